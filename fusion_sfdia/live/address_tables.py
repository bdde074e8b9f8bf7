"""What the files of both bridges share: tables [read] and [write] with an address for each sensor and input."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Hashable, Iterable, Mapping
from pathlib import Path
from typing import Any

from fusion_sfdia.common.arguments import number, require_names, require_unique, shown
from fusion_sfdia.logs.columns import Source
from fusion_sfdia.logs.conversion import conversion
from fusion_sfdia.plant.plant import Plant

OF_SENSOR = ("value", "sigma", "verdict", "health")
OF_ALL = ("verdict", "alarm")
ALONE = ("status", "events")  # names outside of the tables that have an address


def load_tables(
    path: str | Path,
    plant: Plant,
    known: Iterable[str],
    seconds: Iterable[str],
    require_source: Callable[[str, Any], None],
    require: Callable[[str, Any], None],
    address: Callable[[Any], tuple[Hashable, ...]],
) -> dict[str, Any]:
    """Read a TOML file with the names `known`, those in `seconds` positive numbers, and the tables read and write.

    read: an address of each input, and of some sensors. write: of some sensors {name of `OF_SENSOR`: address}, and the
    addresses "verdict" and "alarm" of the whole. require_source, require: raise ValueError, beginning with their first
    argument, unless the second states where to read, or is an address. address: of either, equal for equal ones: where it is,
    and what is read there. ValueError for anything else, and where two of these names, or one and one of `ALONE`, have one.
    """
    with Path(path).open("rb") as file:
        try:
            found = tomllib.load(file)
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise ValueError(f"{path} is not TOML: {error}") from error
    require_names(f"{path}:", found, known)
    for name in ("read", "write"):
        if not isinstance(value := found.setdefault(name, {}), dict):
            raise ValueError(f"{path}: {name} is {shown(value)}; expected a table, [{name}]")
    for name in seconds:
        if name in found and not 0 < number(f"{path}: {name}", found[name]) < float("inf"):
            raise ValueError(f"{path}: {name} is {found[name]}; expected a positive number of seconds")
    sensors, inputs, read = plant.sensor_names, tuple(s.name for s in plant.inputs), found["read"]
    require_unique(f"{path}: sensors and inputs of plant {plant.name!r}", [*sensors, *inputs])
    require_names(f"{path}, [read]:", read, [*sensors, *inputs])
    for name, value in read.items():
        require_source(f"{path}, [read]: {name}", value)
    if lacking := [name for name in inputs if name not in read]:
        raise ValueError(f"{path}, [read]: nothing for the inputs {', '.join(lacking)}; the model needs them")
    if not any(name in read for name in sensors):
        raise ValueError(f"{path}, [read]: nothing for a sensor; sensors: {', '.join(sensors)}")
    if given := [name for name in inputs if name in found["write"] and name not in OF_ALL]:
        raise ValueError(f"{path}, [write]: {given[0]} is an input; expected sensors, {', '.join(OF_ALL)}: remove it")
    require_names(f"{path}, [write]:", found["write"], [*sensors, *OF_ALL])
    for name, value in found["write"].items():
        if isinstance(value, dict):
            require_names(f"{path}, [write.{name}]:", value, OF_SENSOR)
            for what, given_address in value.items():
                require(f"{path}, [write.{name}]: {what}", given_address)
        elif name not in OF_ALL:
            raise ValueError(f"{path}, [write]: {name} is {shown(value)}; expected a table of {', '.join(OF_SENSOR)}")
        else:
            require(f"{path}, [write]: {name}", value)
    for name in ALONE:
        if name in found:
            require(f"{path}: {name}", found[name])
    _require_own_addresses(path, plant, found, address)
    return found


def _require_own_addresses(
    path: str | Path, plant: Plant, found: dict[str, Any], address: Callable[[Any], tuple[Hashable, ...]]
) -> None:
    """Raise ValueError where two names have one address: what is written would be read again, or two values be one."""
    known: dict[Hashable, str] = {}
    for name, value in found["read"].items():
        what = f"{'sensor' if name in plant.sensor_names else 'input'} {name}"
        if (other := known.setdefault(at := address(value), what)) != what:
            raise ValueError(
                f"{path}, [read]: {other} and {what} are both read from {_in_words(at)}; give each its own address, or leave "
                "out the sensor that has none"
            )
    read = {at[0]: what for at, what in ((address(value), f"[read] {name}") for name, value in found["read"].items())}
    written = [(f"[write] {name}", value) for name, value in found["write"].items() if not isinstance(value, dict)]
    for name, value in found["write"].items():
        written += [(f"[write.{name}] {what}", at) for what, at in value.items()] if isinstance(value, dict) else []
    for what, value in [*written, *((name, found[name]) for name in ALONE if name in found)]:
        where = address(value)[0]
        if (other := read.get(where) or known.setdefault(("written", where), what)) != what:
            raise ValueError(f"{path}: {other} and {what} both have the address {shown(value)}; give each its own")


def _in_words(address: tuple[Hashable, ...]) -> str:
    where, *what = map(str, address)
    return f"{where!r}" + "".join(f", key {key!r}" for key in what)


def units_of(plant: Plant) -> dict[str, str]:
    """The unit of each sensor and input."""
    return {s.name: s.unit for s in plant.inputs} | {s.name: s.unit for s in plant.sensors}


def columns_of(plant: Plant, read: Mapping[str, tuple[str, str]]) -> tuple[Source, ...]:
    """What is read as columns of a log, by sensor or input: (tag, unit), the unit "" for the plant's."""
    places = [(s.name, i, False) for i, s in enumerate(plant.sensors)] + [(s.name, j, True) for j, s in enumerate(plant.inputs)]
    wanted, found = units_of(plant), []
    for name, position, is_input in places:
        if name in read:
            tag, unit = read[name]
            found.append(Source(tag, name, position, is_input, unit or wanted[name], conversion(unit, wanted[name])))
    return tuple(found)


def require_readers(path: str | Path, names: Iterable[str], reader: Callable[[str, str], object], plant: Plant) -> None:
    """Raise ValueError, which names the file, for a sensor or input whose reader, reader(name, unit), cannot be made."""
    units = units_of(plant)
    try:
        for name in names:
            reader(name, units[name])
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def require_texts(path: str | Path, found: dict[str, Any], names: Iterable[str]) -> None:
    """Raise ValueError for a value of one of these names that is not a text."""
    for name in names:
        if name in found and not isinstance(found[name], str):
            raise ValueError(f"{path}: {name} is {shown(found[name])}; expected a text")


def require_bounds(path: str | Path, found: dict[str, Any]) -> None:
    """Raise ValueError for a max_lead or max_lag that is no number of seconds of at least 0; infinity is one."""
    for name in ("max_lead", "max_lag"):
        if name in found and not number(f"{path}: {name}", found[name]) >= 0:
            raise ValueError(f"{path}: {name} is {found[name]}; expected seconds of at least 0, or inf")


def require_states(where: str, found: dict[str, Any]) -> None:
    """Raise ValueError for states that are no table of finite numbers by text."""
    states = found.get("states", {})
    if not isinstance(states, dict) or not all(
        isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < float("inf")
        for value in states.values()
    ):
        raise ValueError(f"{where}: states is {shown(states)}; expected numbers by text, such as {{ on = 1.0, off = 0.0 }}")
