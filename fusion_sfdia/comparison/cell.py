"""Numbers of a comparison: cells of one detector on one plant.

Intervals are those of `evaluation.metrics`, one rule for each kind of number: shares of runs Wilson's, shares of samples the
same for the variance seen between runs, means over runs Student's, areas under a ROC the jackknife over seeds. To what
depends on the threshold comes how uncertain the threshold is: half the difference of what is seen with thresholds a standard
error lower and higher, added in quadrature; for biases, drifts, noise and scales of the small and the large size and for
healthy samples. From the sample on at which an estimator breaks down it neither alarms nor names; its errors are left out
from there, see `diverged`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from fusion_sfdia.comparison.protocol import GRADED, conditions
from fusion_sfdia.comparison.recordings import plant_of
from fusion_sfdia.evaluation import detection_metrics as metrics
from fusion_sfdia.evaluation.metrics import LEVEL, Estimate, mean_over_runs, proportion, rate_over_runs
from fusion_sfdia.experiments.scenario import Arrays, Settings, Task

Array = NDArray[Any]

LEAST_ERROR = 1e-3  # sigma of the noise: less is as good as none
PER_SEED = {"trunk": 1, "swept": 2, "deployed_alarms": 0}  # the axis of seeds; of the rest it is 1 where there are two axes
Measure = Callable[["Cell", Array], Estimate]


class Cell:
    """What one detector did on one plant: the arrays of `comparison_work`, the seeds of all tasks side by side."""

    def __init__(self, plant: str, detector: str, settings: Settings, parts: Sequence[Arrays], seeds: Sequence[int]) -> None:
        self.plant, self.detector, self.settings, self.seeds = plant, detector, settings, tuple(seeds)
        self.window = int(settings["window"])
        self.model = plant_of(plant)
        self.arrays = {
            name: np.concatenate([p[name] for p in parts], axis=PER_SEED.get(name, 1))
            if name in PER_SEED or parts[0][name].ndim >= 2
            else parts[0][name]
            for name in parts[0]
        }
        self.step_seconds = float(min(p["step_seconds"] for p in parts))
        self.scale = float(parts[0]["scale"])
        self.ends = tuple(parts[0]["ends"].tolist())
        self.sigmas = {c.name: c.sigmas for c in conditions(settings, plant)}
        self.kinds = {c.name: c.kind for c in conditions(settings, plant)}
        self.lengths = {c.name: c.length for c in conditions(settings, plant)}

    def __getitem__(self, name: str) -> Array:
        return self.arrays[name]

    def rows_of(self, *names: str, truth: str = "", threshold: int = 0) -> Array:
        """Indices of conditions by name; threshold: -1 or 1 for one a standard error lower or higher."""
        named = np.isin(self["condition"], names) & (self["truth"] == truth)
        return np.flatnonzero(named & (self["threshold"] == threshold))

    def of(self, measure: Measure, *names: str, truth: str = "") -> Estimate:
        """A measure of some conditions, with how uncertain the threshold makes it where that was tried for all of them."""
        low, high = (self.rows_of(*names, truth=truth, threshold=sign) for sign in (-1, 1))
        found = measure(self, self.rows_of(*names, truth=truth))
        if not len(names) == low.size == high.size:
            return found
        wider = widened(found, abs(measure(self, high).value - measure(self, low).value) / 2)
        return within(wider, 0.0, np.inf)  # all measures are shares, times, errors or ratios

    def graded(self, sigmas: float) -> list[str]:
        """The conditions of that size."""
        return [name for name, kind in self.kinds.items() if kind in GRADED and self.sigmas[name] == sigmas]

    @cached_property
    def truths(self) -> list[str]:
        """The departures that were tried."""
        return [t for t in dict.fromkeys(self["truth"].tolist()) if t]

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
        """Share of samples at which exactly the faulty sensors are named."""
        return self.rate("exact", rows, self["samples"][rows])

    def recall(self, rows: Array) -> Estimate:
        """Share of faulty sensor-samples that are named, alone or among others."""
        return self.rate("right", rows, self["faulty"][rows])

    def blame(self, rows: Array) -> Estimate:
        """Share of samples at which a healthy sensor is named."""
        return self.rate("blamed", rows, self["samples"][rows])

    def delay(self, rows: Array, until: str = "first") -> Estimate:
        """Mean seconds from the onset to the first alarm, of the runs that have one; until: as in `comparison_records`.

        A faulty sensor is read at the onset, a plant that fails shows it a sample later.
        """
        plant = [self.kinds.get(str(self["condition"][j])) == "plant" for j in rows]
        samples = (self[until][rows] + np.array(plant, float).reshape(-1, 1)).ravel()
        return within(mean(samples[np.isfinite(samples)] * self.model.dt), 0.0, np.inf)

    def false_flags(self, rows: Array) -> Estimate:
        """Share of healthy sensor-samples that are named."""
        wrong, sensors = (self["named"] - self["right"])[rows], self["samples"][rows] * len(self.model.sensors)
        return rate_over_runs(wrong.ravel(), (sensors - self["faulty"][rows]).ravel())

    def size_error(self, rows: Array) -> Estimate:
        """Mean error of the sizes of faults in percent, where named; not of noise, whose size goes through 0."""
        steady = [j for j in rows if self.kinds.get(str(self["condition"][j])) != "noise"]
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
        trunk, faulty = self["trunk"], self["swept"][j][: self.lengths[name]]
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
    more = (stats.norm.ppf((1 + LEVEL) / 2) * deviation) ** 2 if np.isfinite(deviation) else 0.0
    low, high = e.value - np.sqrt((e.value - e.low) ** 2 + more), e.value + np.sqrt((e.high - e.value) ** 2 + more)
    return Estimate(e.value, float(low), float(high), e.n)


def within(e: Estimate, least: float, most: float) -> Estimate:
    """The interval as far as a quantity can be; it covers as often."""
    low, high = np.clip([e.low, e.high], least, most)
    return Estimate(e.value, float(low), float(high), e.n)


def root(e: Estimate) -> Estimate:
    """The square root of a mean square."""
    return Estimate(float(np.sqrt(e.value)), float(np.sqrt(max(e.low, 0.0))), float(np.sqrt(e.high)), e.n)


def gather(settings: Settings, results: Iterable[tuple[Task, Arrays]]) -> tuple[dict[tuple[str, str], Cell], dict[Any, str]]:
    """The cells by plant and detector, and the reasons of those that cannot run."""
    parts: dict[tuple[str, str], list[Arrays]] = {}
    seeds: dict[tuple[str, str], list[int]] = {}
    reasons: dict[tuple[str, str], str] = {}
    for task, arrays in results:
        key = task["plant"], task["detector"]
        if "reason" in arrays:
            reasons[key] = str(arrays["reason"])
        else:
            parts.setdefault(key, []).append(arrays)
            seeds.setdefault(key, []).extend(task["seeds"])
    return {key: Cell(*key, settings, found, seeds[key]) for key, found in parts.items()}, reasons


def complete(cells: Mapping[tuple[str, str], Cell]) -> dict[tuple[str, str], Cell]:
    """The cells that have all seeds, which alone can be paired: a piece of work of the others has failed."""
    everyone = {seed for cell in cells.values() for seed in cell.seeds}
    return {key: cell for key, cell in cells.items() if len(cell.seeds) == len(everyone)}


def confusion(cell: Cell) -> Array:
    """What is named where a sensor of each quantity is faulty (Q, runs, Q + 2): none, another of each quantity, the right one.

    Samples of bias, drift, noise and scale at their two largest sizes, of replays and negated readings; sizes share noise and
    sensor and count as one run; where several are named, each has its share of the sample. Runs in which a sensor of another
    quantity is faulty have none.
    """
    large = sorted(cell.settings["magnitudes"])[-2:]
    single = [n for n, kind in cell.kinds.items() if (kind in GRADED and cell.sigmas[n] in large) or kind in ("sign", "replay")]
    kinds = [
        cell.rows_of(*(n for n in single if cell.kinds[n] == kind)) for kind in dict.fromkeys(cell.kinds[n] for n in single)
    ]
    width, count = cell["told"].shape[-1], len(cell.seeds)
    sensor = np.array([cell["sensor"][rows[0]] for rows in kinds]).reshape(len(kinds) * count)
    told = np.array([cell["told"][rows].sum(axis=0) for rows in kinds]).reshape(len(kinds) * count, width)
    return np.stack([np.where(np.isin(sensor, q)[:, None], told, 0.0) for q in cell.model.quantities.values()])


def share_right(cell: Cell) -> float:
    """Share of the samples of `confusion` in which the faulty sensor is named."""
    samples = confusion(cell)
    return float(samples[..., -1].sum() / samples.sum()) if samples.any() else np.nan
