"""Runs of several cases that are followed together until their readings differ."""

from dataclasses import dataclass, fields, replace

import numpy as np
import pytest
from toy_plants import chain

from fusion_sfdia.benchmarks.pipeline.support.forks import decisions
from fusion_sfdia.detectors.detector import Decision, Detector
from fusion_sfdia.detectors.kalman_banks.fusing_bank import FusingBank
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.detectors.state import Array, State
from fusion_sfdia.diagnosis.fault_draws import FaultRange
from fusion_sfdia.filters.enkf import EnKFSettings
from fusion_sfdia.filters.estimators import Ensemble, Extended
from fusion_sfdia.study.trials import Faulted, decide, faulted, with_faults

STEPS, RUNS = 80, 3
PLANT = chain(6)
LIMITS = tuple(0.01 * PLANT.sensor_sigma)
RANGES = (FaultRange("bias", (8, 8), "sigmas"), FaultRange("dropout", length=(5, 20)), None)


def cases() -> list[Faulted]:
    healthy = faulted(PLANT, STEPS, range(RUNS), None, None)
    return [with_faults(PLANT, healthy.recording, of, None) for of in RANGES]


@pytest.mark.parametrize(
    "detector",
    [
        FusingBank(PLANT, Extended(), thresholds=LIMITS),
        FusingBank(PLANT, Ensemble(EnKFSettings(size=8)), thresholds=LIMITS),
        LeaveOneOutBank(PLANT, window=5),
    ],
    ids=["ekf", "enkf", "loo"],
)
def test_each_case_has_the_decisions_that_it_has_alone(detector: Detector) -> None:
    """The same bits, and of the ensemble the same random numbers, with false alarms before the faults."""
    together = list(decisions(detector, cases(), 5))
    assert len(together) == len(RANGES) and together[0].isolated.any()
    for data, found in zip(cases(), together, strict=True):
        alone = decide(detector, data, seed=5)
        for field in fields(Decision):
            np.testing.assert_array_equal(getattr(found, field.name), getattr(alone, field.name), err_msg=field.name)


@dataclass(frozen=True)
class Counting(LeaveOneOutBank):
    """It states how many runs it stepped as its normalised innovation."""

    def step(self, state: State, t: float, y: Array, u: Array) -> tuple[State, Decision]:
        state, decision = super().step(state, t, y, u)
        return state, replace(decision, nis=np.full(len(y), float(len(y))))


def test_a_run_is_stepped_once_until_its_readings_differ_between_cases() -> None:
    data = cases()
    stepped = next(decisions(Counting(PLANT), data)).nis[:, 0]
    begun = np.logical_or.accumulate(np.stack([case.active.any(axis=-1) for case in data]), axis=1)  # (cases, K, runs)
    own = begun.sum(axis=(0, 2))
    np.testing.assert_array_equal(stepped, own + (~begun).any(axis=0).sum(axis=-1))
    assert stepped[0] == RUNS and stepped[-1] == len(RANGES) * RUNS
