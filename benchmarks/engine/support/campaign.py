"""Shared by the engine's Monte Carlo campaigns: truths simulated once, noise drawn step by step, first firings of modules.

Decisions are latched, so the decisions at any time follow from the first firing of each module. Nothing else of a run is kept.
 The modules M(I,q) and the sensors S(I){j} have the same order: each module tests the equation of one sensor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.benchmarks.engine.support.trials import DETECTORS, MOST_NOISE, SAMPLING, engine, extremes
from fusion_sfdia.common.random_streams import stream
from fusion_sfdia.common.run_statistics import Estimate, mean_over_runs, proportion, share
from fusion_sfdia.detectors.adaptive_thresholds.adaptive_threshold import AdaptiveThreshold
from fusion_sfdia.detectors.adaptive_thresholds.diagnosis_sets import DiagnosisLogic
from fusion_sfdia.detectors.adaptive_thresholds.monitored_plant import ENVELOPE
from fusion_sfdia.detectors.state import State, with_runs
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.learning.builders import adaptive_threshold
from fusion_sfdia.models.marine_engine.equilibrium import engine_variables, equilibrium
from fusion_sfdia.models.marine_engine.faults import EngineFault
from fusion_sfdia.models.marine_engine.governor import governed_settings
from fusion_sfdia.models.marine_engine.modules import alone as modules_alone
from fusion_sfdia.models.marine_engine.parameters import engine_parameters
from fusion_sfdia.models.marine_engine.plant import marine_engine
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.report.results import Row
from fusion_sfdia.study.diagnosis_metrics import Response
from fusion_sfdia.study.experiments.scenario import Arrays, Settings

Array = NDArray[Any]

VALID = "adaptive-threshold"
USUAL_NOISE = 0.05  # of the nominal values: K24, sec. VII
LOWER_LOAD = 0.8
DRIVES = {
    "constant": "full load",
    "governor": "100 to 80 % load by a PI governor",
    "step": "100 to 80 % load in one step",
}
FINER = 4  # substeps of the truth in one of the detector's
DRAWN = 100  # samples of noise drawn at once
ROOM = 1.2  # margin of the drifts over those in the transients


class NoiseFreeRun(NamedTuple):
    """A run without noise: times (K,) s, fuel settings (K, 1) and what healthy sensors without noise read, (K, N)."""

    t: Array
    u: Array
    signal: Array


@cache
def truth(
    duration: float,
    drive: str = "constant",
    at: float = 0.0,
    fault: tuple[str, float] | None = None,
    sampling: float = SAMPLING,
) -> NoiseFreeRun:
    """The engine for `duration` seconds under one of DRIVES, which acts at `at`, as a process fault (kind, severity) does.

    Computed on finer steps than the detector's.
    """
    plant = marine_engine(dt=sampling)
    steps = round(duration / plant.dt)
    changes: dict[str, Any] = {}
    if fault is not None:
        changes["truth"] = marine_engine(process_faults=[EngineFault(*fault, onset=at)], substeps=FINER)
    if drive == "governor":
        c = engine_parameters()
        full, lower = (float(engine_variables(equilibrium(load, c), c)["speed"]) for load in (1.0, LOWER_LOAD))
        changes["inputs"] = governed_settings(lambda t: lower if t >= at else full, steps)
    elif drive == "step":
        changes["inputs"] = lambda t: np.array([LOWER_LOAD if t >= at else 1.0])
    run = simulate(plant, steps, [0], **changes)
    return NoiseFreeRun(run.t, run.u, run.signal[:, 0])


def noise(plant: Plant, steps: int, seeds: Sequence[int]) -> Iterator[Array]:
    """Sample by sample, noise (B, N) uniform within the sensors' bounds; that of a seed does not depend on the other seeds."""
    bound = np.array([s.noise_bound for s in plant.sensors])
    streams = [stream(s, "measurement noise") for s in seeds]
    for first in range(0, steps, DRAWN):
        block = np.empty((len(streams), min(DRAWN, steps - first), bound.size))
        for r, own in zip(streams, block, strict=True):
            r.random(out=own)
        for k in range(block.shape[1]):
            yield 2 * bound * block[:, k] - bound  # as `uniform` draws them, in less than half its time


def default_envelope(level: float) -> float:
    """Half-width of the envelope for this noise, with one proof for all noise up to the usual: twice the noise and 5 %."""
    return 2 * max(level, USUAL_NOISE) + ENVELOPE


@cache
def steady_detector(
    name: str, level: float = USUAL_NOISE, design: str = "K24", factor: float = 1.0, sampling: float = SAMPLING
) -> AdaptiveThreshold:
    """A named detector at a noise level, with the gains of a design times a factor."""
    plant = engine(level, design, sampling)
    if plant.structure.modules is not None:
        gains = {state: factor * gain for state, gain in plant.structure.modules.gains.items()}
        modules = replace(plant.structure.modules, gains=gains)
        plant = replace(plant, structure=replace(plant.structure, modules=modules))
    return replace(adaptive_threshold(plant, name.partition(":")[2]), envelope=default_envelope(level))


def alone(detector: AdaptiveThreshold, variables: Sequence[str]) -> AdaptiveThreshold:
    """A detector that evaluates one module in a run, that of its variable; variables: one for all runs, or one for each."""
    plant = detector.plant
    assert plant.structure.modules is not None
    modules = modules_alone(plant.structure.modules, variables)
    return replace(detector, plant=replace(plant, structure=replace(plant.structure, modules=modules)))


@cache
def moving_detector(name: str, level: float, duration: float, at: float) -> AdaptiveThreshold:
    """A detector for changing loads: its envelope and drifts cover the runs of DRIVES, with a margin for noise."""
    plant = engine(level, "K24")
    runs = [truth(duration, drive, at).signal for drive in DRIVES]
    low, high = np.min([r.min(axis=0) for r in runs], axis=0), np.max([r.max(axis=0) for r in runs], axis=0)
    most = np.max([np.abs(np.diff(r, axis=0)).max(axis=0) for r in runs], axis=0)
    envelope, drift = {}, {}
    for i, sensor in enumerate(plant.sensors):
        room = 2 * sensor.noise_bound
        envelope[sensor.measures] = float(low[i] - room), float(high[i] + room)
        if plant.structure.modules is not None and sensor.measures in plant.structure.modules.states:
            drift[sensor.measures] = ROOM * float(most[i]) / plant.structure.modules.nominal[sensor.measures]
    return replace(adaptive_threshold(plant, name.partition(":")[2]), envelope=envelope, drift=drift)


def first_firings(
    detector: AdaptiveThreshold,
    t: Array,
    u: Array,
    readings: Iterable[Array],
    state: State | None = None,
    shown: tuple[int, ...] | None = None,
) -> tuple[State, Arrays]:
    """Run the detector through readings (..., N) at each of t (K,) under u (K, m); return its state and the modules' firings.

    first (..., N): time of the first residual beyond its threshold, s, inf for none. beyond (..., N): how many samples were.
    threshold (..., N): its mean, sensor units. diverged (...) bool. trace: as `trials.extremes`, of the run `shown`. The
    runs are stepped as a batch of one axis, which the detector need not reshape.
    """
    first = beyond = total = np.empty(0)
    shape: tuple[int, ...] = ()
    trace: list[tuple[Array, ...]] = []
    for k, (time, applied, now) in enumerate(zip(t, u, readings, strict=True)):
        y = now.reshape(-1, now.shape[-1])
        if k == 0:
            shape, state = now.shape, state or detector.init(now.shape[:-1], float(time) - detector.plant.dt)
            state = _of_batch(state, shape[:-1], (len(y),))
            first, beyond, total = np.full(y.shape, np.inf), np.zeros(y.shape, int), np.zeros(y.shape)
        assert state is not None
        state, decision = detector.step(state, float(time), y, applied)
        with np.errstate(invalid="ignore"):
            firing = np.abs(decision.residual) > decision.threshold
        if firing.any():
            first[firing & np.isinf(first)] = time
            beyond += firing
        total += decision.threshold
        if shown is not None:
            trace.append(tuple(a.reshape(shape)[shown].copy() for a in (decision.residual, decision.threshold)))
    if state is None or not shape:
        raise ValueError("there are no readings; pass at least one")
    state = _of_batch(state, (len(first),), shape[:-1])
    found = {"first": first, "beyond": beyond, "threshold": total / len(t)}
    found = {name: values.reshape(shape) for name, values in found.items()} | {"diverged": state.diverged}
    if trace:
        found["trace"] = extremes(t, *np.moveaxis(np.array(trace), 1, 0))
    return state, found


def _of_batch(state: State, batch: tuple[int, ...], new: tuple[int, ...]) -> State:
    """The state of a batch, with the same runs in a batch of another shape."""
    return with_runs(state, lambda a: a.reshape((*new, *a.shape[len(batch) :])))


def fork(state: State, ways: int) -> State:
    """The state of a batch (*batch), copied to (ways, *batch) runs that differ from here on."""
    return with_runs(state, lambda a: np.broadcast_to(a, (ways, *a.shape)))


def sizes(detector: AdaptiveThreshold, size: float) -> Array:
    """Biases (N,) of `size` thresholds of each sensor's own module, at full load without noise; sensor units."""
    run = truth(1.0)
    state, _ = first_firings(detector, run.t, run.u, run.signal)
    return size * np.asarray(detector.step(state, float(run.t[-1]) + detector.plant.dt, run.signal[-1], run.u[-1])[1].threshold)


def response(first: Array, onset: float, modules: Sequence[int]) -> Response:
    """As diagnosis_metrics.response, from first firings (B, N): (20) with the own module, (21) with those of other agents."""
    delay = np.maximum(first[:, list(modules)].min(axis=-1) - onset, 0.0)
    caught = np.isfinite(delay)
    some = np.round(delay[caught], 6)  # s, of the sums of steps
    return Response(
        proportion(int((~caught).sum()), caught.size),
        mean_over_runs(some, np.ones(some.size)),
        float(some.min()) if some.size else float("nan"),
        float(some.max()) if some.size else float("nan"),
    )


@cache
def logic() -> DiagnosisLogic:
    """The decision logic of the engine's modules."""
    return AdaptiveThreshold(marine_engine()).logic


def diagnosis_rows(at: Callable[[str, Estimate], Row], first: Array, faulty: int | None = None) -> list[Row]:
    """The diagnosis sets at the end of runs of first firings (B, N): rows of `at(metric, estimate)`.

    faulty: the faulty sensor, None for none. isolated_sensors: how many sensors are in S^F; unexplained: runs whose pattern is
    consistent with no set of sensor faults.
    """
    fired: Array = np.isfinite(first)
    isolated, unexplained = logic().isolated(fired), np.logical_not(logic().explained(fired))
    count = isolated.sum(axis=-1)
    rows = [
        at("alarm_at_end", share(np.asarray(fired.any(axis=-1)))),
        at("any_sensor_isolated_at_end", share(count > 0)),
        at("isolated_sensors_at_end", mean_over_runs(count, np.ones(count.size))),
        at("unexplained_at_end", share(unexplained)),
    ]
    if faulty is not None:
        right = isolated[:, faulty]
        rows += [at("isolated_at_end", share(right)), at("exact_isolation_at_end", share(right & (count == 1)))]
    return rows


def require_settings(settings: Settings) -> None:
    """Raise ValueError for settings with which no run is possible, before the first run."""
    for name in ("detector", "detectors"):
        for value in np.atleast_1d(np.asarray(settings.get(name, VALID))):
            if value not in DETECTORS:
                raise ValueError(f"setting {name} is {str(value)!r}; known: {', '.join(DETECTORS)}")
    for name in ("noise", "levels"):
        for value in np.atleast_1d(np.asarray(settings.get(name, USUAL_NOISE))):
            if not 0 < value <= MOST_NOISE:
                raise ValueError(
                    f"setting {name} has {value:g}; expected a share of the nominal values, above 0, at most {MOST_NOISE}"
                )
    if not 0.02 <= settings["onset"] < settings["duration"] - 0.02:
        raise ValueError(
            f"the onset is {settings['onset']:g} s of {settings['duration']:g} s; expected one within the run, from 0.02 s on"
        )
