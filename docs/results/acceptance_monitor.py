"""Conditions M1 to M13 of acceptance.py: a monitor that has learnt from healthy logs, without a model."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parents[1] / "tests" / "helpers")]

import real_logs_data as data  # noqa: E402
from acceptance import Row  # noqa: E402
from factor_logs import factors, log_of, runs_with_offsets, signals  # noqa: E402  (tests/helpers)

from fusion_sfdia.learning.monitor.causes import MOVED, OK, ONE_OF, RECORDER, Causes  # noqa: E402
from fusion_sfdia.learning.monitor.monitor import Monitor  # noqa: E402
from fusion_sfdia.plant.log import Log  # noqa: E402

Array = NDArray[Any]

STATED = 0.01


class Sizes(NamedTuple):
    """Where recordings of others are, the first seed, how many made plants or logs, and faults of each kind and size."""

    folder: Path
    seed: int = 7300
    plants: int = 12
    each: int = 9


def learnt(y: Array, *more: Array) -> Monitor:
    """A monitor of made logs (K, N)."""
    return Monitor.of_logs(signals(y.shape[1]), [log_of(one) for one in (y, *more)], false_alarm=STATED)


def judged(monitor: Monitor, log: Log | Array) -> Causes:
    """The verdict of each row of a log without gaps."""
    (found,) = monitor.judge(log if isinstance(log, Log) else log_of(log))
    return found.causes


def off(y: Array, sensor: int, rows: slice, size: float, slope: bool = False) -> Array:
    """Readings with a fault of one sensor; size: in its standard deviations."""
    y = y.copy()
    count = len(y[rows])
    y[rows, sensor] += size * y[:, sensor].std() * (np.linspace(0, 1, count) if slope else 1.0)
    return y


@cache
def chemical(folder: Path) -> tuple[data.Recorded, data.Recorded, Monitor]:
    """The chemical plant's recordings, healthy and with process faults, and what d00 teaches."""
    first, second = data.chemical(str(folder / "tep_braatz"))
    return first, second, Monitor.of_logs(first.sensors, first.healthy, inputs=first.inputs, false_alarm=STATED)


LIMITS = {"bias": (0.75, 0.15, 0.58), "drift": (0.9, 0.2, 0.46), "freeze": (0.95, 0.85, 0.85), "noise": (0.8, 0.5, 0.6)}


def sensors_of_the_chemical_plant(of: Sizes) -> Iterator[Row]:
    """M1: faults of 1, 2 and 4 standard deviations and 120 rows, put into a healthy recording that was not learnt."""
    first, _, monitor = chemical(of.folder)
    later, sd = first.judged[0].log, first.healthy[0].y.std(axis=0)
    found, place = judged(monitor, later), "chemical plant"
    yield Row("M1", place, "healthy: rows in alarm", "<= 0.02", float(found.alarm.mean()), 1)
    yield Row("M1", place, "healthy: rows outside", "<= 0.05", float(found.outside.mean()), 1)
    every, wrong = range(len(sd)), []
    shares: dict[str, list[tuple[bool, float, float]]] = {kind: [] for kind in data.INJECTED}
    for kind, size, i, rng in data.injections([every, every, range(22), range(22)], of.each, seed=of.seed):
        at = int(rng.integers(150, 700))
        rows = slice(at, at + data.FAULTY)
        by = judged(monitor, data.with_fault(later, kind, i, at, size * sd[i], rng).log)
        named, moved = by.named[rows], by.suspect[rows, i] & (by.kind[rows] == MOVED)
        shares[kind].append((bool(by.alarm[rows].any()), float(named[:, i].mean()), float((named[:, i] | moved).mean())))
        wrong.append(float(np.delete(named, i, axis=1).any(axis=1).mean()))
    for kind, limits in LIMITS.items():
        values = np.mean(shares[kind], axis=0)
        for what, limit, value in zip(("found", "rows named", "rows named or moved"), limits, values, strict=True):
            yield Row("M1", place, f"{kind}: {what}", f">= {limit}", float(value), len(shares[kind]))
    yield Row("M1", place, "rows with another sensor named", "<= 0.01", float(np.mean(wrong)), len(wrong))


def process_of_the_chemical_plant(of: Sizes) -> Iterator[Row]:
    """M2: recorded process faults, from their first row on."""
    _, second, monitor = chemical(of.folder)
    for name, one in zip(data.FAULTS, second.judged[1:], strict=True):
        by, first = judged(monitor, one.log), int(np.argmax(one.process))
        yield Row("M2", name, "rows naming a sensor", "<= 0.02", float(by.named[first:].any(axis=1).mean()), 1)
        yield Row("M2", name, "rows in alarm or outside", ">= 0.95", float((by.kind[first:] != OK).mean()), 1)
        kind = next((e.kind for e in monitor.diagnose(one.log).events if e.end >= one.log.t[first]), "none")
        yield Row("M2", name, "first event process or outside", ">= 1", float(kind in ("process", "outside")), 1)


def rates(of: Sizes) -> Iterator[Row]:
    """M3: rows in alarm of logs that were not learnt, at .01: 20 pairs of two tanks, 12 plants of factors, a curved plant."""
    tanks = data.tanks()[0]
    logs = [*tanks.healthy, *(one.log for one in tanks.judged[:3])]
    found, inside = [], []
    pairs = [(triple, next(k for k in range(6) if k not in triple)) for triple in combinations(range(6), 3)]
    monitors = [
        (Monitor.of_logs(tanks.sensors, [logs[k] for k in t], inputs=tanks.inputs, false_alarm=STATED), logs[j])
        for t, j in pairs
    ]
    for k in range(of.plants):
        plant = 10 * (of.seed + k)
        monitors.append((learnt(factors(plant)), log_of(factors(plant + 1))))
    for monitor, log in monitors:
        found.append(float(judged(monitor, log).alarm.mean()))
        inside.append(found[-1] <= monitor.learnt.limits.rate[2])
    n = len(found)
    yield Row("M3", "tanks and factors", "mean rate", "<= 0.01", float(np.mean(found)), n)
    yield Row("M3", "tanks and factors", "logs above 0.02", "<= 3", float(np.sum(np.array(found) > 0.02)), n)
    yield Row("M3", "tanks and factors", "largest rate", "<= 0.035", max(found), n)
    yield Row("M13", "tanks and factors", "logs within the interval that is stated", ">= 28", float(np.sum(inside)), n)
    healthy = [curved(of.seed + k, load) for k, load in enumerate((0.3, 0.3, 0.6, 0.6, 0.9, 0.9))]
    monitor = learnt(*healthy)
    between = [judged(monitor, curved(of.seed + 20 + k, load)) for k, load in enumerate((0.3, 0.45, 0.6, 0.75, 0.9))]
    yield Row("M3", "curved", "rate between learnt loads", "<= 0.01", float(np.mean([c.alarm.mean() for c in between])), 5)
    beyond = judged(monitor, curved(of.seed + 30, 1.2))
    yield Row("M3", "curved", "beyond them: rows outside", ">= 0.85", float(beyond.outside.mean()), 1)
    yield Row("M3", "curved", "beyond them: rows naming a sensor", "<= 0.01", float(beyond.named.any(axis=1).mean()), 1)


def curved(seed: int, load: float, rows: int = 800) -> Array:
    """Six readings that are quadratic in a load that moves about a level."""
    shape, rng = np.random.default_rng(5), np.random.default_rng(seed)
    a, b = shape.standard_normal((2, 6)) * [[2.0], [1.5]]
    f = np.zeros(rows)
    for k in range(1, rows):
        f[k] = 0.97 * f[k - 1] + np.sqrt(1 - 0.97**2) * rng.standard_normal()
    x = (load + 0.03 * f)[:, None]
    return np.asarray(a * x + b * x**2 + 0.03 * rng.standard_normal((rows, 6)))


def river(of: Sizes) -> Iterator[Row]:
    """M3 of a river, fortnights in turn: from what real-logs.csv holds."""
    from real_logs import ALL, load

    cells = load()
    for name, limit in (("Logan river, fortnights in turn", "<= 0.02"), ("Logan river, faults put in", "<= 0.02")):
        yield Row("M3", name, "healthy rows in alarm", limit, cells[name, "monitor", ALL, "alarm"], 10)
    name = "Logan river, faults put in"
    yield Row("M3", name, "freeze: found", ">= 0.55", cells[name, "monitor", "freeze", "found"], 9)
    yield Row("M3", name, "named wrong", "<= 0.05", cells[name, "monitor", ALL, "named wrong"], 36)


def starts_and_stops(of: Sizes) -> Iterator[Row]:
    """M4: a fault from the first row, columns that stop, rows that are skipped, a channel that misses most readings."""
    first, _, monitor = chemical(of.folder)
    later, sd, place = first.judged[0].log, first.healthy[0].y.std(axis=0), "chemical plant"
    alarms, known = [], []
    for i in range(0, len(sd), 2):
        y = later.y.copy()
        y[:, i] += 2 * sd[i] * (-1) ** (i // 2)
        by = judged(monitor, Log(later.t, y, later.u))
        alarms.append(by.alarm.mean())
        known.append((by.named[:, i] | by.suspect[:, i])[by.alarm].mean() if by.alarm.any() else 0.0)
    yield Row("M4", place, "2 sd from the first row: rows in alarm", ">= 0.85", float(np.mean(alarms)), len(alarms))
    yield Row("M4", place, "of these, named or among suspects", ">= 0.8", float(np.mean(known)), len(known))
    for what, value in (("repeat", later.y[400]), ("miss", np.nan)):
        y, u = later.y.copy(), later.u.copy()
        y[400:], u[400:] = value, (later.u[400] if what == "repeat" else np.nan)
        by = judged(monitor, Log(later.t, y, u))
        late = by.kind[400:] == RECORDER
        yield Row(
            "M4", place, f"all columns {what}: rows to `recorder`", "<= 20", float(np.argmax(late)) if late.any() else np.inf, 1
        )
        yield Row("M4", place, f"all columns {what}: rows naming a sensor", "<= 0", float(by.named[400:].any(axis=1).sum()), 1)
    y = later.y.copy()
    y[400:, ::4] = y[400, ::4]
    by = judged(monitor, Log(later.t, y, later.u))
    yield Row("M4", place, "a quarter stops: rows naming a sensor", "<= 5", float(by.named[400:].any(axis=1).sum()), 1)
    yield Row("M4", place, "a quarter stops: recorder", ">= 1", float((by.kind[400:] == RECORDER).any()), 1)
    shares, other = [], {"whole": [], "one missing 60 %": []}
    for k in range(of.plants):
        plant, rng = 10 * (of.seed + 100 + k), np.random.default_rng(of.seed + k)
        healthy, judge = factors(plant), factors(plant + 1)
        kept = [np.sort(rng.permutation(1500)[:1050]) for _ in range(2)]
        gappy = Monitor.of_logs(signals(8), [_of_rows(healthy, kept[0])], false_alarm=STATED)
        shares.append(np.mean(np.concatenate([p.causes.alarm for p in gappy.judge(_of_rows(judge, kept[1]))])))
        for what in other:
            a, b = healthy.copy(), off(judge, 1, slice(900, 1100), 4.0)
            if what != "whole":
                for y in (a, b):
                    y[rng.random(len(y)) < 0.6, 7] = np.nan
            by = judged(learnt(a), b)
            other[what].append((by.alarm[:900].mean(), by.alarm[900:1100].mean()))
    yield Row("M4", "factors", "30 % of rows skipped: rows in alarm", "<= 0.02", float(np.mean(shares)), of.plants)
    change = np.abs(np.mean(other["whole"], axis=0) - np.mean(other["one missing 60 %"], axis=0))
    for what, value in zip(("rate", "power"), change, strict=True):
        yield Row("M4", "factors", f"a channel missing 60 %: change of the {what}", "<= 0.02", float(value), of.plants)


def _of_rows(y: Array, rows: Array) -> Log:
    return Log(60.0 * rows, y[rows], np.zeros((len(rows), 0)))


def same_decisions(of: Sizes) -> Iterator[Row]:
    """M5: rows decided otherwise after saving and loading, and row by row; CPU seconds."""
    for k in range(3):
        plant = 10 * (of.seed + 200 + k)
        monitor, log = learnt(factors(plant)), log_of(off(factors(plant + 1, 500), 2, slice(250, 350), 4.0))
        whole = monitor.diagnose(log).decisions
        with TemporaryDirectory() as folder:
            monitor.save(Path(folder) / "m.sfdia")
            again = Monitor.load(Path(folder) / "m.sfdia")
        stream, rows = again.stream(), []
        for row in zip(*log, strict=True):
            rows += [s.decision for s in stream.update(*row)]
        for what, other in (("saved and loaded", again.diagnose(log).decisions), ("row by row", rows)):
            differ = np.zeros(len(log.t), bool)
            for name in ("isolated", "suspect", "process"):
                there = getattr(other, name) if what != "row by row" else np.array([getattr(d, name) for d in rows])
                differ |= np.any(there != getattr(whole, name), axis=1)
            yield Row("M5", f"factors {k}", f"{what}: rows decided otherwise", "<= 0", float(differ.sum()), len(log.t))
    for what, count, length, limit in (("week of minutes", 7, 10080, 3), ("year of quarter hours", 30, 35040, 30)):
        y = factors(of.seed, length, count)
        begun = process_time()
        judged(learnt(y), y)
        yield Row("M5", f"{what}, {count} sensors", "CPU s, learn and judge", f"<= {limit}", process_time() - begun, 1)


def runs(of: Sizes) -> Iterator[Row]:
    """M7: runs with offsets of their own, each left out once."""
    kept, right, wrong, worst = [], [], [], []
    for seed, count, offset in ((of.seed, 6, 0.5), (of.seed + 1, 6, 1.0), (of.seed + 2, 8, 1.0)):
        made = runs_with_offsets(seed, count, offset)
        for k, run in enumerate(made):
            monitor = learnt(*(r for j, r in enumerate(made) if j != k))
            healthy = judged(monitor, run)
            outside = healthy.outside.mean() > 0.5
            kept.append(bool(healthy.alarm.mean() <= 0.02 or outside))
            worst.append(0.0 if outside else float(healthy.alarm.mean()))
            named = judged(monitor, off(run, k, slice(400, 800), 3.0)).named[400:]
            right.append(named[:, k].mean())
            wrong.append(np.delete(named, k, axis=1).any(axis=1).mean())
    yield Row("M7", "runs", "share within 0.02 or outside", ">= 0.85", float(np.mean(kept)), len(kept))
    yield Row("M7", "runs", "largest rate without outside", "<= 0.1", max(worst), len(kept))
    yield Row("M7", "runs", "step of 3 sd: rows named", ">= 0.65", float(np.mean(right)), len(kept))
    yield Row("M7", "runs", "step of 3 sd: rows with another named", "<= 0.1", float(np.mean(wrong)), len(kept))


def after_faults(of: Sizes) -> Iterator[Row]:
    """M8, M12, M13: what follows a fault; a wild block while learning; a sensor's fault after one of the process."""
    after, wild, noticed = [], [], []
    first, second = [], []
    for k in range(of.plants):
        plant = 10 * (of.seed + 300 + k)
        healthy, judge = factors(plant), factors(plant + 1)
        monitor = learnt(healthy)
        by = judged(monitor, off(judge, k % 8, slice(500, 800), 10.0))
        after.append(np.mean((by.alarm | by.outside)[832:1100]))
        block = healthy.copy()
        block[750:930, 2] += 3 * healthy[:, 2].std() * np.random.default_rng([of.seed, k]).standard_normal(180)
        spoilt = learnt(block)
        noticed.append(any(line.startswith("s2 ") and "from 45000 s" in line for line in spoilt.remarks))
        wild.append(judged(spoilt, off(judge, 2, slice(500, 800), 6.0)).named[500:800, 2].mean())
        by = judged(monitor, off(factors(plant + 1, process=slice(400, 500)), k % 8, slice(900, 1100), 5.0))
        first.append(by.named[400:500].any(axis=1).mean())
        second.append(by.named[900:1100, k % 8].mean())
    yield Row(
        "M8", "factors", "32 rows after 10 sd over 300 rows: alarm or outside", "<= 0.03", float(np.mean(after)), of.plants
    )
    yield Row("M12", "factors", "wild block reported with its time", ">= 1", float(np.mean(noticed)), of.plants)
    yield Row("M12", "factors", "bias of 6 sd of that sensor: rows named", ">= 0.6", float(np.mean(wild)), of.plants)
    yield Row("M13", "factors", "process fault: rows naming a sensor", "<= 0", float(np.mean(first)), of.plants)
    yield Row("M13", "factors", "sensor 400 rows later: rows named", ">= 0.9", float(np.mean(second)), of.plants)


def without_witness(of: Sizes) -> Iterator[Row]:
    """M9: a sensor that nothing else measures, and two that only measure each other."""
    never, told, frozen, other, one_of = [], [], [], [], []
    for k in range(of.plants):
        plant = 10 * (of.seed + 400 + k)

        def alone(seed: int, twin: bool = False) -> Array:
            rng, y = np.random.default_rng([seed, 3]), factors(seed)
            slow = np.zeros(len(y))
            for j in range(1, len(y)):
                slow[j] = 0.95 * slow[j - 1] + 0.3 * rng.standard_normal()
            more = [slow + 0.2 * rng.standard_normal(len(y)) for _ in range(1 + twin)]
            return np.column_stack([y, *more])

        monitor, judge, rows = learnt(alone(plant)), alone(plant + 1), slice(700, 1100)
        by = judged(monitor, off(judge, 8, rows, 5.0, slope=True))
        never.append(by.named[rows, 8].mean())
        told.append((by.suspect[rows, 8] & (by.kind[rows] == MOVED)).mean())
        y = judge.copy()
        y[rows, 8] = y[700, 8]
        frozen.append(judged(monitor, y).named[rows, 8].mean())
        pair, judge = learnt(alone(plant, True)), alone(plant + 1, True)
        by = judged(pair, off(judge, 8, rows, 3.0))
        other.append(by.named[rows, 9].mean())
        both = by.suspect[rows, 8] & by.suspect[rows, 9] & (by.kind[rows] == ONE_OF)
        one_of.append((both | by.named[rows, 8]).mean())
    yield Row("M9", "factors", "drift of 5 sd nobody else measures: rows named", "<= 0", float(np.mean(never)), of.plants)
    yield Row("M9", "factors", "the same: rows `moved`", ">= 0.3", float(np.mean(told)), of.plants)
    yield Row("M9", "factors", "its freeze: rows named", ">= 0.9", float(np.mean(frozen)), of.plants)
    yield Row("M9", "factors", "of a pair: rows naming the other", "<= 0.02", float(np.mean(other)), of.plants)
    yield Row("M9", "factors", "of a pair: rows right or `one of the two`", ">= 0.7", float(np.mean(one_of)), of.plants)


def trends(of: Sizes) -> Iterator[Row]:
    """M10: a random walk in one sensor while it is learnt, and after it."""
    kept, reported, stated, false = [], [], [], []
    for k in range(20):
        y = factors(10 * (of.seed + 500 + k), 3000)
        monitor = learnt(y[:1500])
        false.append("no rate of false alarms can be stated" in monitor.promise)
        if k < 6:
            walk = y.copy()
            walk[:, 3] += np.cumsum(0.08 * np.random.default_rng([of.seed, k]).standard_normal(len(y)))
            monitor = learnt(walk[:1500])
            trend = bool(monitor.learnt.limits.trend.any())
            reported.append(trend)
            stated.append(trend and "no rate of false alarms can be stated" not in monitor.promise)
            kept.append(judged(monitor, walk[1500:]).alarm.mean() <= 0.06)
    yield Row("M10", "factors", "walks with at most 0.06 of rows in alarm", ">= 5", float(np.sum(kept)), 6)
    yield Row("M10", "factors", "walks reported as a trend", ">= 4", float(np.sum(reported)), 6)
    yield Row("M10", "factors", "reported, and a rate stated", "<= 0", float(np.sum(stated)), 6)
    yield Row("M10", "factors", "trends where there is none", "<= 1", float(np.sum(false)), 20)


def seldom(of: Sizes) -> Iterator[Row]:
    """M11: a channel that starts once in two blocks, or every 50 rows."""
    for every, left_out in ((375, True), (50, False)):
        rates_, right = [], []
        for k in range(of.plants):
            plant = 10 * (of.seed + 600 + k)
            a, b = (np.column_stack([factors(plant + j), _starts(of.seed + j, every)]) for j in (0, 1))
            monitor = learnt(a)
            right.append(("s8" in monitor.channels.left_out) == left_out)
            rates_.append(judged(monitor, b).alarm.mean())
        what = f"a start every {every} rows"
        yield Row("M11", "factors", f"{what}: {'left out' if left_out else 'kept'}", ">= 1", float(np.mean(right)), of.plants)
        yield Row("M11", "factors", f"{what}: rows in alarm", "<= 0.01", float(np.mean(rates_)), of.plants)


def _starts(seed: int, every: int) -> Array:
    """A channel (K,) that is on for some rows at a time."""
    rng, found = np.random.default_rng([seed, 9]), np.zeros(1500)
    for k in range(int(rng.integers(20, 60)), 1500, every):
        found[k : k + min(10, every // 3)] = 1.0
    return found


def labelled_river(of: Sizes) -> Iterator[Row]:
    """M6 is about readings of a river, see real-logs.md: what real-logs.csv holds, reported, not demanded."""
    from real_logs import ALL, load

    cells = load()
    for name in ("Herbert river, fortnights in turn", "Herbert river, later half"):
        yield Row("M6", name, "events named right, reported", ">= 0", cells[name, "monitor", ALL, "named right"], 0)


CONDITIONS: dict[str, Sequence[Callable[[Sizes], Iterator[Row]]]] = {
    "M1": (sensors_of_the_chemical_plant,),
    "M2": (process_of_the_chemical_plant,),
    "M3": (rates, river),
    "M4": (starts_and_stops,),
    "M5": (same_decisions,),
    "M6": (labelled_river,),
    "M7": (runs,),
    "M8": (after_faults,),
    "M9": (without_witness,),
    "M10": (trends,),
    "M11": (seldom,),
}
