"""acceptance: what `robust-glr` has to reach under the errors of real plants: nine items, limits fixed before any run.

Each `Check` is a case of `error_protocol` on a plant with limits of what the detector decides while it runs, without the second
look of a diagnosis. The limits are those of the acceptance list P1 to P9 of the study that the detector was designed in; where
it asks for no less than before, before is the detector of commit 170c653d. What each item is stands in `ITEMS`.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import fusion_sfdia
from fusion_sfdia.common.references import load
from fusion_sfdia.common.run_statistics import Estimate, rate_over_runs, share
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.detector import Detector, run
from fusion_sfdia.detectors.registry import require_known
from fusion_sfdia.learning.tuning.tune import tune
from fusion_sfdia.plant.plant import Plant, Truth
from fusion_sfdia.plant.signals import Sensor, Signal
from fusion_sfdia.plant.uncertainty import Parameter, Uncertainty
from fusion_sfdia.report.content import Interval, ResultTable, Summary
from fusion_sfdia.report.results import AT_MOST, MORE_THAN, Published, Row, row_of
from fusion_sfdia.study.audit import lasting
from fusion_sfdia.study.cases import MismatchCase, ProcessFaultCase
from fusion_sfdia.study.comparison.subjects import cases_of, compared_plant
from fusion_sfdia.study.detection_metrics import auc
from fusion_sfdia.study.error_protocol import CASES, OF_PLANT, Case, ErrorTrial, stated_cases, trial
from fusion_sfdia.study.errors import ReadingError, white
from fusion_sfdia.study.experiments.scenario import Arrays, Scenario, Settings, Task
from fusion_sfdia.study.truths import trending

Array = NDArray[Any]
Results = list[tuple[Task, Arrays]]

NAME, DETECTOR = "acceptance", "robust-glr"
SEEDS, FIRST_SEED, LOG_SEEDS = 24, 700_000, 10_000_000  # logs begin at the sum of the last two
FALSE_ALARM = 1e-3  # per row, to which detectors are tuned
VERDICTS = ("met", "within its interval", "missed")
ITEMS = {
    "P1": "noise of other kinds, nothing fails",
    "P2": "power under white noise and AR(0.8), after 300 healthy rows",
    "P3": "all unknowns off since the first row, at rest there",
    "P4": "two causes on two tanks",
    "P5": "outlets of two tanks that widen within 300 rows",
    "P6": "a large bias of the heat meter of a house",
    "P7": "time of a step, over that of commit 170c653d",
    "P8": "after a healthy log with the same noise",
    "P9": "after a healthy log with white noise, noise that is slow",
}
TANKS, ENGINE, PIPELINE, NETWORK = PLANTS = ("two-tanks", "marine-engine", "gas-pipeline", "power-network")
LARGE = {PIPELINE: 6, NETWORK: 6}  # of the seeds one in so many
SETTLE, LIVE = {ENGINE: 400}, 30  # rows until a filter has settled, where not 60; the last of them that are judged, too
FALSE, EXACT, FOUND = "false_isolation_probability", "exact_isolation", "process_found_probability"
LATCHED, EVER, NAMED = "latched_probability", "ever_isolated_probability", "process_verdict_probability"
AUC, DELAY, RATIO = "auc", "median_delay_rows", "step_time_ratio"


class Check(NamedTuple):
    """A case on a plant, its rows before the cause, while it lasts and in all, the first that is judged, and what to reach.

    limits: by metric, negative for "at least". log: noise of a healthy log of `log_rows` that the detector is tuned on before,
    "" for none. times: runs for each seed.
    """

    item: str
    plant: str
    case: Case
    begin: int
    last: int
    rows: int
    judged: int
    limits: dict[str, float]
    log: str = ""
    log_rows: int = 0
    times: int = 1

    @property
    def name(self) -> str:
        """Of the case, and of the log before it."""
        return self.case.name + (f", after {self.log_rows} rows of {self.log}" if self.log else "")


BY_NAME = {case.name: case for case in CASES}
SMALLER = tuple(
    Case("readings", f"variance-{v:g}", f"variance of {v:g} times the stated one",
         ReadingError(f"variance-{v:g}", "", partial(white, size=v**0.5))) for v in (0.3, 2.0)
)  # fmt: skip
NOISE = (
    *SMALLER,
    *(BY_NAME[n] for n in ("as-stated", "variance-3", "ar-0.5", "ar-0.8", "ar-0.95", "student-3", "outliers", "steps-1")),
    *(BY_NAME[n] for n in ("steps-3", "offsets", "cross-talk")),
)
SLOW = BY_NAME["ar-0.8"].readings
MOST = {"ar-0.95": 0.05, "outliers": 0.05}  # false isolation, where not .01
BEFORE = {TANKS: 0.873, ENGINE: 0.800}  # area under the ROC at 3 sigma, of the study
POWER = {TANKS: 0.80, ENGINE: 0.88, PIPELINE: 0.70}  # exact isolation at 3 sigma
UNDER_SLOW_NOISE = ("leak", "injector-loss", "governor", "input-gain")  # process faults that are to be found there
# exact isolation before, under white noise: 3 sigma, 10 sigma, drift to 10 sigma; and rows until a process fault was named
POWER_BEFORE = {TANKS: (0.92, 0.99, 0.75), ENGINE: (0.96, 1.0, 0.77), PIPELINE: (0.95, 1.0, 0.70), NETWORK: (0.66, 0.99, 0.73)}
DELAY_BEFORE = {"leak": 6, "turbine-fouling": 6, "injector-loss": 2, "heavy-propeller": 25, "governor": 0, "input-gain": 2}
LOG_ROWS = {ENGINE: (600,)}  # its filter takes 263 rows to settle, and `tune` refuses a log of 300
LOGS = ("as-stated", "ar-0.5", "ar-0.8", "variance-3", "steps-3")
COST = 1.5


def checks() -> Iterator[Check]:
    """All but P7, which is a time."""
    for plant in PLANTS:
        settle, rows = SETTLE.get(plant, 60), 100 if plant in LARGE else 240
        for case in NOISE:
            limit = MOST.get(case.name, 0.01)
            yield Check("P1", plant, case, settle, 0, settle + rows, settle - LIVE, {FALSE: limit})
    for plant in PLANTS:
        exact = {"bias-3": POWER.get(plant), "bias-10": 0.95, "drift-10": 0.6, "bias-under-ar-0.8": 0.95}
        for name, least in exact.items():
            limits = {} if least is None else {EXACT: -least}
            if name == "bias-3" and plant in BEFORE:
                limits[AUC] = 0.01 - BEFORE[plant]
            if limits:
                yield Check("P2", plant, BY_NAME[name], 300, 60, 360, 300 - LIVE, limits)
        for case in process_faults(plant):
            rows = 400 if plant in LARGE else 540
            for slow in (False, True)[: 1 + (short(case) in UNDER_SLOW_NOISE)]:
                yield Check(
                    "P2", plant, under_slow_noise(case) if slow else case, 300, 0, rows, 300, {FOUND: -0.9, FALSE: 0.02}
                )
    for plant in (TANKS, ENGINE):
        off = replace(BY_NAME["all-unknowns-off"], start="rest")
        yield Check("P3", plant, off, 0, 0, 300, 0, {EVER: 0.0}, times=4)
    two = {EXACT: -0.85, LATCHED: 0.05}
    for case in (BY_NAME["two-biases"], *two_causes()):
        yield Check("P4", TANKS, case, 100, 60, 280, 0, two)
    for percent in (3, 6, 9, 15):
        yield Check("P5", TANKS, widening(percent), 0, 0, 360, 0, {FALSE: 0.02})
    for size in (10.0, 24.0, 30.0, 36.0):
        case = Case("cause", f"meter-{size:g}", f"bias of the heat meter of {size:g} sigma", sensors=(("bias", size),))
        yield Check("P6", HOUSE, case, 100, 60, 280, 0, {EXACT: -0.8, NAMED: 0.0})
    for plant in (*PLANTS, HOUSE):
        for log in LOGS:
            for rows in LOG_ROWS.get(plant, (300, 600)):
                yield from after_log(plant, log, rows)
    for plant in (TANKS, ENGINE):
        for name in ("ar-0.5", "ar-0.8"):
            yield Check("P9", plant, BY_NAME[name], 0, 0, 300, 60, {FALSE: 0.02}, "as-stated", 600)


def after_log(plant: str, log: str, rows: int) -> Iterator[Check]:
    """P8 after one log: nothing fails; where it was long, white or AR(0.8): sensors and the process, too."""
    yield Check("P8", plant, BY_NAME[log], 0, 0, 300, 0, {FALSE: 0.01}, log, rows)
    if rows < 600 or plant == HOUSE:
        return
    cases = process_faults(plant)
    if log == "as-stated":
        for name, before in zip(("bias-3", "bias-10", "drift-10"), POWER_BEFORE[plant], strict=True):
            yield Check("P8", plant, BY_NAME[name], 100, 60, 160, 0, {EXACT: 0.03 - before}, log, rows)
        for case in cases:
            limits = {FOUND: -0.9, FALSE: 0.02}
            if short(case) in DELAY_BEFORE and plant != PIPELINE:
                limits[DELAY] = DELAY_BEFORE[short(case)] + 2.0
            yield Check("P8", plant, case, 100, 0, 240, 100, limits, log, rows)
    elif log == "ar-0.8":
        yield Check("P8", plant, BY_NAME["bias-under-ar-0.8"], 100, 60, 160, 0, {EXACT: -0.95}, log, rows)
        for case in cases:
            yield Check("P8", plant, under_slow_noise(case), 100, 0, 240, 100, {FALSE: 0.02}, log, rows)


def process_faults(plant: str) -> list[Case]:
    """Those that stand beside a plant."""
    return [c for c in stated_cases(cases_of(compared_plant(plant))) if isinstance(c.stated, ProcessFaultCase)]


def short(case: Case) -> str:
    """The name of a process fault, as it stands beside the plant."""
    return "" if case.stated is None else case.stated.name


def under_slow_noise(case: Case) -> Case:
    """A case under AR(0.8)."""
    return replace(case, name=f"{case.name}, ar-0.8", readings=SLOW)


def two_causes() -> Iterator[Case]:
    """A share of the tanks' inflow is lost so many rows before a bias begins."""
    for percent, size, lead in ((10, 10, 0), (5, 5, 0), (10, 10, 3), (10, 10, 10), (10, 10, 30), (10, 10, -10)):
        lost = ProcessFaultCase(
            f"inflow-{percent}", "a part of the inflow is lost", lost=(1 - percent / 100,), named=("inflow",)
        )
        name = f"inflow -{percent} %, bias of {size} sigma {lead} rows later"
        yield Case(OF_PLANT, name, name, sensors=(("bias", float(size)),), lead=lead, stated=lost)


def widening(percent: int) -> Case:
    """Both outlets of the tanks widen within 300 rows."""
    make = load(registry.find_plant(TANKS).source)
    first, last = make(), make(outlet=1 + percent / 100)
    drift = MismatchCase("", "", partial(trending, first, last, 300 * first.dt))
    return Case(OF_PLANT, f"outlets widen by {percent} %", "within 300 rows", stated=drift)


# ---- a house: two rooms, one heated; a bias of its heat meter looks like an error of the heating power at first

HOUSE = "house"
POWER_USUAL, OUTDOORS, LOSS, BETWEEN, CAPACITY = 3000.0, 275.0, 100.0, 150.0, 5e6  # W; K; W/K; W/K; J/K


def house() -> Plant:
    """Two rooms; the temperature of each and the heat are measured every 5 min. The power that acts is known to 10 %, the loss,
    too.
    """
    return Plant(
        HOUSE,
        tuple(Signal(n, "K", 293.0, initial_sigma=0.5, process_sigma=0.01) for n in ("first", "second")),
        (Sensor("T_1", "first", "K", 0.1), Sensor("T_2", "second", "K", 0.1), Sensor("heat", "heat", "W", 40.0)),
        _house_step,
        _house_output,
        dt=300.0,
        x0=HOUSE_AT_REST,
        inputs=(Signal("power", "W", POWER_USUAL),),
        truth=Truth(operation=_heating, disturbed=True),
        uncertainty=Uncertainty(
            (Parameter("loss", "W/K", LOSS, 0.1 * LOSS, low=10.0),), step=_house_step, inputs={"power": 0.1 * POWER_USUAL}
        ),
    )


def _house_step(t: float, x: Array, u: Array, dt: float, theta: Array = np.array([LOSS])) -> Array:  # noqa: B008
    between, loss = BETWEEN * (x[..., 0] - x[..., 1]), theta[..., :1] * (x - OUTDOORS)
    heat = np.stack([u[..., 0] - between, between + np.zeros_like(u[..., 0])], axis=-1)
    return np.asarray(x + dt / CAPACITY * (heat - loss))


def _house_output(t: float, x: Array, u: Array) -> Array:
    return np.concatenate([x, u[..., :1] + 0 * x[..., :1]], axis=-1)


def _heating(t: float) -> Array:
    return np.array([POWER_USUAL * (1 + 0.25 * np.sign(np.sin(2 * np.pi * t / 14_400.0)))])


HOUSE_AT_REST = OUTDOORS + np.linalg.solve(
    [[LOSS + BETWEEN, -BETWEEN], [-BETWEEN, LOSS + BETWEEN]], np.array([POWER_USUAL, 0.0])
)


def plant_of(name: str) -> Plant:
    """A registered plant, or the house."""
    return house() if name == HOUSE else registry.plant(name)


# ---- what is measured


class Seen(NamedTuple):
    """What a detector decides on trials: isolated (K, B, N), whether the process is named (K, B), score (K, B)."""

    isolated: Array
    process: Array
    score: Array


def seen(detector: Detector, made: Sequence[ErrorTrial]) -> Seen:
    """The decisions of one batch."""
    y, u = (np.stack([getattr(one.log, what) for one in made], axis=1) for what in ("y", "u"))
    found = run(detector, detector.init((len(made),)), made[0].log.t, y, u)[1]
    assert found.process is not None
    return Seen(found.isolated[..., : y.shape[-1]], np.any(found.process, axis=-1), found.score)


def measured(check: Check, made: Sequence[ErrorTrial], found: Seen) -> dict[str, Estimate]:
    """The metrics that have limits."""
    faulty, differs = (np.stack([getattr(one, what) for one in made], axis=1) for what in ("faulty", "process"))
    failed, runs = np.any(faulty, axis=-1), len(made)
    live = np.arange(check.rows) >= check.judged
    false: Array = np.any(found.isolated & ~lasting(faulty), axis=-1)
    right = (found.isolated == faulty).all(axis=-1)
    named = found.process & differs
    waits = np.where(named.any(axis=0), named.argmax(axis=0) - differs.argmax(axis=0), np.inf)

    def of_failed(hits: Array) -> Estimate:
        return rate_over_runs((hits & failed).sum(axis=0), failed.sum(axis=0))

    metrics: dict[str, Callable[[], Estimate]] = {
        FALSE: lambda: rate_over_runs(false[live].sum(axis=0), np.full(runs, live.sum())),
        EXACT: lambda: of_failed(right),
        NAMED: lambda: of_failed(found.process),
        FOUND: lambda: share(named.any(axis=0)),
        LATCHED: lambda: share(false[-1]),
        EVER: lambda: share(found.isolated[live].any(axis=(0, 2))),
        DELAY: lambda: Estimate(float(np.median(waits)), np.nan, np.nan, runs),
        AUC: lambda: auc(found.score, faulty, np.broadcast_to(live[:, None], failed.shape)),
    }
    return {metric: metrics[metric]() for metric in check.limits}


def trials(check: Check, plant: Plant, first_seed: int, runs: int) -> list[ErrorTrial]:
    """Of a check; of the house those in which the meter fails."""
    made: list[ErrorTrial] = []
    seed = first_seed
    while len(made) < runs:
        one = trial(plant, check.case, seed, check.rows, check.begin, check.last)
        if check.item != "P6" or one.faulty[:, -1].any():
            made.append(one)
        seed += 1
    return made


def after_logs(check: Check, plant: Plant, made: Sequence[ErrorTrial], learnt: Sequence[Detector]) -> Seen:
    """The decisions of detectors that each learnt of another log, on as many trials each."""
    each = len(made) // len(learnt)
    parts = [seen(detector, made[k * each : (k + 1) * each]) for k, detector in enumerate(learnt)]
    return Seen(*(np.concatenate(of, axis=1) for of in zip(*parts, strict=True)))


def learnt_of(plant: Plant, log: str, rows: int, seed: int) -> Detector:
    """The detector, tuned on a healthy log."""
    made = trial(plant, BY_NAME[log], LOG_SEEDS + seed, rows)
    found: Detector = tune(plant, made.log, false_alarm=FALSE_ALARM, detector=DETECTOR).detector(plant)
    return found


# ---- the scenario

SETTINGS = {
    "items": tuple(ITEMS),
    "plants": (*PLANTS, HOUSE),
    "first_seed": FIRST_SEED,  # those of a run are fresh; below 1000 to choose something
    "earlier": "",  # a checkout of another commit, of which P7 is a multiple; without one P7 is not measured
}


def tasks(settings: Settings, seeds: int) -> list[Task]:
    """The checks of an item on a plant after one kind of log a task. ValueError for an unknown item or plant."""
    for what, known in (("item", ITEMS), ("plant", (*PLANTS, HOUSE))):
        for name in settings[f"{what}s"]:
            require_known(what, name, known)
    groups = dict.fromkeys((c.item, c.plant, c.log, c.log_rows) for c in checks())
    names = ("item", "plant", "log", "log_rows")
    common = {"seeds": seeds, "first_seed": settings["first_seed"]}
    found: list[Task] = [
        dict(zip(names, group, strict=True)) | common
        for group in groups
        if group[0] in settings["items"] and group[1] in settings["plants"]
    ]
    if (earlier := settings["earlier"]) and not os.path.isfile(os.path.join(earlier, "fusion_sfdia", "__init__.py")):
        raise ValueError(f"earlier is {earlier!r:.80}; expected a folder with a checkout of another commit of fusion_sfdia")
    if "P7" in settings["items"] and settings["earlier"]:
        found += [{"item": "P7", "plant": p, "earlier": settings["earlier"]} for p in PLANTS if p in settings["plants"]]
    return found


def work(task: Task) -> Arrays:
    """condition, metric (R,): the case and what is measured; value, low, high, n, limit (R,), negative for "at least"."""
    if task["item"] == "P7":
        return cost(task["plant"], task["earlier"])
    plant, runs = plant_of(task["plant"]), max(task["seeds"] // LARGE.get(task["plant"], 1), 1)
    if task["log"]:
        logs = max(runs // 2, 1)
        learnt = [learnt_of(plant, task["log"], task["log_rows"], task["first_seed"] + k) for k in range(logs)]
    else:
        learnt = [registry.detector(DETECTOR, plant)]
    rows: list[tuple[str, str, Estimate, float]] = []
    for check in checks():
        if (check.item, check.plant, check.log, check.log_rows) == tuple(task[k] for k in ("item", "plant", "log", "log_rows")):
            made = trials(check, plant, task["first_seed"], runs * check.times)
            found = measured(check, made, after_logs(check, plant, made, learnt))
            rows += [(check.name, metric, estimate, check.limits[metric]) for metric, estimate in found.items()]
    names = {what: np.array([r[k] for r in rows]) for k, what in enumerate(("condition", "metric"))}
    numbers = {what: np.array([getattr(r[2], what) for r in rows]) for what in ("value", "low", "high", "n")}
    return {**names, **numbers, "limit": np.array([r[3] for r in rows])}


STEP_TIMES = """
import json, sys, time
import numpy as np
try:
    from fusion_sfdia.detectors import registry
    from fusion_sfdia.diagnosis.simulate import simulate
except ImportError:  # of commit 170c653d
    from fusion_sfdia import registry, simulate
plant = registry.plant(sys.argv[1])
detector, made = registry.detector("robust-glr", plant), simulate(plant, 40, list(range(24)))
u = np.stack([made.u_of_runs[:, b] if made.u_of_runs.ndim > 2 else made.u_of_runs for b in range(24)], axis=1)
y = made.y.copy()
for k in range(40):  # one run has a far reading in each sample
    y[k, k % 24, k % y.shape[-1]] += 10 * plant.sensor_sigma[k % y.shape[-1]]
def best(runs):
    found = []
    for _ in range(int(sys.argv[2])):
        state = detector.init((runs,) if runs > 1 else ())
        begin = time.perf_counter()
        for k in range(40):
            now = (y[k, :runs], u[k, :runs]) if runs > 1 else (y[k, 0], u[k, 0])
            state, _ = detector.step(state, float(made.t[k]), *now)
        found.append((time.perf_counter() - begin) / 40)
    return min(found)
best(1), best(24)
print(json.dumps([best(1), best(24)]))
"""


def cost(plant: str, earlier: str, turns: int = 5) -> Arrays:
    """Time of a step over that of an earlier commit, of one stream and of a batch of 24 in which some run has a far reading in
    each sample: processes of both in turn, the median over the turns.
    """
    own, found = str(Path(fusion_sfdia.__file__).parents[1]), []
    for _ in range(turns):
        times = []
        for where in (earlier, own):
            command = [sys.executable, "-P", "-c", STEP_TIMES, plant, "10"]
            paths = os.environ | {"PYTHONPATH": where}
            done = subprocess.run(command, env=paths, capture_output=True, text=True, check=True)
            times.append(np.array(json.loads(done.stdout)))
        found.append(times[1] / times[0])
    nothing = np.full(2, np.nan)
    return {
        "condition": np.array(["one stream", "batch of 24"]), "metric": np.array([RATIO] * 2),
        "value": np.median(found, axis=0), "low": nothing, "high": nothing, "n": np.full(2, turns), "limit": np.full(2, COST),
    }  # fmt: skip


def rows_of(results: Results) -> list[Row]:
    """The rows of metrics.csv: the item as quantity, its limit as what is published."""
    rows = []
    for task, arrays in results:
        columns = ("condition", "metric", "limit", "value", "low", "high", "n")
        for condition, metric, limit, *numbers in zip(*(arrays[c].tolist() for c in columns), strict=True):
            bound = Published(abs(limit), f"acceptance list{MORE_THAN if limit < 0 else AT_MOST}")
            estimate = Estimate._make(numbers)
            rows.append(
                row_of(task["plant"], NAME, DETECTOR, "none", task["item"], metric, estimate, bound, condition=condition)
            )
    return rows


def met(row: Row) -> bool:
    """Whether a value keeps its limit."""
    assert row.published is not None
    return row.value <= row.published if row.source.endswith(AT_MOST) else row.value >= row.published


def verdict(row: Row) -> str:
    """One of `VERDICTS`: missed, but for chance, where the limit is within the interval."""
    return VERDICTS[0] if met(row) else VERDICTS[1 if row.agrees else 2]


def table(rows: Sequence[Row], kept: Callable[[Row], bool], title: str) -> ResultTable:
    """Conditions with their values and limits."""
    lines: list[tuple[str | Interval, ...]] = [
        (
            r.quantity, r.plant, r.condition, r.metric.replace("_", " "), (r.value, r.low, r.high, r.n),
            ("at most " if r.source.endswith(AT_MOST) else "at least ") + f"{r.published:g}", verdict(r),
        )
        for r in rows
        if kept(r)
    ]  # fmt: skip
    return ResultTable(title, ("item", "plant", "case", "metric", "value", "limit", "verdict"), tuple(lines))


def totals(rows: Sequence[Row]) -> ResultTable:
    """Of each item how many conditions are met."""
    lines = []
    for item, about in ITEMS.items():
        verdicts = [verdict(r) for r in rows if r.quantity == item]
        lines.append((item, about, str(len(verdicts)), *(str(verdicts.count(v)) for v in VERDICTS)))
    return ResultTable("The acceptance list", ("item", "what", "conditions", *VERDICTS), tuple(lines))


def summarise(settings: Settings, results: Results) -> Summary:
    """Rows and report."""
    rows = rows_of(results)
    missed = table(rows, lambda r: not met(r), "Not met")
    remarks = [] if settings["earlier"] else ["P7 needs a checkout of the commit to compare with: --set earlier=PATH"]
    return Summary(rows, tables=[totals(rows), missed, table(rows, lambda r: True, "All conditions")], remarks=remarks)


SCENARIO = Scenario(
    name=NAME,
    title="What robust-glr has to reach",
    about="Nine items with limits that were fixed before any run: false isolation, power, two causes, starts, drifts of the "
    "plant, cost, and what a healthy log changes.",
    settings=SETTINGS,
    seeds=SEEDS,
    full_seeds=SEEDS,
    tasks=tasks,
    work=work,
    summarise=summarise,
    bounds={"first_seed": (0, 1e6)},
    optional=("earlier",),
)
