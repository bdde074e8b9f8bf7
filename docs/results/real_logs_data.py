"""Recordings for real_logs.py: those of others, read from a folder, and simulated plants with faults put in.

Every set has healthy logs to learn from and labelled logs to judge, on a grid without gaps inside a log, NaN where there is no
reading. Nothing of the judged logs sets anything.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fusion_sfdia import Log, Signal, simulate
from fusion_sfdia.benchmarks.chemical.support.recordings import ANALYSES, FAULTS, MEASUREMENTS, ONSET, VALVES, channels
from fusion_sfdia.detectors import registry

Array = NDArray[Any]

INJECTED = ("bias", "drift", "freeze", "noise")
SIZES, EACH = (1.0, 2.0, 4.0), 9  # of a fault in units of the set, and how many of each kind and size
FAULTY, BEFORE = 120, 300  # rows of a fault that is put in, and of a simulated log before it
CALM = 32  # rows after a labelled reading that are not counted as healthy
FORTNIGHT = 14  # days


class Judged(NamedTuple):
    """A log to judge: label (K, N), 0 good, k the kinds[k - 1] of its set, -1 unknown; process (K,), where it is at fault;
    healthy (K,), rows in which an alarm is false.
    """

    log: Log
    label: Array
    process: Array
    healthy: Array


class Recorded(NamedTuple):
    """A set of logs: kinds of labels, groups of sensors that measure alike in several places."""

    name: str
    sensors: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    healthy: list[Log]
    judged: list[Judged]
    kinds: tuple[str, ...]
    groups: tuple[tuple[int, ...], ...] = ()

    @property
    def dt(self) -> float:
        """Seconds from row to row."""
        return float(self.healthy[0].t[1] - self.healthy[0].t[0])


def sets(folder: Path) -> Iterator[Recorded]:
    """All sets; folder: holds tep_braatz, herbert and logan_river."""
    yield from (*tanks(), *pipeline(), *chemical(str(folder / "tep_braatz")))
    yield from of_river("Logan river", *logan(folder / "logan_river"))
    yield from of_river("Herbert river", *herbert(folder / "herbert"))


def with_fault(log: Log, kind: str, sensor: int, at: int, size: float, rng: np.random.Generator) -> Judged:
    """A log with a fault of FAULTY rows in one sensor; size: in its unit. The other rows are not counted."""
    y, label, rows = log.y.copy(), np.zeros(log.y.shape, np.int8), slice(at, at + FAULTY)
    shape = {"bias": np.ones(FAULTY), "drift": np.linspace(0, 1, FAULTY), "noise": rng.standard_normal(FAULTY)}
    if kind == "freeze":
        y[rows, sensor] = y[at, sensor]
    else:
        y[rows, sensor] += rng.choice([-1.0, 1.0]) * size * shape[kind]
    label[rows, sensor] = INJECTED.index(kind) + 1
    none = np.zeros(len(y), bool)
    return Judged(Log(log.t, y, log.u), label, none, none)


def fault_free(log: Log) -> Judged:
    """A healthy log, of which every row counts."""
    rows = len(log.t)
    return Judged(log, np.zeros(log.y.shape, np.int8), np.zeros(rows, bool), np.ones(rows, bool))


def injections(
    choices: Sequence[Sequence[int]], each: int = EACH, seed: int = 11
) -> Iterator[tuple[str, float, int, np.random.Generator]]:
    """Kind, size, sensor and generator of each fault; choices: the sensors of each of INJECTED."""
    for k, kind in enumerate(INJECTED):
        rng = np.random.default_rng([seed, k])
        for size in np.repeat(SIZES, each):
            yield kind, float(size), int(rng.choice(choices[k])), rng


def of_plant(name: str, plant_name: str, moved: int, swing: float, groups: int = 0) -> tuple[Recorded, Recorded]:
    """Simulated logs of a plant, whose input `moved` varies slowly by the share `swing`; faults in units of twice sigma.

    Three logs of 1500 rows to learn from, ten to count false alarms in, and one of 600 rows a fault, each with a seed of its
    own; and the same with four times as long logs to learn from, without faults.
    """
    plant = registry.plant(plant_name)
    nominal = np.asarray(simulate(plant, 2, [0]).u)[0]

    def log(seed: int, rows: int) -> Log:
        load, moves = np.zeros(rows), np.random.default_rng(seed).standard_normal(rows)
        for k in range(1, rows):
            load[k] = 0.99 * load[k - 1] + np.sqrt(1 - 0.99**2) * moves[k]
        u = np.tile(nominal, (rows, 1))
        u[:, moved] *= 1 + swing * load
        found = simulate(plant, rows, [seed], inputs=u)
        return Log(found.t, found.y[:, 0], found.u)

    count = len(plant.sensors)
    faulty = [
        with_fault(log(9100 + k, 2 * BEFORE), kind, i, BEFORE, 2 * size * plant.sensor_sigma[i], rng)
        for k, (kind, size, i, rng) in enumerate(injections([range(count)] * len(INJECTED)))
    ]
    alike = tuple(tuple(range(a, a + groups)) for a in range(0, count, groups)) if groups else ()
    signals = tuple(Signal(s.name, s.unit) for s in plant.sensors), tuple(Signal(s.name, s.unit) for s in plant.inputs)
    learnt, longer = ([log(seed, rows) for seed in range(9000, 9003)] for rows in (1500, 6000))
    later = [fault_free(log(seed, 1500)) for seed in range(9010, 9020)]
    made = Recorded(name, *signals, learnt, later + faulty, INJECTED, alike)
    return made, made._replace(name=f"{name}, more learnt", healthy=longer, judged=later)


def tanks() -> tuple[Recorded, Recorded]:
    """Two tanks, whose inflow varies."""
    return of_plant("two tanks", "two-tanks", 0, 0.1)


def pipeline() -> tuple[Recorded, Recorded]:
    """A gas pipeline, whose demand varies: 21 pressures, 21 flows, 21 temperatures."""
    return of_plant("gas pipeline", "gas-pipeline", 2, 0.05, groups=21)


def chemical(folder: str) -> tuple[Recorded, Recorded]:
    """The Tennessee Eastman process: d00 is learnt, faults of sensors are put into d00_te, those of the process recorded."""
    sensors, inputs = tuple(Signal(*one) for one in MEASUREMENTS), tuple(Signal(one, "%") for one in VALVES)

    def log(name: str) -> Log:
        table = channels(folder, name)
        return Log(180.0 * np.arange(len(table)), table[:, : len(sensors)], table[:, len(sensors) :])

    healthy, later = log("d00"), log("d00_te")
    sd = healthy.y.std(axis=0)
    every, fast = range(len(sensors)), np.flatnonzero(~ANALYSES)  # analyses repeat as it is
    faulty = [
        with_fault(later, kind, i, int(rng.integers(150, 700)), size * sd[i], rng)
        for kind, size, i, rng in injections([every, every, fast, fast])
    ]
    process = []
    for name in FAULTS:
        one = fault_free(log(f"{name}_te"))
        process.append(one._replace(process=np.arange(len(one.log.t)) >= ONSET, healthy=np.zeros(len(one.log.t), bool)))
    first = Recorded("chemical plant", sensors, inputs, [healthy], [fault_free(later), *faulty], INJECTED)
    return first, first._replace(name="chemical plant, process faults", judged=[fault_free(later), *process], kinds=())


class River(NamedTuple):
    """A recording of sites along a river: t (K,) s, y (K, N) as read, clean (K, N) without what is labelled, label (K, N)."""

    sensors: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    log: Log
    clean: Array
    label: Array
    kinds: tuple[str, ...]
    groups: tuple[tuple[int, ...], ...]


def of_river(name: str, river: River, unit: Array | None = None) -> Iterator[Recorded]:
    """Three sets: fortnights in turn are learnt and judged; the same with faults of 24 h put in, where the set has a unit
    (N,) for their size; the first half is learnt and the second judged.
    """
    t, _, u = river.log
    day = (t - t[0]) // 86400
    turn = day // FORTNIGHT
    edges = np.flatnonzero(np.diff(turn)) + 1
    parts = np.split(np.arange(len(t)), edges)
    half = len(t) // 2

    def clean(rows: Array) -> Log:
        return Log(t[rows], river.clean[rows], u[rows])

    def judged(rows: Array) -> Judged:
        label = river.label[rows]
        near = np.convolve((label > 0).any(axis=1), np.ones(CALM + 1))[: len(rows)] > 0
        return Judged(river.log.rows(rows), label, np.zeros(len(rows), bool), ~near)

    # one log with gaps: the fortnights are pieces of one recording and no runs of their own
    learnt = [clean(np.concatenate(parts[::2]))]
    of = Recorded(name, river.sensors, river.inputs, learnt, [], river.kinds, river.groups)
    later = [judged(rows) for rows in parts[1::2] if len(rows) > 4 * CALM]
    yield of._replace(name=f"{name}, fortnights in turn", judged=later)
    if unit is not None:
        logs = [clean(rows) for rows in parts[1::2] if len(rows) > 4 * FAULTY]
        faulty = []
        for k, (kind, size, i, rng) in enumerate(injections([range(len(unit))] * len(INJECTED), 3)):
            log = logs[k % len(logs)]
            at = int(rng.integers(2 * FAULTY, len(log.t) - FAULTY))
            faulty.append(with_fault(log, kind, i, at, size * unit[i], rng))
        yield of._replace(name=f"{name}, faults put in", judged=[*map(fault_free, logs), *faulty], kinds=INJECTED)
    first, second = np.arange(half), np.arange(half, len(t))
    yield of._replace(name=f"{name}, later half", healthy=[clean(first)], judged=[judged(second)])


QUANTITIES = {"temp": "degC", "cond": "uS/cm", "ph": "1", "do": "mg/l", "turb": "NTU", "stage": "cm"}
SITES = ("TonyGrove", "WaterLab", "MainStreet", "Mendon")
REASONS = {1: "single readings", 7: "single readings", 4: "to be estimated", 10: "constant offset"}
WITHDRAWN = "withdrawn"
NONE = -9999.0


def logan(folder: Path) -> tuple[River, Array]:
    """Four sites of the Logan river, January to September 2019, and the usual deviation of each reading within a day (N,).

    Readings without a label are those that technicians corrected, in which the slow corrections between calibrations, which
    have no label, are made; labelled ones are as read, less the last correction before.
    """
    first, last = pd.Timestamp("2019-01-01"), pd.Timestamp("2019-09-27")
    times = pd.date_range(first, last, freq="15min")
    kinds = tuple(dict.fromkeys((*REASONS.values(), WITHDRAWN)))
    y, clean, label, names = [], [], [], []
    for site in SITES:
        table = pd.read_csv(folder / f"{site}2019.csv.gz", parse_dates=["datetime"], index_col="datetime")
        table = table.replace(NONE, np.nan).reindex(times)
        for quantity, unit in QUANTITIES.items():
            read, corrected, reason = (table[f"{quantity}{end}"] for end in ("", "_cor", "_qual"))
            good = reason.isna()
            offset = (read - corrected).where(good)
            known = np.where(good, corrected, read - offset.ffill().fillna(offset.median()))
            marked = [kinds.index(REASONS.get(int(r), WITHDRAWN)) + 1 if r > 0 else 0 for r in reason.fillna(0)]
            y.append(known)
            clean.append(np.where(good, corrected, np.nan))
            label.append(np.where(np.isfinite(known), marked, 0))
            names.append(Signal(f"{quantity} {site}", unit))
    n, t = len(QUANTITIES), (times - first).total_seconds().to_numpy()
    groups = tuple(tuple(range(q, n * len(SITES), n)) for q in range(n))
    log = Log(t, np.stack(y, axis=1), np.zeros((len(t), 0)))
    good = np.stack(clean, axis=1)
    days = pd.DataFrame(good).groupby(t // 86400).std()
    return River(tuple(names), (), log, good, np.stack(label, axis=1).astype(np.int8), kinds, groups), days.median().to_numpy()


UNCERTAIN = "uncertain"


def herbert(folder: Path) -> tuple[River]:
    """Seven sites of the Herbert river, level and suspended solids, with an expert's label of each reading, and the rain.

    Readings of which the expert is uncertain are taken as missing.
    """
    table = pd.read_csv(folder / "herbert.csv.gz", parse_dates=["time"]).set_index("time")
    table = table.reindex(pd.date_range(table.index[0], table.index[-1], freq="30min"))
    of = {"level": "level_m", "suspended solids": "tss_mg_l"}
    marks = {"level": "level_label", "suspended solids": "tss_label"}
    each = [(quantity, site) for quantity in of for site in range(1, 8)]
    text = np.stack([table[f"{marks[q]}_{s}"].fillna("").str.strip() for q, s in each], axis=1)
    y = np.stack([table[f"{of[q]}_{s}"] for q, s in each], axis=1).astype(float)
    y[text == UNCERTAIN] = np.nan
    kinds = tuple(sorted(set(text.ravel().tolist()) - {"", "good", UNCERTAIN}))
    label = np.array([[kinds.index(x) + 1 if x in kinds else 0 for x in row] for row in text], np.int8)
    label[~np.isfinite(y)] = 0
    clean = np.where(text == "good", y, np.nan)
    t = (table.index - table.index[0]).total_seconds().to_numpy()
    sensors = tuple(Signal(f"{q} {s}", "m" if q == "level" else "mg/l") for q, s in each)
    rain = table[["prec_mm_1"]].fillna(0.0).to_numpy()
    groups = (tuple(range(7)), tuple(range(7, 14)))
    return (River(sensors, (Signal("rain", "mm"),), Log(t, y, rain), clean, label, kinds, groups),)
