"""Aims and tables of made-up rows: what is reached is stated, and what is not, too."""

from __future__ import annotations

import importlib
from functools import cache
from pathlib import Path

import pytest
from made_up_robustness import BLIND, KNOWING, PLANT, both, made_up, row

from fusion_sfdia.evaluation.results import write_rows
from fusion_sfdia.report.plots import style
from fusion_sfdia.robustness import aims, tables
from fusion_sfdia.robustness.aims import AIMS, AT_END, EXACT, FALSE
from fusion_sfdia.robustness.figures import columns_of, draw
from fusion_sfdia.robustness.protocol import slow_name
from fusion_sfdia.robustness.report import findings
from fusion_sfdia.robustness.rows import index_of, variants_of


def reached(rows: list, detector: str) -> dict[str, bool]:
    index = index_of(rows)
    found = {aim.name: (aim, aim.worst(index, PLANT, detector)) for aim in AIMS}
    return {name: aim.reached(shown) for name, (aim, shown) in found.items() if shown is not None}


def test_one_detector_reaches_every_aim_and_the_other_those_of_the_right_model() -> None:
    assert all(reached(both(), KNOWING).values()) and len(reached(both(), KNOWING)) == len(AIMS)
    blind = reached(both(), BLIND)
    missed = {name for name, kept in blind.items() if not kept}
    assert missed == {name for name in blind if "mismatch" in name or name == "healthy sensors isolated, process faults"}
    assert len(missed) == 5 and not any("verdict" in name for name in blind)


def test_of_several_cases_the_one_farthest_from_its_limit_counts() -> None:
    case = aims.mismatches(PLANT, unseen=True)[-1]
    rows = [r for r in both() if (r.detector, r.metric, r.condition) != (KNOWING, FALSE, case)]
    rows.append(row(KNOWING, "none", FALSE, 0.4, case))
    aim = next(a for a in AIMS if "unseen" in a.name)
    shown = aim.worst(index_of(rows), PLANT, KNOWING)
    assert shown is not None and shown.row.condition == case and not aim.reached(shown)
    assert tables.in_words(shown, aim) == f"not reached: 0.40 [0.39, 0.41] ({case})"


def test_a_limit_beside_the_reference_follows_it() -> None:
    """Exact isolation of 10 sigma: the tanks may lose 0.05."""
    for value, kept in ((0.91, True), (0.89, False)):
        rows = [r for r in both() if not (r.detector == KNOWING and r.metric == EXACT and r.fault == "drift-10-sigma")]
        rows.append(row(KNOWING, "drift-10-sigma", EXACT, value))
        assert reached(rows, KNOWING)["exact isolation, bias 10 sigma and drift 10 sigma"] is kept


def test_a_slow_drift_has_the_limit_of_its_length() -> None:
    rows = [r for r in both() if r.metric != AT_END] + [row(KNOWING, slow_name(n), AT_END, 0.85) for n in (180, 480, 1500)]
    found = reached(rows, KNOWING)
    assert [found[f"drift to 10 sigma in {n} samples isolated"] for n in (180, 480, 1500)] == [False, False, True]


def test_tables_are_rectangular_and_show_what_was_not_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(aims.REASONS, (PLANT, AIMS[0].name), "because")
    found = tables.tables_of(both(), PLANT)
    for table in found:
        assert table.rows and {len(line) for line in table.rows} == {len(table.header)}, table.title
    assert found[0].header[2:-1] == (BLIND, KNOWING) and found[0].rows[0][-1] == "because"
    verdicts = [line for line in found[3].rows if line[1] == BLIND]
    assert all(tables.NO_VERDICT in line for line in verdicts)
    few = tables.tables_of(made_up(BLIND, false=1.0, exact=0.0, verdict=None)[:2], PLANT)
    assert all(tables.NOT_TRIED in str(table.rows) for table in few)


def test_the_figure_draws_with_and_without_process_verdicts() -> None:
    for rows, panels in ((both(), 3), (made_up(BLIND, false=1.0, exact=0.0, verdict=None), 2)):
        assert len(columns_of(rows, PLANT)) == panels
        with style():
            assert len(draw(rows, PLANT).axes) == panels


def test_findings_name_the_worst_case_and_count_aims() -> None:
    assert variants_of(both(), PLANT) == [BLIND, KNOWING]
    blind, knowing = findings(both(), PLANT)
    assert "in at most 1.00 of samples" in blind and knowing.endswith(f"{len(AIMS)} of {len(AIMS)} aims are reached.")


def test_the_page_is_made_of_rows_of_several_files(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(root / "docs" / "results"))
    page = importlib.import_module("robustness")
    first, second = tmp_path / "first.csv", tmp_path / "second.csv"
    write_rows(first, made_up(BLIND, false=1.0, exact=0.0, verdict=None))
    write_rows(second, both())
    rows = page.load([first, second])
    assert page.render(rows) == page.render(page.load([second]))
    assert page.render(rows).count("not reached: ") == 5
    text = page.render(rows)
    assert all(f"### {table.title}" in text for table in tables.tables_of(both(), PLANT))
    write_rows(tmp_path / "again.csv", rows)
    assert page.render(page.load([tmp_path / "again.csv"])) == text


def test_the_committed_page_is_that_of_its_numbers(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(root / "docs" / "results"))
    page = importlib.import_module("robustness")
    if not page.NUMBERS.exists():
        pytest.skip("no numbers are committed yet")
    monkeypatch.setattr(aims, "compared_plant", cache(aims.compared_plant))  # once a plant
    assert page.render(page.load([page.NUMBERS])) == page.PAGE.read_text(encoding="utf-8")
