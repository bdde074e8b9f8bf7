"""The physical and the identified model of a valve on the same log: the valve sticks, and the flow sensor drifts."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.diagnosis.diagnose import Diagnosis, DiagnosisWarning, diagnose_run
from fusion_sfdia.learning.identification.choice import ModelChoice
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Signal

K_VALVE = 4.71967e-3  # kg/s per root of Pa, fully open
PARTED = 0.05  # command less opening from which the valve counts as stuck


@pytest.fixture(scope="module")
def valve(shared_fixtures: Path) -> dict[str, NDArray[np.float64]]:
    file = shared_fixtures / "estimationpy_valve" / "NoisyData_ValveStuck.csv"
    if not file.is_file():
        pytest.skip("needs the log in ../shared/fixtures/estimationpy_valve, next to the checkout")
    log = np.genfromtxt(file, delimiter=",", names=True)
    return {name.removeprefix("valveStuck"): log[name] for name in log.dtype.names}


@pytest.fixture(scope="module")
def physical(root: Path) -> Plant:
    return registry.plant(f"{root / 'docs/examples/valve.py'}:make")


@pytest.fixture(scope="module")
def log(valve: dict[str, NDArray[np.float64]]) -> Log:
    y, u = (np.stack([valve[a], valve[b]], axis=1) for a, b in (("m_flow", "cmd"), ("dp", "T_in")))
    return Log(valve["Time"] + 3.0, y, u)


@pytest.fixture(scope="module")
def stuck(valve: dict[str, NDArray[np.float64]]) -> NDArray[np.bool_]:
    return np.asarray(np.abs(valve["cmd"] - valve["valveopening"]) > PARTED)


@pytest.fixture(scope="module")
def identified(log: Log, stuck: NDArray[np.bool_], physical: Plant) -> ModelChoice:
    """From the samples before the valve sticks, in which the temperature and the pressure drop rise and it begins to close."""
    healthy = log.rows(slice(np.argmax(stuck) - 1))
    sensors = [Signal(s.name, s.unit) for s in physical.sensors]
    return ModelChoice.of("identified valve", sensors, [healthy], inputs=physical.inputs)


def diagnosis(plant: Plant, log: Log, window: int) -> Diagnosis:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DiagnosisWarning)  # the opening leaves its limits where the valve nearly closes
        return diagnose_run(LeaveOneOutBank(plant, window=window), log)


def test_both_models_isolate_the_command_where_the_valve_is_stuck(
    physical: Plant, identified: ModelChoice, log: Log, stuck: NDArray[np.bool_]
) -> None:
    """The physical model in 0.80 of the 79 samples, the one identified from 32 samples in 0.92; a test of one sample in 0.80
    and 0.65. Nothing is isolated by the identified one before; by the physical one in 2 samples at the start, where the
    pressure drop is nearly 0.
    """
    assert stuck.sum() == 79 and identified.samples == 32
    share = {}
    for name, plant in (("physical", physical), ("identified", identified.plant)):
        for window in (1, 15):
            isolated = diagnosis(plant, log, window).decisions.isolated
            share[name, window] = np.mean(np.all(isolated[stuck] == [False, True], axis=1))
            assert isolated[: np.argmax(stuck)].any(axis=1).sum() <= 3
    assert share["physical", 15] >= 0.75 and share["physical", 1] >= 0.75
    assert share["identified", 15] >= 0.85 and 0.5 <= share["identified", 1] <= share["identified", 15]


def test_the_physical_model_alone_removes_the_drift_of_the_flow_sensor(
    physical: Plant, identified: ModelChoice, log: Log, valve: dict[str, NDArray[np.float64]]
) -> None:
    """The drift acts from the start: readings without a truth cannot show it. Raw error 0.136 kg/s."""
    truth = valve["m_flow_real"]

    def rms(flow: NDArray[np.float64]) -> float:
        return float(np.sqrt(np.mean((flow - truth) ** 2)))

    estimate = diagnosis(physical, log, 1).decisions.estimate
    assert rms(K_VALVE * estimate[:, 0] ** 2 * np.sqrt(log.u[:, 0])) < 0.06
    assert rms(diagnosis(identified.plant, log, 15).decisions.reconstruction[:, 0]) > 0.12
