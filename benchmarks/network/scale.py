"""network/scale: time and memory of the diagnosed network against its size, of a change of it, and on two processes; and of
robust banks of its areas.

Times depend on the machine and the run: only these numbers differ in a second run.
"""

from __future__ import annotations

import logging
import multiprocessing
from functools import partial
from importlib.util import find_spec
from time import perf_counter, thread_time
from typing import Any

import numpy as np
from matplotlib.figure import Figure as Drawing
from numpy.typing import NDArray

from fusion_sfdia.benchmarks.network.support.robust_scale import growth, robust_step
from fusion_sfdia.benchmarks.network.support.rows import row
from fusion_sfdia.common.run_statistics import NOTHING
from fusion_sfdia.detectors.stochastic_thresholds.consensus import Diagnosers, NetworkReadings, initial_state
from fusion_sfdia.detectors.stochastic_thresholds.network_step import network_step, terms_of
from fusion_sfdia.detectors.stochastic_thresholds.partitioned_network import PartitionedNetwork
from fusion_sfdia.models.power_network.diagnosis import network_areas
from fusion_sfdia.models.power_network.model import NetworkModel, network_model
from fusion_sfdia.models.power_network.parameters import generate_network
from fusion_sfdia.models.power_network.running import RunningNetwork
from fusion_sfdia.plant.areas import Areas
from fusion_sfdia.report.content import Figure, Summary
from fusion_sfdia.report.plots import panels
from fusion_sfdia.report.results import Published, Row
from fusion_sfdia.study.experiments.scenario import Arrays, Scenario, Settings, Task
from fusion_sfdia.study.experiments.timing import Timing, best_times

Array = NDArray[Any]

NAME, DETECTOR, ROBUST = "network/scale", "chebyshev:corrected", "robust-glr:areas"
PAPER_AREAS = 15
PUBLISHED = Published(4.1e-3, "Boem 2018, sec. VIII (one area, worst case, Matlab on an i7 of 2.2 GHz)")
ALPHA, LAM = 2.0, 0.3  # B18, sec. VIII
AWAY = "8"  # the area that leaves and joins
PARTS = 2
CLUSTER = ("distributed", "cryptography")  # the packages of a cluster with certificates of its own
LONG = 10_000  # areas: a longer step is interrupted on a busy machine, so that its processor time is measured


class Constant:
    """The same readings at every step, drawn where they are used. No branch depends on them: all steps take the same time."""

    def __init__(self, n: int) -> None:
        self.n = n
        self.kept: NetworkReadings | None = None

    def __call__(self, k: int, areas: tuple[int, int], sides: Array) -> NetworkReadings:
        if self.kept is None:
            rng, count = np.random.default_rng(areas[0]), areas[1] - areas[0]
            own, shared = 1e-3 * rng.standard_normal((1, count, self.n)), 1e-3 * rng.standard_normal((1, sides.size))
            reference, load = 1e-2 * rng.standard_normal((2, 1, count))
            self.kept = NetworkReadings(own, shared, reference, load)
        return self.kept


def network_of(areas: int) -> NetworkModel:
    """The network of B18, or a generated one of another size."""
    return network_model(None if areas == PAPER_AREAS else generate_network(areas, 0))


def stepping(areas: Areas) -> tuple[partial[None], list[Array]]:
    """A call that computes one step after the other in the same memory, and the arrays that a step reads or writes."""
    count, n, sides = areas.size
    given = Constant(n)(0, (0, count), np.arange(sides))
    terms = terms_of(areas.arrays)
    turns: list[Diagnosers] = [initial_state(areas, (1,)), initial_state(areas, (1,))]

    def step() -> None:
        now, _ = network_step(areas, turns[0], given, ALPHA, LAM, out=turns[1], terms=terms)
        turns[:] = [now, turns[0]]

    at = areas.arrays
    model = [at.matrices, at.slope, at.closed, at.start, at.opposite, at.reader]
    return partial(step), [*model, *terms, *turns[0], *turns[1], *given, np.empty(count, np.bool_)]


def scale_tasks(settings: Settings, seeds: int) -> list[Task]:
    """One task for each size, the same for robust banks, and on two processes where the packages of CLUSTER are installed."""
    sizes, seconds = settings["areas"], settings["seconds"]
    parts = [PAPER_AREAS, *settings["parts"]] if settings["parts"] and all(map(find_spec, CLUSTER)) else []
    tasks = [{"kind": "one", "areas": n, "seconds": seconds} for n in sizes]
    others = [*(("robust", n) for n in settings["robust"]), *(("parts", n) for n in parts)]
    return [*tasks, *({"kind": kind, "areas": n, "seconds": seconds} for kind, n in others)]


def scale_work(task: Task) -> Arrays:
    """Least seconds of what was timed and how often, (2,) each; bytes () of all that a step reads or writes."""
    areas, seconds = task["areas"], task["seconds"]
    if task["kind"] == "robust":
        return robust_step(network_of(areas), seconds)
    return in_parts(areas, seconds) if task["kind"] == "parts" else in_one(areas, seconds)


def in_one(areas: int, seconds: float) -> Arrays:
    """One core: processor time of a step, and of a change in place and as another model."""
    model = network_of(areas)
    running = RunningNetwork(model)
    step, arrays = stepping(running.areas)

    def in_place() -> None:
        running.switch(unplug=[AWAY])
        running.switch(plug_in=[AWAY])

    clock = thread_time if areas > LONG else perf_counter
    times = best_times({"step": step}, seconds, clock)
    times |= best_times({"in_place": in_place, "copied": partial(model.switched, unplug=[AWAY])}, seconds, clock)
    times["in_place"] = times["in_place"]._replace(best=times["in_place"].best / 2)
    return {"bytes": np.array(sum(a.nbytes for a in arrays)), **_arrays(times)}


def in_parts(areas: int, seconds: float) -> Arrays:
    """Two processes of one thread against this one, taking turns: seconds on the clock.

    They use TLS with a certificate made for this cluster alone: without it, anyone who reaches a dask scheduler can run code.
    """
    from distributed import Client, LocalCluster

    whole = network_areas(network_of(areas), named=False)
    step, _ = stepping(whole)
    multiprocessing.set_start_method("spawn", force=True)  # joblib's own, in its workers, is unknown to those of the cluster
    with (
        LocalCluster(
            n_workers=PARTS,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
            security=True,
        ) as cluster,
        Client(cluster, set_as_default=False, direct_to_workers=True) as client,
    ):
        parts = PartitionedNetwork(client, whole, initial_state(whole, (1,)), Constant(whole.size[1]), ALPHA, LAM)
        return _arrays(best_times({"step": step, "parts": parts.step}, seconds))


def _arrays(times: dict[str, Timing]) -> Arrays:
    return {name: np.array(time, dtype=float) for name, time in times.items()}


def scale_summary(settings: Settings, results: list[tuple[Task, Arrays]]) -> Summary:
    """Rows, the figure, and the times per area."""
    rows: list[Row] = []

    def add(
        quantity: str, metric: str, value: float, n: float, *, condition: str = "", stated: Published | None = None,
        detector: str = DETECTOR,
    ) -> None:  # fmt: skip
        estimate = NOTHING._replace(value=value, n=int(n))
        rows.append(row(NAME, detector, "none", quantity, metric, estimate, stated, condition=condition))

    one, parts, robust = ({t["areas"]: a for t, a in results if t["kind"] == kind} for kind in ("one", "parts", "robust"))
    for areas, found in one.items():
        step, calls = found["step"]
        add(f"{areas} areas", "step_time", step, calls)
        add(f"one of {areas} areas", "step_time", step / areas, calls, stated=PUBLISHED if areas == PAPER_AREAS else None)
        add(f"one of {areas} areas", "peak_memory", found["bytes"] / areas, 1)
        add(f"{areas} areas", "replug_time", *found["in_place"], condition="in place")
        add(f"{areas} areas", "replug_time", *found["copied"], condition="another model")
    for areas, found in parts.items():
        where = f"{PARTS} processes"
        add(f"{areas} areas", "step_time", *found["parts"], condition=where)
        add(f"{areas} areas", "speedup", found["step"][0] / found["parts"][0], found["parts"][1], condition=where)
    for areas, found in robust.items():
        step, calls = found["step"]
        add(f"{areas} areas", "step_time", step, calls, detector=ROBUST)
        add(f"one of {areas} areas", "step_time", step / areas, calls, detector=ROBUST)
        add(f"one of {areas} areas", "peak_memory", found["bytes"] / areas, 1, detector=ROBUST)
    each = {areas: found["step"][0] / areas for areas, found in one.items()}
    remarks = [
        f"Least times, for more than {LONG} areas on one core its processor time. A step computes the estimates, thresholds, "
        "weights, stored readings and alarms of all areas. Memory is that of all arrays that a step reads or writes, "
        "including two states, without the names of areas, states and sensors.",
    ]
    if robust:
        remarks.append(growth(robust))
    if PAPER_AREAS in parts and each:
        barrier, largest = parts[PAPER_AREAS]["parts"][0], max(each)
        count = parts[PAPER_AREAS]["parts"][1]
        add("areas in a part", "break_even", barrier / each[largest], count, condition="two free cores")
        remarks.append(
            f"A step of {PARTS} processes takes {1e3 * barrier:.3g} ms however few the areas, so it pays from about "
            f"{barrier / each[largest]:.2g} areas in each part on, if each has its own core and memory."
        )
    elif not parts:
        remarks.append("Several processes were not measured: that needs the packages distributed and cryptography.")
    times = "; ".join(f"{n} areas {1e6 * found['step'][0]:.3g} us" for n, found in one.items())
    figure = Figure(
        "time",
        "Time of a step and of a change",
        f"One core. Least time of a step, for each area: {'; '.join(f'{n} areas {1e9 * s:.0f} ns' for n, s in each.items())}.",
        partial(draw, one),
        "Times of a step and of unplugging an area against the number of areas, both axes logarithmic",
    )
    return Summary(
        rows, [figure] if one else [], highlights=[f"A step of all diagnosers on one core: {times}"], remarks=remarks
    )


def draw(one: dict[int, Arrays]) -> Drawing:
    """Times against the number of areas."""
    figure, (axes,) = panels([""], columns=1)
    sizes = sorted(one)
    for name, label, marker in (
        ("step", "a step", "o"),
        ("copied", "another model", "s"),
        ("in_place", "change in place", "^"),
    ):
        axes.loglog(sizes, [one[n][name][0] for n in sizes], marker=marker, label=label)
    axes.set(xlabel="areas", ylabel="time (s)")
    axes.legend()
    return figure


SCENARIO = Scenario(
    name=NAME,
    title="Speed and scale of the diagnosed power network",
    about="Time and memory of a step of all diagnosers against the number of areas, of unplugging and plugging in an area, and "
    "of a network on two processes; the same of robust banks of the areas. Boem 2018 states 4.1 ms for a step of one area.",
    settings={"areas": (15, 1500, 150000), "parts": (150000,), "robust": (15, 150, 1500), "seconds": 2.0},
    seeds=1,
    full_seeds=1,
    tasks=scale_tasks,
    work=scale_work,
    summarise=scale_summary,
    full={"areas": (15, 1500, 150000, 1500000)},
    bounds=dict.fromkeys(("areas", "parts", "robust"), (int(AWAY) + 1, 1e7)),
    optional=("parts", "robust"),
    papers=("boem2018",),
)
