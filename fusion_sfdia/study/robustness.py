"""robustness: what detectors make of readings, starts, models and causes that are not as stated, from the first sample on.

Every detector as it is shipped, with its own thresholds, on the registered plants and on `random_plant`s that nothing was
tuned on. A piece of work is one detector on one plant: an `audit`, with the cases that stand beside the plant.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fusion_sfdia.common.errors import NotApplicableError
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.registry import require_known
from fusion_sfdia.report.content import Summary
from fusion_sfdia.report.results import Row
from fusion_sfdia.study.audit import FEWEST, audit
from fusion_sfdia.study.comparison.subjects import cases_of, compared_plant
from fusion_sfdia.study.error_protocol import GROUPS, OF_PLANT, STEPS, stated_cases
from fusion_sfdia.study.experiments.scenario import Arrays, Scenario, Settings, Task
from fusion_sfdia.study.random_plants import random_plant
from fusion_sfdia.study.robustness_report import NAME, Results, summary_of

SEEDS = 24
SETTINGS = {
    "plants": ("two-tanks", "marine-engine", "gas-pipeline", "power-network"),
    "random_plants": (9101, 9102, 9103),  # seeds
    "detectors": tuple(registry.compared_detectors()),
    "groups": (*GROUPS, OF_PLANT),
    "rows": STEPS,
    "first_seed": 8000,  # those of a run are fresh: nothing was chosen on them; below 1000 to choose something
    "thorough": ("robust-glr", "loo-glr"),  # detectors that are judged with all seeds
    "rival_seeds": 6,  # of the others, at most
}


def tasks(settings: Settings, seeds: int) -> list[Task]:
    """One detector on one plant a task. ValueError for an unknown plant, detector or group."""
    for group in settings["groups"]:
        require_known("group", group, (*GROUPS, OF_PLANT))
    for name in (*settings["detectors"], *settings["thorough"]):
        require_known("detector", name, registry.detectors())
    plants = [(compared_plant(name).name, -1) for name in settings["plants"]]
    plants += [(random_plant(seed).name, seed) for seed in settings["random_plants"]]
    common = {"groups": list(settings["groups"]), "rows": settings["rows"], "first_seed": settings["first_seed"]}
    found: list[Task] = []
    for detector in settings["detectors"]:
        count = seeds if detector in settings["thorough"] else min(seeds, settings["rival_seeds"])
        found += [{"plant": name, "random": seed, "detector": detector, "seeds": count} | common for name, seed in plants]
    return found


def work(task: Task) -> Arrays:
    """The numbers of an audit, or the `reason` why the detector does not apply to the plant.

    quantity, condition, metric (R,): group, case and what is measured; value, low, high, n (R,). absent: cases with trials
    that are left out, and why, in words.
    """
    known = task["random"] < 0
    plant = registry.plant(task["plant"]) if known else random_plant(task["random"])
    stated = stated_cases(cases_of(compared_plant(task["plant"]))) if known and OF_PLANT in task["groups"] else ()
    seeds = range(task["first_seed"], task["first_seed"] + task["seeds"])
    try:
        detector = registry.detector(task["detector"], plant)
        generic = [group for group in task["groups"] if group != OF_PLANT]
        found = audit(detector, seeds=seeds, steps=task["rows"], groups=generic, more=stated)
    except NotApplicableError as problem:
        return {"reason": np.array(str(problem))}
    rows = found.rows()
    names = {what: np.array([getattr(r, what) for r in rows]) for what in ("quantity", "condition", "metric")}
    numbers = {what: np.array([getattr(r, what) for r in rows]) for what in ("value", "low", "high", "n")}
    absent = [f"{r.case.name}: {r.absent} of {len(seeds)} trials, {r.left_out}" for r in found.results if r.absent]
    return {**names, **numbers, "absent": np.array(absent, dtype=str)}


def rows_of(results: Results) -> list[Row]:
    """The rows of metrics.csv, of the detectors that apply."""
    rows = []
    for task, arrays in results:
        if "reason" not in arrays:
            like = Row(NAME, task["plant"], task["detector"], "none", "", "", 0.0)
            columns = ("quantity", "condition", "metric", "value", "low", "high", "n")
            for values in zip(*(arrays[c].tolist() for c in columns), strict=True):
                rows.append(replace(like, **dict(zip(columns, values, strict=True))))
    return rows


def left_out(results: Results) -> list[str]:
    """Detectors that do not apply to a plant, and trials that are left out, each with the reason."""
    found: list[str] = []
    for task, arrays in results:
        who = f"{task['plant']}, {task['detector']}"
        if "reason" in arrays:
            found.append(f"{who} is left out: {arrays['reason']}")
        else:
            found += [f"{who}: {one}" for one in arrays["absent"].tolist()]
    return found


def summarise(settings: Settings, results: Results) -> Summary:
    """Rows and report."""
    return summary_of(rows_of(results), left_out(results))


SCENARIO = Scenario(
    name=NAME,
    title="When the model is wrong",
    about="A real plant is not as its model and its sensors are stated. What every detector, as it is shipped, makes of noise "
    "of other kinds, starts away from rest, model errors, and one or two causes at a time, live from the first sample: whether "
    "its verdicts are right, undecided or wrong, and how far its confidence can be believed.",
    settings=SETTINGS,
    seeds=SEEDS,
    full_seeds=SEEDS,
    tasks=tasks,
    work=work,
    summarise=summarise,
    bounds={"rows": (FEWEST, 1e5), "first_seed": (0, 1e6), "rival_seeds": (1, 1e6), "random_plants": (0, 1e6)},
    optional=("plants", "random_plants", "thorough"),
)
