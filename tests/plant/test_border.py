"""Absurd readings and inputs: their limits, and what replaces them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from toy_plants import Array, chain, readings, tanks

from fusion_sfdia.detectors.data_driven.fixed_limits import FixedLimits
from fusion_sfdia.detectors.detector import Decision, run
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.detectors.kalman_banks.particle_filter import ParticleFilter
from fusion_sfdia.detectors.stochastic_thresholds.chebyshev import Chebyshev
from fusion_sfdia.detectors.storage import load_state, save_state
from fusion_sfdia.plant.border import InputLimits, possible
from fusion_sfdia.plant.discretise import discretise
from fusion_sfdia.plant.physics import Physics
from fusion_sfdia.plant.signals import Sensor, Signal

PLANT = tanks()
INFLOW = PLANT.inputs[0].nominal
FREE = replace(PLANT, inputs=(Signal("inflow", "m3/s", INFLOW),))  # without declared limits


def test_a_possible_reading_resolves_its_noise_and_an_absurd_one_is_missing() -> None:
    limit = PLANT.largest_readings
    terms = len(PLANT.sensors) + len(PLANT.states)  # floats at y lie eps |y| / 2 to eps |y| apart
    assert np.all(terms * np.spacing(limit) <= PLANT.sensor_sigma)
    assert np.all(terms * np.spacing(2.001 * limit) >= PLANT.sensor_sigma)
    y = np.array([limit, -limit, 2 * limit, -2 * limit, np.full(4, np.nan)])
    np.testing.assert_array_equal(possible(PLANT, y), np.where(np.abs(y) > limit, np.nan, y))
    factor = np.array([1e-5, 1e3, 1.0, 1.0])
    converted = PLANT.in_units({s.name: ("other", f) for s, f in zip(PLANT.sensors, factor, strict=True)})
    np.testing.assert_allclose(converted.largest_readings, factor * limit, rtol=1e-14)


def test_a_large_possible_reading_does_not_affect_the_others() -> None:
    """Its rounding stays below their noise: at a hundredth of the limit the others are judged as without it."""
    plant = chain(6)
    t, _, y, u = readings(plant, 40, 4, seed=1)
    bank = LeaveOneOutBank(plant, window=1)
    y = y.copy()
    y[20, :, 2] = 0.01 * plant.largest_readings[2]
    _, d = run(bank, bank.init((4,)), t, y, u)
    gone = y.copy()
    gone[20, :, 2] = np.nan
    _, without = run(bank, bank.init((4,)), t, gone, u)
    assert d.isolated[20, :, 2].all() and not d.absurd.any() and not d.diverged.any()
    others = [0, 1, 3, 4, 5]
    np.testing.assert_array_equal(d.isolated[20][:, others], without.isolated[20][:, others])
    assert np.abs(d.estimate[20] - without.estimate[20]).max() < 1.0  # sigma


@pytest.mark.parametrize(
    ("u", "applied"),
    [
        (2.0 * INFLOW, 2.0 * INFLOW),
        (2.5e-3, 2.5e-3),  # beyond its limit of 2e-3, but the levels stay within theirs
        (-1e-4, -1e-4),
        (0.05, INFLOW),  # 5 m more after a step
        (-0.05, INFLOW),  # the tank would be empty
        (1e30, INFLOW),
        (-1e303, INFLOW),
    ],
)
def test_an_input_beyond_its_limits_is_judged_by_what_it_does_to_the_states(u: float, applied: float) -> None:
    assert InputLimits(PLANT).applied(0.0, PLANT.dt, np.array([u]))[0] == applied
    both = InputLimits(PLANT).applied(0.0, PLANT.dt, np.array([[INFLOW / 2], [u]]))
    np.testing.assert_array_equal(both, [[INFLOW / 2], [applied]])


def test_an_input_without_limits_may_be_anything_that_can_be_resolved() -> None:
    limits = InputLimits(FREE)
    for u in (0.05, -0.05, 1.0, 1e10):
        assert limits.applied(0.0, PLANT.dt, np.array([u]))[0] == u
    for u in (1e30, -1e30, 1e303):
        assert limits.applied(0.0, PLANT.dt, np.array([u]))[0] == INFLOW
    swinging = InputLimits(tanks(swing=0.5))  # what is usual depends on the time
    assert swinging.applied(300.0, PLANT.dt, np.array([1e30]))[0] == pytest.approx(1.5 * INFLOW)


def test_inputs_within_their_limits_are_left_as_they_are_without_asking_the_model() -> None:
    asked = []

    def step(t: float, x: Array, u: Array, dt: float) -> Array:
        asked.append(t)
        return PLANT.step(t, x, u, dt)

    limits, u = InputLimits(replace(PLANT, step=step)), np.array([2e-3])
    asked.clear()  # by the plant, which checks its shapes
    assert limits.applied(0.0, PLANT.dt, u) is u and not asked
    limits.applied(0.0, PLANT.dt, 1e3 * u)
    assert asked == [0.0]


def test_an_input_under_which_the_model_has_no_solution_is_absurd() -> None:
    """z = sin(u z) has one by sweeps under the usual input, none under 1e303."""
    physics = Physics(
        "loop", (Signal("x"),), lambda t, x, z, u, c: z - x, (Signal("u"),), (Signal("z", nominal=1.0),),
        lambda t, x, z, u, c: np.sin(u * z),
    )  # fmt: skip
    sensors = [Sensor(name, "x", sigma=0.1) for name in "abc"]
    plant = discretise(physics, sensors, dt=0.1, x0=np.zeros(1), initial_cov=np.full(1, 0.1), process_cov=np.full(1, 0.01))
    bank = LeaveOneOutBank(plant)
    u = np.zeros((5, 1))
    u[2] = 1e303
    _, d = run(bank, bank.init(), 0.1 * np.arange(1, 6), np.zeros((5, 3)), u)
    assert d.absurd_input[:, 0].tolist() == [False, False, True, False, False] and not d.diverged.any()


def test_a_diverged_run_is_not_capped_and_a_state_goes_on_after_absurd_values(tmp_path: Path) -> None:
    t, _, y, u = readings(PLANT, 20, 2, seed=2)
    y, u = y.copy(), u.copy()
    y[6, 0], u[6, 1] = 1e303, -1e303
    detector = LeaveOneOutBank(PLANT)
    middle, _ = run(detector, detector.init((2,)), t[:7], y[:7], u[:7])
    save_state(tmp_path / "state.npz", detector, middle)
    _, d = run(detector, middle, t[7:], y[7:], u[7:])
    _, resumed = run(detector, load_state(tmp_path / "state.npz", detector), t[7:], y[7:], u[7:])
    np.testing.assert_array_equal(d.estimate, resumed.estimate)
    assert np.isfinite(d.estimate).all() and not d.diverged.any() and not d.isolated.any()


def test_limits_learnt_from_a_recording_with_an_absurd_reading_are_those_without_it() -> None:
    _, _, y, _ = readings(PLANT, 6000, 1, seed=3)
    bad, gone = y.copy(), y.copy()
    bad[100, 0, 1], gone[100, 0, 1] = 1e303, np.nan
    one, other = (FixedLimits.fit(PLANT, each, 0.01) for each in (bad, gone))
    np.testing.assert_array_equal(one.level, other.level)
    np.testing.assert_array_equal(one.change, other.change)


@pytest.mark.parametrize(
    "detector",
    [
        LeaveOneOutBank(chain(6), window=1),
        LeaveOneOutBank(chain(6), window=5),
        LeaveOneOutBank(chain(6), window=1, accommodate=False),
        ParticleFilter(chain(6), size=2000),
        Chebyshev(chain(6), lam=0.0, alpha=6.0),
    ],
    ids=["loo", "glr", "watching", "particles", "chebyshev"],
)
def test_a_decision_reports_that_another_sensor_would_be_isolated(
    detector: LeaveOneOutBank | ParticleFilter | Chebyshev,
) -> None:
    """One, two and three faults where two sensors may be out: capped with the third alone, and by default none of them."""
    t, _, y, u = readings(detector.plant, 30, 4, seed=4)
    y = y.copy()
    for b, count in enumerate((0, 1, 2, 3)):
        y[20, b, : 2 * count : 2] += 12.0  # sigma, of sensors that do not touch
    two = replace(detector, max_faults=2)

    def step(of: LeaveOneOutBank | ParticleFilter | Chebyshev) -> Decision:
        return run(of, of.init((4,)), t[:21], y[:21], u[:21])[1]

    assert step(two).capped[20].tolist() == [False, False, False, True] and not step(two).capped[:20].any()
    assert detector.most_faults == 3 and not step(detector).capped.any()
    assert step(detector).isolated[20].sum(axis=-1).tolist() == [0, 1, 2, 3]
    assert not run(CentralFilter(detector.plant), CentralFilter(detector.plant).init((4,)), t, y, u)[1].capped.any()
