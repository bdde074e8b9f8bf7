"""engine/three-faults: offsets of three sensors one after the other (Kougiatsos 2024, Fig. 4, and P^U, P^E of its sec. VII)."""

from __future__ import annotations

from functools import partial

from fusion_sfdia.benchmarks.engine.support.decisions import (
    alarms_table,
    departures,
    figures,
    isolation_rows,
    module_rows,
    pattern_share,
    shares,
    value_of,
)
from fusion_sfdia.benchmarks.engine.support.trials import (
    DETECTORS,
    Results,
    gather,
    published_first,
    row,
    tasks,
    timeline,
    trial,
)
from fusion_sfdia.evaluation.results import Row
from fusion_sfdia.experiments.scenario import Scenario, Settings, Task
from fusion_sfdia.models.marine_engine.published import (
    AT_NOMINAL_SPEED,
    EXONERATION_HALF_WIDTH,
    EXONERATION_PERFORMANCE,
    ISOLATION_HALF_WIDTH,
    ISOLATION_PERFORMANCE,
    THREE_FAULTS,
)
from fusion_sfdia.report.content import Summary
from fusion_sfdia.report.findings import listed, pick

NAME, FAULT = "engine/three-faults", "three-faults"
PUBLISHED = (ISOLATION_PERFORMANCE, EXONERATION_PERFORMANCE)
TOLD = "the paper's own timeline"
PRINTED = "(30) as printed"


def three_tasks(settings: Settings, seeds: int) -> list[Task]:
    """Every detector on the same runs, and the last with (30) as printed."""
    usual = tasks(settings, THREE_FAULTS.faults, seeds)
    return [*usual, *({**task, "design": AT_NOMINAL_SPEED} for task in usual if task["detector"] == DETECTORS[-1])]


def three_summary(settings: Settings, results: Results) -> Summary:
    """Alarms of the modules, P^U and P^E; also of the printed timeline, by hand."""
    found = gather([(task, arrays) for task, arrays in results if task["design"] != AT_NOMINAL_SPEED])
    as_printed = gather([(task, arrays) for task, arrays in results if task["design"] == AT_NOMINAL_SPEED])
    told = THREE_FAULTS._replace(duration=settings["duration"])
    rows: list[Row] = []
    for detector, arrays in found.items():
        at = partial(row, NAME, detector, FAULT)
        rows += module_rows(NAME, detector, FAULT, arrays, told)
        rows += isolation_rows(
            NAME, detector, FAULT, timeline(arrays["first"], told.faults, told.duration), published=PUBLISHED
        )
        rows += [
            at("all", "published_pattern_share", pattern_share(arrays["first"], told)),
            at("all but M(3,3)", "published_pattern_share", pattern_share(arrays["first"], told, ("M(3,3)",))),
        ]
    for detector, arrays in as_printed.items():
        at, lines = partial(row, NAME, detector, FAULT), timeline(arrays["first"], told.faults, told.duration)
        rows += isolation_rows(NAME, detector, FAULT, lines, PRINTED, PUBLISHED)
        rows += [
            at(f"{q}, {PRINTED}", "published_pattern_share", pattern_share(arrays["first"], told, but))
            for q, but in (("all", ()), ("all but M(3,3)", ("M(3,3)",)))
        ]
    printed = timeline(published_first(THREE_FAULTS.fired), THREE_FAULTS.faults, THREE_FAULTS.duration)
    rows += isolation_rows(NAME, DETECTORS[0], FAULT, printed, TOLD, PUBLISHED)
    of_runs = [r for r in rows if r.quantity == "all"]
    oracle = {r.metric: r.value for r in rows if r.quantity == TOLD}
    remarks = [
        f"Decision logic alone: the detection times that the paper prints, by our diagnosis sets, give P^U "
        f"{oracle['isolation_performance_percent']:.1f} % and P^E {oracle['exoneration_performance_percent']:.1f} % "
        f"(rows '{TOLD}'); it states {ISOLATION_PERFORMANCE.value} +- {ISOLATION_HALF_WIDTH} and "
        f"{EXONERATION_PERFORMANCE.value} +- {EXONERATION_HALF_WIDTH} over 100 runs, of which that is one. The "
        f"length of a run, {told.duration:g} s here, is not stated: 100 s is ours, chosen because its P^E is near. Our "
        f"simulated runs: P^U {listed(pick(of_runs, metric='isolation_performance_percent'))}; P^E "
        f"{listed(pick(of_runs, metric='exoneration_performance_percent'))}.",
        *(departures(rows, d, told, "Fig. 4") for d in found),
        "A faulty sensor is read by modules of other variables too, as the printed tables have it (* in Tables I to III): a "
        "torque that reads 38 kN m too little changes the speed that M(3,1) reckons with, and thresholds that only bound the "
        "noise show it. With wider ones Fig. 4 can be had: all ten modules are as there in "
        f"{shares(rows, metric='published_pattern_share', quantity='all')} of the runs, all but M(3,3) in "
        f"{shares(rows, metric='published_pattern_share', quantity='all but M(3,3)')}. M(3,3), which fires at "
        "69.9 s in the paper, before the third fault, reads one faulty sensor, S(3){1} from 45 s on. Ours take p_6 and T_6 at "
        "the speed that the torque says, as K22 (6) has it; with K24 (30) as printed, at nominal speed, M(2,1) and M(2,2) do "
        "not notice the torque's fault, and the pattern but for M(3,3) shows in "
        f"{shares(rows, metric='published_pattern_share', quantity=f'all but M(3,3), {PRINTED}')} of the runs.",
        "Runs with an alarm before the first fault: "
        f"{shares(of_runs, metric='false_alarm_share')}. The published constants of M(3,1) and M(4,1) bound less than "
        "the noise can do (rho below 1, rho_d below the gain).",
        "The more modules fire, the more sensors are accused, and latched decisions do not let go of them. Every faulty "
        f"sensor is named at the end in {shares(of_runs, metric='faults_named_share')} of the runs, among "
        f"{listed(pick(of_runs, metric='sensors_named'))} sensors.",
        "The published numbers are of another engine in part: the papers give few of the parameters, and the geometry, the "
        "rating and the turbocharger's data here are recalled or chosen so that the operating point closes "
        "(marine_engine_parameters.toml).",
    ]
    highlights = [
        f"{d}: P^U {value_of(of_runs, detector=d, metric='isolation_performance_percent')} % (published "
        f"{ISOLATION_PERFORMANCE.value}), P^E {value_of(of_runs, detector=d, metric='exoneration_performance_percent')} % "
        f"(published {EXONERATION_PERFORMANCE.value}), sensors named for 3 faulty ones: "
        f"{value_of(of_runs, detector=d, metric='sensors_named')}"
        for d in found
    ]
    return Summary(rows, figures(found, told, "three faults"), [alarms_table(rows, told, list(found))], highlights, remarks)


SCENARIO = Scenario(
    name=NAME,
    title="Three sensor faults in a marine engine",
    about="Offsets of -38 kN m of the torque sensor at 20 s, 50 kPa of the receiver's pressure sensor at 45 s and 8 K of the "
    "charge air's temperature sensor at 70 s, at full load with 5 % noise: residuals, thresholds and decisions of the ten "
    "modules, and how many sensors they accuse (Kougiatsos 2024, Fig. 4, (25), (26)).",
    settings={"noise": THREE_FAULTS.noise, "duration": THREE_FAULTS.duration, "detectors": DETECTORS},
    seeds=3,
    full_seeds=100,
    tasks=three_tasks,
    work=trial,
    summarise=three_summary,
)
