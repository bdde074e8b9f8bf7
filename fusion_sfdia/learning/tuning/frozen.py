"""Tuning of the frozen model: what is unhealthy is left out and listed, so that there always is a result.

The detector commissions the plant itself (`frozen_model`), in a few passes over stretches of the log side by side. Readings of
a sensor that stands still, and blocks of rows that are unlike all others, are left out.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.rate import Rate
from fusion_sfdia.common.steps import Each, in_silence
from fusion_sfdia.diagnosis.events import TOGETHER, spans
from fusion_sfdia.learning.commissioning.parameters import declared
from fusion_sfdia.learning.commissioning.refusals import still
from fusion_sfdia.learning.frozen_model.commissioned_bank import with_bank
from fusion_sfdia.learning.frozen_model.commissioned_model import Learnt, commissioned_without_faults
from fusion_sfdia.learning.frozen_model.frozen_bank import FrozenBank
from fusion_sfdia.learning.frozen_model.frozen_filter import unknowns
from fusion_sfdia.learning.frozen_model.window_means import WINDOWS
from fusion_sfdia.learning.tuning.tail import counted, shortest, threshold, threshold_figures
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

LASTING_FAULT, MOST_FAULTS = 60, 3  # rows of a sensor's fault that is remarked on; sensors
FAR = 3.0  # prior standard deviations of an unknown, beyond which it is remarked on


class FrozenTuning(NamedTuple):
    """The tuned detector, and tables and figures of the file."""

    detector: FrozenBank
    tables: dict[str, Any]
    quality: dict[str, Any]


def tuned_frozen(
    plant: Plant, log: Log, at: Callable[[int, int], str], rate: Rate, strict: bool, each: Each = in_silence
) -> FrozenTuning:
    """Commission the frozen model on runs y (K, B, N); at: the time of a row of a run in words. each: as of `commissioned`.

    ValueError where rows are too few for the plant; with strict also where any have to be left out.
    """
    dt = float(np.median(np.diff(log.t)))
    log, left_out = _moving(plant, log, at)
    learnt, unlike, log = commissioned_without_faults(plant, log, each)
    left_out += [
        f"all readings from {at(a, b)} to {at(z, b)}: {np.sqrt(times):.2g} times as far off as in the rest of the log"
        for b, a, z, times in unlike
    ]
    scores = [np.sqrt(learnt.held_out)[:, None]]
    limit = threshold(scores, rate.per_sample(dt))
    scale = max(limit.scale, 1.0)  # above the largest that blocks have shown which were not learnt
    alone = FrozenBank(plant, frozen=learnt.frozen, threshold_scale=scale, fitted_rate=rate.per_sample(dt))
    detector, share, isolated = with_bank(alone, log, each)
    faulty = _like_faults(plant, isolated, at) if detector is alone else []
    if strict and left_out + faulty:
        raise ValueError("the healthy log has readings that are not healthy: " + "; ".join(left_out + faulty))
    count = counted(scores, scale)
    remarks = [f"left out: {reason}" for reason in left_out]
    remarks += [
        f"from {at(a, b)} to {at(z, b)} readings are {np.sqrt(times):.2g} times as far off as elsewhere: an operation that the "
        "log has once, or a fault"
        for b, a, z, times in learnt.unlike
    ]
    remarks += faulty
    least = shortest(rate.per_sample(dt))
    if learnt.held_out.size < least:
        remarks.append(
            f"{learnt.held_out.size} healthy samples cannot show {rate}: thresholds are above all that this log has shown, and "
            f"above what normal errors exceed at that rate; {least} samples would show it"
        )
    if detector is alone:
        remarks.append(
            f"the adaptive bank isolates a sensor or names the process in {share:.2g} of these healthy rows: the frozen model "
            "judges alone, and where an abrupt fault has two explanations it names both"
        )
    commissioned = {
        h.name: {"value": float(v), "stated": float(h.nominal), "stated_sd": float(sd), "unit": h.unit}
        for h, v, sd in zip(unknowns(plant), learnt.frozen.values, declared(plant)[2], strict=True)
    }
    moved = np.abs(learnt.frozen.values - declared(plant)[1]) / declared(plant)[2]
    away = {name: a for name, a in zip(commissioned, moved.tolist(), strict=True) if a > FAR}
    remarks += [f"{name} is {a:.1f} of its stated deviations off: check its value, and the units" for name, a in away.items()]
    if short := [w for w, one in zip(WINDOWS, learnt.frozen.limit, strict=True) if np.isinf(one)]:
        remarks.append(f"the log is too short for windows of {short[0]} rows: drifts that are slower are not seen")
    corrected = bool((learnt.frozen.coef[:, 1:] != 0).any())
    quality = {
        "samples": int(learnt.held_out.size),
        "runs": int(log.y.shape[1]),
        "settle": learnt.frozen.settle,
        "learnt": ["unknowns"] * bool(commissioned) + ["errors of the equations by operation"] * corrected,
        **threshold_figures(limit, count, rate, dt),
        "remarks": remarks,
    }
    tables = {"sensors": _sensors(plant, learnt), "commissioned": commissioned}
    return FrozenTuning(detector, tables, quality)


def _like_faults(plant: Plant, isolated: Array, at: Callable[[int, int], str]) -> list[str]:
    """Where the healthy log looks like one with a fault: the longest time for which each sensor is isolated (K, B, N)."""
    found = []
    for i, sensor in enumerate(plant.sensors):
        times = [(z - a + 1, a, z, b) for b in range(isolated.shape[1]) for a, z in spans(isolated[:, b, i], TOGETHER)]
        rows, first, last, run = max(times, default=(0, 0, 0, 0))
        if rows >= LASTING_FAULT:
            found.append(
                (
                    rows,
                    f"from {at(first, run)} to {at(last, run)} this looks like a fault of {sensor.name} in the healthy log, or "
                    "an error of the model: look at it, and leave that time out or give another log if it is a fault",
                )
            )
    return [text for _, text in sorted(found, reverse=True)[:MOST_FAULTS]]


def _moving(plant: Plant, log: Log, at: Callable[[int, int], str]) -> tuple[Log, list[str]]:
    """The log without readings of sensors that stand still, and which these are."""
    left_out = []
    for _ in range(len(plant.sensors)):
        found = still(log)
        if not found:
            break
        y = log.y.copy()
        for i, run, first, last in found:
            y[first : last + 1, run, i] = np.nan
            left_out.append(
                f"{plant.sensors[i].name} from {at(first, run)} to {at(last, run)}: the same reading {last - first + 1} times"
            )
        log = log._replace(y=y)
    seen = np.any(np.isfinite(log.y), axis=(0, 1)).tolist()
    none = [s.name for s, known in zip(plant.sensors, seen, strict=True) if not known]
    return log, left_out + [f"{name}: it has no reading" for name in none]


def _sensors(plant: Plant, learnt: Learnt) -> dict[str, Any]:
    """Of each sensor the noise that is stated, and the standard deviation of its errors over each window that has a limit."""
    spread = np.sqrt(np.diagonal(learnt.frozen.cov, axis1=1, axis2=2))
    has_limit = np.isfinite(learnt.frozen.limit)
    return {
        s.name: {"sigma": s.noise_sigma, "stated": s.noise_sigma, "unit": s.unit}
        | {f"error_{w}": float(e[i]) for w, e, known in zip(WINDOWS, spread, has_limit, strict=True) if known}
        for i, s in enumerate(plant.sensors)
    }
