"""The three filters of the banks behind one face: start, predict, joint, and what a bank does with their state.

A core is what a filter carries from step to step, a tuple of arrays: (x, P) for the extended and unscented filters,
(ensemble,) for the ensemble filter. Each keeps the plant's limits: a prediction starts from the state moved into them, a
state whose step still ends in no number stays where it is, and both are told as `guarded`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia import ekf, enkf, gaussian, ukf
from fusion_sfdia.gaussian import Joint
from fusion_sfdia.plant import Plant

Array = NDArray[Any]
Core = tuple[Array, ...]


class Prior(NamedTuple):
    """A filter between its two halves: core before the reading, whether the estimate had to be moved into the plant's
    limits (...), and, where the filter has them, the Jacobian of the step and the sigma points that wait for the reading.
    """

    core: Core
    guarded: Array
    tangent: Array | None = None
    propagated: Array | None = None


class Estimator(Protocol):
    """A Kalman filter as a bank needs it; rng serves those that draw random numbers.

    start: the core of a batch at the plant's x0. predict: over [t, t + dt] with input u. joint: of state and readings at t.
    assimilate: the core after the readings y (NaN: not used) with noise
    covariance noise_gain R, its mean x and its covariance scaled by cov_gain to p; x and p are the bank's result for it.
    consistent: whether S = H P H' + R and C = P H' hold in its joint Gaussian.
    """

    @property
    def consistent(self) -> bool: ...
    def start(self, plant: Plant, batch: tuple[int, ...], rng: np.random.Generator) -> Core: ...
    def predict(self, plant: Plant, core: Core, t: float, u: Array, dt: float, rng: np.random.Generator) -> Prior: ...
    def joint(self, plant: Plant, prior: Prior, t: float, u: Array) -> Joint: ...
    def assimilate(
        self, plant: Plant, prior: Prior, reading: Reading, x: Array, p: Array, rng: np.random.Generator
    ) -> Core: ...


class Reading(NamedTuple):
    """What an update uses: time, readings (NaN: not used), input, and by how much the bank scales R and the covariance."""

    t: float
    y: Array
    u: Array
    noise_gain: float = 1.0
    cov_gain: float = 1.0


def guarded_step(plant: Plant, t: float, x: Array, u: Array, dt: float) -> tuple[Array, Array]:
    """Return the states (..., n) after a step from within the plant's limits, and whether any was guarded (...)."""
    inside, moved = plant.guard(x)
    ahead = plant.step(t, inside, u, dt)
    lost = ~np.all(np.isfinite(ahead), axis=-1)
    if not np.any(lost):
        return ahead, moved
    return np.where(lost[..., None], inside, ahead), moved | lost


class _Moments:
    """What the filters that carry mean and covariance share."""

    def start(self, plant: Plant, batch: tuple[int, ...], rng: np.random.Generator) -> Core:
        n = plant.x0.size
        p = gaussian.dense(plant.initial_cov)
        return np.broadcast_to(plant.x0, (*batch, n)).copy(), np.broadcast_to(p, (*batch, n, n)).copy()

    def assimilate(self, plant: Plant, prior: Prior, reading: Reading, x: Array, p: Array, rng: np.random.Generator) -> Core:
        return x, p


@dataclass(frozen=True)
class Extended(_Moments):
    """The extended Kalman filter (Shaheen 2024, sec. III-C1); the linear one where the plant is linear."""

    consistent: bool = field(default=True, init=False, repr=False)

    def predict(self, plant: Plant, core: Core, t: float, u: Array, dt: float, rng: np.random.Generator) -> Prior:
        start, _ = plant.guard(core[0])
        ahead, guarded = guarded_step(plant, t, core[0], u, dt)
        jacobian = plant.step_jacobian_at(t, start, u, dt)
        if np.any(guarded):  # beyond its limits the model has no slope to speak of
            jacobian = np.where(guarded[..., None, None], np.eye(start.shape[-1]), jacobian)
        x, p = ekf.predict(start, core[1], lambda s: ahead, jacobian, plant.process_cov_over(dt))
        return Prior((x, p), guarded, tangent=jacobian)

    def joint(self, plant: Plant, prior: Prior, t: float, u: Array) -> Joint:
        x, p = prior.core
        return ekf.joint(x, p, lambda s: plant.output(t, s, u), plant.output_jacobian_at(t, x, u), plant.sensor_cov)


@dataclass(frozen=True)
class Unscented(_Moments):
    """The unscented Kalman filter (Shaheen 2024, sec. III-C3).

    redraw: draw new sigma points from the predicted moments before the reading, as the textbook does; without, the
    propagated points serve again as the paper prints it, and the gain does not know of the process noise.
    """

    points: ukf.SigmaPoints = field(default_factory=ukf.SigmaPoints)
    redraw: bool = True

    @property
    def consistent(self) -> bool:
        return self.redraw

    def predict(self, plant: Plant, core: Core, t: float, u: Array, dt: float, rng: np.random.Generator) -> Prior:
        start, moved = plant.guard(core[0])
        over = np.expand_dims(u, -2)
        x, p, propagated = ukf.predict(
            self.points, start, core[1], lambda s: guarded_step(plant, t, s, over, dt)[0], plant.process_cov_over(dt)
        )
        return Prior((x, p), moved, propagated=None if self.redraw else propagated)

    def joint(self, plant: Plant, prior: Prior, t: float, u: Array) -> Joint:
        x, p = prior.core
        over = np.expand_dims(u, -2)
        return ukf.joint(self.points, x, p, lambda s: plant.output(t, s, over), plant.sensor_cov, prior.propagated)


@dataclass(frozen=True)
class Ensemble:
    """The ensemble Kalman filter (Shaheen 2024, sec. III-C2), with S = H P H' + R for the printed sample covariance,
    which is singular for fewer members than readings.
    """

    settings: enkf.EnKFSettings = field(default_factory=enkf.EnKFSettings)
    consistent: bool = field(default=True, init=False, repr=False)

    def start(self, plant: Plant, batch: tuple[int, ...], rng: np.random.Generator) -> Core:
        return (plant.x0 + gaussian.sample(plant.initial_cov, rng, (*batch, self.settings.size)),)

    def predict(self, plant: Plant, core: Core, t: float, u: Array, dt: float, rng: np.random.Generator) -> Prior:
        members, guarded = guarded_step(plant, t, core[0], np.expand_dims(u, -2), dt)
        members = enkf.predict(members, lambda s: s, plant.process_cov_over(dt), rng)
        return Prior((members,), np.any(guarded, axis=-1))

    def joint(self, plant: Plant, prior: Prior, t: float, u: Array) -> Joint:
        over = np.expand_dims(u, -2)
        return enkf.joint(prior.core[0], lambda s: plant.output(t, s, over), plant.sensor_cov)

    def assimilate(self, plant: Plant, prior: Prior, reading: Reading, x: Array, p: Array, rng: np.random.Generator) -> Core:
        over = np.expand_dims(reading.u, -2)
        members = enkf.update(
            self.settings,
            prior.core[0],
            lambda s: plant.output(reading.t, s, over),
            reading.y,
            plant.sensor_cov * reading.noise_gain,
            rng,
        )
        spread = members - members.mean(axis=-2, keepdims=True)
        return (x[..., None, :] + np.sqrt(reading.cov_gain) * spread,)


def step_stream(seed: Array | int, step: Array | int) -> np.random.Generator:
    """The generator of one step of one seed (Philox, the step in the highest counter word): no step repeats another's."""
    return np.random.Generator(np.random.Philox(key=int(seed), counter=[0, 0, 0, int(step)]))
