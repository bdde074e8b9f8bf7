"""What is kept of a branch: a few numbers a run, so that parts are small and any metric is a sum over runs."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.detector import Decision
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.study.detection_metrics import judged_right
from fusion_sfdia.study.experiments.scenario import Arrays

Array = NDArray[Any]

CONFIRMATIONS = 3  # alarms in a row that Boem 2018 waits for


class BranchReadings(NamedTuple):
    """Readings of a branch (W, B, N): as the detector gets them, without the sensors' faults, without noise; active, size.

    u (W, B, m): the inputs as they are known.
    """

    u: Array
    y: Array
    unfaulted: Array
    signal: Array
    active: Array
    size: Array


class KeptDecisions(NamedTuple):
    """What is kept of Decisions, (W, B) or (W, B, N), N sensors."""

    alarm: Array
    diverged: Array
    isolated: Array
    scores: Array
    fault_size: Array
    reconstruction: Array


def kept(plant: Plant, decision: Decision) -> KeptDecisions:
    """What is kept of a Decision."""
    n = len(plant.sensors)
    return KeptDecisions(
        decision.alarm,
        decision.diverged,
        decision.isolated[..., :n],
        decision.scores,
        decision.fault_size[..., :n],
        decision.reconstruction,
    )


def record(plant: Plant, decision: KeptDecisions, branch: BranchReadings) -> Arrays:
    """Arrays (B,) of the runs of a branch of W samples.

    samples: W. alarms: samples with an alarm. first, confirmed, own: samples until the first, until the third in a row, and
    until the first of a faulty sensor's own residual, inf for none. right, isolated, faulty: sensor-samples that are isolated
    and faulty, isolated, faulty. exact: samples at which exactly the faulty sensors are isolated. falsely_isolated: samples at
    which a healthy sensor is. isolated_as (B, Q + 2): samples at which none is isolated, healthy sensors of each quantity, a
    faulty sensor; where several are isolated, each has its share of the sample. judged: see `judged_right`. size_error: mean
    |size / true size - 1| where isolated. Mean squared errors against the noise-free readings in the sensors' variances: of the
    faulty sensors measured, raw, noise (without fault); of all sensors all_measured, all_raw. diverged.
    """
    isolated, active = decision.isolated, branch.active
    right = isolated & active
    alarm = decision.alarm
    sized = right & np.isfinite(decision.fault_size) & np.isfinite(branch.size) & (branch.size != 0)
    ratio = np.where(sized, decision.fault_size, 1.0) / np.where(sized, branch.size, 1.0)
    return {
        "samples": np.full(alarm.shape[1], alarm.shape[0]),
        "alarms": alarm.sum(axis=0),
        "first": until(alarm),
        "confirmed": until(in_a_row(alarm, CONFIRMATIONS)),
        "own": until(np.any(active & (decision.scores > 1), axis=-1)),
        "right": right.sum(axis=(0, 2)),
        "isolated": isolated.sum(axis=(0, 2)),
        "faulty": active.sum(axis=(0, 2)),
        "exact": ((isolated == active).all(axis=-1) & active.any(axis=-1)).sum(axis=0),
        "falsely_isolated": (isolated & ~active).any(axis=-1).sum(axis=0),
        "isolated_as": isolated_as(plant, isolated, active),
        "judged": judged_right(alarm, isolated, active),
        "size_error": _mean(np.abs(ratio - 1), sized),
        "measured": _error(plant, decision.reconstruction, branch, active),
        "raw": _error(plant, branch.y, branch, active),
        "noise": _error(plant, branch.unfaulted, branch, active),
        "all_measured": _error(plant, decision.reconstruction, branch, np.ones_like(active)),
        "all_raw": _error(plant, branch.y, branch, np.ones_like(active)),
        "diverged": np.any(decision.diverged, axis=0),
    }


def isolated_as(plant: Plant, isolated: Array, active: Array) -> Array:
    """Samples (B, Q + 2) by what is isolated, see `record`; isolated, active (W, B, N)."""
    count = isolated.sum(axis=-1, keepdims=True)
    share = np.where(isolated, 1.0 / np.maximum(count, 1), 0.0)
    wrong = np.where(active, 0.0, share)
    columns = [count[..., 0] == 0, *(wrong[..., members].sum(axis=-1) for members in plant.quantities.values())]
    return np.stack([*(c.sum(axis=0) for c in columns), np.where(active, share, 0.0).sum(axis=(0, 2))], axis=-1)


def until(seen: Array) -> Array:
    """Samples (B,) until the first that is seen (W, B), inf for none."""
    return np.where(np.any(seen, axis=0), np.argmax(seen, axis=0), np.inf)


def in_a_row(alarm: Array, count: int) -> Array:
    """Whether an alarm (W, B) is at least the count-th in a row."""
    found = alarm.copy()
    for earlier in range(1, count):
        found[earlier:] &= alarm[:-earlier]
        found[:earlier] = False
    return found


def _error(plant: Plant, readings: Array, branch: BranchReadings, where: Array) -> Array:
    """Mean squared error (B,) in variances of the sensors' noise; NaN where there is no reading."""
    square = (readings - branch.signal) ** 2 / plant.sensor_cov
    return _mean(square, where & np.isfinite(square))


def _mean(values: Array, where: Array) -> Array:
    counted = where.sum(axis=(0, 2))
    with warnings.catch_warnings(), np.errstate(invalid="ignore"):
        total = np.where(where, values, 0.0).sum(axis=(0, 2))
    return np.asarray(np.where(counted > 0, total / np.maximum(counted, 1), np.nan))


def join(parts: Sequence[Arrays]) -> Arrays:
    """Conditions (S, ...) one below the other."""
    return {name: np.stack([p[name] for p in parts]) for name in parts[0]}
