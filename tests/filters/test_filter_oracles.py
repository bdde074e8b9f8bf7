"""Reference numbers for the filters: a published pendulum, the Lorenz tables of data assimilation, filterpy."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import filterpy.kalman as fp
import numpy as np
import pytest
from numpy.typing import NDArray

from fusion_sfdia.filters import ekf, enkf, ukf
from fusion_sfdia.filters.enkf import EnKFSettings
from fusion_sfdia.filters.gaussian import condition
from fusion_sfdia.filters.ukf import SigmaPoints
from fusion_sfdia.plant.integration import runge_kutta_4

Array = NDArray[Any]

DT, GRAVITY = 0.01, 9.81


def pendulum(x: Array) -> Array:
    return np.stack([x[..., 0] + DT * x[..., 1], x[..., 1] - GRAVITY * DT * np.sin(x[..., 0])], -1)


@pytest.mark.parametrize(
    ("points", "rmse"),
    [
        (None, 0.16830859061153763),
        (SigmaPoints(1.0, 0.0, 1.0), 0.09524392125923083),
        (SigmaPoints(1.0, 0.0, 0.0), 0.1141966031380275),  # the cubature rule
    ],
)
def test_pendulum(shared_fixtures: Path, points: SigmaPoints | None, rmse: float) -> None:
    """RMSE of the angle over the 500 samples of Bayesian Filtering and Smoothing's companion code (Sarkka and Svensson)."""
    data = json.loads((shared_fixtures / "sarkka_bfs" / "pendulum.json").read_text())
    Q = 0.01 * np.array([[DT**3 / 3, DT**2 / 2], [DT**2 / 2, DT]])
    R = np.array([0.1])
    x, P = np.zeros(2), np.eye(2)
    errors = []
    for y, truth in zip(np.array(data["Y"]).reshape(-1, 1), np.array(data["X"]).T, strict=True):
        if points is None:
            x, P = ekf.predict(x, P, pendulum, None, Q)
            joint = ekf.joint(x, P, lambda s: np.sin(s[..., :1]), None, R)
        else:
            x, P, _ = ukf.predict(points, x, P, pendulum, Q)
            joint = ukf.joint(points, x, P, lambda s: np.sin(s[..., :1]), R)
        x, P = condition(joint, y)[:2]
        errors.append(x[0] - truth[0])
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(rmse, abs=1e-9)


def lorenz_96(x: Array) -> Array:
    around = np.concatenate([x[..., -2:], x, x[..., :1]], axis=-1)
    return np.asarray((around[..., 3:] - around[..., :-3]) * around[..., 1:-2] - x + 8.0)


def lorenz_63(x: Array) -> Array:
    a, b, c = x[..., 0], x[..., 1], x[..., 2]
    return np.stack([10 * (b - a), a * (28 - c) - b, a * b - 8 / 3 * c], axis=-1)


def stepper(slope: Callable[[Array], Array], dt: float, substeps: int) -> Callable[[Array], Array]:
    def step(x: Array) -> Array:
        for _ in range(substeps):
            x = runge_kutta_4(lambda t, p: slope(p), 0.0, x, dt)
        return x

    return step


class Twin:
    """A batch of independent runs: a truth without model noise, read everywhere after every step with variance R.

    `rmse` is the root mean square error over the states, averaged over the steps after `burn`, one number a run. The systems
    are chaotic, so rounding makes other runs on another machine: limits leave four standard errors.
    """

    def __init__(self, step: Callable[[Array], Array], x0: Array, spread: float, noise: float, runs: int, seed: int) -> None:
        self.step, self.noise, self.rng = step, noise, np.random.default_rng(seed)
        self.x0, self.spread = x0, spread
        self.truth = x0 + np.sqrt(spread) * self.rng.standard_normal((runs, x0.size))

    def read(self) -> Array:
        self.truth = self.step(self.truth)
        return np.asarray(self.truth + np.sqrt(self.noise) * self.rng.standard_normal(self.truth.shape))

    def rmse(self, analyse: Callable[[Array], Array], steps: int, burn: int) -> Array:
        errors = []
        for _ in range(steps):
            x = analyse(self.read())
            errors.append(np.sqrt(np.mean((x - self.truth) ** 2, axis=-1)))
        return np.asarray(np.mean(errors[burn:], axis=0))

    def ensemble_rmse(self, settings: EnKFSettings, steps: int, burn: int) -> Array:
        n, runs = self.x0.size, len(self.truth)
        members = self.x0 + np.sqrt(self.spread) * self.rng.standard_normal((runs, settings.size, n))

        def analyse(y: Array) -> Array:
            nonlocal members
            members = enkf.predict(members, self.step, np.zeros(n), self.rng)
            members = enkf.update(settings, members, lambda s: s, y, np.full(n, self.noise), self.rng)
            return np.asarray(members.mean(-2))

        return self.rmse(analyse, steps, burn)


def lorenz_96_twin(runs: int, seed: int = 1) -> Twin:
    """40 states, forcing 8, dt 0.05, R = 1, from a point on the attractor (Sakov and Oke 2008, sec. 4)."""
    step = stepper(lorenz_96, 0.05, 1)
    x0 = np.full(40, 8.0)
    x0[0] += 0.01
    for _ in range(1000):
        x0 = step(x0)
    return Twin(step, x0, 0.001, 1.0, runs, seed)


@pytest.mark.parametrize(
    ("settings", "published"),
    [
        (EnKFSettings(40, "stochastic", 1.06), 0.22),
        (EnKFSettings(40, "deterministic", 1.01), 0.18),
        (EnKFSettings(28, "stochastic", 1.08), 0.24),
        (EnKFSettings(24, "square-root", 1.013, rotate=True), 0.18),
    ],
)
def test_lorenz_96(settings: EnKFSettings, published: float) -> None:
    """The median over the runs: with random rotations about one in 40 loses track in 1000 steps (so does a literal
    transform filter without any of our algebra), and the published number is of a run that did not.
    """
    runs = lorenz_96_twin(24).ensemble_rmse(settings, 700, 300)
    lower, middle, upper = np.quantile(runs, [0.25, 0.5, 0.75])
    # standard error of a median: 1.25 sigma / sqrt(runs), sigma = interquartile range / 1.35
    assert 4 * 1.25 * (upper - lower) / 1.35 / np.sqrt(runs.size) < 0.04
    assert middle == pytest.approx(published, abs=0.02)


def test_localisation_makes_ten_members_do() -> None:
    """Lorenz-96 has 13 growing directions: ten members alone lose track (climatology is 3.6), tapered they stay below R."""
    positions = np.arange(40.0)
    taper = enkf.taper(positions, positions, 4.0, period=40.0)
    alone = lorenz_96_twin(4).ensemble_rmse(EnKFSettings(10, "deterministic", 1.05), 300, 100)
    tapered = lorenz_96_twin(4).ensemble_rmse(EnKFSettings(10, "deterministic", 1.05, localisation=taper), 300, 100)
    assert np.median(tapered) < 0.3 and np.median(alone) > 1.0


def lorenz_63_twin(runs: int, seed: int = 1) -> Twin:
    """Read every 0.25 time units with R = 2 I, steps of 0.01 (Sakov, Oliver and Bertino 2012, Table 1)."""
    return Twin(stepper(lorenz_63, 0.01, 25), np.array([1.509, -1.531, 25.46]), 2.0, 2.0, runs, seed)


@pytest.mark.parametrize(
    ("settings", "runs", "published"),
    [
        (EnKFSettings(100, "stochastic", 1.01), 30, 0.56),
        (EnKFSettings(10, "square-root", 1.02, rotate=True), 160, 0.60),
    ],
)
def test_lorenz_63(settings: EnKFSettings, runs: int, published: float) -> None:
    rmse = lorenz_63_twin(runs).ensemble_rmse(settings, 250, 20)
    assert 4 * rmse.std() / np.sqrt(runs) < 0.07
    assert rmse.mean() == pytest.approx(published, abs=0.07)


def test_lorenz_63_extended_kalman_filter() -> None:
    """The covariance grows by a factor of 180 per time unit, that is 180^0.01 a step of 0.01."""
    twin = lorenz_63_twin(120)
    small = stepper(lorenz_63, 0.01, 1)
    x, P = np.broadcast_to(twin.x0, twin.truth.shape), np.broadcast_to(twin.spread * np.eye(3), (120, 3, 3))

    def analyse(y: Array) -> Array:
        nonlocal x, P
        for _ in range(25):
            x, P = ekf.predict(x, P * 180**0.01, small, None, np.zeros(3))
        x, P = condition(ekf.joint(x, P, lambda s: s, np.eye(3), np.full(3, twin.noise)), y)[:2]
        return x

    rmse = twin.rmse(analyse, 250, 20)
    assert 4 * rmse.std() / np.sqrt(rmse.size) < 0.07
    assert rmse.mean() == pytest.approx(0.92, abs=0.07)


def test_sixty_three_states_against_filterpy() -> None:
    """Lorenz-96 with 63 states and readings, process noise, 20 steps: filterpy's unscented filter to rounding."""
    n = 63
    step = stepper(lorenz_96, 0.05, 1)
    rng = np.random.default_rng(0)
    truth = 8.0 + rng.standard_normal(n)
    source = fp.UnscentedKalmanFilter(
        n, n, 0.05, lambda s: s, lambda s, dt: step(s), fp.MerweScaledSigmaPoints(n, 0.3, 2.0, 0.0)
    )
    source.x, source.P, source.Q, source.R = truth + 0.3, 0.5 * np.eye(n), 0.01 * np.eye(n), np.eye(n)
    points, x, P = SigmaPoints(0.3, 2.0, 0.0), source.x.copy(), source.P.copy()
    for _ in range(20):
        truth = step(truth)
        y = truth + rng.standard_normal(n)
        source.predict()
        source.update(y)
        x, P, _ = ukf.predict(points, x, P, step, np.full(n, 0.01))
        x, P = condition(ukf.joint(points, x, P, lambda s: s, np.ones(n)), y)[:2]
    np.testing.assert_allclose(x, source.x, atol=1e-10)
    np.testing.assert_allclose(P, source.P, atol=1e-10)
