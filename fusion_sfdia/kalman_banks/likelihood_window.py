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

from fusion_sfdia.kalman_banks.leave_one_out import LeaveOneOut

Array = NDArray[Any]

LEAST_INFORMATION = 1e-3  # b in units of 1 / size^2, below which an onset has no information on faults of realistic size


class Grid(NamedTuple):
    """The onsets that are kept: the `latest` ones among the multiples of each of finest, 2 finest, 4 finest .. (`levels`)."""

    latest: int
    levels: int = 1
    finest: int = 1

    @classmethod
    def spanning(cls, samples: int, finest: int = 1, latest: int = 4) -> Grid:
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

    def moves(self, step: int) -> list[int] | None:
        """For each slot but the first, the slot in which its onset was in the step before; None where all stay."""
        return _moves(self, step % (self.finest * 2 ** (self.levels - 1)))


@lru_cache(maxsize=4096)
def _moves(grid: Grid, step: int) -> list[int] | None:
    if step % grid.finest:
        return None
    before = {onset: slot for slot, onset in enumerate(grid.onsets(step - 1))}
    return [before[onset] for onset in grid.onsets(step)[1:]]


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
    """The window with the present readings, before the update; eta of the prediction, M (..., L, N, q)."""

    window: Window
    M: Array


class Best(NamedTuple):
    """For each hypothesis the best onset: statistic, size, information b, level of evidence and slot of the onset (..., q)."""

    statistic: Array
    size: Array
    information: Array
    evidence: Array
    slot: Array


def empty(batch: tuple[int, ...], grid: Grid, states: int, hypotheses: int) -> Window:
    """Return the window before the first readings."""
    sums = (*batch, grid.slots, hypotheses)
    eta = np.zeros((*batch, grid.slots, states, hypotheses))
    return Window(eta, np.zeros(sums), np.zeros(sums), np.zeros((*batch, grid.slots)))


def shifted(window: Window, grid: Grid, step: int) -> Window:
    """Return the window with the present step as an onset, where the grid has it, and the other onsets in their slots."""
    places = grid.moves(step)
    if places is not None:
        window = Window(*(_shift(v, places, axis) for v, axis in zip(window, (-3, -2, -2, -1), strict=True)))
    return window._replace(age=window.age + 1)


def _shift(v: Array, places: list[int], axis: int) -> Array:
    """The slots from these places behind a new one of zeros."""
    v = np.moveaxis(v, axis, 0)
    moved = np.empty_like(v)
    moved[0] = 0.0
    np.take(v, places, axis=0, out=moved[1:])
    return np.asarray(np.moveaxis(moved, 0, axis))


def weigh(window: Window, tangent: Array, output_jacobian: Array, found: LeaveOneOut, effect: Effect) -> Weighed:
    """Add the present innovations; tangent F (..., n, n) of the step just taken, H (..., N, n), all sensors in use.

    window: after `shifted`.
    """
    eta = tangent[..., None, :, :] @ window.eta
    if effect.state is not None:
        change = effect.state[..., None, :, :]
        if effect.once is not None:
            change = np.where(effect.once & (window.age[..., None, None] > 1), 0.0, change)
        eta[..., eta.shape[-1] - change.shape[-1] :] -= change
    M = -measured(output_jacobian, eta)
    direct = np.einsum("...ii->...i", M[..., : found.used.shape[-1]])
    direct += effect.readings[..., None]
    a = window.a + (np.swapaxes(M, -1, -2) @ found.whitened[..., None, :, None])[..., 0]
    b = window.b + np.einsum("...ij,...ij->...j", M, found.inverse[..., None, :, :] @ M)
    return Weighed(window._replace(eta=eta, a=a, b=b), M)


def measured(output_jacobian: Array, eta: Array) -> Array:
    """H eta (..., L, N, q); a copy of rows of eta where H selects states."""
    rows = output_jacobian.reshape(-1, *output_jacobian.shape[-2:])
    picks = np.argmax(rows[0] != 0, axis=-1)
    if np.array_equal(rows, np.broadcast_to(np.arange(rows.shape[-1]) == picks[:, None], rows.shape)):
        return np.asarray(np.take(eta, picks, axis=-2))
    return np.asarray(output_jacobian[..., None, :, :] @ eta)


def best_onset(weighed: Weighed, usable: Array, size: Array, first: int = 0) -> Best:
    """Maximise over the onsets from slot `first` on; a statistic of 0 where there is no information.

    usable (..., q). size (q,) or (..., L, q): standard deviation of the hypothesis's size before any reading. The evidence of
    an onset is twice the logarithm of the likelihood ratio, averaged over sizes N(0, size^2):
    a^2 / (b + size^-2) - ln(1 + b size^2).
    """
    a, b = weighed.window.a[..., first:, :], weighed.window.b[..., first:, :]
    spread = size**2 if np.ndim(size) == 1 else (size**2)[..., first:, :]
    known = usable[..., None, :] & (b * spread > LEAST_INFORMATION)
    information = np.where(known, b, 1.0)
    found = np.where(known, a, 0.0) / information
    statistic = found**2 * information
    evidence = np.where(known, statistic * (b * spread / (1 + b * spread)) - np.log1p(b * spread), -np.inf)
    slot = np.argmax(statistic, axis=-2, keepdims=True)
    best, size, information, evidence = (
        np.take_along_axis(v, slot, axis=-2)[..., 0, :] for v in (statistic, found, information, evidence)
    )
    return Best(best, size, information, evidence, slot[..., 0, :] + first)


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
    window, M = weighed
    eta = window.eta + gain[..., None, :, :] @ M
    if not np.any(restart):
        return window._replace(eta=eta)
    keep = ~restart[..., None]
    sums = keep[..., None]
    return Window(eta * sums[..., None], window.a * sums, window.b * sums, window.age * keep)
