"""Files and folders that are complete or absent: atomic writes, a folder's files together, one writer at a time, and errors
that name the cure.

What is written goes to a temporary file or folder, which its process holds by a lock of the system for as long as it lives.
A temporary without a holder is what a killed process has left: the next write into that folder removes it. Where the disk or
the system has no such locks (some network disks, Windows), nothing is held and nothing is removed.
"""

from __future__ import annotations

import errno
import os
import secrets
import shutil
import stat
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import IO, Any, Literal

from fusion_sfdia.common.arguments import some

if sys.platform != "win32":
    import fcntl

TEMPORARY, LOCK = ".fusion-sfdia.", ".lock"  # how the names of temporaries begin, and the file by which a folder is held
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
        for made in new:
            _sync_folder(made.parent)
    finally:
        for made in new:
            with suppress(OSError):
                made.rmdir()


@contextmanager
def _temporary(path: Path, mode: Literal["w", "wb"]) -> Iterator[IO[Any]]:
    path = Path(os.path.realpath(path))
    kept = stat.S_IMODE(path.stat().st_mode) if path.is_file() else None
    make = partial(_make_file, permissions=0o666 if kept is None else 0o600)
    with made_folder(path.parent), _held_temporary(path.parent, make) as temporary:
        with temporary.open(mode, **_text(mode)) as file:
            yield file
            _sync(file)
        if kept is not None:
            temporary.chmod(kept)
        os.replace(temporary, path)
        _sync_folder(path.parent)


def _make_file(path: Path, permissions: int = 0o666) -> None:
    """Make an empty file; permissions: less the process's umask, as for any new file."""
    os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, permissions))


@contextmanager
def _held_temporary(folder: Path, make: Callable[[Path], None]) -> Iterator[Path]:
    """A new temporary in a folder, held until the end of the block, where it is removed; before it those without a holder."""
    remove_leftovers(folder)
    handle = None
    while handle is None:  # a process that removes leftovers may take it before it is held
        temporary = folder / f"{TEMPORARY}{secrets.token_hex(8)}"
        make(temporary)
        handle = hold(temporary)
    try:
        yield temporary
    finally:
        shutil.rmtree(temporary, ignore_errors=True) if temporary.is_dir() else temporary.unlink(missing_ok=True)
        os.close(handle)


def remove_leftovers(folder: Path) -> None:
    """Remove the temporaries of processes that have ended from a folder."""
    for path in folder.glob(f"{TEMPORARY}*"):
        with suppress(OSError):  # gone meanwhile, or of another user
            if not stat.S_ISDIR(mode := path.lstat().st_mode) and not stat.S_ISREG(mode):
                continue
            if (handle := hold(path, surely=True)) is not None:
                try:
                    shutil.rmtree(path) if stat.S_ISDIR(mode) else path.unlink()
                finally:
                    os.close(handle)


def hold(path: Path, *, surely: bool = False) -> int | None:
    """Hold a file or folder until the handle is closed or the process ends; None where another process does, or has removed it.

    surely: also None where there are no locks; otherwise the handle then holds nothing.
    """
    if sys.platform == "win32":  # opens no folders, either
        return None if surely else os.open(os.devnull, os.O_RDONLY)
    try:
        handle = os.open(path, (os.O_RDONLY if path.is_dir() else os.O_RDWR) | os.O_NOFOLLOW)
    except FileNotFoundError:
        return None
    held = False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        held = os.path.samestat(os.fstat(handle), path.stat())
    except (BlockingIOError, FileNotFoundError):
        pass
    except OSError:
        held = not surely
    finally:
        if not held:
            os.close(handle)
    return handle if held else None


def compiled_code_folder() -> Path | None:
    """Where an installed package keeps what it compiles, in the user's cache; None in a checkout: beside its modules."""
    package = Path(__file__).parents[1]
    if (package.parent / "pyproject.toml").exists():
        return None
    from platformdirs import user_cache_dir

    return Path(user_cache_dir(package.name, appauthor=False), "compiled")


def _sync(file: IO[Any]) -> None:
    """Have a file's content on the disk, so that a power cut after its renaming leaves the old file or the new one."""
    file.flush()
    os.fsync(file.fileno())


def _sync_folder(folder: Path) -> None:
    """Have the names in a folder on the disk, where the disk can."""
    if sys.platform == "win32":
        return
    with suppress(OSError):  # some disks cannot sync a folder, and it may be one that may not be read
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


STREAMS = {Path("/dev/stdout"): 1, Path("/dev/stderr"): 2}  # may be a file to which other processes write


def _is_stream(path: Path) -> bool:
    return path in STREAMS or (path.exists() and not (path.is_file() or path.is_dir()))


@contextmanager
def _through(path: Path, mode: Literal["w", "wb"]) -> Iterator[IO[Any]]:
    with open(os.dup(STREAMS[path]) if path in STREAMS else path, mode, **_text(mode)) as file:
        yield file


def _text(mode: str) -> dict[str, Any]:
    return {} if "b" in mode else {"encoding": "utf-8", "newline": "", "errors": "backslashreplace"}


def require_free(out: Path, *, force: bool = False) -> None:
    """Raise ValueError where the folder is a file, cannot be written to, or holds something and force is not given."""
    nearest = next((p for p in (out, *out.parents) if p.exists()), Path())
    if nearest.is_file():
        raise ValueError(f"cannot write into {out}: {nearest} is a file; name a folder with --out")
    if not os.access(nearest, os.R_OK | os.W_OK | os.X_OK):
        raise ValueError(f"cannot write into {out}: no permission in {nearest}; name another folder with --out")
    held = [p for p in out.iterdir() if not p.name.startswith((TEMPORARY, LOCK))] if out.exists() and not force else []
    if held:
        newest = datetime.fromtimestamp(max(p.lstat().st_mtime for p in held))
        raise ValueError(
            f"{out} is already used: it holds {some(sorted(p.name for p in held))}, the newest of {newest:%Y-%m-%d %H:%M}; "
            "name another folder with --out, or replace what is there with --force"
        )


@contextmanager
def locked(out: Path, *, force: bool = True) -> Iterator[None]:
    """Make a folder and hold it for this process; ValueError where another process does, and as `require_free`.

    The system releases the lock of a process that ends, however it ends: a file that is left behind blocks no other process.
    """
    require_free(out, force=force)
    with made_folder(out), _only_writer(out / LOCK, out, "folder with --out"):
        require_free(out, force=force)  # another process may have filled it before this one held it
        yield


@contextmanager
def locked_file(path: Path) -> Iterator[None]:
    """The same for a file that is written, by a file .NAME.lock beside it; nothing is held of a device, a pipe or a stream."""
    if _is_stream(path):
        yield
        return
    real = Path(os.path.realpath(path))
    with made_folder(real.parent), _only_writer(real.with_name(f".{real.name}{LOCK}"), path, "file"):
        yield


@contextmanager
def _only_writer(lock: Path, held: Path, another: str) -> Iterator[None]:
    try:
        with suppress(FileExistsError):
            _make_file(lock)
        handle = hold(lock)
    except OSError as error:
        raise ValueError(f"cannot write into {lock.parent} ({error.strerror}); name another {another}") from error
    if handle is None:
        raise ValueError(f"{held} is in use: another run writes into it; wait until it has ended, or name another {another}")
    try:
        yield
    finally:
        with suppress(OSError):
            lock.unlink()
        os.close(handle)


@contextmanager
def all_or_none(out: Path, *, instead_of: Iterable[str] = ()) -> Iterator[Path]:
    """Yield a folder whose files move into `out` when the block ends without an error; otherwise `out` does not change.

    Files of the same names are replaced, one at a time; if one fails, those before are restored. Others stay, but for files
    of these names, instead_of, which an earlier run has left: they are removed, and restored likewise.
    """
    near = next(p for p in (out, *out.parents) if p.exists())  # on the same disk
    with _held_temporary(near, lambda path: path.mkdir(0o700)) as temporary:
        new, old = temporary / "new", temporary / "old"
        new.mkdir()
        try:
            yield new
        except OSError as error:
            if error.filename and Path(error.filename).is_relative_to(new):  # the temporary folder means nothing to the user
                raise OSError(error.errno, error.strerror, str(out / Path(error.filename).relative_to(new))) from error
            raise
        names = [p.relative_to(new) for p in sorted(new.rglob("*")) if p.is_file()]
        for name in names:
            with (new / name).open("rb+") as file:
                _sync(file)
        present = [name for name in names if (out / name).exists()]
        former = [name for name in {Path(name) for name in instead_of} - {*names} if (out / name).is_file()]
        for name in (*present, *former):
            (old / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(out / name, old / name)
        with made_folder(out):
            moved, removed = [], []
            try:
                for name in former:
                    (out / name).unlink()
                    removed.append(name)
                for name in names:
                    (out / name).parent.mkdir(parents=True, exist_ok=True)
                    os.replace(new / name, out / name)
                    moved.append(name)
            except BaseException:
                for name in moved:
                    os.replace(old / name, out / name) if name in present else (out / name).unlink()
                for name in removed:
                    os.replace(old / name, out / name)
                raise
            for folder in {out / name.parent for name in names}:
                _sync_folder(folder)
