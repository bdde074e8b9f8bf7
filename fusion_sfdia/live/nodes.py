"""Which OPC UA nodes are the sensors and inputs of a plant, and where its verdicts go: the file nodes.toml."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from fusion_sfdia.common.arguments import require_names, shown
from fusion_sfdia.live.address_tables import (
    columns_of,
    load_tables,
    require_bounds,
    require_readers,
    require_states,
    require_texts,
)
from fusion_sfdia.live.live_readings import Reader
from fusion_sfdia.live.security import Connection, require_connection, require_security
from fusion_sfdia.live.values import MAX_LAG, MAX_LEAD
from fusion_sfdia.logs.columns import Source
from fusion_sfdia.logs.conversion import conversion
from fusion_sfdia.logs.numbers import Numbers
from fusion_sfdia.plant.plant import Plant

UNCERTAIN = ("use", "missing")


class NodeSource(NamedTuple):
    """A node; unit: of its numbers, "" for the plant's; states: the numbers of texts and of true and false."""

    node: str
    unit: str = ""
    states: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True)
class Nodes(Connection):
    """Nodes by their OPC UA ids, such as "ns=2;s=TT-101.PV", and how they are read.

    read: the node of each sensor and input, or a table of the fields of `NodeSource`. write: of some sensors {"value", "sigma",
    "verdict", "health": node}, and the nodes "verdict" and "alarm" of the whole; health is an Int32 by the enumeration
    DeviceHealth of OPC UA for Devices. status: a node for the verdict of the moment as a
    text, "blind" where no row comes. uncertain: whether values of that quality are used ("use") or "missing". stale: seconds
    by which the source time of a value may be before the newest one; an older one is missing (None: it counts, as servers
    that report changes alone do not renew it). max_lead, max_lag: as in `Values`, of source times that are new. period:
    seconds between two readings of all nodes, None for the plant's dt. retry: seconds between attempts to connect; timeout:
    seconds for an answer. security: "Policy,Mode,certificate,key" of a connection that is signed, or signed and encrypted;
    trusted: a folder of certificates of servers and authorities that are trusted. The rest of the connection: see
    `Connection`.
    """

    read: dict[str, Any]
    write: dict[str, Any] = field(default_factory=dict)
    status: str | None = None
    uncertain: str = "use"
    stale: float | None = None
    max_lead: float = MAX_LEAD
    max_lag: float = MAX_LAG
    period: float | None = None
    retry: float = 5.0
    timeout: float = 4.0
    security: str | None = None
    trusted: str | None = None

    @property
    def sources(self) -> dict[str, NodeSource]:
        """Where the value of each sensor and input comes from."""
        return {name: NodeSource(at) if isinstance(at, str) else NodeSource(**at) for name, at in self.read.items()}

    def columns(self, plant: Plant) -> tuple[Source, ...]:
        """The nodes as columns of a log: the text of an id is the tag, "TT-101.PV" of "ns=2;s=TT-101.PV"."""
        texts = {name: re.search(r"(?:^|;)s=(.+)", source.node) for name, source in self.sources.items()}
        return columns_of(
            plant, {name: (found[1] if found else name, self.sources[name].unit) for name, found in texts.items()}
        )

    def reader(self, name: str, unit: str) -> Reader:
        """How the values of a sensor or an input in this unit are read; ValueError for a unit that does not convert to it."""
        source = self.sources[name]
        return Reader(unit, conversion(source.unit, unit), Numbers(states=source.states))


def load_nodes(path: str | Path, plant: Plant) -> Nodes:
    """Read nodes.toml: the fields of `Nodes`, read and write as tables.

    ValueError for anything else, for unknown names, for an input without a node, and where no sensor has one.
    """
    known, seconds = [f.name for f in fields(Nodes)], ("stale", "period", "retry", "timeout")
    found = load_tables(path, plant, known, seconds, _require_source, _require_node, _address)
    require_texts(path, found, ("uncertain",))
    require_connection(path, found, "security", "trusted")
    require_security(path, found)
    if (given := found.get("uncertain", "use")) not in UNCERTAIN:
        raise ValueError(f"{path}: uncertain is {given!r}; expected {' or '.join(map(repr, UNCERTAIN))}")
    require_bounds(path, found)
    nodes = Nodes(**found)
    require_readers(path, nodes.sources, nodes.reader, plant)
    return nodes


def _require_source(where: str, value: Any) -> None:
    if not isinstance(value, dict):
        return _require_node(where, value)
    require_names(f"{where}:", value, NodeSource._fields)
    if not isinstance(value.get("unit", ""), str):
        raise ValueError(f"{where}: unit is {shown(value['unit'])}; expected a unit, such as 'degC'")
    require_states(where, value)
    _require_node(f"{where}: node", value.get("node"))


def _require_node(where: str, value: Any) -> None:
    if not isinstance(value, str) or "=" not in value:
        raise ValueError(f"{where} is {shown(value)}; expected the id of a node, such as 'ns=2;s=TT-101.PV'")


def _address(value: Any) -> tuple[str]:
    """The id of a node in one form, "ns=0;i=85" for "i=85"."""
    parts = [part.strip() for part in (value if isinstance(value, str) else value["node"]).split(";")]
    parts += [] if any(part.startswith("ns") for part in parts) else ["ns=0"]
    return (";".join(sorted(parts, key=lambda part: not part.startswith("ns"))),)
