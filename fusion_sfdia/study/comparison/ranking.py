"""Which detectors differ: paired tests over clusters of runs, and ranks that are shared where nothing differs.

A cluster is a seed and a group of conditions: its runs share noise and sensor, so they count as one, by their mean. Detectors
are compared pairwise on the same clusters by the mean of their differences under random signs (Fisher 1935), all pairs of a
plant and criterion at a family-wise error of 5 % (Holm 1979). The rank of a detector is one more than the number of those that
are better beyond chance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.random_streams import stream
from fusion_sfdia.common.run_statistics import LEVEL, Estimate
from fusion_sfdia.study.comparison.cell import ComparisonCell, mean, within
from fusion_sfdia.study.comparison.loss import loss
from fusion_sfdia.study.comparison.protocol import HEALTHY, PROCESS
from fusion_sfdia.study.experiments.scenario import Settings

Array = NDArray[Any]

FLIPS = 20_000  # so that a hundred pairs can each differ at the family-wise error


class RankedDetector(NamedTuple):
    """A detector's mean over clusters, and its rank."""

    mean: Estimate
    rank: int


def detection(cell: ComparisonCell) -> dict[str, Array]:
    """Share of runs with an alarm (S,) by group of faulty sensors."""
    return _by_group(cell, np.isfinite(cell["first"]), faulty=True)


def isolation(cell: ComparisonCell) -> dict[str, Array]:
    """Share of samples at which exactly the faulty sensors are isolated."""
    return _by_group(cell, cell["exact"] / cell["samples"], faulty=True)


def accommodation(cell: ComparisonCell) -> dict[str, Array]:
    """Error of `measured` over that of the readings, of the faulty sensors: tenfold less is 1."""
    better = -cell.log_gain / np.log(10)
    return _by_group(cell, np.where(np.isfinite(better), better, 0.0), faulty=True)


def exoneration(cell: ComparisonCell) -> dict[str, Array]:
    """Share of samples without false isolation: under model mismatch, process faults and missing readings."""
    return _by_group(cell, 1 - cell["falsely_isolated"] / cell["samples"], faulty=False)


class Criterion(NamedTuple):
    """By what detectors are ranked: values (C,) by cluster, those of a group side by side; whether less is better, the bounds
    of their mean, and whether groups have weights, so that its interval is over seeds alone.
    """

    values: Callable[[ComparisonCell, Settings], Array]
    less: bool = False
    bounds: tuple[float, float] = (0.0, 1.0)
    weighted: bool = False


def _clusters(of: Callable[[ComparisonCell], dict[str, Array]]) -> Callable[[ComparisonCell, Settings], Array]:
    return lambda cell, _: np.concatenate([*of(cell).values(), np.empty(0)]).astype(float)


LOSS = "loss"
CRITERIA = {
    LOSS: Criterion(loss, less=True, bounds=(0.0, np.inf), weighted=True),
    "detection": Criterion(_clusters(detection)),
    "isolation": Criterion(_clusters(isolation)),
    "accommodation": Criterion(_clusters(accommodation), bounds=(-np.inf, np.inf)),
    "exoneration": Criterion(_clusters(exoneration)),
}


def _by_group(cell: ComparisonCell, values: Array, *, faulty: bool) -> dict[str, Array]:
    """Means (S,) over the conditions of a kind, or over all mismatch cases, which share noise and sensor."""
    found: dict[str, list[int]] = {}
    for j in np.flatnonzero(cell["threshold"] == 0).tolist():
        mismatch, kind = str(cell["mismatch"][j]), cell.kind(j)
        sensor_fault = not mismatch and kind not in (HEALTHY, PROCESS, "dropout")
        if sensor_fault and faulty:
            found.setdefault(kind, []).append(j)
        elif not faulty and (mismatch or kind in (PROCESS, "dropout")):
            found.setdefault("mismatch" if mismatch else kind, []).append(j)
    return {group: values[rows].mean(axis=0) for group, rows in found.items()}


def ranking(
    values: Mapping[str, Array],
    *,
    less: bool = False,
    bounds: tuple[float, float] = (-np.inf, np.inf),
    seeds: int | None = None,
) -> dict[str, RankedDetector]:
    """Standing of detectors by their values on the same clusters (C,). less: is better. bounds: of the mean. seeds: of each
    group of clusters, where the interval of the mean is over seeds.
    """
    names = list(values)
    pairs = list(combinations(names, 2))
    differences = np.array([values[a] - values[b] for a, b in pairs])
    p = holm(sign_flips(differences) if pairs else np.empty(0))
    better: dict[str, set[str]] = {name: set() for name in names}
    for (a, b), difference, probability in zip(pairs, differences, p, strict=True):
        if probability < 1 - LEVEL:
            first, second = (a, b) if (difference.mean() > 0) != less else (b, a)
            better[second].add(first)
    return {name: RankedDetector(within(mean(by_seed(values[name], seeds)), *bounds), 1 + len(better[name])) for name in names}


def by_seed(values: Array, seeds: int | None) -> Array:
    """The means (S,) over groups of values (G S,) in which the seeds of a group stand side by side; as they are for None."""
    return values if seeds is None else values.reshape(-1, seeds).mean(axis=0)


def sign_flips(differences: Array) -> Array:
    """Two-sided probabilities (P,) of means as large, if each of the differences (P, C) had either sign with equal chance.

    Of FLIPS draws, the same for all pairs and calls; 1 where nothing differs.
    """
    count = differences.shape[-1]
    signs = stream(0, "signs of differences").integers(0, 2, (FLIPS, count)) * 2.0 - 1.0
    seen = np.abs(differences.sum(axis=-1))
    drawn = np.abs(signs @ differences.T)
    return np.asarray((1 + np.sum(drawn >= seen * (1 - 1e-12), axis=0)) / (1 + FLIPS))


def holm(p: Array) -> Array:
    """Adjusted probabilities (Holm 1979), in the order given."""
    given = np.asarray(p, dtype=float)
    order = np.argsort(given)
    adjusted = np.maximum.accumulate(given[order] * np.arange(given.size, 0, -1)).clip(max=1.0)
    found = np.empty_like(given)
    found[order] = adjusted
    return found
