"""What the report of a comparison opens with, on a made-up cell: exact in 7 of 16 samples, false isolation in 5 of 8."""

from __future__ import annotations

import numpy as np
import pytest
from made_up_cell import SETTINGS_HERE, cell, made_up

from fusion_sfdia.common.run_statistics import Estimate
from fusion_sfdia.study.comparison.chapters import extremes
from fusion_sfdia.study.comparison.conclusions import MOST_LISTED, false_isolations
from fusion_sfdia.study.comparison.opening import advised, decided, opening, percent
from fusion_sfdia.study.comparison.ranking import RankedDetector
from fusion_sfdia.study.comparison.result_tables import EVERY, choices_table

NONE = np.zeros((12, 2), int)


def standings(**ranks: int) -> dict[str, RankedDetector]:
    return {name.replace("_", "-"): RankedDetector(Estimate(0.5, 0.4, 0.6, 8), rank) for name, rank in ranks.items()}


def test_the_advice_names_the_detector_its_faults_and_the_more_robust_one() -> None:
    fewer = np.where(np.arange(12)[:, None] == 2, [[1, 1]], cell()["exact"])
    cells = {"first": cell(), "second": cell(exact=fewer, falsely_isolated=NONE)}
    assert advised(SETTINGS_HERE, cells, standings(first=1, second=2)) == (
        "two-tanks: use first: no other detector isolates better; under a fault of 10 sigma it isolates "
        "exactly the faulty sensor in 44 % of the samples. "
        "With a wrong model (inflow) first isolates a healthy sensor in 62 % of the samples; second in 0 %, and the faulty one "
        "in 31 %. It attributes a process fault (leak) to a sensor in 12 % of the samples."
    )
    alone = advised(SETTINGS_HERE, {"second": cells["second"]}, {})
    assert alone == (
        "two-tanks: use second: no other detector isolates better; under a fault of 10 sigma it isolates "
        "exactly the faulty sensor in 31 % of the samples."
    )


def test_only_what_nothing_beats_is_advised_and_its_equals_are_named() -> None:
    fewer = np.where(np.arange(12)[:, None] == 2, [[1, 1]], cell()["exact"])
    cells = {"most": cell(), "fewer": cell(exact=fewer), "equal": cell(exact=fewer)}
    assert advised(SETTINGS_HERE, cells, standings(most=2, fewer=1, equal=1)).startswith(
        "two-tanks: use fewer: no other detector isolates better (as good: equal); "
    )
    many = {f"d{k}": cell() for k in range(6)}
    last = cell(exact=fewer)
    assert advised(SETTINGS_HERE, {**many, "last": last}, standings(**dict.fromkeys(many, 1), last=2)).startswith(
        "two-tanks: use d0: no other detector isolates better; "
    )


def test_where_no_difference_is_significant_the_two_highest_are_stated() -> None:
    fewer = np.where(np.arange(12)[:, None] == 2, [[1, 1]], cell()["exact"])
    cells = {"least": cell(exact=NONE), "second": cell(exact=fewer), "first": cell()}
    found = advised(SETTINGS_HERE, cells, standings(least=1, second=1, first=1))
    assert found.startswith(
        "two-tanks: no detector isolates significantly better than another; first and second have the highest values: "
        "under a fault of 10 sigma they isolate exactly the faulty sensor in 44 % and 31 % of the samples. "
        "With a wrong model (inflow) first isolates"
    )


def test_without_mismatch_cases_the_report_states_that_they_are_not_tried() -> None:
    kept = cell()["mismatch"] == ""
    nominal = cell(**{name: v[kept] for name, v in made_up().items() if v.ndim and len(v) == kept.size})
    assert "of the samples. Model mismatch not tried. It attributes a process fault" in advised(
        SETTINGS_HERE, {"d": nominal}, {}
    )
    assert "not tried" not in advised(SETTINGS_HERE, {"d": cell()}, {})
    [row] = choices_table(SETTINGS_HERE, {("two-tanks", "d"): nominal}).rows
    assert row[1] == "most exact isolation; model mismatch not tried"


def test_a_single_detector_has_one_value_and_several_a_range() -> None:
    assert extremes({"d": 1.0, "unknown": np.nan}) == "1 (d)"
    assert extremes({"d": 1.0, "e": 0.5}) == "from 0.5 (e) to 1 (d)"


def test_where_nothing_isolates_nothing_is_advised() -> None:
    assert advised(SETTINGS_HERE, {"none": cell(exact=NONE)}, {}) == ""
    assert opening(SETTINGS_HERE, {("two-tanks", "none"): cell(exact=NONE)}, {}) == []


def test_ranks_count_the_pairs_that_differ() -> None:
    criteria = {"detection": standings(a=1, b=1, c=2), "isolation": standings(a=1, b=2, c=3)}
    assert decided({"tanks": criteria, EVERY: criteria}) == (
        "Pairs of detectors that differ significantly, in detection and in isolation: tanks 1 and 3 of 3."
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
