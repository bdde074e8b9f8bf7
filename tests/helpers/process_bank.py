"""A detector that accepts process hypotheses and suspects some by a fixed rule, to test what is made of its decisions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from toy_plants import Array

from fusion_sfdia.detectors.batch_detector import TimeStep
from fusion_sfdia.detectors.detector import Decision, ProcessHypothesis
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank

OUTLET = ProcessHypothesis("outlet", "m2.5/s", "parameter", 6e-4)
INFLOW = ProcessHypothesis("error of inflow", "m3/s", "input", 0.0)
SIZE, SD = np.array([-3e-5, 4.2e-5]), np.array([5e-6, 6e-6])  # of the two: 5 % +- 0.8 of the outlet


@dataclass(frozen=True)
class ProcessBank(LeaveOneOutBank):
    """Sensors as in the bank. In the steps from `accept`[j] to before `release`[j] hypothesis j of outlet and inflow is
    accepted; in the steps from `doubt`[0] to before `doubt`[1] the hypotheses at `between` are suspected, the first the most.
    """

    accept: tuple[int, int] = (3, 10**6)
    release: tuple[int, int] = (10**6, 10**6)
    doubt: tuple[int, int] = (0, 0)
    between: tuple[int, ...] = ()

    @property
    def process_hypotheses(self) -> tuple[ProcessHypothesis, ...]:
        return OUTLET, INFLOW

    def _judge(self, memory: Any, now: TimeStep, y: Array, u: Array) -> tuple[Any, Decision]:
        memory, decision = super()._judge(memory, now, y, u)
        runs, count = y.shape[:-1], y.shape[-1] + 2
        process = (np.array(self.accept) <= now.k) & (now.k < np.array(self.release))
        suspect, probability = np.zeros(count, bool), np.concatenate([np.zeros(count - 2), 0.45 * process])
        if self.doubt[0] <= now.k < self.doubt[1]:
            suspect[list(self.between)] = True
            probability[list(self.between)] = 0.5 ** np.arange(2, 2 + len(self.between))
            probability /= max(1.0, np.sum(probability))
        fields = {
            "process": process,
            "process_size": np.where(process, SIZE, np.nan),
            "process_sd": np.where(process, SD, np.nan),
            "suspect": suspect,
            "probability": probability,
        }
        return memory, replace(decision, **{name: np.tile(a, (*runs, 1)) for name, a in fields.items()})
