"""network/consensus: variance of the residuals of shared angles with and without consensus (B18, (6), (15)-(17))."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.benchmarks.network.support.consensus_figures import (
    ALONE,
    COPIES,
    READINGS,
    WEIGHTS,
    SharedCopies,
    Variance,
    parts_figure,
    ratio_figure,
    remarks,
    table,
    unequal_figure,
)
from fusion_sfdia.benchmarks.network.support.residuals import B18, PAPER, SETTLE, Variant, diagnosed
from fusion_sfdia.benchmarks.network.support.rows import detector_name, row
from fusion_sfdia.common.run_statistics import NOTHING, Estimate, mean_over_runs
from fusion_sfdia.detectors.stochastic_thresholds.consensus_equations import precision_printed, precision_read, shared_term
from fusion_sfdia.models.power_network.diagnosis import network_areas
from fusion_sfdia.models.power_network.model import PROCESS_VARIANCE, network_model
from fusion_sfdia.models.power_network.operation import load_profile
from fusion_sfdia.models.power_network.parameters import load_steps
from fusion_sfdia.models.power_network.simulation import NetworkSample, run_network
from fusion_sfdia.plant.areas import Areas
from fusion_sfdia.report.content import Summary
from fusion_sfdia.report.results import Published, Row
from fusion_sfdia.study.experiments.scenario import Arrays, Scenario, Settings, Task, seed_blocks

Array = NDArray[Any]

NAME = "network/consensus"
CHUNK = 50  # runs in one task
MEMORIES = (0.0, PAPER.lam)


def consensus_tasks(settings: Settings, seeds: int) -> list[Task]:
    """Healthy runs by process noise; neighbours read an angle as precisely as its area, or less precisely."""
    if settings["worse"] <= 1:
        raise ValueError(
            f"worse is {settings['worse']:g}; expected more than 1: the variance of a neighbour's reading over the area's"
        )
    ratio = {"equal": 1.0, "unequal": settings["worse"]}
    return [
        {"noise": noise, "readings": kind, "worse": ratio[kind], "steps": settings["steps"], "seeds": block}
        for noise in PROCESS_VARIANCE
        for kind in READINGS
        for block in seed_blocks(seeds, CHUNK)
    ]


def network(task: Task) -> Areas:
    """The areas whose neighbours' readings have `worse` times the variance."""
    areas = network_areas(network_model(noise=task["noise"]), named=False)
    return replace(areas, shared_noise=task["worse"] * areas.shared_noise)


def consensus_work(task: Task) -> Arrays:
    """Sums over time of the squared residuals of all copies of the angles (B, N + 2E), by weights and memory."""
    areas = network(task)
    model = network_model(noise=task["noise"])
    loads = load_profile(model, load_steps("1"))
    moments = [worsened(m, areas, task["worse"]) for m in run_network(model, task["steps"], task["seeds"], loads=loads)]
    found: Arrays = {}
    for lam in MEMORIES:
        found[f"{ALONE} {lam:g}"] = _sum_of_squares(alone(areas, moments, lam))
        for weights in WEIGHTS:
            states = (s for _, s in diagnosed(areas, moments, Variant(weights, lam, weights)))
            found[f"{weights} {lam:g}"] = _sum_of_squares(
                np.concatenate([s.residual[..., 0], s.residual_shared], axis=-1) for s in states
            )
    return found


def worsened(now: NetworkSample, areas: Areas, ratio: float) -> NetworkSample:
    """The sample with the noise of the neighbours' readings multiplied by the root of the ratio of variances."""
    truth = now.x[..., areas.network.topology.neighbour, 0]
    return now._replace(shared=truth + np.sqrt(ratio) * (now.shared - truth))


def alone(areas: Areas, moments: Iterable[NetworkSample], lam: float) -> Iterable[Array]:
    """Residuals (B, N + 2E) of the copies of the angles where each area that shares one uses its own reading alone, W_ii = 1.

    The drive still comes from the area whose angle it is.
    """
    at, F = areas.network.topology, areas.matrices
    whose = np.concatenate([np.arange(len(at.names)), at.neighbour])
    a, n = F[whose, 0, 0], F.shape[1]

    def angles(now: NetworkSample) -> Array:
        return np.concatenate([now.own[..., 0], now.shared], axis=-1)

    residual = None
    for last, now in pairwise(moments):
        if residual is None:
            residual = np.zeros_like(angles(last))
            yield residual
        inflow = np.add.reduceat(areas.slope * last.shared, at.start[:-1], axis=-1)
        drive = np.einsum("nc,bnc->bn", F[:, 0, 1:n], last.own[..., 1:])
        drive += F[:, 0, n] * now.reference + F[:, 0, n + 1] * (inflow - now.load)
        residual = angles(now) - shared_term(angles(last), drive[..., whose], residual, a, lam)
        yield residual


def _sum_of_squares(residuals: Iterable[Array]) -> Array:
    total: Array = np.sum([e**2 for e in list(residuals)[SETTLE:]], axis=0)
    return total


def theory(areas: Areas, weights: str, lam: float) -> dict[str, Array]:
    """Parts of the variance of each copy's residual (N + 2E,) in the steady state: "process", "drive", "readings", "own".

    With e_bar = sum_j W_j e_j, r_bar = sum_j W_j r_j and delta the drive's error, consensus_equations gives
    e_bar+ = lam e_bar - a r_bar + delta + w + r_bar+, and e_i+ the same with r_i+ for r_bar+. So
    Var e_i = (Var delta + Var w + (a - lam)^2 Var r_bar) / (1 - lam^2) + sigma_i^2; alone, r_bar is r_i.
    """
    at, F = areas.network.topology, areas.matrices
    whose = np.concatenate([np.arange(len(at.names)), at.neighbour])
    noise, drive = np.concatenate([areas.noise[:, 0], areas.shared_noise]), drive_variance(areas)
    a, q = F[:, 0, 0], areas.process_variance[:, 0]
    W = agreement(areas, weights)
    agreed = noise if weights == ALONE else np.bincount(whose, W**2 * noise)[whose]
    kept = 1 - lam**2
    return {
        "process": q[whose] / kept,
        "drive": drive[whose] / kept,
        "readings": (a[whose] - lam) ** 2 * agreed / kept,
        "own": noise,
    }


def drive_variance(areas: Areas) -> Array:
    """(N,) of the error of each area's drive, due to its readings of its other states and of its neighbours' angles."""
    F, n = areas.matrices, areas.size[1]
    inflow = np.add.reduceat(areas.slope**2 * areas.shared_noise, areas.network.topology.start[:-1])
    variance: Array = np.sum(F[:, 0, 1:n] ** 2 * areas.noise[:, 1:], axis=-1) + F[:, 0, n + 1] ** 2 * inflow
    return variance


def agreement(areas: Areas, weights: str) -> Array:
    """W (17) of each copy of an angle (N + 2E,) in the consensus of its sharers, 0 at open ties; 1 alone."""
    at = areas.network.topology
    whose = np.concatenate([np.arange(len(at.names)), at.neighbour])
    counted = np.concatenate([np.ones(len(at.names), bool), areas.network.closed])
    noise = np.concatenate([areas.noise[:, 0], areas.shared_noise])
    if weights == ALONE:
        return counted.astype(float)
    a, q = areas.matrices[whose, 0, 0], areas.process_variance[whose, 0]
    precise = (
        precision_read(noise, 0.0)
        if weights == "corrected"
        else precision_printed(noise, 0.0, a, drive_variance(areas)[whose], q)
    )
    precise = np.where(counted, precise, 0.0)
    W: Array = precise / np.bincount(whose, precise)[whose]
    return W


def copies(areas: Areas) -> dict[tuple[int, str], Array]:
    """Copies (N + 2E,) by how many areas share the angle and which reads it: {(2, "its area"): truth values, ...}."""
    at = areas.network.topology
    sharers = 1 + np.diff(at.start)
    who = np.concatenate([sharers, sharers[at.neighbour]])
    own = np.arange(who.size) < sharers.size
    return {(int(k), name): (who == k) & (own == (name == COPIES[0])) for k in np.unique(who) for name in COPIES}


def parts_of(areas: Areas, lam: float) -> dict[int, dict[str, dict[str, float]]]:
    """By number of sharers, weights and part: the mean over the areas' own copies."""
    return {
        sharers: {w: {part: float(v[mask].mean()) for part, v in theory(areas, w, lam).items()} for w in (ALONE, "corrected")}
        for (sharers, copy), mask in copies(areas).items()
        if copy == COPIES[0]
    }


def consensus_summary(settings: Settings, results: list[tuple[Task, Arrays]]) -> Summary:
    """Variances with and without consensus, measured and by theory."""
    cells: dict[tuple[str, str], list[tuple[Task, Arrays]]] = {}
    for task, arrays in results:
        cells.setdefault((task["noise"], task["readings"]), []).append((task, arrays))
    rows: dict[Variance, Row] = {}

    def add(key: Variance, estimate: Estimate, stated: Published | None = None) -> None:
        detector = detector_name("corrected" if key.of.weights == ALONE else key.of.weights)
        rows[key] = row(NAME, detector, "none", key.quantity, key.metric, estimate, stated, condition=key.condition)

    for (noise, kind), parts in cells.items():
        task = parts[0][0]
        areas = network(task)
        samples = task["steps"] + 1 - SETTLE
        for lam in MEMORIES:
            square = {w: np.concatenate([a[f"{w} {lam:g}"] for _, a in parts]) / samples for w in (ALONE, *WEIGHTS)}
            for (sharers, copy), mask in copies(areas).items():
                single = _mean(theory(areas, ALONE, lam), mask)
                for weights in square:
                    case = SharedCopies(noise, kind, lam, sharers, copy, weights)
                    runs = square[weights][:, mask].mean(axis=-1)
                    add(Variance("residual_variance", case), mean_over_runs(runs, np.ones_like(runs)))
                    expected = _mean(theory(areas, weights, lam), mask)
                    add(Variance("residual_variance_theory", case), _exactly(expected))
                    if weights != ALONE:
                        ratio = mean_over_runs(runs, square[ALONE][:, mask].mean(axis=-1))
                        stated = Published(1 / sharers, f"{B18}, (15) and (17) for equal variances: 1 / sharers")
                        claimed = stated if kind == "equal" and weights == "paper" else None
                        add(Variance("residual_variance_ratio", case), ratio, claimed)
                        add(Variance("residual_variance_ratio_theory", case), _exactly(expected / single))
    kinds = {
        (noise, lam): parts_of(network(found[0][0]), lam)
        for (noise, kind), found in cells.items()
        if kind == "equal"
        for lam in MEMORIES
    }
    figures = [ratio_figure(rows), parts_figure(kinds), unequal_figure(rows)]
    sentences = remarks(rows)
    return Summary(list(rows.values()), figures, [table(rows)], sentences[:1], sentences[1:])


def _mean(parts: dict[str, Array], mask: Array) -> float:
    return float(np.sum(list(parts.values()), axis=0)[mask].mean())


def _exactly(value: float) -> Estimate:
    return NOTHING._replace(value=value)


SCENARIO = Scenario(
    name=NAME,
    title="Variance reduction by consensus on shared angles",
    about="Healthy runs of the power network: the variance of the angles' residuals where all areas that share an angle agree "
    "on its estimate, by weights (17) as printed and corrected, and where each uses its own reading alone; compared with "
    "(15) and with theory. Neighbours read an angle as precisely as its area, or less precisely.",
    settings={"steps": 200, "worse": 16.0},
    seeds=50,
    full_seeds=500,
    tasks=consensus_tasks,
    work=consensus_work,
    summarise=consensus_summary,
    bounds={"steps": (SETTLE + 1, 1e6)},
    papers=("boem2018",),
)
