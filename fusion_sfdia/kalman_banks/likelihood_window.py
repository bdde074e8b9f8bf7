"""Generalised likelihood ratios over a window of onsets (Willsky and Jones 1976), for a bias on any sensor.

A unit bias on sensor i that begins at step j changes the innovation at step k by the i-th column of

    M = I - H eta,    eta <- F (eta + K M),    eta = 0 at the onset

with F, H, K as used by the filter. The window stores eta before the update; its recursion costs one product for each onset:
eta <- F (I - K H) eta + F K. Over the steps since the onset a = sum M' S^-1 d and b = sum diag(M' S^-1 M)
give the statistic a^2 / b (chi-square with 1 degree of freedom when healthy) and the size of the bias a / b with variance
1 / b. At the onset a and b are u and w of `leave_one_out`: an exact extension of the leave-one-out chi-square.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.kalman_banks.leave_one_out import LeaveOneOut

Array = NDArray[Any]

LEAST_INFORMATION = 1e-3  # b in units of 1 / R_ii, below which an onset has no information on faults of realistic size


class Window(NamedTuple):
    """The window after an update, for onsets 0 .. L - 1 steps before it.

    eta (..., L, n, N): before the update. a, b (..., L, N). closed: I - K H (..., n, n), gain: K (..., n, N) of the update.
    """

    eta: Array
    a: Array
    b: Array
    closed: Array
    gain: Array


class OnsetStatistics(NamedTuple):
    """For onsets 1 .. L steps ago: eta before the update (..., L, n, N), a, b (..., L, N) with the present readings, and H."""

    eta: Array
    a: Array
    b: Array
    output_jacobian: Array


class Best(NamedTuple):
    """For each sensor the onset with the largest statistic: statistic, size, information b and index of the onset (..., N)."""

    statistic: Array
    size: Array
    information: Array
    onset: Array


def empty(batch: tuple[int, ...], lags: int, states: int, sensors: int) -> Window:
    """Return the window before the first readings."""
    sums = (*batch, lags, sensors)
    eta, gain = np.zeros((*batch, lags, states, sensors)), np.zeros((*batch, states, sensors))
    return Window(eta, np.zeros(sums), np.zeros(sums), np.zeros((*batch, states, states)), gain)


def weigh(window: Window, tangent: Array, output_jacobian: Array, found: LeaveOneOut) -> OnsetStatistics:
    """Add the present innovations; tangent F (..., n, n) of the step just taken, H (..., N, n), all sensors in use."""
    eta = (tangent @ window.closed)[..., None, :, :] @ window.eta
    eta += (tangent @ window.gain)[..., None, :, :]
    effect = np.eye(found.used.shape[-1]) - output_jacobian[..., None, :, :] @ eta
    a = window.a + (np.swapaxes(effect, -1, -2) @ found.whitened[..., None, :, None])[..., 0]
    b = window.b + np.einsum("...ij,...ij->...j", effect, found.inverse[..., None, :, :] @ effect)
    return OnsetStatistics(eta, a, b, output_jacobian)


def best_onset(onsets: OnsetStatistics, usable: Array, sensor_cov: Array) -> Best:
    """Maximise over the onsets, for the sensors in use (..., N); a statistic of 0 where there is no information."""
    known = usable[..., None, :] & (onsets.b * sensor_cov > LEAST_INFORMATION)
    information = np.where(known, onsets.b, 1.0)
    size = np.where(known, onsets.a, 0.0) / information
    statistic = size**2 * information
    onset = np.argmax(statistic, axis=-2, keepdims=True)
    at = [np.take_along_axis(v, onset, axis=-2)[..., 0, :] for v in (statistic, size, information)]
    return Best(at[0], at[1], at[2], onset[..., 0, :])


def absorbed(onsets: OnsetStatistics, best: Best, sensor: Array) -> Array:
    """Return the change of the predicted state (..., n) by a unit bias of `sensor` (...) since its best onset."""
    which = sensor[..., None]
    onset = np.take_along_axis(best.onset, which, axis=-1)[..., None, None]
    eta = np.take_along_axis(onsets.eta, onset, axis=-3)[..., 0, :, :]
    return np.take_along_axis(eta, which[..., None], axis=-1)[..., 0]


def advance(onsets: OnsetStatistics, gain: Array, found: LeaveOneOut, restart: Array) -> Window:
    """Return the window after the update with gain K (..., n, N): onsets are one step older, the present one is added.

    restart (...): runs whose window restarts, because the readings in use have changed.
    """
    eta = np.concatenate([np.zeros_like(onsets.eta[..., :1, :, :]), onsets.eta[..., :-1, :, :]], axis=-3)
    a = np.concatenate([found.whitened[..., None, :], onsets.a[..., :-1, :]], axis=-2)
    b = np.concatenate([found.weight[..., None, :], onsets.b[..., :-1, :]], axis=-2)
    closed = np.eye(gain.shape[-2]) - gain @ onsets.output_jacobian
    if not np.any(restart):
        return Window(eta, a, b, closed, gain)
    keep = ~restart[..., None, None]
    return Window(eta * keep[..., None], a * keep, b * keep, closed, gain * keep)
