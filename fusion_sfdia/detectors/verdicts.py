"""What a diagnosis may conclude, in one word: the same words for a row, a log, a status line and what is written back."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.detector import Decision, ProcessHypothesis

Array = NDArray[Any]

FAR = 100.0  # thresholds; where every sensor is further off, the model describes none of them
ALL_FAR = "all readings are far from the model"
TOO_MANY = "more sensors disagree with the model than can be isolated"
NO_THRESHOLDS = "the thresholds allow no decision yet"


class Verdict(StrEnum):
    """A verdict on a row or on a log, a text for programs.

    Attributes
    ----------
    HEALTHY
        Judged, and nothing found.
    SENSOR
        A sensor is isolated.
    PROCESS
        The process differs from the model.
    OUTSIDE
        The data are outside what was learnt or declared.
    UNDECIDED
        "cannot tell": something is wrong and nothing is isolated, or the method cannot decide yet.
    BLIND
        Nothing was judged, for want of data or of a model that gives numbers.

    Examples
    --------
    >>> from fusion_sfdia.events import Verdict
    >>> Verdict.UNDECIDED == "cannot tell"
    True
    """

    HEALTHY = "healthy"
    SENSOR = "sensor"
    PROCESS = "process"
    OUTSIDE = "outside"
    UNDECIDED = "cannot tell"
    BLIND = "blind"


class Conclusion(NamedTuple):
    """A verdict, and the reason of one that isolates nothing; "" of the others."""

    verdict: Verdict
    reason: str = ""

    @property
    def text(self) -> str:
        """For people: "no verdict: no sensor has a reading"."""
        word = "no verdict" if self.verdict is Verdict.BLIND else str(self.verdict)
        return f"{word}: {self.reason}" if self.reason else word


def judged(decision: Decision) -> Array:
    """Whether any sensor was judged (...): it has a finite residual, and a threshold, which may still be infinite."""
    known = np.isfinite(decision.residual) & ~np.isnan(decision.threshold)
    return np.asarray(np.any(known, axis=-1) & ~decision.diverged)


def undecidable(decision: Decision) -> Array:
    """Whether sensors were judged against infinite thresholds alone (...), which allow no decision yet."""
    finite = np.isfinite(decision.residual) & np.isfinite(decision.threshold)
    return np.asarray(judged(decision) & ~np.any(finite, axis=-1))


def far_off(decision: Decision, threshold_scale: float = 1.0) -> Array:
    """Whether all sensors that were judged, and at least two, are more than `FAR` thresholds off (...), thresholds without
    the factor threshold_scale.
    """
    known = np.isfinite(decision.residual) & np.isfinite(decision.threshold)
    far = decision.scores * threshold_scale > FAR
    return np.asarray(np.all(far | ~known, axis=-1) & (np.sum(known, axis=-1) > 1) & ~decision.diverged)


def conclusion_of(decision: Decision, y: Array, tested: Sequence[ProcessHypothesis] = ()) -> Conclusion:
    """What the Decision of one sample of one run says; y (N,): its readings, NaN where missing. tested: what of the process."""
    known = np.isfinite(decision.residual) & ~np.isnan(decision.threshold)  # as in `judged`, here for many single samples
    if decision.diverged or not known.any():
        return Conclusion(Verdict.BLIND, _why_blind(decision, y))
    alarm = bool(decision.alarm)
    if alarm and far_off(decision):
        return Conclusion(Verdict.UNDECIDED, ALL_FAR)
    if np.any(decision.capped):
        return Conclusion(Verdict.UNDECIDED, TOO_MANY)
    if decision.isolated[: y.size].any():
        return Conclusion(Verdict.SENSOR)
    if decision.process is not None and decision.process.any():
        accepted = [h for h, holds in zip(tested, decision.process, strict=True) if holds] if tested else []
        if not accepted or not all(h.of_operation for h in accepted):
            return Conclusion(Verdict.PROCESS)
        if not decision.isolated[y.size :].any():
            return Conclusion(Verdict.OUTSIDE, ", ".join(h.name for h in accepted))
    if decision.isolated[y.size :].any():
        return Conclusion(Verdict.PROCESS)
    if decision.suspect is not None and decision.suspect.any():
        suspects = [h for h, held in zip(tested, decision.suspect[-len(tested) :], strict=True) if held] if tested else []
        if any(h.kind == "since start" for h in suspects):
            return Conclusion(Verdict.UNDECIDED, "a sensor or the model has been wrong since the start")
        return Conclusion(Verdict.UNDECIDED, "several hypotheses explain an alarm")
    if np.any(decision.absurd_input):
        return Conclusion(Verdict.OUTSIDE, "an input is beyond the limits of its signal")
    if np.isinf(decision.threshold[known]).all():
        return Conclusion(Verdict.UNDECIDED, NO_THRESHOLDS)
    if alarm:
        return Conclusion(Verdict.UNDECIDED, "an alarm, and nothing is isolated")
    return Conclusion(Verdict.HEALTHY)


def _why_blind(decision: Decision, y: Array) -> str:
    if decision.diverged:
        return "the estimate diverged, or the model gave no finite value"
    if np.all(np.isnan(y)):
        return "no sensor has a reading"
    if np.all(decision.absurd | np.isnan(y)):
        return "all readings are missing or impossible"
    return "no reading could be compared with the model"
