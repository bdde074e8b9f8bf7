"""Whether the model fits a log: innovations of the sensors that no fault was found in, against what the model states."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from fusion_sfdia.diagnosis.hindsight import Hindsight
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.slow_noise import inflation_of

Array = NDArray[Any]

MORE_ALARMS = 10.0  # times the stated rate of false alarms, at which a model is suspect
WARM_UP = 20  # samples after a start
SURE = 3.0  # standard errors
MOST_NAMES = 4
STEADIEST = 0.99  # largest autocorrelation that is believed
PARTS = 4  # of a log, in each of which the mean of the residuals is tested
POWER = 2.0  # standard errors beyond what is tested: so much more is seen with a probability of 0.98


class Visible(NamedTuple):
    """The least mismatch of any one tested sensor that is seen with a probability of 0.98: spread, its noise over the stated
    one; shift, a mean of its residuals over half of the log, which has a whole part in it, in standard deviations. NaN where
    none is tested.
    """

    spread: float
    shift: float

    def __str__(self) -> str:
        return (
            f"noise of a sensor {self.spread:.2g} times as large as stated, or residuals off by {self.shift:.2g} standard "
            "deviations for half of the log, would have been seen"
        )


class Health(NamedTuple):
    """Whether the model fits the readings, by the innovations of its filter.

    Attributes
    ----------
    nis : float
        Normalised innovation squared per reading over `samples` samples.
    limit : float
        Above it the model is suspect.
    samples : int
        Number of samples behind nis.
    excess : dict of str to float
        {sensor: by how much sums of its innovations vary more than stated} of the sensors significantly above the limit, the
        largest first.
    shifts : dict of str to float
        {sensor: mean of its residuals over a part of the log, in standard deviations} of those in which it is significantly
        above `shift_limit`.
    sensors : int
        How many there are.
    untested : tuple of str
        Those with too few readings.
    visible : Visible
        What is seen of each other one.
    tested : bool
        Whether the readings sufficed for a test.
    remarks : tuple of str
        What else speaks against the model.

    Examples
    --------
    >>> from fusion_sfdia import diagnose, simulate
    >>> from fusion_sfdia.events import Health
    >>> from fusion_sfdia.plants import two_tanks
    >>> health: Health = diagnose("loo-glr", simulate(two_tanks(), 200, seeds=[3]), plant=two_tanks()).health
    >>> health.suspect, health.sensors
    (False, 4)
    """

    nis: float
    limit: float
    samples: int
    excess: dict[str, float]
    shifts: dict[str, float]
    sensors: int
    untested: tuple[str, ...]
    visible: Visible
    tested: bool
    remarks: tuple[str, ...] = ()

    @property
    def suspect(self) -> bool:
        """Whether the model is suspect."""
        off = len({*self.excess, *self.shifts})
        return bool(self.remarks or (self.tested and (self.nis > self.limit or 2 * off > self.sensors)))

    @property
    def cautious(self) -> bool:
        """Whether the innovations are as much smaller than stated."""
        return self.tested and self.nis < 1 / self.limit

    @property
    def line(self) -> str:
        """One line for people."""
        numbers = f"NIS {self.nis:.3g} over {self.samples} samples (expected 1, suspect above {self.limit:.2g})"
        parts = [*self.remarks, *([numbers] if self.tested else [])]
        if self.excess:
            few = _few([f"{name} ({float(f'{value:.2g}'):g} times)" for name, value in self.excess.items()])
            parts.append(f"{len(self.excess)} of {self.sensors} sensors vary more or slower than stated: {few}")
        if self.shifts:
            few = _few([f"{name} (by {value:+.2g} standard deviations)" for name, value in self.shifts.items()])
            parts.append(f"{len(self.shifts)} of {self.sensors} sensors read off for a part of the log: {few}")
        if self.suspect:
            return f"model suspect: {'; '.join(parts)}"
        if not self.tested:
            return f"model not tested: {self.samples} healthy samples are too few"
        if self.cautious:
            return f"model cautious: {'; '.join(parts)}; the noise is overstated, small faults are missed"
        if self.untested:
            parts.append(f"not tested: {_few(self.untested)}")
        if np.isfinite(self.visible.spread):
            parts.append(str(self.visible))
        return f"model fits{', with reservations' if self.excess or self.shifts else ''}: {'; '.join(parts)}"


def _few(names: Sequence[str]) -> str:
    return ", ".join(names[:MOST_NAMES]) + (f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else "")


def limit_of(false_alarm: float, sensors: int) -> float:
    """The factor on the variance of residuals at which false alarms are `MORE_ALARMS` times as frequent as stated.

    A threshold of q = Phi^-1(1 - f / 2) standard deviations, with f the rate of one of the sensors, is exceeded at the rate
    10 f where the variance is c times as large and q / sqrt(c) = Phi^-1(1 - 10 f / 2): c = (q / q10)^2.
    """
    f = _rate(false_alarm, sensors)
    return float((ndtri(f / 2) / ndtri(MORE_ALARMS * f / 2)) ** 2)


def shift_limit(false_alarm: float, sensors: int) -> float:
    """The mean of residuals, in standard deviations, at which false alarms are `MORE_ALARMS` times as frequent as stated.

    Of a mean m the threshold q is exceeded at the rate 1 - Phi(q - m), but for the other side: m = q - Phi^-1(1 - 10 f).
    """
    f = _rate(false_alarm, sensors)
    return float(ndtri(MORE_ALARMS * f) - ndtri(f / 2))


def _rate(false_alarm: float, sensors: int) -> float:
    return min(false_alarm / sensors, 0.5 / MORE_ALARMS)


def health_of(plant: Plant, after: Hindsight, starts: Array, false_alarm: float, remarks: tuple[str, ...]) -> Health:
    """Test the innovations after each start: their mean square (NIS), of each sensor how much sums of them vary, and the mean
    of its residuals, the readings less what the other sensors give, in `PARTS` parts of the log.

    starts: indices of the samples with which a filter began. Of a sensor with variance v and autocorrelation rho of its
    standardised innovations, the sum over many samples varies v (1 + rho) / (1 - rho) times as much as that of white ones, and
    a test that accumulates has as many more false alarms as with such a variance. Its logarithm has the variance
    2 / n + 4 / (n (1 - rho^2)); a sensor is reported where it is above the limit by `SURE` standard errors, and by more where
    there are many sensors. The mean of n residuals has the variance v (1 + rho) / ((1 - rho) n), of theirs. Slow noise that a
    sensor states counts in both. NIS needs so many
    readings M that SURE sqrt(2 / M) is below limit - 1.
    """
    names, slow = plant.sensor_names[: plant.modelled], plant.slow_noise
    usual = inflation_of(np.inf, *slow)
    settled = np.ones(len(after.nis), bool)
    for k in starts:
        settled[k : k + WARM_UP] = False
    limit, off = limit_of(false_alarm, len(names)), shift_limit(false_alarm, len(names))
    use = settled & np.isfinite(after.nis)
    count = float(np.sum(after.used[use]))
    nis = float(np.sum(after.nis[use] * after.used[use]) / count) if count else np.nan
    sure = max(SURE, float(-ndtri(1e-3 / len(names))))
    excess: dict[str, float] = {}
    shifts: dict[str, float] = {}
    untested, visible = [], Visible(np.nan, np.nan)
    for i, name in enumerate(names):
        used = settled & np.isfinite(after.normal[:, i])
        v, rho, n = _spread(np.where(used, after.normal[:, i], np.nan))
        if n <= WARM_UP:
            untested.append(name)
            continue
        inflation, error = v * (1 + rho) / (1 - rho), np.sqrt(2 / n + 4 / (n * (1 - rho**2)))
        if np.log(max(inflation, 1e-300)) - sure * error > np.log(limit * usual[i]):
            excess[name] = float(inflation)
        means, errors = _means((after.error / after.sd)[used, i])
        if slow[0][i]:
            part = n / PARTS
            errors = np.maximum(errors, np.sqrt(inflation_of(part, *slow)[i] / part))
        surely = np.abs(means) - sure * errors
        if surely[k := int(np.argmax(surely))] > off:
            shifts[name] = float(means[k])
        spread = np.sqrt(limit * np.exp((sure + POWER) * np.sqrt(6 / n)))
        visible = Visible(*np.fmax(visible, (spread, off + (sure + POWER) * np.max(errors))).tolist())
    tested = bool(count) and SURE * np.sqrt(2 / count) < limit - 1
    excess, shifts = (dict(sorted(of.items(), key=lambda item: -abs(item[1]))) for of in (excess, shifts))
    return Health(nis, limit, int(np.sum(use)), excess, shifts, len(names), tuple(untested), visible, tested, remarks)


def _means(z: Array) -> tuple[Array, Array]:
    """The means of the `PARTS` parts of z (K,) and their standard errors, each by the spread about it."""
    parts = np.array_split(z, PARTS)
    means = np.array([np.mean(part) for part in parts])
    spreads = [_spread(part - mean) for part, mean in zip(parts, means, strict=True)]
    return means, np.sqrt([v * (1 + rho) / ((1 - rho) * n) for v, rho, n in spreads])


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
