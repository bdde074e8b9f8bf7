"""Which states the readings determine along the usual operation, and which sensors they cannot miss.

With F and H of each step along the operation, the readings of K samples depend on the initial state by the rows R^-1/2 H Phi,
Phi the product of F so far (observability matrix; Kalman 1960), here in units of D = diag(state_scale). A singular value s
means that the readings know that combination of states to 1/s of its scale; below rounding of the largest they do not.

Of the decomposition U S V' of these rows, U has a block of rows U_i of each sensor. A direction z = V S^-1 w with |w| = 1 that
no other sensor shows has |U_i w| = 1: the singular vectors of U_i with that value are all that the sensor alone may show.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.learning.inspection.plant_findings import REMARK, PlantFinding
from fusion_sfdia.plant.augment import augment
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.redundancy import Redundancy, redundancy

Array = NDArray[Any]

SAMPLES = 60
MOST_ROWS = 20_000  # of all samples, of many sensors, but twice as many as there are states
ALONE = 1 - 1e-8  # square of a singular value of U_i, above which a direction may be the sensor's alone
EARLY, FORGOTTEN = 3, 0.01  # samples after which so little is left of what the model forgets at once
PART = 0.3  # of the largest part that a state has in some directions: a state with more belongs to them


class Observability(NamedTuple):
    """rank: how many of n directions the readings determine, or the model forgets within 3 samples (states that inputs set).

    condition: largest over smallest singular value of those that readings determine. unseen: states in the other directions.
    needed: sensor and the states that are not determined without it. redundancy: how many sensors may fail together, and why;
    learning: the same where the declared unknowns have to be learnt from the readings, too.
    """

    rank: int
    states: int
    samples: int
    condition: float
    unseen: tuple[str, ...]
    needed: tuple[tuple[str, tuple[str, ...]], ...]
    redundancy: Redundancy
    learning: Redundancy


def observability(plant: Plant) -> Observability:
    """The observability of the states from all sensors, and from all but one."""
    scale, n, N = plant.state_scale, len(plant.states), len(plant.sensors)
    samples = max(min(SAMPLES, MOST_ROWS // N), -(-2 * n // N), EARLY)
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
    if samples > n:
        each = np.asarray(np.linalg.qr(each, mode="r"))  # (N, n, n)
    flat = each.reshape(-1, n)
    more = np.zeros((max(n - len(flat), 0), n))  # for as many directions as states
    U, values, directions = np.linalg.svd(np.concatenate([flat, more]), full_matrices=False)
    least = np.finfo(float).eps * samples * max(N, n) * values[0]
    rank = int(np.sum(values > least))
    unseen = directions[rank:][np.linalg.norm(directions[rank:] @ early.T, axis=-1) > FORGOTTEN]
    of_each = U[: len(flat), :rank].reshape(N, -1, rank)
    needed = []
    for i, name in enumerate(plant.sensor_names):
        alone = _alone(of_each, i, values[:rank], least)
        if len(alone):
            needed.append((name, _named(plant, alone @ directions[:rank])))
    condition = float(values[0] / values[rank - 1]) if rank else np.inf
    known, larger = redundancy(plant), augment(plant)
    learning = known if len(larger.states) == n else redundancy(larger)
    return Observability(n - len(unseen), n, samples, condition, _named(plant, unseen), tuple(needed), known, learning)


def _alone(U: Array, i: int, values: Array, least: float) -> Array:
    """The directions (.., r) that sensor i alone shows, along the r singular vectors of all; U (N, k, r)."""
    if np.sum(U[i] ** 2) < ALONE:
        return np.zeros((0, len(values)))
    _, shown, w = np.linalg.svd(U[i], full_matrices=False)
    w = w[shown**2 >= ALONE]
    if not len(w):
        return w
    by_each = U @ w.T  # (N, k, ..)
    by_each[i] = 0.0
    z = w / values
    return np.asarray(z[np.linalg.norm(by_each, axis=(0, 1)) <= least * np.linalg.norm(z, axis=-1)])


def _named(plant: Plant, directions: Array) -> tuple[str, ...]:
    """The states that have a large part in what some directions (.., n) span."""
    basis = np.linalg.qr(directions.T)[0]
    size = np.linalg.norm(basis, axis=-1)
    return tuple(plant.states[i].name for i in np.flatnonzero(size > PART * np.max(size, initial=0.0)))


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
