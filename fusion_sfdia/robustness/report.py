"""The report of `robustness`: a chapter a plant, first what to see."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from fusion_sfdia.comparison.protocol import HEALTHY
from fusion_sfdia.comparison.subjects import cases_of, compared_plant
from fusion_sfdia.evaluation.results import Row
from fusion_sfdia.experiments.scenario import Settings
from fusion_sfdia.report.content import Chapter, Figure, Summary, Table
from fusion_sfdia.robustness.aims import AIMS, FALSE, mismatches, process_faults
from fusion_sfdia.robustness.figures import draw
from fusion_sfdia.robustness.protocol import LOG_RUNS, LOG_STEPS
from fusion_sfdia.robustness.rows import Results, index_of, rows_of, variants_of
from fusion_sfdia.robustness.tables import UNSEEN, judged, tables_of
from fusion_sfdia.robustness.variants import Variant

METHOD = (
    "Readings come from the high-fidelity model of each plant, under mismatch of another plant, with seeds on which nothing "
    "was chosen. A mismatch acts from the start, a sensor fault or process fault from the onset on, after 60 samples (engine "
    "400). Thresholds are out of reach until 30 samples before the onset, so that no alarm of the start lasts. They are "
    "scaled so that one healthy sample in a thousand alarms over all sensors while the model is right.",
    "On augmented: the plant with its uncertain parameters and errors of inputs as states. Commissioned: on a healthy log of "
    f"the real plant, {LOG_RUNS} runs of {LOG_STEPS} samples (engine {LOG_STEPS + 340}) in the usual operation with other "
    "seeds; detectors that learn from data are fitted to that log. From a log alone: the plant states nothing uncertain, and "
    f"it is judged in an operation that is not in the log. Cases marked{UNSEEN} are unseen: no setting was chosen with them in "
    "view.",
)


def summarise(settings: Settings, results: Results) -> Summary:
    """Rows, a chapter a plant, and what to see first."""
    rows = rows_of(settings, results)
    plants = [p for p in settings["plants"] if variants_of(rows, p)]
    return Summary(
        rows=rows,
        chapters=[chapter(rows, results, plant) for plant in plants],
        highlights=[sentence for plant in plants for sentence in findings(rows, plant)],
        remarks=[*left_out(results)],
        method=METHOD,
    )


def chapter(rows: Sequence[Row], results: Results, plant: str) -> Chapter:
    """What detectors do on a plant."""
    those = variants_of(rows, plant)
    figure = Figure(
        plant,
        f"{plant}: when the model is wrong",
        "Orange: samples at which a healthy sensor is isolated, none is right. Blue: samples at which exactly the faulty "
        "sensor is isolated, and runs with a process verdict, which is right for process faults and wrong for sensor faults. "
        f"Grey: not tried, or a detector without such a verdict. Cases with{UNSEEN} are unseen.",
        partial(draw, rows, plant),
        f"Shares of samples and runs for {len(those)} variants of detectors on {plant}, by condition",
    )
    return Chapter(plant, plant, findings(rows, plant), [figure], [*tables_of(rows, plant), cases_table(plant)])


def findings(rows: Sequence[Row], plant: str) -> list[str]:
    """For each variant of the judged detectors: false isolation, and how many aims it reaches."""
    index, sentences = index_of(rows), []
    for v in judged(rows, plant):
        wrong = [index.get((plant, v, HEALTHY, m, FALSE)) for m in mismatches(plant)]
        wrong += [index.get((plant, v, fault, "", FALSE)) for fault in process_faults(plant)]
        known = [row for row in wrong if row is not None]
        shown = [(aim, s) for aim in AIMS if (s := aim.worst(index, plant, v)) is not None]
        reached = sum(aim.reached(s) for aim, s in shown)
        if known:
            worst = max(known, key=lambda row: row.value)
            sentences.append(
                f"{plant}, {v}: a healthy sensor is isolated in at most {worst.value:.2f} of samples "
                f"({worst.condition or worst.fault}); {reached} of {len(shown)} aims are reached."
            )
    return sentences


def cases_table(plant: str) -> Table:
    """What is changed, and why."""
    cases = cases_of(compared_plant(plant))
    lines = [("mismatch case" + UNSEEN * c.unseen, c.name, c.why) for c in cases.mismatch]
    lines += [("process fault", c.name, c.why) for c in cases.process_faults]
    return Table("What is changed", ("kind", "name", "why"), tuple(lines), folded=True)


def left_out(results: Results) -> list[str]:
    """Variants that do not apply, and logs that commissioning refuses."""
    found = []
    for task, arrays in results:
        if "variants" in task:
            continue
        who = f"{task['plant']}, {Variant(task['detector'], task['knowledge']).name}"
        if "reason" in arrays:
            found.append(f"{who} is left out: {arrays['reason']}.")
        else:
            found += [f"{who}: the log of {name} is refused: {why}" for name, why in arrays["refused"].tolist()]
    return found
