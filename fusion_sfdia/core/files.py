"""Files and folders that are complete or absent: atomic writes, a folder's files together, and errors that name the cure."""

from __future__ import annotations

import errno
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, Literal

CURES = {
    errno.ENOENT: "name an existing one",
    errno.EISDIR: "name a file, not a folder",
    errno.ENOTDIR: "name a place below folders, not below a file",
    errno.ENOSPC: "make room, or name another place",
    errno.EDQUOT: "make room, or name another place",
    errno.ENAMETOOLONG: "give a shorter name",
}


def explained(error: BaseException) -> str:
    """Return an error as text: the purpose of the file, what failed and the cure."""
    if isinstance(error, MemoryError):
        return f"the memory is too small ({error}); ask for fewer steps, seeds or workers, or cut the log"
    if isinstance(error, OverflowError):
        return f"a number is too large ({error}); give a smaller one"
    if not isinstance(error, OSError) or not (error.filename and error.strerror):
        return str(error)
    return f"{error.filename}: {error.strerror}; {CURES.get(error.errno or 0, 'name another place, or change its permissions')}"


@contextmanager
def atomic_write(path: Path, mode: Literal["w", "wb"] = "w") -> Iterator[IO[Any]]:
    """Open a file that takes its name only when the block ends without an error; otherwise no file or new folder remains.

    An existing file is replaced and keeps its mode, also behind a link. A device, a pipe or a stream of this process
    (/dev/stdout) is written to directly. An OSError names the file, also where the folder or the disk caused it.
    """
    try:
        with _through(path, mode) if _is_stream(path) else _temporary(path, mode) as file:
            yield file
    except FileExistsError as error:  # from mkdir: a part of the path is a file
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(path)) from error
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


@contextmanager
def made_folder(folder: Path) -> Iterator[None]:
    """Make a folder and its parents; those that are new and still empty at the end of the block are removed."""
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


STREAMS = {Path("/dev/stdout"): 1, Path("/dev/stderr"): 2}  # may be a file to which other processes write


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


def require_free(out: Path, *, force: bool = False) -> None:
    """Raise ValueError where the folder is a file, cannot be written to, or holds something and force is not given."""
    nearest = next((p for p in (out, *out.parents) if p.exists()), Path())
    if nearest.is_file():
        raise ValueError(f"cannot write into {out}: {nearest} is a file; name a folder with --out")
    if not os.access(nearest, os.R_OK | os.W_OK | os.X_OK):
        raise ValueError(f"cannot write into {out}: no permission in {nearest}; name another folder with --out")
    if out.exists() and any(out.iterdir()) and not force:
        raise ValueError(f"{out} is already used; name another folder with --out, or write into it with --force")


@contextmanager
def all_or_none(out: Path) -> Iterator[Path]:
    """Yield a folder whose files move into `out` when the block ends without an error; otherwise `out` does not change.

    Files of the same names are replaced, one at a time; if one fails, those before are restored. Others stay.
    """
    near = next(p for p in (out, *out.parents) if p.exists())  # on the same disk
    with tempfile.TemporaryDirectory(dir=near, prefix=".fusion-sfdia.") as temporary:
        new, old = Path(temporary, "new"), Path(temporary, "old")
        new.mkdir()
        try:
            yield new
        except OSError as error:
            if error.filename and Path(error.filename).is_relative_to(new):  # the temporary folder means nothing to the user
                raise OSError(error.errno, error.strerror, str(out / Path(error.filename).relative_to(new))) from error
            raise
        names = [p.relative_to(new) for p in sorted(new.rglob("*")) if p.is_file()]
        present = [name for name in names if (out / name).exists()]
        for name in present:
            (old / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(out / name, old / name)
        with made_folder(out):
            moved = []
            try:
                for name in names:
                    (out / name).parent.mkdir(parents=True, exist_ok=True)
                    os.replace(new / name, out / name)
                    moved.append(name)
            except BaseException:
                for name in moved:
                    os.replace(old / name, out / name) if name in present else (out / name).unlink()
                raise
