"""Generalised likelihood ratios over a window of onsets (Willsky and Jones 1976), for any additive hypothesis.

A hypothesis of unit size changes the readings by D and the state by C in the steps since its onset. With F, H, K as used by
the filter, eta, the change of its prediction less that of the state, and M, the change of its innovation, follow

    eta <- F eta - C,    M = D - H eta,    and with the update    eta <- eta + K M,    eta = 0 at the onset

Over the steps since the onset a = sum M' S^-1 d and b = sum diag(M' S^-1 M) give the statistic a^2 / b (chi-square with 1
degree of freedom when healthy) and the size a / b with variance 1 / b. For a bias on a sensor D = e_i, C = 0: a and b of the
present onset are u and w of `leave_one_out`, so that the window is an exact extension of the leave-one-out chi-square.

Which onsets are kept is a `Grid`: all of the latest samples, or fewer and fewer in the past.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.filters.gaussian import ONE_BY_ONE
from fusion_sfdia.kalman_banks import bank_kernels
from fusion_sfdia.kalman_banks.leave_one_out import LeaveOneOut

Array = NDArray[Any]

LEAST_INFORMATION = 1e-3  # b in units of 1 / size^2, below which an onset has no information on faults of realistic size


class Grid(NamedTuple):
    """The onsets that are kept: the `latest` ones among the multiples of each of finest, 2 finest, 4 finest .. (`levels`)."""

    latest: int
    levels: int = 1
    finest: int = 1

    @classmethod
    def spanning(cls, samples: int, finest: int = 1, latest: int = 2) -> Grid:
        """Onsets up to that many samples ago, at steps that grow with their distance: latest / 2 for each doubling."""
        return cls(latest, max(1, int(np.ceil(np.log2(samples / (latest * finest)))) + 1), finest)

    @property
    def slots(self) -> int:
        """How many onsets are kept."""
        return self.latest + (self.levels - 1) * (self.latest - self.latest // 2)

    def onsets(self, step: int) -> list[int]:
        """The steps of the onsets, the newest first; negative ones are before the start."""
        sizes = [self.finest * 2**level for level in range(self.levels)]
        return sorted({(step // size - i) * size for size in sizes for i in range(self.latest)}, reverse=True)

    def moves(self, step: int) -> Array | None:
        """For each slot, that in which its onset was in the step before, -1 for the present onset; None where all stay."""
        return _moves(self, step % (self.finest * 2 ** (self.levels - 1)))


@lru_cache(maxsize=4096)
def _moves(grid: Grid, step: int) -> Array | None:
    if step % grid.finest:
        return None
    before = {onset: slot for slot, onset in enumerate(grid.onsets(step - 1))}
    return np.array([-1, *(before[onset] for onset in grid.onsets(step)[1:])])


class Window(NamedTuple):
    """Sums over the steps since each of L onsets, for q hypotheses, after an update.

    eta (..., L, n, q): after the update. a, b (..., L, q). age (..., L): samples since the onset, its own included.
    """

    eta: Array
    a: Array
    b: Array
    age: Array


class Effect(NamedTuple):
    """What hypotheses do in the present step.

    readings (..., L): D of the first N hypotheses, one for each sensor, as a factor of e_i. state (..., n, r): C of the last r
    hypotheses, or None. once (r,): whether it acts at the onset only.
    """

    readings: Array
    state: Array | None = None
    once: Array | None = None


class Weighed(NamedTuple):
    """The window with the present readings, before the update; eta of the prediction.

    readout (..., N, d): H of the first d states, the others are not read. readings (..., L): D, as of `Effect`.
    """

    window: Window
    readout: Array
    readings: Array

    @property
    def M(self) -> Array:  # noqa: N802, the symbol of the equations
        """The change of the innovation (..., L, N, q)."""
        return self.changes(slice(None), 0)

    def changes(self, slots: slice, first: int) -> Array:
        """M of the hypotheses from `first` on, with onsets in these slots."""
        H = self.readout
        found = -(H[..., None, :, :] @ self.window.eta[..., slots, : H.shape[-1], first:])
        if first == 0:
            np.einsum("...ii->...i", found[..., : H.shape[-2]])[...] += self.readings[..., slots, None]
        return np.asarray(found)


class Best(NamedTuple):
    """For each hypothesis the best onset: statistic, size, information b, level of evidence and slot of the onset (..., q)."""

    statistic: Array
    size: Array
    information: Array
    evidence: Array
    slot: Array


def empty(batch: tuple[int, ...], grid: Grid, states: int, hypotheses: int, kind: type = np.float64) -> Window:
    """Return the window before the first readings; kind: of the numbers in which eta and M are computed."""
    sums = (*batch, grid.slots, hypotheses)
    eta: Array = np.zeros((*batch, grid.slots, states, hypotheses), kind)
    return Window(eta, np.zeros(sums), np.zeros(sums), np.zeros((*batch, grid.slots)))


def shifted(window: Window, grid: Grid, step: int) -> Window:
    """Return the window with the present step as an onset, where the grid has it, and the other onsets in their slots."""
    eta, a, b, age = window
    if (places := grid.moves(step)) is None:
        return Window(eta, a, b, age + 1)
    batch = age.shape[:-1]
    eta, a, b, age = (bank_kernels.runs(v, batch) for v in window)
    return _window(batch, *bank_kernels.shift(eta, a, b, age, places))


def _window(batch: tuple[int, ...], *arrays: Array) -> Window:
    """The window of a batch from arrays (B, ..)."""
    return Window(*arrays) if len(batch) == 1 else Window(*(v.reshape(*batch, *v.shape[1:]) for v in arrays))


def weigh(
    window: Window, tangent: Array, output_jacobian: Array, found: LeaveOneOut, effect: Effect, still: int = 0
) -> Weighed:
    """Add the present innovations; tangent F (..., n, n) of the step just taken, H (..., N, n), all sensors in use.

    window: after `shifted`. still: that many last rows of F are those of the identity. With S^-1 = U U',
    a = sum (U' M)' U' d and b = sum diag((U' M)' U' M).
    """
    assert found.half is not None and found.scores is not None
    kind = window.eta.dtype
    readout = output_jacobian
    half = np.swapaxes(found.half, -1, -2).astype(kind)
    if _written_out(window, readout):
        batch, once = window.age.shape[:-1], 0 if effect.once is None else int(np.sum(effect.once))
        eta, a, b = (np.array(bank_kernels.runs(v, batch)) for v in window[:3])
        age = bank_kernels.runs(window.age, batch)
        change = np.empty((1, tangent.shape[-1], 0), kind)
        if effect.state is not None:
            change = bank_kernels.common(effect.state.astype(kind, copy=False), batch, 2)
        bank_kernels.weighed(
            eta, a, b, age, bank_kernels.common(tangent.astype(kind, copy=False), batch, 2), change, once,
            bank_kernels.common(readout.astype(kind, copy=False), batch, 2), bank_kernels.runs(half, batch),
            bank_kernels.runs(found.scores.astype(kind, copy=False), batch), bank_kernels.common(effect.readings, batch, 1),
        )  # fmt: skip
        return Weighed(_window(batch, eta, a, b, age), readout, effect.readings)
    readout = _read(output_jacobian)
    eta = _predicted(window, tangent.astype(kind, copy=False), effect, still)
    M = (half @ -readout).astype(kind)[..., None, :, :] @ eta[..., : readout.shape[-1], :]  # U' M
    M[..., : half.shape[-1]] += _direct(half, effect.readings)
    a = window.a + (found.scores.astype(kind)[..., None, None, :] @ M)[..., 0, :]
    b = window.b + np.einsum("...ij,...ij->...j", M, M)
    return Weighed(Window(eta, a, b, window.age), readout, effect.readings)


def _written_out(window: Window, readout: Array) -> bool:
    """Whether the products are so small that compiled loops take less time than calls of the library."""
    return bool(readout.shape[-2] < ONE_BY_ONE and window.eta.shape[-2] < 2 * ONE_BY_ONE)


def _direct(weights: Array, readings: Array) -> Array:
    """What D adds to the readings, weighted (..., k, N): (..., L, k, N), or (..., 1, k, N) where D = e_i for all onsets."""
    weights = weights[..., None, :, :]
    return weights if np.all(readings == 1) else weights * readings[..., None, None].astype(weights.dtype)


def _read(output_jacobian: Array) -> Array:
    """H (..., N, d) of the first d states, where no reading depends on those behind."""
    H = output_jacobian.reshape(-1, output_jacobian.shape[-1])
    return output_jacobian[..., : int(np.flatnonzero(H.any(axis=0)).max(initial=0)) + 1]


def _predicted(window: Window, tangent: Array, effect: Effect, still: int) -> Array:
    """F eta - C (..., L, n, q)."""
    moving = tangent.shape[-1] - still
    if still:
        eta = np.empty_like(window.eta)
        np.matmul(tangent[..., None, :moving, :], window.eta, out=eta[..., :moving, :])
        eta[..., moving:, :] = window.eta[..., moving:, :]
    else:
        eta = tangent[..., None, :, :] @ window.eta
    if effect.state is None:
        return eta
    change = effect.state.astype(eta.dtype, copy=False)[..., None, :, :]
    moved = eta[..., eta.shape[-1] - change.shape[-1] :]
    once = 0 if effect.once is None else int(np.sum(effect.once))
    moved[..., once:] -= change[..., once:]
    if once:
        fresh = window.age <= 1
        among = fresh.shape[-1] if np.any(fresh[..., 1:]) else 1
        moved[..., :among, :, :once] -= change[..., :once] * fresh[..., :among, None, None]
    return eta


def averaged(statistic: Array, expected: Array) -> Array:
    """Return twice the logarithm of the likelihood ratio, averaged over sizes N(0, size^2).

    It is a^2 / (b + size^-2) - ln(1 + b size^2); statistic: a^2 / b, expected: b size^2.
    """
    return np.asarray(statistic * (expected / (1 + expected)) - np.log1p(expected))


def best_onset(weighed: Weighed, usable: Array, size: Array, first: int = 0) -> Best:
    """Maximise over the onsets from slot `first` on; a statistic of 0 where there is no information.

    usable (..., q). size (q,) or (..., L, q): standard deviation of the hypothesis's size before any reading. The evidence of
    an onset is that of `averaged`.
    """
    _, a, b, age = weighed.window
    batch = age.shape[:-1]
    spread = size[None, None] if size.ndim == 1 else bank_kernels.common(size, batch, 2)
    found = bank_kernels.best(
        bank_kernels.runs(a, batch), bank_kernels.runs(b, batch), bank_kernels.runs(usable, batch), spread, first,
        LEAST_INFORMATION,
    )  # fmt: skip
    return Best(*found) if len(batch) == 1 else Best(*(v.reshape(*batch, -1) for v in found))


def absorbed(weighed: Weighed, best: Best, which: Array) -> Array:
    """Return the change of the predicted state less that of the true one (..., n) by a unit of hypothesis `which` (...) since
    its best onset.
    """
    column = which[..., None]
    slot = np.take_along_axis(best.slot, column, axis=-1)[..., None, None]
    eta = np.take_along_axis(weighed.window.eta, slot, axis=-3)[..., 0, :, :]
    return np.take_along_axis(eta, column[..., None], axis=-1)[..., 0]


def updated(weighed: Weighed, gain: Array, restart: Array) -> Window:
    """Return the window after the update with gain K (..., n, N).

    restart (...): runs whose window restarts, because the readings in use, or the model, have changed.
    """
    (before, a, b, age), readout, readings = weighed
    kind, read = before.dtype, readout.shape[-1]
    if _written_out(weighed.window, readout):
        batch = age.shape[:-1]
        eta = np.array(bank_kernels.runs(before, batch))
        K, H = (bank_kernels.common(v.astype(kind, copy=False), batch, 2) for v in (gain, readout))
        bank_kernels.corrected(eta, K, H, bank_kernels.common(readings, batch, 1))
        return _restarted(Window(eta.reshape(before.shape), a, b, age), restart)
    eta = (gain @ -readout).astype(kind)[..., None, :, :] @ before[..., :read, :]  # K M = K D - K H eta
    eta += before
    eta[..., : gain.shape[-1]] += _direct(gain.astype(kind, copy=False), readings)
    return _restarted(Window(eta, a, b, age), restart)


def _restarted(window: Window, restart: Array) -> Window:
    """The window without what the runs `restart` (...) have summed so far."""
    if not restart.any():
        return window
    keep = ~restart[..., None]
    sums = keep[..., None]
    return Window(window.eta * sums[..., None], window.a * sums, window.b * sums, window.age * keep)
