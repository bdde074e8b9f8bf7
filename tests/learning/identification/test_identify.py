"""A plant identified from a simulated recording has the truth's poles, gain and noise; bad recordings are refused."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import t as student

from fusion_sfdia.learning.checks.plants import check_plant
from fusion_sfdia.learning.identification.healthy_runs import without_repeats
from fusion_sfdia.learning.identification.identify import identify
from fusion_sfdia.learning.innovations import whiteness
from fusion_sfdia.plant.linear import linear_plant
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal

Array = NDArray[Any]

POLES = np.array([0.5, 0.9])
F = np.array([[0.9, 0.0], [0.3, 0.5]])
G = np.array([[0.4], [0.1]])
H = np.array([[1.0, 0.0], [0.0, 1.0], [0.5, 0.5]])
Q, SIGMA = np.array([[0.09, 0.02], [0.02, 0.04]]), np.array([0.2, 0.3, 0.25])
LEVEL = np.array([20.0, 300.0, -5.0])  # of the readings
SENSORS = (Signal("level", "m"), Signal("pressure", "kPa"), Signal("flow", "m3/s"))
INPUT = Signal("pump", "%")
SAMPLES, SEEDS = 400, 5


def truth() -> Plant:
    sensors = [Sensor(s.name, s.name, s.unit, sigma=float(noise)) for s, noise in zip(SENSORS, SIGMA, strict=True)]
    return linear_plant(
        "truth", F, H, sensors, dt=10.0, x0=np.zeros(2), initial_cov=np.eye(2), process_cov=Q, input_matrix=G,
        output_offset=LEVEL, inputs=[INPUT],
    )  # fmt: skip


def recorded(seed: int, samples: int = SAMPLES) -> Log:
    """The truth under a pump that changes at random every fifth sample, from rest."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(-(-samples // 5)), 5)[:samples, None]
    w = rng.multivariate_normal(np.zeros(2), Q, samples)
    x, states = np.zeros(2), np.empty((samples, 2))
    for k in range(samples):
        states[k] = x = F @ x + G @ u[k] + w[k]
    return Log(10.0 * np.arange(1, samples + 1), states @ H.T + LEVEL + SIGMA * rng.standard_normal((samples, 3)), u)


def matrices(plant: Plant) -> tuple[Array, Array, Array]:
    """F, G and H of a linear plant."""
    x, u = plant.x0, plant.input_at(0.0)
    step = plant.step(0.0, x, u + np.eye(len(u)), plant.dt) - plant.step(0.0, x, u, plant.dt)
    return plant.step_jacobian_at(0.0, x, u, plant.dt), step.T, plant.output_jacobian_at(0.0, x, u)


def gain(plant: Plant) -> Array:
    """Change of each reading at rest over that of the pump (3,)."""
    f, g, h = matrices(plant)
    return np.asarray(h @ np.linalg.solve(np.eye(len(f)) - f, g))[:, 0]


@pytest.fixture(scope="module")
def plants() -> list[Plant]:
    return [
        identify("found", SENSORS, recorded(seed), inputs=[INPUT], order=2, folds=2, ridge=0.0, iterations=100)
        for seed in range(SEEDS)
    ]


def within_standard_errors(found: Array, expected: Array, largest: float) -> None:
    """The mean over the seeds is within Student's interval of 99.9 %; the standard error is small enough to mean something."""
    error = found.std(axis=0, ddof=1) / np.sqrt(SEEDS)
    assert np.all(np.abs(found.mean(axis=0) - expected) <= student.ppf(0.9995, SEEDS - 1) * error)
    assert np.all(error < largest)


@pytest.mark.long
def test_poles_are_recovered_within_their_standard_errors(plants: list[Plant]) -> None:
    """A pole p of states read without noise has the standard error sqrt((1 - p^2) / samples): 0.04 and 0.02 of a recording.

    Readings noisier than the process add to it: of the mean of five recordings, 0.08 at most.
    """
    found = np.array([np.sort(np.linalg.eigvals(matrices(p)[0]).real) for p in plants])
    within_standard_errors(found, POLES, 0.08)


@pytest.mark.long
def test_the_gain_at_rest_and_the_noise_are_recovered_within_their_standard_errors(plants: list[Plant]) -> None:
    expected = gain(truth())
    within_standard_errors(np.array([gain(p) for p in plants]), expected, 0.1 * float(np.abs(expected).max()))
    within_standard_errors(np.array([p.sensor_sigma for p in plants]), SIGMA, 0.1 * float(SIGMA.max()))


@pytest.mark.long
def test_the_filter_on_other_readings_has_white_innovations_of_the_stated_size(plants: list[Plant]) -> None:
    """NIS per reading of K samples of 3 sensors has the standard error sqrt(2 / (3 K)): 4 of them, twice, since the model was
    identified from as many samples and has errors of the same order.
    """
    for seed, plant in enumerate(plants):
        found = whiteness(plant, *recorded(100 + seed))
        assert abs(found.nis - 1) <= 2 * 4 * np.sqrt(2 / (3 * SAMPLES))
        assert np.all(np.abs(found.autocorrelation) <= 2 * 4 / np.sqrt(found.pairs))
        assert np.all(np.abs(found.variance - 1) <= 2 * 4 * np.sqrt(2 / SAMPLES))


@pytest.mark.long
def test_states_are_readings_without_noise_in_their_units(plants: list[Plant]) -> None:
    units = {s.name: s.unit for s in SENSORS}
    for plant in plants:
        h = matrices(plant)[2]
        for j, state in enumerate(plant.states):
            name = state.name.removeprefix("true ")
            assert units[name] == state.unit and h[plant.sensor_index(name)] == pytest.approx(np.eye(2)[j], abs=1e-9)
        assert plant.output(0.0, plant.x0, plant.input_at(0.0)) == pytest.approx(LEVEL, abs=1.0)


def short(**changes: Any) -> Plant:
    """A quick identification."""
    given = {"name": "quick", "sensors": SENSORS, "healthy": recorded(7, 120), "inputs": [INPUT], "order": 2}
    return identify(**{**given, "folds": 2, "iterations": 5, **changes})


def test_the_plant_keeps_the_contract_and_can_be_pickled() -> None:
    plant = short()
    check_plant(plant)
    copy = pickle.loads(pickle.dumps(plant))
    assert np.array_equal(copy.process_cov, plant.process_cov) and copy.inputs[0].nominal == plant.inputs[0].nominal


def test_readings_may_be_missing() -> None:
    t, y, u = recorded(7, 120)
    y[::2, 1] = np.nan
    plant = short(healthy=Log(t, y, u))
    assert np.isfinite(plant.process_cov).all() and whiteness(plant, t, y, u).pairs[1] == 0


def test_units_of_the_readings_make_no_difference() -> None:
    t, y, u = recorded(7, 120)
    plant, other = short(), short(healthy=Log(t, y * np.array([1e3, 1.0, 1.0]), u))
    assert other.sensor_sigma == pytest.approx(plant.sensor_sigma * np.array([1e3, 1.0, 1.0]), rel=1e-6)
    first, second = (whiteness(p, t, readings, u).nis for p, readings in ((plant, y), (other, y * np.array([1e3, 1.0, 1.0]))))
    assert first == pytest.approx(second, rel=1e-6)


def test_the_order_is_that_of_the_truth_where_a_lower_one_cannot_follow() -> None:
    assert len(short(order=(1, 2), healthy=recorded(7, 300), iterations=15).states) == 2


def test_one_sensor_gives_states_some_steps_later() -> None:
    t, y, u = recorded(7, 200)
    plant = short(sensors=SENSORS[1:2], healthy=Log(t, y[:, 1:2], u))
    assert [s.name for s in plant.states] == ["true pressure", "true pressure 1 later"]
    f = matrices(plant)[0]
    assert f[0] == pytest.approx([0.0, 1.0], abs=1e-9)


def test_a_plant_without_inputs() -> None:
    t, y, _ = recorded(7, 120)
    plant = short(healthy=Log(t, y, np.empty((120, 0))), inputs=())
    assert plant.inputs == () and len(plant.states) == 2


T, Y, U = recorded(8, 60)
STILL = Y * np.array([1.0, 0.0, 1.0])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"healthy": (T, Y)}, "has 2 parts"),
        ({"healthy": Log(T, Y[:, :2], U)}, "do not fit 3 sensors and 1 inputs"),
        ({"healthy": Log(T, STILL, U)}, "'pressure' has 60 readings of 1 values"),
        ({"healthy": Log(T, Y, 0 * U)}, "input 'pump' has 60 readings of 1 values"),
        ({"healthy": Log(np.sqrt(T), Y, U)}, "equal steps"),
        ({"healthy": Log(T[::-1], Y, U)}, "equal steps"),
        ({"healthy": Log(T, np.where(Y == Y[3], np.inf, Y), U)}, "infinite readings"),
        ({"healthy": Log(T, Y, np.where(U == U[3], np.nan, U))}, "inputs that are missing"),
        ({"healthy": Log(T, Y, U), "order": 7}, "60 samples for 7 states"),
        ({"healthy": Log(T, Y, U), "order": ()}, "order is empty"),
        ({"order": 0}, "order is 0"),
        ({"folds": 1}, "folds is 1"),
        ({"iterations": 0}, "iterations is 0"),
        ({"ridge": -1.0}, "ridge is -1.0"),
        ({"sensors": [SENSORS[0]] * 3}, "level"),
    ],
)
def test_what_cannot_be_identified_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        short(**changes)


def test_repeated_readings_are_left_out_of_the_sensors_that_repeat() -> None:
    y = np.array([[1.0, 5.0], [1.0, 5.0], [2.0, 5.0], [2.0, 6.0], [1.0, 6.0]])
    found = without_repeats(y, np.array([True, False]))
    assert np.array_equal(found[:, 0], [1.0, np.nan, 2.0, np.nan, 1.0], equal_nan=True)
    assert np.array_equal(found[:, 1], y[:, 1])
