"""A chain of four areas of three states, some of which are not read, and its runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from fusion_sfdia.detectors.stochastic_thresholds.consensus import Diagnosers, Prediction, initial_state, predict, take
from fusion_sfdia.plant.areas import Areas
from fusion_sfdia.plant.network import Network, Topology
from fusion_sfdia.plant.plant import Array

TOPOLOGY = Topology.joined(["a", "b", "c", "d"], [("a", "b"), ("b", "c"), ("c", "d")])
AB, BA, BC, CB, CD, DC = range(6)  # sides: AB is where a reads the first state of b


class Step(NamedTuple):
    """x (B, 4, 3), and the diagnosers' prediction of the readings own, shared and their memory afterwards."""

    x: Array
    ahead: Prediction
    own: Array
    shared: Array
    now: Diagnosers


def chain_areas(unread: Sequence[tuple[int, int]] = (), received: Sequence[int] = (), seed: int = 0) -> Areas:
    """unread: pairs of area and state without a sensor. received: sides without one."""
    rng = np.random.default_rng(seed)
    F = rng.standard_normal((4, 3, 3))
    F *= 0.8 / np.abs(np.linalg.eigvals(F)).max(axis=-1)[:, None, None]
    matrices = np.concatenate([F, rng.standard_normal((4, 3, 2)) * [1.0, 0.5]], axis=-1)
    noise, shared_noise = rng.uniform(0.2, 2.0, (4, 3)), rng.uniform(0.2, 2.0, 6)
    for at in unread:
        noise[at] = np.inf
    shared_noise[list(received)] = np.inf
    names = tuple(tuple(f"{area}{k}" for k in range(3)) for area in TOPOLOGY.names)
    slope, process = rng.uniform(-0.3, 0.3, 6), rng.uniform(0.1, 1.0, (4, 3))
    owners = tuple(f"area {area}" for area in TOPOLOGY.names)
    shared_gain = matrices[TOPOLOGY.neighbour, 0, 0]
    return Areas(Network.of(TOPOLOGY), names, owners, matrices, slope, shared_gain, process, noise, shared_noise)


def chain_runs(
    areas: Areas, runs: int, steps: int, lam: float = 0.0, *, noise: float = 1.0, fault: Array | None = None,
    missing: Callable[[int, Array, Array], None] = lambda k, own, shared: None,
    draw: Callable[[np.random.Generator, tuple[int, ...]], Array] = lambda rng, shape: rng.standard_normal(shape),
    known: bool = True,
) -> Iterator[Step]:  # fmt: skip
    """Healthy runs from x = 0, which the diagnosers know if `known`, or with `fault` (4, 3) added to the states in each step.

    noise: factor of all noise. missing(k, own, shared) sets readings of step k to NaN. draw: numbers of variance 1.
    """
    rng, at = np.random.default_rng(1), TOPOLOGY
    now, x = initial_state(areas, (runs,)), np.zeros((runs, 4, 3))
    if known:
        now.covariance[...], now.error_bound[...], now.error_bound_shared[...] = 0.0, 0.0, 0.0
    sigma, sigma_shared = (noise * np.sqrt(np.where(np.isinf(v), 0.0, v)) for v in (areas.noise, areas.shared_noise))
    for k in range(steps):
        reference, load = rng.standard_normal((2, runs, 4))
        inflow = np.zeros((runs, 4))
        for s in range(6):
            inflow[:, at.node[s]] += areas.slope[s] * x[:, at.neighbour[s], 0]
        given = np.concatenate([x, reference[..., None], (inflow - load)[..., None]], axis=-1)
        x = np.einsum("irc,bic->bir", areas.matrices, given) + noise * np.sqrt(areas.process_variance) * draw(rng, x.shape)
        x = x if fault is None else x + fault
        own = np.where(areas.unread, np.nan, x + sigma * draw(rng, x.shape))
        shared = np.where(areas.received, np.nan, x[:, at.neighbour, 0] + sigma_shared * draw(rng, (runs, 6)))
        missing(k, own, shared)
        ahead = predict(areas, now, reference, load, lam, "corrected")
        now = take(areas, ahead, own, shared)
        yield Step(x, ahead, own, shared, now)
