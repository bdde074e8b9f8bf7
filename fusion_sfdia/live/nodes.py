"""Which OPC UA nodes are the sensors and inputs of a plant, and where its verdicts go: the file nodes.toml."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from fusion_sfdia.core.arguments import number, shown
from fusion_sfdia.core.plant import Plant

UNCERTAIN = ("use", "missing")
OF_SENSOR = ("value", "sigma", "verdict")
OF_ALL = ("verdict", "alarm")


@dataclass(frozen=True)
class Nodes:
    """Nodes by their OPC UA ids, such as "ns=2;s=TT-101.PV", and how they are read.

    read: the node of each sensor and input, in the plant's units. write: of some sensors {"value", "sigma", "verdict": node},
    and the nodes "verdict" and "alarm" of the whole. uncertain: whether values of that quality are used ("use") or "missing".
    stale: seconds by which the source time of a value may be before the newest one; an older one is missing (None: it counts,
    as servers that report changes alone do not renew it). period: seconds between two readings of all nodes, None for the
    plant's dt. retry: seconds between attempts to connect; timeout: seconds for an answer. user, password, security (asyncua's
    "Policy,Mode,certificate,key[,server certificate]"): of the connection.
    """

    read: dict[str, str]
    write: dict[str, Any] = field(default_factory=dict)
    uncertain: str = "use"
    stale: float | None = None
    period: float | None = None
    retry: float = 5.0
    timeout: float = 4.0
    user: str | None = None
    password: str | None = None
    security: str | None = None


def load_nodes(path: str | Path, plant: Plant) -> Nodes:
    """Read nodes.toml: the fields of `Nodes`, read and write as tables.

    ValueError for anything else, for unknown names, for an input without a node, and where no sensor has one.
    """
    with Path(path).open("rb") as file:
        try:
            found = tomllib.load(file)
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise ValueError(f"{path} is not TOML: {error}") from error
    sensors, inputs = plant.sensor_names, tuple(s.name for s in plant.inputs)
    _require_known(f"{path}:", found, [f.name for f in fields(Nodes)])
    for name, value in found.items():
        if name in ("read", "write"):
            if not isinstance(value, dict):
                raise ValueError(f"{path}: {name} is {shown(value)}; expected a table, [{name}]")
        elif name in ("stale", "period", "retry", "timeout"):
            if not 0 < number(f"{path}: {name}", value) < float("inf"):
                raise ValueError(f"{path}: {name} is {value}; expected a positive number of seconds")
        elif not isinstance(value, str):
            raise ValueError(f"{path}: {name} is {shown(value)}; expected a text")
    if (given := found.get("uncertain", "use")) not in UNCERTAIN:
        raise ValueError(f"{path}: uncertain is {given!r}; expected {' or '.join(map(repr, UNCERTAIN))}")
    read = found.get("read", {})
    _require_known(f"{path}, [read]:", read, [*sensors, *inputs])
    _require_ids(f"{path}, [read]:", read)
    if lacking := [name for name in inputs if name not in read]:
        raise ValueError(f"{path}, [read]: no node of the inputs {', '.join(lacking)}; the model needs them")
    if not any(name in read for name in sensors):
        raise ValueError(f"{path}, [read]: no node of a sensor; sensors: {', '.join(sensors)}")
    write = found.get("write", {})
    _require_known(f"{path}, [write]:", write, [*sensors, *OF_ALL])
    for name, value in write.items():
        if isinstance(value, dict):
            _require_known(f"{path}, [write.{name}]:", value, OF_SENSOR)
            _require_ids(f"{path}, [write.{name}]:", value)
        elif name not in OF_ALL:
            raise ValueError(f"{path}, [write]: {name} is {shown(value)}; expected a table of {', '.join(OF_SENSOR)}")
        else:
            _require_ids(f"{path}, [write]:", {name: value})
    return Nodes(**found)


def _require_known(where: str, found: dict[str, Any], known: Any) -> None:
    if unknown := [name for name in found if name not in known]:
        raise ValueError(f"{where} unknown name {unknown[0]!r}; known: {', '.join(known)}")


def _require_ids(where: str, found: dict[str, Any]) -> None:
    for name, value in found.items():
        if not isinstance(value, str) or "=" not in value:
            raise ValueError(f"{where} {name} is {shown(value)}; expected the id of a node, such as 'ns=2;s=TT-101.PV'")
