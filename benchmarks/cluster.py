"""Pieces of work on the workers of a dask cluster that is already running; their arrays come back and are kept here.

The cluster's own scheduler shares the pieces out and gives those of a worker that is lost to the others. Every piece runs with
one thread for linear algebra, so that its bits are those of a run on one machine of the same kind with the same libraries.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from fusion_sfdia.benchmarks.parts import decisive, write_part
from fusion_sfdia.benchmarks.workers import Done, Piece, timed

REACHED = 10.0  # seconds to wait for the scheduler


def work_off_on_cluster(pieces: Sequence[Piece], address: str) -> Iterator[Done]:
    """Do the pieces on the workers of the scheduler at `address` and tell of each when it is done, in any order.

    Raises ModuleNotFoundError without the package `distributed`, OSError where nothing answers, ValueError where workers run
    other code or libraries than this process.
    """
    try:
        from distributed import Client, as_completed
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "a dask cluster needs the package distributed, which is not installed: pip install 'fusion-sfdia[dask]'"
        ) from error
    try:
        client = Client(address, timeout=REACHED, set_as_default=False)
    except ValueError as error:
        raise ValueError(
            f"{address!r} is no address of a dask scheduler ({error}); wanted one such as tcp://host:8786"
        ) from error
    except OSError as error:
        raise OSError(f"no dask scheduler answers at {address}; start it or correct the address") from error
    with client:
        here = decisive()
        for worker, there in client.run(decisive).items():
            if differing := [name for name in here if here[name] != there[name]]:
                raise ValueError(f"worker {worker} has other {', '.join(differing)} than this process; install the same there")
        waiting = {client.submit(timed, piece.work, piece.task, pure=False): piece.path for piece in pieces}
        for future in as_completed(list(waiting), loop=client.loop):
            path = waiting.pop(future)
            if future.status == "finished":
                arrays, seconds, error_text = future.result()
            else:  # lost: a worker died of it, too often for the scheduler
                arrays, seconds, error_text = {}, 0.0, f"{type(future.exception()).__name__}: {future.exception()}"
            future.release()
            if error_text is None:
                write_part(path, arrays)
            yield Done(path, seconds, error_text)
