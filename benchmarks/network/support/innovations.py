"""Innovations of one steady-state Kalman filter on the whole power network: the reference for local residuals."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

from fusion_sfdia.models.power_network.model import NOISE_VARIANCE, NetworkModel
from fusion_sfdia.models.power_network.simulation import NetworkSample

Array = NDArray[Any]


class Innovations(NamedTuple):
    """values (K, B, M) of the M sensors that are read, their covariance (M, M), and which of the plant's 4N + 2E these are."""

    values: Array
    covariance: Array
    sensors: Array


def innovations(model: NetworkModel, moments: Iterable[NetworkSample]) -> Innovations:
    """Y - H x_hat with the gain of the steady state, from x = 0; sensors at open ties are left out.

    P = F P F' - F P H' S^-1 H P F' + Q, S = H P H' + R, x_hat+ = F (x_hat + P H' S^-1 (y - H x_hat)) + B u.
    """
    F, by_reference, by_load = model.matrices
    n = len(model.names)
    sensors = np.flatnonzero(np.concatenate([np.ones(4 * n, bool), model.network.closed]))
    picks = np.concatenate([np.arange(4 * n), 4 * model.network.topology.neighbour])[sensors]
    H = np.eye(4 * n)[picks]
    noise = np.tile(NOISE_VARIANCE, n)
    R, Q = np.diag(noise[picks]), np.diag(np.tile(model.process_cov, n))
    P = solve_discrete_are(F.T, H.T, Q, R)
    S = H @ P @ H.T + R
    gain = np.linalg.solve(S, H @ P).T
    x, values = np.zeros((1, 4 * n)), []
    for k, now in enumerate(moments):
        if k:
            x = x @ F.T + now.reference @ by_reference.T + np.asarray(now.load) @ by_load.T
        values.append(now.y[:, sensors] - x[:, picks])
        x = x + values[-1] @ gain.T
    return Innovations(np.stack(values), S, sensors)


def chi_square(found: Innovations, chosen: Array) -> Array:
    """V' S^-1 v (K, B) of the innovations of some of the plant's sensors, truth values (4N + 2E,)."""
    which = np.flatnonzero(chosen[found.sensors])
    v, S = found.values[..., which], found.covariance[np.ix_(which, which)]
    total: Array = np.einsum("kbi,kbi->kb", v, np.linalg.solve(S, v[..., None])[..., 0])
    return total


def standardised(found: Innovations, chosen: Array) -> Array:
    """Innovations over their standard deviations (K, B, m), of some of the plant's sensors."""
    which = np.flatnonzero(chosen[found.sensors])
    z: Array = found.values[..., which] / np.sqrt(np.diagonal(found.covariance)[which])
    return z
