"""Events of sensors with what is known afterwards: kind and size of the fault, other sensors that may have it, silent and
frozen sensors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from fusion_sfdia.detectors.detector import Decision, Detector, chosen
from fusion_sfdia.diagnosis.absent import dropouts, due
from fusion_sfdia.diagnosis.events import EVEN, TOGETHER, Event
from fusion_sfdia.diagnosis.fault_kinds import FEW, POSSIBLE, QUIET, Named, name, noise_of, resized
from fusion_sfdia.diagnosis.hindsight import Residuals

Array = NDArray[Any]

HEALTHY = 2.0  # standard deviations: root mean square of residuals up to which a sensor that moves again is right
STILL = 0.4  # share of equal successive readings of a healthy sensor above which they mean nothing


def false_alarm_of(detector: Detector) -> float:
    """The rate of false alarms that a detector states, else 1e-3."""
    rate = detector.false_alarm
    return float(rate) if rate is not None and 0 < rate < 1 else 1e-3


def alarm_rate_of(detector: Detector) -> float:
    """The rate of false alarms at which a detector acts: that for which its thresholds were fitted, else what it states."""
    return false_alarm_of(detector) if detector.fitted_rate is None else float(detector.fitted_rate)


def explained(
    detector: Detector,
    t: Array,
    y: Array,
    decisions: Decision,
    events: Sequence[Event],
    after: Residuals,
    frozen: Sequence[Sequence[tuple[int, int]]],
) -> tuple[Event, ...]:
    """Return the events with those of sensors explained, and with those of sensors that are silent or `frozen` (of each
    sensor first and last sample), unless the model does not know them: when these are, the detector says. The others first,
    then sensors and other faults in order of their start.
    """
    sensors = detector.plant.sensors
    found = [_accepted(detector, t, decisions, e) for e in events if e.kind not in ("sensor", "other")]
    faults: list[Event] = [e for e in events if e.kind == "other"]
    silent = dropouts(y)
    for i, sensor in enumerate(sensors):
        own = [e for e in events if e.kind == "sensor" and e.hypothesis == sensor.name]
        spans = [(int(np.searchsorted(t, e.start)), int(np.searchsorted(t, e.end))) for e in own]
        held = np.zeros(len(t), bool)
        for a, b in spans:
            held[a : b + 1] = True
        expected = due(y[:, i], silent[i])
        pairs = np.diff(y[~held & np.isfinite(y[:, i]), i])
        still = pairs.size > 0 and bool(np.mean(pairs == 0) > STILL)
        mine, noise = [], noise_of(detector.plant, i)
        for first, last in _groups(spans):
            a, b = spans[first][0], spans[last][1]
            part = slice(a, b + 1)
            over = b < len(t) - 1
            named = name(after.error[part, i], after.sd[part, i], noise, y[part, i][expected[part]], still=still, over=over)
            for e, (k, end) in zip(own[first : last + 1], spans[first : last + 1], strict=True):
                error, sd = after.error[k : end + 1, i], after.sd[k : end + 1, i]
                of_it = resized(named, error, sd, noise)
                confidence, rivals = rivals_at(detector, decisions, i, k)
                if is_in_doubt(decisions, i, end) or (end < len(t) - 1 and may_be_outliers(error, sd)):
                    confidence = min(confidence, EVEN)
                mine.append(replace(_with(e, of_it, noise.sigma), confidence=confidence, alternatives=rivals))
        for kind, stretches in (("freeze", frozen[i]), ("dropout", silent[i])):
            for a, b in stretches if i < detector.plant.modelled else ():
                mine = with_stretch(mine, kind, t, a, b, sensor.name, sensor.unit)
        with np.errstate(invalid="ignore"):
            z = after.error[:, i] / after.sd[:, i]
        faults += [_until_it_moves(e, t, z, frozen[i]) for e in mine]
    return (*found, *sorted(faults, key=lambda e: (e.start, e.hypothesis)))


def _groups(spans: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """The first and last of the events, given by their first and last samples, that are judged together."""
    groups: list[tuple[int, int]] = []
    for j, (a, _) in enumerate(spans):
        if groups and a - spans[groups[-1][1]][1] - 1 < TOGETHER:
            groups[-1] = (groups[-1][0], j)
        else:
            groups.append((j, j))
    return groups


def _with(e: Event, named: Named, sigma: float) -> Event:
    """An event with the kind of its fault; with its size, unless that could not be found from residuals."""
    if named.kind == "dropout":
        return replace(e, fault="dropout", size=np.nan)
    if not np.isfinite(named.size):
        return replace(e, fault=named.kind or e.fault, sigmas=e.size / float(sigma))
    return replace(
        e,
        fault=named.kind,
        size=named.size,
        low=named.low,
        high=named.high,
        sigmas=named.size / float(sigma),
        fault_alternatives=named.alternatives,
    )


def with_stretch(events: list[Event], kind: str, t: Array, a: int, b: int, sensor: str, unit: str) -> list[Event]:
    """The events of a sensor with a stretch from sample a to b in which it is silent or frozen.

    Events of that kind that overlap the stretch are one with it, and so is, of a frozen sensor, any event that begins in it:
    what follows is how long the detector takes to trust the sensor again. Confidence and alternatives, which are of tests for
    the size of a fault, do not apply to it. A stretch of equal readings within another fault adds nothing.
    """
    if kind == "freeze" and any(e.start < t[a] and e.end >= t[b] for e in events):
        return events
    start, end, certain = float(t[a]), float(t[b]), 1.0 if kind == "dropout" else np.nan
    one = Event(sensor, start, end, np.nan, unit, b == len(t) - 1, fault=kind, confidence=certain)
    kept = []
    for e in events:
        if e.end < start or e.start > end or not (e.fault == kind or (kind == "freeze" and e.start >= start)):
            kept.append(e)
            continue
        larger = e if not abs(one.sigmas) > abs(e.sigmas) else one
        one = replace(
            larger,
            start=min(e.start, one.start),
            end=max(e.end, one.end),
            open=e.open or one.open,
            fault=kind,
            fault_alternatives=(),
            confidence=certain,
            alternatives=(),
        )
    return [*kept, one]


def _until_it_moves(e: Event, t: Array, z: Array, frozen: Sequence[tuple[int, int]]) -> Event:
    """An event of a sensor, ended where its equal readings end; z (K,): residuals over their standard deviations.

    The detector isolates the sensor for a while longer, until it trusts it again. Where the residuals of these readings are
    not those of a healthy sensor, the event goes on.
    """
    ends = [b for _, b in frozen if e.start <= t[b] <= e.end]
    if e.fault != "freeze" or not ends or t[ends[-1]] == e.end:
        return e
    rest = z[ends[-1] + 1 : int(np.searchsorted(t, e.end)) + 1]
    rest = rest[np.isfinite(rest)]
    if rest.size and np.mean(rest**2) > HEALTHY**2:
        return e
    return replace(e, end=float(t[ends[-1]]), open=False)


def is_in_doubt(decisions: Decision, i: int, end: int) -> bool:
    """Whether sensor i is a suspect once it is no longer isolated, after sample `end`: the isolation was not upheld."""
    return decisions.suspect is not None and end + 1 < len(decisions.suspect) and bool(decisions.suspect[end + 1, i])


def may_be_outliers(error: Array, sd: Array) -> bool:
    """Whether at most `FEW` residuals (K,) of an event that is over are large: a healthy sensor may have as many outliers."""
    known = np.isfinite(error) & np.isfinite(sd)
    return bool(known.any() and np.sum(np.abs(error[known]) > QUIET * sd[known]) <= FEW)


def _accepted(detector: Detector, t: Array, decisions: Decision, e: Event) -> Event:
    """A change of the process with its probability when it was accepted, where the detector states one and prefers it."""
    names = (*detector.hypotheses, *(h.name for h in detector.process_hypotheses))
    if e.kind != "process" or decisions.probability is None or e.hypothesis not in names:
        return e
    probability = float(decisions.probability[int(np.searchsorted(t, e.start)), names.index(e.hypothesis)])
    return replace(e, confidence=probability) if probability >= EVEN else e


def rivals_at(detector: Detector, decisions: Decision, i: int, k: int) -> tuple[float, tuple[str, ...]]:
    """The probability of hypothesis i when it was isolated, at sample k, and the other hypotheses that could not be excluded.

    Of a detector that states probabilities, these, and the suspects of the sample before. Otherwise from the test statistics
    of the sensors, T = (score q)^2 with q the normal quantile of the detector's rate of false alarms, shared by the sensors:
    twice the logarithm of a likelihood ratio, so that the probability is exp(T_i / 2) / sum_j exp(T_j / 2).
    """
    tested = detector.process_hypotheses
    names = (*detector.hypotheses, *(h.name for h in tested))
    count = len(detector.plant.sensors)
    together = decisions.isolated[k]
    if decisions.probability is not None:
        probability = np.where(np.isfinite(decisions.probability[k]), decisions.probability[k], 0.0)
    else:
        q = ndtri(false_alarm_of(detector) / count / 2) * detector.threshold_scale
        score = chosen(decisions, k).scores
        score = np.where(np.isfinite(score), score, 0.0)
        others = ~together[:count]
        others[i] = True
        half = np.where(others, np.minimum(np.abs(score * q), 1e6) ** 2 / 2, -np.inf)
        weight = np.exp(half - np.max(half))
        probability = np.zeros(len(names))
        probability[:count] = weight / np.sum(weight)
    possible = probability > POSSIBLE
    if decisions.suspect is not None and k > 0:
        possible |= decisions.suspect[k - 1]
    possible[: together.size] &= ~together
    if decisions.process is not None:  # accepted beside the sensor, not in its place
        possible[len(detector.hypotheses) :] &= ~decisions.process[k]
    possible[i] = False
    ordered = sorted(np.flatnonzero(possible).tolist(), key=lambda j: -probability[j])
    own = float(probability[i])
    return (own if own > 0 else np.nan), tuple(names[j] for j in ordered)
