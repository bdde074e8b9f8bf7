"""Whether the model fits a log: innovations of the sensors that no fault was found in, against what the model states."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from fusion_sfdia.evaluation.hindsight_steps import Hindsight

Array = NDArray[Any]

MORE_ALARMS = 10.0  # times the stated rate of false alarms, at which a model is suspect
WARM_UP = 20  # samples after a start
SURE = 3.0  # standard errors
MOST_NAMES = 4
STEADIEST = 0.99  # largest autocorrelation that is believed


class Health(NamedTuple):
    """nis: normalised innovation squared per reading over `samples` samples; limit: above it the model is suspect.

    excess: {sensor: by how much sums of its innovations vary more than stated} of the sensors significantly above the limit,
    the largest first; of `sensors` tested. remarks: what else speaks against the model.
    """

    nis: float
    limit: float
    samples: int
    excess: dict[str, float]
    sensors: int
    tested: bool
    remarks: tuple[str, ...] = ()

    @property
    def suspect(self) -> bool:
        """Whether the model is suspect."""
        return bool(self.remarks or (self.tested and (self.nis > self.limit or 2 * len(self.excess) > self.sensors)))

    @property
    def cautious(self) -> bool:
        """Whether the innovations are as much smaller than stated."""
        return self.tested and self.nis < 1 / self.limit

    @property
    def line(self) -> str:
        """One line for people."""
        numbers = f"NIS {self.nis:.3g} over {self.samples} samples (expected 1, suspect above {self.limit:.2g})"
        names = [f"{name} ({value:.2g} times)" for name, value in list(self.excess.items())[:MOST_NAMES]]
        more = f" and {len(self.excess) - MOST_NAMES} more" if len(self.excess) > MOST_NAMES else ""
        varied = f"{len(self.excess)} of {self.sensors} sensors vary more or slower than stated: {', '.join(names)}{more}"
        told = [*self.remarks, *([numbers] if self.tested else []), *([varied] if self.excess else [])]
        if self.suspect:
            return f"model suspect: {'; '.join(told)}"
        if not self.tested:
            return f"model not tested: {self.samples} healthy samples are too few"
        if self.cautious:
            return f"model cautious: {'; '.join(told)}; the noise is overstated, small faults are missed"
        return f"model fits{', with reservations' if self.excess else ''}: {'; '.join(told)}"


def limit_of(false_alarm: float, sensors: int) -> float:
    """The factor on the variance of residuals at which false alarms are `MORE_ALARMS` times as frequent as stated.

    A threshold of q = Phi^-1(1 - f / 2) standard deviations, with f the rate of one of the sensors, is exceeded at the rate
    10 f where the variance is c times as large and q / sqrt(c) = Phi^-1(1 - 10 f / 2): c = (q / q10)^2.
    """
    f = min(false_alarm / sensors, 0.5 / MORE_ALARMS)
    return float((ndtri(f / 2) / ndtri(MORE_ALARMS * f / 2)) ** 2)


def health_of(names: tuple[str, ...], after: Hindsight, starts: Array, false_alarm: float, remarks: tuple[str, ...]) -> Health:
    """Test the innovations after each start: their mean square (NIS), and of each sensor how much sums of them vary.

    starts: indices of the samples with which a filter began. Of a sensor with variance v and autocorrelation rho of its
    standardised innovations, the sum over many samples varies v (1 + rho) / (1 - rho) times as much as that of white ones, and
    a test that accumulates has as many more false alarms as with such a variance. Its logarithm has the variance
    2 / n + 4 / (n (1 - rho^2)); a sensor is reported where it is above the limit by `SURE` standard errors, and by more where
    there are many sensors. NIS needs so many readings M that SURE sqrt(2 / M) is below limit - 1.
    """
    settled = np.ones(len(after.nis), bool)
    for k in starts:
        settled[k : k + WARM_UP] = False
    limit = limit_of(false_alarm, len(names))
    use = settled & np.isfinite(after.nis)
    count = float(np.sum(after.used[use]))
    nis = float(np.sum(after.nis[use] * after.used[use]) / count) if count else np.nan
    sure = max(SURE, float(-ndtri(1e-3 / len(names))))
    excess = {}
    for name, column in zip(names, after.normal.T, strict=True):
        v, rho, n = _spread(np.where(settled, column, np.nan))
        with np.errstate(divide="ignore"):
            inflation = v * (1 + rho) / (1 - rho)
            error = np.sqrt(2 / n + 4 / (n * (1 - rho**2))) if n else np.inf
        if n > WARM_UP and np.log(max(inflation, 1e-300)) - sure * error > np.log(limit):
            excess[name] = float(inflation)
    tested = bool(count) and SURE * np.sqrt(2 / count) < limit - 1
    ordered = dict(sorted(excess.items(), key=lambda item: -item[1]))
    return Health(nis, limit, int(np.sum(use)), ordered, len(names), tested, remarks)


def _spread(z: Array) -> tuple[float, float, int]:
    """Mean square, autocorrelation at the next sample and number of the finite ones of z (K,)."""
    known = np.isfinite(z)
    n = int(np.sum(known))
    square = float(np.sum(z[known] ** 2))
    pairs = known[1:] & known[:-1]
    if not (square > 0 and np.any(pairs)):
        return 0.0, 0.0, n
    rho = float(np.mean(z[1:][pairs] * z[:-1][pairs])) / (square / n)
    return square / n, float(np.clip(rho, -STEADIEST, STEADIEST)), n
