"""network/detectors: detection delays of the paper's residual and of other tests at the same false-alarm rate."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.benchmarks.network.support.detector_figures import (
    CASES,
    LEVEL,
    LEVELS,
    TESTS,
    Measured,
    curve_figure,
    delay_figure,
    remarks,
    table,
)
from fusion_sfdia.benchmarks.network.support.innovations import chi_square, innovations, standardised
from fusion_sfdia.benchmarks.network.support.residuals import CORRECTED, MEMORYLESS, SETTLE, owners, streams
from fusion_sfdia.benchmarks.network.support.rows import row
from fusion_sfdia.common.run_statistics import Estimate, mean_over_runs, proportion, rate_over_runs
from fusion_sfdia.detectors.stochastic_thresholds.confirmation import (
    Confirmation,
    ConfirmationCusum,
    Consecutive,
    WindowGlr,
    run,
)
from fusion_sfdia.detectors.stochastic_thresholds.threshold_rules import conformal_alpha
from fusion_sfdia.models.power_network.model import PROCESS_VARIANCE, network_model
from fusion_sfdia.models.power_network.operation import AreaFault, load_profile
from fusion_sfdia.models.power_network.parameters import load_steps
from fusion_sfdia.models.power_network.simulation import run_network
from fusion_sfdia.report.content import Summary
from fusion_sfdia.report.results import Row
from fusion_sfdia.study.experiments.scenario import Arrays, Scenario, Settings, Task, seed_blocks

Array = NDArray[Any]

NAME = "network/detectors"
CHUNK = 100  # runs in one task
APART = 10**6  # added to a seed for the healthy runs that set the levels
STEPS = 110
DRIFT, WINDOW = 1.0, 8  # of the cumulative sum, half the shift to be detected; of the likelihood ratio, in steps
# loads of B18's scenario, unplugged areas, faulty area, onset (s)
SETTINGS: dict[str, tuple[str, tuple[str, ...], str, float]] = {
    "1": ("1", ("15",), "4", 35.0),
    "2": ("2", (), "5", 45.0),
}


def detector_tasks(settings: Settings, seeds: int) -> list[Task]:
    """Healthy runs of both scenarios, which set the levels, and runs of each fault."""
    weak = settings["weak"]
    if not 0 < weak < 1:
        raise ValueError(f"weak is {weak:g}; expected a share of the load in per unit between 0 and 1")
    cells: list[tuple[str, str | None]] = [("1", None), ("2", None), *((CASES[name], name) for name in CASES)]
    return [
        {"noise": noise, "scenario": scenario, "fault": fault, "weak": weak, "seeds": block}
        for noise in PROCESS_VARIANCE
        for scenario, fault in cells
        for block in seed_blocks(seeds if fault else 2 * seeds, CHUNK, 0 if fault else APART)
    ]


def detector_work(task: Task) -> Arrays:
    """The statistic of each of TESTS (K, B) from SETTLE s on, of the diagnoser of the faulty area."""
    scenario, away, area, onset = SETTINGS[task["scenario"]]
    model = network_model(noise=task["noise"], unplugged=away)
    faults = [] if task["fault"] is None else [fault_of(task["fault"], area, onset, task["weak"])]
    loads = load_profile(model, load_steps(scenario))
    moments = list(run_network(model, STEPS, task["seeds"], loads=loads, faults=faults))
    mine = owners(model) == model.names.index(area)
    z = streams(model, moments, (CORRECTED, MEMORYLESS))
    found = innovations(model, moments)
    fresh = standardised(found, mine)[SETTLE:]

    def largest(test: Confirmation, values: Array) -> Array:
        known = values[..., np.isfinite(values).all(axis=(0, 1))]
        return np.asarray(run(test, known).max(axis=-1))

    level = 1.0  # the level is set by the summary
    memory, plain = z[CORRECTED.name][..., mine], z[MEMORYLESS.name][..., mine]
    statistics = (
        largest(Consecutive(level, 1), memory),
        largest(Consecutive(level, 3), memory),
        largest(ConfirmationCusum(level, DRIFT), plain),
        largest(WindowGlr(level, WINDOW), plain),
        chi_square(found, mine)[SETTLE:],
        largest(ConfirmationCusum(level, DRIFT), fresh),
        largest(WindowGlr(level, WINDOW), fresh),
    )
    return dict(zip(TESTS, statistics, strict=True))


def fault_of(name: str, area: str, onset: float, weak: float) -> AreaFault:
    """The fault of a case: the faults of B18's scenarios, and a loss of load, our choice."""
    kind, value = {"governor": ("governor", 1000.0), "sign-flip": ("input-gain", -1.0), "load-loss": ("load-loss", weak)}[name]
    return AreaFault(kind, area, value, onset)


def delays(statistic: Array, level: float, onset: float) -> tuple[Array, Array]:
    """Seconds from the onset to the first alarm after it (B,), or to the end of the run, and whether there was one."""
    after = statistic[int(onset) - SETTLE + 1 :] > level  # a fault is read a step after its onset
    seen: Array = np.any(after, axis=0)
    return np.where(seen, np.argmax(after, axis=0) + 1.0, after.shape[0]), seen


def detector_summary(settings: Settings, results: list[tuple[Task, Arrays]]) -> Summary:
    """Levels from the healthy runs; delays, missed detections and false alarms of the others."""
    cells: dict[tuple[str, str, str | None], list[Arrays]] = {}
    for task, arrays in results:
        cells.setdefault((task["noise"], task["scenario"], task["fault"]), []).append(arrays)
    joined = {key: {t: np.concatenate([p[t] for p in parts], axis=1) for t in TESTS} for key, parts in cells.items()}
    measured: dict[Measured, Row] = {}

    def add(key: Measured, area: str, estimate: Estimate) -> None:
        detector, how = TESTS[key.test]
        where = f"{how}, false alarms {key.level:g}, {key.noise}"
        measured[key] = row(NAME, detector, key.fault, f"area {area}", key.metric, estimate, condition=where)

    for (noise, scenario, fault), found in joined.items():
        if fault is None or (noise, scenario, None) not in joined:
            continue
        *_, area, onset = SETTINGS[scenario]
        for test in TESTS:
            scores = joined[noise, scenario, None][test].ravel()
            for p in LEVELS:
                level = float(conformal_alpha(scores, p))
                delay, seen = delays(found[test], level, onset)
                mean = mean_over_runs(delay, np.ones(delay.shape, bool))
                add(Measured(fault, test, p, noise), area, mean)
                missed = proportion(int((~seen).sum()), seen.size)
                add(Measured(fault, test, p, noise, "missed_detection_rate"), area, missed)
                if p == LEVEL:
                    before = found[test][: int(onset) - SETTLE + 1] > level
                    rate = rate_over_runs(before.sum(axis=0), np.full(before.shape[1], before.shape[0]))
                    add(Measured(fault, test, p, noise, "false_alarm_probability"), area, rate)
    figures = [delay_figure(measured), curve_figure(measured)]
    sentences = remarks(measured)
    return Summary(list(measured.values()), figures, [table(measured)], sentences[:1], sentences[1:])


SCENARIO = Scenario(
    name=NAME,
    title="Detectors at the same false-alarm rate",
    about="Strong and weak faults of the power network: mean delay of the faulty area's diagnoser by the paper's residual "
    "with one alarm and with three consecutive alarms, by cumulative sums and windowed likelihood ratios of residuals, and by "
    "a Kalman filter on the whole network; each at the level at which one healthy step in a thousand has an alarm.",
    settings={"weak": 0.07},
    seeds=100,
    full_seeds=1000,
    tasks=detector_tasks,
    work=detector_work,
    summarise=detector_summary,
)
