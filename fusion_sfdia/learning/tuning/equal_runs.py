"""Healthy logs of any length as runs of one length, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.plant.gaps import LONG, stated_step, stretches
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

EVEN = 0.01  # of dt: times of runs side by side may differ by so much
LEAST = 40  # samples of a run


class EvenRuns(NamedTuple):
    """A log of runs, the times (K, B) at which they were recorded, and of which of the logs each is (B,)."""

    log: Log
    times: Array
    of: tuple[int, ...]


def as_even_runs(plant: Plant, logs: Sequence[Log]) -> EvenRuns:
    """The logs of one run each, cut at long gaps, as one Log of runs of the length at which most samples are used.

    The runs take the times of the first: a model's dependence on the time of day is lost. Unevenly sampled stretches cannot
    stand side by side; the longest is then used alone. ValueError where no stretch is long enough.
    """
    whole = [(i, part) for i, log in enumerate(logs) for part in _without_gaps(plant, log) if len(part.t) >= LEAST]
    if not whole:
        raise ValueError(
            f"no stretch of {LEAST} samples without a gap of more than {LONG} in the healthy logs: give longer logs"
        )
    alone, longest = max(whole, key=lambda part: len(part[1].t))
    even = [(i, p) for i, p in whole if np.max(np.abs(np.diff(p.t) - plant.dt)) <= EVEN * plant.dt]
    lengths = [len(p.t) for _, p in even]
    if len(whole) == 1 or sum(lengths) <= len(longest.t):
        return EvenRuns(Log(longest.t, longest.y[:, None], longest.u[:, None]), longest.t[:, None], (alone,))
    length = max(sorted(set(lengths)), key=lambda n: sum(k // n * (n - LEAST) for k in lengths))
    cut = [slice(i * length, (i + 1) * length) for i in range(max(lengths) // length)]
    runs = [(i, Log(*(a[s] for a in p))) for i, p in even for s in cut[: len(p.t) // length]]
    t, y, u = (np.stack([run[j] for _, run in runs], axis=1) for j in range(3))
    return EvenRuns(Log(t[:, 0], y, u), t, tuple(i for i, _ in runs))


def _without_gaps(plant: Plant, log: Log) -> list[Log]:
    """The stretches between long gaps, with rows as far apart as the log's usually are, or, where the plant steps over less, as
    its dt.
    """
    if len(log.t) < 2:
        return [log]
    usual = float(np.median(np.diff(log.t)))
    return stretches(log, usual if usual <= stated_step(plant) * (1 + 1e-9) else plant.dt)
