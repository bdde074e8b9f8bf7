"""The filter whose unknowns stay at the values of commissioning, and what constant causes do to its innovations.

A cause m_h is an offset of sensor h (h = 1..N) or a change of unknown h - N. With e = d(x_true - x) / dm on the augmented state
(`plant.augment`), F, H its Jacobians and K the gain, which is zero for the unknowns,

    e- = F e,    D = d(innovation) / dm = H e- + [I | 0],    e = e- - K D

as in the separated bias filter (Friedland 1969, Treatment of bias in recursive filtering). A cause that has been there for long
has e of the row before; one that began k rows ago has the same recursion from e = 0 at that row. What equations miss may be
corrected by a regression on the predicted states, which have moved by e-, too: with its derivative B the error has D + B e-.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.differentiable import Differentiable
from fusion_sfdia.detectors.detector import ProcessHypothesis
from fusion_sfdia.filters.estimators import UNUSED, Extended, GaussianState
from fusion_sfdia.learning.innovations import held, updated
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.uncertainty import error_of

Array = NDArray[Any]

FRESH = 10  # rows up to which the effect of a cause that has just begun is followed


class Tracked(NamedTuple):
    """The filter between two rows: estimate, effect e (..., a, M) of lasting causes, and those that began up to FRESH rows ago.

    fresh (..., FRESH + 1, a, M), the latest first, and last those that began at the row that `since` has chosen; grown
    (..., FRESH + 1, N, M): the sum of D since they began.
    """

    core: GaussianState
    effect: Array
    fresh: Array
    grown: Array

    def since(self, age: Array, where: Array) -> Tracked:
        """With causes that began so many rows ago (...), 1 to FRESH, followed from now on, in the runs `where` (...)."""

        def chosen(a: Array) -> Array:
            one = np.take_along_axis(a, (age - 1)[..., None, None, None], axis=-3)
            kept = np.where(where[..., None, None, None], one, a[..., FRESH:, :, :])
            return np.concatenate([a[..., :FRESH, :, :], kept], axis=-3)

        return self._replace(fresh=chosen(self.fresh), grown=chosen(self.grown))


class FrozenRow(NamedTuple):
    """What a row shows: innovation v (..., N), NaN where missing, and its variance; D (..., N, M), and that of causes
    that began at a row; state x (..., n), predicted and after the readings, this with its effect (..., n, M); expected readings
    (..., N). lost (...): no finite value.
    """

    innovation: Array
    variance: Array
    by_cause: Array
    by_begun: Array
    x: Array
    x_after: Array
    effect_after: Array
    covariance: Array
    expected: Array
    guarded: Array
    lost: Array
    nis: Array


@dataclass(frozen=True, eq=False)
class FrozenFilter:
    """The extended filter of a plant, N sensors and n states, with its p unknowns at `values` (p,)."""

    plant: Plant
    values: Array
    of_sensors: bool = True  # whether their faults are followed, and causes that have just begun; not while it is commissioned
    along: Array | float = 0.0  # B (N, n): derivative of what is taken from innovations with respect to the predicted states

    @cached_property
    def _is_corrected(self) -> bool:
        return bool(np.any(self.along))

    @cached_property
    def model(self) -> Plant:
        """The augmented plant, at these values, which no reading changes; its disturbances are estimated."""
        model = held(self.plant)
        n, x0 = len(self.plant.states), model.x0.copy()
        x0[n : n + self.values.size] = self.values
        return replace(model, x0=x0)

    @cached_property
    def _stepped(self) -> Plant:
        """That plant, with its step and Jacobian by one call."""
        both = self.model.step_with_jacobian
        return self.model if self.model.jacobians[0] else replace(self.model, step=Differentiable(self.model.step, both))

    @property
    def counts(self) -> tuple[int, int, int]:
        """Sensors N, states of the augmented plant, unknowns p."""
        return len(self.plant.sensors), self.model.x0.size, self.values.size

    @cached_property
    def _begin(self) -> Array:
        """The effect of causes that begin now (a, M): of the unknowns on themselves."""
        count, size, p = self.counts
        n, sensors = len(self.plant.states), count * self.of_sensors
        found = np.zeros((size, sensors + p))
        found[n : n + p, sensors:] = np.eye(p)
        return found

    def start(self, batch: tuple[int, ...]) -> Tracked:
        """At the plant's x0."""
        shape, ages = self._begin.shape, (FRESH + 1) * self.of_sensors
        effect = np.broadcast_to(self._begin, (*batch, *shape)).copy()
        fresh = np.broadcast_to(self._begin, (*batch, ages, *shape)).copy()
        core = Extended().start(self.model, batch, UNUSED)
        return Tracked(core, effect, fresh, np.zeros((*batch, ages, len(self.plant.sensors), shape[-1])))

    def step(self, now: Tracked, t_start: float, dt: float, y: Array, u: Array) -> tuple[Tracked, FrozenRow]:
        """After the readings y (*batch, N) at t_start + dt under u (*batch, m)."""
        count, n = len(self.plant.sensors), len(self.plant.states)
        prior, joint, y, used, half, normal, gain_half, core = updated(self._stepped, now.core, t_start, dt, y, u)
        assert prior.tangent is not None and joint.H is not None
        tangent, readout = prior.tangent, joint.H
        own = np.eye(count, now.effect.shape[-1]) if self.of_sensors else 0.0
        gain = gain_half @ np.swapaxes(half, -1, -2)

        def followed(effect: Array, F: Array, H: Array, K: Array) -> tuple[Array, Array]:
            ahead = F @ effect
            by_cause = H @ ahead + own
            return ahead - K @ by_cause, by_cause + (self.along @ ahead[..., :n, :] if self._is_corrected else 0.0)

        effect, by_cause = followed(now.effect, tangent, readout, gain)
        fresh, grown, by_begun = now.fresh, now.grown, np.zeros_like(by_cause)
        if self.of_sensors:
            fresh, seen = followed(_aged(self._begin, fresh), *(a[..., None, :, :] for a in (tangent, readout, gain)))
            grown, by_begun = _aged(0.0, grown) + seen, seen[..., FRESH, :, :]
        lost = ~np.isfinite(core.x).all(axis=-1) | prior.lost
        nis = np.sum(normal**2, axis=-1) / np.maximum(np.sum(used, axis=-1), 1)
        nis = np.where(used.any(axis=-1), nis, np.nan)
        row = FrozenRow(
            y - joint.y, np.diagonal(joint.S, axis1=-2, axis2=-1), by_cause, by_begun, joint.x[..., :n],
            core.x[..., :n], effect[..., :n, :], core.P[..., :n, :n], joint.y, prior.guarded, lost, nis,
        )  # fmt: skip
        return Tracked(core, effect, fresh, grown), row


def _aged(youngest: Array | float, fresh: Array) -> Array:
    """Of causes (..., FRESH + 1, k, M) a row later: those that began now, up to FRESH rows ago, and at the chosen row."""
    found = fresh.copy()
    found[..., 0, :, :] = youngest
    found[..., 1:FRESH, :, :] = fresh[..., : FRESH - 1, :, :]
    return found


def unknowns(plant: Plant) -> tuple[ProcessHypothesis, ...]:
    """What the plant declares: parameters, then constant errors of inputs, in the order of the augmented states."""
    known = plant.uncertainty
    errors = [s for s in plant.inputs if s.name in known.inputs]
    return (
        *(ProcessHypothesis(p.name, p.unit, "parameter", p.nominal) for p in known.parameters),
        *(ProcessHypothesis(error_of(s.name), s.unit, "input", 0.0) for s in errors),
    )
