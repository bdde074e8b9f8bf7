"""Speed: the whole bank against one filter and against filterpy, the compiled model, large pipelines, Lorenz-96, codac.

Everything on one thread; what is compared takes turns, and the least time of each counts (see `timing`).

- bank: step_time of a step of the whole bank (63 filters, mixture, diagnosis), of one that alarms and so mixes twice, and
  of a single filter; speedup with quantity `single` is a ratio of times, bank over one filter; with `filterpy` (model in
  NumPy) and `filterpy, compiled model` it is 63 filterpy filters of 62 sensors, without mixture or diagnosis, over the bank.
- model: step_time of the pipeline's step and Jacobian, compiled and in NumPy, of one state and per state of a batch.
- scaling: an ensemble filter on finer pipelines, predict and update: step_time, the model's part of it, peak_memory
  (NumPy's arrays above those of the plant; the compiled model holds one ensemble more); the extended bank at 201 nodes.
- lorenz: step_time of single filters on 63 states, ours and filterpy's, and their ratio (see `bench_lorenz`).
- engine: step_time of all ten modules for one run of a batch, and of the bounds of the seven algebraic ones by codac; speedup
  is theirs over ours for one step, of all seven calls and of the quickest of them (see `bench_engine`).
"""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from fusion_sfdia.benchmarks.speed import against_filterpy as bench_filterpy
from fusion_sfdia.benchmarks.speed import engine as bench_engine
from fusion_sfdia.benchmarks.speed import lorenz as bench_lorenz
from fusion_sfdia.builders import PAPER_FILTERS
from fusion_sfdia.core.detector import Detector
from fusion_sfdia.core.files import require_free
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.evaluation.results import Row, write_rows
from fusion_sfdia.evaluation.simulate import simulate
from fusion_sfdia.experiments.timing import Timing, best_times
from fusion_sfdia.filters import enkf
from fusion_sfdia.filters.estimators import Extended
from fusion_sfdia.filters.gaussian import sample
from fusion_sfdia.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.kalman_banks.fusing_bank import FusingBank
from fusion_sfdia.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.models.gas_pipeline.plant import gas_pipeline

Array = NDArray[Any]
Call = Callable[[], object]

SECONDS = 2.0  # of each call
SETTLED = 16  # steps before the one that is timed: the window of the likelihood ratios is full
QUIET, ALARMING = 10.0, 1e-9  # thresholds in sigma of the sensors: never crossed and always crossed
FILTERPY_TIMED = 3  # of its filters, scaled to all of them: each costs the same
BATCHES = (40, 127)  # members, and sigma points of 63 states
NODES = (21, 201, 2001)
BANK_NODES = (201,)
TOLERANCES = (0.1, 0.01)  # of set inversion, in noise bounds


def bank(seconds: float) -> list[Row]:
    """Banks on the pipeline of 21 nodes and 63 sensors."""
    plant = gas_pipeline()
    rows: list[Row] = []
    for kind, estimator in PAPER_FILTERS.items():
        quiet, alarming = (tuple((level * plant.sensor_sigma).tolist()) for level in (QUIET, ALARMING))
        ours = {
            "bank": repeated_step(FusingBank(plant, estimator, thresholds=quiet)),
            "bank, alarm": repeated_step(FusingBank(plant, estimator, thresholds=alarming)),
            "one filter": repeated_step(CentralFilter(plant, estimator)),
        }
        theirs = filterpy_banks(kind, plant)
        times = best_times({**ours, **{name: call for name, (call, _) in theirs.items()}}, seconds)
        whole = times["bank"]
        ratios = {"single": (whole, 1.0), "single, alarm": (times["bank, alarm"], 1.0)}
        found = [_row("bank", plant, f"fusing-{kind}", q, "step_time", times[q]) for q in ours]
        for q, (over, factor) in ratios.items():
            found.append(_row("bank", plant, f"fusing-{kind}", q, "speedup", over, factor / times["one filter"].best))
        for q, (_, factor) in theirs.items():
            found.append(_row("bank", plant, f"fusing-{kind}", q, "step_time", times[q], factor))
            found.append(_row("bank", plant, f"fusing-{kind}", q, "speedup", times[q], factor / whole.best))
        rows += found
    windows = {"loo-chi2": 1, "loo-glr": 15}
    times = best_times({name: repeated_step(LeaveOneOutBank(plant, window=w)) for name, w in windows.items()}, seconds)
    return rows + [_row("bank", plant, name, "bank", "step_time", time) for name, time in times.items()]


def filterpy_banks(kind: str, plant: Plant) -> dict[str, tuple[Call, float]]:
    """Calls of filterpy filters, each without one sensor, and the factor from the few timed to one for each sensor."""
    u, y = plant.input_at(0.0), plant.output(0.0, plant.x0, plant.input_at(0.0)) + 0.5 * plant.sensor_sigma
    models = {
        "filterpy": bench_filterpy.numpy_model(plant, u),
        "filterpy, compiled model": bench_filterpy.compiled_model(plant, u),
    }

    def some(model: bench_filterpy.Model) -> Call:
        filters = [bench_filterpy.step_call(kind, plant, model, y, without=i) for i in range(FILTERPY_TIMED)]
        return lambda: [call() for call in filters]

    return {name: (some(model), len(plant.sensors) / FILTERPY_TIMED) for name, model in models.items()}


def model(seconds: float) -> list[Row]:
    """The pipeline of 21 nodes: one step of 10 s, its Jacobian, and batches."""
    plant = gas_pipeline()
    u, x = plant.input_at(0.0), plant.x0
    numpy_model = bench_filterpy.numpy_model(plant, u)
    calls: dict[str, tuple[Call, int]] = {
        "step": (partial(plant.step, 0.0, x, u, plant.dt), 1),
        "Jacobian": (partial(plant.step_jacobian_at, 0.0, x, u, plant.dt), 1),
        "step, NumPy": (partial(numpy_model.step, x), 1),
        "Jacobian, NumPy": (partial(numpy_model.jacobian, x), 1),
    }
    for size in BATCHES:
        many = np.repeat(x[None], size, axis=0)
        calls[f"step, per state of {size}"] = (partial(plant.step, 0.0, many, u, plant.dt), size)
        calls[f"step, NumPy, per state of {size}"] = (partial(numpy_model.step, many), size)
    times = best_times({name: call for name, (call, _) in calls.items()}, seconds)
    return [_row("model", plant, "none", name, "step_time", times[name], 1 / size) for name, (_, size) in calls.items()]


def scaling(seconds: float) -> list[Row]:
    """The ensemble filter on finer and finer pipelines, every node with its sensors, and the extended bank on one of them."""
    rows = []
    for nodes in NODES:
        plant = gas_pipeline(nodes=nodes)
        rows += timed_with_memory(plant, "fusing-enkf", f"{nodes} nodes", *ensemble_calls(plant), "model", seconds)
    for nodes in BANK_NODES:
        plant = gas_pipeline(nodes=nodes)
        whole = repeated_step(FusingBank(plant, Extended(), thresholds=tuple((QUIET * plant.sensor_sigma).tolist())))
        one = repeated_step(CentralFilter(plant, Extended()))
        rows += timed_with_memory(plant, "fusing-ekf", f"{nodes} nodes", whole, one, "one filter", seconds)
    return rows


def timed_with_memory(
    plant: Plant, detector: str, where: str, whole: Call, other: Call, name: str, seconds: float
) -> list[Row]:
    """Time and memory of a call, and the time of another beside it."""
    memory = Timing(peak_memory(whole), 1)
    times = best_times({where: whole, f"{where}, {name}": other}, seconds)
    rows = [_row("scaling", plant, detector, q, "step_time", time) for q, time in times.items()]
    return [*rows, _row("scaling", plant, detector, where, "peak_memory", memory)]


def ensemble_calls(plant: Plant) -> tuple[Call, Call]:
    """Predict and update of an ensemble without any matrix of all states, and the model's step of it alone."""
    settings, rng = enkf.EnKFSettings(), np.random.default_rng(0)
    u = plant.input_at(0.0)
    members = plant.x0 + sample(plant.initial_cov, rng, (settings.size,))
    y = plant.output(0.0, plant.x0, u) + sample(plant.sensor_cov, rng)

    def advance(states: Array) -> Array:
        return plant.step(0.0, states, u, plant.dt)

    def step() -> Array:
        ahead = enkf.predict(members, advance, plant.process_cov, rng)
        return enkf.update(settings, ahead, lambda s: plant.output(0.0, s, u), y, plant.sensor_cov, rng)

    return step, lambda: advance(members)


def lorenz(seconds: float) -> list[Row]:
    """Single filters on Lorenz-96."""
    rows = []
    for source in bench_lorenz.MODELS:
        plant = bench_lorenz.lorenz_96(source)
        for kind in ("kf", "ukf", "enkf"):
            ours, theirs = bench_lorenz.pairs(kind, source)
            times = best_times({"ours": ours, "filterpy": theirs}, seconds)
            rows += [_row("lorenz", plant, kind, f"{q}, {source}", "step_time", time) for q, time in times.items()]
            ratio = 1 / times["ours"].best
            rows.append(_row("lorenz", plant, kind, f"filterpy, {source}", "speedup", times["filterpy"], ratio))
    return rows


def engine(seconds: float) -> list[Row]:
    """The engine's modules, and the bounds of its algebraic variables by codac where it is installed."""
    found = bench_engine.detector()
    row = partial(_row, "engine", found.plant, "adaptive-threshold")
    time = best_times({"ours": bench_engine.step_call()}, seconds)["ours"]
    one = time.best / bench_engine.RUNS
    rows = [row("all modules", "step_time", time, 1 / bench_engine.RUNS)]
    for tolerance in TOLERANCES if find_spec("codac") else ():
        times = best_times(bench_engine.codac_calls(tolerance), seconds)
        every = Timing(sum(t.best for t in times.values()), min(t.calls for t in times.values()))
        where = f"codac, {tolerance:g} noise bounds"
        rows += [
            row(where, "step_time", every),
            row(where, "speedup", every, 1 / one),
            row(f"{where}, one call", "speedup", min(times.values()), 1 / one),
        ]
    return rows


PARTS: dict[str, Callable[[float], list[Row]]] = {
    "bank": bank,
    "model": model,
    "scaling": scaling,
    "lorenz": lorenz,
    "engine": engine,
}


def run(parts: Sequence[str], out: Path | None = None, seconds: float = SECONDS, *, force: bool = False) -> list[Row]:
    """Return the rows of some parts (none: all), each call timed for about `seconds`; into out/metrics.csv where out is given.

    Raises ValueError for an unknown part and where the folder is not free (see output.require_free).
    """
    unknown = [part for part in parts if part not in PARTS]
    if unknown:
        raise ValueError(f"unknown part {', '.join(unknown)} of the benchmark; known: {', '.join(PARTS)}")
    if out is not None:
        require_free(out, force=force)
    with threadpool_limits(1):
        rows = [row for part in parts or PARTS for row in PARTS[part](seconds)]
    if out is not None:
        write_rows(out / "metrics.csv", rows)
    return rows


def repeated_step(detector: Detector) -> Call:
    """A call that repeats one step of the detector, on healthy readings, always from the same settled state."""
    plant = detector.plant
    healthy = simulate(plant, SETTLED + 1, [1], truth="model")
    y, u = healthy.y[:, 0], healthy.u
    state = detector.init((), float(healthy.t[0]) - plant.dt)
    for time, reading, applied in zip(healthy.t[:-1], y[:-1], u[:-1], strict=True):
        state, _ = detector.step(state, float(time), reading, applied)
    last = float(healthy.t[-1])
    return lambda: detector.step(state, last, y[-1], u[-1])


def peak_memory(call: Call) -> float:
    """Bytes that a call allocates at its peak, of what Python and NumPy allocate."""
    call()
    tracemalloc.start()
    call()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return float(peak)


def _row(part: str, plant: Plant, detector: str, quantity: str, metric: str, time: Timing, factor: float = 1.0) -> Row:
    return Row(f"bench/{part}", plant.name, detector, "none", quantity, metric, time.best * factor, n=time.calls)


def as_text(row: Row) -> str:
    """A row for people: times in ms, memory in MB."""
    factor, unit = {"step_time": (1e3, " ms"), "peak_memory": (1e-6, " MB")}.get(row.metric, (1.0, ""))
    part = row.scenario.removeprefix("bench/")
    return f"{part:<8} {row.detector:<12} {row.quantity:<32} {row.metric:<12} {row.value * factor:10.4g}{unit}"
