"""robustness: what detectors do when the model is wrong, and which of them can tell a sensor from the process.

What a detector knows of the plant: `variants`. What is tried: `protocol`, with the cases that stand beside each plant. How:
`run`, with `material` and `records`. The numbers: `rows`, and what they should be: `aims`. The report: `report`.
"""

from __future__ import annotations

from fusion_sfdia.comparison.subjects import compared_plant
from fusion_sfdia.experiments.scenario import Scenario, Settings, Task
from fusion_sfdia.robustness.protocol import SETTINGS
from fusion_sfdia.robustness.report import summarise
from fusion_sfdia.robustness.rows import SCENARIO as NAME
from fusion_sfdia.robustness.run import work
from fusion_sfdia.robustness.variants import variants

SEEDS = 24


def tasks(settings: Settings, seeds: int) -> list[Task]:
    """One variant on one plant with all seeds a task, and for each plant one that times them all."""
    first = int(settings["first_seed"])
    names = ("plants", "detectors", "knowledge", "first_seed")
    common = {k: list(v) if isinstance(v, tuple) else v for k, v in settings.items() if k not in names}
    common["seeds"] = list(range(first, first + seeds))
    those = variants(settings["detectors"], settings["knowledge"])
    found: list[Task] = []
    for plant in settings["plants"]:
        of = {"plant": compared_plant(plant).name}
        found += [of | {"detector": one.detector, "knowledge": one.knowledge} | common for one in those]
        found.append(of | {"variants": [list(one) for one in those]})
    return found


SCENARIO = Scenario(
    name=NAME,
    title="When the model is wrong",
    about="A real plant is not its model. Detectors on the plant as it is, on the augmented plant and commissioned on a "
    "healthy log: what they isolate under model mismatch, under faults of the process and under slow drifts, and whether they "
    "name the process where it has changed.",
    settings=SETTINGS,
    seeds=SEEDS,
    full_seeds=SEEDS,
    tasks=tasks,
    work=work,
    summarise=summarise,
    bounds={
        "first_seed": (0, 1e6),
        "window": (2, 1e6),
        "watch": (2, 1e6),
        "false_alarm": (1e-6, 0.5),
        "calibration_error": (1e-3, 0.99),
    },
    optional=("slow",),
)
