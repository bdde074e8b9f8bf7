"""Healthy logs of any length as runs of one length, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.gaps import parted, stated_step
from fusion_sfdia.core.log import Log
from fusion_sfdia.core.plant import Plant

Array = NDArray[Any]

EVEN = 0.01  # of dt: times of runs side by side may differ by so much
LEAST = 40  # samples of a run


def as_even_runs(plant: Plant, logs: Sequence[Log]) -> Log:
    """The logs of one run each, cut at gaps, as one Log of runs of the length at which most samples are used.

    The runs take the times of the first: a model's dependence on the time of day is lost. Unevenly sampled stretches cannot
    stand side by side; the longest is then used alone. ValueError where no stretch is long enough.
    """
    parts = [part for log in logs for part in _without_gaps(plant, log)]
    parts = [p for p in parts if len(p.t) >= LEAST]
    if not parts:
        raise ValueError(
            f"no stretch of {LEAST} samples without a gap in the healthy logs; plant {plant.name!r} steps over "
            f"{stated_step(plant):g} s at most: give longer logs, or a plant with another max_dt"
        )
    longest = max(parts, key=lambda p: len(p.t))
    even = [p for p in parts if np.max(np.abs(np.diff(p.t) - plant.dt)) <= EVEN * plant.dt]
    if len(parts) == 1 or not even or sum(len(p.t) for p in even) <= len(longest.t):
        return Log(longest.t, longest.y[:, None], longest.u[:, None])
    lengths = [len(p.t) for p in even]
    length = max(sorted(set(lengths)), key=lambda n: sum(k // n * (n - LEAST) for k in lengths))
    cut = [slice(i * length, (i + 1) * length) for i in range(max(lengths) // length)]
    runs = [(p.y[s], p.u[s]) for p in even for s in cut[: len(p.t) // length]]
    first = next(p for p in even if len(p.t) >= length)
    return Log(first.t[:length], np.stack([y for y, _ in runs], axis=1), np.stack([u for _, u in runs], axis=1))


def _without_gaps(plant: Plant, log: Log) -> list[Log]:
    """The stretches between gaps that are too long for a step of the plant, or twice as long as usual."""
    most = min(stated_step(plant) * (1 + 1e-9), 2 * float(np.median(np.diff(log.t))) if len(log.t) > 1 else np.inf)
    return parted(log, np.diff(log.t) > most)
