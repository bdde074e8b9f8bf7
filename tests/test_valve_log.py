"""A log that none of us made: a valve whose command and position part, behind a flow sensor that drifts with temperature."""

import numpy as np
import pytest

from fusion_sfdia.diagnose import diagnose
from fusion_sfdia.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.plant import Plant, Sensor, Signal

K_VALVE = 4.71967e-3  # kg/s per root of Pa, fully open
HERE = 293.15  # K, where the flow sensor reads true


def valve() -> Plant:
    """Opening and drift as random walks; one sensor reads (1 + drift (T - 293.15)) times the flow, the command the opening."""

    def flow(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        return K_VALVE * x[..., 0] ** 2 * np.sqrt(u[..., 0])

    return Plant(
        name="valve",
        states=(Signal("opening", "1", 1.0, 0.01, 1.1), Signal("drift", "1/K", 0.0, -0.05, 0.05)),
        inputs=(Signal("pressure_drop", "Pa", 5e4), Signal("temperature", "K", 293.15)),
        sensors=(Sensor("flow", "flow", "kg/s", sigma=0.03), Sensor("command", "opening", "1", sigma=0.01)),
        step=lambda t, x, u, dt: x,
        output=lambda t, x, u: np.stack([(1 + x[..., 1] * (u[..., 1] - HERE)) * flow(x, u), x[..., 0]], axis=-1),
        dt=3.0,
        x0=np.array([1.0, 0.0]),
        initial_cov=np.array([0.05, 0.02]) ** 2,
        process_cov=np.array([0.05, 2e-5]) ** 2,
    )


def test_the_stuck_valve_is_named_and_the_drift_of_the_flow_sensor_taken_out(shared_fixtures) -> None:  # type: ignore[no-untyped-def]
    path = shared_fixtures / "estimationpy_valve" / "NoisyData_ValveStuck.csv"
    log = np.genfromtxt(path, delimiter=",", names=True)
    y = np.stack([log["valveStuckm_flow"], log["valveStuckcmd"]], axis=1)
    u = np.stack([log["valveStuckdp"], log["valveStuckT_in"]], axis=1)
    plant = valve()
    diagnosis = diagnose(LeaveOneOutBank(plant, window=1), log["Time"] + 3.0, y, u)
    estimate = diagnosis.decisions.estimate
    truth = log["valveStuckm_flow_real"]
    raw = np.sqrt(np.mean((y[:, 0] - truth) ** 2))
    accommodated = np.sqrt(np.mean((K_VALVE * estimate[:, 0] ** 2 * np.sqrt(u[:, 0]) - truth) ** 2))
    assert raw == pytest.approx(0.1363, abs=5e-5)
    assert accommodated <= 0.06
    assert 0.007 <= estimate[-1, 1] <= 0.0135
    # 60 % open for good while 80 to 100 % is asked: named to the end. Earlier, with two instruments and an opening that may
    # move by itself, a disagreement does not say which of the two is wrong.
    last = diagnosis.events[-1]
    assert last.hypothesis == "command" and last.open and abs(last.start - 177.0) <= 6.0
    assert diagnosis.decisions.fault_size[-1, 1] == pytest.approx(0.1, abs=0.03)  # 100 % asked, 90 % open
