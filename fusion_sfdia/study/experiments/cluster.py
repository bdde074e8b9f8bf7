"""Pieces of work on the workers of a dask cluster that is already running; their arrays come back and are kept here.

The cluster's own scheduler distributes the pieces and reassigns those of a lost worker. Every piece runs with
one thread for linear algebra, so that its bits are those of a run on one machine of the same kind with the same libraries.

A dask scheduler authenticates its clients only if its address is tls://, and tasks and answers are pickles, which run code
where they are read: whoever reaches a tcp:// scheduler can run code on its workers, and on this machine through their answers.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

from fusion_sfdia.study.experiments.parts import decisive, write_part
from fusion_sfdia.study.experiments.scenario import Arrays, Task
from fusion_sfdia.study.experiments.workers import Done, Piece, timed

PATIENCE = 15.0  # seconds to wait for the scheduler, and for its first worker


@contextmanager
def connected(address: str) -> Iterator[Callable[[Sequence[Piece]], Iterator[Done]]]:
    """Give a function that does pieces of work on the scheduler's workers and yields each when it is done, in any order.

    Raises ModuleNotFoundError without the package `distributed`, ValueError for what is no address, for tls:// without
    certificates, and where workers run other code or libraries than this process, OSError where nothing answers or no worker
    comes, RuntimeError where the scheduler disappears meanwhile.
    """
    try:
        from distributed import Client
        from distributed.comm import get_address_host_port
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "a dask cluster needs the package distributed, which is not installed: pip install 'fusion-sfdia[dask]'"
        ) from error
    _require_certificates(address)
    try:
        get_address_host_port(address)  # a Client would take its time and print a traceback
        client = Client(address, timeout=PATIENCE, set_as_default=False)
    except ValueError as error:
        raise ValueError(
            f"{address!r} is no address of a dask scheduler ({error}); expected one such as tcp://host:8786"
        ) from error
    except OSError as error:
        raise OSError(f"no dask scheduler answers at {address}; start it or correct the address") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError as error:
            raise OSError(
                f"the dask scheduler at {address} has no worker after {PATIENCE:g} s; start at least one: dask worker {address}"
            ) from error
        here = decisive()
        for worker, problem in client.run(_require_same, here, on_error="return").items():
            if problem is not None:
                raise ValueError(f"worker {worker} cannot do the work: {problem}; install the same there") from problem
        yield partial(_work_off, client, here)


def _require_certificates(address: str) -> None:
    """ValueError where an address is tls:// and dask is configured without the certificates that it needs."""
    from distributed.security import Security

    found = Security().get_tls_config_for_role("client")
    needed = {"ca_file": "DASK_DISTRIBUTED__COMM__TLS__CA_FILE", "cert": "DASK_DISTRIBUTED__COMM__TLS__CLIENT__CERT"}
    lacking = [variable for part, variable in needed.items() if not found[part]]
    if address.startswith("tls://") and lacking:
        raise ValueError(f"{address} needs certificates: set {' and '.join(lacking)} to their files")


def _work_off(client: Any, here: Mapping[str, Any], pieces: Sequence[Piece]) -> Iterator[Done]:
    from distributed import as_completed

    waiting = {client.submit(_done_alike, here, piece.work, piece.task, pure=False): piece.path for piece in pieces}
    for future in as_completed(list(waiting), loop=client.loop):
        path = waiting.pop(future)
        arrays: Arrays = {}
        seconds = 0.0
        if future.status == "cancelled":
            logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # no traceback of a closed connection
            raise RuntimeError(
                "the dask scheduler disappeared, or dropped the work; finished pieces are kept: start the cluster again "
                "and repeat the same command to continue"
            )
        if future.status == "finished":
            arrays, seconds, error_text = future.result()
        elif isinstance(problem := future.exception(), OtherCodeError):  # a worker that joined after the others
            raise ValueError(f"a worker cannot do the work: {problem}; install the same there") from problem
        else:  # lost: more workers ended on it than the scheduler accepts
            error_text = f"{type(problem).__name__}: {problem}"
        future.release()
        if error_text is None:
            write_part(path, arrays)
        yield Done(path, seconds, error_text)


class OtherCodeError(Exception):
    """A worker's code or libraries differ from those of this process."""


def _require_same(expected: Mapping[str, Any]) -> None:
    """On a worker: raise OtherCodeError where it has other code or libraries than expected."""
    there = decisive()
    if differing := [name for name in expected if expected[name] != there.get(name)]:
        raise OtherCodeError(f"it has other {', '.join(differing)} than this process")


def _done_alike(expected: Mapping[str, Any], work: Callable[[Task], Arrays], task: Task) -> tuple[Arrays, float, str | None]:
    """On a worker: do a piece of work, only with the expected code and libraries."""
    _require_same(expected)
    return timed(work, task)
