"""The filters of the banks with one interface: start, predict, joint, update, assimilate.

A core is what a filter carries from step to step: a GaussianState for the extended, unscented and Gaussian particle filters,
an EnsembleState for the ensemble filter. Predictions keep the plant's limits, see `guarded_steps`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.alike import for_all, repeated, single
from fusion_sfdia.common.arguments import shown, whole
from fusion_sfdia.common.errors import NotApplicableError
from fusion_sfdia.filters import ekf, enkf, gaussian, particle, ukf
from fusion_sfdia.filters.gaussian import Joint
from fusion_sfdia.filters.guarded_steps import (
    guarded_points,
    guarded_step_and_jacobian,
    readings_and_jacobian,
    readings_of_points,
)
from fusion_sfdia.filters.repeated import repeated_readings
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]
Core = Any  # GaussianState or EnsembleState


class GaussianState(NamedTuple):
    """State of a filter that carries moments: mean x (..., n) and covariance P (..., n, n) after the last readings."""

    x: Array
    P: Array


class EnsembleState(NamedTuple):
    """State of an ensemble filter: the members (..., M, n) after the last readings."""

    members: Array


class Prior(NamedTuple):
    """A filter after its prediction and before its update.

    core: predicted. guarded (...): whether the estimate, or a point of it, had to be moved into the plant's limits. lost (...):
    whether the model gives no finite value, see `guarded_steps`. tangent: Jacobian of the step, propagated: sigma points for
    the update, or their covariance where the plant's output is linear; None for filters without them.
    """

    core: Core
    guarded: Array
    lost: Array
    tangent: Array | None = None
    propagated: Array | None = None


class Estimator(Protocol):
    """A Kalman filter as a bank needs it; rng serves those that draw random numbers, as `is_random` states.

    start: the core of a batch at the plant's x0. predict: over [t_start, t_start + dt] with input u. joint: of state and
    readings at t. update: mean and covariance after the readings y at t (NaN: not used), of this filter by itself. assimilate:
    the core after the readings y (NaN: not used) with noise covariance noise_gain R; its mean is
    moved to x and its covariance scaled by cov_gain to p, the bank's results for it. consistent: whether S = H P H' + R and
    C = P H' hold in its joint Gaussian.
    """

    is_random: ClassVar[bool]

    @property
    def consistent(self) -> bool: ...
    def start(self, plant: Plant, batch: tuple[int, ...], rng: np.random.Generator) -> Core: ...
    def predict(self, plant: Plant, core: Core, t_start: float, u: Array, dt: float, rng: np.random.Generator) -> Prior: ...
    def joint(self, plant: Plant, prior: Prior, t: float, u: Array) -> Joint: ...
    def update(self, plant: Plant, prior: Prior, t: float, y: Array, u: Array) -> GaussianState: ...
    def assimilate(
        self, plant: Plant, prior: Prior, reading: Reading, x: Array, p: Array, rng: np.random.Generator
    ) -> Core: ...


class Reading(NamedTuple):
    """An update: time, readings (NaN: not used), input, and the factors of the bank on R and on the covariance."""

    t: float
    y: Array
    u: Array
    noise_gain: float = 1.0
    cov_gain: float = 1.0


def require_filter(estimator: object) -> None:
    """Raise ValueError for anything but an estimator; a class in place of its instance is refused too."""
    if isinstance(estimator, type) or not hasattr(estimator, "assimilate"):
        raise ValueError(
            f"estimator is {shown(estimator)}; expected Extended(), Unscented(), Ensemble() or GaussianParticles()"
        )


def require_consistent(estimator: object) -> None:
    """Raise ValueError unless the estimator carries a mean and covariance of the optimal gain; an ensemble does not."""
    require_filter(estimator)
    if isinstance(estimator, Ensemble) or not estimator.consistent:  # type: ignore[attr-defined]
        raise ValueError(f"{estimator} has no consistent mean and covariance; use Extended() or Unscented(redraw=True)")


def require_none_considered(plant: Plant, what: str) -> None:
    """Raise NotApplicableError for a plant with considered states, which an update of this kind would change."""
    if plant.considered is not None:
        names = ", ".join(plant.states[i].name for i in plant.considered)
        raise NotApplicableError(
            f"plant {plant.name!r} has considered states ({names}), which {what} would change; treat them as estimated or "
            "frozen, or use a bank on one Extended() or Unscented() filter"
        )


class Conditioned:
    """Common to the filters whose update conditions the joint Gaussian of state and readings."""

    def update(self: Estimator, plant: Plant, prior: Prior, t: float, y: Array, u: Array) -> GaussianState:
        found = gaussian.condition(self.joint(plant, prior, t, u), y)
        return GaussianState(found.x, found.P)


class Moments:
    """Common to the filters that carry mean and covariance."""

    def start(self, plant: Plant, batch: tuple[int, ...], rng: np.random.Generator) -> Core:
        n = plant.x0.size
        return GaussianState(np.broadcast_to(plant.x0, (*batch, n)).copy(), for_all(gaussian.dense(plant.initial_cov), batch))

    def assimilate(self, plant: Plant, prior: Prior, reading: Reading, x: Array, p: Array, rng: np.random.Generator) -> Core:
        return GaussianState(x, p)


@dataclass(frozen=True)
class Extended(Conditioned, Moments):
    """The extended Kalman filter (Shaheen 2024, sec. III-C1); the linear one where the plant is linear.

    Examples
    --------
    >>> from fusion_sfdia import run, simulate
    >>> from fusion_sfdia.detectors import CentralFilter
    >>> from fusion_sfdia.filters import Extended
    >>> from fusion_sfdia.plants import two_tanks
    >>> detector = CentralFilter(two_tanks(), Extended())
    >>> recording = simulate(detector.plant, 40, seeds=[1])
    >>> decisions = run(detector, detector.init(1), recording)[1]
    >>> bool((abs(decisions.estimate[-1] - recording.x[-1]) < 0.02).all())  # m
    True
    """

    is_random: ClassVar[bool] = False
    consistent: bool = field(default=True, init=False, repr=False)

    def predict(self, plant: Plant, core: Core, t_start: float, u: Array, dt: float, rng: np.random.Generator) -> Prior:
        (start, ahead, moved, stuck, lost), jacobian = guarded_step_and_jacobian(plant, t_start, core.x, u, dt)
        if (beyond := moved | stuck).any():  # outside its limits the model has no usable Jacobian
            jacobian = np.where(beyond[..., None, None], np.eye(start.shape[-1]), jacobian)
        x, p = ekf.predict(start, core.P, lambda s: ahead, jacobian, plant.process_cov_over(dt), plant.sparse[0])
        return Prior(GaussianState(x, p), beyond, lost, tangent=jacobian)

    def joint(self, plant: Plant, prior: Prior, t: float, u: Array) -> Joint:
        x, p = prior.core
        expected, H = readings_and_jacobian(plant, t, x, u)
        found = ekf.joint(x, p, lambda s: expected, H, plant.sensor_cov, plant.sparse[1])
        return found._replace(considered=plant.considered, repeated=repeated_readings(plant.same_readings, H, plant.sensor_cov))


@dataclass(frozen=True)
class Unscented(Conditioned, Moments):
    """The unscented Kalman filter (Shaheen 2024, sec. III-C3).

    Parameters
    ----------
    points : SigmaPoints, default SigmaPoints()
        The spread and the weights of the sigma points.
    redraw : bool, default True
        Whether new sigma points are drawn from the predicted moments before the update, as in textbooks. Without it, the
        propagated points are used again, as the paper prints it, and the gain neglects the process noise. The moments of linear
        functions of the points are those of their matrices.

    Examples
    --------
    >>> from fusion_sfdia import run, simulate
    >>> from fusion_sfdia.detectors import CentralFilter
    >>> from fusion_sfdia.filters import Unscented
    >>> from fusion_sfdia.plants import two_tanks
    >>> detector = CentralFilter(two_tanks(), Unscented())
    >>> recording = simulate(detector.plant, 40, seeds=[1])
    >>> decisions = run(detector, detector.init(1), recording)[1]
    >>> bool((abs(decisions.estimate[-1] - recording.x[-1]) < 0.02).all())  # m
    True
    """

    is_random: ClassVar[bool] = False
    points: ukf.SigmaPoints = field(default_factory=ukf.SigmaPoints)
    redraw: bool = True

    @property
    def consistent(self) -> bool:
        return self.redraw

    def predict(self, plant: Plant, core: Core, t_start: float, u: Array, dt: float, rng: np.random.Generator) -> Prior:
        if all(plant.linear):
            prior = Extended().predict(plant, core, t_start, u, dt, rng)
            if self.redraw:
                return prior
            p = prior.core.P
            return prior._replace(propagated=repeated(gaussian.add(single(p), -plant.process_cov_over(dt)), p))
        start, moved = plant.guard(core.x)
        points = ukf.sigma_points(self.points, start, core.P)
        _, ahead, any_moved, stuck, lost = guarded_points(plant, t_start, points, u, dt)
        x, spread = ukf.moments(self.points, ahead)
        p = gaussian.add(spread, plant.process_cov_over(dt))
        used_again = None if self.redraw else spread if plant.linear[1] else ahead
        return Prior(GaussianState(x, p), moved | any_moved | stuck, lost, propagated=used_again)

    def joint(self, plant: Plant, prior: Prior, t: float, u: Array) -> Joint:
        x, p = prior.core
        if plant.linear[1]:
            spread = p if prior.propagated is None else prior.propagated
            return Extended().joint(plant, prior._replace(core=GaussianState(x, spread)), t, u)._replace(P=p)
        found = ukf.joint(self.points, x, p, lambda s: readings_of_points(plant, t, s, u), plant.sensor_cov, prior.propagated)
        return found._replace(considered=plant.considered)


@dataclass(frozen=True)
class Ensemble(Conditioned):
    """The ensemble Kalman filter (Shaheen 2024, sec. III-C2), with S = H P H' + R for the printed sample covariance,
    which is singular for fewer members than readings.

    Parameters
    ----------
    settings : EnKFSettings, default EnKFSettings()
        Size of the ensemble, the kind of update, inflation and localisation.

    Examples
    --------
    >>> from fusion_sfdia import run, simulate
    >>> from fusion_sfdia.detectors import CentralFilter
    >>> from fusion_sfdia.filters import Ensemble
    >>> from fusion_sfdia.plants import two_tanks
    >>> detector = CentralFilter(two_tanks(), Ensemble())
    >>> recording = simulate(detector.plant, 40, seeds=[1])
    >>> decisions = run(detector, detector.init(1), recording)[1]
    >>> bool((abs(decisions.estimate[-1] - recording.x[-1]) < 0.02).all())  # m
    True
    """

    is_random: ClassVar[bool] = True
    settings: enkf.EnKFSettings = field(default_factory=enkf.EnKFSettings)
    consistent: bool = field(default=True, init=False, repr=False)

    def start(self, plant: Plant, batch: tuple[int, ...], rng: np.random.Generator) -> Core:
        require_none_considered(plant, "an ensemble")
        return EnsembleState(plant.x0 + gaussian.sample(plant.initial_cov, rng, (*batch, self.settings.size)))

    def predict(self, plant: Plant, core: Core, t_start: float, u: Array, dt: float, rng: np.random.Generator) -> Prior:
        _, ahead, moved, stuck, lost = guarded_points(plant, t_start, core.members, u, dt)
        members = enkf.predict(ahead, lambda s: s, plant.process_cov_over(dt), rng)
        return Prior(EnsembleState(members), moved | stuck, lost)

    def joint(self, plant: Plant, prior: Prior, t: float, u: Array) -> Joint:
        if plant.linear[1]:
            moments = GaussianState(*enkf.moments(prior.core.members))
            return Extended().joint(plant, prior._replace(core=moments), t, u)
        return enkf.joint(prior.core.members, lambda s: readings_of_points(plant, t, s, u), plant.sensor_cov)

    def assimilate(self, plant: Plant, prior: Prior, reading: Reading, x: Array, p: Array, rng: np.random.Generator) -> Core:
        members = enkf.update(
            self.settings,
            prior.core.members,
            lambda s: readings_of_points(plant, reading.t, s, reading.u),
            reading.y,
            plant.sensor_cov * reading.noise_gain,
            rng,
        )
        members -= members.mean(axis=-2, keepdims=True)
        members *= np.sqrt(reading.cov_gain)
        members += x[..., None, :]
        return EnsembleState(members)


@dataclass(frozen=True)
class GaussianParticles(Moments):
    """The Gaussian particle filter (Kotecha and Djuric 2003), with the Kalman update of the moments as importance density
    (van der Merwe et al. 2000): from the prior, no particle would hit the readings of many sensors.

    The draws of a step have mean 0 and covariance I exactly, and all runs and local filters share them, so that on a linear
    plant every weight is the same and the filter is the Kalman filter.

    Parameters
    ----------
    size : int, default 1000
        Number of particles, more than states.

    Examples
    --------
    >>> from fusion_sfdia import simulate
    >>> from fusion_sfdia.detectors import FusingBank
    >>> from fusion_sfdia.filters import GaussianParticles
    >>> from fusion_sfdia.plants import two_tanks
    >>> plant = two_tanks()
    >>> healthy = simulate(plant, 60, seeds=range(2))
    >>> bank = FusingBank.fit(plant, healthy, false_alarm=0.05, estimator=GaussianParticles(100))
    >>> len(bank.thresholds)
    4
    """

    is_random: ClassVar[bool] = True
    size: int = 1000
    consistent: bool = field(default=False, init=False, repr=False)

    def start(self, plant: Plant, batch: tuple[int, ...], rng: np.random.Generator) -> Core:
        require_none_considered(plant, "the weights of particles")
        if whole("size", self.size, least=1) <= len(plant.states):
            raise ValueError(f"{self.size} particles; expected more than the {len(plant.states)} states of {plant.name!r}")
        return super().start(plant, batch, rng)

    def predict(self, plant: Plant, core: Core, t_start: float, u: Array, dt: float, rng: np.random.Generator) -> Prior:
        z = standard_draws(rng, self.size, len(plant.states))
        if all(plant.linear):
            return Extended().predict(plant, core, t_start, u, dt, rng)._replace(propagated=z)
        start, moved = plant.guard(core.x)
        _, ahead, any_moved, stuck, lost = guarded_points(plant, t_start, _drawn(start, core.P, z), u, dt)
        x, spread = enkf.moments(ahead)
        p = gaussian.add(spread, plant.process_cov_over(dt))
        return Prior(GaussianState(x, p), moved | any_moved | stuck, lost, propagated=z)

    def joint(self, plant: Plant, prior: Prior, t: float, u: Array) -> Joint:
        if plant.linear[1]:
            return Extended().joint(plant, prior, t, u)
        x, p = prior.core
        assert prior.propagated is not None
        members = _drawn(x, p, prior.propagated)
        return enkf.joint(members, lambda s: readings_of_points(plant, t, s, u), plant.sensor_cov)._replace(x=x, P=p)

    def update(self, plant: Plant, prior: Prior, t: float, y: Array, u: Array) -> GaussianState:
        joint = self.joint(plant, prior, t, u)
        found, reading = gaussian.condition(joint, y), Reading(t, y[..., None, :], u)
        x, p = self.weighed(plant, prior, joint, reading, found.x[..., None, :], found.P[..., None, :, :])
        return GaussianState(x[..., 0, :], p[..., 0, :, :])

    def weighed(self, plant: Plant, prior: Prior, joint: Joint, reading: Reading, x: Array, p: Array) -> tuple[Array, Array]:
        """Return mean and covariance of N local filters from draws of the x and p given.

            X = x + L z,    L L' = p,    w ~ N(X; prior) prod_j N(y_j; h_j(X), R_j) / N(X; x, p)

        Parameters
        ----------
        plant : Plant
            The model.
        prior : Prior
            Of all filters.
        joint : Joint
            Of all filters.
        reading : Reading
            y (..., N, N), NaN where a filter does not use a reading.
        x : array (..., N, n)
            Mean of the draws of each filter.
        p : array (..., N, n, n)
            Covariance of the draws of each filter.

        Returns
        -------
        x : array (..., N, n)
            Weighted mean.
        p : array (..., N, n, n)
            Weighted covariance.
        """
        x, p, z, (mean, cov) = np.array(x), np.array(p), prior.propagated, prior.core
        assert z is not None
        exact = np.diagonal(cov, axis1=-2, axis2=-1) == 0  # states without variance stay at the mean
        L = gaussian.cholesky(cov + exact[..., None] * np.eye(exact.shape[-1]) if exact.any() else cov)
        for i in range(x.shape[-2]):
            members = _drawn(x[..., i, :], p[..., i, :, :], z)
            h = plant.near(readings_of_points(plant, reading.t, members, reading.u), joint.y[..., None, :])
            away = np.swapaxes(members - mean[..., None, :], -1, -2)
            whitened = gaussian.solve_lower(np.broadcast_to(L, (*away.shape[:-2], *L.shape[-2:])), away)
            log = particle.log_likelihood(h, reading.y[..., i, :], plant.sensor_cov)
            log = log - 0.5 * np.sum(whitened * whitened, axis=-2) + 0.5 * np.sum(z * z, axis=-1)
            w = np.exp(particle.normalise(log))
            x[..., i, :], spread = particle.weighted_moments(members, w)
            p[..., i, :, :] = spread / (1 - np.sum(w * w, axis=-1))[..., None, None]  # unbiased: M - 1 for equal weights
        return x, p


def standard_draws(rng: np.random.Generator, size: int, count: int) -> Array:
    """Draws (size, count) of N(0, I), moved so that their mean is 0 and their covariance I."""
    z = rng.standard_normal((size, count))
    z -= np.mean(z, axis=0)
    L = np.linalg.cholesky(z.T @ z / (size - 1))
    return np.ascontiguousarray(gaussian.solve_lower(L, z.T).T)


def _drawn(x: Array, p: Array, z: Array) -> Array:
    """Draws (..., M, n) with mean x (..., n) and covariance p (..., n, n) of standard ones z (M, n)."""
    return np.asarray(x[..., None, :] + z @ np.swapaxes(gaussian.square_root(p), -1, -2))


def step_stream(seed: Array | int, step: Array | int) -> np.random.Generator:
    """The generator of one step of one seed (Philox, the step in the highest counter word); no two steps share numbers."""
    return np.random.Generator(np.random.Philox(key=int(seed), counter=[0, 0, 0, int(step)]))


UNUSED = step_stream(0, 0)  # of filters that draw nothing: to make a generator takes as long as a small product


def drawn_by(estimator: Estimator, seed: Array | int, step: Array | int) -> np.random.Generator:
    """The generator of a step for an estimator, `UNUSED` for one that draws nothing."""
    return step_stream(seed, step) if estimator.is_random else UNUSED
