"""Alarms from streams of normalised residuals z = residual / deviation: several in a row, cumulative sums, windows.

Each test has `start(shape)` -> state and `step(state, z)` -> (state, statistic), elementwise and of any shape, so streams,
seeds and components may be mixed. It raises an alarm where the statistic exceeds `level`. A missing z (NaN) changes nothing and
raises no alarm. `run` is the loop over z (K, ...).

False-alarm probability. The probability of q alarms in a row is at most that of one alarm, 1 / alpha^2 by Chebyshev. Boem et
al. 2018, Proposition 5, bound it by (1 / alpha^2)^q, with a proof that assumes independent consecutive alarms. They are not
independent: neighbouring residuals share a reading and, with lam > 0, a memory. That bound does not hold (a test shows it). For
a stated probability with any of the three tests set `level` to an order statistic of healthy runs
(`threshold_rules.conformal_alpha`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import floats, number, whole

Array = NDArray[Any]
ConfirmationState = tuple[Array, ...]


class Confirmation(Protocol):
    """A sequential test of a stream of residuals, which confirms an alarm."""

    @property
    def level(self) -> float: ...
    def start(self, shape: tuple[int, ...]) -> ConfirmationState: ...
    def step(self, state: ConfirmationState, z: Array) -> tuple[ConfirmationState, Array]: ...


def run(test: Confirmation, z: Array) -> Array:
    """The statistics (K, ...) of a stream z (K, ...); alarms are where they exceed test.level."""
    z = floats("z", z)
    state, statistics = test.start(z.shape[1:]), np.empty(z.shape)
    for k in range(len(z)):
        state, statistics[k] = test.step(state, z[k])
    return statistics


@dataclass(frozen=True)
class Consecutive:
    """q in a row: the least |z| of the last q exceeds the level (Boem et al. 2018, sec. VII-A); 0 before there are q."""

    level: float
    q: int = 3

    def __post_init__(self) -> None:
        _require_level(self.level)
        whole("q", self.q, least=1)

    def start(self, shape: tuple[int, ...]) -> ConfirmationState:
        return (np.zeros((*shape, self.q)),)

    def step(self, state: ConfirmationState, z: Array) -> tuple[ConfirmationState, Array]:
        (last,) = state
        moved = np.concatenate([last[..., 1:], np.abs(z)[..., None]], axis=-1)
        seen = np.isfinite(z)
        last = np.where(seen[..., None], moved, last)
        return (last,), np.where(seen, np.min(last, axis=-1), 0.0)


@dataclass(frozen=True)
class ConfirmationCusum:
    """Cumulative sums of z - drift and -z - drift, kept at or above 0 (Page 1954); drift: half the shift to detect."""

    level: float
    drift: float = 0.5

    def __post_init__(self) -> None:
        _require_level(self.level)
        if not 0 <= number("drift", self.drift) < np.inf:
            raise ValueError(f"drift is {self.drift}; expected at least 0, half the shift in standard deviations")

    def start(self, shape: tuple[int, ...]) -> ConfirmationState:
        return np.zeros(shape), np.zeros(shape)

    def step(self, state: ConfirmationState, z: Array) -> tuple[ConfirmationState, Array]:
        seen = np.isfinite(z)
        value = np.where(seen, z, 0.0)
        up, down = (np.where(seen, np.maximum(s + v - self.drift, 0.0), s) for s, v in zip(state, (value, -value), strict=True))
        return (up, down), np.where(seen, np.maximum(up, down), 0.0)


@dataclass(frozen=True)
class WindowGlr:
    """The largest |sum of the last k| / sqrt(k) over k up to `window`.

    For white unit Gaussian z it is the root of twice the log-likelihood ratio of a constant shift that began k samples ago.
    """

    level: float
    window: int = 8

    def __post_init__(self) -> None:
        _require_level(self.level)
        whole("window", self.window, least=1)

    def start(self, shape: tuple[int, ...]) -> ConfirmationState:
        return (np.zeros((*shape, self.window)),)

    def step(self, state: ConfirmationState, z: Array) -> tuple[ConfirmationState, Array]:
        (sums,) = state  # sums of the last 1, 2, ... window samples
        seen = np.isfinite(z)
        value = np.where(seen, z, 0.0)[..., None]
        moved = value + np.concatenate([np.zeros_like(value), sums[..., :-1]], axis=-1)
        sums = np.where(seen[..., None], moved, sums)
        statistic = np.max(np.abs(sums) / np.sqrt(np.arange(1, self.window + 1)), axis=-1)
        return (sums,), np.where(seen, statistic, 0.0)


def _require_level(level: object) -> None:
    if not 0 < number("level", level) < np.inf:
        raise ValueError(f"level is {level}; expected a positive number of standard deviations")
