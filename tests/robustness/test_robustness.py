"""The scenario at a small size on two tanks: it runs to rows, tables and a report, with the same bits again."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from fusion_sfdia.experiments.scenario import Arrays, Settings, Task, adjust
from fusion_sfdia.report.plots import style
from fusion_sfdia.robustness.aims import EXACT, FALSE
from fusion_sfdia.robustness.rows import index_of
from fusion_sfdia.robustness.scenario import SCENARIO
from fusion_sfdia.robustness.variants import Variant

pytestmark = pytest.mark.slow

TANKS = "two-tanks"
SMALL = {
    "plants": TANKS, "detectors": "loo-glr,limits-ewma", "knowledge": "plant,augmented", "first_seed": "0", "slow": "40",
    "watch": "30", "calibration_error": "0.6",
}  # fmt: skip


def settings(**changes: str) -> Settings:
    return adjust(SCENARIO, SMALL | changes)


@cache
def results() -> list[tuple[Task, Arrays]]:
    return [(task, SCENARIO.work(task)) for task in SCENARIO.tasks(settings(), 2)]


def of(variant: Variant) -> tuple[Task, Arrays]:
    return next(r for r in results() if (r[0].get("detector"), r[0].get("knowledge")) == tuple(variant))


def test_a_task_a_variant_and_one_that_times_them() -> None:
    tasks = [task for task, _ in results()]
    assert len(tasks) == 5 and tasks[-1]["variants"] == [
        [d, k] for d in ("loo-glr", "limits-ewma") for k in ("plant", "augmented")
    ]
    assert all(task["seeds"] == [0, 1] for task in tasks[:-1])
    assert SCENARIO.tasks(adjust(SCENARIO, SMALL | {"first_seed": "7"}), 2)[0]["seeds"] == [7, 8]


def test_the_same_task_gives_the_same_bits() -> None:
    task, before = of(Variant("loo-glr", "augmented"))
    again = SCENARIO.work(task)
    assert again.keys() == before.keys()
    assert all(np.array_equal(again[name], before[name], equal_nan=before[name].dtype.kind == "f") for name in before)


def test_a_variant_that_is_the_same_as_another_is_left_out_with_its_reason() -> None:
    _, arrays = of(Variant("limits-ewma", "augmented"))
    assert set(arrays) == {"reason"} and "no model" in str(arrays["reason"])


def test_the_summary_shows_what_the_uncertainty_of_a_plant_is_worth() -> None:
    summary = SCENARIO.summarise(settings(), results())
    index = index_of(summary.rows)

    def value(detector: str, fault: str, metric: str, condition: str = "") -> float:
        return index[TANKS, detector, fault, condition, metric].value

    # outlets 5 % off: a healthy sensor in every sample without their uncertainty, none with it; the bias is found with it
    assert value("loo-glr", "none", FALSE, "outlets -5 %") > 0.9
    assert value("loo-glr on augmented", "none", FALSE, "outlets -5 %") < 0.1
    assert value("loo-glr", "bias-10-sigma", EXACT, "outlets -5 %") < 0.1
    assert value("loo-glr on augmented", "bias-10-sigma", EXACT, "outlets -5 %") > 0.9
    assert value("loo-glr", "bias-3-sigma", "auc") > 0.95 and value("loo-glr", "leak", FALSE) > 0.5
    assert value("loo-glr", "none", "step_time_ratio") == 1.0
    assert not any(r.metric.startswith("process") for r in summary.rows)
    keys = [(r.plant, r.detector, r.fault, r.condition, r.metric) for r in summary.rows]
    assert len(set(keys)) == len(keys)
    assert len(summary.remarks) == 1 and "limits-ewma on augmented is left out" in summary.remarks[0]
    (chapter,) = summary.chapters
    for figure in chapter.figures:
        with style():
            assert figure.draw().axes and figure.alt
    for table in chapter.tables:
        assert {len(line) for line in table.rows} == {len(table.header)}


@pytest.mark.parametrize("change", [{"first_seed": "-1"}, {"window": "1"}, {"detectors": "loo-gl"}, {"knowledge": "all"}])
def test_settings_that_do_not_fit_are_refused(change: dict[str, Any]) -> None:
    with pytest.raises(ValueError):
        SCENARIO.tasks(settings(**change), 2)
