"""engine/two-faults: offsets of two sensors (Kougiatsos 2022, Fig. 3)."""

from __future__ import annotations

from fusion_sfdia.benchmarks.engine.support.decisions import shares, value_of
from fusion_sfdia.benchmarks.engine.support.published_runs import compare_with_published
from fusion_sfdia.benchmarks.engine.support.trials import DETECTORS, SAMPLING, Results, by_detector, tasks, trial
from fusion_sfdia.models.marine_engine.published import TWO_FAULTS
from fusion_sfdia.report.content import Summary
from fusion_sfdia.report.scenario_sentences import listed, pick
from fusion_sfdia.study.experiments.scenario import Scenario, Settings, Task

NAME, FAULT = "engine/two-faults", "two-faults"


def two_tasks(settings: Settings, seeds: int) -> list[Task]:
    """Every detector on the same runs, with the gains of that paper."""
    return tasks(settings, TWO_FAULTS.faults, seeds, design="K22")


def two_summary(settings: Settings, results: Results) -> Summary:
    """Alarms of the modules and the sensors they isolate; also of the printed timeline."""
    found = by_detector(results)
    compared = compare_with_published(NAME, FAULT, found, TWO_FAULTS, settings["duration"], what="two faults", figure="Fig. 3")
    rows = [*(r for of in compared.by_detector.values() for r in of), *compared.of_timeline]
    of_runs = pick(rows, quantity="all", condition="")
    remarks = [
        *compared.differences,
        f"From the printed detection times our diagnosis sets isolate {compared.logic_alone['isolated_sensors']:.0f} of 10 "
        "sensors at the end; the paper isolates 3, because its last alarm, of M(4,3), changes nothing, whereas our sets allow "
        f"a fault of S(4){{3}}. Simulated: {listed(pick(of_runs, metric='isolated_sensors'))} sensors.",
        "With the constants of (10) as printed, xi_d of 2 and 1 1/s with rho_d of 465 and 320 1/s, M(3,1) and M(4,1) get "
        "thresholds of hundreds of noise bounds, which no offset of 50 kPa crosses, so Fig. 3 must have been made with other "
        f"constants: M(3,1) fires in {shares(rows, detector=DETECTORS[1], quantity='M(3,1)', metric='fired_share')} of the "
        "runs.",
        f"Runs with an alarm before the first fault: {shares(of_runs, metric='false_alarm_share')}.",
    ]
    highlights = [
        f"{d}: both faulty sensors isolated at the end in "
        f"{shares(of_runs, detector=d, metric='faults_isolated_share').removeprefix(d).strip()} of the runs, among "
        f"{value_of(of_runs, detector=d, metric='isolated_sensors')} sensors"
        for d in found
    ]
    return Summary(rows, compared.figures, [compared.table], highlights, remarks)


SCENARIO = Scenario(
    name=NAME,
    title="Two sensor faults in a marine engine",
    about="Offsets of 50 kPa of the receiver's pressure sensor at 10 s and 8 K of the charge air's temperature sensor at 20 s, "
    "at full load with 3 % noise and the observer gains of that paper (Kougiatsos 2022, Fig. 3).",
    settings={"noise": TWO_FAULTS.noise, "duration": TWO_FAULTS.duration, "detectors": DETECTORS, "sampling": SAMPLING},
    seeds=3,
    full_seeds=100,
    tasks=two_tasks,
    work=trial,
    summarise=two_summary,
    papers=("kougiatsos2022",),
)
