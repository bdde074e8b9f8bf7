"""Files that are whole or absent: atomic writes, arrays with a digest of their content, detector states without pickle."""

from __future__ import annotations

import errno
import hashlib
import io
import os
import stat
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.detector import Detector, State
from fusion_sfdia.core.plant import Plant

CURES = {
    errno.ENOENT: "name one that is there",
    errno.EISDIR: "name a file, not a folder",
    errno.ENOTDIR: "name a place below folders, not below a file",
    errno.ENOSPC: "make room, or name another place",
    errno.EDQUOT: "make room, or name another place",
    errno.ENAMETOOLONG: "give a shorter name",
}


def explained(error: BaseException) -> str:
    """Return an error in words: of a file, what it was about, what went wrong and the cure."""
    if isinstance(error, MemoryError):
        return f"the memory is too small ({error}); ask for fewer steps, seeds or workers, or cut the log"
    if isinstance(error, OverflowError):
        return f"a number is too large ({error}); give a smaller one"
    if not isinstance(error, OSError) or not (error.filename and error.strerror):
        return str(error)
    return f"{error.filename}: {error.strerror}; {CURES.get(error.errno or 0, 'name another place, or change its permissions')}"


@contextmanager
def atomic_write(path: Path, mode: Literal["w", "wb"] = "w") -> Iterator[IO[Any]]:
    """Open a file that takes its name only when the block ends well; otherwise nothing is left behind, new folders neither.

    A file that is there is replaced, its mode kept, behind a link too. A device, a pipe or a stream of this process
    (/dev/stdout) is written to as it is. An OSError names the file, also where it is of its folder or of the disk.
    """
    try:
        with _through(path, mode) if _is_stream(path) else _temporary(path, mode) as file:
            yield file
    except FileExistsError as error:  # from mkdir: something on the way is a file
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(path)) from error
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


@contextmanager
def made_folder(folder: Path) -> Iterator[None]:
    """Make a folder and those above it; what is new and still empty when the block ends is taken away again."""
    new = [p for p in (folder, *folder.parents) if not p.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        for made in new:
            with suppress(OSError):
                made.rmdir()


@contextmanager
def _temporary(path: Path, mode: Literal["w", "wb"]) -> Iterator[IO[Any]]:
    path = Path(os.path.realpath(path))
    with made_folder(path.parent):
        permissions = stat.S_IMODE(path.stat().st_mode) if path.is_file() else 0o666 & ~_umask()
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, mode, **_text(mode)) as file:
                yield file
            os.chmod(temporary, permissions)
            os.replace(temporary, path)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise


STREAMS = {Path("/dev/stdout"): 1, Path("/dev/stderr"): 2}  # may stand for a file, in which others write, too


def _is_stream(path: Path) -> bool:
    return path in STREAMS or (path.exists() and not (path.is_file() or path.is_dir()))


@contextmanager
def _through(path: Path, mode: Literal["w", "wb"]) -> Iterator[IO[Any]]:
    with open(os.dup(STREAMS[path]) if path in STREAMS else path, mode, **_text(mode)) as file:
        yield file


def _text(mode: str) -> dict[str, Any]:
    return {} if "b" in mode else {"encoding": "utf-8", "newline": ""}


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def fingerprint(detector: Detector) -> str:
    """A digest by which a saved state is matched: a detector's class and settings, and of its plant the names, the noise,
    where one nominal step and its readings lead from x0 (to 9 digits), which any change of parameters moves, and its areas.
    """
    plant: Plant = detector.plant
    u = plant.input_at(0.0)
    ahead = plant.step(0.0, plant.x0, u, plant.dt)
    parts = [
        type(detector).__name__,
        _described(detector) if is_dataclass(detector) else "",
        plant.name,
        repr(plant.dt),
        *plant.sensor_names,
        *(s.name for s in plant.states),
        *(f"{v:.8e}" for v in (*ahead, *plant.output(plant.dt, ahead, u))),
        *(() if plant.areas is None else (_described(plant.areas),)),
    ]
    digest = hashlib.sha256("\n".join(parts).encode())
    for array in (plant.x0, plant.initial_cov, plant.process_cov, plant.sensor_cov):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _described(value: Any) -> str:
    """Settings in full, arrays to the last bit; the plant of a detector is left to `fingerprint`."""
    if isinstance(value, Plant):
        return ""
    if is_dataclass(value) and not isinstance(value, type):
        return f"{type(value).__name__}({', '.join(f'{f.name}={_described(getattr(value, f.name))}' for f in fields(value))})"
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}{hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()}"
    if isinstance(value, tuple):
        return f"({', '.join(map(_described, value))})"
    return repr(value)


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]], *, compress: bool = False) -> None:
    """Write arrays to a .npz file that ends with a digest of all that stands before it; ValueError for arrays of objects."""
    packed = io.BytesIO()
    save = np.savez_compressed if compress else np.savez
    save(packed, allow_pickle=False, **arrays)
    content = packed.getvalue()
    with atomic_write(path, "wb") as file:
        file.write(content + hashlib.sha256(content).digest())


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Read what write_arrays wrote, to the bit; ValueError where the file is anything else, cut or damaged."""
    found = path.read_bytes()
    content, digest = found[:-32], found[-32:]
    if hashlib.sha256(content).digest() != digest:
        raise ValueError("the digest at its end is not that of its content: it is damaged, cut or of another kind")
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def save_state(path: str | Path, detector: Detector, state: State) -> None:
    """Write a detector's state to a .npz file, without pickle; on the same machine a run goes on from it with the same bits."""
    arrays = {f"state_{i:03d}": np.asarray(a) for i, a in enumerate(state)}
    write_arrays(Path(path), {"fingerprint": np.array(fingerprint(detector)), **arrays})


def load_state(path: str | Path, detector: Detector) -> State:
    """Read a state written by save_state; ValueError where it is none, damaged, or of another detector, settings or plant."""
    try:
        arrays = read_arrays(Path(path))
        found = str(arrays.pop("fingerprint"))
    except (KeyError, ValueError) as error:
        raise ValueError(f"{path} is not a saved detector state ({error}); write one with save_state") from error
    if found != fingerprint(detector):
        raise ValueError(
            f"{path} was saved by another detector, other settings or another plant than {type(detector).__name__} "
            f"on {detector.plant.name!r}; build the detector as it was when the state was saved"
        )
    return tuple(arrays[name] for name in sorted(arrays))
