"""Entries of a registry: named things, each from a source "module:name", of this package or another."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from importlib.metadata import EntryPoint
from typing import Any

from fusion_sfdia.common.references import call, first_line, load

NAME = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*(:[a-z0-9]+(-[a-z0-9]+)*)?")
EXAMPLES = {"plant": "two-tanks", "detector": "kf-chi2 or chebyshev:paper"}


def enter(known: dict[str, Any], kind: str, entry: Any) -> None:
    """Register a NamedPlant or NamedDetector; ValueError for a name of another form, or one registered from another source."""
    if not NAME.fullmatch(entry.name):
        raise ValueError(f"{kind} {entry.name!r}: expected small letters, digits and hyphens, such as {EXAMPLES[kind]}")
    taken = known.get(entry.name)
    if taken is not None and taken.source != entry.source:
        raise ValueError(
            f"{kind} {entry.name!r} of {entry.source}: that name is taken by {taken.source}; register it under another"
        )
    known[entry.name] = entry


def register_entry_point(point: EntryPoint, known: dict[str, Any], kind: str, entry: Callable[..., Any]) -> None:
    """Register the object of an entry point, unless its package registers it itself, before or while it is loaded."""

    def registered() -> bool:
        return point.name in known and known[point.name].package == package_of(point.value)

    if registered():
        return
    package = point.dist.name if point.dist else package_of(point.value)
    try:
        about = first_line(load(point.value))
    except ValueError as error:
        about = f"cannot be loaded: {error}"
    if not registered():
        enter(known, kind, entry(point.name, about, partial(call, point.value, f"package {package}: "), source=point.value))


def deferred(thing: Any) -> Any:
    """The function that makes a plant or builds a detector; one given as a text is imported when it is called."""
    return partial(call, thing, "") if isinstance(thing, str) else thing


def identity(thing: Any) -> Any:
    """Return the argument: partial(identity, plant) makes that plant."""
    return thing


def package_of(source: str) -> str:
    """The top-level package of a source."""
    return source.partition(":")[0].partition(".")[0]
