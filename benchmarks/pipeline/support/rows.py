"""The runs of a case without the diverged ones, and the rows and bars of the pipeline scenarios."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.benchmarks.pipeline.support.trials import AFTERMATH, SENSORS, SETTLE, cases
from fusion_sfdia.common.run_statistics import NOTHING, Estimate, proportion
from fusion_sfdia.models.gas_pipeline.published import QUANTITIES
from fusion_sfdia.report.plots import Bars
from fusion_sfdia.report.results import Published, Row, row_of
from fusion_sfdia.study import detection_metrics as metrics
from fusion_sfdia.study.experiments.scenario import Arrays, Task
from fusion_sfdia.study.trials import join, unpack

Array = NDArray[Any]
Shown = Mapping[tuple[str, str], Estimate | None]

row = partial(row_of, "gas-pipeline")  # of scenario, detector, fault, quantity, metric, estimate, published; condition


class JudgedRuns:
    """The joined arrays of the runs of one case without the diverged ones, after the settling time, unpacked where needed."""

    def __init__(self, arrays: Arrays) -> None:
        sound = ~arrays["diverged"]
        self.runs, self.diverged = arrays["diverged"].size, int(arrays["diverged"].sum())
        self._every = {k: v[:, sound] if v.ndim > 1 else v[sound] for k, v in arrays.items()}
        self._arrays = {k: v[SETTLE:] if v.ndim > 1 else v for k, v in self._every.items()}
        self.active = unpack(self._arrays, "active", SENSORS)
        self.isolated = unpack(self._arrays, "isolated", SENSORS)
        self.judged = ~aftermath(np.asarray(self.active.any(axis=-1)))

    @property
    def divergence(self) -> Estimate:
        """Share of runs that diverged; all other numbers are of the runs that did not."""
        return proportion(self.diverged, self.runs)

    def whole(self, name: str) -> Array:
        """An array of the runs from the first sample on."""
        return self._every[name]

    def __getitem__(self, name: str) -> Array:
        return self._arrays[name]


def aftermath(faulty: Array, samples: int = AFTERMATH) -> Array:
    """Whether a fault has ended within the last `samples` samples and none is active; faulty and result (K, B)."""
    recent = np.zeros_like(faulty)
    for k in range(1, samples + 1):
        recent[k:] |= faulty[:-k]
    return recent & ~faulty


def judged_runs(results: Sequence[tuple[Task, Arrays]], *keys: str) -> dict[tuple[Any, ...], JudgedRuns]:
    """Join the results of the cases that are equal in `keys`, in which fault and quantity are those of the case."""
    parts: dict[tuple[Any, ...], list[Arrays]] = {}
    for task, arrays in results:
        for i, (fault, quantity) in enumerate(cases(task)):
            case = {**task, "fault": fault, "quantity": quantity}
            parts.setdefault(tuple(case[k] for k in keys), []).append({name: a[i] for name, a in arrays.items()})
    return {key: JudgedRuns(join(found)) for key, found in parts.items()}


def detection_rows(scenario: str, cells: Mapping[tuple[Any, ...], JudgedRuns]) -> list[Row]:
    """Area under the ROC of the faulty quantity's score, and both probabilities at the detector's own threshold.

    Of the samples that are judged; auc_all_samples: of those in the aftermath of a fault too.
    """
    rows = []
    for (detector, fault, quantity), cell in cells.items():
        score = cell["score"][..., QUANTITIES.index(quantity)]
        at = partial(row, scenario, detector, fault, quantity)
        rows += [
            at("diverged", cell.divergence),
            at("auc", metrics.auc(score, cell.active, cell.judged)),
            at("auc_all_samples", metrics.auc(score, cell.active)),
            at("detection_probability", metrics.detection_probability(score > 1, cell.active, cell.judged)),
            at("false_alarm_probability", metrics.false_alarm_probability(score > 1, cell.active, cell.judged)),
        ]
    return rows


def bar_series(
    shown: Shown,
    labels: Sequence[str],
    groups: Sequence[str],
    published: Mapping[tuple[str, str], Published | None] | None = None,
) -> list[Bars]:
    """Return the bars of plots.bars from estimates by (label, group); labels without any are left out."""
    series = []
    for label in labels:
        found = [shown.get((label, g)) or NOTHING for g in groups]
        theirs = [(published or {}).get((label, g)) for g in groups]
        if any(e.n for e in found) or any(np.isfinite(e.value) for e in found):
            stated = [np.nan if p is None else p.value for p in theirs]
            series.append(Bars(label, [e.value for e in found], [e.low for e in found], [e.high for e in found], stated))
    return series
