"""Lorenz-96 (see `lorenz_96`) by other packages, each as fast as its users can make it, and by NumPy alone.

One thread, double precision, the right-hand side by indices. What takes a batch of states is given them at once: Stone Soup's
models, dynamax (compiled by JAX, and warm). filterpy and pykalman call the model state by state. A call repeats one prediction
and one update of x and P from the same values, and gives the estimate (63,).

KINDS: "kf" with the tangent of the step; "ukf", which draws its points again before the update, with alpha 1, beta 0 and
kappa 3 - n, which all four packages can; "enkf" with 40 members and perturbed readings; "bank": 63 linear filters, each
without one sensor, with estimates (63, 63). None where a package has no such filter.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from datetime import datetime, timedelta
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.benchmarks.speed.support.against_filterpy import MEMBERS
from fusion_sfdia.benchmarks.speed.support.lorenz_96 import AHEAD, BEHIND, DT, FAR, FORCING, SIZE, lorenz_96
from fusion_sfdia.derivatives.equation import complex_step_jacobian
from fusion_sfdia.detectors.kalman_banks.fusing_bank import FusingBank
from fusion_sfdia.filters import ekf, enkf, ukf
from fusion_sfdia.filters.gaussian import condition

Array = NDArray[Any]
Call = Callable[[], Array]

KINDS = ("kf", "ukf", "enkf", "bank")
X, P = FORCING + 0.1 * np.sin(np.arange(SIZE)), np.eye(SIZE)
Q, R, Y = 0.01 * np.eye(SIZE), np.eye(SIZE), FORCING + np.cos(np.arange(SIZE))
POINTS = {"alpha": 1.0, "beta": 0.0, "kappa": 3.0 - SIZE}


def rate(x: Array) -> Array:
    """The right-hand side for states (..., 63)."""
    return (x.take(AHEAD, -1) - x.take(FAR, -1)) * x.take(BEHIND, -1) - x + FORCING


def step(x: Array) -> Array:
    """One Runge-Kutta step of states (..., 63), in NumPy or JAX."""
    k1 = rate(x)
    k2 = rate(x + DT / 2 * k1)
    k3 = rate(x + DT / 2 * k2)
    moved: Array = x + DT / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + DT * k3))
    return moved


@cache
def tangent() -> Array:
    """The Jacobian of the step at X."""
    return complex_step_jacobian(step, X)


def bank_of(linear: Callable[[Array], Call]) -> Call:
    """The linear filters of all sensors but one, for each sensor; linear: the filter of the sensors with these indices."""
    each = [linear(np.delete(np.arange(SIZE), i)) for i in range(SIZE)]
    return lambda: np.array([call() for call in each])


def this_package(kind: str) -> Call | None:
    """The filters of this package, on the plant; "bank" with mixture and diagnosis too."""
    plant, nothing, H = lorenz_96("indices"), np.empty(0), np.eye(SIZE)

    def move(s: Array) -> Array:
        return plant.step(0.0, s, nothing, DT)

    if kind == "kf":
        F = tangent()

        def linear() -> Array:
            mean, cov = ekf.predict(X, P, lambda s: F @ s, F, np.diag(Q))
            return condition(ekf.joint(mean, cov, lambda s: H @ s, H, np.diag(R)), Y).x

        return linear
    if kind == "ukf":
        points = ukf.SigmaPoints(**POINTS)

        def unscented() -> Array:
            mean, cov, _ = ukf.predict(points, X, P, move, np.diag(Q))
            return condition(ukf.joint(points, mean, cov, lambda s: s, np.diag(R)), Y).x

        return unscented
    if kind == "enkf":
        settings, rng = enkf.EnKFSettings(MEMBERS), np.random.default_rng(0)
        members = X + rng.standard_normal((MEMBERS, SIZE))

        def ensemble() -> Array:
            ahead = enkf.predict(members, move, np.diag(Q), rng)
            return np.asarray(np.mean(enkf.update(settings, ahead, lambda s: s, Y, np.diag(R), rng), axis=0))

        return ensemble
    bank = FusingBank(plant, thresholds=(10.0,) * SIZE)
    start = bank.init((), -DT)
    return lambda: bank.step(start, 0.0, Y, nothing)[1].estimate


def numpy_by_hand(kind: str) -> Call | None:
    """What an engineer writes who needs just this filter."""
    F, rng = tangent(), np.random.default_rng(0)
    if kind == "kf":

        def linear() -> Array:
            x, p = F @ X, F @ P @ F.T + Q
            gain = np.linalg.solve(p + R, p).T
            x, p = x + gain @ (Y - x), p - gain @ p
            return x

        return linear
    if kind == "ukf":
        scale = np.sqrt(POINTS["alpha"] ** 2 * (SIZE + POINTS["kappa"]))
        first = 1 - SIZE / scale**2
        mean = np.concatenate([[first], np.full(2 * SIZE, 0.5 / scale**2)])
        weight = mean + np.eye(1, 2 * SIZE + 1)[0] * (1 - POINTS["alpha"] ** 2 + POINTS["beta"])

        def drawn(x: Array, p: Array) -> Array:
            spread = scale * np.linalg.cholesky(p).T
            return np.concatenate([x[None], x + spread, x - spread])

        def unscented() -> Array:
            points = step(drawn(X, P))
            x = mean @ points
            apart = points - x
            p = (weight * apart.T) @ apart + Q
            again = drawn(x, p)
            predicted = mean @ again
            apart = again - predicted
            cross = (weight * apart.T) @ apart
            gain = np.linalg.solve(cross + R, cross).T
            x, p = x + gain @ (Y - predicted), p - gain @ cross
            return np.asarray(x)

        return unscented
    if kind == "enkf":
        members, q = X + rng.standard_normal((MEMBERS, SIZE)), np.sqrt(np.diag(Q))

        def ensemble() -> Array:
            ahead = step(members) + q * rng.standard_normal((MEMBERS, SIZE))
            apart = ahead - ahead.mean(axis=0)
            cov = apart.T @ apart / (MEMBERS - 1)
            read = Y + rng.standard_normal((MEMBERS, SIZE))
            return np.asarray((ahead + np.linalg.solve(cov + R, (read - ahead).T).T @ cov).mean(axis=0))

        return ensemble
    keep = [np.delete(np.arange(SIZE), i) for i in range(SIZE)]
    H = np.eye(SIZE)[np.array(keep)]  # (63, 62, 63)
    x0, p0 = np.broadcast_to(X, (SIZE, SIZE)), np.broadcast_to(P, (SIZE, SIZE, SIZE))
    y, r = Y[np.array(keep)], np.eye(SIZE - 1)

    def bank() -> Array:
        x, p = x0 @ F.T, F @ p0 @ F.T + Q
        hp = H @ p
        gain = np.linalg.solve(hp @ H.swapaxes(-1, -2) + r, hp).swapaxes(-1, -2)
        x, p = x + (gain @ (y - (H @ x[..., None])[..., 0])[..., None])[..., 0], p - gain @ hp
        return x

    return bank


def by_filterpy(kind: str) -> Call | None:
    """filterpy, which takes one state at a time."""
    from filterpy.kalman import EnsembleKalmanFilter, KalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

    def linear(keep: Array) -> Call:
        one = KalmanFilter(SIZE, keep.size)
        one.F, one.H, one.Q, one.R = tangent(), np.eye(SIZE)[keep], Q, np.eye(keep.size)

        def call() -> Array:
            one.x, one.P = X, P
            one.predict()
            one.update(Y[keep])
            return np.asarray(one.x)

        return call

    everything = np.arange(SIZE)
    if kind == "kf":
        return linear(everything)
    if kind == "bank":
        return bank_of(linear)
    if kind == "ukf":
        points = MerweScaledSigmaPoints(SIZE, **POINTS)
        sigma = UnscentedKalmanFilter(SIZE, SIZE, DT, hx=lambda x: x, fx=lambda x, dt: step(x), points=points)
        sigma.Q, sigma.R = Q, R

        def unscented() -> Array:
            sigma.x, sigma.P = X, P
            sigma.predict()
            sigma.update(Y)
            return np.asarray(sigma.x)

        return unscented
    many = EnsembleKalmanFilter(X, P, SIZE, DT, MEMBERS, hx=lambda x: x, fx=lambda x, dt: step(x))
    many.Q, many.R = Q, R
    members = many.sigmas.copy()

    def ensemble() -> Array:
        many.sigmas = members.copy()
        many.predict()
        many.update(Y)
        return np.asarray(many.x)

    return ensemble


def by_pykalman(kind: str) -> Call | None:
    """pykalman, which takes one state at a time and has no ensemble."""
    from pykalman import AdditiveUnscentedKalmanFilter, KalmanFilter

    def linear(keep: Array) -> Call:
        one = KalmanFilter(
            tangent(), np.eye(SIZE)[keep], Q, np.eye(keep.size), initial_state_mean=X, initial_state_covariance=P
        )
        return lambda: np.asarray(one.filter_update(X, P, Y[keep])[0])

    everything = np.arange(SIZE)
    if kind == "kf":
        return linear(everything)
    if kind == "bank":
        return bank_of(linear)
    if kind == "ukf":
        sigma = AdditiveUnscentedKalmanFilter(step, lambda x: x, Q, R, X, P)
        return lambda: np.asarray(sigma.filter_update(X, P, Y)[0])
    return None


def by_stonesoup(kind: str) -> Call | None:
    """Stone Soup, whose models take many states at once."""
    from stonesoup.models.base import TimeVariantModel
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.linear import LinearGaussianTimeInvariantTransitionModel
    from stonesoup.models.transition.nonlinear import GaussianTransitionModel
    from stonesoup.predictor.ensemble import EnsemblePredictor
    from stonesoup.predictor.kalman import KalmanPredictor, UnscentedKalmanPredictor
    from stonesoup.types.array import StateVector, StateVectors
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import EnsembleState, GaussianState
    from stonesoup.updater.ensemble import EnsembleUpdater
    from stonesoup.updater.kalman import KalmanUpdater, UnscentedKalmanUpdater

    class Lorenz(GaussianTransitionModel, TimeVariantModel):  # type: ignore[misc]
        ndim_state = SIZE

        def covar(self, **_: Any) -> Array:
            return Q

        def function(self, state: Any, noise: Any = False, **options: Any) -> Any:
            moved = step(np.asarray(state.state_vector, float).T).T
            if noise is True:
                moved = moved + 0.1 * np.random.standard_normal(moved.shape)
            return moved.view(StateVectors if moved.shape[1] > 1 else StateVector)

    now = datetime(2000, 1, 1)
    then = now + timedelta(seconds=DT)

    def filtered(predictor: Any, updater: Any, prior: Callable[[], Any], read: Any) -> Call:
        def call() -> Array:
            ahead = predictor.predict(prior(), timestamp=then)  # a new prior: the last one's prediction is kept
            found = updater.update(SingleHypothesis(ahead, Detection(read, timestamp=then)))
            return np.asarray(found.mean if kind == "enkf" else found.state_vector, float).ravel()

        return call

    def gaussian() -> Any:
        return GaussianState(X[:, None].view(StateVector), P, timestamp=now)

    def linear(keep: Array) -> Call:
        moves = LinearGaussianTimeInvariantTransitionModel(transition_matrix=tangent(), covariance_matrix=Q)
        reads = LinearGaussian(SIZE, list(keep), np.eye(keep.size))
        return filtered(KalmanPredictor(moves), KalmanUpdater(reads), gaussian, Y[keep, None].view(StateVector))

    everything = np.arange(SIZE)
    whole, read = LinearGaussian(SIZE, list(range(SIZE)), R), Y[:, None].view(StateVector)
    if kind == "kf":
        return linear(everything)
    if kind == "bank":
        return bank_of(linear)
    if kind == "ukf":
        return filtered(UnscentedKalmanPredictor(Lorenz(), **POINTS), UnscentedKalmanUpdater(whole, **POINTS), gaussian, read)
    members = (X + np.random.default_rng(0).standard_normal((MEMBERS, SIZE))).T.view(StateVectors)
    return filtered(EnsemblePredictor(Lorenz()), EnsembleUpdater(whole), lambda: EnsembleState(members, timestamp=now), read)


def by_dynamax(kind: str) -> Call | None:
    """dynamax, compiled by JAX for this processor: its own prediction and update, for the bank mapped over the filters."""
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
    import jax

    jax.config.update("jax_enable_x64", True)
    import jax.numpy as jnp
    from dynamax.linear_gaussian_ssm import inference as linear
    from dynamax.nonlinear_gaussian_ssm import inference_ukf as unscented

    none, zero = jnp.zeros(1), jnp.zeros((SIZE, 1))
    F = jnp.asarray(tangent())

    def kalman(x: Any, p: Any, y: Any, H: Any) -> Any:
        size = y.shape[0]
        mean, cov = linear._predict(x, p, F, zero, jnp.zeros(SIZE), jnp.asarray(Q), none)
        return linear._condition_on(mean, cov, H, zero[:size], jnp.zeros(size), jnp.eye(size), none, y)

    def sigma(x: Any, p: Any, y: Any, _: Any) -> Any:
        lam = POINTS["alpha"] ** 2 * (SIZE + POINTS["kappa"]) - SIZE
        weights = unscented._compute_weights(SIZE, POINTS["alpha"], POINTS["beta"], lam)
        mean, cov, _ = unscented._predict(x, p, lambda s, u: step(s), jnp.asarray(Q), lam, *weights, none)
        return unscented._condition_on(mean, cov, lambda s, u: s, jnp.asarray(R), lam, *weights, none, y)[1:]

    if kind == "enkf":
        return None
    given: tuple[Any, ...] = (X, P, Y, np.eye(SIZE))
    run: Any = sigma if kind == "ukf" else kalman
    if kind == "bank":
        keep = np.array([np.delete(np.arange(SIZE), i) for i in range(SIZE)])
        given = (np.tile(X, (SIZE, 1)), np.tile(P, (SIZE, 1, 1)), Y[keep], np.eye(SIZE)[keep])
        run = jax.vmap(kalman)
    compiled, arrays = jax.jit(run), [jnp.asarray(a) for a in given]
    return lambda: np.asarray(jax.block_until_ready(compiled(*arrays))[0])


PEERS: dict[str, tuple[str | None, Callable[[str], Call | None]]] = {  # the package that it needs, and what makes its calls
    "fusion-sfdia": (None, this_package),
    "NumPy by hand": (None, numpy_by_hand),
    "filterpy": ("filterpy", by_filterpy),
    "stonesoup": ("stonesoup", by_stonesoup),
    "dynamax": ("dynamax", by_dynamax),
    "pykalman": ("pykalman", by_pykalman),
}
