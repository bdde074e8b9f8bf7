"""network/plug: an area is unplugged, another plugged in: effects on the other areas, false alarms (B18, sec. VI, VIII-A)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.benchmarks.network.consensus import agreement
from fusion_sfdia.benchmarks.network.support.plug_figures import (
    JOINS,
    LEAVES,
    MANNERS,
    PHASES,
    PLACES,
    Changed,
    FirstAlarm,
    alarm_figure,
    locality_figure,
    remarks,
    tables,
)
from fusion_sfdia.benchmarks.network.support.residuals import B18, CORRECTED, SETTLE, normalised, owners
from fusion_sfdia.benchmarks.network.support.rows import row
from fusion_sfdia.common.run_statistics import NOTHING, Estimate, rate_over_runs, share
from fusion_sfdia.detectors.stochastic_thresholds.consensus import Diagnosers, NetworkReadings, initial_state
from fusion_sfdia.detectors.stochastic_thresholds.network_step import network_step
from fusion_sfdia.detectors.stochastic_thresholds.replug import opened_sides, reset_sides
from fusion_sfdia.models.power_network.diagnosis import network_areas
from fusion_sfdia.models.power_network.model import PROCESS_VARIANCE, NetworkModel, network_model
from fusion_sfdia.models.power_network.operation import Switch, load_profile
from fusion_sfdia.models.power_network.parameters import load_steps
from fusion_sfdia.models.power_network.simulation import NetworkSample, run_network
from fusion_sfdia.plant.areas import Areas
from fusion_sfdia.report.content import Summary
from fusion_sfdia.report.results import Published, Row
from fusion_sfdia.study.experiments.scenario import Arrays, Scenario, Settings, Task, seed_blocks

Array = NDArray[Any]

NAME = "network/plug"
CHUNK = 50  # runs in one task
ALPHA = 2.0  # B18, sec. VIII
TIMES = {LEAVES: 43.0, JOINS: 70.0}  # s: B18's scenario 1, where area 4 is unplugged as soon as its fault is detected
STEPS = 95
SWITCHES = (Switch(TIMES[LEAVES], unplug=("4",)), Switch(TIMES[JOINS], plug_in=("15",)))
STATED = {  # areas that change
    LEAVES: Published(4.0, f"{B18}, sec. VI and VIII-A: areas 3, 5, 13 and 4"),
    JOINS: Published(2.0, f"{B18}, sec. VI and VIII-A: areas 14 and 15 alone"),
}


def plug_tasks(settings: Settings, seeds: int) -> list[Task]:
    """Comparisons before and after a switch, without noise; healthy runs by process noise, diagnosed in each manner."""
    return [{"what": "locality", "noise": noise} for noise in PROCESS_VARIANCE] + [
        {"what": "alarms", "noise": noise, "seeds": block} for noise in PROCESS_VARIANCE for block in seed_blocks(seeds, CHUNK)
    ]


def plug_work(task: Task) -> Arrays:
    """Alarms of the areas (K, B, N) by manner, or which areas change, see `changes`."""
    model = network_model(noise=task["noise"], unplugged=("15",))
    loads = load_profile(model, load_steps("1"))
    if task["what"] == "locality":
        return {f"{event} {what}": who for event in TIMES for what, who in changes(model, event).items()}
    moments = list(run_network(model, STEPS, task["seeds"], loads=loads, switches=SWITCHES))
    whose = owners(model)
    found: Arrays = {}
    for manner in MANNERS:
        over = np.stack([np.abs(normalised(s)) > ALPHA for s in replugged(model, moments, manner)])
        found[manner] = np.stack([over[..., whose == i].any(axis=-1) for i in range(len(model.names))], axis=-1)
    return found


def replugged(model: NetworkModel, moments: Iterable[NetworkSample], manner: str) -> Iterator[Diagnosers]:
    """The diagnosers after each moment, replugged after the step at which the network switches, in a manner of MANNERS."""
    areas, state = network_areas(model, named=False), None
    for now in moments:
        if state is None:
            state = initial_state(areas, now.reference.shape[:1])
        load = np.broadcast_to(now.load, now.reference.shape)
        given = NetworkReadings(now.own, now.shared, now.reference, load)
        state, _ = network_step(areas, state, given, 1.0, CORRECTED.lam)
        yield state
        after = switched(areas, network_areas(now.condition.known, named=False), manner)
        state, areas = Diagnosers(*map(np.ascontiguousarray, reset_sides(state, opened_sides(areas, after)))), after


def switched(before: Areas, now: Areas, manner: str) -> Areas:
    """The areas as modelled by the diagnosers: the present ones, by sec. VI-A as printed, or those before the switch.

    Sec. VI-A sets the unplugged area's angle and weights to 0 (and VI-B sets them again); sum_j P_ij in A_ii remains.
    """
    if manner == MANNERS[0]:
        return now
    return replace(now, matrices=before.matrices, shared_gain=before.shared_gain) if manner == MANNERS[1] else before


def changes(model: NetworkModel, event: str) -> Arrays:
    """Areas (N,) of which a bit changes at an event of TIMES, and how many numbers were compared.

    model: its row of matrices. weights, thresholds: of its own states. copies: weights or thresholds of its readings of its
    neighbours' angles; of ties that are closed before and after.
    """
    names = list(TIMES)
    past = [s for s in SWITCHES if s.time < TIMES[event]]
    for s in past:
        model = model.switched(plug_in=s.plug_in, unplug=s.unplug)
    switch = SWITCHES[names.index(event)]
    models = model, model.switched(plug_in=switch.plug_in, unplug=switch.unplug)
    loads = load_profile(model, [])
    areas = [network_areas(m, named=False) for m in models]
    n, count = areas[0].size[1], len(model.names)
    # thresholds do not depend on the readings: they are the same in all healthy runs
    settled = []
    for m in models:
        *_, last = replugged(m, run_network(m, 6 * SETTLE, [0], loads=loads), MANNERS[0])
        settled.append(last)
    closed = models[0].network.closed & models[1].network.closed
    node = model.network.topology.node
    weights = [agreement(a, "corrected") for a in areas]
    other = weights[0] != weights[1]
    threshold = settled[0].deviation[0] != settled[1].deviation[0]
    copy = closed & ((settled[0].deviation_shared[0] != settled[1].deviation_shared[0]) | other[count:])
    return {
        "model": np.any(areas[0].matrices != areas[1].matrices, axis=(1, 2)),
        "weights": other[:count],
        "thresholds": threshold.any(axis=-1),
        "copies": np.bincount(node, copy, minlength=count) > 0,
        "compared": np.array([areas[0].matrices.size, count, n * count, 2 * closed.sum()]),
    }


def plug_summary(settings: Settings, results: list[tuple[Task, Arrays]]) -> Summary:
    """Which areas change, and alarms by manner, phase and place."""
    names = network_model().names
    changed: dict[Changed, Row] = {}
    alarms: dict[FirstAlarm, Row] = {}
    rows: list[Row] = []
    local: dict[str, Arrays] = {}
    curves: dict[tuple[str, str], Array] = {}
    for noise in PROCESS_VARIANCE:
        for task, arrays in results:
            if task["what"] == "locality" and task["noise"] == noise:
                local[noise] = arrays
                changed |= (new := _changed_areas(noise, arrays, names))
                rows += new.values()
        parts = [arrays for task, arrays in results if task["what"] == "alarms" and task["noise"] == noise]
        for manner in MANNERS if parts else ():
            curves[noise, manner] = alarm = np.concatenate([p[manner] for p in parts], axis=1)
            for key, estimate in _alarm_estimates(noise, manner, alarm, names).items():
                condition = f"{key.phase}, {manner}, {noise}"
                alarms[key] = row(NAME, CORRECTED.name, "none", key.place, key.metric, estimate, condition=condition)
                rows.append(alarms[key])
    sentences = remarks(changed, alarms)
    figures = [locality_figure(local, names), alarm_figure(curves, names, sentences[0])]
    return Summary(rows, figures, tables(changed, alarms), sentences[:1], sentences[1:])


def _alarm_estimates(noise: str, manner: str, alarm: Array, names: tuple[str, ...]) -> dict[FirstAlarm, Estimate]:
    """Alarms per step, and runs with three consecutive ones, by phase and place; alarm (K, B, N)."""
    found = {}
    for phase, (start, end) in PHASES.items():
        for place, who in places(names).items():
            some = alarm[start:end][..., who]
            rate = rate_over_runs(some.sum(axis=(0, 2)), np.full(some.shape[1], some.shape[0] * some.shape[2]))
            found[FirstAlarm(place, phase, manner, noise)] = rate
            run = (some[2:] & some[1:-1] & some[:-2]).any(axis=(0, 2))
            found[FirstAlarm(place, phase, manner, noise, "false_confirmation_share")] = share(np.asarray(run))
    return found


def places(names: tuple[str, ...]) -> dict[str, Array]:
    """Areas by the effect of a switch on them, (N,) truth values."""
    found = {place: np.isin(names, who) for place, who in PLACES.items()}
    return found | {"other areas": ~np.any(list(found.values()), axis=0)}


def _changed_areas(noise: str, arrays: Arrays, names: tuple[str, ...]) -> dict[Changed, Row]:
    found = {}
    for event in TIMES:
        of = {what: arrays[f"{event} {what}"] for what in ("model", "weights", "thresholds", "copies")}
        own = np.any([of[what] for what in ("model", "weights", "thresholds")], axis=0)
        for what, changed in (of | {"own numbers": own, "any number": own | of["copies"]}).items():
            key = Changed(event, what, noise, tuple(n for n, c in zip(names, changed, strict=True) if c))
            counted = NOTHING._replace(value=float(changed.sum()), n=len(names))
            stated = STATED[event] if what in ("own numbers", "any number") else None
            quantity, condition = f"{what} of {key.who}", f"{event}, {noise}"
            found[key] = row(NAME, CORRECTED.name, "none", quantity, "changed_areas", counted, stated, condition=condition)
    return found


SCENARIO = Scenario(
    name=NAME,
    title="Effects of unplugging and plugging in areas",
    about="Healthy runs of the power network: area 4 is unplugged at 43 s, area 15 plugged in at 70 s. Shown are the areas "
    "whose models, weights and thresholds change in any bit, and the alarm rates when the diagnosers are replugged, when they "
    "follow sec. VI-A of the paper literally, and when they are not updated.",
    settings={},
    seeds=50,
    full_seeds=500,
    tasks=plug_tasks,
    work=plug_work,
    summarise=plug_summary,
    papers=("boem2018",),
)
