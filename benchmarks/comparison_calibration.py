"""One rate of false alarms for all detectors: each is calibrated on healthy readings, once a process.

Two forms of a detector are run. The silent one has thresholds so high that nothing is ever accused, replaced or latched: its
scores, times that scale, are those over which a threshold can be swept. The deployed one has its thresholds scaled to the
common rate and does all that it does.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.benchmarks import registry
from fusion_sfdia.benchmarks.comparison_recordings import healthy, plant_of
from fusion_sfdia.core.detector import Decision, Detector, run
from fusion_sfdia.core.order_statistics import order_statistic

Array = NDArray[Any]

SILENT = 1e6  # thresholds are so many times as high
CALIBRATION_SEEDS = 910_000  # the first: apart from those of any run and from those that detectors are fitted on
CLAIMS = {  # alarms a step over all sensors, of those that have no setting false_alarm
    # what they are fitted to
    **dict.fromkeys(("fusing-ekf", "fusing-ukf", "fusing-enkf", "structural-residuals"), 1e-3),
    **dict.fromkeys(("limits", "limits-ewma", "pca", "dynamic-pca", "one-class"), 1e-3),
    **dict.fromkeys(("adaptive-threshold", "virtual-sensors"), 0.0),  # guaranteed for bounded noise
}


class Calibrated(NamedTuple):
    """A detector, the scale of its thresholds for the common rate, its healthy scores (K, R) at its own, and its claim."""

    detector: Any  # a Detector that is a dataclass with threshold_scale
    scale: float
    scores: Array
    claim: float  # NaN for none


class CannotRunError(ValueError):
    """A detector that a plant cannot have, and why."""


@lru_cache(maxsize=2)
def calibrated(plant: str, name: str, settle: int, steps: int, seeds: int, false_alarm: float) -> Calibrated:
    """A registered detector and the scale at which it alarms at that rate, on healthy runs of `steps` samples after settling.

    The order statistic whose expected exceedance by a fresh sample is at most `false_alarm`. CannotRunError for a detector
    that the plant cannot have, that needs a package which is not installed, or whose scores cannot set a threshold.
    """
    try:
        detector: Any = registry.detector(name, plant_of(plant))
    except (ValueError, ModuleNotFoundError) as problem:
        raise CannotRunError(str(problem)) from problem
    recording = healthy(plant, settle + steps, tuple(range(CALIBRATION_SEEDS, CALIBRATION_SEEDS + seeds)))
    scores = silent_scores(watch(silent(detector), recording.t, recording.y, recording.u_of_runs))[settle:]
    scale = float(order_statistic(scores.ravel(), false_alarm))
    if not 0 < scale < np.inf:
        raise CannotRunError(
            f"its score on healthy readings is {scale:g} at most: no threshold brings it to a rate of false alarms"
        )
    return Calibrated(detector, scale, scores, claim(name, detector))


def claim(name: str, detector: Any) -> float:
    """Alarms a step over all sensors that a detector claims at most, NaN where it claims nothing below 1."""
    if (rate := getattr(detector, "false_alarm", None)) is not None:
        return float(rate)
    if (alpha := getattr(detector, "alpha", None)) is not None:  # Chebyshev's inequality for each sensor
        bound = float(np.sum(np.broadcast_to(np.asarray(alpha, float), len(detector.plant.sensors)) ** -2.0))
        return bound if bound < 1 else np.nan
    found = CLAIMS.get(name, np.nan)
    stated = all(np.isfinite(s.noise_bound) for s in detector.plant.sensors)
    return found if found > 0 or stated else np.nan  # from bounds that are taken from standard deviations nothing follows


def silent(detector: Any) -> Any:
    """The detector with thresholds beyond reach."""
    return replace(detector, threshold_scale=SILENT * detector.threshold_scale)


def deployed(calibration: Calibrated) -> Any:
    """The detector with thresholds at the common rate of false alarms."""
    return replace(calibration.detector, threshold_scale=calibration.scale * calibration.detector.threshold_scale)


def silent_scores(decision: Decision) -> Array:
    """Scores (K, B) of a silent detector over its own thresholds; what diverged scores nothing."""
    return np.nan_to_num(decision.score * SILENT, nan=0.0)


def watch(detector: Detector, t: Array, y: Array, u: Array) -> Decision:
    """The decisions on readings y (K, B, N) at t (K,), from the start; u (K, B, m)."""
    start = detector.init((y.shape[1],), float(t[0]) - detector.plant.dt)
    return run(detector, start, t, y, u)[1]
