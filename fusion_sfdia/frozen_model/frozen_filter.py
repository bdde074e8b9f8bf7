"""The filter whose unknowns stay at the values of commissioning, and what constant causes do to its innovations.

A cause m_h is an offset of sensor h (h = 1..N) or a change of unknown h - N. With e = d(x_true - x) / dm on the augmented state
(`core.augment`), F, H its Jacobians and K the gain, which is zero for the unknowns,

    e- = F e,    D = d(innovation) / dm = H e- + [I | 0],    e = e- - K D

as in the separated bias filter (Friedland 1969, Treatment of bias in recursive filtering). A cause that has been there for long
has e of the row before; one that began k rows ago has the same recursion from e = 0 at that row.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.augment import augment
from fusion_sfdia.core.detector import ProcessHypothesis
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.core.uncertainty import error_of
from fusion_sfdia.filters.estimators import Extended, GaussianState, step_stream
from fusion_sfdia.filters.gaussian import half_inverse

Array = NDArray[Any]

FRESH = 10  # rows up to which the effect of a cause that has just begun is followed


class Tracked(NamedTuple):
    """The filter between two rows: estimate, effect e (..., a, M) of lasting causes, and those that began up to FRESH rows ago.

    fresh (..., FRESH, a, M), the latest first; grown (..., FRESH, N, M): the sum of D since they began.
    """

    core: GaussianState
    effect: Array
    fresh: Array
    grown: Array


class Row(NamedTuple):
    """What a row shows: innovation v (..., N), NaN where missing, and its variance; D (..., N, M); state x (..., n), predicted
    and after the readings, each with its effect (..., n, M); expected readings (..., N). lost (...): no finite value.
    """

    innovation: Array
    variance: Array
    by_cause: Array
    x: Array
    effect: Array
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

    @cached_property
    def model(self) -> Plant:
        """The augmented plant, at these values, which no reading changes; its disturbances are estimated."""
        known = self.plant.uncertainty
        frozen = tuple(replace(p, treatment="frozen") for p in known.parameters)
        model = augment(replace(self.plant, uncertainty=replace(known, parameters=frozen, at_rest=False)))
        n, x0, cov = len(self.plant.states), model.x0.copy(), model.initial_cov.copy()
        own = slice(n, n + self.values.size)
        x0[own] = self.values
        if cov.ndim == 1:
            cov[own] = 0.0
        else:
            cov[own] = cov[:, own] = 0.0
        return replace(model, x0=x0, initial_cov=cov)

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
        shape, ages = self._begin.shape, FRESH * self.of_sensors
        effect = np.broadcast_to(self._begin, (*batch, *shape)).copy()
        fresh = np.broadcast_to(self._begin, (*batch, ages, *shape)).copy()
        core = Extended().start(self.model, batch, step_stream(0, 0))
        return Tracked(core, effect, fresh, np.zeros((*batch, ages, len(self.plant.sensors), shape[-1])))

    def step(self, now: Tracked, t_start: float, dt: float, y: Array, u: Array) -> tuple[Tracked, Row]:
        """After the readings y (*batch, N) at t_start + dt under u (*batch, m)."""
        model, rng, filter_ = self.model, step_stream(0, 0), Extended()  # it draws nothing
        count, n = len(self.plant.sensors), len(self.plant.states)
        prior = filter_.predict(model, now.core, t_start, u, dt, rng)
        joint = filter_.joint(model, prior, t_start + dt, u)
        y = model.near(y, joint.y)
        used = np.isfinite(y)
        half = half_inverse(joint.S, used)
        back = np.swapaxes(half, -1, -2)
        innovation = y - joint.y
        normal = (back @ np.where(used, innovation, 0.0)[..., None])[..., 0]
        gain_half = joint.C @ half
        x = joint.x + (gain_half @ normal[..., None])[..., 0]
        p = joint.P - gain_half @ np.swapaxes(gain_half, -1, -2)
        floor = 4 * np.finfo(float).eps * sum(joint.C.shape[-2:])
        np.einsum("...ii->...i", p)[...] += floor * np.diagonal(joint.P, axis1=-2, axis2=-1)
        assert prior.tangent is not None and joint.H is not None
        tangent, readout = prior.tangent, np.broadcast_to(joint.H, np.swapaxes(joint.C, -1, -2).shape)
        own = np.eye(count, now.effect.shape[-1]) if self.of_sensors else 0.0
        gain = gain_half @ back

        def followed(effect: Array, F: Array, H: Array, K: Array) -> tuple[Array, Array, Array]:
            ahead = F @ effect
            by_cause = H @ ahead + own
            return ahead - K @ by_cause, by_cause, ahead

        effect, by_cause, ahead = followed(now.effect, tangent, readout, gain)
        fresh, grown = now.fresh, now.grown
        if self.of_sensors:
            begun = np.concatenate([np.broadcast_to(self._begin, (*fresh.shape[:-3], 1, *fresh.shape[-2:])), fresh], axis=-3)
            fresh, seen, _ = followed(begun[..., :-1, :, :], *(a[..., None, :, :] for a in (tangent, readout, gain)))
            grown = np.concatenate([np.zeros_like(grown[..., :1, :, :]), grown[..., :-1, :, :]], axis=-3) + seen
        lost = ~np.isfinite(x).all(axis=-1) | prior.lost
        nis = np.sum(normal**2, axis=-1) / np.maximum(np.sum(used, axis=-1), 1)
        nis = np.where(used.any(axis=-1), nis, np.nan)
        row = Row(
            innovation, np.diagonal(joint.S, axis1=-2, axis2=-1), by_cause, joint.x[..., :n], ahead[..., :n, :],
            x[..., :n], effect[..., :n, :], p[..., :n, :n], joint.y,
            prior.guarded, lost, nis,
        )  # fmt: skip
        return Tracked(GaussianState(x, p), effect, fresh, grown), row


def unknowns(plant: Plant) -> tuple[ProcessHypothesis, ...]:
    """What the plant declares: parameters, then constant errors of inputs, in the order of the augmented states."""
    known = plant.uncertainty
    errors = [s for s in plant.inputs if s.name in known.inputs]
    return (
        *(ProcessHypothesis(p.name, p.unit, "parameter", p.nominal) for p in known.parameters),
        *(ProcessHypothesis(error_of(s.name), s.unit, "input", 0.0) for s in errors),
    )
