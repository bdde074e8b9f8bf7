"""What the report of a comparison opens with, on a made-up cell: exact in 7 of 16 samples, false isolation in 5 of 8."""

from __future__ import annotations

import numpy as np
import pytest
from made_up_cell import SETTINGS_HERE, cell, made_up

from fusion_sfdia.common.run_statistics import Estimate
from fusion_sfdia.study.comparison.cell import ComparisonCell
from fusion_sfdia.study.comparison.chapters import extremes
from fusion_sfdia.study.comparison.conclusions import MOST_LISTED, advised, decided, false_isolations, opening, percent
from fusion_sfdia.study.comparison.loss import loss
from fusion_sfdia.study.comparison.ranking import RankedDetector
from fusion_sfdia.study.comparison.result_tables import EVERY, choices_table
from fusion_sfdia.study.comparison.summary import standings_of

NONE = np.zeros((12, 2), int)


def ranked(cells: dict[str, ComparisonCell], **ranks: int) -> dict[str, RankedDetector]:
    """The standings by loss; ranks: where they are not 1 for the least and 2 for the others."""
    losses = {d: float(loss(c, SETTINGS_HERE).mean()) for d, c in cells.items()}
    least = min(losses.values())
    return {d: RankedDetector(Estimate(v, v, v, 8), ranks.get(d, 1 if v == least else 2)) for d, v in losses.items()}


def two() -> dict[str, ComparisonCell]:
    fewer = np.where(np.arange(12)[:, None] == 2, [[1, 1]], cell()["exact"])
    return {"first": cell(), "second": cell(exact=fewer, falsely_isolated=NONE)}


def test_the_advice_names_the_least_loss_and_what_is_better_elsewhere() -> None:
    assert advised(SETTINGS_HERE, two(), ranked(two())) == (
        "two-tanks: second has the least loss, 0.33. With the right model second isolates exactly the faulty sensor in 31 % of "
        "the samples of a fault of 10 sigma; most exact is first, 44 %."
    )
    alone = {"first": cell()}
    assert advised(SETTINGS_HERE, alone, ranked(alone)) == (
        "two-tanks: first has the least loss, 0.85. With the right model first isolates exactly the faulty sensor in 44 % of "
        "the samples of a fault of 10 sigma. Under the worst model mismatch (inflow) first isolates a healthy sensor in 62 % "
        "of the samples. Under the worst process fault (leak) first isolates a healthy sensor in 12 % of the samples."
    )


def test_the_advice_states_for_which_models_another_costs_less() -> None:
    """The other isolates no faulty sensor, but no healthy one either where the model is wrong."""
    wrong = (cell()["mismatch"] != "")[:, None] & np.ones((1, 2), bool)
    cells = {"keen": cell(falsely_isolated=np.where(wrong, 4, 0)), "idle": cell(right=NONE, falsely_isolated=NONE)}
    found = advised(SETTINGS_HERE | {"wrong_model_share": 0.0}, cells, {
        "keen": RankedDetector(Estimate(0.1, 0.1, 0.1, 8), 1), "idle": RankedDetector(Estimate(0.2, 0.2, 0.2, 8), 2),
    })  # fmt: skip
    assert "0.10. idle would have the least if the model were wrong more than " in found


def test_what_is_no_worse_beyond_chance_is_named() -> None:
    cells = two() | {"third": cell()}
    assert "0.33 (no worse beyond chance: first). With" in advised(SETTINGS_HERE, cells, ranked(cells, first=1))
    assert "0.33; no other is worse beyond chance. With" in advised(SETTINGS_HERE, cells, ranked(cells, first=1, third=1))
    many = {f"d{k}": cell() for k in range(6)} | {"last": cell(falsely_isolated=np.full((12, 2), 4))}
    assert "d0 has the least loss, 0.85. With" in advised(SETTINGS_HERE, many, ranked(many))


def test_without_mismatch_cases_the_report_states_that_they_are_not_tried() -> None:
    kept = cell()["mismatch"] == ""
    nominal = cell(**{name: v[kept] for name, v in made_up().items() if v.ndim and len(v) == kept.size})
    assert "10 sigma. Model mismatch not tried. Under the worst process fault" in advised(
        SETTINGS_HERE, {"d": nominal}, ranked({"d": nominal})
    )
    assert "not tried" not in advised(SETTINGS_HERE, {"d": cell()}, ranked({"d": cell()}))
    cells = {("two-tanks", "d"): nominal}
    [row] = choices_table(SETTINGS_HERE, cells, standings_of(cells, SETTINGS_HERE)).rows
    assert row[2] == "least loss, most exact isolation"


def test_a_single_detector_has_one_value_and_several_a_range() -> None:
    assert extremes({"d": 1.0, "unknown": np.nan}) == "1 (d)"
    assert extremes({"d": 1.0, "e": 0.5}) == "from 0.5 (e) to 1 (d)"


def test_where_nothing_isolates_nothing_is_advised() -> None:
    cells = {("two-tanks", "none"): cell(exact=NONE)}
    assert opening(SETTINGS_HERE, cells, {}) == []
    differ, elsewhere = opening(SETTINGS_HERE, cells, standings_of(cells, SETTINGS_HERE))
    assert "loss" in differ and "fusion-sfdia audit" in elsewhere


def test_ranks_count_the_pairs_that_differ() -> None:
    cells = {name: cell() for name in "abc"}
    criteria = {"loss": ranked(cells, a=1, b=2, c=3)}
    assert decided({"tanks": criteria, EVERY: criteria}) == (
        "Pairs of detectors whose losses differ beyond chance: tanks 3 of 3."
    )
    assert decided({}) == ""


@pytest.mark.parametrize(("share", "text"), [(0.0, "0 %"), (0.004, "under 1 %"), (0.055, "6 %"), (1.0, "100 %")])
def test_shares_are_rounded_but_not_to_none(share: float, text: str) -> None:
    assert percent(share) == text


def test_many_detectors_are_counted_rather_than_named() -> None:
    few = {f"d{k}": cell() for k in range(MOST_LISTED)}
    mismatch, process = false_isolations("two-tanks", few)
    assert "in most samples: d0 62%, d1 62%" in mismatch and "in some: d0 12%" in process
    mismatch, process = false_isolations("two-tanks", few | {"one more": cell()})
    assert mismatch == "False isolation under the worst mismatch case of two-tanks, in most samples: 10 of 10 detectors."
