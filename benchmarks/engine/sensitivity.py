"""engine/sensitivity: thresholds and smallest detected faults by noise and observer gains (named as future work in V22)."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure as Drawing
from numpy.typing import NDArray

from fusion_sfdia.benchmarks.engine.support import campaign
from fusion_sfdia.benchmarks.engine.support.trials import DETECTORS, NAMES, row
from fusion_sfdia.common.run_statistics import Estimate, mean_over_runs
from fusion_sfdia.detectors.state import chosen_runs
from fusion_sfdia.models.marine_engine.modules import GAINS, MODULES
from fusion_sfdia.models.marine_engine.published import DESIGNS, minimum_fault
from fusion_sfdia.report.content import Figure, Summary
from fusion_sfdia.report.plots import COLOURS, DASHES, MARKERS, legend_above, panels
from fusion_sfdia.report.results import Row
from fusion_sfdia.report.scenario_sentences import listed, pick, span
from fusion_sfdia.study.diagnosis_metrics import smallest_detected
from fusion_sfdia.study.experiments.scenario import Arrays, Scenario, Settings, Task, seed_blocks

Array = NDArray[Any]

CHUNK = 100  # runs in one task
K24 = "K24"
GAIN_SETS = {  # design and factor; V22 has the gains of K22; the factors are ours
    "K24 x 0.01": ("K24", 0.01),
    "K24 x 0.1": ("K24", 0.1),
    "K22": ("K22", 1.0),
    K24: ("K24", 1.0),
    "K24 x 10": ("K24", 10.0),
}
OBSERVERS = {name: module.variable for name, module in MODULES.items() if module.variable in GAINS}
STRETCH = 50  # samples after which a run with a bias ends that was detected, or whose module fired without it
SIZES = np.round(np.geomspace(0.01, 5.0, 28), 4)  # of the faults tried, in noise bounds


def sensitivity_tasks(settings: Settings, seeds: int) -> list[Task]:
    """Each noise level with each set of gains; published and calibrated thresholds with the published gains only."""
    campaign.require_settings(settings)
    if unknown := [g for g in settings["gains"] if g not in GAIN_SETS]:
        raise ValueError(f"setting gains has {', '.join(unknown)}; known: {', '.join(GAIN_SETS)}")
    common = {k: settings[k] for k in ("onset", "duration")}
    return [
        common | {"detector": detector, "level": level, "gains": gains, "seeds": block}
        for level in settings["levels"]
        for gains in settings["gains"]
        for detector in (DETECTORS if gains in DESIGNS else (campaign.VALID,))
        for block in seed_blocks(seeds, CHUNK)
    ]


def sensitivity_work(task: Task) -> Arrays:
    """Of the healthy runs: samples beyond their thresholds (B, N) and mean thresholds (B, N), sensor units, after the onset.

    detected (3, sizes, B) bool: whether an observer's module, silent otherwise, fired with a bias of SIZES on its sensor. A run
    with a bias is stepped through that module alone.
    """
    detector = campaign.steady_detector(task["detector"], task["level"], *GAIN_SETS[task["gains"]])
    t, u, signal = campaign.truth(task["duration"])
    bound, count = np.array([s.noise_bound for s in detector.plant.sensors]), len(task["seeds"])
    onset = int(np.searchsorted(t, task["onset"] - detector.plant.dt / 2))
    draws = campaign.noise(detector.plant, t.size, task["seeds"])
    state, before = campaign.first_firings(detector, t[:onset], u[:onset], (signal[k] + next(draws) for k in range(onset)))
    own = [NAMES.index(name) for name in OBSERVERS]
    observers = [campaign.alone(detector, [variable]) for variable in OBSERVERS.values()]
    left = [np.arange(SIZES.size * count) for _ in own]  # runs with a bias, the sizes of each seed
    states = [chosen_runs(state, runs % count) for runs in left]
    silent, fired = np.ones((count, bound.size), bool), np.zeros((len(own), SIZES.size * count), bool)
    beyond, threshold = before["beyond"], np.zeros((count, bound.size))
    for first in range(onset, t.size, STRETCH):
        now = range(first, min(first + STRETCH, t.size))
        readings = np.array([signal[k] + next(draws) for k in now])
        state, found = campaign.first_firings(detector, t[now], u[now], readings, state)
        beyond, threshold = beyond + found["beyond"], threshold + len(now) * found["threshold"]
        silent &= np.isinf(found["first"])
        for i, sensor in enumerate(own):
            if (runs := left[i]).size:
                y = readings[:, runs % count]
                y[..., sensor] += SIZES[runs // count] * bound[sensor]
                states[i], found = campaign.first_firings(observers[i], t[now], u[now], y, states[i])
                fired[i, runs] |= np.isfinite(found["first"][:, sensor])
                open_ = ~fired[i, runs] & silent[runs % count, sensor]  # of the others nothing more is to be known
                left[i], states[i] = runs[open_], chosen_runs(states[i], np.flatnonzero(open_))
    return {
        "beyond": beyond,
        "threshold": threshold / (t.size - onset),
        "detected": fired.reshape(len(own), SIZES.size, count) & silent.T[own, None],
        "bound": bound,
    }


def sensitivity_summary(settings: Settings, results: list[tuple[Task, Arrays]]) -> Summary:
    """Thresholds, smallest detected faults and false alarms by module, noise and gains."""
    cells: dict[tuple[str, float, str], list[Arrays]] = {}
    for task, arrays in results:
        cells.setdefault((task["detector"], task["level"], task["gains"]), []).append(arrays)
    samples = round(settings["duration"] / 0.01)
    rows: list[Row] = []
    for (detector, level, gains), parts in cells.items():
        threshold, beyond = (np.concatenate([p[k] for p in parts]) for k in ("threshold", "beyond"))
        detected = np.concatenate([p["detected"] for p in parts], axis=-1)
        at = partial(row, "engine/sensitivity", detector, condition=condition(level, gains))
        alarms = beyond.sum(axis=-1)
        count = Estimate(float((beyond > 0).any(axis=-1).sum()), math.nan, math.nan, alarms.size)
        rows.append(at("none", "all", "runs_with_false_alarm", count))
        rows.append(at("none", "all", "false_alarms", Estimate(float(alarms.sum()), math.nan, math.nan, alarms.size)))
        for i, name in enumerate(OBSERVERS):
            sensor = NAMES.index(name)
            ratio = threshold[:, sensor] / parts[0]["bound"][sensor]
            mean = mean_over_runs(ratio, np.ones(ratio.size))
            stated = minimum_fault(name) if level == campaign.USUAL_NOISE and gains == K24 else None
            seen = smallest_detected(SIZES * 100 * level, detected[i])
            rows += [
                at("none", name, "threshold_noise_bounds", mean),
                at("none", name, "minimum_detectable_percent", _scaled(mean, 100 * level), stated),
                at("bias", name, "smallest_detected_percent", seen, stated),
                at("bias", name, "samples", Estimate(float(samples), math.nan, math.nan, alarms.size)),
            ]  # fmt: skip
    return Summary(rows, [_figure(settings, rows)], remarks=_remarks(settings, rows))


def condition(level: float, gains: str) -> str:
    """The condition of a row: the noise level, as a share of the nominal values, and the observer gains."""
    return f"noise {level:.0%}, gains {gains}"


def _scaled(e: Estimate, factor: float) -> Estimate:
    return Estimate(e.value * factor, e.low * factor, e.high * factor, e.n)


def _of(rows: list[Row], name: str, level: float, gains: str, metric: str, detector: str = campaign.VALID) -> float:
    found = pick(rows, quantity=name, condition=condition(level, gains), metric=metric, detector=detector)
    return found[0].value if found else math.nan


def _figure(settings: Settings, rows: list[Row]) -> Figure:
    def draw() -> Drawing:
        figure, axes = panels([f"{name} ({v})" for name, v in OBSERVERS.items()], columns=3, width=10.0, height=3.2)
        for panel, name in zip(axes, OBSERVERS, strict=True):
            gain = {g: GAIN_SETS[g][1] * DESIGNS[GAIN_SETS[g][0]][0][OBSERVERS[name]] for g in settings["gains"]}
            order = sorted(gain, key=gain.__getitem__)
            x = [gain[g] for g in order]
            for j, level in enumerate(settings["levels"]):
                bounds = [_of(rows, name, level, g, "threshold_noise_bounds") for g in order]
                seen = [_of(rows, name, level, g, "smallest_detected_percent") / (100 * level) for g in order]
                panel.plot(x, bounds, DASHES[j % len(DASHES)], color=COLOURS[j % len(COLOURS)], label=f"{level:.0%} noise")
                panel.plot(x, seen, MARKERS[j % len(MARKERS)], color=COLOURS[j % len(COLOURS)], mfc="none")
            panel.set(
                xscale="log", xlabel="gain of the observer (1/s)", ylabel="noise bounds", ylim=(0, 1.05 * panel.get_ylim()[1])
            )
        legend_above(figure)
        return figure

    return Figure(
        "gains",
        "Thresholds and smallest detected faults by observer gain and noise",
        "Lines: mean threshold of the module, the smallest fault detectable without noise (19). Markers: mean over runs of the "
        "smallest bias that its own module detected. Both over the noise bound.",
        draw,
        "Thresholds of the three observers over their gains at several noise levels, with the smallest faults detected",
    )


def _remarks(settings: Settings, rows: list[Row]) -> list[str]:
    remarks = []
    for name in OBSERVERS:
        parts = []
        for gains in settings["gains"]:
            found = [_of(rows, name, level, gains, "threshold_noise_bounds") for level in settings["levels"]]
            parts.append(f"{gains} {span(found)}")
        remarks.append(f"Threshold of {name} over its noise bound, by gains: {'; '.join(parts)}.")
    alarms = pick(rows, metric="runs_with_false_alarm")
    runs = {d: sum(r.n for r in pick(alarms, detector=d)) for d in dict.fromkeys(r.detector for r in alarms)}
    remarks.append(
        "Healthy runs with a sample beyond a threshold: "
        + "; ".join(f"{d} {sum(r.value for r in pick(alarms, detector=d)):.0f} of {n}" for d, n in runs.items())
        + ". The published constants are for the published gains and would have to be derived again for others."
    )
    usual = pick(
        rows, metric="smallest_detected_percent", condition=condition(campaign.USUAL_NOISE, K24), detector=campaign.VALID
    )
    if usual:
        remarks.append(f"Smallest fault detected, % of nominal, on a grid in steps of a quarter: {listed(usual, 'quantity')}.")
    return remarks


SCENARIO = Scenario(
    name="engine/sensitivity",
    title="Thresholds by noise and observer gains",
    about="Thresholds of the three observers, the smallest biases they detect, and their false alarms, for the gains of the "
    "two papers and for a hundredth to ten times those of K24, at several noise levels.",
    settings={"levels": (0.01, 0.03, 0.05), "gains": tuple(GAIN_SETS), "onset": 4.0, "duration": 8.0},
    seeds=2,
    full_seeds=100,
    tasks=sensitivity_tasks,
    work=sensitivity_work,
    summarise=sensitivity_summary,
    full={"levels": (0.01, 0.03, 0.05, 0.07, 0.1), "duration": 20.0},
)
