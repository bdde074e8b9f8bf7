"""What the files of both bridges share: tables [read] and [write] with an address for each sensor and input."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from fusion_sfdia.core.arguments import number, shown
from fusion_sfdia.core.plant import Plant

OF_SENSOR = ("value", "sigma", "verdict")
OF_ALL = ("verdict", "alarm")


def load_tables(
    path: str | Path, plant: Plant, known: Iterable[str], seconds: Iterable[str], require: Callable[[str, Any], None]
) -> dict[str, Any]:
    """Read a TOML file with the names `known`, those in `seconds` positive numbers, and the tables read and write.

    read: an address of each input, and of some sensors. write: of some sensors {"value", "sigma", "verdict": address}, and
    the addresses "verdict" and "alarm" of the whole. require: raises ValueError, beginning with its first argument, unless the
    second is an address. ValueError for anything else.
    """
    with Path(path).open("rb") as file:
        try:
            found = tomllib.load(file)
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise ValueError(f"{path} is not TOML: {error}") from error
    require_known(f"{path}:", found, known)
    for name in ("read", "write"):
        if not isinstance(value := found.setdefault(name, {}), dict):
            raise ValueError(f"{path}: {name} is {shown(value)}; expected a table, [{name}]")
    for name in seconds:
        if name in found and not 0 < number(f"{path}: {name}", found[name]) < float("inf"):
            raise ValueError(f"{path}: {name} is {found[name]}; expected a positive number of seconds")
    sensors, inputs, read = plant.sensor_names, tuple(s.name for s in plant.inputs), found["read"]
    require_known(f"{path}, [read]:", read, [*sensors, *inputs])
    for name, value in read.items():
        require(f"{path}, [read]: {name}", value)
    if lacking := [name for name in inputs if name not in read]:
        raise ValueError(f"{path}, [read]: nothing for the inputs {', '.join(lacking)}; the model needs them")
    if not any(name in read for name in sensors):
        raise ValueError(f"{path}, [read]: nothing for a sensor; sensors: {', '.join(sensors)}")
    require_known(f"{path}, [write]:", found["write"], [*sensors, *OF_ALL])
    for name, value in found["write"].items():
        if isinstance(value, dict):
            require_known(f"{path}, [write.{name}]:", value, OF_SENSOR)
            for what, address in value.items():
                require(f"{path}, [write.{name}]: {what}", address)
        elif name not in OF_ALL:
            raise ValueError(f"{path}, [write]: {name} is {shown(value)}; expected a table of {', '.join(OF_SENSOR)}")
        else:
            require(f"{path}, [write]: {name}", value)
    return found


def require_known(where: str, found: Iterable[str], known: Iterable[str]) -> None:
    """Raise ValueError for a name that is not known."""
    if unknown := [name for name in found if name not in (known := tuple(known))]:
        raise ValueError(f"{where} unknown name {unknown[0]!r}; known: {', '.join(known)}")


def require_texts(path: str | Path, found: dict[str, Any], names: Iterable[str]) -> None:
    """Raise ValueError for a value of one of these names that is not a text."""
    for name in names:
        if name in found and not isinstance(found[name], str):
            raise ValueError(f"{path}: {name} is {shown(found[name])}; expected a text")
