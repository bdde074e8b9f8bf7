"""Public names of a module that are imported at their first use: those of the .pyi beside it, which type checkers read, too."""

import ast
import sys
from collections.abc import Callable, Mapping
from functools import reduce
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any

from fusion_sfdia.common.errors import warn_renamed

NONE: Mapping[str, str] = MappingProxyType({})


def public_names(
    name: str, file: str, former: Mapping[str, str] = NONE
) -> tuple[list[str], Callable[[str], Any], Callable[[], list[str]]]:
    """Return `__all__`, `__getattr__` and `__dir__` of the module `name` in `file`; AttributeError for any other name.

    former: names that still work, with a warning, and what they are called now, see `now_called`.
    """
    tree = ast.parse(Path(file).with_suffix(".pyi").read_text(encoding="utf-8"))
    modules = {alias.name: str(n.module) for n in tree.body if isinstance(n, ast.ImportFrom) for alias in n.names}

    def get(wanted: str) -> Any:
        if now := former.get(wanted):
            warn_renamed(f"{name}.{wanted}", f"{name}.{now}")
            return now_called(sys.modules[name], now)
        if wanted not in modules:
            raise AttributeError(f"module {name!r} has no attribute {wanted!r}; public names: {', '.join(modules)}")
        value = getattr(import_module(modules[wanted]), wanted)
        setattr(sys.modules[name], wanted, value)
        return value

    return [*modules], get, lambda: sorted(modules)


def now_called(home: Any, now: str) -> Any:
    """What `now` names in a module: "Class.method", or "Class.method(...).part", a part of what that returns."""
    made, _, part = now.partition("(...).")
    found = reduce(getattr, made.split("."), home)
    return (lambda *args, **settings: getattr(found(*args, **settings), part)) if part else found
