"""Runs of engine/virtual-sensors: three faults of a marine engine, by its modules alone and with virtual sensors.

V22: Kougiatsos and Reppa 2022, "A distributed virtual sensor scheme for marine fuel engines". Its MAPE of a module is the mean
of |f^ - f| / |f| from a time t_0 on, f^ = 0 before the module's sensor is isolated. In whole runs
intervals are by corners, also for M(2,3), which V22 inverts by SIVIA: the two are compared on short runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from fusion_sfdia.benchmarks.engine.support.trials import (
    CHUNK,
    DETECTORS,
    SAMPLING,
    Array,
    Results,
    engine,
    offsets,
    proof,
    recording,
    tasks,
    trial,
)
from fusion_sfdia.detectors.adaptive_thresholds.virtual_sensors import VirtualSensors
from fusion_sfdia.detectors.registry import require_known
from fusion_sfdia.models.marine_engine.published import PublishedOffset
from fusion_sfdia.report.results import AT_MOST, Published
from fusion_sfdia.study.experiments.scenario import Arrays, Settings, Task, seed_blocks

NAME, FAULT, DETECTOR = "engine/virtual-sensors", "three-faults", "virtual-sensors"
V22 = "Kougiatsos and Reppa 2022, sec. 5, one run"
FAULTS = (
    PublishedOffset("S(2){3}", 10.0, 5e3),
    PublishedOffset("S(3){1}", 10.0, 5e4),
    PublishedOffset("S(4){2}", 20.0, 100.0),
)  # N m, Pa, K
SIZED = ("M(2,3)", "M(3,1)", "M(4,2)")  # the modules of these sensors
SINCE = (40.0, 20.0, 20.0)  # s, t_0
MAPE = (8.76, 0.26, 3.74)  # percent
LEARNING_RATES = {"fuel": 0.5, "p_receiver": 8.7, "p_charge": 5.0}  # 1/s
DELAYED = Published(10.0, f"{V22}: almost")  # s, isolation of M(2,3)
IDENTIFIED = {  # s
    "M(2,3)": Published(30.0, f"{V22}: within" + AT_MOST),
    "M(3,1)": Published(10.0, f"{V22}: within approximately" + AT_MOST),
}
REMAINS = 0.05  # of the fault, once an adaptive observer has identified it; ours
WITHIN = MAPE[0] / 100  # of the fault, once M(2,3) has identified it: its error in V22
DURATION = 100.0  # s
SHORT_FAULTS, SHORT = tuple(f._replace(onset=f.onset / 50) for f in FAULTS), 3.0  # s, where inversions are compared
KEPT = 0.1  # s between the samples that are drawn

PRINTED, INTERSECTED, GUARANTEED = "as printed", "intersected", "interval alone"
VARIANTS: dict[str, dict[str, Any]] = {
    PRINTED: {"learning_rates": LEARNING_RATES, "intersect": False},
    INTERSECTED: {"learning_rates": LEARNING_RATES},
    GUARANTEED: {},
}
INVERSIONS = ("corners", "sivia")


@cache
def virtual_sensors(noise: float, variant: str, inversion: str, sampling: float = SAMPLING) -> VirtualSensors:
    """The detector on the engine with the observers of V22, built once for all tasks of a process."""
    detector = VirtualSensors(engine(noise, "K22", sampling), inversion=inversion, **VARIANTS[variant])
    vars(detector.thresholds)["slopes"] = proof(noise, "K24")  # the cached property: seconds, and the same for all
    return detector


def sensor_tasks(settings: Settings, seeds: int) -> list[Task]:
    """The modules without reconstructed readings, each variant with them, and both inversions on few short runs."""
    if not settings["duration"] > (least := max(SINCE) + 1):
        raise ValueError(
            f"setting duration is {settings['duration']} s; expected more than {least:g}: errors are averaged from "
            f"{max(SINCE):g} s on"
        )
    if settings["inversion_seeds"] < 0:
        raise ValueError(f"setting inversion_seeds is {settings['inversion_seeds']}; expected 0 or more")
    for v in settings["variants"]:
        require_known("variant", v, VARIANTS)
    alone = tasks({**settings, "detectors": DETECTORS[:1]}, FAULTS, seeds, design="K22")
    common = {k: settings[k] for k in ("noise", "sampling")}
    whole = common | {"duration": settings["duration"], "faults": [list(f) for f in FAULTS]}
    short = common | {"duration": SHORT, "faults": [list(f) for f in SHORT_FAULTS]}
    fed = [
        whole | {"variant": v, "inversion": "corners", "seeds": block}
        for block in seed_blocks(seeds, CHUNK)
        for v in settings["variants"]
    ]
    few = seed_blocks(settings["inversion_seeds"], CHUNK)
    return [
        *alone,
        *fed,
        *(short | {"variant": GUARANTEED, "inversion": i, "seeds": block} for block in few for i in INVERSIONS),
    ]


def sensor_work(task: Task) -> Arrays:
    """Runs through the monitoring modules, or the virtual sensors: arrays as in `follow`."""
    if "detector" in task:
        return trial(task)
    detector = virtual_sensors(task["noise"], task["variant"], task["inversion"], task["sampling"])
    healthy = recording(task["noise"], round(task["duration"] / detector.plant.dt), tuple(task["seeds"]), task["sampling"])
    y = offsets(detector.plant, healthy.t, healthy.y, task["faults"])
    return follow(detector, healthy.t, y, healthy.u, healthy.signal, [PublishedOffset(*f) for f in task["faults"]], SINCE)


def follow(
    detector: VirtualSensors,
    t: Array,
    y: Array,
    u: Array,
    signal: Array,
    faults: Sequence[PublishedOffset],
    from_: Sequence[float],
) -> Arrays:
    """Decisions of virtual sensors on readings y (K, B, N) of `signal` (K, B, N) at t (K,) under u (K, m), of the F faults.

    from_ (F,): t_0 of the errors, s.

    first (B, N): when each sensor was isolated, s, inf for never. mape (B, F), percent. inside (B, F): samples since then whose
    interval contains the fault, of the `isolated` (B, F) ones. width (B, F): of the last interval over the fault, NaN where it
    is empty.
    square, square_faulty (B, F): mean squared error of the reconstructed and of the faulty reading since t_0.
    rise (B, F): s from the isolation until the estimate reaches 1 - REMAINS of the fault, NaN for never. settled (B, F): s from
    the isolation until the error is below WITHIN of the fault for good, inf where it is not at the end.
    trace (4, B, duration / KEPT, N): time, the fault's estimate, and the ends of its interval.
    """
    own = [detector.plant.sensor_index(f.sensor) for f in faults]
    true, since = np.array([f.magnitude for f in faults]), np.minimum(from_, t[-1])
    runs, count = y.shape[1:]
    state = detector.init((runs,), float(t[0]) - detector.plant.dt)
    first, (rise, settled) = np.full((runs, count), np.inf), np.full((2, runs, len(faults)), np.nan)
    ape, inside, isolated, square, square_faulty = np.zeros((5, runs, len(faults)))
    kept = max(1, round(KEPT / detector.plant.dt))
    trace = np.zeros((4, runs, t.size // kept, count), np.float32)
    for k, now in enumerate(t):
        state, decision = detector.step(state, float(now), y[k], u[k])
        held, size = detector.fault_interval(state), np.nan_to_num(decision.fault_size)
        first = np.where(decision.isolated, np.minimum(first, now), first)
        found = decision.isolated[:, own]
        error = np.abs(size[:, own] / true - 1)
        risen = found & (size[:, own] >= (1 - REMAINS) * true) & np.isnan(rise)
        rise = np.where(risen, now - first[:, own], rise)
        settled = np.where(found & (error <= WITHIN), np.fmin(settled, now - first[:, own]), np.nan)
        inside += found & (held.lo[:, own] <= true) & (true <= held.hi[:, own])
        isolated += found
        late = now >= since - detector.plant.dt / 2
        ape += np.where(late, 100 * error, 0.0)
        square += np.where(late, (decision.reconstruction - signal[k])[:, own] ** 2, 0.0)
        square_faulty += np.where(late, (y[k] - signal[k])[:, own] ** 2, 0.0)
        if (k + 1) % kept == 0:
            limits = (np.where(decision.isolated, end, np.nan) for end in (held.lo, held.hi))
            trace[:, :, k // kept] = np.stack([np.full_like(size, now), size, *limits])
    samples = (t[:, None] >= since - detector.plant.dt / 2).sum(axis=0)
    last = detector.fault_interval(state)
    return {
        "first": first,
        "mape": ape / samples,
        "inside": inside,
        "isolated": isolated,
        "width": (last.hi - last.lo)[:, own] / true,
        "square": square / samples,
        "square_faulty": square_faulty / samples,
        "rise": rise,
        "settled": np.where(np.isnan(settled), np.inf, settled),
        "trace": trace,
    }


def by_kind(results: Results) -> dict[str, Arrays]:
    """The arrays of all tasks joined: modules alone ("alone"), each variant, and each inversion on short runs."""
    parts: dict[str, list[Arrays]] = {}
    for task, arrays in results:
        kind = "alone" if "detector" in task else task["inversion"] if task["duration"] == SHORT else task["variant"]
        parts.setdefault(kind, []).append(arrays)
    return {
        kind: {
            k: np.concatenate([p[k] for p in found], axis=int(k == "trace"))
            for k in found[0]
            if k != "trace" or kind != "alone"
        }
        for kind, found in parts.items()
    }
