"""network/false-alarms: claimed and measured false alarms, single and consecutive (B18, (12) to (15) and sec. VII-A)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from fusion_sfdia.benchmarks.network.support.claims import (
    AFTER,
    ALPHAS,
    B18_ALPHA,
    CONFIRMED,
    CONSECUTIVE,
    LEVELS,
    ONE_SHOCK,
    RULES_SHOWN,
    SINGLE,
    Counted,
    published_claim,
)
from fusion_sfdia.benchmarks.network.support.false_alarm_figures import (
    WHO,
    claims_figure,
    consecutive_figure,
    groups_figure,
    remarks,
    tables,
)
from fusion_sfdia.benchmarks.network.support.residuals import (
    CORRECTED,
    PAPER,
    SETTLE,
    VARIANTS,
    draw_of,
    groups,
    owners,
    streams,
    three_points,
)
from fusion_sfdia.benchmarks.network.support.rows import row
from fusion_sfdia.common.random_streams import stream
from fusion_sfdia.common.run_statistics import Estimate, proportion, rate_over_runs
from fusion_sfdia.detectors.stochastic_thresholds.threshold_rules import CONFORMAL, RULES, conformal_alpha
from fusion_sfdia.models.power_network.model import PROCESS_VARIANCE, network_model
from fusion_sfdia.models.power_network.operation import load_profile
from fusion_sfdia.models.power_network.parameters import load_steps
from fusion_sfdia.models.power_network.simulation import run_network
from fusion_sfdia.report.content import Summary
from fusion_sfdia.report.results import Row
from fusion_sfdia.study.experiments.scenario import Arrays, Scenario, Settings, Task, seed_blocks

Array = NDArray[Any]

NAME = "network/false-alarms"
CHUNK = 50  # runs in one task
APART = 10**6  # added to a seed for the runs on which the rule "conformal" is calibrated
RUN = 100  # s: the length of B18's simulations, in which confirmed false alarms are counted
CONSECUTIVE_ALARMS = (1, 2, 3)
SHOCKED = 4  # times as many runs with shocks, which are rare


def false_alarm_tasks(settings: Settings, seeds: int) -> list[Task]:
    """Healthy runs by process noise and distribution of all noise; a residual of white shocks alone."""
    for law in (*settings["laws"], *settings["shocks"]):
        draw_of(law)
    cells = [(noise, law, seeds) for law in settings["laws"] for noise in PROCESS_VARIANCE]
    cells += [("lit", law, SHOCKED * seeds) for law in settings["shocks"]]
    steps = settings["steps"]
    return [
        {"noise": noise, "law": law, "steps": steps, "seeds": block, "conformal": law in settings["laws"]}
        for noise, law, runs in cells
        for block in seed_blocks(runs, CHUNK)
    ] + [{"noise": "none", "law": "one shock", "steps": settings["shock_steps"], "seeds": list(range(seeds))}]


def false_alarm_work(task: Task) -> Arrays:
    """Counts by run (B, ...), see `counts`; with white shocks alone, see `one_shock`."""
    if task["noise"] == "none":
        return one_shock(task["seeds"], task["steps"])
    model = network_model(noise=task["noise"])
    loads = load_profile(model, load_steps("1"))

    def healthy(first: int) -> dict[str, Array]:
        seeds = [first + s for s in task["seeds"]]
        return streams(model, run_network(model, task["steps"], seeds, loads=loads, draw=draw_of(task["law"])), VARIANTS)

    z = healthy(0)
    calibration = healthy(APART) if task["conformal"] else {}
    kinds = np.stack(list(groups(model).values()))
    found: Arrays = {}
    for name, values in z.items():
        found |= {f"{name} {what}": a for what, a in counts(values, kinds, owners(model)).items()}
        if task["conformal"]:
            scores = np.abs(calibration[name]).reshape(-1, values.shape[-1])
            limits = np.stack([conformal_alpha(scores, p) for p in LEVELS])
            over = np.abs(values)[..., None, :] > limits
            found[f"{name} {CONFORMAL}"] = over.sum(axis=(0, 3))
    return found


def counts(z: Array, kinds: Array, owner: Array) -> Arrays:
    """Alarms of normalised residuals z (K, B, C) by run.

    samples (B,): of all components. beyond (B, G, A): |z| > alpha by group (G, C) and alpha of ALPHAS; rules (B, R, P): by
    rule and level, of all. consecutive (B, A, Q): samples that are at least the q-th consecutive alarm; chances (B, Q):
    samples that could be. confirmed (B, 2): whether within RUN s some component, and some area by any of its components, has
    three consecutive alarms at alpha = 2.
    """
    size = np.abs(z)
    over = np.stack([size > a for a in ALPHAS], axis=-1)  # (K, B, C, A)
    beyond = np.einsum("kbca,gc->bga", over.astype(np.float32), kinds.astype(np.float32))
    rules = np.stack([[_beyond(z, rule, p) for p in LEVELS] for rule in RULES_SHOWN if rule != CONFORMAL])
    consecutive, chances = [over.sum(axis=(0, 2))], [np.full(z.shape[1], size.shape[0] * size.shape[2])]
    run = over
    for _ in CONSECUTIVE_ALARMS[1:]:
        run = run[1:] & over[: len(run) - 1]
        consecutive.append(run.sum(axis=(0, 2)))
        chances.append(np.full(z.shape[1], run.shape[0] * run.shape[2]))
    alarm = over[:RUN, :, :, ALPHAS.index(B18_ALPHA)]
    area = np.stack([alarm[:, :, owner == i].any(axis=-1) for i in np.unique(owner)], axis=-1)
    confirmed = np.stack([(a[2:] & a[1:-1] & a[:-2]).any(axis=(0, 2)) for a in (alarm, area)], axis=-1)
    return {
        "samples": chances[0],
        "beyond": beyond,
        "rules": np.moveaxis(rules, -1, 0),
        "consecutive": np.stack(consecutive, axis=-1),
        "chances": np.stack(chances, axis=-1),
        "confirmed": confirmed,
        "members": np.broadcast_to(kinds.sum(axis=1) * size.shape[0], (z.shape[1], len(kinds))).copy(),
    }


def _beyond(z: Array, rule: str, level: float) -> Array:
    alpha = float(RULES[rule].alpha(level))
    alarmed: Array = ((z if rule == "cantelli-one-sided" else np.abs(z)) > alpha).sum(axis=(0, 2))
    return alarmed


def one_shock(seeds: list[int], steps: int) -> Arrays:
    """e+ = lam e + chi with white three-point chi, s = 1 / (1 - lam): samples that end q consecutive alarms, (B, A, Q).

    chi has the smallest size with which one shock gives q alarms: alpha s lam^(1 - q). Its probability is the size to the -2,
    that is (1 - lam)^2 lam^(2 q - 2) / alpha^2, which falls with alpha^2 where Proposition 5 has alpha^(2 q).
    Of two shocks close to each other with opposite signs the second may give none.
    """
    lam = PAPER.lam
    found = np.zeros((len(seeds), len(ALPHAS), len(CONSECUTIVE_ALARMS)), int)
    for b, seed in enumerate(seeds):
        for a, alpha in enumerate(ALPHAS):
            for j, q in enumerate(CONSECUTIVE_ALARMS):
                limit = alpha / (1 - lam)
                chi = three_points(stream(seed, "shock", a, j), (steps,), limit * lam ** (1 - q) * (1 + 1e-9))
                run = alarm = np.abs(lfilter([1.0], [1.0, -lam], chi)) > limit
                for _ in range(q - 1):
                    run = run[1:] & alarm[: len(run) - 1]
                found[b, a, j] = run.sum()
    return {"consecutive": found, "chances": np.full((len(seeds), len(CONSECUTIVE_ALARMS)), steps)}


def false_alarm_summary(settings: Settings, results: list[tuple[Task, Arrays]]) -> Summary:
    """Rates with intervals over runs, compared with the claims."""
    cells: dict[tuple[str, str], list[Arrays]] = {}
    for task, arrays in results:
        cells.setdefault((task["noise"], task["law"]), []).append(arrays)
    rates: dict[Counted, Row] = {}
    for (noise, law), parts in cells.items():
        found = {k: np.concatenate([p[k] for p in parts]) for k in parts[0]}
        if noise == "none":
            _add(rates, _consecutive(CORRECTED.name, "", ONE_SHOCK, found))
            continue
        for v in VARIANTS:
            of = {k.removeprefix(f"{v.name} "): a for k, a in found.items() if k.startswith(f"{v.name} ")}
            _add(rates, _consecutive(v.name, noise, law, of))
            if law in settings["laws"]:
                _add(rates, _single(v.name, noise, law, of))
            if law in settings["laws"] and settings["steps"] >= RUN + 10:
                for j, who in enumerate(WHO):
                    share = proportion(int(of["confirmed"][:, j].sum()), len(of["confirmed"]))
                    _add(rates, {Counted(CONFIRMED, v.name, who, noise, law, B18_ALPHA): share})
    figures = [groups_figure(rates), claims_figure(rates, settings["laws"]), consecutive_figure(rates)]
    sentences = remarks(rates)
    return Summary(
        list(rates.values()),
        figures,
        tables(rates, settings["laws"]),
        sentences[:1],
        sentences[1:],
    )


def _add(rates: dict[Counted, Row], found: Mapping[Counted, Estimate]) -> None:
    for key, rate in found.items():
        rates[key] = row(
            NAME, key.detector, "none", key.quantity, key.metric, rate, published_claim(key), condition=key.condition
        )


def _single(detector: str, noise: str, law: str, of: Arrays) -> dict[Counted, Estimate]:
    """Probabilities of an alarm by quantity and alpha, and of all components by the rules and their levels."""
    found = {}
    for g, kind in enumerate(groups(network_model())):
        for a, alpha in enumerate(ALPHAS):
            rate = rate_over_runs(of["beyond"][:, g, a], of["members"][:, g])
            found[Counted(SINGLE, detector, kind, noise, law, alpha)] = rate
    for r, rule in enumerate(RULES_SHOWN):
        for p, level in enumerate(LEVELS):
            hits = of[CONFORMAL][:, p] if rule == CONFORMAL else of["rules"][:, r, p]
            found[Counted(SINGLE, detector, "all", noise, law, rule=rule, level=level)] = rate_over_runs(hits, of["samples"])
    return found


def _consecutive(detector: str, noise: str, law: str, of: Arrays) -> dict[Counted, Estimate]:
    """Probabilities of q consecutive alarms, and of an alarm after an alarm."""
    hits, chances = of["consecutive"], of["chances"]
    found = {}
    for a, alpha in enumerate(ALPHAS):
        for j, q in enumerate(CONSECUTIVE_ALARMS):
            key = Counted(CONSECUTIVE, detector, "all", noise, law, alpha, q=q)
            found[key] = rate_over_runs(hits[:, a, j], chances[:, j])
        if law != ONE_SHOCK:
            found[Counted(AFTER, detector, "all", noise, law, alpha)] = rate_over_runs(hits[:, a, 1], hits[:, a, 0])
    return found


SCENARIO = Scenario(
    name=NAME,
    title="Claimed and measured false alarms",
    about="Healthy runs of the power network with several noise distributions: rates at which residuals exceed alpha "
    "deviations by (14) and (15), as printed and corrected, compared with the claim of each rule; consecutive alarms compared "
    "with Proposition 5; share of runs of 100 s with a false alarm confirmed by three consecutive steps.",
    settings={
        "laws": ("gaussian", "student-t", "three-point 4"),
        "shocks": ("three-point 90", "three-point 180"),
        "steps": 110,
        "shock_steps": 20000,
    },
    seeds=50,
    full_seeds=1000,
    tasks=false_alarm_tasks,
    work=false_alarm_work,
    summarise=false_alarm_summary,
    full={"shock_steps": 100000},
    bounds={"steps": (SETTLE + 1, 1e6)},
    papers=("boem2018",),
)
