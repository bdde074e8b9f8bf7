"""What healthy logs say of each channel: which others explain it, how long it repeats a reading, whether it ever moves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.log import Log
from fusion_sfdia.core.regularity import equal_readings
from fusion_sfdia.core.signals import Signal
from fusion_sfdia.evaluation.absent import repeats
from fusion_sfdia.evaluation.events import Event
from fusion_sfdia.identification.autoregression import autoregression
from fusion_sfdia.identification.choice import RIDGE
from fusion_sfdia.identification.runs import Runs
from fusion_sfdia.identification.state_space import terms
from fusion_sfdia.identification.subspace import held

Array = NDArray[Any]

UNEXPLAINED = 0.1  # share of the variance below which no other channel explains a channel
SAME = 0.9  # share of the variance of one channel that one other explains, beyond which both are redundant


class Channel(NamedTuple):
    """explained: share of a sensor's variance in left-out runs that the other sensors and the inputs explain at the same time,
    negative where they predict worse than the mean. partner: the sensor with the largest squared correlation, and that.
    repeats: the longest run of one reading, in samples.
    """

    name: str
    explained: float
    partner: str
    shared: float
    repeats: int

    def __str__(self) -> str:
        if self.explained < UNEXPLAINED:
            return f"{self.name}: no other channel explains it; only its own past shows a fault, and a slow one not at all"
        same = f"; redundant with {self.partner}" if self.shared > SAME else ""
        return f"{self.name}: the other channels explain {self.explained:.0%} of its variance{same}"


def channels_of(sensors: Sequence[Signal], runs: Runs, groups: Sequence[Sequence[Log]]) -> tuple[Channel, ...]:
    """Judge each sensor that moves, by ridge predictors that have not seen the group of runs that they are judged on."""
    error, total = np.zeros(len(sensors)), np.zeros(len(sensors))
    for k, group in enumerate(groups):
        rest = [log for j, other in enumerate(groups) if j != k for log in other]
        model = autoregression(_parts(runs, rest), 0, RIDGE, sensors)
        precision = np.linalg.inv(model.Q + np.diag(model.r))
        for y, z in _parts(runs, group):
            known = np.isfinite(y)
            left = (held(y) - z @ model.B.T) @ precision / np.diag(precision)  # y_i less its prediction from the others
            error += np.sum(np.where(known, left, 0.0) ** 2, axis=0)
            total += np.sum(np.where(known, y, 0.0) ** 2, axis=0)
    explained = 1 - error / np.maximum(total, 1e-12)
    y = np.concatenate([held(part) for part, _ in _parts(runs, runs.logs)])
    shared = np.nan_to_num(np.corrcoef(y.T).reshape(len(sensors), -1)) ** 2 * (1 - np.eye(len(sensors)))
    best = np.argmax(shared, axis=1)
    return tuple(
        Channel(s.name, float(explained[i]), sensors[best[i]].name, float(shared[i, best[i]]),
                max(int(np.max(equal_readings(log.y[:, i])[2], initial=1)) for log in runs.logs))
        for i, s in enumerate(sensors)
    )  # fmt: skip


def frozen(channels: Sequence[Channel], sensors: Sequence[Signal], t: Array, y: Array) -> list[Event]:
    """The times (K,) at which sensors repeat one reading of y (K, N) longer than healthy logs allow, see `absent.repeats`."""
    return [
        Event(s.name, float(t[a]), float(t[b]), np.nan, s.unit, not np.isfinite(y[b + 1 :, i]).any())
        for i, (s, stretches) in enumerate(zip(sensors, repeats(y, [c.repeats for c in channels]), strict=True))
        for a, b in stretches
    ]


def _parts(runs: Runs, logs: Sequence[Log]) -> list[tuple[Array, Array]]:
    return [(y, terms(log.u, runs.u_mean, runs.u_sd, False)) for (y, _), log in zip(runs.scaled(logs), logs, strict=True)]
