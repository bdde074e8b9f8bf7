"""The step of consensus.py in arrays over all areas, without a loop over them: what the compiled one is compared with."""

from __future__ import annotations

from typing import Any

import numpy as np

from fusion_sfdia.detectors.stochastic_thresholds import consensus_equations as equations
from fusion_sfdia.detectors.stochastic_thresholds.consensus import Diagnosers, Prediction
from fusion_sfdia.detectors.stochastic_thresholds.consensus_equations import UNKNOWN
from fusion_sfdia.plant.areas import Areas
from fusion_sfdia.plant.plant import Array


def predict(areas: Areas, now: Diagnosers, reference: Array, load: Array, lam: float, mode: str) -> Prediction:
    """Estimates and deviations for the next readings, under reference and load (B, N)."""
    at, F, closed = areas.network.topology, areas.matrices, areas.network.closed
    n, a = F.shape[1], F[:, 0, 0]
    read, read_shared = (
        equations.noise_read(areas.noise, now.error_bound),
        equations.noise_read(areas.shared_noise, now.error_bound_shared),
    )

    def around(values: Array) -> Array:
        """Sums (B, N) over the closed sides of each area."""
        total: Array = np.add.reduceat(np.where(closed, values, 0.0), at.start[:-1], axis=-1)
        return total

    inflow = around(areas.slope * now.held_shared)
    inflow_variance = around(areas.slope**2 * read_shared)
    inflow_bound = around(np.abs(areas.slope) * now.error_bound_shared)

    def row(r: int, first: int) -> tuple[Array, Array, Array]:
        """Row r of the model without the states before `first`: its value, variance and error_bound (B, N)."""
        value = F[:, r, n] * reference + F[:, r, n + 1] * (inflow - load)
        variance, error_bound = F[:, r, n + 1] ** 2 * inflow_variance, np.abs(F[:, r, n + 1]) * inflow_bound
        for c in range(first, n):
            value = value + F[:, r, c] * now.held[..., c]
            variance = variance + F[:, r, c] ** 2 * read[..., c]
            error_bound = error_bound + np.abs(F[:, r, c]) * now.error_bound[..., c]
        return value, variance, error_bound

    estimate, deviation, error_bound = np.empty_like(now.held), np.empty_like(now.held), np.empty_like(now.held)
    for r in range(1, n):
        value, variance, estimate_bound = row(r, 0)
        memory, process = lam * now.deviation[..., r], areas.process_variance[:, r]
        estimate[..., r] = equations.private_term(value, now.residual[..., r], lam)
        deviation[..., r] = equations.residual_deviation(memory, variance, process, areas.noise[:, r], estimate_bound)
        error_bound[..., r] = equations.error_deviation(memory, variance, process, estimate_bound)

    drive, drive_variance, drive_bound = row(0, 1)
    process = areas.process_variance[:, 0]
    own = (
        now.held[..., 0],
        now.residual[..., 0],
        areas.noise[:, 0],
        now.error_bound[..., 0],
        read[..., 0],
        now.deviation[..., 0],
    )
    there = areas.opposite  # the copies of an area's first state at its neighbours
    others = (
        now.held_shared[..., there], now.residual_shared[..., there], areas.shared_noise[there],
        now.error_bound_shared[..., there], read_shared[..., there], now.deviation_shared[..., there],
    )  # fmt: skip

    def per_side(of_area: Array) -> Array:
        return np.take(of_area, at.node, axis=-1)

    def shared(function: Any) -> tuple[Array, Array]:
        """A function of what an area and its neighbours have of its first state: the area's (B, N), theirs (B, 2E)."""
        mine = a, drive, drive_variance, process
        return function(*own, *mine), function(*others, *(per_side(m) for m in mine))

    if mode == "paper":
        weigh = shared(lambda h, e, v, d, r, s, a, drive, dv, q: equations.precision_printed(v, d, a, dv, q))
    else:
        weigh = shared(lambda h, e, v, d, r, s, a, drive, dv, q: equations.precision_read(v, d))
    total = weigh[0] + around(weigh[1])
    W = weigh[0] / total, weigh[1] / per_side(total)  # (17)

    def consensus(function: Any, power: int = 1) -> Array:
        """sum_j W_j^power function_j (B, N) over all who share an area's first state."""
        mine, theirs = shared(function)
        summed: Array = W[0] ** power * mine + around(W[1] ** power * theirs)
        return summed

    agreed = consensus(lambda h, e, v, d, r, s, a, drive, dv, q: equations.shared_term(h, drive, e, a, lam))
    memory = lam * consensus(lambda h, e, v, d, r, s, a, drive, dv, q: s)
    variance = a**2 * consensus(lambda h, e, v, d, r, s, a, drive, dv, q: r, 2) + drive_variance
    estimate_bound = np.abs(a) * consensus(lambda h, e, v, d, r, s, a, drive, dv, q: d) + drive_bound
    estimate[..., 0] = agreed
    error_bound[..., 0] = equations.error_deviation(memory, variance, process, estimate_bound)
    if mode == "paper":
        printed = consensus(lambda h, e, v, d, r, s, a, drive, dv, q: equations.printed_variance(v, d, a, dv, q), 2)
        deviation[..., 0] = memory + np.sqrt(printed) + estimate_bound
        deviation_shared = np.take(deviation[..., 0], at.neighbour, axis=-1)
    else:
        deviation[..., 0] = equations.residual_deviation(memory, variance, process, areas.noise[:, 0], estimate_bound)
        memory, variance, process, estimate_bound = (
            np.take(x, at.neighbour, axis=-1) for x in (memory, variance, process, estimate_bound)
        )
        deviation_shared = equations.residual_deviation(memory, variance, process, areas.shared_noise, estimate_bound)

    def at_sides(of_area: Array, where_open: Array | float) -> Array:
        return np.where(closed, of_area, where_open)

    return Prediction(
        estimate,
        at_sides(np.take(agreed, at.neighbour, axis=-1), now.held_shared),
        deviation,
        at_sides(deviation_shared, UNKNOWN),
        np.minimum(error_bound, UNKNOWN),
        np.minimum(at_sides(np.take(error_bound[..., 0], at.neighbour, axis=-1), UNKNOWN), UNKNOWN),
        now.covariance,
    )


def take(predicted: Prediction, own: Array, shared: Array) -> Diagnosers:
    """The diagnosers after the readings own (B, N, n) and shared (B, 2E); NaN where missing or not to be used."""
    kept = []
    for y, estimate, deviation, error_bound in zip((own, shared), predicted[:2], predicted[2:4], predicted[4:6], strict=True):
        read = np.isfinite(y)
        known = read & (deviation < UNKNOWN**0.5)  # a copy that knew nothing starts here, its residual 0
        kept.append(
            (
                np.where(read, y, estimate),
                np.where(read, 0.0, error_bound),
                np.where(known, y - estimate, 0.0),
                np.where(known, deviation, 0.0),
            )
        )
    return Diagnosers(*(x for pair in zip(*kept, strict=True) for x in pair), predicted.covariance)
