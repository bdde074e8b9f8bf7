"""Which states the readings determine along the usual operation, and which sensors they cannot miss.

With F and H of each step along the operation, the readings of K samples depend on the initial state by the rows R^-1/2 H Phi,
Phi the product of F so far (observability matrix; Kalman 1960), here in units of D = diag(state_scale). A singular value s
means that the readings know that combination of states to 1/s of its scale; below rounding of the largest they do not.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.learning.inspection.plant_findings import REMARK, PlantFinding
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.redundancy import Redundancy, redundancy

Array = NDArray[Any]

SAMPLES = 60
EARLY, FORGOTTEN = 3, 0.01  # samples after which so little is left of what the model forgets at once
PART = 0.3  # of the largest entry of a direction: a state with more belongs to it


class Observability(NamedTuple):
    """rank: how many of n directions the readings determine, or the model forgets within 3 samples (states that inputs set).

    condition: largest over smallest singular value of those that readings determine. unseen: states in the other directions.
    needed: sensor and the states that are not determined without it. redundancy: how many sensors may fail together, and why.
    """

    rank: int
    states: int
    samples: int
    condition: float
    unseen: tuple[str, ...]
    needed: tuple[tuple[str, tuple[str, ...]], ...]
    redundancy: Redundancy


def observability(plant: Plant, samples: int = SAMPLES) -> Observability:
    """The observability of the states from all sensors, and from all but one."""
    scale, n = plant.state_scale, len(plant.states)
    x, Phi, rows = plant.x0, np.eye(n), []
    early = Phi
    for k in range(samples):
        t, u = k * plant.dt, plant.input_at(k * plant.dt)
        F = plant.step_jacobian_at(t, x, u, plant.dt) * scale / scale[:, None]
        Phi = F @ Phi
        x = plant.guard(plant.step(t, x, u, plant.dt))[0]
        early = Phi if k < EARLY else early
        rows.append(plant.output_jacobian_at(t + plant.dt, x, u) * scale / plant.sensor_sigma[:, None] @ Phi)
    each = np.stack(rows, axis=1)  # (N, K, n)
    compact = np.asarray(np.linalg.qr(each, mode="r"))  # (N, min(K, n), n)
    values, directions = _singular(compact)
    least = np.finfo(float).eps * samples * max(len(compact), n) * values[0]
    rank = int(np.sum(values > least))
    unseen = directions[rank:][np.linalg.norm(directions[rank:] @ early.T, axis=-1) > FORGOTTEN]
    needed = []
    for i, name in enumerate(plant.sensor_names):
        kept, lost = _singular(np.delete(compact, i, axis=0))
        if (left := int(np.sum(kept > least))) < rank:
            needed.append((name, _named(plant, lost[left:rank])))
    condition = float(values[0] / values[rank - 1]) if rank else np.inf
    return Observability(n - len(unseen), n, samples, condition, _named(plant, unseen), tuple(needed), redundancy(plant))


def _singular(rows: Array) -> tuple[Array, Array]:
    """Singular values (n,), zeros where rows are fewer, and the directions (n, n) as rows."""
    n = rows.shape[-1]
    flat = np.concatenate([rows.reshape(-1, n), np.zeros((n, n))])
    _, values, directions = np.linalg.svd(flat, full_matrices=False)
    return values, directions


def _named(plant: Plant, directions: Array) -> tuple[str, ...]:
    """The states that have a large part in some of the directions."""
    size = np.abs(directions)
    large = np.any(size > PART * np.max(size, axis=-1, initial=0.0, keepdims=True), axis=0) if len(size) else []
    return tuple(plant.states[i].name for i in np.flatnonzero(large))


def of_readings(plant: Plant, found: Observability) -> Iterator[PlantFinding]:
    """What to know about states and redundancy."""
    if found.rank < found.states:
        yield PlantFinding(
            REMARK,
            "observability",
            f"{found.states - found.rank} of {found.states} states are not determined by any reading: "
            f"{', '.join(found.unseen)}; their estimates are predictions: add a sensor, or leave them out",
        )
    for name, states in found.needed:
        those = ", ".join(states)
        yield PlantFinding(
            REMARK,
            name,
            f"only this sensor determines {those}: the figures on its faults take the plant as modelled; a change of the plant "
            f"that moves {those} cannot be told from a fault of this sensor, so add one where the plant may change",
        )
    of = found.redundancy
    count = len(plant.sensors)
    if of.faults < max(count // 2, 1) or count < 3:
        yield PlantFinding(
            REMARK,
            "redundancy",
            f"{of.faults} of {count} sensors may be isolated at once: {of.reason}; detectors that exclude sensors stop there "
            "and report a further one as capped; max_faults of the detector changes it",
        )
