"""What can be detected before any data: against differences of the filter itself, and against simulation."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.special import ndtr
from toy_plants import Array, chain, tanks

from fusion_sfdia.detectors.detector import run
from fusion_sfdia.detectors.kalman_banks.identifiability import NEEDED, identifiability
from fusion_sfdia.detectors.kalman_banks.leave_one_out import posterior, statistics
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.filters.estimators import Extended, GaussianState, step_stream
from fusion_sfdia.models.marine_engine.plant import marine_engine
from fusion_sfdia.models.two_tanks.plant import two_tanks
from fusion_sfdia.plant.augment import augment
from fusion_sfdia.plant.linear import linear_plant
from fusion_sfdia.plant.plant import Numerics, Plant
from fusion_sfdia.plant.secants import secants
from fusion_sfdia.plant.signals import Sensor
from fusion_sfdia.plant.uncertainty import Disturbance, Parameter, Uncertainty

SETTLE, SAMPLES = 30, 40
RUNS = 400
SMALL = 1e-4  # of a fault, for differences


@cache
def uncertain_tanks() -> Plant:
    """The tanks with an outlet known to 5 %, which drifts, and an inflow known to 5 %."""
    outlet = Parameter("outlet", "1", 1.0, 0.05, rate=2e-3)
    return replace(tanks(), uncertainty=secants(tanks(), (outlet,), two_tanks, inputs={"inflow": 3e-5}))


@cache
def uncertain_engine() -> Plant:
    plant = marine_engine()
    return replace(plant, uncertainty=Uncertainty(inputs={s.name: 0.02 * abs(s.nominal) for s in plant.inputs}))


class Filtered(NamedTuple):
    """Innovations (K, B, N) of readings, the inverses of their covariances (K, B, N, N), and the state after the last."""

    innovations: Array
    inverses: Array
    end: GaussianState


def filtered(plant: Plant, y: Array, start: GaussianState | None = None, first: int = 0) -> Filtered:
    """The filter on readings y (K, B, N) from the sample `first`, which goes on from `start` or begins as the plant states."""
    estimator, none = Extended(), step_stream(0, 0)
    state = estimator.start(plant, y.shape[1:2], none) if start is None else start
    innovations, inverses = [], []
    for k, now in enumerate(y, first):
        t, u = k * plant.dt, np.broadcast_to(plant.input_at(k * plant.dt), (y.shape[1], len(plant.inputs)))
        prior = estimator.predict(plant, state, t, u, plant.dt, none)
        joint = estimator.joint(plant, prior, t + plant.dt, u)
        found = statistics(joint, now, np.ones(now.shape, bool))
        innovations.append(now - joint.y)
        inverses.append(found.inverse)
        state = GaussianState(*posterior(joint, found))
    return Filtered(np.stack(innovations), np.stack(inverses), state)


def readings(plant: Plant, jump: Array | None = None, rng: np.random.Generator | None = None, runs: int = 1) -> Array:
    """Readings (K, B, N) along the usual operation, with states that jump after SETTLE samples; with noise for an rng."""
    start = (runs, len(plant.states))

    def noise(cov: Array, shape: tuple[int, ...]) -> Any:
        return 0.0 if rng is None else np.sqrt(cov) * rng.standard_normal(shape)

    z, y = np.broadcast_to(plant.x0, start) + noise(plant.initial_cov, start), []
    for k in range(SETTLE + SAMPLES):
        if k == SETTLE and jump is not None:
            z = z + jump
        u = np.broadcast_to(plant.input_at(k * plant.dt), (runs, len(plant.inputs)))
        z = plant.step(k * plant.dt, z, u, plant.dt) + noise(plant.process_cov, start)
        y.append(plant.output((k + 1) * plant.dt, z, u) + noise(plant.sensor_cov, (runs, len(plant.sensors))))
    return np.stack(y)


def faults(plant: Plant, kind: str) -> Array:
    """A fault of each sensor (sensors, K, 1, N) of its sigma: a bias, or a drift that ends at it."""
    growth = np.ones(SAMPLES) if kind == "bias" else np.arange(1, SAMPLES + 1) / SAMPLES
    of_one = np.concatenate([np.zeros(SETTLE), growth])
    return of_one[:, None, None] * (np.eye(len(plant.sensors)) * plant.sensor_sigma)[:, None, None, :]


def signature(plant: Plant, above: Array, below: Array) -> Array:
    """Half the difference of the innovations (SAMPLES, B, N) of readings (K, B, N) over the size of a small fault in both."""
    one, two = np.split(filtered(plant, np.concatenate([above, below], axis=1)).innovations[SETTLE:], 2, axis=1)
    return np.asarray((one - two) / (2 * SMALL))


def of_sensors(plant: Plant, kind: str) -> Array:
    """The change of innovations (sensors, SAMPLES, N) for each unit of a fault of each sensor."""
    healthy, change = readings(plant), SMALL * np.concatenate(list(faults(plant, kind)), axis=1)
    return np.swapaxes(signature(plant, healthy + change, healthy - change), 0, 1)


def of_jump(plant: Plant, jump: Array) -> Array:
    """That (SAMPLES, N) of a jump of the states."""
    return signature(plant, readings(plant, SMALL * jump), readings(plant, -SMALL * jump))[:, 0]


def inverses(plant: Plant) -> Array:
    return filtered(plant, readings(plant)).inverses[SETTLE:, 0]


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("kind", ["bias", "drift"])
def test_limits_are_those_of_the_filter_itself(kind: str, known: bool) -> None:
    """b = sum M' S^-1 M with M from the innovations of the filter with and without the fault.

    Central differences of 1e-4 sigma, 1e-6 of the state, have errors of the square of that and of rounding, 1e-16 / 1e-6.
    """
    plant = tanks() if known else augment(uncertain_tanks())
    found = getattr(identifiability(uncertain_tanks(), SAMPLES, SETTLE), kind + "_known" * known)
    M = of_sensors(plant, kind)
    b = np.einsum("ski,kij,skj->s", M, inverses(plant), M)
    np.testing.assert_allclose(found, NEEDED / np.sqrt(b), rtol=1e-7)


def test_rho_is_that_of_the_filter_itself() -> None:
    plant = augment(uncertain_tanks())
    found = identifiability(uncertain_tanks(), SAMPLES, SETTLE)
    assert found.hypotheses == ("outlet", "error of inflow")
    M, weight = of_sensors(plant, "bias"), inverses(plant)
    b_sensors = np.einsum("ski,kij,skj->s", M, weight, M)
    for j in range(2):
        jump = np.zeros(4)
        jump[2 + j] = np.sqrt(plant.initial_cov[2 + j])
        N = of_jump(plant, jump)
        rho = np.einsum("ski,kij,kj->s", M, weight, N) / np.sqrt(b_sensors * np.einsum("ki,kij,kj", N, weight, N))
        np.testing.assert_allclose(found.rho[:, j], rho, rtol=0, atol=1e-7)


@cache
def runs_of(stated: Callable[[], Plant]) -> tuple[Array, GaussianState]:
    """Readings (K, RUNS, N) whose parameters and inputs are drawn from what the plant states, and the filter after SETTLE."""
    plant = augment(stated())
    healthy = readings(plant, rng=np.random.default_rng(1), runs=RUNS)
    return healthy, filtered(plant, healthy[:SETTLE]).end


def require_mean_of_5(plant: Plant, M: Array, settled: GaussianState, y: Array) -> None:
    """The statistic a / sqrt(b) of readings y (SAMPLES, RUNS, N) for a signature M (SAMPLES, N) has mean 5 and variance 1.

    The filter goes on from its state after the SETTLE samples before. The statistic is above thresholds of 3.29 and 5 in shares
    of Phi(5 - h) of the runs, within 3.5 standard errors of a binomial share.
    """
    weight = inverses(plant)
    a = np.einsum("ki,kij,kbj->b", M, weight, filtered(plant, y, settled, SETTLE).innovations)
    found = a / np.sqrt(np.einsum("ki,kij,kj", M, weight, M))
    for threshold, expected in ((3.29, ndtr(NEEDED - 3.29)), (5.0, 0.5)):
        share = np.mean(np.abs(found) > threshold)
        assert abs(share - expected) <= 3.5 * np.sqrt(expected * (1 - expected) / RUNS)


@pytest.mark.parametrize("kind", ["bias", "drift"])
@pytest.mark.parametrize(
    ("stated", "sensors"),
    [(uncertain_tanks, range(4)), pytest.param(uncertain_engine, (0, 3, 7), marks=pytest.mark.long)],
    ids=["tanks", "engine"],
)
def test_the_smallest_detectable_faults_are_detected(stated: Callable[[], Plant], sensors: Iterable[int], kind: str) -> None:
    """In runs whose parameters and inputs are drawn from what the plant states."""
    plant, sizes = augment(stated()), getattr(identifiability(stated(), SAMPLES, SETTLE), kind)
    (healthy, settled), M = runs_of(stated), of_sensors(plant, kind)
    for i in sensors:
        require_mean_of_5(plant, M[i], settled, (healthy + sizes[i] * faults(plant, kind)[i])[SETTLE:])


@pytest.mark.parametrize(
    "stated", [uncertain_tanks, pytest.param(uncertain_engine, marks=pytest.mark.long)], ids=["tanks", "engine"]
)
def test_a_bank_with_that_window_detects_them_at_least_as_often(stated: Callable[[], Plant]) -> None:
    """loo-glr tests all onsets in its window, the true one among them: at the window's end at least Phi(5 - h) of the runs."""
    plant = augment(stated())
    bank = LeaveOneOutBank(plant, window=SAMPLES, accommodate=False)
    sizes, h = identifiability(stated(), SAMPLES, SETTLE).bias, np.sqrt(bank.limits[1])
    least, healthy = ndtr(NEEDED - h), readings(plant, rng=np.random.default_rng(3), runs=RUNS)
    t = np.arange(1, SETTLE + SAMPLES + 1) * plant.dt
    u = np.stack([np.broadcast_to(plant.input_at(now - plant.dt), (RUNS, len(plant.inputs))) for now in t])
    for i in (0, len(sizes) - 1):
        y = healthy + sizes[i] * faults(plant, "bias")[i]
        _, decisions = run(bank, bank.init(RUNS), t, y, u)
        share = np.mean(decisions.scores[-1, :, i] > 1)
        error = np.sqrt(least * (1 - least) / RUNS)
        assert least - 3.5 * error <= share <= least + 3.5 * error + 0.1  # other onsets add little


def test_what_can_be_told_apart_is_detected_beside_its_rival() -> None:
    """The statistic less its share with the jump of the outlet, in runs with such a jump of 1 %, itself well detected.

    A larger one has an effect beyond its signature, which is linear.
    """
    plant, found = augment(uncertain_tanks()), identifiability(uncertain_tanks(), SAMPLES, SETTLE)
    assert found.rival == ("outlet",) * 4
    jump = np.array([0, 0, 0.01, 0])
    N, weight, M = of_jump(plant, jump), inverses(plant), of_sensors(plant, "bias")
    b = np.einsum("ki,kij,kj", N, weight, N)
    assert np.sqrt(b) > NEEDED
    y = readings(plant, jump, np.random.default_rng(2), RUNS)
    settled = filtered(plant, y[:SETTLE]).end
    for i in range(4):
        apart = M[i] - N * np.einsum("ki,kij,kj", M[i], weight, N) / b
        require_mean_of_5(plant, apart, settled, (y + found.told_apart[i] * faults(plant, "bias")[i])[SETTLE:])


def test_an_absorbed_bias_has_the_limit_of_the_scalar_filter() -> None:
    """A random walk read by one sensor: M_k = (1 - K)^(k - 1), so that b = 1 / (S (1 - (1 - K)^2)), in the steady state."""
    Q, R = 0.04, 1.0
    predicted = Q / 2 + np.sqrt(Q**2 / 4 + Q * R)
    S, K = predicted + R, predicted / (predicted + R)
    walk = linear_plant(
        "walk", np.eye(1), np.eye(1), [Sensor("s", "x", sigma=1.0)], dt=1.0, x0=np.zeros(1),
        initial_cov=np.array([predicted - Q]), process_cov=np.array([Q]),
    )  # fmt: skip
    found = identifiability(walk, np.inf, 0)
    b = (1 - (1 - K) ** (2 * found.samples)) / (S * (1 - (1 - K) ** 2))
    np.testing.assert_allclose(found.bias, NEEDED / np.sqrt(b), rtol=1e-9)
    assert found.samples == 128  # as many as lower it by less than a hundredth of that after 64
    np.testing.assert_allclose(identifiability(walk, 1, 0).bias, NEEDED * np.sqrt(S), rtol=1e-12)
    np.testing.assert_array_equal(found.bias_known, found.bias)
    assert found.hypotheses == () and found.rival == ("",) and found.overlap.tolist() == [0.0]


def test_a_disturbance_of_one_reading_is_its_bias() -> None:
    """rho = -1 or 1: nothing tells them apart, and a sentence says so."""
    plant = chain(3)
    off = Disturbance("offset", np.zeros(3), np.array([0.0, 1.0, 0.0]), sd=10.0)
    found = identifiability(replace(plant, uncertainty=Uncertainty(disturbances=(off,))), 20, 20)
    np.testing.assert_allclose(np.abs(found.rho[1, 0]), 1.0, rtol=1e-12)
    assert found.rival == ("offset",) * 3 and found.told_apart[1] > 1e5 > 1e3 * found.told_apart[0]
    assert np.all(found.bias >= found.bias_known * (1 - 1e-12)) and found.bias[1] > found.bias_known[1]
    (warning,) = [w for w in found.warnings if w.startswith("s1: a bias")]
    assert warning.startswith("s1: a bias looks like offset (rho 1.00); they are told apart from ")
    assert re.search(r"^s1 .* 1\.00 ! +offset", str(found), re.MULTILINE) and not re.search(
        r"^s0 .*!", str(found), re.MULTILINE
    )


def test_free_outlets_leave_no_static_information_about_levels() -> None:
    """At rest flow = outlet sqrt(level): an outlet explains a wrong level as well, however long one waits."""
    short, long = (identifiability(tanks(), samples) for samples in (60, 480))
    assert np.all(long.bias_known < 0.45 * short.bias_known)  # as 1 / sqrt(samples), 0.35
    assert np.all(long.told_apart[:2] > 0.9 * short.told_apart[:2]) and np.all(long.told_apart[:2] > 2)
    assert long.rival[:2] == ("outlet_1", "outlet_2")


def test_large_limits_are_marked() -> None:
    """Within one sample a bias is seen against the noise of that sample alone."""
    found = identifiability(replace(tanks(), uncertainty=Uncertainty()), 1)
    assert np.all(found.bias > 5) and len(found.warnings) == 8
    assert found.warnings[0] == f"l1: only a bias of {found.bias[0]:.3g} sigma or more is detected and told apart"
    assert found.warnings[1] == f"l1: only a drift to {found.drift[0]:.3g} sigma or more in 1 samples is detected"
    lines = str(found).splitlines()
    assert lines[0].startswith("two-tanks: smallest sensor faults within 1 samples") and repr(found) == str(found)
    assert lines[2].split()[:3] == ["l1", "0.01", "m"] and lines[2].count("!") == 5


def test_limits_do_not_change_with_units() -> None:
    plant = uncertain_tanks()
    in_other = identifiability(plant.in_units({"l1": ("mm", 1e3), "q2": ("l/h", 3.6e6)}))
    for name in ("bias", "bias_known", "drift", "drift_known", "told_apart", "rho"):
        np.testing.assert_allclose(getattr(in_other, name), getattr(identifiability(plant), name), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [((0,), "samples"), ((2.5,), "samples"), ((4000,), "samples is 4000; expected at most 3840, or inf"), ((60, -1), "settle")],
)
def test_other_numbers_are_refused(arguments: tuple[Any, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        identifiability(tanks(), *arguments)


def test_a_model_without_numbers_is_refused() -> None:
    plant = tanks()
    broken = replace(plant, output=partial(_failing, plant.output), numerics=Numerics(output_jacobian=_zero))
    with pytest.raises(ValueError, match="two-tanks' has no finite readings at 100 s of its usual operation; give another"):
        identifiability(broken)


def _failing(output: Any, t: float, x: Array, u: Array) -> Array:
    return output(t, x, u) * (1.0 if t < 100 else np.nan)


def _zero(t: float, x: Array, u: Array) -> Array:
    return np.full((*x.shape[:-1], 4, 2), 0.0 if t < 100 else np.nan)
