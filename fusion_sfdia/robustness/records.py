"""What is kept of a condition: decisions while it lasts, and of those a few numbers a run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.comparison.records import until
from fusion_sfdia.core.detector import Decision, Detector
from fusion_sfdia.experiments.scenario import Arrays
from fusion_sfdia.robustness.material import Branched
from fusion_sfdia.robustness.protocol import LATER

Array = NDArray[Any]

NO_NAME = ""
FIELDS = (
    *("samples", "exact", "falsely_isolated", "first", "first_process"),
    *("process", "process_name", "at_end", "diverged"),
)  # of record


class Kept(NamedTuple):
    """Decisions under a condition: alarm, diverged (L, S), isolated (L, S, N), process (L, S, P), its P hypotheses' names."""

    branched: Branched
    alarm: Array
    diverged: Array
    isolated: Array
    process: Array
    hypotheses: tuple[str, ...]

    @classmethod
    def empty(cls, detector: Detector, branched: Branched) -> Kept:
        """Room for the decisions of a detector."""
        runs, readings = branched.readings.y.shape[:2], branched.readings.y.shape
        names = tuple(h.name for h in getattr(detector, "process_hypotheses", ()))
        alarm, diverged = np.zeros((2, *runs), bool)
        return cls(branched, alarm, diverged, np.zeros(readings, bool), np.zeros((*runs, len(names)), bool), names)

    def take(self, k: int, decision: Decision) -> None:
        """Keep the decision of a sample; an accepted or suspected hypothesis about the process is an alarm, too."""
        self.alarm[k], self.diverged[k] = decision.alarm, decision.diverged
        self.isolated[k] = decision.isolated[:, : self.isolated.shape[-1]]
        for accepted in (decision.process, decision.suspect):
            if accepted is not None:
                self.alarm[k] |= accepted.any(axis=-1)
        if decision.process is not None:
            self.process[k] = decision.process


def record(kept: Kept) -> Arrays:
    """Arrays (S,) of the runs of a condition of L samples.

    samples: L. exact: samples at which exactly the faulty sensors are isolated. falsely_isolated: samples at which a healthy
    sensor is. first, first_process: samples until the first alarm and until the first process verdict, inf for none. process:
    samples with a process verdict. process_name: the hypothesis accepted most often, "" for none. at_end: whether exactly the
    faulty sensors are isolated at the last sample of the rise of a slow drift, or at one of those after it. diverged.
    """
    isolated, active = kept.isolated, kept.branched.readings.active
    exact = (isolated == active).all(axis=-1) & active.any(axis=-1)
    verdict = np.asarray(kept.process.any(axis=-1))
    counts = kept.process.sum(axis=0)
    names = [kept.hypotheses[int(np.argmax(c))] if c.any() else NO_NAME for c in counts]
    return {
        "samples": np.full(exact.shape[1], exact.shape[0]),
        "exact": exact.sum(axis=0),
        "falsely_isolated": (isolated & ~active).any(axis=-1).sum(axis=0),
        "first": until(kept.alarm),
        "first_process": until(verdict),
        "process": verdict.sum(axis=0),
        "process_name": np.array(names, dtype=str),
        "at_end": exact[round(exact.shape[0] / (1.0 + LATER)) - 1 :].any(axis=0),
        "diverged": np.asarray(kept.diverged.any(axis=0)),
    }


def join(parts: Sequence[Arrays]) -> Arrays:
    """The runs of all conditions one after the other (R,), and `row`, the condition of each."""
    row = np.concatenate([np.full(p["samples"].size, j) for j, p in enumerate(parts)])
    return {"row": row} | {name: np.concatenate([p[name] for p in parts]) for name in parts[0]}
