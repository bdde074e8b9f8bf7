"""The diagnoser of present readings: gains, and the removal of the effect of a fault."""

from __future__ import annotations

import numpy as np
import pytest
from toy_plants import bounded_chain, chain

from fusion_sfdia.detectors.batch_detector import TimeStep
from fusion_sfdia.detectors.stochastic_thresholds.chebyshev import BoundedReadings
from fusion_sfdia.detectors.stochastic_thresholds.present_readings import PresentReadings
from fusion_sfdia.filters.estimators import Extended
from fusion_sfdia.plant.linear import linear_plant
from fusion_sfdia.plant.signals import Sensor


@pytest.mark.parametrize("kind", [PresentReadings, BoundedReadings])
def test_a_removed_fault_leaves_its_uncertainty_and_other_runs_do_not_change(kind: type[PresentReadings]) -> None:
    """Each reading is a state: a fault f of the last reading of sensor 1 adds F[:, 1] f to the expected readings."""
    plant, lam, size, uncertainty = bounded_chain(), 0.3, np.zeros((3, 6)), np.zeros((3, 6))
    one, u = kind(plant, lam, Extended()), np.zeros((3, len(plant.inputs)))
    F = plant.step_jacobian_at(0.0, plant.x0, u[0], plant.dt)
    memory = one.start((3,), 0)
    for k in (0, 1):
        predicted = one.predict(memory, TimeStep(k * plant.dt, (k + 1) * plant.dt, plant.dt, 0, k), u)
        memory = one.take(predicted, np.random.default_rng(k).normal(size=(3, 6))).memory
    now = TimeStep(2 * plant.dt, 3 * plant.dt, plant.dt, 0, 2)
    before, predicted = one.predict(memory, now, u), one.predict(memory, now, u)
    size[2, 1], uncertainty[2, 1] = 2.0, 0.25
    corrected = one.without_faults(memory, predicted, now, u, size, uncertainty)
    np.testing.assert_allclose(corrected.expected[:2], before.expected[:2], rtol=0, atol=1e-12)  # of numbers of some units
    np.testing.assert_allclose(corrected.deviation[:2], before.deviation[:2], rtol=1e-12)
    expected = before.expected[2] - 2.0 * F[:, 1]
    expected[1] += lam * memory.residual[2, 1]  # its own last residual was that of the fault
    np.testing.assert_allclose(corrected.expected[2], expected, rtol=0, atol=1e-12)
    kept = lam * memory.deviation[2]
    power = 1 if kind is BoundedReadings else 2  # bounds add up, variances do
    wider = (before.deviation[2] - kept) ** power + np.abs(0.25 * F[:, 1]) ** power
    np.testing.assert_allclose((corrected.deviation[2] - kept) ** power, wider, rtol=1e-11)


def test_a_state_that_is_read_as_a_multiple_is_its_reading_over_it() -> None:
    plant = linear_plant(
        "scaled", 0.5 * np.eye(2), np.diag([2.0, -4.0]), [Sensor(f"s{i}", f"x{i}", sigma=0.1) for i in (0, 1)],
        dt=1.0, x0=np.zeros(2), initial_cov=np.ones(2), process_cov=np.ones(2),
    )  # fmt: skip
    one, u = PresentReadings(plant, 0.0, Extended()), np.zeros((1, 0))
    taken = one.take(one.predict(one.start((1,), 0), TimeStep(0.0, 1.0, 1.0, 0, 0), u), np.array([[3.0, 3.0]]))
    np.testing.assert_allclose(taken.estimate, [[1.5, -0.75]], rtol=1e-15)
    assert taken.covariance is not None
    np.testing.assert_allclose(taken.covariance[0], np.diag([0.1 / 2, 0.1 / 4]) ** 2, rtol=1e-14)


def test_unmeasured_states_have_the_kalman_gain() -> None:
    plant = chain(6, sensors=4)
    one, u, y = PresentReadings(plant, 0.0, Extended()), np.zeros((1, 0)), np.array([[1.0, -2.0, 3.0, 0.5]])
    F, H = plant.step_jacobian_at(0.0, plant.x0, u[0], 1.0), plant.output_jacobian_at(0.0, plant.x0, u[0])
    P = F @ np.diag(plant.initial_cov) @ F.T + np.diag(plant.process_cov)
    taken = one.take(one.predict(one.start((1,), 0), TimeStep(0.0, 1.0, 1.0, 0, 0), u), y)
    expected = P @ H.T @ np.linalg.solve(H @ P @ H.T + np.diag(plant.sensor_cov), y[0])
    np.testing.assert_allclose(taken.estimate[0], expected, rtol=0, atol=1e-12)  # of numbers of some units
