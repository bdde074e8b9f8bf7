"""Whether areas that read only some of their states can estimate the others (ours: Boem et al. 2018 read all states, (4)).

With the gain K with which Sigma of consensus_equations settles, the errors of unread states follow, without noise,

    eps_i+ = (1 - K_i C_i) (F_i eps_i + g_i sum_j P_ij z_err_j)

z_err_j is the error of what area i holds of z_j: 0 where it reads z_j or receives a reading of it. Errors decay where all
eigenvalues of this matrix over all unread states are below 1 in magnitude. An area alone has such a gain where it is
detectable: its readings show every mode of F_i that does not decay.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.stochastic_thresholds.consensus import Diagnosers, after_readings, initial_state
from fusion_sfdia.plant.areas import Areas

Array = NDArray[Any]

MOST_STEPS = 1000
SETTLED = 1e-10  # largest relative change of a variance in a step
DECAYS = 1 - 1e-6  # errors that decay by less in a step do not decay in any run


def require_estimable(areas: Areas) -> float:
    """Return the factor by which errors of unread states decay in a step, 0 without such states.

    ValueError where they do not decay in a plugged-in area, as its readings do not show them, or in the network, by values of
    neighbours that are estimates themselves.
    """
    if not areas.partly_read:
        return 0.0
    now, grows = settle(areas)
    at, plugged = areas.network.topology, areas.network.plugged
    whole, unread = error_matrix(areas, now), areas.unread.ravel()
    for i in np.flatnonzero(plugged & np.any(areas.unread, axis=1)).tolist():
        own = np.arange(i * areas.size[1], (i + 1) * areas.size[1])
        if not (radius := _radius(whole, own[areas.unread[i]])) < DECAYS:
            names, read = (
                [areas.state_name(i, c) for c in np.flatnonzero(a).tolist()] for a in (areas.unread[i], ~areas.unread[i])
            )
            raise ValueError(
                f"area {at.names[i]!r}: errors of estimates of {', '.join(names)} do not decay (factor {radius:.6g} a step) "
                f"with readings of {', '.join(read) or 'no state'}; expected a factor below 1: add a sensor of "
                f"{' or '.join(names)}"
            )
    radius = _radius(whole, np.flatnonzero(unread & np.repeat(plugged, areas.size[1])))
    if not radius < DECAYS or np.any(grows & plugged):
        raise ValueError(
            f"errors of unread states, or their bounds, grow in the network (factor {radius:.6g} a step), though they decay in "
            "each area: areas without a sensor of a neighbour's first state receive estimates of it; expected sensors of more "
            f"first states, here none of {areas.unread_names}"
        )
    return radius


def settle(areas: Areas) -> tuple[Diagnosers, Array]:
    """Return the diagnosers (1, ...) after many readings of all sensors, and where Sigma still grows (N,) bool.

    It grows where it has not settled after MOST_STEPS, and its changes do not become smaller.
    """
    now, change = initial_state(areas, (1,)), np.full(areas.noise.shape, np.inf)
    for _ in range(MOST_STEPS):
        after = after_readings(areas, now)
        variance, last = (np.diagonal(a.covariance[0], axis1=-2, axis2=-1) for a in (after, now))
        now, before, change = after, change, np.abs(variance - last)
        settled = change <= SETTLED * variance
        if np.all(settled):
            break
    return now, np.any(~settled & (change >= DECAYS * before), axis=-1)


def error_matrix(areas: Areas, now: Diagnosers) -> Array:
    """The matrix (N n, N n) of the errors of all states in a step, 0 of read ones; now: as of `settle`."""
    count, n, _ = areas.size
    at, network, Sigma = areas.network.topology, areas.network, now.covariance[0]
    whole = np.zeros((count, n, count, n))
    for i in np.flatnonzero(np.any(areas.unread, axis=1)).tolist():
        sides, read = network.sides(i), ~areas.unread[i]
        copies = areas.opposite[sides]
        precision = 1 / np.array([Sigma[i, 0, 0], *areas.shared_noise[copies]])  # 0 of a copy without a sensor
        F = areas.matrices[i, :, :n].copy()
        F[0, 0] *= precision[0] / np.sum(precision)  # (17)
        kept = np.diag(~read) - np.where(~read[:, None] & read, Sigma[i], 0.0) / areas.noise[i]  # K is Sigma_ur / R
        whole[i, :, i] = kept @ F
        for s in sides[areas.received[sides]]:
            whole[i, :, at.neighbour[s], 0] += kept @ areas.matrices[i, :, n + 1] * areas.slope[s]
    whole[:, :, ~areas.unread] = 0.0
    return whole.reshape(count * n, count * n)


def _radius(matrix: Array, some: Array) -> float:
    return float(np.max(np.abs(np.linalg.eigvals(matrix[np.ix_(some, some)])), initial=0.0))
