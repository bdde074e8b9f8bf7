"""A sensor whose readings come late: they follow, so many rows behind, what the other sensors and the model predict.

After a diagnosis that is not healthy, each sensor with large residuals is left out of the filter, which then predicts it from
the others: p. Its reading is late by k rows where y(t) - p(t - k) scatters clearly less than y(t) - p(t), and no more than its
noise, in nearly all parts of the log. The scatter is about the median of each part, so that a bias is no lag, and a lag
hides no bias. A variable that hardly moves shows no lag, nor any residual by it.

That the readings fit better so is not enough where the model itself is off by a part of a row: a lag has to explain alarms that
a bias, drift or noise of the sensor leaves. What is isolated of a step that lasts stays so when the readings are shifted.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import huber
from threadpoolctl import threadpool_limits

from fusion_sfdia.detectors.detector import Detector
from fusion_sfdia.diagnosis.diagnose import Diagnosis, DiagnosisWarning, model_of
from fusion_sfdia.diagnosis.hindsight import hindsight
from fusion_sfdia.plant.gaps import bridged
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

LONGEST, PARTS, ROWS = 12, 4, 2000  # rows of a lag at most; parts of the log that agree; rows of it that are looked at
FEWEST = 12  # readings of a part
CANDIDATES, LARGE = 4, 1.2  # sensors that are looked at, with a mean square of residuals in standard deviations above
# by which log L is larger with the lag: more than ln(n) / 2 for its parameter (BIC) and ln `LONGEST` for the choice
EVIDENCE = 8.0
SHARE = 0.1  # of the samples in alarm that a lag explains at least
FOLLOWS, MOST_SD = 3.0, 10.0  # standard errors of a correlation; residuals in standard deviations that it takes as they are
MOST = 3  # late sensors
EXPLAINED = 1.5  # standard deviations: scatter with the lag
HUBER, MOST_CORRELATED = 2.0, 0.95  # standard deviations up to which a residual counts by its square; correlation of residuals
SCATTER = 1.4826  # standard deviation of a normal variable over its median absolute deviation


class Lag(NamedTuple):
    """The position of a sensor and by how many rows its readings are late."""

    sensor: int
    rows: int

    def summary(self, plant: Plant, log: Log) -> str:
        """In words: "level_1 is late by 4 rows (240 s)"."""
        rows, step = self.rows, self.rows * float(np.median(np.diff(log.t)))
        return f"{plant.sensor_names[self.sensor]} is late by {rows} row{'s' * (rows != 1)} ({step:.6g} s)"


def explained_by_lag(
    detector: Detector, log: Log, found: Diagnosis, again: Callable[[Log], Diagnosis]
) -> tuple[Diagnosis, Log]:
    """The diagnosis of a log of one run, or, where late sensors explain most of its isolations, that of the log with their
    readings moved to when they were true, which states so; and the log that it is of. again: diagnoses a log.
    """
    texts = list[str]()
    while found.events and (late := latest(detector, log, found)) is not None and len(texts) < MOST:
        i, rows = late
        near = range(max(rows - 1, 1), rows + 2)  # the prediction may be off itself, by a row
        tried = [(k, earlier(log, i, k)) for k in sorted(near, key=lambda k: abs(k - late.rows))]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DiagnosisWarning)  # they were issued with the first
            results = [(k, moved, _without_end(again(moved), detector.plant.sensor_names[i], k)) for k, moved in tried]
        rows, moved, result = min(results, key=lambda r: (_flagged(r[2]), _residual(r[2], i)))
        if not _explains(_flagged(found), _flagged(result), rows):
            break
        texts.append(
            f"{Lag(i, rows).summary(detector.plant, log)}: its readings were shifted back by that much; correct the time "
            "stamps, or add the delay to the model"
        )
        log, found = moved, replace(result, of_log=(*result.of_log, *texts))
    return found, log


def earlier(log: Log, i: int, rows: int) -> Log:
    """The log with the readings of sensor i so many rows earlier; the last ones are missing."""
    y = log.y.copy()
    y[:-rows, i], y[-rows:, i] = log.y[rows:, i], np.nan
    return log._replace(y=y)


def _without_end(found: Diagnosis, sensor: str, rows: int) -> Diagnosis:
    """The diagnosis without a dropout of the sensor in the last rows, of which no reading has come yet."""
    end = float(found.t[-rows])
    kept = tuple(e for e in found.events if not (e.hypothesis == sensor and e.fault == "dropout" and e.start >= end))
    return replace(found, events=kept)


def _flagged(found: Diagnosis) -> int:
    """The samples in which anything is isolated, accepted or suspected."""
    d = found.decisions
    flags = [d.isolated, *(v for v in (d.process, d.suspect) if v is not None)]
    return int(np.sum(np.any(np.concatenate([np.atleast_2d(f) for f in flags], axis=-1), axis=-1)))


def _explains(before: int, after: int, rows: int) -> bool:
    """Whether a lag of so many rows explains the alarm of so many samples that fewer are left after the shift: all of them, or
    a share of at least `SHARE`, and more than the rows by which it moves the end of an event.
    """
    return after < before and (after == 0 or before - after > max(rows, SHARE * before))


def _residual(found: Diagnosis, i: int) -> float:
    """The mean square of the residuals of sensor i over their variances, where they were looked at again."""
    if found.after is None:
        return 0.0
    with np.errstate(invalid="ignore", divide="ignore"):
        z = found.after.error[:, i] / found.after.sd[:, i]
    return float(np.nanmean(z**2))


def latest(detector: Detector, log: Log, found: Diagnosis) -> Lag | None:
    """The sensor with large residuals for which the evidence that it is late is largest; None where none is."""
    if found.after is None:
        return None
    with np.errstate(invalid="ignore", divide="ignore"):
        z = (found.after.error / found.after.sd)[:ROWS]
    large = np.array([np.mean(c[np.isfinite(c)] ** 2) if np.isfinite(c).sum() >= FEWEST else 0.0 for c in z.T])
    named = {name for e in found.events for name in (e.hypothesis, *e.alternatives, *getattr(e, "suspects", ()))}
    chosen = [i for i, name in enumerate(detector.plant.sensor_names) if large[i] > LARGE or name in named]
    chosen = [i for i in chosen if _follows_change(log.y[:ROWS, i], found.after.error[:ROWS, i], z[:, i])]
    chosen = sorted(chosen, key=lambda i: -large[i])[:CANDIDATES]
    part = log.rows(slice(ROWS))
    best = [(evidence, Lag(i, rows)) for i in chosen for rows, evidence in [_lag(model_of(detector), part, i)] if rows]
    return max(best)[1] if best else None


def _follows_change(y: Array, error: Array, z: Array) -> bool:
    """Whether the residuals of a sensor go with the change of what is predicted since some rows ago, as those of a late one."""
    predicted = y - error
    for rows in (1, 3, 6, LONGEST):
        if y.size <= 2 * PARTS * rows:
            break
        change = predicted[:-rows] - predicted[rows:]
        known = np.isfinite(change) & np.isfinite(z[rows:])
        if known.sum() < FEWEST * PARTS:
            continue
        parts = (np.array_split(v[known], PARTS) for v in (z[rows:], change))
        a, b = (np.concatenate([part - np.median(part) for part in v]) for v in parts)
        a = np.clip(a, -MOST_SD, MOST_SD)
        if a @ b > FOLLOWS / np.sqrt(a.size) * np.sqrt((a @ a) * (b @ b)):
            return True
    return False


def _lag(model: Plant, log: Log, i: int) -> tuple[int, float]:
    """By how many rows sensor i is late, 0 for none, and the evidence for it."""
    track, _ = bridged(model, log)
    out = np.zeros(log.y.shape, bool)
    out[:, i] = True
    with threadpool_limits(1):
        look = hindsight(model, track, out)
    y, sd = log.y[:, i], look.sd[:, i]
    predicted = y - look.error[:, i]
    known = np.isfinite(predicted)
    if known.sum() < FEWEST * PARTS:
        return 0, 0.0
    at = np.arange(y.size)
    predicted = np.interp(at, at[known], predicted[known])  # between the readings of a slow sensor
    z = [_about_medians(y[k:] - predicted[: y.size - k], sd[k:], k) for k in range(LONGEST + 1)]
    gain, scatter = np.array([_gain(z[0], late) for late in z]).swapaxes(0, 1)
    k = int(np.argmax(np.sum(gain, axis=1)))
    agree = (scatter[k] < EXPLAINED) & (gain[k] > -1.0)
    evidence = float(np.sum(gain[k]))
    return (k, evidence) if k and np.sum(agree) >= PARTS - 1 and evidence > EVIDENCE else (0, 0.0)


def _about_medians(r: Array, sd: Array, k: int) -> list[Array]:
    """Residuals in standard deviations about the median of each part of the log, k rows of which are before them."""
    parts = np.array_split(np.concatenate([np.full(k, np.nan), r / sd]), PARTS)
    return [
        part - np.median(part[np.isfinite(part)]) if np.isfinite(part).sum() >= FEWEST else np.full_like(part, np.nan)
        for part in parts
    ]


def _gain(now: list[Array], late: list[Array]) -> tuple[Array, Array]:
    """By how much the log-likelihood of each part (PARTS,) is larger with the lag than without, and the scatter with it.

    The noise is as large as it is seen to be with the lag, sigma = `SCATTER` median |z|, at least a tenth of what is stated,
    and the same rows are compared, so that noise alone, which is in both, gains nothing:
    sum_t rho(z_t / sigma) - rho(z'_t / sigma), with z and z' without and with the lag and Huber's rho, which is z^2 / 2 up to
    `HUBER` and linear above. Errors of the prediction last for some rows, so that n residuals with the correlation phi from row
    to row say as much as n (1 - phi) / (1 + phi).
    """
    gain, scatter = np.zeros(PARTS), np.ones(PARTS)
    for j, (a, b) in enumerate(zip(now, late, strict=True)):
        known = np.isfinite(a) & np.isfinite(b)
        if known.sum() < FEWEST:
            continue
        a, b = a[known], b[known]
        scatter[j] = max(SCATTER * float(np.median(np.abs(b))), 0.1)
        a, b = a / scatter[j], b / scatter[j]
        calm = np.clip(b, -HUBER, HUBER)
        phi = float(np.clip(calm[1:] @ calm[:-1] / max(calm @ calm, 1e-300), 0.0, MOST_CORRELATED))
        gain[j] = np.sum(huber(HUBER, a) - huber(HUBER, b)) * (1 - phi) / (1 + phi)
    return gain, scatter
