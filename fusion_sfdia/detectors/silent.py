"""A detector with thresholds that no residual reaches: nothing is isolated, and its scores set or sweep the thresholds."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.detector import Decision

Array = NDArray[Any]

SILENT = 1e6  # factor on the thresholds


def require_scale(name: str, detector: Any) -> None:
    """Raise ValueError unless the detector's thresholds can be scaled."""
    if not is_dataclass(detector) or "threshold_scale" not in (f.name for f in fields(detector)):
        raise ValueError(
            f"detector {name} has no field threshold_scale, by which its thresholds are brought to the common rate; "
            "derive it from BatchDetector, or make it a frozen dataclass with that factor of all its thresholds"
        )


def silent(detector: Any) -> Any:
    """The detector, a dataclass with threshold_scale, with thresholds that nothing reaches."""
    return replace(detector, threshold_scale=SILENT * detector.threshold_scale)


def silent_score(decision: Decision) -> Array:
    """The score (...) of a silent detector's decision over the thresholds that it has when it is not silent."""
    return np.asarray(decision.score * SILENT)


def silent_scores(detector: Any, t: Array, y: Array, u: Array) -> tuple[Any, Array]:
    """The last state and the scores (K, ...) of a silent detector from its start: t (K,), y (K, ..., N), u (K, ..., m).

    Only the scores are kept of each decision.
    """
    state, scores = detector.init(y.shape[1:-1], float(t[0]) - detector.plant.dt), []
    for time, reading, applied in zip(t, y, u, strict=True):
        state, decision = detector.step(state, float(time), reading, applied)
        scores.append(silent_score(decision))
    return state, np.stack(scores)
