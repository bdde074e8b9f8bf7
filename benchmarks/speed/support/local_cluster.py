"""A dask cluster of this machine with TLS and a certificate of its own, which ends with the block."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory


@contextmanager
def secure_cluster(workers: int) -> Iterator[str]:
    """Give the tls:// address of a scheduler with that many workers of one thread; within the block clients are known to it.

    Nobody else has the certificate: other processes, which could run code through a scheduler at tcp://, are refused.
    """
    import dask
    from distributed import LocalCluster
    from distributed.security import Security

    security = Security.temporary()
    with TemporaryDirectory() as folder:
        files = {}
        for name in ("tls_ca_file", "tls_client_cert", "tls_client_key"):
            files[name] = Path(folder, f"{name}.pem")
            files[name].touch(mode=0o600)
            files[name].write_text(getattr(security, name), encoding="ascii")
        known = {
            "distributed.comm.require-encryption": True,
            "distributed.comm.tls.ca-file": str(files["tls_ca_file"]),
            "distributed.comm.tls.client.cert": str(files["tls_client_cert"]),
            "distributed.comm.tls.client.key": str(files["tls_client_key"]),
        }
        with (
            dask.config.set(known),
            LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                host="127.0.0.1",
                dashboard_address=None,
                silence_logs=logging.CRITICAL,
                security=security,
            ) as cluster,
        ):
            yield str(cluster.scheduler_address)
