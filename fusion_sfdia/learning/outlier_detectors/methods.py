"""How each method of monitoring is fitted to healthy runs: the bank on the identified plant, and what stands beside it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.data_driven.fixed_limits import FixedLimits
from fusion_sfdia.detectors.data_driven.one_class import OneClass
from fusion_sfdia.detectors.data_driven.pca import PrincipalComponents
from fusion_sfdia.detectors.detector import Detector
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.detectors.kalman_banks.sequential_bank import SequentialBank
from fusion_sfdia.detectors.kalman_banks.sequential_rules import Ewma, Shewhart
from fusion_sfdia.learning.identification.choice import Candidate, ModelChoice, model_of, times
from fusion_sfdia.learning.identification.healthy_runs import runs_of
from fusion_sfdia.learning.outlier_detectors.partial_least_squares import PartialLeastSquares
from fusion_sfdia.learning.outlier_detectors.since_start import SinceStart, changes
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Signal

Array = NDArray[Any]

LAGS = 2  # of dynamic principal components
WEIGHT = 0.05  # of the moving average of the predictors' errors: 20 samples
NEEDED = 8  # healthy samples over the inverse of the rate that a detector which learns is fitted to at first
STATIC = Candidate("autoregression", 0)


@dataclass(frozen=True)
class Methods:
    """Fits of detectors to healthy runs without gaps, all of the same sensors and inputs and the model that was chosen.

    baseline: samples at the start of a run that changes are counted from, of the predictors.
    """

    choice: ModelChoice
    sensors: Sequence[Signal]
    inputs: Sequence[Signal]
    false_alarm: float
    baseline: int = 30

    def bank(self, logs: Sequence[Log]) -> Detector:
        """`LeaveOneOutBank` on the model that was chosen, identified from these runs."""
        plant = self._plant(self.choice.chosen, logs)
        return LeaveOneOutBank(times(plant, self.choice.nis), false_alarm=self.false_alarm)

    def predictors(self, logs: Sequence[Log]) -> Detector:
        """Ridge predictors of each sensor from the others and the inputs at the same time, all as changes since the start of
        the run, with limits on their present errors and on those averaged over time.
        """
        plant = self._plant(STATIC, changes(logs, self.baseline))
        rules = (Shewhart(), Ewma(WEIGHT))
        return SinceStart(plant, SequentialBank(plant, rules, false_alarm=self.false_alarm), self.baseline)

    def pls(self, logs: Sequence[Log]) -> Detector:
        """As `predictors`, by partial least squares, whose number of components is chosen by cross-validation."""
        moved = changes(logs, self.baseline)
        plant = self._plant(STATIC, moved)
        return SinceStart(plant, PartialLeastSquares.of_runs(plant, moved, self.false_alarm), self.baseline)

    def limits(self, logs: Sequence[Log]) -> Detector:
        """`FixedLimits` of each reading and of its change."""
        return FixedLimits.fit(self.choice.plant, joined(logs), self._rate(logs))

    def pca(self, logs: Sequence[Log]) -> Detector:
        """`PrincipalComponents`."""
        return PrincipalComponents.fit(self.choice.plant, joined(logs), self._rate(logs))

    def dynamic_pca(self, logs: Sequence[Log]) -> Detector:
        """`PrincipalComponents` of the present readings and those of LAGS samples before."""
        return PrincipalComponents.fit(self.choice.plant, joined(logs), self._rate(logs), lags=LAGS)

    def one_class(self, logs: Sequence[Log]) -> Detector:
        """`OneClass`, a support vector machine of scikit-learn."""
        return OneClass.fit(self.choice.plant, joined(logs), self._rate(logs))

    @property
    def fits(self) -> dict[str, Callable[[Sequence[Log]], Detector]]:
        """All methods by name, the bank first."""
        return {
            "bank": self.bank,
            "predictors": self.predictors,
            "pls": self.pls,
            "limits": self.limits,
            "pca": self.pca,
            "dynamic pca": self.dynamic_pca,
            "one-class": self.one_class,
        }

    def _plant(self, candidate: Candidate, logs: Sequence[Log]) -> Plant:
        runs = runs_of(self.sensors, self.inputs, logs)
        return model_of(candidate, self.choice.plant.name, runs, runs.logs, self.sensors, self.inputs)

    def _rate(self, logs: Sequence[Log]) -> float:
        """The rate of the fit of a detector that learns, which calibration replaces: at least what the data can set."""
        return min(0.2, max(self.false_alarm, NEEDED / sum(len(log.t) for log in logs)))


def joined(logs: Sequence[Log]) -> Array:
    """Readings of runs (K, N) one after the other, with missing samples between them."""
    return np.concatenate([np.pad(log.y, ((0, LAGS + 1), (0, 0)), constant_values=np.nan) for log in logs])
