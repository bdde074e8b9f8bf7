"""Where compiled code is kept: beside the modules of a checkout, of an installed package in the user's cache.

There it outlives an installation anew and is shared by all environments; a package that cannot be written to needs no other
place. It belongs to the text of all files whose functions are compiled into it, so that no edit and no other version is missed.
Before both comes the folder that NUMBA_CACHE_DIR names. Where no folder can be written to, nothing is kept.
"""

from __future__ import annotations

import inspect
import os
import sys
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from time import monotonic, sleep
from typing import Any

from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator

from fusion_sfdia.common.files import compiled_code_folder, hold

LONGEST_WAIT = 20.0  # s, for what another process compiles, which takes a few


class _InUserCache(_CacheLocator):  # type: ignore[misc]
    """A folder for each text of a file of an installed package."""

    def __init__(self, folder: Path, function: Any, path: str) -> None:
        self.line = function.__code__.co_firstlineno
        self.folder = str(folder / f"{function.__module__}-{text_hash(path)[:16]}")

    def get_cache_path(self) -> str:
        return self.folder

    def get_source_stamp(self) -> None:
        return None  # a MachineCode has its own

    def get_disambiguator(self) -> str:
        return str(self.line)

    @classmethod
    def from_function(cls, function: Any, path: str) -> _InUserCache | None:
        if (folder := compiled_code_folder()) is None or not os.path.exists(path):
            return None
        found = cls(folder, function, path)
        try:
            found.ensure_cache_path()
        except OSError:
            return None
        return found


class _Kept(CompileResultCacheImpl):  # type: ignore[misc]
    @property
    def _locator_classes(self) -> list[Any]:
        named, *others = CompileResultCacheImpl._locator_classes
        return [named, _InUserCache, *others]


class MachineCode(FunctionCache):  # type: ignore[misc]
    """Machine code on disk; what refers to modules or classes that no longer exist is discarded and compiled again.

    What one process compiles another waits for, where files can be locked.
    """

    _impl_class = _Kept
    held: int | None = None  # the lock of what is compiled here at present
    stamped = False

    @property
    def has_code(self) -> bool:
        """Whether the function, as it and what it calls are now, has been compiled for any arguments."""
        self._stamp()
        return bool(self._cache_file._load_index())

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        self._stamp()
        if (found := self._loaded(sig, target_context)) is None and self.held is None:
            with suppress(OSError):
                self._impl.locator.ensure_cache_path()
                self.held = _locked(self._lock)
            if (found := self._loaded(sig, target_context)) is not None:
                self._release()
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        super().save_overload(sig, data)
        self._release()

    def _stamp(self) -> None:
        """Not before a first call: what a function calls may stand below it."""
        if not self.stamped:
            self.stamped, self._cache_file._source_stamp = True, called_text(self._py_func)

    def _loaded(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except (ImportError, AttributeError):
            self.flush()  # otherwise saving would read the same index again
            return None

    @property
    def _lock(self) -> str:
        return f"{self._cache_file._index_path}.lock"

    def _release(self) -> None:
        if self.held is not None:
            with suppress(OSError):
                os.unlink(self._lock)
            os.close(self.held)
            self.held = None


def called_text(function: Any) -> str:
    """A hash of all that is compiled into a function: the files in which it and what it calls stand, and constants."""
    package = function.__module__.split(".")[0]
    known: set[str] = set()
    seen, waiting = set(), [function]
    while waiting:
        one = waiting.pop()
        if one in seen:
            continue
        seen.add(one)
        known.add(text_of(one))
        for name in one.__code__.co_names:
            found = one.__globals__.get(name)
            found = getattr(found, "py_func", found)
            if isinstance(found, int | float | complex | str | tuple):
                known.add(f"{name} = {found!r}")
            elif str(getattr(found, "__module__", None)).split(".")[0] == package:
                known.add(text_of(found))
                waiting += [found] if inspect.isfunction(found) else []
    return sha256("\n".join(sorted(known)).encode()).hexdigest()


def text_of(one: Any) -> str:
    """A hash of the file in which a function or class stands; of one that was typed in, what no other process has."""
    path = getattr(sys.modules.get(one.__module__), "__file__", None)
    if path is None or not os.path.exists(path):
        return repr(getattr(one, "__code__", one))
    return text_hash(path)


@cache
def text_hash(path: str) -> str:
    """Of a file."""
    return sha256(Path(path).read_bytes()).hexdigest()


def _locked(path: str) -> int | None:
    """The file, held until it is closed or the process ends; None where another holds it too long."""
    latest = monotonic() + LONGEST_WAIT
    while monotonic() < latest:
        Path(path).touch()  # what compiled before has removed it
        if (handle := hold(Path(path))) is not None:
            return handle
        sleep(0.01)
    return None
