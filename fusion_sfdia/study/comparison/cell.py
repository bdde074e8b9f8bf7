"""Cells of a comparison: what one detector did on one plant, and its numbers with intervals.

Intervals are those of `common.run_statistics`, one rule for each kind of number: shares of runs Wilson's, shares of samples the
same for the variance between runs, means over runs Student's, areas under a ROC the jackknife over seeds. Where a number
depends on the threshold, its interval contains how uncertain the threshold is: half the difference of the numbers with
thresholds a standard error lower and higher, added in quadrature; for bias, drift, noise and scale of the small and the large
size and for healthy samples. From the sample on at which an estimator diverges it neither alarms nor isolates; its errors are
left out from there, see `diverged`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.run_statistics import Estimate, mean_over_runs, normal_quantile, proportion, rate_over_runs
from fusion_sfdia.study import detection_metrics as metrics
from fusion_sfdia.study.comparison.protocol import GRADED, PROCESS, conditions
from fusion_sfdia.study.comparison.subjects import ComparedPlant, cases_of, plant_of
from fusion_sfdia.study.experiments.scenario import Arrays, Settings

Array = NDArray[Any]
T = TypeVar("T")

LEAST_ERROR = 1e-3  # sigma of the noise: less is as good as none
PER_SEED = {"trunk": 1, "swept": 2, "deployed_alarms": 0}  # the axis of seeds; of the rest it is 1 where there are two axes
CellNumber = Callable[["ComparisonCell", Array], Estimate]


class ComparisonCell:
    """What one detector did on one plant: the arrays of `run.work`, the seeds of all tasks side by side."""

    def __init__(
        self, plant: ComparedPlant, detector: str, settings: Settings, parts: Sequence[Arrays], seeds: Sequence[int]
    ) -> None:
        self.subject, self.detector, self.settings, self.seeds = plant, detector, settings, tuple(seeds)
        self.plant, self.model, self.cases = plant.name, plant_of(plant), cases_of(plant)
        self.window = int(settings["window"])
        self.arrays = {
            name: np.concatenate([p[name] for p in parts], axis=PER_SEED.get(name, 1))
            if name in PER_SEED or parts[0][name].ndim >= 2
            else parts[0][name]
            for name in parts[0]
        }
        self.step_seconds = float(min(p["step_seconds"] for p in parts))
        self.scale = float(parts[0]["scale"])
        self.ends = tuple(parts[0]["ends"].tolist())
        self.conditions = {c.name: c for c in conditions(settings, self.cases)}

    def __getitem__(self, name: str) -> Array:
        return self.arrays[name]

    def rows_of(self, *names: str, mismatch: str = "", threshold: int = 0) -> Array:
        """Indices of conditions by name under a mismatch case; threshold: -1 or 1 for one a standard error lower or higher."""
        chosen = np.isin(self["condition"], names) & (self["mismatch"] == mismatch)
        return np.flatnonzero(chosen & (self["threshold"] == threshold))

    def of(self, measure: CellNumber, *names: str, mismatch: str = "") -> Estimate:
        """A number of some conditions, with how uncertain the threshold makes it where that was tried for all of them."""
        low, high = (self.rows_of(*names, mismatch=mismatch, threshold=sign) for sign in (-1, 1))
        found = measure(self, self.rows_of(*names, mismatch=mismatch))
        if not len(names) == low.size == high.size:
            return found
        wider = widened(found, abs(measure(self, high).value - measure(self, low).value) / 2)
        return within(wider, 0.0, np.inf)  # all numbers are shares, times, errors or ratios

    def names_of(self, *kinds: str) -> list[str]:
        """The conditions of some kinds."""
        return [c.name for c in self.conditions.values() if c.kind in kinds]

    def kind(self, j: int) -> str:
        """The kind of the condition of a row; a bias under model mismatch need not be among those tried without."""
        name = str(self["condition"][j])
        return self.conditions[name].kind if name in self.conditions else "bias"

    def graded(self, sigmas: float) -> list[str]:
        """The conditions of that size."""
        return [c.name for c in self.conditions.values() if c.kind in GRADED and c.sigmas == sigmas]

    @cached_property
    def mismatches(self) -> list[str]:
        """The mismatch cases that were tried."""
        return [t for t in dict.fromkeys(self["mismatch"].tolist()) if t]

    # each takes rows of conditions; runs of all of them count alike

    def detected(self, rows: Array) -> Estimate:
        """Share of runs with an alarm."""
        seen = np.isfinite(self["first"][rows])
        return proportion(int(seen.sum()), seen.size)

    def rate(self, what: str, rows: Array, of: Array | float) -> Estimate:
        """A share of samples, or of sensor-samples, with an interval over runs."""
        hits = self[what][rows].ravel()
        return rate_over_runs(hits, np.broadcast_to(of, self[what][rows].shape).ravel())

    def alarms(self, rows: Array) -> Estimate:
        """Share of samples with an alarm."""
        return self.rate("alarms", rows, self["samples"][rows])

    def exact(self, rows: Array) -> Estimate:
        """Share of samples at which exactly the faulty sensors are isolated."""
        return self.rate("exact", rows, self["samples"][rows])

    def recall(self, rows: Array) -> Estimate:
        """Share of faulty sensor-samples that are isolated, alone or among others."""
        return self.rate("right", rows, self["faulty"][rows])

    def false_isolation(self, rows: Array) -> Estimate:
        """Share of samples at which a healthy sensor is isolated."""
        return self.rate("falsely_isolated", rows, self["samples"][rows])

    def delay(self, rows: Array, until: str = "first") -> Estimate:
        """Mean seconds from the onset to the first alarm, of the runs that have one; until: as in `records.record`.

        A faulty sensor is read at the onset, a process fault shows a sample later.
        """
        later = [self.kind(j) == PROCESS for j in rows]
        samples = (self[until][rows] + np.array(later, float).reshape(-1, 1)).ravel()
        return within(mean(samples[np.isfinite(samples)] * self.model.dt), 0.0, np.inf)

    def false_flags(self, rows: Array) -> Estimate:
        """Share of healthy sensor-samples that are isolated."""
        wrong, sensors = (self["isolated"] - self["right"])[rows], self["samples"][rows] * len(self.model.sensors)
        return rate_over_runs(wrong.ravel(), (sensors - self["faulty"][rows]).ravel())

    def size_error(self, rows: Array) -> Estimate:
        """Mean error of the sizes of faults in percent, where isolated; not of noise, whose size goes through 0."""
        steady = [j for j in rows if self.kind(j) != "noise"]
        e = within(mean(self["size_error"][steady].ravel()), 0.0, np.inf)
        return Estimate(100 * e.value, 100 * e.low, 100 * e.high, e.n)

    def rms(self, what: str, rows: Array) -> Estimate:
        """Root mean square over runs, in standard deviations of the noise."""
        return root(mean(self[what][rows].ravel()))

    @cached_property
    def log_gain(self) -> Array:
        """Logarithm of the error of `measured` over that of the readings as they came, of the faulty sensors; NaN for none.

        An error of less than LEAST_ERROR counts as that: where the truth is the model, one may be right to rounding.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.log(np.maximum(self["measured"], LEAST_ERROR**2) / self["raw"]) / 2)

    def gain(self, rows: Array) -> Estimate:
        """Error of `measured` over that of the readings as they came, of the faulty sensors: geometric mean over runs."""
        ratio = self.log_gain[rows].ravel()
        e = mean(ratio[np.isfinite(ratio)])
        return Estimate(float(np.exp(e.value)), float(np.exp(e.low)), float(np.exp(e.high)), e.n)

    @cached_property
    def areas(self) -> dict[str, Estimate]:
        """Areas under the curves of the silent detector: samples under a fault against those of the healthy trunk."""
        return {name: metrics.auc(*self.swept(name)) for name in self["swept_condition"].tolist()}

    def mean_area(self, sigmas: float) -> Estimate:
        """The mean of the areas of all kinds of single faults: of those of a size, and of freezes."""
        kinds = [n for n in self["swept_condition"].tolist() if n == "freeze" or n in self.graded(sigmas)]
        return metrics.mean_auc([self.swept(name) for name in kinds])

    def swept(self, name: str) -> tuple[Array, Array]:
        """Scores (K, S) of trunk and fault one after the other, and where the fault is (K, S, 1)."""
        (j,) = np.flatnonzero(self["swept_condition"] == name)
        trunk, faulty = self["trunk"], self["swept"][j][: self.conditions[name].length]
        scores = np.concatenate([trunk, faulty]).astype(float)
        return scores, np.broadcast_to((np.arange(len(scores)) >= len(trunk))[:, None, None], (*scores.shape, 1))

    @property
    def nominal(self) -> Estimate:
        """Healthy samples above the detector's own threshold."""
        alarms = self["nominal_alarms"]
        return rate_over_runs(alarms, np.full(alarms.size, float(self["calibration_samples"])))

    @property
    def calibration_error(self) -> float:
        """Standard error of the common rate as it is set, as a share of it: from the differences between calibration runs."""
        alarms = self["calibration_alarms"].astype(float)
        return float(alarms.std(ddof=1) / np.sqrt(alarms.size) / alarms.mean()) if alarms.any() else np.nan

    @property
    def deployed(self) -> Estimate:
        """Healthy samples at which the deployed detector alarms; the threshold counts in proportion to `matched`."""
        found = rate_over_runs(self["deployed_alarms"], np.full(len(self.seeds), self["trunk"].shape[0]))
        share = self.matched.value
        return within(widened(found, self.rate_error * found.value / share if share > 0 else 0.0), 0.0, 1.0)

    @property
    def scale_error(self) -> float:
        """Standard error of the scale of thresholds."""
        return float(self.ends[1] - self.ends[0]) / 2

    @property
    def rate_error(self) -> float:
        """Standard error of `matched` that comes from the threshold."""
        low, high = (float((self["trunk"] > end).mean()) for end in self.ends)
        return (low - high) / 2

    @property
    def chance(self) -> float:
        """Share of healthy windows, each as long as a fault, in which a sample is above the common threshold."""
        trunk = self["trunk"]
        windows = trunk[: trunk.shape[0] // self.window * self.window].reshape(-1, self.window, trunk.shape[1])
        return float(np.mean(np.any(windows > self.scale, axis=1)))

    @property
    def matched(self) -> Estimate:
        """Healthy samples above the common threshold, of other seeds than set it."""
        alarms = (self["trunk"] > self.scale).sum(axis=0)
        found = rate_over_runs(alarms, np.full(alarms.size, self["trunk"].shape[0]))
        return within(widened(found, self.rate_error), 0.0, 1.0)


def mean(values: Array) -> Estimate:
    """The mean over runs; NaN values are left out."""
    known = np.isfinite(values)
    return mean_over_runs(np.where(known, values, 0.0), known)


def widened(e: Estimate, deviation: float) -> Estimate:
    """The interval with another, independent source of error of that standard deviation."""
    more = (normal_quantile() * deviation) ** 2 if np.isfinite(deviation) else 0.0
    low, high = e.value - np.sqrt((e.value - e.low) ** 2 + more), e.value + np.sqrt((e.high - e.value) ** 2 + more)
    return Estimate(e.value, float(low), float(high), e.n)


def within(e: Estimate, least: float, most: float) -> Estimate:
    """The interval as far as a quantity can be; it covers as often."""
    low, high = np.clip([e.low, e.high], least, most)
    return Estimate(e.value, float(low), float(high), e.n)


def root(e: Estimate) -> Estimate:
    """The square root of a mean square."""
    return Estimate(float(np.sqrt(e.value)), float(np.sqrt(max(e.low, 0.0))), float(np.sqrt(e.high)), e.n)


Cells = Mapping[tuple[str, str], ComparisonCell]  # by plant and detector


def of_plant(found: Mapping[tuple[str, str], T], plant: str) -> dict[str, T]:
    """The part of one plant of what is known by plant and detector, by detector."""
    return {detector: one for (where, detector), one in found.items() if where == plant}
