"""Shared by the scenarios on residuals of the power network: noise distributions, normalised residuals of runs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.stochastic_thresholds.consensus import Diagnosers, NetworkReadings, initial_state
from fusion_sfdia.detectors.stochastic_thresholds.network_step import network_step, terms_of
from fusion_sfdia.models.power_network.diagnosis import network_areas
from fusion_sfdia.models.power_network.model import NetworkModel
from fusion_sfdia.models.power_network.simulation import Draw, NetworkSample
from fusion_sfdia.plant.areas import Areas

Array = NDArray[Any]

B18 = "Boem 2018"
SETTLE = 10  # s that are not evaluated: lam^10 of the start is left, 6e-6 for lam = 0.3
STUDENT_FREEDOM = 3  # the heaviest whole number with finite variance


class Variant(NamedTuple):
    """Diagnosers by their filter parameter and mode of `consensus`; name: as `list detectors` has it, or that mode of it."""

    name: str
    lam: float
    mode: str


PAPER = Variant("chebyshev:paper", 0.3, "paper")
CORRECTED = Variant("chebyshev:corrected", 0.3, "corrected")
MEMORYLESS = Variant("chebyshev", 0.0, "corrected")
VARIANTS = (PAPER, CORRECTED, MEMORYLESS)


def student(rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """Student t of variance 1: of three degrees of freedom, over the root of its variance."""
    drawn: Array = rng.standard_t(STUDENT_FREEDOM, shape) / np.sqrt(STUDENT_FREEDOM / (STUDENT_FREEDOM - 2))
    return drawn


def three_points(rng: np.random.Generator, shape: tuple[int, ...], size: float) -> Array:
    """-size, 0 or size, of variance 1: +-size with probability 1 / size^2, for which Chebyshev's inequality is an equality."""
    u = rng.random(shape)
    p = 0.5 / size**2
    drawn: Array = np.where(u < p, -size, np.where(u < 2 * p, size, 0.0))
    return drawn


def draw_of(law: str) -> Draw:
    """The standardised draws of "gaussian", "student-t" or "three-point SIZE"; ValueError for another law."""
    kind, _, size = law.partition(" ")
    if kind == "three-point" and size:
        return partial(three_points, size=float(size))
    known: Mapping[str, Draw] = {"gaussian": lambda rng, shape: rng.standard_normal(shape), "student-t": student}
    if law not in known:
        raise ValueError(f"unknown law {law!r}; known: {', '.join(known)}, three-point SIZE")
    return known[law]


def diagnosed(areas: Areas, moments: Iterable[NetworkSample], variant: Variant) -> Iterator[tuple[NetworkSample, Diagnosers]]:
    """Each sample of the runs of a network, with its diagnosers after the readings of that sample."""
    state, terms = None, terms_of(areas.arrays, variant.mode)
    for now in moments:
        if state is None:
            state = initial_state(areas, now.reference.shape[:1])
        load = np.broadcast_to(now.load, now.reference.shape)
        given = NetworkReadings(now.own, now.shared, now.reference, load)
        state, _ = network_step(areas, state, given, 1.0, variant.lam, variant.mode, terms=terms)
        yield now, state


def normalised(state: Diagnosers) -> Array:
    """Residuals over deviations (B, 4N + 2E) in the order of the plant's sensors, NaN for components that are not evaluated."""
    residual, deviation = (
        np.concatenate([own.reshape(*own.shape[:-2], -1), shared], axis=-1)
        for own, shared in ((state.residual, state.residual_shared), (state.deviation, state.deviation_shared))
    )
    z: Array = np.divide(residual, deviation, out=np.full(residual.shape, np.nan), where=deviation > 0)
    return z


def streams(model: NetworkModel, moments: Iterable[NetworkSample], variants: Iterable[Variant]) -> dict[str, Array]:
    """Normalised residuals (K, B, 4N + 2E) by variant of the same runs, without the first SETTLE samples."""
    areas, recorded = network_areas(model, named=False), list(moments)
    return {v.name: np.stack([normalised(s) for _, s in diagnosed(areas, recorded, v)])[SETTLE:] for v in variants}


def owners(model: NetworkModel) -> Array:
    """(4N + 2E,): the area whose diagnoser evaluates each component."""
    return np.concatenate([np.repeat(np.arange(len(model.names)), 4), model.network.topology.node])


def groups(model: NetworkModel) -> dict[str, Array]:
    """Components by quantity, the angle by how many areas share it: {"theta, 2 sharers": (4N + 2E,) truth values, ...}."""
    at, n = model.network.topology, len(model.names)
    sharers = 1 + np.bincount(at.node[model.network.closed], minlength=n)
    state = np.concatenate([np.tile(np.arange(4), n), np.zeros(at.node.size, int)])
    who = np.concatenate([np.repeat(sharers, 4), sharers[at.neighbour]])
    angles = {f"theta, {k} sharers": (state == 0) & (who == k) for k in np.unique(sharers)}
    return angles | {name: state == c for c, name in enumerate(("theta", "omega", "p_m", "p_v")) if c}
