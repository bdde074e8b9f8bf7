"""A log from another model: a valve whose command and position part, behind a flow sensor that drifts with temperature."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.diagnoser import diagnose
from fusion_sfdia.diagnosis.diagnose import DiagnosisWarning
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

EXAMPLE = "docs/examples/valve.py"
K_VALVE = 4.71967e-3  # kg/s per root of Pa, fully open


def valve(root: Path) -> Plant:
    """Opening and drift as random walks; one sensor reads (1 + drift (T - 293.15)) times the flow, the command the opening.

    The noises are ours, from the log's truth, rounded up: see the test of them. The command is exact, and takes 0.01 for
    its rounding; the drift is a constant, left 2e-5 a step (2e-4 over the log) of its 0.01.
    """
    return registry.plant(f"{root / EXAMPLE}:make")


def read(folder: Path) -> dict[str, Array]:
    log = np.genfromtxt(folder / "estimationpy_valve" / "NoisyData_ValveStuck.csv", delimiter=",", names=True)
    return {name.removeprefix("valveStuck"): log[name] for name in log.dtype.names}


def test_the_noises_of_the_plant_are_those_of_the_log(shared_fixtures: Path, root: Path) -> None:
    """Root mean squares: flow less the model's at the true opening and drift (noise of the pressure drop included) 0.022, a
    step of the opening 0.030, 0.066 where it moves. Twice as much would not be "rounded up".
    """
    log, plant = read(shared_fixtures), valve(root)
    opening = log["valveopening"]
    x = np.stack([opening, log["lambda"]], axis=1)
    error = log["m_flow"] - plant.output(0.0, x, np.stack([log["dp"], log["T_in"]], axis=1))[:, 0]
    steps = np.diff(opening)
    found = {"flow": np.sqrt(np.mean(error**2)), "step": np.sqrt(np.mean(steps**2))}
    assert found["flow"] <= plant.sensor_sigma[0] <= 2 * found["flow"]
    assert found["step"] <= np.sqrt(plant.process_cov[0]) <= 2 * found["step"]


def test_the_stuck_valve_is_isolated_and_the_drift_of_the_flow_sensor_removed(shared_fixtures: Path, root: Path) -> None:
    log = read(shared_fixtures)
    y = np.stack([log["m_flow"], log["cmd"]], axis=1)
    u = np.stack([log["dp"], log["T_in"]], axis=1)
    plant = valve(root)
    with pytest.warns(DiagnosisWarning, match="moved back in 2 of 121 samples"):  # nearly closed: the command is used
        diagnosis = diagnose(LeaveOneOutBank(plant, window=1), log["Time"] + 3.0, y, u)
    estimate = diagnosis.decisions.estimate
    truth = log["m_flow_real"]
    raw = np.sqrt(np.mean((y[:, 0] - truth) ** 2))
    accommodated = np.sqrt(np.mean((K_VALVE * estimate[:, 0] ** 2 * np.sqrt(u[:, 0]) - truth) ** 2))
    assert raw == pytest.approx(0.1363, abs=5e-5)
    # less than half of the raw error; the drift is 0.01 / K
    assert accommodated <= 0.06
    assert 0.007 <= estimate[-1, 1] <= 0.0135
    # 60 % open for good while 80 to 100 % is asked: isolated to the end. Earlier, with two instruments and an opening that may
    # move by itself, a disagreement does not show which of the two is wrong.
    last = diagnosis.events[-1]
    assert last.hypothesis == "command" and last.open and abs(last.start - 177.0) <= 6.0
    assert diagnosis.decisions.fault_size[-1, 1] == pytest.approx(0.1, abs=0.03)  # 100 % asked, 90 % open
