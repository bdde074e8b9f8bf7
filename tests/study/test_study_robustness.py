"""The scenario `robustness` at a small size: its trials, its numbers, its report, and the page made of them."""

from __future__ import annotations

import importlib
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fusion_sfdia.detectors import registry
from fusion_sfdia.report.plots import style
from fusion_sfdia.report.results import Row, write_rows
from fusion_sfdia.study import robustness_report as report
from fusion_sfdia.study.comparison.subjects import cases_of, compared_plant
from fusion_sfdia.study.error_protocol import CASES, stated_cases, trial
from fusion_sfdia.study.experiments.scenario import Arrays, Settings, Task, adjust
from fusion_sfdia.study.robustness import SCENARIO, rows_of

TANKS = "two-tanks"
SMALL = {
    "plants": TANKS, "random_plants": "9101", "detectors": "robust-glr,limits,structural-residuals", "groups": "start,plant",
    "rows": "90", "first_seed": "0", "rival_seeds": "1",
}  # fmt: skip


def settings(**changes: str) -> Settings:
    return adjust(SCENARIO, SMALL | changes)


@cache
def results() -> list[tuple[Task, Arrays]]:
    return [(task, SCENARIO.work(task)) for task in SCENARIO.tasks(settings(), 2)]


def test_a_process_fault_beside_a_plant_begins_after_a_third_and_lasts() -> None:
    plant = registry.plant(TANKS)
    case = next(c for c in stated_cases(cases_of(compared_plant(TANKS))) if c.name.startswith("process fault: "))
    made = trial(plant, case, 4, 90)
    assert np.array_equal(np.flatnonzero(made.process), np.arange(30, 90))
    assert not made.faulty.any() and not case.model_is_off
    alone = trial(plant, CASES[0], 4, 90)
    assert np.isfinite(made.log.y).all() and made.log.y.shape == alone.log.y.shape


def test_mismatch_beside_a_plant_is_no_process_fault() -> None:
    plant = registry.plant(TANKS)
    for case in stated_cases(cases_of(compared_plant(TANKS))):
        if case.name.startswith("mismatch: "):
            made = trial(plant, case, 4, 90)
            assert case.model_is_off and not made.process.any() and not made.faulty.any()


def test_a_task_is_a_detector_on_a_plant() -> None:
    tasks = [task for task, _ in results()]
    assert [(t["detector"], t["plant"], t["seeds"]) for t in tasks[:3]] == [
        ("robust-glr", TANKS, 2), ("robust-glr", "random plant 9101", 2), ("limits", TANKS, 1)
    ]  # fmt: skip
    assert len(tasks) == 6


@pytest.mark.parametrize(
    "change", [{"first_seed": "-1"}, {"rows": "20"}, {"detectors": "loo-gl"}, {"thorough": "loo-gl"}, {"groups": "all"}]
)
def test_settings_of_robustness_that_do_not_fit_are_refused(change: dict[str, Any]) -> None:
    with pytest.raises(ValueError):
        SCENARIO.tasks(settings(**change), 2)


def test_the_summary_has_every_case_of_every_detector_that_applies() -> None:
    summary = SCENARIO.summarise(settings(), results())
    index = report.index_of(summary.rows)
    assert len(index) == len(summary.rows)
    leak = index[TANKS, "robust-glr", "process fault: leak", report.RIGHT]
    assert leak.n == 2 and leak.value > 0
    assert index[TANKS, "limits", "start-sampled", report.FALSE].n == 1
    own = [c.name for c in stated_cases(cases_of(compared_plant(TANKS)))]
    assert report.cases_in(summary.rows, TANKS) == ["start-sampled", "start-at-corner", *own]
    assert report.cases_in(summary.rows, "random plant 9101") == ["start-sampled", "start-at-corner"]
    missing = [task["plant"] for task, arrays in results() if "reason" in arrays]
    assert len([line for line in summary.remarks if "is left out: " in line]) == len(missing)
    for figure in summary.every_figure:
        with style():
            assert figure.draw().axes and figure.alt
    for table in (*summary.tables, *(t for chapter in summary.chapters for t in chapter.tables)):
        assert table.rows and {len(line) for line in table.rows} == {len(table.header)}, table.title


def made_up(detector: str, false: float, right: float) -> list[Row]:
    """Rows of a detector on two tanks, the same in every case."""
    rows = []
    for case in CASES:
        for metric, value in ((report.FALSE, false), (report.RIGHT, right)):
            rows.append(
                Row(report.NAME, TANKS, detector, "none", case.group, metric, value, value, value, 24, condition=case.name)
            )
    sure = Row(report.NAME, TANKS, detector, "none", "all", report.RIGHT_EVENT, 0.9, 0.8, 0.95, 50, condition=report.SURE)
    return [*rows, sure]


def test_the_worst_case_counts_and_causes_are_not_among_them() -> None:
    rows = made_up("robust-glr", 0.0, 0.9)
    changed = {"ar-0.8": 0.25, "bias-10": 0.5}
    rows = [
        Row(*(getattr(r, n) for n in ("scenario", "plant", "detector", "fault", "quantity", "metric")), changed[r.condition],
            0.0, 1.0, 24, condition=r.condition) if r.metric == report.FALSE and r.condition in changed else r
        for r in rows
    ]  # fmt: skip
    assert report.summary_numbers(rows, TANKS, "robust-glr") == pytest.approx((0.25, 0.0, 0.9, 0.9, 0.9))
    assert np.isnan(report.summary_numbers(rows, TANKS, "loo-glr")).all()


def test_the_page_is_made_of_rows_of_several_files(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(root / "docs" / "results"))
    page = importlib.import_module("robustness")
    first, second = tmp_path / "first.csv", tmp_path / "second.csv"
    write_rows(first, made_up("loo-glr", 1.0, 0.0))
    write_rows(second, [*made_up("loo-glr", 0.5, 0.5), *made_up("robust-glr", 0.01, 0.9)])
    rows = page.load([first, second])
    text = page.render(rows)
    assert "| loo-glr | 1.00 | 1.00 | 0.00 |" in text and "| robust-glr | 0.01 | 0.01 | 0.90 |" in text
    write_rows(tmp_path / "again.csv", rows)
    assert page.render(page.load([tmp_path / "again.csv"])) == text
    count = sum(case.group in report.WITHOUT_CAUSE for case in CASES)
    assert f"under {count} errors" in page.trust(rows) and f"in at most 2 % of the rows in {count};" in page.trust(rows)


def test_the_page_on_wrong_models_is_that_of_its_numbers(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(root / "docs" / "results"))
    page = importlib.import_module("robustness")
    assert page.render(page.load([page.NUMBERS]), page.read_rows(page.LIMITS)) == page.PAGE.read_text(encoding="utf-8")


def test_every_row_of_a_result_is_kept() -> None:
    rows = rows_of(results())
    assert {r.scenario for r in rows} == {report.NAME}
    assert len(rows) == sum(arrays["value"].size for _, arrays in results() if "reason" not in arrays)
