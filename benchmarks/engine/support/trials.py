"""Shared by the engine scenarios: runs with sensor offsets through the monitoring modules, and their arrays.

The papers' setting: constant full load, a truth that obeys the detector's model, noise redrawn at each reading. Decisions are
latched, (16), so that the first alarm of each module determines all decisions of a run.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache, lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.adaptive_thresholds.adaptive_threshold import AdaptiveThreshold
from fusion_sfdia.detectors.adaptive_thresholds.corner_bounds import Slopes
from fusion_sfdia.detectors.detector import run
from fusion_sfdia.diagnosis.fault_effects import apply_faults
from fusion_sfdia.diagnosis.faults import Fault
from fusion_sfdia.diagnosis.simulate import Recording, simulate
from fusion_sfdia.models.marine_engine.equations import NOMINAL_SPEED
from fusion_sfdia.models.marine_engine.modules import MODULES
from fusion_sfdia.models.marine_engine.plant import marine_engine
from fusion_sfdia.models.marine_engine.published import AT_NOMINAL_SPEED, DESIGNS, PublishedOffset
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.report.results import Row, row_of
from fusion_sfdia.study.experiments.scenario import Arrays, Settings, Task, seed_blocks

Array = NDArray[Any]
Results = Sequence[tuple[Task, Arrays]]

PLANT = "marine-engine"
DETECTORS = ("adaptive-threshold", "adaptive-threshold:paper", "adaptive-threshold:calibrated")
NAMES = tuple(MODULES)  # of the modules, each that of one sensor, in the same order
CHUNK = 50  # runs in one task
BLOCK = 1000  # samples that are stacked at a time
BIN = 10  # samples of a trace of which two are kept
SAMPLING = 0.01  # s between readings; the papers state none
MOST_NOISE = 0.12  # of the nominal values: the envelope is twice as wide and must not contain negative pressures

row = partial(row_of, PLANT)  # of scenario, detector, fault, quantity, metric, estimate, published; condition


@cache
def engine(noise: float, design: str, sampling: float = SAMPLING) -> Plant:
    """The engine at full load with readings of that noise, so many seconds apart, and modules as designed in K24 or K22."""
    plant = marine_engine(noise=noise, dt=sampling)
    assert plant.structure.modules is not None
    gains, bounds = DESIGNS[design]
    modules = replace(plant.structure.modules, gains=gains, observer_bounds=bounds)
    if design == AT_NOMINAL_SPEED:
        modules = replace(modules, equations=dict(modules.equations) | NOMINAL_SPEED, monitor=None)
    return replace(plant, structure=replace(plant.structure, modules=modules))


@cache
def engine_detector(name: str, noise: float, design: str = "K24", sampling: float = SAMPLING) -> AdaptiveThreshold:
    """A named detector on that engine, built once for all tasks of a process."""
    detector = registry.detector(name, engine(noise, design, sampling))
    assert isinstance(detector, AdaptiveThreshold)
    alike = design if design == AT_NOMINAL_SPEED else "K24"
    vars(detector)["slopes"] = proof(noise, alike)  # the cached property: seconds, and the same for all modes, gains, bounds
    return detector


@cache
def proof(noise: float, design: str) -> Slopes:
    """The slopes of the engine's equations over the readings' range at that noise."""
    return AdaptiveThreshold(engine(noise, design)).slopes


@lru_cache(maxsize=1)
def recording(noise: float, steps: int, seeds: tuple[int, ...], sampling: float = SAMPLING) -> Recording:
    """Healthy readings, the same for every detector."""
    return simulate(engine(noise, "K24", sampling), steps, seeds, truth="model")


def offsets(plant: Plant, t: Array, y: Array, faults: Iterable[Sequence[Any]]) -> Array:
    """The readings y (K, B, N) at t (K,) with permanent offsets (sensor, onset in s, magnitude)."""
    listed = [Fault(sensor, "bias", onset, magnitude=magnitude) for sensor, onset, magnitude in faults]
    return apply_faults(plant, t, y, listed).y if listed else y


def tasks(settings: Settings, faults: Sequence[PublishedOffset], seeds: int, design: str = "K24") -> list[Task]:
    """Tasks of CHUNK runs and one detector each; ValueError for settings with which no run is possible."""
    if not 0 < settings["noise"] <= MOST_NOISE:
        raise ValueError(
            f"setting noise is {settings['noise']}; expected a share of the nominal values, above 0, at most {MOST_NOISE}"
        )
    last = max((f.onset for f in faults), default=0.0)
    if not settings["duration"] > last + 1:
        raise ValueError(
            f"setting duration is {settings['duration']} s; expected more than {last + 1:g}, a second after the last fault"
        )
    if unknown := [d for d in settings["detectors"] if d not in DETECTORS]:
        raise ValueError(f"setting detectors has {', '.join(unknown)}; known: {', '.join(DETECTORS)}")
    common = {
        "noise": settings["noise"],
        "duration": settings["duration"],
        "design": design,
        "sampling": float(str(settings.get("sampling", SAMPLING))),
        "faults": [list(f) for f in faults],
    }
    return [common | {"detector": d, "seeds": block} for block in seed_blocks(seeds, CHUNK) for d in settings["detectors"]]


def trial(task: Task) -> Arrays:
    """The runs of a task through its detector; arrays as in `module_scores`."""
    detector = engine_detector(task["detector"], task["noise"], task["design"], task["sampling"])
    steps = round(task["duration"] / detector.plant.dt)
    healthy = recording(task["noise"], steps, tuple(task["seeds"]), task["sampling"])
    y = offsets(detector.plant, healthy.t, healthy.y, task["faults"])
    onset = min((onset for _, onset, _ in task["faults"]), default=np.inf)
    return module_scores(detector, healthy.t, y, healthy.u, onset)


def module_scores(detector: AdaptiveThreshold, t: Array, y: Array, u: Array, onset: float) -> Arrays:
    """The modules' decisions on readings y (K, B, N) at t (K,) under u (K, m), BLOCK samples at a time.

    first (B, M): when each module fired first, s, inf for never. healthy, faulty (B, M): its largest |residual| / threshold
    before `onset` and from then on. trace (3, 2 K / BIN, M): time (s), residual and threshold of the first run at the samples
    of each BIN where the residual is nearest to the upper and to the lower threshold.
    """
    runs = y.shape[1]
    state = detector.init((runs,), float(t[0]) - detector.plant.dt)
    first = np.full((runs, len(NAMES)), np.inf)
    largest = np.zeros((2, runs, len(NAMES)))
    traces = []
    for k in range(0, t.size, BLOCK):
        now = slice(k, k + BLOCK)
        applied = np.broadcast_to(u[now, None], (t[now].size, runs, u.shape[-1]))
        state, decision = run(detector, state, t[now], y[now], applied)
        with np.errstate(invalid="ignore"):
            firing = np.abs(decision.residual) > decision.threshold
        first = np.minimum(first, np.where(firing.any(axis=0), t[now][np.argmax(firing, axis=0)], np.inf))
        begun = t[now] >= onset - detector.plant.dt / 2
        for part, chosen in enumerate((~begun, begun)):
            largest[part] = np.maximum(largest[part], decision.scores[chosen].max(axis=0, initial=0.0))
        traces.append(extremes(t[now], decision.residual[:, 0], decision.threshold[:, 0]))
    return {"first": first, "healthy": largest[0], "faulty": largest[1], "trace": np.concatenate(traces, axis=1)}


def extremes(t: Array, residual: Array, threshold: Array) -> Array:
    """Time, residual, threshold (3, 2 K', M) at the samples of each BIN with the largest and least residual / threshold."""
    bins = t.size // BIN
    if not bins:
        return np.empty((3, 0, residual.shape[-1]), np.float32)
    shape = (bins, BIN, residual.shape[-1])
    every = np.stack([np.broadcast_to(t[:, None], residual.shape), residual, threshold])[:, : bins * BIN].reshape(3, *shape)
    ratio = every[1] / every[2]
    at = np.sort(np.stack([np.argmax(ratio, axis=1), np.argmin(ratio, axis=1)], axis=1), axis=1)
    kept = np.take_along_axis(every, at[None], axis=2)
    return kept.reshape(3, 2 * bins, -1).astype(np.float32)


def by_detector(results: Results) -> dict[str, Arrays]:
    """The arrays of each detector: all its runs, and the trace of the first one."""
    parts: dict[str, list[Arrays]] = {}
    for task, arrays in results:
        parts.setdefault(task["detector"], []).append(arrays)
    return {
        name: {k: found[0][k] if k == "trace" else np.concatenate([p[k] for p in found]) for k in found[0]}
        for name, found in parts.items()
    }


def sampled(rows: Sequence[Row], sampling: float) -> list[Row]:
    """The rows, whose condition also states how often readings come where that is not every `SAMPLING`."""
    if sampling == SAMPLING:
        return list(rows)
    every = f"readings every {1e3 * sampling:g} ms"
    return [replace(r, condition=f"{r.condition}, {every}" if r.condition else every) for r in rows]


class Timeline(NamedTuple):
    """Latched decisions at the times at which something changes: t (E,) s; decisions (E, B, M), active, isolated (E, B, N)."""

    t: Array
    decisions: Array
    active: Array
    isolated: Array


def timeline(first: Array, faults: Sequence[PublishedOffset], duration: float) -> Timeline:
    """The decisions in runs (B, M) whose modules fired first at these times (s), and the true faults."""
    plant = engine(0.05, "K24")
    times = np.concatenate([[0.0, duration], [f.onset for f in faults], first[np.isfinite(first)]])
    t = np.unique(times[times <= duration])
    decisions = first <= t[:, None, None]
    active = np.zeros((t.size, len(first), len(NAMES)), bool)
    for fault in faults:
        active[..., plant.sensor_index(fault.sensor)] |= (t >= fault.onset)[:, None]
    return Timeline(t, decisions, active, AdaptiveThreshold(plant).logic.isolated(decisions))


def published_first(fired: Mapping[str, float]) -> Array:
    """First firing times (1, M) of a published run, inf for the silent modules."""
    return np.array([[fired.get(name, np.inf) for name in NAMES]])
