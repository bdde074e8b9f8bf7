"""Which OPC UA nodes are the sensors and inputs of a plant, and where its verdicts go: the file nodes.toml."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from fusion_sfdia.core.arguments import shown
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.live.tables import load_tables, require_texts

UNCERTAIN = ("use", "missing")


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
    known, seconds = [f.name for f in fields(Nodes)], ("stale", "period", "retry", "timeout")
    found = load_tables(path, plant, known, seconds, _require_node, _require_node, _address)
    require_texts(path, found, ("uncertain", "user", "password", "security"))
    if (given := found.get("uncertain", "use")) not in UNCERTAIN:
        raise ValueError(f"{path}: uncertain is {given!r}; expected {' or '.join(map(repr, UNCERTAIN))}")
    return Nodes(**found)


def _require_node(where: str, value: Any) -> None:
    if not isinstance(value, str) or "=" not in value:
        raise ValueError(f"{where} is {shown(value)}; expected the id of a node, such as 'ns=2;s=TT-101.PV'")


def _address(value: str) -> tuple[str]:
    """The id of a node in one form, "ns=0;i=85" for "i=85"."""
    parts = sorted(part.strip() for part in value.split(";"))
    return (";".join(parts if any(part.startswith("ns") for part in parts) else ["ns=0", *parts]),)
