"""Simulation: the same bits for a seed whatever else is simulated, noise of the stated law, timing, limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest, truncnorm
from toy_plants import chain, changed, tanks

from fusion_sfdia.common.random_streams import require_seeds, stream
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.models.gas_pipeline.plant import coarse_state, gas_pipeline
from fusion_sfdia.models.power_network.plant import power_network
from fusion_sfdia.plant.linear import linear_plant
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal
from fusion_sfdia.plant.slow_noise import SlowNoise


def walk(sensor: Sensor | None = None, process_cov: float = 1.0, **changes) -> Plant:
    """One state that keeps its value, or walks at random."""
    plant = linear_plant(
        "walk", np.eye(1), np.eye(1), [sensor or Sensor("s", "x0", sigma=1.0)], dt=1.0, x0=np.zeros(1),
        initial_cov=np.full(1, 4.0), process_cov=np.full(1, process_cov),
    )  # fmt: skip
    return changed(plant, **changes)


def correlated() -> Plant:
    """Full covariances, and matrix products in the step: the hardest to repeat to the bit."""
    plant = chain(17)
    half = np.random.default_rng(1).standard_normal((17, 17))
    return replace(plant, process_cov=half @ half.T, initial_cov=half @ half.T)


@pytest.mark.parametrize(
    "plant",
    [chain(), tanks(), correlated(), gas_pipeline(), power_network()],
    ids=["chain", "tanks", "correlated", "pipeline", "network"],
)
def test_a_seed_gives_the_same_bits_alone_and_in_any_batch(plant):
    options = {"process_noise": True, "start": "sampled"}
    batch = simulate(plant, 40, [5, 3, 11, 0, 8], **options)
    alone = simulate(plant, 40, [11], **options)
    for name in ("y", "x", "signal", "u_of_runs"):
        np.testing.assert_array_equal(getattr(batch, name)[:, 2], getattr(alone, name)[:, 0])
    longer = simulate(plant, 50, [11], **options)
    np.testing.assert_array_equal(longer.y[:40], alone.y)


def test_switching_one_randomness_on_does_not_change_the_others():
    plant = chain(4)
    plain = simulate(plant, 20, [1, 2])
    noisy = simulate(plant, 20, [1, 2], process_noise=True)
    sampled = simulate(plant, 20, [1, 2], start="sampled")
    # each reading is signal + noise, rounded once: a few units in the last place of numbers of the order of 10
    for other in (noisy, sampled):
        np.testing.assert_allclose(other.y - other.signal, plain.y - plain.signal, atol=1e-14)
        assert not np.array_equal(other.signal, plain.signal)
    draws = [stream(1, name).random() for name in ("measurement noise", "process noise", "initial state", "faults")]
    assert len(set(draws)) == 4


def test_timing_of_states_inputs_and_models():
    """Each model is called with the time at which it acts, u[k] is the input that acts from t[k] - dt to t[k]."""
    called, seen = [], []

    def step(t, x, u, dt):
        called.append((t, dt))
        return x + u[..., :1] * dt

    def output(t, x, u):
        seen.append(t)
        return x + 10 * u[..., :1]

    plant = walk(
        step=step, output=output, inputs=(Signal("rate"),), operation=lambda t: np.array([t]), dt=2.0, fixed_dt=False,
    )  # fmt: skip
    called.clear(), seen.clear()  # the plant has tried both once, for their shapes
    found = simulate(plant, 3, [0], t0=100.0)
    np.testing.assert_array_equal(found.t, [102, 104, 106])
    np.testing.assert_array_equal(found.u, [[100], [102], [104]])
    assert (called, seen) == ([(100, 2), (102, 2), (104, 2)], [102, 104, 106])
    np.testing.assert_allclose(found.x[:, 0, 0], [200, 404, 612])
    np.testing.assert_allclose(found.signal[:, 0, 0], [1200, 1424, 1652])
    irregular = simulate(plant, np.array([1.0, 1.5, 4.0]), [0])
    np.testing.assert_array_equal(irregular.u, [[0], [1], [1.5]])
    np.testing.assert_allclose(irregular.x[:, 0, 0], [0, 0.5, 4.25])


def test_inputs_as_function_and_array():
    plant = tanks()
    doubled = simulate(plant, 5, [0], inputs=lambda t: np.array([1.2e-3]))
    np.testing.assert_array_equal(doubled.y, simulate(plant, 5, [0], inputs=np.full((5, 1), 1.2e-3)).y)
    assert np.all(doubled.x[..., 0] > simulate(plant, 5, [0]).x[..., 0])
    with pytest.raises(ValueError, match=r"inputs have shape \(4, 1\); expected finite values \(5, 1\)"):
        simulate(plant, 5, [0], inputs=np.zeros((4, 1)))


def test_feedback_acts_on_the_last_readings_of_each_run():
    """u[k] is made of the operation and the readings at t[k] - dt, the first of the operation alone."""
    open_loop = walk(step=lambda t, x, u, dt: x + u * dt, inputs=(Signal("rate"),), operation=lambda t: np.array([t]))
    plant = changed(open_loop, feedback=lambda t, y, u: u - 0.5 * y + t)
    found = simulate(plant, 4, [0, 1])
    assert found.u.shape == (4, 2, 1) and found.u_of_runs is found.u
    np.testing.assert_array_equal(found.u[0], 0.0)
    before = found.t[:-1, None, None]
    np.testing.assert_array_equal(found.u[1:], before - 0.5 * found.y[:-1] + before)
    np.testing.assert_array_equal(found.x[1:], found.x[:-1] + found.u[1:])
    assert simulate(plant, 4, [0, 1], inputs=np.ones((4, 1))).u.shape == (4, 1)  # given inputs act unchanged
    assert simulate(open_loop, 4, [0, 1], truth=plant).u.shape == (4, 2, 1)  # it is the truth that is controlled
    in_other_units = simulate(plant.in_units({"s": ("m", 1000.0)}), 4, [0, 1])
    np.testing.assert_allclose(in_other_units.u, found.u, rtol=1e-9)  # of noise by inversion of quantiles


def test_feedback_by_a_matrix_has_the_same_bits_alone_and_in_any_batch():
    n = 17
    gain = np.random.default_rng(2).standard_normal((n, n)) / 50
    plant = changed(
        chain(n),
        step=lambda t, x, u, dt: 0.9 * x + u,
        step_jacobian=None,
        inputs=tuple(Signal(f"u_{i}") for i in range(n)),
        operation=lambda t: np.zeros(n),
        feedback=lambda t, y, u: u - y @ gain.T,
    )
    batch, alone = simulate(plant, 20, [5, 3, 11, 0, 8]), simulate(plant, 20, [11])
    np.testing.assert_array_equal(batch.u[:, 2], alone.u[:, 0])
    np.testing.assert_array_equal(batch.y[:, 2], alone.y[:, 0])


@pytest.mark.parametrize("bad", [lambda t, y, u: u[0], lambda t, y, u: u * np.nan], ids=["shape", "nan"])
def test_feedback_that_does_not_fit_is_refused(bad):
    plant = walk(step=lambda t, x, u, dt: x + u, inputs=(Signal("rate"),), feedback=bad)
    with pytest.raises(ValueError, match=r"feedback of plant 'walk' gives shape .* at 1 s; expected finite inputs \(..., 1\)"):
        simulate(plant, 4, [0, 1])


def test_tanks_stay_at_rest_without_disturbance():
    found = simulate(tanks(), 100, [0, 1], truth="model")
    np.testing.assert_allclose(found.x, 1.0, rtol=1e-12)
    np.testing.assert_allclose(found.signal[..., 2:], 6e-4, rtol=1e-12)
    assert (found.sensors, found.states, found.inputs) == (("l1", "l2", "q12", "q2"), ("level_1", "level_2"), ("inflow",))


@pytest.mark.parametrize(
    ("sensor", "law"),
    [
        (Sensor("s", "x0", sigma=2.0), ("norm", (0, 2.0))),
        (Sensor("s", "x0", bound=0.3), ("uniform", (-0.3, 0.6))),
        (Sensor("s", "x0", sigma=1.0, bound=1.5), truncnorm(-1.5, 1.5).cdf),
    ],
    ids=["gaussian", "uniform", "truncated"],
)
def test_reading_noise_has_the_stated_law(sensor, law):
    """Kolmogorov-Smirnov on 20 000 independent errors; a true law fails one fixed seed with probability 1e-3."""
    found = simulate(walk(sensor), 200, range(100))
    noise = (found.y - found.signal).ravel()
    name, arguments = law if isinstance(law, tuple) else (law, ())
    assert kstest(noise, name, arguments).pvalue > 1e-3
    assert np.abs(noise).max() <= sensor.noise_bound


def test_slow_noise_has_the_stated_share_and_time_constant():
    """1 000 runs: a correlation has the standard error 1/sqrt(1 000); each reading has the stated law as before."""
    slow = SlowNoise(0.6, 20.0)
    found = simulate(walk(Sensor("s", "x0", sigma=2.0, noise=slow)), 60, range(1000))
    noise = (found.y - found.signal)[..., 0]
    assert kstest(noise[30], "norm", (0, 2)).pvalue > 1e-3
    for lag in (1, 5, 40):
        assert np.corrcoef(noise[0], noise[lag])[0, 1] == pytest.approx(0.6 * np.exp(-lag / 20), abs=4 / np.sqrt(1000))
    bounded = simulate(walk(Sensor("s", "x0", sigma=1.0, bound=1.5, noise=slow)), 60, range(1000))
    assert np.abs(bounded.y - bounded.signal).max() <= 1.5
    white = simulate(walk(Sensor("s", "x0", sigma=2.0, noise=SlowNoise(0.0, 20.0))), 60, range(20))
    np.testing.assert_allclose(
        white.y, simulate(walk(Sensor("s", "x0", sigma=2.0)), 60, range(20)).y, rtol=1e-9, atol=1e-9
    )  # by quantiles


def test_noise_is_independent_over_time_sensors_and_seeds():
    """A correlation of n independent pairs has the standard error 1/sqrt(n); four are allowed."""
    found = simulate(chain(4), 500, range(10))
    noise = found.y - found.signal
    for a, b in ((noise[1:], noise[:-1]), (noise[..., 1:], noise[..., :-1]), (noise[:, 1:], noise[:, :-1])):
        assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 4 / np.sqrt(a.size)


def test_process_noise_and_start_have_the_stated_variance():
    """A random walk: var x_K = P0 + K Q. The standard error of a variance of n is sqrt(2/n); four are allowed."""
    n = 4000
    found = simulate(walk(), 5, range(n), process_noise=True, start="sampled")
    for k in range(5):
        assert abs(found.x[k, :, 0].var() / (4 + (k + 1)) - 1) < 4 * np.sqrt(2 / n)
    half = simulate(walk(fixed_dt=False), np.array([0.5]), range(n), process_noise=True)
    assert abs(half.x[0, :, 0].var() / 0.5 - 1) < 4 * np.sqrt(2 / n)


def test_full_covariances_are_those_of_the_draws():
    """Entries of a sample covariance err by at most sqrt(2/n) of the product of the deviations; four are allowed."""
    n = 4000
    plant = replace(correlated(), step=lambda t, x, u, dt: x)
    scale = np.sqrt(np.diagonal(plant.process_cov))
    for options in ({"process_noise": True}, {"start": "sampled"}):
        found = simulate(plant, 1, range(n), **options).x[0] - plant.x0
        expected = plant.process_cov / np.outer(scale, scale)
        assert np.abs(np.cov((found / scale).T) - expected).max() < 4.5 * np.sqrt(2 / n)  # the largest of 153


def test_bounded_process_noise():
    bounded = walk(process_cov=0.0, process_bound=np.array([0.2]))
    steps = np.diff(simulate(bounded, 200, range(20), process_noise=True).x[..., 0], axis=0)
    assert 0.19 < np.abs(steps).max() <= 0.2 + 1e-12
    assert kstest(steps.ravel(), "uniform", (-0.2, 0.4)).pvalue > 1e-3
    still = simulate(walk(process_cov=0.0), 5, [0], process_noise=True)
    assert not still.x.any()
    with pytest.raises(ValueError, match="process bound and a full process_cov"):
        simulate(replace(correlated(), process_bound=np.ones(17)), 1, [0], process_noise=True)


def test_truth_with_smaller_steps_and_other_states():
    plant = tanks()
    fine = replace(plant, dt=0.5)
    coarse = simulate(plant, 60, [0], truth="model", inputs=lambda t: np.array([9e-4]))
    better = simulate(plant, 60, [0], truth=fine, inputs=lambda t: np.array([9e-4]))
    # RK4 at 5 s, a fiftieth of the tanks' time constant, is good to (1/50)^4 of the change
    np.testing.assert_allclose(better.x, coarse.x, rtol=1e-6)
    assert not np.array_equal(better.x, coarse.x)
    other = replace(plant, states=(Signal("a", "m", 1.0), Signal("b", "m", 1.0)))
    assert simulate(plant, 3, [0], truth=other).x is None
    mapped = simulate(plant, 3, [0], truth=other, to_states=lambda x: x[..., ::-1])
    np.testing.assert_array_equal(mapped.x[..., ::-1], simulate(plant, 3, [0], truth="model").x)
    with pytest.raises(ValueError, match=r"to_states gives \(3, 1, 1\); expected \(3, 1, 2\)"):
        simulate(plant, 3, [0], truth=other, to_states=lambda x: x[..., :1])


def test_pipeline_on_a_finer_grid():
    """41 nodes against 21: the difference of the grids is a few Pa, far below the sensors' 500 Pa, and not nothing."""
    plant, truth = gas_pipeline(), gas_pipeline(nodes=41, stations=21)
    ours = simulate(plant, 60, [0])
    found = simulate(plant, 60, [0], truth=truth, to_states=lambda x: coarse_state(x, 21))
    error = np.abs(found.x - ours.x)[..., :21]
    assert 0.1 < error.max() < 100
    np.testing.assert_array_equal(found.signal, found.x)


def test_noise_of_the_truths_sensors_is_what_is_added():
    plant = walk()
    truth = walk(Sensor("s", "x0", sigma=3.0))
    ours, theirs = simulate(plant, 30, [4]), simulate(plant, 30, [4], truth=truth)
    np.testing.assert_allclose(theirs.y, 3 * ours.y, rtol=1e-12)


def test_a_finer_truth_is_read_by_the_plants_sensors():
    plant = replace(tanks(), sensors=tuple(replace(s, bound=None) for s in tanks().sensors))
    louder = replace(plant, sensors=tuple(replace(s, sigma=3 * s.sigma) for s in plant.sensors))
    ours, theirs = simulate(plant, 30, [4]), simulate(louder, 30, [4])
    np.testing.assert_array_equal(theirs.signal, ours.signal)
    np.testing.assert_allclose(theirs.y - theirs.signal, 3 * (ours.y - ours.signal), rtol=1e-9, atol=1e-12)


def test_leaving_the_limits_names_seed_time_state_and_cure():
    plant = tanks()
    with pytest.raises(
        ArithmeticError, match=r"seed 7 left the limits of 'two-tanks' at \d+ s: level_1 = 3\.\d+ m, limits \[0.01, 3\]; make"
    ):
        simulate(plant, 1000, [7, 9], inputs=lambda t: np.array([3e-3]))
    broken = walk(step=lambda t, x, u, dt: x + np.nan, fixed_dt=False)
    with pytest.raises(ArithmeticError, match="x0 = nan"):
        simulate(broken, 3, [0])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"times": 0}, "at least 1"),
        ({"times": np.empty(0)}, "at least one time"),
        ({"times": np.array([5.0, 5.0])}, "increase"),
        ({"times": np.array([-5.0])}, "increase"),
        ({"seeds": []}, "at least one"),
        ({"seeds": [1, 1]}, "each different"),
        ({"seeds": [-1]}, "integer of at least 0"),
        ({"seeds": [1.5]}, "integer of at least 0"),
        ({"seeds": 0}, r"seeds are 0; expected several integers .* such as \[0\]"),
        ({"seeds": "12"}, "a seed is '1'; expected an integer"),
        ({"seeds": None}, "seeds are None; expected"),
        ({"seeds": np.array(3)}, "expected several integers"),
        ({"times": 2.5}, "times is 2.5; expected a whole number"),
        ({"times": "ten"}, "times is 'ten'; expected an array of numbers"),
        ({"times": 10**30}, "at most 1000000000"),
        ({"truth": "fine"}, "expected 'finer', 'model' or a plant"),
        ({"truth": 3}, "truth is 3; expected 'finer', 'model' or a plant"),
        ({"t0": np.nan}, "t0 is nan; expected a finite time"),
        ({"start": "anywhere"}, "'nominal', 'sampled'"),
        ({"start": np.zeros(5)}, "start has shape"),
        ({"truth": chain()}, "truth has the sensors"),
        ({"truth": replace(tanks(), dt=3.0)}, "divided by a whole number"),
        ({"truth": replace(tanks(), inputs=(Signal("feed"),))}, "truth has the inputs"),
    ],
)
def test_bad_arguments(arguments, message):
    with pytest.raises(ValueError, match=message):
        simulate(**({"plant": tanks(), "times": 3, "seeds": [0]} | arguments))


def test_steps_that_the_plant_does_not_allow():
    with pytest.raises(ValueError, match=r"holds for 1\.0 s only"):
        simulate(chain(3), np.array([1.0, 3.0]), [0])
    with pytest.raises(ValueError, match="largest admissible step"):
        simulate(changed(tanks(), max_dt=5.0), np.array([6.0]), [0])


def test_start_states_can_be_given():
    given = np.array([[0.5, 0.6], [1.5, 1.6]])
    found = simulate(replace(tanks(), step=lambda t, x, u, dt: x), 2, [0, 1], truth="model", start=given)
    np.testing.assert_array_equal(found.x[0], given)


def test_seeds_are_integers_from_zero():
    assert require_seeds(range(3)) == (0, 1, 2)
    assert require_seeds(np.arange(2)) == (0, 1)
    with pytest.raises(ValueError, match="integer"):
        stream(True)
