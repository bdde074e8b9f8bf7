"""Docstrings of public names: every parameter and result is described, in sections as numpydoc has them, and examples run."""

from __future__ import annotations

import doctest
import re
from ast import literal_eval
from collections.abc import Iterator
from contextlib import suppress
from enum import Enum
from inspect import Signature, cleandoc, isclass, isfunction, signature
from typing import Any

import pytest

import fusion_sfdia
from fusion_sfdia.detectors import registry

GROUPS = [getattr(fusion_sfdia, group) for group in fusion_sfdia._GROUPS]
NAMES = [(fusion_sfdia, name) for name in fusion_sfdia.__all__ if name not in ("__version__", *fusion_sfdia._GROUPS)]
NAMES += [(group, name) for group in GROUPS for name in group.__all__]
PUBLIC = {f"{module.__name__}.{name}": getattr(module, name) for module, name in NAMES}
LONG = {"Commissioning", "audit", "compare", "inspect", "tune"}  # examples of more than two seconds
HEADING = re.compile(r"^(\w[\w ]*)\n-{3,}$", re.MULTILINE)
DESCRIBED = re.compile(r"^(\*{0,2}\w+(?:, \*{0,2}\w+)*)(?: : (.+))?$", re.MULTILINE)  # names and their type


def sections(thing: Any) -> dict[str, str]:
    """The sections of a docstring by their titles."""
    parts = HEADING.split(cleandoc(thing.__doc__ or ""))
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def described(thing: Any) -> dict[str, str]:
    """The types of the parameters and attributes that a docstring describes, by their names."""
    stated = sections(thing)
    lists = "\n".join(stated.get(title, "") for title in ("Parameters", "Attributes"))
    return {name.strip("*"): kind for names, kind in DESCRIBED.findall(lists) for name in names.split(", ")}


def wrong(thing: Any, name: str, by: dict[str, str]) -> list[str]:
    """What the docstring of a callable leaves out or states wrongly, where `by` is what it describes."""
    found, own = signature(thing), sections(thing)
    known = {p: by.get(p, "") for p in found.parameters if p not in ("self", "cls")}
    lacks = [f"{name}: {p} is not described" for p in known if p not in by]
    lacks += [f"{name}: {p} is no parameter" for p in described(thing) if "Attributes" not in own and p not in known]
    for p, kind in known.items():
        default = found.parameters[p].default
        with suppress(ValueError, SyntaxError):  # an expression, such as Extended()
            stated = literal_eval(kind.partition("default ")[2].replace("inf", "1e999"))
            if stated != default and isinstance(default, str | int | float | tuple):
                lacks.append(f"{name}: {p} has the default {default!r}")
    if (
        isfunction(thing)
        and found.return_annotation not in (None, "None", Signature.empty)
        and not {"Returns", "Yields"} & {*own}
    ):
        lacks.append(f"{name}: no section Returns or Yields")
    return lacks


def methods(thing: Any) -> Iterator[tuple[str, Any]]:
    """The public methods of a class that have a docstring; the name and the class of others say it all."""
    for name, held in vars(thing).items():
        method = getattr(held, "__func__", held)
        own = isfunction(method) and method.__qualname__.startswith(thing.__name__)  # else the default of a field
        if own and method.__doc__ and not name.startswith("_"):
            yield name, method


@pytest.mark.parametrize("name", PUBLIC)
def test_every_parameter_and_result_of_a_public_name_is_described(name: str) -> None:
    thing = PUBLIC[name]
    if isfunction(thing):
        assert not wrong(thing, name, described(thing))
        return
    assert isclass(thing)
    lacks = [one for method, held in methods(thing) for one in wrong(held, f"{name}.{method}", described(held))]
    if not issubclass(thing, BaseException | Enum) and not getattr(thing, "_is_protocol", False):  # which nobody calls
        by = dict(pair for base in reversed(thing.__mro__) for pair in described(base).items())  # inherited settings, too
        lacks += wrong(thing, name, by)
    assert not lacks


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.long) if n.rpartition(".")[2] in LONG else n for n in PUBLIC]
)
def test_the_examples_of_a_public_name_run(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for table in ("_PLANTS", "_DETECTORS"):  # an example may register something
        monkeypatch.setattr(registry, table, dict(getattr(registry, table)))
    thing = PUBLIC[name]
    text = sections(thing).get("Examples", "")
    assert ">>> " in text or re.match(r"\s*See `[\w.]+`", text), "no example"
    found = doctest.DocTestFinder().find(thing, name, module=False, globs={})  # type: ignore[arg-type]
    failures: list[str] = []
    for test in found:
        doctest.DocTestRunner().run(test, out=failures.append)
    assert not failures, "".join(failures)
