"""Generalised likelihood ratios over a window of onsets (Willsky and Jones 1976), for any additive hypothesis.

A hypothesis of unit size changes the readings by D and the state by C in the steps since its onset. With F, H, K as used by
the filter, eta, the change of its prediction less that of the state, and M, the change of its innovation, follow

    eta <- F eta - C,    M = D - H eta,    and with the update    eta <- eta + K M,    eta = 0 at the onset

Over the steps since the onset a = sum M' S^-1 d and b = sum diag(M' S^-1 M) give the statistic a^2 / b (chi-square with 1
degree of freedom when healthy) and the size a / b with variance 1 / b. For a bias on a sensor D = e_i, C = 0: a and b of the
present onset are u and w of `leave_one_out`, so that the window is an exact extension of the leave-one-out chi-square.

Which onsets are kept is a `OnsetGrid`: all of the latest samples, or fewer and fewer in the past.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.alike import for_all, repeated, single
from fusion_sfdia.detectors.kalman_banks import window_kernels, window_step
from fusion_sfdia.detectors.kalman_banks.bank_kernels import contiguous, of_runs
from fusion_sfdia.detectors.kalman_banks.leave_one_out import LeaveOneOut, value_at
from fusion_sfdia.detectors.kalman_banks.window_step import WindowStep

Array = NDArray[Any]

NO_INFLATION = np.ones((1, 1)), np.ones((1, 1, 0))
LEAST_INFORMATION = 1e-3  # b in units of 1 / size^2, below which an onset has no information on faults of realistic size


class OnsetGrid(NamedTuple):
    """The onsets that are kept: the `latest` ones among the multiples of each of finest, 2 finest, 4 finest .. (`levels`)."""

    latest: int
    levels: int = 1
    finest: int = 1

    @classmethod
    def spanning(cls, samples: int, finest: int = 1, latest: int = 2) -> OnsetGrid:
        """Onsets up to that many samples ago, at steps that grow with their distance: latest / 2 for each doubling."""
        return cls(latest, max(1, int(np.ceil(np.log2(samples / (latest * finest)))) + 1), finest)

    @property
    def slots(self) -> int:
        """How many onsets are kept."""
        return self.latest + (self.levels - 1) * (self.latest - self.latest // 2)

    @property
    def oldest(self) -> int:
        """The age, in samples, that an onset has at most."""
        return int(self.latest * self.finest * 2 ** (self.levels - 1))

    def onsets(self, step: int) -> list[int]:
        """The steps of the onsets, the newest first; negative ones are before the start."""
        sizes = [self.finest * 2**level for level in range(self.levels)]
        return sorted({(step // size - i) * size for size in sizes for i in range(self.latest)}, reverse=True)

    def moves(self, step: int) -> Array | None:
        """For each slot, that in which its onset was in the step before, -1 for the present onset; None where all stay."""
        return _moves(self, step % (self.finest * 2 ** (self.levels - 1)))


@lru_cache(maxsize=4096)
def _moves(grid: OnsetGrid, step: int) -> Array | None:
    if step % grid.finest:
        return None
    before = {onset: slot for slot, onset in enumerate(grid.onsets(step - 1))}
    return np.array([-1, *(before[onset] for onset in grid.onsets(step)[1:])])


class Window(NamedTuple):
    """Sums over the steps since each of L onsets, for q hypotheses, with the last readings.

    eta (..., L, n, q): of the last prediction, before the update. readings (..., L): D of the last readings. a, b (..., L, q).
    age (..., L): samples since the onset, its own included.
    """

    eta: Array
    readings: Array
    a: Array
    b: Array
    age: Array


class Effect(NamedTuple):
    """What hypotheses do in the present step.

    readings (..., L): D of the first N hypotheses, one for each sensor, as a factor of e_i. state (..., n, r): C of the last r
    hypotheses, or None; that of the first `once` of these acts at the onset only. ramp: whether D is the age, not 1.
    """

    readings: Array
    state: Array | None = None
    once: int = 0
    ramp: bool = False


class Shifted(NamedTuple):
    """The window before a step, and a, b, age of its onsets in the slots of that step; places (L,): see `OnsetGrid.moves`."""

    before: Window
    places: Array
    a: Array
    b: Array
    age: Array


class Weighed(NamedTuple):
    """The window of the present step, and H (..., N, n)."""

    eta: Array
    readings: Array
    a: Array
    b: Array
    age: Array
    readout: Array

    @property
    def M(self) -> Array:  # noqa: N802, the symbol of the equations
        """The change of the innovation (..., L, N, q)."""
        return self.changes(slice(None), 0)

    def changes(self, slots: slice, first: int) -> Array:
        """M of the hypotheses from `first` on, with onsets in these slots."""
        found = -(self.readout[..., None, :, :] @ self.eta[..., slots, :, first:])
        if first == 0:
            np.einsum("...ii->...i", found[..., : self.readout.shape[-2]])[...] += self.readings[..., slots, None]
        return np.asarray(found)


class Best(NamedTuple):
    """For each hypothesis the best onset: statistic, size, information b, level of evidence and slot of the onset (..., q)."""

    statistic: Array
    size: Array
    information: Array
    evidence: Array
    slot: Array


def empty(batch: tuple[int, ...], grid: OnsetGrid, states: int, hypotheses: int, kind: type | None = None) -> Window:
    """Return the window before the first readings; kind: of the numbers of eta, `window_step.NUMBERS` by default."""
    slots, sums = (*batch, grid.slots), (*batch, grid.slots, hypotheses)
    eta = for_all(np.zeros((grid.slots, states, hypotheses), kind or window_step.NUMBERS), batch)
    return Window(eta, np.zeros(slots), np.zeros(sums), for_all(np.zeros(sums[-2:]), batch), np.zeros(slots))


def shifted(window: Window, grid: OnsetGrid, step: int) -> Shifted:
    """Return the window with the present step as an onset, where the grid has it, and the other onsets in their slots."""
    places = np.arange(grid.slots) if (moves := grid.moves(step)) is None else moves
    a, b, age = (contiguous(v) for v in (window.a, single(window.b), window.age))
    a, b, age = window_kernels.shift(a, b, age, places)
    return Shifted(window, places, a, repeated(b, a), age)


def weigh(now: Shifted, step: WindowStep, effect: Effect) -> Weighed:
    """Take the window over a step and add its innovations.

    Where all runs have the same transition and the same hypotheses, such as biases, eta and b are computed once.
    """
    before, places, a, b, age = now
    kind, D = before.eta.dtype, effect.readings
    alike = effect.state is None and D.ndim == 1 and len(step.A) == len(step.seen) == 1
    old = contiguous(single(before.eta) if alike else before.eta)
    eta, a, b = np.empty_like(old), np.array(a, order="C"), np.array(single(b) if len(old) == 1 else b, order="C")
    change = np.empty((1, step.A.shape[-1], 0)) if effect.state is None else effect.state
    readings = D if D.ndim > 1 else repeated(D[None], age)
    onsets = window_kernels.Onsets(contiguous(age), places, contiguous(single(before.readings)), contiguous(single(readings)))
    arrays = window_kernels.StepArrays(
        step.A,
        step.leading,
        step.FK,
        step.half,
        step.seen,
        step.scores,
        of_runs(change.astype(kind, copy=False), 2),
        effect.once,
    )
    window_kernels.weighed(old, eta, a, b, onsets, arrays)
    return Weighed(repeated(eta, a), readings, a, repeated(b, a), age, step.H[0] if len(step.H) == 1 else step.H)


def averaged(statistic: Array, expected: Array) -> Array:
    """Return twice the logarithm of the likelihood ratio, averaged over sizes N(0, size^2).

    It is a^2 / (b + size^-2) - ln(1 + b size^2); statistic: a^2 / b, expected: b size^2.
    """
    return np.asarray(statistic * (expected / (1 + expected)) - np.log1p(expected))


class Inflation(NamedTuple):
    """By how much sums since each onset vary more than those of white noise: common (..., L), of sensors own (..., L, N)."""

    common: Array
    own: Array


def best_onset(weighed: Weighed, usable: Array, size: Array, first: int = 0, inflation: Inflation | None = None) -> Best:
    """Maximise over the onsets from slot `first` on; a statistic of 0 where there is no information.

    usable (..., q). size (q,) or (..., L, q): standard deviation of the hypothesis's size before any reading. The evidence of
    an onset is that of `averaged`. inflation: of the noise; hypotheses compete by the common one, so that none is favoured, and
    the statistic and information of each are by its own.
    """
    spread = size[None, None] if size.ndim == 1 else of_runs(size, 2)
    common, own = NO_INFLATION if inflation is None else map(contiguous, inflation)
    a, b, usable = (contiguous(v) for v in (weighed.a, weighed.b, usable))
    return Best(*window_kernels.best(a, b, usable, spread, common, own, first, LEAST_INFORMATION))


def with_readings(weighed: Weighed, more: Array) -> Weighed:
    """The window with M' du added to a: readings whose whitened innovations u are more by du (..., N)."""
    back = (np.swapaxes(weighed.readout, -1, -2) @ more[..., None])[..., 0]
    added = -np.einsum("...lnq,...n->...lq", weighed.eta, back)
    added[..., : more.shape[-1]] += weighed.readings[..., None] * more[..., None, :]
    return weighed._replace(a=weighed.a + added)


def residual_and_threshold(
    found: LeaveOneOut, statistic: Array, size: Array, information: Array, limits: tuple[float, float]
) -> tuple[Array, Array]:
    """Residual and threshold of each sensor (..., N): of the sample, or of the best onset where its statistic is larger.

    statistic, size and information (..., N) are of the best onset. limits: of the statistics of sample and window; each counts
    in units of its own.
    """
    u, w, used = map(contiguous, (found.whitened, found.weight, found.used))
    statistic, size, information = map(contiguous, (statistic, size, information))
    residual, threshold = window_kernels.residual_and_threshold(u, w, used, statistic, size, information, *limits)
    return residual, threshold


def absorbed(weighed: Weighed, best: Best, which: Array) -> Array:
    """Return the change of the predicted state less that of the true one (..., n) by a unit of hypothesis `which` (...) since
    its best onset.
    """
    slot = value_at(best.slot, which).ravel()
    eta = weighed.eta.reshape(-1, *weighed.eta.shape[-3:])
    found = eta[np.arange(len(eta)), slot, :, which.ravel()]
    return np.asarray(found.reshape(*which.shape, -1))


def updated(weighed: Weighed, restart: Array) -> Window:
    """Return the window after the update, which the next step takes; see `last_update`.

    restart (...): runs whose window restarts, because the readings in use, or the model, have changed.
    """
    window: Window = restarted(Window(*weighed[:5]), restart)
    return window


def restarted(carried: Any, where: Array) -> Any:
    """What is carried from step to step, a tuple of arrays (..., ..), as at the start in the runs `where` (...) holds: 0."""
    if not where.any():
        return carried
    return type(carried)(*(np.where(where.reshape(where.shape + (1,) * (v.ndim - where.ndim)), 0, v) for v in carried))
