"""engine/minimum-fault: the smallest offset of each sensor that its own module detects (Kougiatsos 2024, (19) and Table V).

Table V does not state how it was computed. Two interpretations of (19), both for offsets of either sign:

minimum_detectable_percent: for readings without noise; detected in every run, whatever the noise.
smallest_detected_percent: in a run with noise, which can add to the offset at some sample; it decreases with the run's length.

The paper bounds algebraic variables by set inversion (SIVIA); ours come from the corners of the box of readings, which is
tighter. Beside them, without noise and in one sample of a steady engine, those of interval arithmetic and of set inversion.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure as Drawing

from fusion_sfdia.benchmarks.engine.support import campaign
from fusion_sfdia.benchmarks.engine.support.decisions import value_of
from fusion_sfdia.benchmarks.engine.support.trials import (
    DETECTORS,
    NAMES,
    Array,
    Results,
    by_detector,
    engine_detector,
    recording,
    row,
    tasks,
)
from fusion_sfdia.common.run_statistics import Estimate, mean_over_runs
from fusion_sfdia.detectors.adaptive_thresholds.adaptive_threshold import AdaptiveThreshold
from fusion_sfdia.detectors.detector import run
from fusion_sfdia.detectors.state import with_runs
from fusion_sfdia.diagnosis.simulate import Recording
from fusion_sfdia.models.marine_engine.published import minimum_fault
from fusion_sfdia.report.content import Figure, ResultTable, Summary
from fusion_sfdia.report.plots import Bars, bars, legend_above, panels
from fusion_sfdia.report.results import Row
from fusion_sfdia.report.scenario_sentences import pick
from fusion_sfdia.study.experiments.scenario import Arrays, Scenario, Settings, Task

NAME = "engine/minimum-fault"
ONSET = 0.5  # s: the initial state of the observers has decayed
LARGEST = 0.9  # of the nominal value
HALVINGS = 16  # of the interval of the size: to 0.0014 % of the nominal value
INTERVALS = {"inclusion": "interval arithmetic", "sivia": "set inversion"}  # methods, and their conditions
METRICS = {"minimum_detectable_percent": "without noise", "smallest_detected_percent": "in a run"}


def minimum_tasks(settings: Settings, seeds: int) -> list[Task]:
    """Every detector on the same healthy runs."""
    return tasks(settings, (), seeds)


def minimum_work(task: Task) -> Arrays:
    """Smallest sizes over nominal: quiet (1, M) without noise, noisy (B, M) in each run; inf for none found."""
    detector = engine_detector(task["detector"], task["noise"], task["design"])
    healthy = recording(task["noise"], round(task["duration"] / detector.plant.dt), tuple(task["seeds"]))
    search = partial(smallest, detector, healthy.t, u=healthy.u)
    found = {"quiet": search(healthy.signal[:, :1]), "noisy": search(healthy.y)}
    if task["detector"] == DETECTORS[0]:
        found |= {method: by_intervals(detector, healthy, method)[None] for method in INTERVALS}
    return found


def smallest(detector: AdaptiveThreshold, t: Array, y: Array, *, u: Array) -> Array:
    """The smallest |offset| from ONSET on, over the nominal value, with which each sensor's own module fires (B, M).

    The interval between an undetected and a detected size is halved, for either sign; inf where LARGEST is not detected, or the
    module fires without an offset.
    """
    nominal = np.array([detector.plant.structure.modules.nominal[s.measures] for s in detector.plant.sensors])  # type: ignore[union-attr]
    shape = (y.shape[1], 2, len(NAMES))
    unseen, seen = np.zeros(shape), np.full(shape, LARGEST)
    found = fires(detector, t, y, u, seen * nominal) & ~fires(detector, t, y, u, unseen * nominal)
    for _ in range(HALVINGS):
        middle = (unseen + seen) / 2
        fired = fires(detector, t, y, u, middle * nominal)
        unseen, seen = np.where(fired, unseen, middle), np.where(fired, middle, seen)
    return np.asarray(np.where(found, seen, np.inf).min(axis=1))


def fires(detector: AdaptiveThreshold, t: Array, y: Array, u: Array, sizes: Array) -> Array:
    """Whether each sensor's own module fires (B, 2, M), with an offset of + or - its size (B, 2, M) on it alone from ONSET."""
    runs, _, n = sizes.shape
    change = np.array([1.0, -1.0])[:, None, None] * np.eye(n) * sizes[..., None]  # (B, 2, M, N)
    watched = campaign.alone(detector, [s.measures for s in detector.plant.sensors] * (2 * runs))
    readings = (y[k, :, None, None] + (change if now >= ONSET else 0.0 * change) for k, now in enumerate(t))
    _, found = campaign.first_firings(watched, t, u, readings)
    return np.asarray(np.isfinite(np.diagonal(found["first"], axis1=-2, axis2=-1)))


def by_intervals(detector: AdaptiveThreshold, healthy: Recording, method: str) -> Array:
    """As `smallest` without noise (M,), in the first sample of an offset at ONSET, with bounds of algebraic variables by
    `method`; the observers do not depend on it.
    """
    last = int(np.searchsorted(healthy.t, ONSET))
    t, y, u = healthy.t, healthy.signal[:, 0], healthy.u
    state, _ = run(
        replace(detector, latch=False), detector.init((1,), float(t[0]) - detector.plant.dt), t[:last], y[:last, None], u[:last]
    )
    n = len(NAMES)
    state = with_runs(state, lambda a: np.repeat(a, 2 * n, axis=0))
    one = replace(detector, bounds=method, latch=False)
    nominal = np.array([detector.plant.structure.modules.nominal[s.measures] for s in detector.plant.sensors])  # type: ignore[union-attr]
    change = np.array([1.0, -1.0])[:, None, None] * np.eye(n) * nominal

    def fired(size: Array) -> Array:
        readings = (y[last] + change * size[..., None]).reshape(2 * n, n)
        _, decision = one.step(state, float(t[last]), readings, np.broadcast_to(u[last], (2 * n, u.shape[-1])))
        firing = np.abs(decision.residual) > decision.threshold
        return np.asarray(np.diagonal(firing.reshape(2, n, n), axis1=-2, axis2=-1))

    unseen, seen = np.zeros((2, n)), np.full((2, n), LARGEST)
    found = fired(seen)
    for _ in range(HALVINGS):
        middle = (unseen + seen) / 2
        now = fired(middle)
        unseen, seen = np.where(now, unseen, middle), np.where(now, middle, seen)
    return np.asarray(np.where(found, seen, np.inf).min(axis=0))


def minimum_summary(settings: Settings, results: Results) -> Summary:
    """Both sizes of each module, compared with Table V."""
    found = by_detector(results)
    rows: list[Row] = []
    for detector, arrays in found.items():
        for j, name in enumerate(NAMES):
            at = partial(row, NAME, detector, "bias", name)
            quiet, noisy = float(arrays["quiet"][0, j]), arrays["noisy"][:, j]
            known = np.isfinite(noisy)
            size = Estimate(100 * quiet, np.nan, np.nan, 1) if np.isfinite(quiet) else Estimate(np.nan, np.nan, np.nan, 0)
            rows += [
                at("minimum_detectable_percent", size, minimum_fault(name)),
                at("smallest_detected_percent", mean_over_runs(100 * np.where(known, noisy, 0), known), minimum_fault(name)),
            ]
        for method in [m for m in INTERVALS if m in arrays]:
            for j, name in enumerate(NAMES):
                size = Estimate(100 * float(arrays[method][0, j]), np.nan, np.nan, 1)
                at = partial(row, NAME, detector, "bias", name, condition=INTERVALS[method])
                rows.append(at("minimum_detectable_percent", size, minimum_fault(name)))
    table = ResultTable(
        "Smallest detectable fault, percent of the nominal value, laid out as Table V: without noise / in a run (published)",
        ("detector", "agent", "j = 1", "j = 2", "j = 3"),
        tuple((d, f"I = {i}", *(_cell(rows, d, f"M({i},{j})") for j in (1, 2, 3))) for d in found for i in (1, 2, 3, 4)),
    )
    figure = Figure(
        "minimum-fault",
        "Smallest detectable faults",
        "Offset of a module's own sensor, percent of its nominal value, mean over runs with its 95 % interval; diamonds: Table "
        "V. No bar: no offset up to 90 % is detected, or the module fires without a fault.",
        partial(draw, rows, tuple(found)),
        "Bars of the smallest fault that each of ten modules detects, without noise and in a run, one colour per detector",
    )
    valid = [r for r in rows if r.detector == DETECTORS[0] and not r.condition]
    near = {m: [r.quantity for r in pick(valid, metric=m) if abs(r.value / _stated(r) - 1) <= 0.1] for m in METRICS}
    at_M42 = {m: value_of(valid, metric=m, quantity="M(4,2)") for m in METRICS}
    remarks = [
        *(
            f"{DETECTORS[0]}, {METRICS[m]}: within a tenth of Table V for {', '.join(near[m]) or 'no module'}; otherwise "
            + ", ".join(
                f"{r.quantity} {r.value:.3g} % ({_stated(r):g})" for r in pick(valid, metric=m) if r.quantity not in near[m]
            )
            + "."
            for m in METRICS
        ),
        "M(4,2) reads no other sensor, so its threshold is the noise bound: without noise it detects offsets above "
        f"{at_M42['minimum_detectable_percent']} %, in a run of {settings['duration']:g} s above "
        f"{at_M42['smallest_detected_percent']} %. The printed 0.03 % is of the second kind. The values of M(1,1), M(3,1) and "
        "M(4,1), near the noise bound, are of the first. Table V seems to mix both.",
        *_by_intervals(rows),
        "An observer with a gain of hundreds per second follows an offset within a sample or two: M(3,1) and M(4,1) detect it "
        "at its onset or hardly at all.",
    ]
    return Summary(rows, [figure], [table], remarks=remarks)


def _by_intervals(rows: list[Row]) -> list[str]:
    """What other bounds of the algebraic variables make of the modules whose threshold they widen."""
    metric, shown = "minimum_detectable_percent", []
    exact = {r.quantity: r.value for r in rows if (r.detector, r.metric, r.condition) == (DETECTORS[0], metric, "")}
    for condition in INTERVALS.values():
        of = [r for r in rows if r.condition == condition and abs(r.value / exact[r.quantity] - 1) > 0.02]
        moved = ", ".join(f"{r.quantity} {r.value:.3g} % ({_stated(r):g})" for r in of)
        shown += [f"With bounds by {condition}, in one sample of the steady engine: {moved}."] if of else []
    return shown


def _stated(r: Row) -> float:
    return float(r.published or np.nan)


def _cell(rows: list[Row], detector: str, module: str) -> str:
    if module not in NAMES:
        return "-"
    values = {r.metric: r.value for r in rows if (r.detector, r.quantity, r.condition) == (detector, module, "")}
    shown = " / ".join("none" if np.isnan(values[m]) else f"{values[m]:.3g}" for m in METRICS)
    return f"{shown} ({minimum_fault(module).value:g})"


def draw(rows: list[Row], detectors: tuple[str, ...]) -> Drawing:
    """A panel for each interpretation of (19)."""
    figure, axes = panels([f"smallest fault detected {what}" for what in METRICS.values()], columns=1, width=12.0, height=3.0)
    stated = [minimum_fault(name).value for name in NAMES]
    for axis, metric in zip(axes, METRICS, strict=True):
        series = []
        for i, d in enumerate(detectors):
            of: dict[str, Any] = {r.quantity: r for r in rows if (r.detector, r.metric, r.condition) == (d, metric, "")}
            value, low, high = ([getattr(of[name], part) for name in NAMES] for part in ("value", "low", "high"))
            series.append(Bars(d, value, low, high, stated if i == len(detectors) // 2 else [np.nan] * len(NAMES)))
        bars(axis, NAMES, series, ylabel="percent of nominal", log=True)
        axis.set_ylim(1e-3, 100)
    legend_above(figure)
    return figure


SCENARIO = Scenario(
    name=NAME,
    title="Smallest detectable faults of the marine engine's modules",
    about="The smallest offset of each sensor, of either sign, that makes its own module fire, without noise and in a run, at "
    "full load with 5 % noise (Kougiatsos 2024, (19), Table V). Sizes are found by bisection.",
    settings={"noise": 0.05, "duration": 3.0, "detectors": DETECTORS},
    seeds=3,
    full_seeds=20,
    full={"duration": 20.0},
    tasks=minimum_tasks,
    work=minimum_work,
    summarise=minimum_summary,
    papers=("kougiatsos2024",),
)
