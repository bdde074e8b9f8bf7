"""Objects named by a text: "module:attribute", or "path/file.py:attribute" for a file that is on no import path."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from dataclasses import is_dataclass
from difflib import get_close_matches
from hashlib import sha256
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from inspect import getdoc, signature
from pathlib import Path
from types import ModuleType
from typing import Any


def is_reference(text: str) -> bool:
    """Whether a text has the form of a reference to a module or to a Python file."""
    place, colon, attribute = text.rpartition(":")
    named = _is_file(place) or all(part.isidentifier() for part in place.split("."))
    return bool(colon) and named and all(part.isidentifier() for part in attribute.split("."))


def load(reference: str) -> Any:
    """Return the object that a reference names.

    ValueError where there is no such file, module or attribute, and where the file or module fails while it is imported.
    """
    if not is_reference(reference):
        raise ValueError(f"{reference!r} names no object; expected module:attribute or path/file.py:attribute")
    place, _, attributes = reference.rpartition(":")
    found: Any = _file(Path(place)) if _is_file(place) else _module(place)
    for attribute in attributes.split("."):
        if not hasattr(found, attribute):
            members = getattr(found, "__dict__", {})
            there = f"{did_you_mean(attribute, members)}it has {', '.join(_offered(members)) or 'none'}"
            raise ValueError(f"{reference}: {place} has no attribute {attribute!r}; {there}")
        found = getattr(found, attribute)
    return found


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """A question for the nearest of the known names, with a space after it; empty where none is near."""
    near = get_close_matches(name, known, n=1)
    return f"did you mean {near[0]!r}? " if near else ""


def call(reference: str, whose: str, *arguments: Any, **settings: Any) -> Any:
    """Return what the object that a reference names returns for these arguments, or the object where it is no function.

    ValueError as in `load`, its message begins with `whose`.
    """
    try:
        found = load(reference)
    except ValueError as error:
        raise ValueError(f"{whose}{error}") from error
    return found(*arguments, **settings) if callable(found) else found


def require_call(what: str, found: Any, expected: str, arguments: int) -> None:
    """Raise ValueError unless an object can be called with that many arguments."""
    if not callable(found):
        raise ValueError(f"{what} is of type {type(found).__name__}; expected {expected}")
    try:
        signature(found).bind(*[None] * arguments)
    except TypeError as error:
        raise ValueError(f"{what} cannot be called with {arguments} arguments ({error}); expected {expected}") from error


def name_of(thing: Any) -> str:
    """A reference itself, or the name of a function or class."""
    if isinstance(thing, str):
        return thing
    thing = getattr(thing, "func", thing)  # of a partial
    return str(getattr(thing, "__name__", type(thing).__name__))


def source_of(thing: Any) -> str:
    """A reference itself, or the "module:name" of a function or class."""
    if isinstance(thing, str):
        return thing
    thing = getattr(thing, "func", thing)
    return f"{thing.__module__}:{getattr(thing, '__qualname__', type(thing).__qualname__)}"


def first_line(thing: Any) -> str:
    """The first line of the docstring of a function or class, without a full stop."""
    return (getdoc(thing) or "").partition("\n")[0].removesuffix(".")


def _offered(members: Mapping[str, Any]) -> list[str]:
    """The public functions, classes and plants among members, without classes that a module imports."""

    def imported(value: Any) -> bool:
        return isinstance(value, type) and value.__module__ != members.get("__name__", value.__module__)

    return [
        name
        for name, value in members.items()
        if not name.startswith("_") and (is_dataclass(value) or callable(value)) and not imported(value)
    ]


def _is_file(place: str) -> bool:
    return place.endswith(".py")


def _module(name: str) -> ModuleType:
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{name}.".startswith(f"{error.name}."):
            raise ValueError(f"module {name} fails while it is imported: {_shown(error)}; install what it needs") from error
        raise ValueError(
            f"there is no module {name}; install the package that has it, or name its file: path/file.py:attribute"
        ) from error
    except Exception as error:
        raise ValueError(f"module {name} fails while it is imported: {_shown(error)}; correct it") from error


def _file(path: Path) -> ModuleType:
    """The module of a file, imported once until the file changes, under a unique name: two files may have the same one."""
    try:
        path = path.resolve(strict=True)
        source = path.read_bytes()
    except OSError as error:
        raise ValueError(f"{path} cannot be read ({error.strerror}); expected a Python file, path/file.py:attribute") from error
    name = f"{path.stem}_{sha256(str(path).encode()).hexdigest()[:12]}"
    digest = sha256(source).hexdigest()
    if name in sys.modules and getattr(sys.modules[name], "__digest__", "") == digest:
        return sys.modules[name]
    spec = spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None  # as its name ends in .py
    module = module_from_spec(spec)
    vars(module)["__digest__"] = digest
    sys.modules[name] = module  # before it runs: dataclasses look their module up
    folder = str(path.parent)  # of what it imports that is beside it
    sys.path.append(folder)
    try:
        exec(compile(source, str(path), "exec"), vars(module))
    except Exception as error:
        del sys.modules[name]
        raise ValueError(f"{path} fails while it is imported: {_shown(error)}; correct it, or install what it needs") from error
    finally:
        sys.path.remove(folder)
    return module


def _shown(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"
