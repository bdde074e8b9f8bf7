"""Parameters of power networks: a file with provenance, and a seeded generator for networks of any size.

A network is a TOML file as parameters.toml: the areas' names, a table of values for each constant, the slopes
of the tie lines by the names of their ends ("4-13"), and steps of the load.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import number, require_unique, whole
from fusion_sfdia.plant.network import Topology

Array = NDArray[Any]

NETWORK_FILE = Path(__file__).with_name("parameters.toml")
PROVENANCE = ("paper", "recalled", "derived", "chosen")
UNITS = {  # of an area's constants
    "inertia": "s2/rad",
    "droop": "rad/s",
    "damping": "s/rad",
    "turbine_time": "s",
    "governor_time": "s",
    "angle_limit": "rad",
    "reference_limit": "1",
}
DYNAMIC = tuple(UNITS)[:5]
SLOPE_UNIT = "1/rad"
SPAN = 4  # how far apart in the list generated neighbours may be, at least


class LoadStep(NamedTuple):
    """From `time` (s) on the load of an area is `change` (per unit) more than before."""

    time: float
    area: str
    change: float


@dataclass(frozen=True, eq=False)
class NetworkParameters:
    """The areas of a power network and its tie lines.

    topology: N areas, E ties. constants: (N, 5) inertia H, droop R, damping D, turbine time T_t, governor time T_g, in the
    units of UNITS, of B18, Table I. slope: (E,) P_ij in 1/rad. angle_limit, reference_limit: (N,) largest |dtheta|, |dP_ref|.
    ValueError naming the area or the tie whose value is not positive and finite.
    """

    topology: Topology
    constants: Array
    slope: Array
    angle_limit: Array
    reference_limit: Array

    def __post_init__(self) -> None:
        n, e = len(self.topology.names), len(self.topology.links)
        for what, expected in (("constants", (n, 5)), ("slope", (e,)), ("angle_limit", (n,)), ("reference_limit", (n,))):
            value = np.ascontiguousarray(getattr(self, what), dtype=float)
            object.__setattr__(self, what, value)
            if value.shape != expected:
                raise ValueError(f"{what} of {n} areas with {e} ties has shape {value.shape}; expected {expected}")
            wrong = np.argwhere(~((value > 0) & np.isfinite(value)))
            if wrong.size:
                place = tuple(wrong[0])
                where = "-".join(self.topology.names[i] for i in self.topology.links[place[0]])
                who = f"tie {where}" if what == "slope" else f"area {self.topology.names[place[0]]}"
                kind = DYNAMIC[place[1]] if what == "constants" else what
                raise ValueError(f"{kind} of {who} is {value[place]:g}; expected a positive finite number")

    @cached_property
    def side_slope(self) -> Array:
        """(2E,): the slope of each side's tie, all ties closed."""
        return self.slope[self.topology.link]


def load_network(path: str | Path = NETWORK_FILE) -> NetworkParameters:
    """Read a network's file.

    Raises ValueError naming the file and the entry where it is no TOML, an entry is missing or unknown or lacks value, unit,
    provenance or source, the unit is another, names an unknown area, or the number is outside its valid range.
    """
    document = _document(path)
    names = document["names"]
    if not isinstance(names, list) or not all(isinstance(n, str) and n and "-" not in n for n in names):
        raise ValueError(f"{path}: names is {names!r}; expected the areas' names as texts without a hyphen")
    require_unique(str(path), names)
    table = document["area"]
    if not isinstance(table, Mapping) or set(table) != set(UNITS):
        raise ValueError(f"{path}: area has {', '.join(table)}; expected {', '.join(UNITS)}")
    columns = {}
    for what, unit in UNITS.items():
        given = _entry(f"{path}: area.{what}", table[what], "values", unit)
        if not isinstance(given, list) or len(given) != len(names):
            raise ValueError(f"{path}: area.{what} has the values {given!r}; expected one for each of {len(names)} areas")
        columns[what] = np.array([number(f"{path}: area.{what}", v) for v in given])
    ties = document["tie"]
    pairs = [tuple(tie.split("-")) for tie in ties]
    if any(len(pair) != 2 for pair in pairs):
        raise ValueError(f"{path}: ties are {', '.join(ties)}; expected two areas each, such as 4-13")
    slope = [number(f"{path}: tie {tie}", _entry(f"{path}: tie {tie}", e, "value", SLOPE_UNIT)) for tie, e in ties.items()]
    try:
        return NetworkParameters(
            Topology.joined(names, [(a, b) for a, b in pairs]),
            np.stack([columns[what] for what in DYNAMIC], axis=1),
            np.array(slope),
            columns["angle_limit"],
            columns["reference_limit"],
        )
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def load_steps(scenario: str, path: str | Path = NETWORK_FILE) -> tuple[LoadStep, ...]:
    """The load steps of a scenario ("1" or "2" of B18), in the order of time; ValueError for one that the file lacks."""
    document = _document(path)
    loads = document["loads"]
    if scenario not in loads:
        raise ValueError(f"{path} has no loads {scenario!r}; known: {', '.join(loads)}")
    steps = []
    for provenance, rows in loads[scenario].items():
        if provenance not in PROVENANCE:
            raise ValueError(
                f"{path}: loads.{scenario} has the provenance {provenance!r}; expected one of {', '.join(PROVENANCE)}"
            )
        for row in rows:
            if not isinstance(row, list) or len(row) != 3 or row[1] not in document["names"]:
                raise ValueError(f"{path}: loads.{scenario} has {row!r}; expected [time in s, area, change per unit]")
            time, change = (number(f"{path}: loads.{scenario}", row[i]) for i in (0, 2))
            steps.append(LoadStep(time, row[1], change))
    return tuple(sorted(steps, key=lambda s: s.time))


def _document(path: str | Path) -> dict[str, Any]:
    try:
        document = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is not a TOML file ({error}); write names, [area], [tie] and [loads.NAME]") from error
    if set(document) != {"names", "area", "tie", "loads"}:
        raise ValueError(f"{path} has {', '.join(document)}; a network has names, area, tie and loads")
    return document


def _entry(where: str, entry: Any, key: str, unit: str) -> Any:
    if not isinstance(entry, dict) or set(entry) != {key, "unit", "provenance", "source"}:
        raise ValueError(f"{where} is {entry!r}; expected a table of {key}, unit, provenance, source")
    if entry["unit"] != unit:
        raise ValueError(f"{where} is in {entry['unit']!r}; expected {unit!r}")
    if entry["provenance"] not in PROVENANCE:
        raise ValueError(f"{where} has the provenance {entry['provenance']!r}; expected one of {', '.join(PROVENANCE)}")
    if not isinstance(entry["source"], str) or not entry["source"].strip():
        raise ValueError(f"{where} names no source; state where the number comes from")
    return entry[key]


def generate_network(areas: int, seed: int, degree: float = 34 / 15) -> NetworkParameters:
    """A connected network of N areas with round(N degree / 2) ties, the same for the same seed.

    Ties join areas at most max(4, degree) apart in the list: first each area to one before it, then further pairs. Each
    constant is drawn from the column of B18, Table I; slopes from 2, 3 and 4 per rad. ValueError for less than 2 areas, or a
    mean degree with which they are not connected or that their number does not allow.
    """
    n = whole("areas", areas, 2)
    if not np.isfinite(number("degree", degree)):
        raise ValueError(f"degree is {degree}; expected the mean number of ties of an area")
    ties = round(n * degree / 2)
    if not n - 1 <= ties <= n * (n - 1) // 2:
        raise ValueError(
            f"a mean degree of {degree:g} gives {n} areas {ties} ties; expected {n - 1} to {n * (n - 1) // 2}: a degree "
            f"from {2 * (n - 1) / n:g} to {n - 1}"
        )
    rng = np.random.default_rng(np.random.SeedSequence(whole("seed", seed, 0)))
    span = min(n - 1, max(SPAN, int(np.ceil(degree))))
    child = np.arange(1, n)
    tree = np.stack([child - rng.integers(1, np.minimum(child, span) + 1), child], axis=1)
    pairs = np.concatenate([np.stack([np.arange(n - k), np.arange(k, n)], axis=1) for k in range(1, span + 1)])
    others = pairs[~np.isin(pairs @ np.array([n, 1]), tree @ np.array([n, 1]))]
    links = np.concatenate([tree, others[rng.choice(len(others), ties - len(tree), replace=False)]])
    paper = load_network()
    chosen = rng.integers(len(paper.constants), size=(n, 6))
    return NetworkParameters(
        Topology(tuple(str(i) for i in range(1, n + 1)), links),
        np.take_along_axis(paper.constants, chosen[:, :5], axis=0),
        rng.choice([2.0, 3.0, 4.0], size=ties),
        paper.angle_limit[chosen[:, 5]],
        paper.reference_limit[chosen[:, 5]],
    )
