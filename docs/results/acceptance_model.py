"""Conditions S1 to S7 of acceptance.py: a commissioned, frozen model beside wrong equations, slow drifts and slow changes."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parents[1] / "tests" / "helpers")]

from acceptance import Row  # noqa: E402
from unseen_laws import UNSEEN  # noqa: E402  (tests/helpers)
from wrong_laws import DT, WrongLaw, drift  # noqa: E402

from fusion_sfdia.detectors import registry  # noqa: E402
from fusion_sfdia.detectors.detector import Decision, run  # noqa: E402
from fusion_sfdia.detectors.saved_detectors import load_detector, save_detector  # noqa: E402
from fusion_sfdia.diagnosis.simulate import simulate  # noqa: E402
from fusion_sfdia.learning.frozen_model.frozen_bank import OUTSIDE, FrozenBank  # noqa: E402
from fusion_sfdia.learning.tuning.tune import tune  # noqa: E402
from fusion_sfdia.plant.log import Log  # noqa: E402
from fusion_sfdia.plant.plant import Plant  # noqa: E402
from fusion_sfdia.study.truths import Variation, varied  # noqa: E402

Array = NDArray[Any]

AFTER = 30  # rows after the end of a fault from which on a sensor that is isolated is false
ONSET = 400  # row at which faults begin: all windows are full
MARGIN = 0.03  # of the usual faults


@dataclass(frozen=True)
class Sizes:
    """How much is measured: days learnt, the plants with a wrong law, clean days and runs of each, rows, seed."""

    days: float = 7.0
    plants: tuple[Callable[[], WrongLaw], ...] = UNSEEN
    clean: int = 8
    runs: int = 2
    lengths: tuple[int, ...] = (300, 1000, 3000)
    repeats: int = 16
    seed: int = 6100


class Said(NamedTuple):
    """What is said of each row of B runs: sensors isolated (K, B, N), suspects (K, B, N + P), and the process (K, B, P)."""

    isolated: Array
    suspect: Array
    process: Array

    def wrong(self, right: Sequence[int]) -> Array:
        """Rows in which another sensor is isolated than that of each run, -1 for none (K, B)."""
        others = np.arange(self.isolated.shape[2]) != np.asarray(right)[:, None]
        return np.asarray((self.isolated & others).any(axis=2))

    def named(self, right: Sequence[int]) -> Array:
        """Rows in which the sensor of each run, and no other, is isolated (K, B)."""
        own = np.take_along_axis(self.isolated, np.asarray(right)[None, :, None], axis=2)[..., 0]
        return np.asarray(own & ~self.wrong(right))

    def suspected(self, right: Sequence[int]) -> Array:
        """Rows in which no sensor is isolated and that of each run is a suspect (K, B)."""
        own = np.take_along_axis(self.suspect, np.asarray(right)[None, :, None], axis=2)[..., 0]
        return np.asarray(own & ~self.isolated.any(axis=2))


def said(detector: FrozenBank, logs: Sequence[Log]) -> Said:
    """Of logs of one length, judged side by side."""
    t = logs[0].t
    together = Log(t, np.stack([log.y for log in logs], axis=1), np.stack([log.u for log in logs], axis=1))
    d: Decision = run(detector, detector.init((len(logs),), float(t[0]) - detector.plant.dt), together)[1]
    assert d.process is not None and d.suspect is not None
    inside = np.array([h.name != OUTSIDE.name for h in detector.process_hypotheses])
    return Said(d.isolated, d.suspect, d.process[..., inside])


@cache
def learnt(make: Callable[[], WrongLaw], days: float, seed: int) -> tuple[WrongLaw, FrozenBank]:
    """A plant with a wrong law, and what `tune` makes of some healthy days of it."""
    law = make()
    return law, tune(law.plant(), law.record(days, seed, building=seed)).detector(law.plant())


@cache
def commissioned(name: str, seed: int) -> tuple[Plant, FrozenBank]:
    """A plant of the project, and what `tune` makes of 3 000 healthy rows of it."""
    plant = registry.plant(name)
    return plant, tune(plant, simulate(plant, 3000, [seed]), false_alarm=1 / 3000).detector(plant)


def clean_days(of: Sizes) -> Iterator[Row]:
    """S1: healthy days of a plant with a wrong law, closed loop, 5 % errors, correlated noise, rounding."""
    for make in of.plants:
        law, detector = learnt(make, of.days, of.seed)
        found = said(detector, [law.record(1, of.seed + 1 + s, building=of.seed) for s in range(of.clean)])
        yield Row("S1", law.name, "healthy sensor isolated", "<= 0.002", float(found.isolated.any(axis=2).mean()), of.clean)
        yield Row("S1", law.name, "suspects", "<= 0.02", float(found.suspect.any(axis=2).mean()), of.clean)


def faults_beside_a_wrong_law(of: Sizes) -> Iterator[Row]:
    """S2: drifts of 10 sigma in 300 rows, biases of 10 sigma, freezes, and changes of the process by 30 %."""
    for make in of.plants:
        law, detector = learnt(make, of.days, of.seed)
        count, causes = len(law.sensors), len(law.parameters)
        sensors = np.repeat(np.arange(count), of.runs)
        seeds = iter(range(of.seed + 100, of.seed + 1000))
        record = partial(law.record, 0.65, building=of.seed)
        sign = np.where(np.arange(sensors.size) % 2, -10.0, 10.0)
        start, rows = ONSET * DT, slice(ONSET, ONSET + 300)
        pairs = list(zip(sensors.tolist(), sign.tolist(), strict=True))
        found = said(detector, [record(next(seeds), bias=drift(i, count, start, 300, s)) for i, s in pairs])
        right, suspects = (a[rows].mean(axis=0) for a in (found.named(sensors), found.suspected(sensors)))
        each = right.reshape(count, of.runs).mean(axis=1)
        after = found.isolated[ONSET + 300 + AFTER :].any(axis=2)
        n = sensors.size
        yield Row("S2", law.name, "drift: another sensor isolated", "<= 0.005", float(found.wrong(sensors)[rows].mean()), n)
        least = (right + suspects).reshape(count, of.runs).mean(axis=1)
        yield Row("S2", law.name, "drift: right or among suspects, least sensor", ">= 0.6", float(least.min()), n)
        yield Row("S2", law.name, "drift: isolated after its end", "<= 0.02", float(after.mean()), n)
        yield Row("S2", law.name, "drift: right, median sensor", ">= 0.65", float(np.median(each)), n)
        found = said(detector, [record(next(seeds), bias=drift(i, count, start, 1, s, 299)) for i, s in pairs])
        each = found.named(sensors)[rows].mean(axis=0).reshape(count, of.runs).mean(axis=1)
        yield Row("S2", law.name, "bias: right", ">= 0.95", float(each.mean()), n)
        rows = slice(ONSET, ONSET + 120)
        found = said(detector, [record(next(seeds), stuck=(i, ONSET, ONSET + 120)) for i, _ in pairs])
        yield Row("S2", law.name, "freeze: right", ">= 0.8", float(found.named(sensors)[rows].mean()), n)
        changes = [(j, length) for length in (60, 300) for j in range(causes) for _ in range(of.runs)]
        logs = [
            record(next(seeds), change=partial(_weaker, causes, j, length, 1 - 2 * (k % 2)))
            for k, (j, length) in enumerate(changes)
        ]
        found = said(detector, logs)
        seen = found.process.any(axis=2)[ONSET:].any(axis=0)
        yield Row("S2", law.name, "process: found", ">= 0.95", float(seen.mean()), len(changes))
        blamed = found.isolated[ONSET:].any(axis=2)
        yield Row("S2", law.name, "process: sensor isolated", "<= 0.01", float(blamed.mean()), len(changes))


def _weaker(causes: int, cause: int, rows: int, sign: int, t: Array) -> Array:
    factor = np.ones((t.size, causes))
    factor[:, cause] -= sign * 0.3 * np.clip((t / DT - ONSET) / rows, 0, 1)
    return factor


CHANGES = {"two-tanks": (("outlet_1", "outlet_2"), 1), "marine-engine": (("turbine_area",), -1)}  # and their direction
TOLD_APART = {"two-tanks": ("q12", "q2")}  # sensors that no unknown looks like; elsewhere all


def slow_changes(of: Sizes) -> Iterator[Row]:
    """S3: the two tanks and the engine: outlets that widen, a turbine that fouls, drifts of 10 sigma, in 300 to 3 000 rows."""
    for name, (causes, direction) in CHANGES.items():
        plant, detector = commissioned(name, of.seed)
        nominal = {p.name: p.nominal for p in plant.uncertainty.parameters}
        sensors = np.repeat(np.arange(len(plant.sensors)), max(of.repeats // len(plant.sensors), 1))
        healthy = said(detector, _runs(simulate(plant, 1500, _seeds(of, 0))))
        yield Row("S3", name, "healthy: sensor isolated", "<= 0.005", _share(healthy.isolated[ONSET:]), of.repeats)
        for length in of.lengths:
            rows, steps, onset = slice(ONSET, ONSET + length), ONSET + length + 300, ONSET * plant.dt
            for k, percent in enumerate((3, 9, 15)):
                part = direction * percent / 100
                truth = varied(plant, [Variation(c, part * nominal[c], "ramp", onset, length * plant.dt) for c in causes])
                found = said(detector, _runs(simulate(plant, steps, _seeds(of, length + k), truth=truth)))
                what, seen = f"process {percent} % in {length}", found.process[rows].any(axis=(0, 2))
                yield Row("S3", name, f"{what}: found", ">= 1", float(seen.mean()), of.repeats)
                yield Row("S3", name, f"{what}: sensor isolated", "<= 0.02", _share(found.isolated[rows]), of.repeats)
            logs = _runs(simulate(plant, steps, range(of.seed + 50 * length, of.seed + 50 * length + sensors.size)))
            for k, i in enumerate(sensors):
                logs[k].y[rows, i] += 10 * (-1) ** k * plant.sensor_sigma[i] * np.linspace(0, 1, length)
            found, what = said(detector, logs), f"drift in {length}"
            right, suspects = found.named(sensors)[rows].mean(axis=0), found.suspected(sensors)[rows].mean(axis=0)
            apart = np.isin(np.array(plant.sensor_names)[sensors], TOLD_APART.get(name, plant.sensor_names))
            yield Row(
                "S3",
                name,
                f"{what}: another sensor isolated",
                "<= 0.005",
                float(found.wrong(sensors)[rows].mean()),
                sensors.size,
            )
            yield Row(
                "S3", name, f"{what}: right, sensors unlike an unknown", ">= 0.8", float(right[apart].mean()), int(apart.sum())
            )
            if not apart.all():
                yield Row(
                    "S3",
                    name,
                    f"{what}: right or suspects, the others",
                    ">= 0.8",
                    float((right + suspects)[~apart].mean()),
                    int((~apart).sum()),
                )
            yield Row(
                "S3",
                name,
                f"{what}: isolated after its end",
                "<= 0.05",
                _share(found.isolated[rows.stop + AFTER :]),
                sensors.size,
            )


def usual_faults(of: Sizes) -> Iterator[Row]:
    """S4: faults of 60 rows on the two tanks and the engine, exactly isolated, beside `robust-glr`, which adapts."""
    for name in CHANGES:
        plant, detector = commissioned(name, of.seed)
        adaptive, rows = registry.detector("robust-glr", plant), slice(ONSET, ONSET + 60)
        sensors = np.repeat(np.arange(len(plant.sensors)), max(of.repeats // 2, 1))
        for k, (kind, size) in enumerate((("bias", 3), ("bias", 10), ("drift", 10), ("drift", 30))):
            logs = _runs(
                simulate(plant, ONSET + 80, range(of.seed + 200_000 * (k + 1), of.seed + 200_000 * (k + 1) + sensors.size))
            )
            for b, i in enumerate(sensors):
                grown = np.ones(60) if kind == "bias" else np.linspace(0, 1, 60)
                logs[b].y[rows, i] += size * (-1) ** b * plant.sensor_sigma[i] * grown
            ours, other = (float(said(d, logs).named(sensors)[rows].mean()) for d in (detector, adaptive))
            yield Row("S4", name, f"{kind} of {size} sigma: right", f">= {other - MARGIN:.3f}", ours, sensors.size)


def _seeds(of: Sizes, k: int) -> range:
    return range(of.seed + 20 * k, of.seed + 20 * k + of.repeats)


def _runs(found: Any) -> list[Log]:
    u = np.broadcast_to(np.asarray(found.u)[:, None] if found.u.ndim == 2 else found.u, (*found.y.shape[:2], found.u.shape[-1]))
    return [Log(found.t, found.y[:, b].copy(), u[:, b]) for b in range(found.y.shape[1])]


def _share(isolated: Array) -> float:
    """Of rows and runs in which a sensor is isolated."""
    return float(isolated.any(axis=2).mean())


def other_operation(of: Sizes) -> Iterator[Row]:
    """S5: three days learnt; clean days with missing readings and rows, warmer and colder than any that was learnt."""
    for make in of.plants:
        law, detector = learnt(make, min(of.days, 3.0), of.seed + 1)
        cases = {"clean": 0.0, "1 % of readings, 0.5 % of rows missing": 0.0}
        if any(s.unit == "K" for s in law.inputs):
            cases |= {"4 K warmer": 4.0, "6 K colder": -6.0}
        for k, (what, warmer) in enumerate(cases.items()):
            first = of.seed + 3000 + 50 * k
            logs = [law.record(1, first + s, building=of.seed + 1, warmer=warmer) for s in range(max(of.clean // 2, 1))]
            if "missing" in what:
                for s, log in enumerate(logs):
                    rng = np.random.default_rng([first, s])
                    log.y[rng.random(log.y.shape) < 0.01] = np.nan
                    log.y[rng.random(len(log.y)) < 0.005] = np.nan
            found = said(detector, logs)
            yield Row("S5", law.name, f"{what}: sensor isolated", "<= 0.002", _share(found.isolated), len(logs))


def same_decisions(of: Sizes) -> Iterator[Row]:
    """S6: rows of a log with a drift that are decided otherwise one by one, and by a detector that was saved."""
    for make in of.plants:
        law, detector = learnt(make, of.days, of.seed)
        log = law.record(0.4, of.seed + 4000, building=of.seed, bias=drift(1, len(law.sensors), 300 * DT, 200, 10.0))
        first = float(log.t[0]) - DT
        whole = run(detector, detector.init((), first), log)[1]
        with TemporaryDirectory() as folder:
            save_detector(Path(folder) / "saved.npz", detector)
            other = load_detector(Path(folder) / "saved.npz", law.plant())
        state, rows = detector.init((), first), []
        for k in range(len(log.t)):
            state, d = run(detector, state, log.rows(slice(k, k + 1)))
            rows.append((d.isolated[0], d.suspect[0], d.process[0]))
        kept = run(other, other.init((), first), log)[1]
        for what, found in (
            ("row by row", tuple(np.array(a) for a in zip(*rows, strict=True))),
            ("saved and loaded", (kept.isolated, kept.suspect, kept.process)),
        ):
            differ = np.any(
                [np.any(a != b, axis=1) for a, b in zip(found, (whole.isolated, whole.suspect, whole.process), strict=True)],
                axis=0,
            )
            yield Row("S6", law.name, f"{what}: rows decided otherwise", "<= 0", float(differ.sum()), len(log.t))


def cost(of: Sizes) -> Iterator[Row]:
    """S7: CPU time of a row, the frozen model alone, one stream; the least of three runs, as other programs slow it."""
    found = [(*learnt(make, of.days, of.seed), make().record(0.4, of.seed + 5000, building=of.seed)) for make in of.plants]
    for name in CHANGES:
        plant, detector = commissioned(name, of.seed)
        found.append((plant, detector, _runs(simulate(plant, 500, [of.seed + 5000]))[0]))
    for named, detector, log in found:
        plant, times = detector.plant, []
        alone = FrozenBank(plant, frozen=detector.frozen, threshold_scale=detector.threshold_scale)
        for _ in range(3):
            begun = process_time()
            run(alone, alone.init((), float(log.t[0]) - plant.dt), log)
            times.append(process_time() - begun)
        yield Row("S7", named.name, "ms a row", "<= 1", 1e3 * min(times) / len(log.t), len(log.t))


CONDITIONS: dict[str, Callable[[Sizes], Iterator[Row]]] = {
    "S1": clean_days,
    "S2": faults_beside_a_wrong_law,
    "S3": slow_changes,
    "S4": usual_faults,
    "S5": other_operation,
    "S6": same_decisions,
    "S7": cost,
}
