"""A made-up cell of a comparison on the two tanks, small enough to count its numbers by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.study.comparison.cell import ComparisonCell
from fusion_sfdia.study.comparison.protocol import SETTINGS
from fusion_sfdia.study.comparison.subjects import compared_plant

Arrays = dict[str, NDArray[Any]]

TANKS = compared_plant("two-tanks")
SETTINGS_HERE = SETTINGS | {
    "faults": ("bias", "noise", "dropout"), "magnitudes": (3.0, 10.0), "lengths": (), "window": 4, "false_alarm": 0.1,
}  # fmt: skip
CONDITIONS = (  # of two-tanks, window 4 samples, two seeds: name, mismatch case, threshold, and by seed first alarm
    ("none", "", 0, (np.inf, 3)),
    ("bias-3-sigma", "", 0, (2, np.inf)),
    ("bias-10-sigma", "", 0, (0, 1)),
    ("noise-3-sigma", "", 0, (np.inf, np.inf)),
    ("noise-10-sigma", "", 0, (1, 3)),
    ("dropout", "", 0, (np.inf, np.inf)),
    ("leak", "", 0, (2, 3)),
    ("none", "outlets", 0, (0, np.inf)),
    ("bias-10-sigma", "outlets", 0, (1, 2)),
    ("none", "inflow", 0, (0, 0)),
    ("bias-3-sigma", "", -1, (1, 2)),
    ("bias-3-sigma", "", 1, (np.inf, np.inf)),
)


def made_up() -> Arrays:
    """Of the conditions (12, 2): alarms where the first comes and later, and numbers that differ from row to row."""
    names, mismatches, thresholds, first = (np.array(column) for column in zip(*CONDITIONS, strict=True))
    samples = np.full(first.shape, 4)
    healthy = np.isin(names, ["none", "leak"])[:, None]
    row = np.arange(len(names))[:, None] + np.zeros((1, 2))
    none = np.zeros(first.shape)
    right = np.where(healthy, 0, [[0, 1]] + np.arange(12)[:, None] % 3)
    false = np.where(row % 2 == 0, [[1, 0]], [[0, 2]])
    false[9] = 2, 3
    isolated_as = np.zeros((12, 2, 4))
    isolated_as[..., 0] = 4
    isolated_as[1], isolated_as[2], isolated_as[4] = (
        [[3, 1, 0, 0], [4, 0, 0, 0]],
        [[0, 0.5, 0.5, 3], [1, 0, 0, 3]],
        [[2, 0, 2, 0], [1, 1, 2, 0]],
    )
    return {
        "condition": names, "mismatch": mismatches, "threshold": thresholds, "first": first, "samples": samples,
        "alarms": np.where(np.isfinite(first), 4 - np.minimum(first, 4), 0).astype(int),
        "sensor": np.where(healthy, -1, [[0, 2]]), "faulty": np.where(healthy, 0, samples), "right": right,
        "isolated": right + np.array([1, 0]), "exact": np.minimum(right, 2), "falsely_isolated": false,
        "isolated_as": isolated_as, "judged": right > 1, "size_error": np.where(right > 0, 0.1 + row / 10, np.nan),
        "measured": np.where(healthy, np.nan, [[4.0, 1.0]] + 0 * row),
        "raw": np.where(healthy, np.nan, [[100.0, 9.0]] + 0 * row),
        "noise": np.where(healthy, np.nan, 1.0 + none), "all_measured": 2.0 + none, "all_raw": 3.0 + none,
        "diverged": row == 3,
        "trunk": np.array([[0.5, 0.9, 2.5, 0.4, 1.1, 0.3, 0.1, 0.2, 4.0], [0.2, 1.7, 0.1, 0.6, 3.0, 0.2, 0.7, 0.8, 0.0]]).T,
        "swept": np.array([
            [[5.0, 0.3], [6.0, 0.15], [0.45, 9.0], [7.0, 8.0]],
            [[1.0, 3.0], [0.0, 2.0], [9.0, 9.0], [0.55, 0.5]],
        ]),
        "swept_condition": np.array(["bias-3-sigma", "bias-10-sigma"]),
        "scale": np.array(2.0), "ends": np.array([1.6, 2.6]), "claim": np.array(0.01), "calibration_samples": np.array(10),
        "nominal_alarms": np.array([1, 2, 0]), "calibration_alarms": np.array([1, 3, 2]), "deployed_alarms": np.array([3, 1]),
        "step_seconds": np.array(1e-3), "batch_seconds": np.array(1e-4), "state_bytes": np.array(640),
    }  # fmt: skip


def cell(seeds: tuple[int, ...] = (0, 1), **changes: NDArray[Any]) -> ComparisonCell:
    """The cell, some of its arrays changed."""
    return ComparisonCell(TANKS, "made-up", SETTINGS_HERE, [made_up() | changes], seeds)
