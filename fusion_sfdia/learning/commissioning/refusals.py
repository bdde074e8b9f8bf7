"""Reasons to refuse a log: too short, a sensor that stands still, a sensor that alone contradicts the others."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from fusion_sfdia.learning.commissioning.disturbances import UNSEEN, WINDOW, FoundDisturbance, Windows
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]
At = Callable[[int, int], str]  # the time of sample k of run b in words

REFUSED = 1e-4  # probability that a healthy log is refused by each of the tests
LARGE = 3.0  # sigma: a smaller constant bias is a matter of calibration, which is learnt
CLUSTERED = 4  # lengths of runs of equal readings, one over another
LEAST_WINDOWS = 4  # two for each half of the log


def require_length(plant: Plant, log: Log, settle: int, false_alarm: float | None) -> None:
    """Raise ValueError for a log that is too short for its plant or for a false-alarm rate, None for any."""
    steps, runs = log.y.shape[:2]
    if (least := settle + LEAST_WINDOWS * WINDOW) > steps:
        raise ValueError(
            f"the healthy log has {steps} samples; expected at least {least}: the filter on plant {plant.name!r} needs "
            f"{settle} to forget how it began, and each half of the rest {LEAST_WINDOWS // 2} windows of {WINDOW}; give "
            "a longer log"
        )
    if false_alarm is not None and (left := runs * (steps - settle)) * false_alarm < 1:
        raise ValueError(
            f"{left} healthy samples after the first {settle} of each run; expected at least {1 / false_alarm:.0f}, since "
            f"thresholds that one in {1 / false_alarm:.0f} exceeds cannot be set on fewer; give a longer log, or a higher "
            "false_alarm"
        )


def require_readings(plant: Plant, log: Log) -> None:
    """Raise ValueError for a sensor without readings."""
    for i, sensor in enumerate(plant.sensors):
        if not np.any(np.isfinite(log.y[..., i])):
            raise ValueError(
                f"sensor {sensor.name!r} has no reading in the healthy log; give one, or build the plant without it"
            )


class Still(NamedTuple):
    """Rows from first to last of a run, in which a sensor repeats a reading."""

    sensor: int
    run: int
    first: int
    last: int


def still(log: Log) -> list[Still]:
    """For each sensor that repeats a reading too often to be alive, its longest run of equal readings y (K, B, N).

    Of M readings of which a share q repeats the one before, a run of L repeats has a probability of at most M q^L where they
    come independently; q counts the sensor's repeats but those of its longest run, and one more. What coarse readings repeat
    depends on where in a step the variable is: a frozen one also repeats `CLUSTERED` times as often as in any other run.
    """
    y, found = log.y, []
    for i in range(y.shape[-1]):
        same = y[1:, :, i] == y[:-1, :, i]
        steps = np.arange(len(same))[:, None]
        run = steps - np.maximum.accumulate(np.where(same, -1, steps), axis=0)
        end, of = (int(j) for j in np.unravel_index(int(np.argmax(run)), run.shape))
        most, many = int(run[end, of]), same.size
        others = np.where((steps > end - most) & (steps <= end) & (np.arange(same.shape[1]) == of), 0, run)
        share = (np.sum(same) - most + 1) / (many - most + 1)
        if most > max(1, CLUSTERED * int(np.max(others))) and many * share**most < REFUSED:
            found.append(Still(i, of, end + 1 - most, end + 1))
    return found


def require_moving(plant: Plant, log: Log, at: At) -> None:
    """Raise ValueError for a sensor that repeats a reading too often to be alive, see `still`."""
    for i, run, first, last in still(log):
        raise ValueError(
            f"sensor {plant.sensors[i].name!r} shows the same reading {last - first + 1} times in a row in the healthy log, "
            f"until {at(last, run)}: it is frozen; repair it, or leave these readings out (NaN)"
        )


def require_no_fault(plant: Plant, seen: Windows, ends: Array, at: At) -> None:
    """Raise ValueError where a bias of one sensor explains what the plant does not in a window; ends (M,): their last samples.

    A bias counts from 3 sigma. For one of sensor i, T = g_i^2 / I_ii is chi-square with 1 degree of freedom when healthy; what
    is left of g' I^-1 g, chi-square with the rank of I less one, says whether it explains everything.
    """
    runs, many, _ = seen.g.shape
    count = len(plant.sensors)
    for w in range(many):
        for b in range(runs):
            sensor, size, explains = _alone(seen.g[b, w], seen.info[b, w], count, REFUSED / (count * runs * many))
            if explains and abs(size) >= LARGE:
                raise _contradiction(plant, sensor, size, f"in the {WINDOW} samples until {at(int(ends[w]), b)}")


def require_no_sensor(plant: Plant, found: FoundDisturbance) -> None:
    """Raise ValueError where a bias of one sensor explains a disturbance that was learnt, by the same test."""
    count = len(plant.sensors)
    assert found.score is not None and found.information is not None
    sensor, size, explains = _alone(found.score, found.information, count, REFUSED / count)
    size *= found.mean if np.isinf(found.time_constant) else np.sign(found.mean) * np.hypot(found.mean, found.sd)
    if explains and abs(size) >= LARGE:
        raise _contradiction(plant, sensor, size, "of the healthy log")


def _alone(g: Array, info: Array, count: int, level: float) -> tuple[int, float, bool]:
    """The sensor with the largest statistic, the size of its bias in its sigma, and whether it alone explains the rest."""
    own, known = g[-count:], np.maximum(np.diagonal(info)[-count:], np.finfo(float).tiny)
    statistic = own**2 / known
    i = int(np.argmax(statistic))
    size = float(own[i] / known[i])
    if statistic[i] <= chi2.isf(level, 1):
        return i, size, False
    values, vectors = np.linalg.eigh(info)
    kept = values > UNSEEN * values[-1]
    everything = np.sum((g @ vectors[:, kept]) ** 2 / values[kept])
    rest = everything - statistic[i]
    return i, size, bool(rest < chi2.isf(REFUSED, int(np.sum(kept)) - 1))


def _contradiction(plant: Plant, i: int, size: float, where: str) -> ValueError:
    sensor = plant.sensors[i]
    return ValueError(
        f"sensor {sensor.name!r} contradicts all others {where}: it reads {size * sensor.noise_sigma:.3g} {sensor.unit} "
        f"({size:.1f} sigma) off; repair or recalibrate it, or leave these readings out (NaN)"
    )
