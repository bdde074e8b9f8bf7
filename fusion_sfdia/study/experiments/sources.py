"""What an object is made of, as a digest: a plant or detector of a caller's own that was changed has another one.

The package's own sources are in the name of every part of a run (see `provenance.sources_digest`); those of a caller are not.
"""

from __future__ import annotations

import ast
import hashlib
import io
import pickle
import sys
import sysconfig
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from types import FunctionType, MethodType
from typing import Any

import cloudpickle
import numpy as np

OURS = "fusion_sfdia"
KNOWN = ("numpy", "scipy", "numba", "joblib", "sklearn")  # libraries whose versions decide are in the names of parts


def object_digest(thing: Any, modules: Iterable[str] = ()) -> str:
    """A digest of an object's pickled bytes and of the sources of the modules that define it, as they are on disk.

    modules: names of further modules that define it. Modules that these import count too, but for this package and libraries.
    What is defined in the main module is pickled whole. ValueError for what cannot be pickled.
    """
    buffer = io.BytesIO()
    pickler = _Pickler(buffer)
    try:
        pickler.dump(thing)
    except (pickle.PicklingError, TypeError, AttributeError) as error:
        raise ValueError(f"{thing!r} cannot be sent to other processes: {error}; make it of functions and arrays") from error
    digest = hashlib.sha256(buffer.getvalue())
    for name, source in sorted(defining_sources({*modules, *pickler.modules}).items()):
        digest.update(f"{name}\0".encode() + source + b"\0")
    return digest.hexdigest()


def content_digest(thing: Any) -> str:
    """A digest of what an object holds: equal for objects built from equal values, in every process.

    Fields of dataclasses, containers, arrays, objects of methods, and arguments of partial functions count by value; what a
    cached property keeps does not count. All else counts as in `object_digest`, whose ValueError it raises.
    """
    return hashlib.sha256(repr(_content(thing)).encode()).hexdigest()


def _content(thing: Any) -> Any:
    """Nested tuples of texts that two objects share where they hold the same."""
    kind = f"{type(thing).__module__}.{type(thing).__qualname__}"
    if thing is None or isinstance(thing, bool | int | float | complex | str | bytes | np.generic):
        return kind, repr(thing)
    if isinstance(thing, np.ndarray) and not thing.dtype.hasobject:
        return kind, thing.dtype.str, thing.shape, hashlib.sha256(thing.tobytes()).hexdigest()
    if is_dataclass(thing) and not isinstance(thing, type):
        return kind, object_digest(type(thing)), tuple((f.name, _content(getattr(thing, f.name))) for f in fields(thing))
    if isinstance(thing, tuple | list):
        return kind, tuple(_content(one) for one in thing)
    if isinstance(thing, set | frozenset):
        return kind, tuple(sorted(repr(_content(one)) for one in thing))
    if isinstance(thing, Mapping):
        return kind, tuple((_content(key), _content(value)) for key, value in thing.items())
    if isinstance(thing, partial):
        return kind, _content(thing.func), _content(thing.args), _content(thing.keywords)
    if isinstance(thing, MethodType):
        return kind, thing.__name__, _content(thing.__self__)
    return kind, object_digest(thing)


class _Pickler(cloudpickle.Pickler):  # type: ignore[misc]  # it states no types
    """Pickles as for a worker process, the same bytes in every process, and notes the modules of functions and classes."""

    def __init__(self, file: io.BytesIO) -> None:
        super().__init__(file)
        self.modules: set[str] = set()

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, type | FunctionType) and obj.__module__ in sys.modules:  # `namedtuple_X` of a NamedTuple is none
            self.modules.add(obj.__module__)
        reduced = super().reducer_override(obj)
        if isinstance(obj, type) and isinstance(reduced, tuple) and len(reduced[1]) > 2:
            function, (*arguments, _, last), *others = reduced  # a class of the main module has a random number
            return (function, (*arguments, "", last), *others)
        return reduced


def defining_sources(modules: Iterable[str]) -> dict[str, bytes]:
    """Sources by name of modules, and of those that they import; none of this package, of Python, or of other libraries.

    A module that is asked for may be of an installed package, whose own modules then count.
    """
    asked = {name for name in modules if name}
    packages = {name.partition(".")[0] for name in asked}
    libraries = [Path(sysconfig.get_path(kind)).resolve() for kind in ("purelib", "platlib")]
    found: dict[str, bytes] = {}
    to_see, seen = sorted(asked), {"__main__"}
    while to_see:
        name = to_see.pop()
        top = name.partition(".")[0]
        if name in seen or top in (OURS, *sys.stdlib_module_names):
            continue
        seen.add(name)
        module = import_module(name)
        path = Path(getattr(module, "__file__", None) or "")
        library = top in KNOWN or (top not in packages and any(folder in path.resolve().parents for folder in libraries))
        if path.suffix == ".py" and not library:
            found[name] = path.read_bytes()
            to_see += [other for other in _imported(found[name], module.__package__ or "") if other in sys.modules]
    return found


def _imported(source: bytes, package: str) -> set[str]:
    """Full names of what a module of a package imports; names that are no modules are among them."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            start = ".".join([*base, *([node.module] if node.module else [])])
            found |= {start, *(f"{start}.{alias.name}" for alias in node.names)}
    return found
