"""filterpy's extended and unscented filters as estimators of a bank: a reference for ours, and slow.

filterpy predicts and updates one state at a time, so that a batch is a loop. Its filters get the plant's model, Jacobians and
limits as ours do, see `guarded_steps`, and readings in units of their noise: it inverts S as it is, which is singular to
rounding where Pa stand beside rad/s. Covariances, gains and updates are its own code. Where that fails, because a covariance
is singular or not finite, the estimate is NaN.

filterpy's ensemble filter is not among them. It draws from numpy's global generator, so that a run does not repeat from its
seed, and does not centre the noise of perturbed readings: it can equal ours on average only.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter
from numpy.typing import NDArray
from scipy.linalg import cholesky

from fusion_sfdia.filters.estimators import Core, GaussianState, Moments, Prior
from fusion_sfdia.filters.gaussian import Joint, dense, square_root
from fusion_sfdia.filters.guarded_steps import (
    Stepped,
    guarded_points,
    guarded_step_and_jacobian,
    readings_and_jacobian,
    readings_of,
)
from fusion_sfdia.filters.ukf import SigmaPoints
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]
One = Callable[[tuple[int, ...]], tuple[Array, ...]]  # of the run at an index of a batch


class _Extended(ExtendedKalmanFilter):  # type: ignore[misc]
    """With a nonlinear step: what filterpy asks its users to override."""

    ahead: Array  # (n,)
    x: Array

    def predict_x(self, u: Any = 0) -> None:
        self.x = self.ahead


class _Unscented(UnscentedKalmanFilter):  # type: ignore[misc]
    """With a step of all sigma points at once, fx(points, dt), since a plant's limits concern them together."""

    sigmas_f: Array
    stepped: Stepped

    def compute_process_sigmas(self, dt: float, fx: Any = None, **fx_args: Any) -> None:
        self.stepped = self.fx(self.points_fn.sigma_points(self.x, self.P), dt)
        self.sigmas_f = self.stepped.ahead


class _OneRun(Moments, ABC):
    """The update and the joint Gaussian of a filter that takes one state at a time."""

    is_random: ClassVar[bool] = False

    @abstractmethod
    def _updated(self, plant: Plant, prior: Prior, t: float, y: Array, u: Array) -> Callable[[tuple[int, ...]], Any]:
        """What gives the filter of a run, by its index in the batch, after the readings y (..., N) that are not NaN; the filter
        has them in units of their noise.
        """

    def update(self, plant: Plant, prior: Prior, t: float, y: Array, u: Array) -> GaussianState:
        updated, (x, P) = self._updated(plant, prior, t, y, u), prior.core

        def one(index: tuple[int, ...]) -> tuple[Array, ...]:
            found = updated(index)
            return found.x, found.P

        return GaussianState(*_each(one, x.shape[:-1], x.shape[-1:], P.shape[-2:]))

    def joint(self, plant: Plant, prior: Prior, t: float, u: Array) -> Joint:
        (x, P), count, sigma = prior.core, len(plant.sensors), np.sqrt(plant.sensor_cov)
        updated = self._updated(plant, prior, t, np.zeros((*x.shape[:-1], count)), u)  # the readings do not matter

        def one(index: tuple[int, ...]) -> tuple[Array, ...]:
            found = updated(index)
            S = found.S * sigma
            return -found.y * sigma, S * sigma[:, None], found.K @ S  # its y is the innovation, of readings of 0

        y, S, C = _each(one, x.shape[:-1], (count,), (count, count), (x.shape[-1], count))
        return Joint(x, P, y, S, C)


@dataclass(frozen=True)
class FilterpyExtended(_OneRun):
    """filterpy's ExtendedKalmanFilter, the counterpart of `Extended`."""

    consistent: bool = field(default=True, init=False, repr=False)

    def predict(self, plant: Plant, core: Core, t_start: float, u: Array, dt: float, rng: np.random.Generator) -> Prior:
        (start, ahead, moved, stuck, lost), jacobian = guarded_step_and_jacobian(plant, t_start, core.x, u, dt)
        batch, n, beyond = start.shape[:-1], start.shape[-1], moved | stuck
        F = np.where(beyond[..., None, None], np.eye(n), jacobian)  # outside its limits the model has no usable Jacobian
        Q = dense(plant.process_cov_over(dt))

        def one(index: tuple[int, ...]) -> tuple[Array, ...]:
            own = _Extended(n, 1)
            own.x, own.P, own.F, own.Q, own.ahead = start[index], core.P[index], F[index], Q, ahead[index]
            own.predict()
            return own.x, own.P

        return Prior(GaussianState(*_each(one, batch, (n,), (n, n))), beyond, lost)

    def _updated(self, plant: Plant, prior: Prior, t: float, y: Array, u: Array) -> Callable[[tuple[int, ...]], Any]:
        (x, P), sigma = prior.core, np.sqrt(plant.sensor_cov)
        expected, H = readings_and_jacobian(plant, t, x, u)
        z, expected = y / sigma, expected / sigma
        H = np.broadcast_to(H / sigma[:, None], (*x.shape[:-1], *H.shape[-2:]))

        def of(index: tuple[int, ...]) -> ExtendedKalmanFilter:
            used = np.isfinite(y[index])
            own = ExtendedKalmanFilter(x.shape[-1], int(used.sum()))
            own.x, own.P = x[index], _finite(P[index])
            h = _finite(H[index][used])
            own.update(z[index][used] if used.any() else None, lambda state: h, lambda state: expected[index][used])
            return own

        return of


@dataclass(frozen=True)
class FilterpyUnscented(_OneRun):
    """filterpy's UnscentedKalmanFilter with Merwe's scaled sigma points, the counterpart of `Unscented`.

    redraw: whether sigma points are drawn again before the update, as filterpy does; otherwise its update gets the propagated
    ones, as the paper prints it (Shaheen 2024, sec. III-C3).
    """

    points: SigmaPoints = field(default_factory=SigmaPoints)
    redraw: bool = True

    @property
    def consistent(self) -> bool:
        return self.redraw

    def predict(self, plant: Plant, core: Core, t_start: float, u: Array, dt: float, rng: np.random.Generator) -> Prior:
        start, moved = plant.guard(core.x)
        batch, n = start.shape[:-1], start.shape[-1]
        Q, guarded, lost = dense(plant.process_cov_over(dt)), moved.copy(), np.zeros(batch, bool)

        def one(index: tuple[int, ...]) -> tuple[Array, ...]:
            own = self._filter(n, 1, dt)
            own.fx = lambda points, dt: guarded_points(plant, t_start, points, u[index], dt)
            own.x, own.P, own.Q = start[index], core.P[index], Q
            own.predict()
            guarded[index] |= own.stepped.moved | own.stepped.stuck
            lost[index] = own.stepped.lost
            return own.x, own.P, own.sigmas_f if self.redraw else own.stepped.ahead

        x, P, points = _each(one, batch, (n,), (n, n), (2 * n + 1, n))
        return Prior(GaussianState(x, P), guarded, lost, propagated=points)

    def _updated(self, plant: Plant, prior: Prior, t: float, y: Array, u: Array) -> Callable[[tuple[int, ...]], Any]:
        (x, P), points, sigma = prior.core, prior.propagated, np.sqrt(plant.sensor_cov)
        assert points is not None
        centre = readings_of(plant, t, points[..., 0, :], u)

        def of(index: tuple[int, ...]) -> UnscentedKalmanFilter:
            used = np.isfinite(y[index])
            own = self._filter(x.shape[-1], int(used.sum()), plant.dt)
            own.hx = lambda point: (plant.near(readings_of(plant, t, point, u[index]), centre[index]) / sigma)[used]
            own.x, own.P, own.sigmas_f = x[index], P[index], points[index]
            own.update((y[index] / sigma)[used] if used.any() else None)
            return own

        return of

    def _filter(self, states: int, readings: int, dt: float) -> _Unscented:
        points = MerweScaledSigmaPoints(states, self.points.alpha, self.points.beta, self.points.kappa, sqrt_method=_root)
        return _Unscented(states, readings, dt, None, None, points)


def _root(P: Array) -> Array:
    """U with U' U = P: SciPy's Cholesky factor, as in filterpy, and for a singular P, of states that are known, our root."""
    try:
        return np.asarray(cholesky(_finite(P)))
    except np.linalg.LinAlgError:
        return square_root(P).T


def _finite(A: Array) -> Array:
    """A; LinAlgError where it has other than finite numbers, for which SciPy raises ValueError."""
    if not np.isfinite(A).all():
        raise np.linalg.LinAlgError("not finite")
    return A


def _each(one: One, batch: tuple[int, ...], *shapes: tuple[int, ...]) -> list[Array]:
    """What `one` gives for each run of a batch, as arrays (*batch, *shape); NaN where linear algebra fails."""
    found = [np.full((*batch, *shape), np.nan) for shape in shapes]
    for index in np.ndindex(batch):
        try:
            values = one(index)
        except np.linalg.LinAlgError:
            continue
        for array, value in zip(found, values, strict=True):
            array[index] = value
    return found
