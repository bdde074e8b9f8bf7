"""Generalised likelihood ratios over a window of onsets (Willsky and Jones 1976), for a bias on any sensor.

A unit bias on sensor i that begins at step j changes the innovation at step k by the i-th column of

    M = I - H eta,    eta <- F (eta + K M),    eta = 0 at the onset

with F, H, K those of the filter as it ran. Over the steps since the onset a = sum M' S^-1 d and b = sum diag(M' S^-1 M)
give the statistic a^2 / b (chi-square with 1 degree of freedom when healthy) and the size of the bias a / b with variance
1 / b. At the onset itself they are u and w of `leave_one_out`: an exact extension of the leave-one-out chi-square.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.leave_one_out import LeaveOneOut

Array = NDArray[Any]

LEAST_INFORMATION = 1e-3  # b in units of 1 / R_ii below which an onset tells nothing of a fault of any likely size


class Window(NamedTuple):
    """By onset 1 .. L steps ago: eta after the last update (..., L, n, N), a and b (..., L, N)."""

    eta: Array
    a: Array
    b: Array


class Evidence(NamedTuple):
    """Window sums with the present readings: eta and M before the update (..., L, n, N), (..., L, N, N), a, b (..., L, N)."""

    eta: Array
    effect: Array
    a: Array
    b: Array


class Best(NamedTuple):
    """Per sensor the onset with the largest statistic: statistic, size, b (..., N) and the index of the onset (..., N)."""

    statistic: Array
    size: Array
    information: Array
    onset: Array


def empty(batch: tuple[int, ...], lags: int, states: int, sensors: int) -> Window:
    """Return a window that has seen nothing."""
    sums = (*batch, lags, sensors)
    return Window(np.zeros((*batch, lags, states, sensors)), np.zeros(sums), np.zeros(sums))


def weigh(window: Window, tangent: Array, output_jacobian: Array, found: LeaveOneOut) -> Evidence:
    """Add the present innovations; tangent F (..., n, n) of the step just taken, H (..., N, n), all sensors in use."""
    eta = tangent[..., None, :, :] @ window.eta
    effect = np.eye(found.used.shape[-1]) - output_jacobian[..., None, :, :] @ eta
    a = window.a + (np.swapaxes(effect, -1, -2) @ found.whitened[..., None, :, None])[..., 0]
    b = window.b + np.sum(effect * (found.inverse[..., None, :, :] @ effect), axis=-2)
    return Evidence(eta, effect, a, b)


def best_onset(evidence: Evidence, usable: Array, sensor_cov: Array) -> Best:
    """Maximise over the onsets, for the sensors in use (..., N); a statistic of 0 where nothing is known."""
    known = usable[..., None, :] & (evidence.b * sensor_cov > LEAST_INFORMATION)
    information = np.where(known, evidence.b, 1.0)
    size = np.where(known, evidence.a, 0.0) / information
    statistic = size**2 * information
    onset = np.argmax(statistic, axis=-2, keepdims=True)
    at = [np.take_along_axis(v, onset, axis=-2)[..., 0, :] for v in (statistic, size, information)]
    return Best(at[0], at[1], at[2], onset[..., 0, :])


def absorbed(evidence: Evidence, best: Best, sensor: Array) -> Array:
    """Return what a unit bias of `sensor` (...) since its best onset has moved the predicted state by (..., n)."""
    which = sensor[..., None]
    onset = np.take_along_axis(best.onset, which, axis=-1)[..., None, None]
    eta = np.take_along_axis(evidence.eta, onset, axis=-3)[..., 0, :, :]
    return np.take_along_axis(eta, which[..., None], axis=-1)[..., 0]


def advance(evidence: Evidence, gain: Array, found: LeaveOneOut, restart: Array) -> Window:
    """Return the window after the update with gain K (..., n, N): every onset one step older, the present one added.

    restart (...): forget, since the readings in use have changed.
    """
    older = evidence.eta + gain[..., None, :, :] @ evidence.effect
    eta = np.concatenate([gain[..., None, :, :], older[..., :-1, :, :]], axis=-3)
    a = np.concatenate([found.whitened[..., None, :], evidence.a[..., :-1, :]], axis=-2)
    b = np.concatenate([found.weight[..., None, :], evidence.b[..., :-1, :]], axis=-2)
    if not np.any(restart):
        return Window(eta, a, b)
    keep = ~restart[..., None, None]
    return Window(eta * keep[..., None], a * keep, b * keep)
