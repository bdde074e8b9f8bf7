"""engine/two-faults: offsets of two sensors (Kougiatsos 2022, Fig. 3)."""

from __future__ import annotations

from fusion_sfdia.benchmarks.engine.support.decisions import (
    alarms_table,
    departures,
    figures,
    isolation_rows,
    module_rows,
    shares,
    value_of,
)
from fusion_sfdia.benchmarks.engine.support.trials import DETECTORS, Results, gather, published_first, tasks, timeline, trial
from fusion_sfdia.evaluation.results import Row
from fusion_sfdia.experiments.scenario import Scenario, Settings, Task
from fusion_sfdia.models.marine_engine.published import TWO_FAULTS
from fusion_sfdia.report.content import Summary
from fusion_sfdia.report.findings import listed, pick

NAME, FAULT = "engine/two-faults", "two-faults"
TOLD = "the paper's own timeline"


def two_tasks(settings: Settings, seeds: int) -> list[Task]:
    """Every detector on the same runs, with the gains of that paper."""
    return tasks(settings, TWO_FAULTS.faults, seeds, design="K22")


def two_summary(settings: Settings, results: Results) -> Summary:
    """Alarms of the modules and the sensors they accuse; also of the printed timeline."""
    found = gather(results)
    told = TWO_FAULTS._replace(duration=settings["duration"])
    rows: list[Row] = []
    for detector, arrays in found.items():
        rows += module_rows(NAME, detector, FAULT, arrays, told)
        rows += isolation_rows(NAME, detector, FAULT, timeline(arrays["first"], told.faults, told.duration))
    printed = timeline(published_first(TWO_FAULTS.fired), TWO_FAULTS.faults, TWO_FAULTS.duration)
    rows += isolation_rows(NAME, DETECTORS[0], FAULT, printed, TOLD)
    of_runs = [r for r in rows if r.quantity == "all"]
    theirs = {r.metric: r.value for r in rows if r.quantity == TOLD}
    remarks = [
        *(departures(rows, d, told, "Fig. 3") for d in found),
        f"By the printed detection times our diagnosis sets name {theirs['sensors_named']:.0f} of 10 sensors at the end; the "
        "paper names 3, since it lets the last alarm, of M(4,3), change nothing, where ours allow S(4){3} a fault of its own. "
        f"Simulated: {listed(pick(of_runs, metric='sensors_named'))} sensors.",
        "With the constants of (10) as printed, xi_d of 2 and 1 1/s beside rho_d of 465 and 320 1/s, M(3,1) and M(4,1) get "
        "thresholds of hundreds of noise bounds, which no offset of 50 kPa crosses, so those of Fig. 3 must have been others: "
        f"M(3,1) fires in {shares(rows, detector=DETECTORS[1], quantity='M(3,1)', metric='fired_share')} of the runs.",
        f"Runs with an alarm before the first fault: {shares(of_runs, metric='false_alarm_share')}.",
    ]
    highlights = [
        f"{d}: both faulty sensors named at the end in "
        f"{shares(of_runs, detector=d, metric='faults_named_share').removeprefix(d).strip()} of the runs, among "
        f"{value_of(of_runs, detector=d, metric='sensors_named')} sensors"
        for d in found
    ]
    return Summary(rows, figures(found, told, "two faults"), [alarms_table(rows, told, list(found))], highlights, remarks)


SCENARIO = Scenario(
    name=NAME,
    title="Two sensor faults in a marine engine",
    about="Offsets of 50 kPa of the receiver's pressure sensor at 10 s and 8 K of the charge air's temperature sensor at 20 s, "
    "at full load with 3 % noise and the observer gains of that paper (Kougiatsos 2022, Fig. 3).",
    settings={"noise": TWO_FAULTS.noise, "duration": TWO_FAULTS.duration, "detectors": DETECTORS},
    seeds=3,
    full_seeds=100,
    tasks=two_tasks,
    work=trial,
    summarise=two_summary,
)
