"""Fault signature matrices: which residuals each sensor fault affects, derived from the sensors that each residual reads.

Rows are residuals (monitoring modules or agents), columns are sensor faults. An entry is 0 where the residual does not depend
on the sensor, 1 where the residual must exceed its threshold and * where it may (Kougiatsos 2024, sec. V and Tables I-IV). An
entry * is for a fault that may be too small for the threshold, masked, delayed, or attenuated by its propagation through other
agents. A set of faults is a bit mask; bit j is the j-th sensor.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

WIDTH = 64  # number of bits of a mask


class Agent(NamedTuple):
    """A monitoring agent: its modules and the sensors of its own subsystem."""

    modules: tuple[str, ...]
    sensors: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class SignatureMatrix:
    """Entries of R rows, N sensors as two relations (R, N) bool: possible where an entry is not 0, certain where it is 1."""

    rows: tuple[str, ...]
    sensors: tuple[str, ...]
    possible: Array
    certain: Array

    def __post_init__(self) -> None:
        for kind, names in (("rows", self.rows), ("sensors", self.sensors)):
            if not 0 < len(names) <= WIDTH:
                raise ValueError(f"{len(names)} {kind}; expected 1 to {WIDTH}: split the system into several matrices")
            if len(set(names)) < len(names):
                raise ValueError(f"{kind} {names} repeat a name; give unique names")
        shape = (len(self.rows), len(self.sensors))
        for field, relation in (("possible", self.possible), ("certain", self.certain)):
            if relation.shape != shape or relation.dtype != bool:
                raise ValueError(f"{field} is {relation.dtype} {relation.shape}; expected bool {shape}: rows, then sensors")
        if np.any(self.certain & ~self.possible):
            raise ValueError("an entry is certain but not possible; a certain entry must be possible, too")
        if blind := [self.rows[i] for i in np.flatnonzero(~self.possible.any(axis=1))]:
            raise ValueError(
                f"{', '.join(blind)}: no sensor, so no fault explains a detection; give a sensor or remove the row"
            )

    def __str__(self) -> str:
        table = [["", *self.sensors]] + [[row, *self.entries[row].values()] for row in self.rows]
        wide = [max(len(line[i]) for line in table) for i in range(len(table[0]))]
        return "\n".join("  ".join(cell.ljust(w) for cell, w in zip(line, wide, strict=True)).rstrip() for line in table)

    @cached_property
    def entries(self) -> dict[str, dict[str, str]]:
        """{row: {sensor: "0", "1" or "*"}}."""
        symbols = np.where(self.certain, "1", np.where(self.possible, "*", "0")).tolist()
        return {row: dict(zip(self.sensors, line, strict=True)) for row, line in zip(self.rows, symbols, strict=True)}

    @cached_property
    def possible_masks(self) -> Array:
        """Sensors whose entry is not 0, a mask for each row (R,) uint64."""
        return masks(self.possible)

    @cached_property
    def certain_masks(self) -> Array:
        """Sensors whose entry is 1, a mask for each row (R,) uint64."""
        return masks(self.certain)

    def columns(self, faults: Array) -> tuple[Array, Array]:
        """Return the entries of sets of simultaneous faults, masks (...), as (possible, certain), each (..., R).

        An entry is 1 where a fault of the set has a 1, else * where one has a *, else 0. Kougiatsos 2024, sec. VII, calls it a
        conjunction; the diagnosis sets of the paper need the disjunction, since two faults that affect different modules
        explain both detections. Cancellation of two faults in a residual is neglected, as in the paper.
        """
        sets = np.asarray(faults, np.uint64)[..., None]
        return (sets & self.possible_masks) != 0, (sets & self.certain_masks) != 0


def masks(chosen: Array) -> Array:
    """Return (...) uint64 of chosen (..., n) bool, n at most 64: bit j is chosen[..., j]."""
    packed = np.packbits(chosen, axis=-1, bitorder="little")
    whole = np.zeros((*packed.shape[:-1], WIDTH // 8), np.uint8)
    whole[..., : packed.shape[-1]] = packed
    return whole.view("<u8")[..., 0].astype(np.uint64, copy=False)


def members(mask: Array, n: int) -> Array:
    """Return (..., n) bool of masks (...) uint64, the inverse of masks."""
    return ((mask[..., None] >> np.arange(n, dtype=np.uint64)) & np.uint64(1)).astype(bool)


def combinations(n: int) -> Array:
    """Return the masks of all non-empty sets of n sensors (2^n - 1,), n at most 20."""
    if n > 20:
        raise ValueError(f"{n} sensors have {2**n - 1} combinations; expected at most 20 sensors")
    return np.arange(1, 2**n, dtype=np.uint64)


def signature_matrix(entries: Mapping[str, Mapping[str, str]], sensors: Sequence[str]) -> SignatureMatrix:
    """Return the matrix of {row: {sensor: "1", "*" or "0"}}; entries not given are 0.

    Raises ValueError for unknown sensors and symbols, and for a row without a sensor.
    """
    known = set(sensors)
    for row, line in entries.items():
        if unknown := sorted(set(line) - known):
            raise ValueError(f"{row} has {', '.join(unknown)}; the sensors are {', '.join(sensors)}")
        if wrong := sorted(set(line.values()) - {"0", "1", "*"}):
            raise ValueError(f"{row} has the entries {wrong}; expected '0', '1' or '*'")
    table = np.array([[line.get(s, "0") for s in sensors] for line in entries.values()], str).reshape(-1, len(sensors))
    return SignatureMatrix(tuple(entries), tuple(sensors), table != "0", table == "1")


def local_signatures(
    reads: Mapping[str, Collection[str]], certain: Mapping[str, Collection[str]], sensors: Sequence[str]
) -> SignatureMatrix:
    """Return the stacked matrices F^(I) of all agents: 1 for the certain sensors of a module, * for the other sensors it reads.

    reads, certain: {module: sensors}. Kougiatsos 2024, Tables II and III, has a 1 for the sensor with which an observer
    corrects its state, and * elsewhere. Kougiatsos 2022, Tables 1 and 2, has a 1 for all local sensors of an observer. Raises
    ValueError where a module does not read one of its certain sensors.
    """
    for module, names in certain.items():
        if extra := sorted(set(names) - set(reads.get(module, ()))):
            raise ValueError(f"certain[{module!r}] has {', '.join(extra)}, which {module} does not read; add it to reads")
    symbols = {module: {s: "1" if s in certain.get(module, ()) else "*" for s in read} for module, read in reads.items()}
    return signature_matrix(symbols, sensors)


def global_signatures(local: SignatureMatrix, agents: Mapping[str, Agent]) -> SignatureMatrix:
    """Return the matrix F^chi of agents: 1 for an agent's own sensors, * for other sensors that its modules read, else 0.

    Kougiatsos 2024, sec. V-B and Table IV. It claims more than the local matrices: a fault with only * in the modules of its
    own agent must be detected by one of them. Raises ValueError unless each module and each sensor belongs to exactly one
    agent.
    """
    for kind, expected, assigned in (
        ("modules", local.rows, [m for agent in agents.values() for m in agent.modules]),
        ("sensors", local.sensors, [s for agent in agents.values() for s in agent.sensors]),
    ):
        if sorted(assigned) != sorted(expected):
            raise ValueError(f"agents have the {kind} {sorted(assigned)}; expected each of {sorted(expected)} once")
    symbols = {
        name: {
            s: "1" if s in agent.sensors else "*" for m in agent.modules for s in local.sensors if local.entries[m][s] != "0"
        }
        | dict.fromkeys(agent.sensors, "1")
        for name, agent in agents.items()
    }
    return signature_matrix(symbols, local.sensors)


def sensors_read(
    variables: Mapping[str, Iterable[str]],
    sensor_of: Mapping[str, str],
    computed: Mapping[str, Iterable[str]] | None = None,
    known: Collection[str] = (),
) -> dict[str, frozenset[str]]:
    """Return the sensors that each residual reads, {module: sensors}.

    variables: {module: variables of its residual}, the variable that it checks and the arguments of its prediction
    (equation.argument_names). sensor_of: {measured variable: its sensor}. computed: {variable that is computed, not measured:
    its arguments}; it takes precedence, so that a prediction may replace a reading. known: inputs and parameters, which no
    sensor reads. Raises ValueError for a name that is none of these, and for a cycle among the computed variables.
    """
    given = {name: tuple(arguments) for name, arguments in (computed or {}).items()}

    def resolve(name: str, above: tuple[str, ...]) -> frozenset[str]:
        if name in above:
            raise ValueError(f"computed has a cycle: {' <- '.join((*above[above.index(name) :], name))}; measure one of them")
        if name in given:
            return frozenset().union(*(resolve(argument, (*above, name)) for argument in given[name]))
        if name in sensor_of:
            return frozenset((sensor_of[name],))
        if name in known:
            return frozenset()
        raise ValueError(f"{name} has no sensor; add it to sensor_of, to computed or to known (inputs and parameters)")

    return {module: frozenset().union(*(resolve(name, ()) for name in names)) for module, names in variables.items()}
