"""Areas whose sensors read only some of their states: the gain of their observers, and whether it can exist.

Boem et al. 2018 ("B18") read all states of an area, (4), and give no gain. Here K is by default the gain with which the recursion
of M and Sigma in consensus_equations settles when each step takes the Kalman gain of the unread states,

    K = M_ur (M_rr + R)^-1

u the unread states, r those that the area reads, when no reading is missing. Read states keep their readings, as in (5), so that
this is the best gain among estimates that do so, not the Kalman filter of the area. The errors of the network without noise are

    eps_i+ = (1 - K_i C_i) (F_i eps_i + g_i sum_j P_ij z_err_j)

with z_err_j = 0 where area i reads z_j or receives its reading. They decay where the largest magnitude of an eigenvalue of this
matrix over all unread states is below 1, and the residuals' memory where lam is: Proposition 2 here, `spectral_radius`. An area for
itself has such a gain where each mode of F_i that does not decay is visible in its readings (it is detectable).

(29) to (33) hold as printed for a fault's effect E on a residual if E is that of the observer, as `detectable` takes it from
readings without noise: E(t) = lam E(t-1) + phi(t-1) only where all states are read.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.areas import Areas
from fusion_sfdia.stochastic_thresholds.consensus import Diagnosers, initial_state, predict, take

Array = NDArray[Any]

MOST_STEPS = 1000
MOST_ROUNDED = 100 * np.finfo(float).eps
SETTLED = 1e-10  # largest change of a gain in a step over the largest gain
DECAYS = 1 - 1e-6  # errors that decay by less in a step do not decay in any run


def estimable(areas: Areas) -> Areas:
    """Return the areas with the gain K, (N, n, n), unless they have one.

    ValueError where errors of unread states of a plugged-in area do not decay: for no gain, as its readings do not show them, or
    for the one given; and where they do not in the network, through first states that neither area reads.
    """
    if not areas.partly_read:
        return areas
    found = areas if areas.gain is not None else replace(areas, gain=np.zeros((*areas.noise.shape, areas.noise.shape[1])))
    now, grows = settle(found, choose=areas.gain is None)
    network, count = areas.network, areas.size[0]
    F = error_matrix(found, now)
    places = np.flatnonzero(areas.unread)
    owner = places // areas.size[1]
    for i in range(count):
        own = owner == i
        if network.plugged[i] and not (radius := _radius(F[np.ix_(own, own)])) < DECAYS:
            names, read = ([areas.state_name(i, c) for c in np.flatnonzero(which)] for which in (areas.unread[i], ~areas.unread[i]))
            raise ValueError(
                f"area {network.topology.names[i]!r}: errors of the estimates of {', '.join(names)} do not decay (factor "
                f"{radius:.6g} a step) with readings of {', '.join(read) or 'no state'}; expected a factor below 1: add a sensor "
                f"of one of {', '.join(names)}" + ("" if areas.gain is None else ", or give another gain or None")
            )
    if not (radius := error_radius(found, now)) < DECAYS:
        raise ValueError(
            f"errors of unread states do not decay in the network (factor {radius:.6g} a step), though they do in each area: they "
            f"pass between areas that do not read each other's first states, {areas.unread_names}; expected a factor below 1: "
            "add sensors of first states"
        )
    if np.any(grows := grows & network.plugged):
        raise ValueError(
            f"the bound of the errors of unread states grows in {network.topology.shown(np.flatnonzero(grows))}, though the errors "
            f"decay (factor {radius:.6g} a step): it allows for any correlation of errors that pass between areas, "
            f"{areas.unread_names}; expected a bound that settles: add sensors of first states"
        )
    return found


def settle(areas: Areas, choose: bool = False) -> tuple[Diagnosers, Array]:
    """Return the diagnosers (1, ...) of a network whose readings have all been there for long, and where Sigma grows (N,).

    choose: write the gain of each step to areas.gain. Sigma grows where it has not settled after MOST_STEPS, and its changes do
    not become smaller.
    """
    count, n, sides = areas.size
    still = np.zeros((1, count))
    own, shared = np.where(areas.unread, np.nan, 0.0)[None], np.where(areas.unread_shared, np.nan, 0.0)[None]
    now = initial_state(areas, (1,))
    now.error_bound[...], now.error_bound_shared[...] = 0.0, 0.0
    now.covariance[...] = np.where(areas.unread, areas.process_variance, 0.0)[..., None] * np.eye(n)
    some = np.flatnonzero(np.any(areas.unread, axis=1))
    read = ~areas.unread[some]
    noise = np.where(read, areas.noise[some], 1.0)[:, None] * np.eye(n)
    conditioned = np.where(read, areas.noise[some], 1.0).min(axis=1) / MOST_ROUNDED  # beyond, S keeps nothing of R
    both = areas.unread[some][:, :, None] & read[:, None, :]
    assert areas.gain is not None
    change = np.full(count, np.inf)
    for _ in range(MOST_STEPS):
        ahead = predict(areas, now, still, still, 0.0, "corrected")
        before = now.covariance, areas.gain[some], change
        if choose:
            M = ahead.covariance[0, some]
            well = np.trace(M, axis1=1, axis2=2) < conditioned
            S = np.where(read[:, :, None] & read[:, None, :], M, 0.0)[well] + noise[well]
            areas.gain[some[well]] = np.linalg.solve(S, np.where(both, M, 0.0)[well].mT).mT
            areas.arrays("corrected").gain[some] = areas.gain[some]
        now = take(areas, ahead, own, shared)
        change = np.abs(now.covariance - before[0])[0].max(axis=(1, 2))
        settled = change <= SETTLED * np.abs(now.covariance[0]).max(axis=(1, 2))
        gains = np.abs(areas.gain[some] - before[1]).max(initial=0.0) <= SETTLED * np.abs(areas.gain[some]).max(initial=0.0)
        if gains and np.all(settled):
            break
    return now, ~settled & (change >= DECAYS * before[2])


def error_matrix(areas: Areas, now: Diagnosers) -> Array:
    """The matrix (U, U) of the errors of all U unread states in a step, in the order of the states; now: as of `settle`."""
    count, n, _ = areas.size
    at, closed = areas.network.topology, areas.network.closed
    assert areas.gain is not None
    F = areas.matrices[..., :n].copy()
    whole = np.zeros((count, n, count, n))
    for i in np.flatnonzero(np.any(areas.unread, axis=1)):
        copies = [areas.opposite[s] for s in areas.network.sides(i) if not areas.unread_shared[areas.opposite[s]]]
        precision = np.array([now.covariance[0, i, 0, 0] if areas.unread[i, 0] else areas.noise[i, 0], *areas.shared_noise[copies]])
        F[i, 0, 0] *= 1 / np.sum(precision[0] / precision)  # the weight (17) of the area's own value
        kept = np.eye(n) - np.where(areas.unread[i][:, None] & ~areas.unread[i], areas.gain[i], 0.0)
        whole[i, :, i] += kept @ F[i]
        for s in range(at.start[i], at.start[i + 1]):
            if closed[s] and areas.unread_shared[s]:
                whole[i, :, at.neighbour[s], 0] += kept @ areas.matrices[i, :, n + 1] * areas.slope[s]
    unread = areas.unread.ravel()
    return whole.reshape(count * n, count * n)[np.ix_(unread, unread)]


def error_radius(areas: Areas, now: Diagnosers) -> float:
    """The largest magnitude of an eigenvalue of `error_matrix` of the plugged-in areas: errors decay below 1."""
    there = np.repeat(areas.network.plugged, areas.unread.sum(axis=1))
    return _radius(error_matrix(areas, now)[np.ix_(there, there)])


def _radius(matrix: Array) -> float:
    return float(np.max(np.abs(np.linalg.eigvals(matrix)), initial=0.0)) if np.all(np.isfinite(matrix)) else np.inf
