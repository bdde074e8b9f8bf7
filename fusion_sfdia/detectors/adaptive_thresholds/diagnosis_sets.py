"""Which sets of sensor faults explain the decisions of monitoring modules (Kougiatsos 2024, sec. V, (16)-(18)).

A set of faults is a diagnosis when

1. it is consistent: every row that fired has an entry 1 or * among the faults, and no row that has not fired has an entry 1
   among them (a row that has not fired exonerates by 1, never by *). Rows are the modules and the agents; an agent fires when
   any of its modules does;
2. it has no unsupported fault: each fault has an entry 1 or * in a module that fired. There is no evidence of other faults.

The diagnosis set is empty without a detection, and also where no consistent set exists (`explained` distinguishes the two).
S^F, the isolated sensors, are the members of all diagnoses. All agents are intersected at once, as in (18).

The sets printed with the paper's scenario are these sets with at most one fault for each agent. The paper does not state this
restriction, which would exclude two faults in one agent; S^F is the same. Two textbook alternatives fail on that scenario.
Minimal sets lose the torque sensor, which is faulty, once a third fault explains its detection. Consistent sets with
unsupported faults isolate 8 of 10 sensors; no module that fired reads two of them. Exoneration lasts until the row fires: with
latched decisions sensors are only added, as long as the pattern is explained.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import argument_names
from fusion_sfdia.detectors.adaptive_thresholds.signatures import (
    Agent,
    SignatureMatrix,
    combinations,
    global_signatures,
    local_signatures,
    masks,
    members,
    sensors_read,
)
from fusion_sfdia.plant.modules import Modules
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

TABLE = 16  # largest number of modules for which the results of all patterns are stored


def latched(decisions: Array, axis: int = 0) -> Array:
    """Return latched decisions, along the axis of time: D = 1 for t >= T_D (Kougiatsos 2024, (16))."""
    return np.logical_or.accumulate(decisions, axis=axis)


@dataclass(frozen=True, eq=False)
class DiagnosisLogic:
    """The combinatorial decision logic over local signatures and, where agents are given, global signatures.

    Without agents, the sensors of an agent that has not fired are not exonerated (see signatures.global_signatures): more
    sensors stay isolated, and a fault that shows only in other agents is not excluded.

    decisions are (..., M) bool, modules in the order of `local.rows`; any leading axes, seeds or time.
    """

    local: SignatureMatrix
    agents: Mapping[str, Agent] | None = None

    def isolated(self, decisions: Array) -> Array:
        """Return S^F, the sensors in some diagnosis, (..., N) bool."""
        given = self._checked(decisions)
        if len(self.local.rows) <= TABLE:
            return self._table[0].take(given @ self._place, axis=0)
        return self._answers(given)[0]

    def explained(self, decisions: Array) -> Array:
        """Return whether some set of faults, the empty one included, is consistent with the decisions, (...) bool."""
        return self._answers(self._checked(decisions))[1]

    def consistent(self, decisions: Array, faults: Array) -> Array:
        """Return whether sets of faults, masks (...), are consistent with decisions (..., M), also with unsupported faults.

        Leading axes are broadcast.
        """
        fired = self._fired(self._checked(decisions))
        possible, certain = zip(*(matrix.columns(faults) for matrix in self._matrices), strict=True)
        allowed = np.where(fired, np.concatenate(possible, axis=-1), ~np.concatenate(certain, axis=-1))
        return np.asarray(allowed.all(axis=-1))

    def diagnoses(self, decisions: Array) -> tuple[frozenset[str], ...]:
        """Return the diagnosis set of one pattern (M,), the smallest sets of faults first."""
        if np.ndim(decisions) != 1:
            raise ValueError(f"decisions have shape {np.shape(decisions)}; expected one pattern (M,)")
        isolated = np.flatnonzero(self.isolated(decisions))
        if not isolated.size:
            return ()
        chosen = members(combinations(isolated.size), isolated.size)
        faults = np.zeros((len(chosen), len(self.local.sensors)), bool)
        faults[:, isolated] = chosen
        faults = faults[self.consistent(decisions, masks(faults))]
        return tuple(
            frozenset(self.local.sensors[j] for j in np.flatnonzero(row))
            for row in faults[np.argsort(faults.sum(axis=-1), kind="stable")]
        )

    @cached_property
    def _matrices(self) -> tuple[SignatureMatrix, ...]:
        return (self.local,) if self.agents is None else (self.local, global_signatures(self.local, self.agents))

    @cached_property
    def _membership(self) -> Array:
        """Return (agents, M) bool: the modules of each agent."""
        agents = (self.agents or {}).values()
        return np.array([[m in agent.modules for m in self.local.rows] for agent in agents], bool).reshape(
            -1, len(self.local.rows)
        )

    def _fired(self, decisions: Array) -> Array:
        """Return the decisions of modules and agents (..., R)."""
        agents = (decisions[..., None, :] & self._membership).any(axis=-1)
        return np.concatenate([decisions, agents], axis=-1)

    def _diagnose(self, decisions: Array) -> tuple[Array, Array]:
        """Return isolated (P, N) and explained (P,) of patterns (P, M)."""
        fired = self._fired(decisions)
        possible = np.concatenate([matrix.possible_masks for matrix in self._matrices])
        certain = np.concatenate([matrix.certain_masks for matrix in self._matrices])
        exonerated = np.bitwise_or.reduce(np.where(fired, np.uint64(0), certain), axis=-1)
        seen = np.bitwise_or.reduce(np.where(decisions, self.local.possible_masks, np.uint64(0)), axis=-1)
        candidates = seen & ~exonerated
        explained = (~fired | ((candidates[:, None] & possible) != 0)).all(axis=-1)
        return members(candidates, len(self.local.sensors)) & explained[:, None], explained

    @cached_property
    def _table(self) -> tuple[Array, Array]:
        """Return isolated (2^M, N) and explained (2^M,) of all patterns."""
        count = len(self.local.rows)
        return self._diagnose(members(np.arange(2**count, dtype=np.uint64), count))

    @cached_property
    def _place(self) -> Array:
        """Return 2^m (M,), whose product with a pattern is the row in the table."""
        return 2 ** np.arange(len(self.local.rows))

    def _checked(self, decisions: Array) -> Array:
        given, modules = np.asarray(decisions), self.local.rows
        if given.dtype != bool or given.shape[-1:] != (len(modules),):
            raise ValueError(
                f"decisions are {given.dtype} {given.shape}; expected bool (..., {len(modules)}), modules {', '.join(modules)}"
            )
        return given

    def _answers(self, decisions: Array) -> tuple[Array, Array]:
        """Return isolated (..., N) and explained (...)."""
        patterns = masks(decisions)
        if len(self.local.rows) <= TABLE:
            isolated, explained = self._table
            return isolated[patterns], explained[patterns]
        distinct, which = np.unique(patterns, return_inverse=True)
        isolated, explained = self._diagnose(members(distinct, len(self.local.rows)))
        which = which.reshape(patterns.shape)
        return isolated[which], explained[which]


def module_logic(plant: Plant, modules: Modules, *, agents: bool = True) -> DiagnosisLogic:
    """Return the logic of a plant's modules, in the order of its sensors; an agent has the modules of one owner.

    Signatures come from the arguments of the equations: 1 for an observer's own sensor, * for other sensors it reads.
    """
    sensor = {s.measures: s.name for s in plant.sensors}
    arguments = {modules.names[s.measures]: (s.measures, *argument_names(modules.equations[s.measures])) for s in plant.sensors}
    reads = sensors_read(arguments, sensor, known=(*modules.inputs, "c"))
    local = local_signatures(reads, {modules.names[v]: (sensor[v],) for v in modules.states}, plant.sensor_names)
    if not agents:
        return DiagnosisLogic(local)
    owned = {owner: [s for s in plant.sensors if s.owner == owner] for owner in dict.fromkeys(s.owner for s in plant.sensors)}
    parts = {o: Agent(tuple(modules.names[s.measures] for s in own), tuple(s.name for s in own)) for o, own in owned.items()}
    return DiagnosisLogic(local, parts)
