"""Whether and when a fault is detected: sample-wise rates, ROC, events.

alarm (K, B) bool; active (K, B, N) bool, where a fault acts; isolated (K, B, N) bool, the isolated sensors; t (K,) s.
`where` (K, B) bool restricts what is counted, for example to the samples after the start-up. Intervals: see metrics.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from sklearn.metrics import roc_curve

from fusion_sfdia.common.run_statistics import (
    NOTHING,
    Estimate,
    by_run,
    jackknife_over_runs,
    mean_over_runs,
    per_sample,
    proportion,
    rate_over_runs,
    require_shapes,
)

Array = NDArray[Any]


class RocCurve(NamedTuple):
    """A curve over falling thresholds: alarm where score >= threshold.

    Attributes
    ----------
    false_alarm_probability : array (T,)
        Share of the healthy samples in alarm.
    detection_probability : array (T,)
        Share of the faulty samples in alarm.
    threshold : array (T,)
        On the score.

    Examples
    --------
    See `roc`.
    """

    false_alarm_probability: Array
    detection_probability: Array
    threshold: Array


def detection_probability(alarm: Array, active: Array, where: Array | None = None) -> Estimate:
    """P(alarm | a fault is active), by samples."""
    faulty = _faulty(alarm, active)
    return _rate(alarm, faulty, where)


def false_alarm_probability(alarm: Array, active: Array, where: Array | None = None) -> Estimate:
    """P(alarm | no fault is active), by samples; an alarm that outlasts its fault counts as false."""
    return _rate(alarm, ~_faulty(alarm, active), where)


def accuracy(alarm: Array, active: Array, where: Array | None = None) -> Estimate:
    """P(alarm if and only if a fault is active), by samples; it depends on how long the faults are within the run."""
    faulty = _faulty(alarm, active)
    return _rate(alarm == faulty, np.ones_like(faulty), where)


def trial_accuracy(alarm: Array, isolated: Array, active: Array, where: Array | None = None) -> Estimate:
    """Share of runs judged right as a whole, see `judged_right`, with Wilson's interval."""
    right = judged_right(alarm, isolated, active, where)
    if where is not None:
        right = right[where.any(axis=0)]
    return proportion(int(right.sum()), right.size)


def judged_right(alarm: Array, isolated: Array, active: Array, where: Array | None = None) -> Array:
    """Whether each run (B,) is judged right as a whole.

    A run with a fault is right where an alarm is raised while it is active and, over the samples at which it is, the faulty
    sensor is isolated more often than any other; with several, each of them more often than any healthy one. A run without
    faults is right where no alarm is raised. Shaheen 2024 does not define the accuracy of its Tables V to VII; the entries
    of V and VII (but for one) are multiples of 1/36 or 1/60, which shares of samples would not be.
    """
    faulty = _faulty(alarm, active)
    require_shapes(isolated=(isolated, active.shape))
    counted = np.ones_like(faulty) if where is None else where
    during = faulty & counted
    votes = (isolated & during[..., None]).sum(axis=0)
    faulty_sensor = (active & during[..., None]).any(axis=0)
    least = np.where(faulty_sensor, votes, np.iinfo(votes.dtype).max).min(axis=-1)
    most = np.where(faulty_sensor, 0, votes).max(axis=-1)  # 0 where all are faulty: each has to be isolated then
    hit = (alarm & during).any(axis=0) & (least > most)
    quiet = ~(alarm & counted).any(axis=0)
    return np.asarray(np.where(during.any(axis=0), hit, quiet))


def roc(scores: Array, active: Array, where: Array | None = None) -> RocCurve:
    """Receiver operating characteristic by samples.

    It is that of the method only where nothing was accommodated during the run: a threshold changes what follows.

    Parameters
    ----------
    scores : array (K,), (K, B) or (K, B, N)
        Largest |residual| / threshold of each sample, of one run or of several; with sensors, to judge each of them separately.
    active : array (K, B, N) of bool
        Whether each sensor is faulty; of one run also (K, N), or (K,) whether any is.
    where : array (K, B) of bool, optional
        The samples that count, of one run also (K,); None for all.

    Returns
    -------
    RocCurve
        Empty where there are no faulty or no healthy samples.

    Raises
    ------
    ValueError
        For shapes that do not fit, and for a score of NaN that counts: give a sample that was not evaluated the score 0.

    Examples
    --------
    >>> import numpy as np
    >>> from fusion_sfdia import roc
    >>> scores = np.array([[0.2], [0.4], [1.5], [0.9]])  # (K, B) of one run
    >>> active = np.array([[[False]], [[False]], [[True]], [[True]]])  # (K, B, N) of one sensor
    >>> curve = roc(scores, active)
    >>> curve.false_alarm_probability, curve.detection_probability
    (array([0., 0., 0., 1.]), array([0. , 0.5, 1. , 1. ]))
    """
    if np.ndim(scores) == 1:  # of one run
        scores, active, where = per_sample(scores), by_run(active), per_sample(where)
    score, truth, _ = _labelled(scores, active, where)
    if not score.size or truth.all() or not truth.any():
        return RocCurve(np.empty(0), np.empty(0), np.empty(0))
    return RocCurve(*roc_curve(truth, score))


def auc(scores: Array, active: Array, where: Array | None = None) -> Estimate:
    """Area under the ROC, P(score of a faulty sample > of a healthy one) + P(equal) / 2, with a jackknife over runs.

    Parameters
    ----------
    scores : array (K, B) or (K, B, N)
        As of `roc`.
    active : array (K, B, N) of bool
        As of `roc`.
    where : array (K, B) of bool, optional
        As of `roc`.

    Returns
    -------
    Estimate
        The area with its 95 % interval and the number of runs; NaN where there are no faulty or no healthy samples.

    Raises
    ------
    ValueError
        As `roc` does.

    Examples
    --------
    >>> import numpy as np
    >>> from fusion_sfdia.metrics import auc
    >>> scores = np.array([[0.2, 0.3], [0.4, 0.1], [1.5, 0.2], [0.9, 2.0]])  # (K, B) of two runs
    >>> active = np.repeat([[[False]], [[False]], [[True]], [[True]]], 2, axis=1)  # (K, B, N) of one sensor
    >>> round(float(auc(scores, active).value), 3)
    0.844
    """
    area = _area(scores, active, where)
    return NOTHING if area is None else jackknife_over_runs(area, scores.shape[1])


def mean_auc(curves: Sequence[tuple[Array, Array]]) -> Estimate:
    """The mean of the areas under several ROCs of the same runs, each of scores and active, with a jackknife over runs."""
    areas = [_area(scores, active, None) for scores, active in curves]
    known = [area for area in areas if area is not None]
    if not known or len({scores.shape[1] for scores, _ in curves}) > 1:
        return NOTHING
    return jackknife_over_runs(lambda w: np.mean([area(w) for area in known], axis=0), curves[0][0].shape[1])


def _area(scores: Array, active: Array, where: Array | None) -> Callable[[Array], Array] | None:
    """The area under the ROC for weights w (..., R) of the runs; None without faulty or without healthy samples."""
    score, truth, run = _labelled(scores, active, where)
    runs = scores.shape[1]
    positives, negatives = (np.bincount(run[truth == kind], minlength=runs).astype(float) for kind in (True, False))
    if positives.sum() == 0 or negatives.sum() == 0:
        return None
    wins = np.stack([_wins(score[truth], run[truth], score[~truth & (run == b)], runs) for b in range(runs)], axis=-1)
    overall = float(wins.sum() / (positives.sum() * negatives.sum()))

    def area(w: Array) -> Array:
        """Return w' wins w / (w' positives w' negatives), w the weights of the runs; overall where one kind is absent."""
        pairs = (w @ positives) * (w @ negatives)
        won = ((w @ wins) * w).sum(axis=-1)
        return np.asarray(np.where(pairs > 0, won / np.where(pairs > 0, pairs, 1.0), overall))

    return area


def false_alarms(alarm: Array, active: Array, where: Array | None = None) -> int:
    """Number of samples with an alarm and no active fault."""
    false = alarm & ~_faulty(alarm, active)
    return int((false if where is None else false & where).sum())


def missed_detection_rate(alarm: Array, active: Array) -> Estimate:
    """Share of the faults (unbroken spans of active of one sensor) during which no alarm is raised."""
    _faulty(alarm, active)
    found = events(active)
    missed = np.array([not alarm[a : b + 1, run].any() for run, _, a, b in found], bool)
    return rate_over_runs(_by_run(found, missed, alarm.shape[1]), _by_run(found, np.ones(len(found)), alarm.shape[1]))


def detection_delay(t: Array, alarm: Array, active: Array) -> Estimate:
    """Mean seconds from a fault's first sample to the first alarm during it, over the faults that are detected.

    An alarm raised before the fault counts as one at its first sample. Read it together with missed_detection_rate.
    """
    _faulty(alarm, active)
    return _delay(t, np.broadcast_to(alarm[..., None], active.shape), active)


def isolation_delay(t: Array, isolated: Array, active: Array) -> Estimate:
    """Mean seconds from a fault's first sample to the first at which its sensor is isolated, over the isolated faults."""
    require_shapes(isolated=(isolated, active.shape))
    return _delay(t, isolated, active)


def first_alarm_time(t: Array, alarm: Array) -> Estimate:
    """Mean time of the first alarm (s), over the runs that have one."""
    require_shapes(t=(t, alarm.shape[:1]))
    if not t.size:
        return NOTHING
    return mean_over_runs(t[np.argmax(alarm, axis=0)], np.asarray(alarm.any(axis=0)))


def events(active: Array) -> list[tuple[int, int, int, int]]:
    """Return (run, sensor, first, last sample) of each unbroken span of active (K, B, N), by run, sensor and time."""
    padded = np.zeros((active.shape[0] + 2, *active.shape[1:]), np.int8)
    padded[1:-1] = active
    change = np.diff(padded, axis=0).transpose(1, 2, 0)
    run, sensor, first = np.nonzero(change == 1)
    last = np.nonzero(change == -1)[2] - 1
    return list(zip(run.tolist(), sensor.tolist(), first.tolist(), last.tolist(), strict=True))


def _faulty(alarm: Array, active: Array) -> Array:
    require_shapes(alarm=(alarm, active.shape[:2]))
    return np.asarray(active.any(axis=-1))


def _rate(hit: Array, among: Array, where: Array | None) -> Estimate:
    among = among if where is None else among & where
    return rate_over_runs((hit & among).sum(axis=0), among.sum(axis=0))


def _labelled(scores: Array, active: Array, where: Array | None) -> tuple[Array, Array, Array]:
    """Scores, truth and run of every sample that is counted, flat; an infinite score is the largest number."""
    truth: Array = active if scores.ndim == 3 else np.asarray(active.any(axis=-1))
    counted = np.ones(truth.shape[:2], bool) if where is None else where
    require_shapes(scores=(scores, truth.shape), where=(counted, truth.shape[:2]))
    if np.any(np.isnan(scores[counted])):
        raise ValueError("scores has NaN; give a sample that was not evaluated the score 0, or leave it out by `where`")
    run = np.broadcast_to(np.arange(truth.shape[1]).reshape((-1,) + (1,) * (truth.ndim - 2)), truth.shape)
    largest = np.finfo(float).max
    bounded = np.clip(np.asarray(scores, dtype=float), -largest, largest)
    return bounded[counted].ravel(), truth[counted].ravel(), run[counted].ravel()


def _wins(faulty: Array, run: Array, healthy: Array, runs: int) -> Array:
    """Pairs (runs,) in which the faulty score of that run is above a healthy one; ties count half."""
    healthy = np.sort(healthy)
    below, upto = np.searchsorted(healthy, faulty, "left"), np.searchsorted(healthy, faulty, "right")
    return np.bincount(run, weights=(below + upto) / 2, minlength=runs)


def _delay(t: Array, seen: Array, active: Array) -> Estimate:
    require_shapes(t=(t, active.shape[:1]))
    found = [
        (run, i, a, int(np.argmax(seen[a : b + 1, run, i]))) for run, i, a, b in events(active) if seen[a : b + 1, run, i].any()
    ]
    delays = np.array([t[a + later] - t[a] for _, _, a, later in found])
    runs = active.shape[1]
    return mean_over_runs(_by_run(found, delays, runs), _by_run(found, np.ones(len(found)), runs))


def _by_run(found: list[tuple[int, int, int, int]], values: Array, runs: int) -> Array:
    return np.bincount([event[0] for event in found], weights=values, minlength=runs) if found else np.zeros(runs)
