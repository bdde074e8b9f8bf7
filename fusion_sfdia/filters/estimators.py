"""The three filters of the banks behind one face: start, predict, joint, and what a bank does with their state.

A core is what a filter carries from step to step: a GaussianState of the extended and unscented filters, an EnsembleState of
the ensemble filter. Each keeps the plant's limits: a prediction starts from the state moved into them, told
as `guarded`. An estimate whose step ends in no number, or most of whose points' steps do, stays where it is. It is `guarded`
where the model has a number for the plant's x0 (a faulty reading has pulled the estimate to where the model does not hold,
and the next may pull it back), and `lost` where it has none: then the detector calls it diverged.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.arguments import shown
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.filters import ekf, enkf, gaussian, ukf
from fusion_sfdia.filters.gaussian import Joint

Array = NDArray[Any]
Core = Any  # GaussianState or EnsembleState


class GaussianState(NamedTuple):
    """Of a filter that carries moments: mean x (..., n) and covariance P (..., n, n) after the last readings."""

    x: Array
    P: Array


class EnsembleState(NamedTuple):
    """Of an ensemble filter: the members (..., M, n) after the last readings."""

    members: Array


class Prior(NamedTuple):
    """A filter between its two halves: core before the reading, whether the estimate or a point of it had to be moved into the
    plant's limits (...), whether the model gave it no number (...), and, where the filter has them, the Jacobian of the step
    and the sigma points that wait for the reading.
    """

    core: Core
    guarded: Array
    lost: Array
    tangent: Array | None = None
    propagated: Array | None = None


class Estimator(Protocol):
    """A Kalman filter as a bank needs it; rng serves those that draw random numbers.

    start: the core of a batch at the plant's x0. predict: over [t_start, t_start + dt] with input u. joint: of state and
    readings at t. assimilate: the core after the readings y (NaN: not used) with noise
    covariance noise_gain R, its mean x and its covariance scaled by cov_gain to p; x and p are the bank's result for it.
    consistent: whether S = H P H' + R and C = P H' hold in its joint Gaussian.
    """

    @property
    def consistent(self) -> bool: ...
    def start(self, plant: Plant, batch: tuple[int, ...], rng: np.random.Generator) -> Core: ...
    def predict(self, plant: Plant, core: Core, t_start: float, u: Array, dt: float, rng: np.random.Generator) -> Prior: ...
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


class Stepped(NamedTuple):
    """States (..., n) within the plant's limits from which a step began, and those at which it ended, `start` itself where it
    ended in no number; whether a state had to be moved into the limits (...); whether its step ended in no number (...);
    whether a step from the plant's x0 does so too (...).
    """

    start: Array
    ahead: Array
    moved: Array
    stuck: Array
    lost: Array


def guarded_step(plant: Plant, t_start: float, x: Array, u: Array, dt: float) -> Stepped:
    """Step the states x (..., n) from within the plant's limits; ValueError where the plant's step changes their shape."""
    start, moved = plant.guard(x)
    ahead = np.asarray(plant.step(t_start, start, u, dt))
    if ahead.shape != start.shape:
        raise ValueError(
            f"step of plant {plant.name!r} gives shape {ahead.shape} for states {start.shape}; expected the same: "
            "a batch is leading axes"
        )
    stuck = ~np.all(np.isfinite(ahead), axis=-1)
    if not np.any(stuck):
        return Stepped(start, ahead, moved, stuck, stuck)
    return Stepped(start, np.where(stuck[..., None], start, ahead), moved, stuck, stuck & ~_holds(plant, t_start, u, dt))


def _holds(plant: Plant, t_start: float, u: Array, dt: float) -> Array:
    """Whether the model has a number for the plant's x0 under the inputs u (..., m)."""
    x = np.broadcast_to(plant.x0, (*u.shape[:-1], plant.x0.size))
    return np.asarray(np.all(np.isfinite(plant.step(t_start, x, u, dt)), axis=-1))


def guarded_points(plant: Plant, t_start: float, x: Array, u: Array, dt: float) -> Stepped:
    """Step the points x (..., M, n) that together stand for an estimate, under its input u (..., m); moved and lost are (...).

    They are stuck where more than half of them have no step. A point without one goes along with the mean of the others,
    else it would spread them by all that they have moved.
    """
    start, ahead, moved, stuck, lost = guarded_step(plant, t_start, x, np.expand_dims(u, -2), dt)
    if np.any(stuck):
        sound = np.maximum(np.sum(~stuck, axis=-1), 1)[..., None]
        drift = np.sum(ahead - start, axis=-2) / sound  # those without a step have not moved
        ahead = np.where(stuck[..., None], start + drift[..., None, :], ahead)
    most = 2 * np.sum(stuck, axis=-1) > x.shape[-2]
    return Stepped(start, ahead, np.any(moved, axis=-1), np.any(stuck, axis=-1), most & np.any(lost, axis=-1))


def readings_of(plant: Plant, t: float, x: Array, u: Array) -> Array:
    """Return the readings (..., N) of the plant in states x (..., n); ValueError where its output has another shape."""
    y = np.asarray(plant.output(t, x, u))
    if y.shape != (expected := (*x.shape[:-1], len(plant.sensors))):
        raise ValueError(
            f"output of plant {plant.name!r} gives shape {y.shape} for states {x.shape}; expected {expected}, a column a sensor"
        )
    return y


def require_filter(estimator: object) -> None:
    """Raise ValueError for anything but an estimator, as for its class in place of an instance."""
    if isinstance(estimator, type) or not hasattr(estimator, "assimilate"):
        raise ValueError(f"estimator is {shown(estimator)}; expected Extended(), Unscented() or Ensemble()")


def require_consistent(estimator: object) -> None:
    """Raise ValueError for anything but a filter whose mean and covariance are consistent: no ensemble, no other gain."""
    require_filter(estimator)
    if isinstance(estimator, Ensemble) or not estimator.consistent:  # type: ignore[attr-defined]
        raise ValueError(f"{estimator} has no consistent mean and covariance; use Extended() or Unscented(redraw=True)")


class _Moments:
    """What the filters that carry mean and covariance share."""

    def start(self, plant: Plant, batch: tuple[int, ...], rng: np.random.Generator) -> Core:
        n = plant.x0.size
        p = gaussian.dense(plant.initial_cov)
        return GaussianState(np.broadcast_to(plant.x0, (*batch, n)).copy(), np.broadcast_to(p, (*batch, n, n)).copy())

    def assimilate(self, plant: Plant, prior: Prior, reading: Reading, x: Array, p: Array, rng: np.random.Generator) -> Core:
        return GaussianState(x, p)


@dataclass(frozen=True)
class Extended(_Moments):
    """The extended Kalman filter (Shaheen 2024, sec. III-C1); the linear one where the plant is linear."""

    consistent: bool = field(default=True, init=False, repr=False)

    def predict(self, plant: Plant, core: Core, t_start: float, u: Array, dt: float, rng: np.random.Generator) -> Prior:
        start, ahead, moved, stuck, lost = guarded_step(plant, t_start, core.x, u, dt)
        jacobian = plant.step_jacobian_at(t_start, start, u, dt)
        if np.any(beyond := moved | stuck):  # beyond its limits the model has no slope to speak of
            jacobian = np.where(beyond[..., None, None], np.eye(start.shape[-1]), jacobian)
        x, p = ekf.predict(start, core.P, lambda s: ahead, jacobian, plant.process_cov_over(dt))
        return Prior(GaussianState(x, p), beyond, lost, tangent=jacobian)

    def joint(self, plant: Plant, prior: Prior, t: float, u: Array) -> Joint:
        x, p = prior.core
        expected = readings_of(plant, t, x, u)
        return ekf.joint(x, p, lambda s: expected, plant.output_jacobian_at(t, x, u), plant.sensor_cov)


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

    def predict(self, plant: Plant, core: Core, t_start: float, u: Array, dt: float, rng: np.random.Generator) -> Prior:
        start, moved = plant.guard(core.x)
        points = ukf.sigma_points(self.points, start, core.P)
        _, ahead, any_moved, stuck, lost = guarded_points(plant, t_start, points, u, dt)
        x, p = ukf.moments(self.points, ahead, plant.process_cov_over(dt))
        return Prior(GaussianState(x, p), moved | any_moved | stuck, lost, propagated=None if self.redraw else ahead)

    def joint(self, plant: Plant, prior: Prior, t: float, u: Array) -> Joint:
        x, p = prior.core
        over = np.expand_dims(u, -2)
        return ukf.joint(self.points, x, p, lambda s: readings_of(plant, t, s, over), plant.sensor_cov, prior.propagated)


@dataclass(frozen=True)
class Ensemble:
    """The ensemble Kalman filter (Shaheen 2024, sec. III-C2), with S = H P H' + R for the printed sample covariance,
    which is singular for fewer members than readings.
    """

    settings: enkf.EnKFSettings = field(default_factory=enkf.EnKFSettings)
    consistent: bool = field(default=True, init=False, repr=False)

    def start(self, plant: Plant, batch: tuple[int, ...], rng: np.random.Generator) -> Core:
        return EnsembleState(plant.x0 + gaussian.sample(plant.initial_cov, rng, (*batch, self.settings.size)))

    def predict(self, plant: Plant, core: Core, t_start: float, u: Array, dt: float, rng: np.random.Generator) -> Prior:
        _, ahead, moved, stuck, lost = guarded_points(plant, t_start, core.members, u, dt)
        members = enkf.predict(ahead, lambda s: s, plant.process_cov_over(dt), rng)
        return Prior(EnsembleState(members), moved | stuck, lost)

    def joint(self, plant: Plant, prior: Prior, t: float, u: Array) -> Joint:
        over = np.expand_dims(u, -2)
        return enkf.joint(prior.core.members, lambda s: readings_of(plant, t, s, over), plant.sensor_cov)

    def assimilate(self, plant: Plant, prior: Prior, reading: Reading, x: Array, p: Array, rng: np.random.Generator) -> Core:
        over = np.expand_dims(reading.u, -2)
        members = enkf.update(
            self.settings,
            prior.core.members,
            lambda s: plant.output(reading.t, s, over),
            reading.y,
            plant.sensor_cov * reading.noise_gain,
            rng,
        )
        spread = members - members.mean(axis=-2, keepdims=True)
        return EnsembleState(x[..., None, :] + np.sqrt(reading.cov_gain) * spread)


def step_stream(seed: Array | int, step: Array | int) -> np.random.Generator:
    """The generator of one step of one seed (Philox, the step in the highest counter word): no step repeats another's."""
    return np.random.Generator(np.random.Philox(key=int(seed), counter=[0, 0, 0, int(step)]))
