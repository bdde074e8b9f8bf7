"""The smallest size at which each scenario gives its rows and figures, run once in a process for all tests that read it."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from threadpoolctl import threadpool_limits

from fusion_sfdia.report.content import Summary
from fusion_sfdia.study.experiments.scenario import Arrays, Task
from fusion_sfdia.study.scenarios import scenario

PIPELINE = {"steps": 75}
RECORDED = Path(__file__).resolve().parents[3] / "shared" / "fixtures" / "tep_braatz"  # next to the checkout
SMALLEST: dict[str, tuple[int, dict[str, Any]]] = {  # name: seeds, settings that differ from the default
    "chemical/monitored": (
        1,
        {"data": str(RECORDED), "measurements": (7,), "kind": "factors", "false_alarm": 0.05},
    ),
    "chemical/recorded": (1, {"data": str(RECORDED), "measurements": (7,), "sizes": (10.0,)}),
    "pipeline/accommodation": (1, PIPELINE),
    "pipeline/accuracy": (1, PIPELINE),
    "pipeline/consistency": (1, PIPELINE),
    "pipeline/estimation": (1, PIPELINE),
    "pipeline/isolation": (1, {**PIPELINE, "faults": ("weak-bias",)}),
    "pipeline/mismatch": (1, PIPELINE),
    "pipeline/roc": (1, PIPELINE),
    "pipeline/units": (1, PIPELINE),
    "pipeline/weak": (1, PIPELINE),
    "engine/load": (2, {"drives": ("constant", "step"), "change": 0.3, "onset": 0.5, "duration": 1.0}),
    "engine/minimum-fault": (2, {"duration": 1.5}),
    "engine/noise": (2, {"levels": (0.03, 0.05), "onset": 0.5, "duration": 1.0}),
    "engine/process": (2, {"severities": (0.2,), "period": 0.3, "onset": 0.5, "duration": 1.0}),
    "engine/sensitivity": (2, {"levels": (0.05,), "gains": ("K22", "K24"), "onset": 0.3, "duration": 0.5}),
    "engine/three-faults": (1, {"duration": 72.0}),  # the last fault is at 70 s
    "engine/two-faults": (1, {"duration": 22.0}),
    "engine/virtual-sensors": (1, {"duration": 42.0, "inversion_seeds": 1}),  # errors are averaged from 40 s on
    "network/attacks": (2, {"noises": ("lit",), "faults": ("-u", "slow governor"), "duration": 75.0}),
    "network/consensus": (4, {"steps": 40}),
    "network/detectors": (6, {}),
    # the rule "conformal" needs 999 samples for one in a thousand: 10 runs of 101
    "network/false-alarms": (10, {"shock_steps": 500, "laws": ("gaussian",), "shocks": ("three-point 90",)}),
    "network/governor": (2, {"noises": ("lit",), "duration": 75.0}),
    "network/plug": (3, {}),
    "network/scale": (1, {"areas": (15, 40), "parts": (), "robust": (15,), "seconds": 1e-3}),
    "network/sign-flip": (
        2,
        {"noises": ("small",), "modes": ("corrected",), "cases": ("three consecutive", "one"), "duration": 75.0},
    ),
}
EVERY = 4  # of the tasks on the pipeline, which differ in detector and faults, where there are many


class Run(NamedTuple):
    """The tasks that were run, their arrays, and the summary."""

    results: list[tuple[Task, Arrays]]
    summary: Summary


@cache
def smallest(name: str) -> Run:
    """The scenario at its smallest size; a scenario that is not in SMALLEST with its default settings and one seed."""
    one = scenario(name)
    seeds, changes = SMALLEST.get(name, (1, {}))
    settings = {**one.settings, **changes}
    with threadpool_limits(1):
        results = [(task, one.work(task)) for task in some(one.tasks(settings, seeds))]
        return Run(results, one.summarise(settings, results))


def some(tasks: list[Task]) -> list[Task]:
    """All tasks, or of many on the pipeline every fourth."""
    return tasks[::EVERY] if len(tasks) >= 2 * EVERY and "accommodate" in tasks[0] else tasks
