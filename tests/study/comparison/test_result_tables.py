"""The tables of a comparison's report on a made-up cell, each number counted by hand."""

from __future__ import annotations

import numpy as np
import pytest
from made_up_cell import SETTINGS_HERE, cell

from fusion_sfdia.common.run_statistics import Estimate
from fusion_sfdia.report.results import Row
from fusion_sfdia.study.comparison import result_tables as tables
from fusion_sfdia.study.comparison.loss import loss
from fusion_sfdia.study.comparison.ranking import RankedDetector
from fusion_sfdia.study.comparison.summary import standings_of


def test_the_choices_are_by_loss_by_exact_isolation_and_by_false_isolation() -> None:
    """Exact in 7 of 16 samples, false isolation in 5 of 8 at worst; the other is exact in 5 of 16 without false isolation."""
    first = cell()
    fewer = np.where(np.arange(12)[:, None] == 2, [[1, 1]], first["exact"])
    second = cell(exact=fewer, falsely_isolated=np.zeros((12, 2), int))
    cells = {("two-tanks", "first"): first, ("two-tanks", "second"): second}
    found = tables.choices_table(SETTINGS_HERE, cells, standings_of(cells, SETTINGS_HERE))
    assert [row[:3] for row in found.rows] == [
        ("two-tanks", "second", "least loss, least false isolation with a wrong model"),
        ("two-tanks", "first", "most exact isolation"),
    ]
    assert [row[3][0] for row in found.rows] == pytest.approx([loss(c, SETTINGS_HERE).mean() for c in (second, first)])  # type: ignore[index]
    assert [row[4][0] for row in found.rows] == [5 / 16, 7 / 16]  # type: ignore[index]
    assert [row[5][0] for row in found.rows] == [0.0, 5 / 8]  # type: ignore[index]
    assert [row[6] for row in found.rows] == ["outlets", "inflow"] and [row[8] for row in found.rows] == ["leak", "leak"]


def test_numbers_have_a_column_a_measure_and_the_claim() -> None:
    found = tables.numbers_table(SETTINGS_HERE, {"claims": cell(), "claims none": cell(claim=np.array(np.nan))})
    assert {len(row) for row in found.rows} == {len(found.header)}
    shown = dict(zip(found.header, found.rows[0], strict=True))
    assert shown["exact isolation, 10 sigma (n 4)"][0] == 7 / 16  # type: ignore[index]
    assert shown["delay (s), 10 sigma (n 4)"][0] == 6.25  # type: ignore[index]
    assert [row[-1] for row in found.rows] == ["0.01", "none"]


def test_lengths_stand_beside_each_other() -> None:
    of = cell()
    assert tables.lengths_tables(SETTINGS_HERE, {"d": of}) == []
    settings = SETTINGS_HERE | {"lengths": (2, 9)}
    names = np.array([n.replace("bias-3-sigma", "bias-3-sigma-2-samples") for n in of["condition"]])
    changed = cell(condition=names, swept_condition=np.array(["bias-3-sigma-2-samples", "bias-3-sigma-9-samples"]))
    changed.conditions |= {n: of.conditions["bias-3-sigma"] for n in ("bias-3-sigma-2-samples", "bias-3-sigma-9-samples")}
    small = tables.lengths_tables(settings | {"magnitudes": (3.0,)}, {"d": changed})
    assert [t.title for t in small] == ["How long a bias of 3 sigma lasts"]
    assert small[0].header[1:3] == ("area, 2 samples", "area, 9 samples")
    [row] = small[0].rows
    assert row[1] == changed.areas["bias-3-sigma-2-samples"] and row[2] == changed.areas["bias-3-sigma-9-samples"]
    assert row[3][0] == 0.5 and row[5][0] == 3 / 8  # type: ignore[index]  # as the bias of 3 sigma: alarm, exact


def test_published_numbers_stand_beside_ours() -> None:
    def row(low: float, high: float) -> Row:
        return Row("comparison", "p", "d", "f", "M(1)", "detection_delay", 1.0, low, high, 7, 2.0, "K24, Fig. 4",
                   condition="first alarm")  # fmt: skip

    plain = Row("comparison", "p", "d", "f", "all", "auc", 0.5)
    found = tables.paper_table([row(0.5, 2.5), row(0.5, 1.5), row(np.nan, np.nan), plain])
    assert [r[8] for r in found.rows] == ["contains it", "does not", "none"]
    assert found.rows[0] == (
        "f",
        "d",
        "M(1)",
        "first alarm",
        "detection_delay",
        (1.0, 0.5, 2.5, 7),
        7,
        2.0,
        "contains it",
        "K24, Fig. 4",
    )
    assert {len(r) for r in found.rows} == {len(found.header)}


def standing(value: float, rank: int) -> RankedDetector:
    return RankedDetector(Estimate(value, value - 0.1, value + 0.1, 6), rank)


def test_ranks_are_in_the_order_of_the_loss() -> None:
    criteria = {
        "loss": {"a": standing(0.4, 1), "b": standing(0.3, 1)},
        "detection": {"a": standing(0.4, 2), "b": standing(0.9, 1)},
        "isolation": {"a": standing(0.3, 2), "b": standing(0.3, 2)},
        "accommodation": {name: RankedDetector(Estimate(np.nan, np.nan, np.nan, 0), 1) for name in "ab"},
    }
    found = tables.ranks_table("all plants", criteria)
    assert found.header == (
        *("detector", "loss: rank", "mean of loss", "detection: rank", "mean of detection", "isolation: rank"),
        "mean of isolation",
    )
    assert [(row[0], row[3]) for row in found.rows] == [("b", 1), ("a", 2)] and "6 of detection, 6 of isolation" in found.method
    assert tables.ranks_table("none", {}).rows == ()
    assert [row[:3] for row in tables.standing_rows({"p": criteria})][:5] == [
        ("p", "loss", "a"), ("p", "loss", "b"), ("p", "detection", "a"), ("p", "detection", "b"), ("p", "isolation", "a"),
    ]  # fmt: skip


def test_cost_is_in_milliseconds_and_kilobytes() -> None:
    [row] = tables.cost_table({"d": cell(step_bytes=np.array(2500))}).rows
    assert row == ("d", 1.0, 0.1, 0.64, 2.5)


def test_changes_are_those_that_are_tried() -> None:
    whole = tables.changes_table(SETTINGS_HERE, cell()).rows
    assert [row[:2] for row in whole] == [
        ("mismatch case", "outlets -5 %"), ("mismatch case", "inflow swings"), ("process fault", "leak"),
    ]  # fmt: skip
    assert tables.changes_table(SETTINGS_HERE | {"mismatch_cases": False, "process_faults": False}, cell()).rows == ()
