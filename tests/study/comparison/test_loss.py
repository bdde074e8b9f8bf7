"""The loss of a detector on a made-up cell, counted by hand, and where another detector costs less."""

from __future__ import annotations

import numpy as np
import pytest
from made_up_cell import SETTINGS_HERE, cell, made_up

from fusion_sfdia.study.comparison.cell import ComparisonCell
from fusion_sfdia.study.comparison.compare import SCENARIO, Comparison
from fusion_sfdia.study.comparison.loss import (
    DELAY,
    FALSE,
    FALSE_IF_WRONG,
    MISSED,
    cheaper_elsewhere,
    loss,
    loss_parts,
)
from fusion_sfdia.study.comparison.protocol import COSTS

NONE = np.zeros((12, 2), int)


def test_the_parts_of_the_loss_by_hand() -> None:
    """Four kinds with the right model (bias, noise, missing readings, leak), two mismatch cases in three rows; half each."""
    found = {part: float(values.mean()) for part, values in loss_parts(cell(), SETTINGS_HERE).items()}
    assert found == pytest.approx({
        MISSED: 0.5 * (0.5 + 0.75) / 4 + 0.5 * (2 / 4 + 1 / 4) / 2 / 3,
        FALSE: 2 * 0.5 * (0.1875 + 0.1875 + 0.25 + 0.125) / 4,
        FALSE_IF_WRONG: 2 * 0.5 * (3 / 12 + 5 / 12) / 2,
        DELAY: 0.5 * 0.5 * (0.4375 + 0.75 + 0 + 0.625) / 4,
    })  # fmt: skip
    assert loss(cell(), SETTINGS_HERE).mean() == pytest.approx(sum(found.values()))


@pytest.mark.parametrize(("cost", "part"), [("missed_cost", MISSED), ("delay_cost", DELAY)])
def test_a_part_is_in_proportion_to_its_cost(cost: str, part: str) -> None:
    dearer = loss_parts(cell(), SETTINGS_HERE | {cost: 3 * COSTS[cost]})
    for name, values in loss_parts(cell(), SETTINGS_HERE).items():
        np.testing.assert_allclose(dearer[name], values * (3 if name == part else 1))


def test_a_perfect_detector_costs_nothing_and_an_idle_one_what_it_misses() -> None:
    of = cell()
    perfect = cell(right=of["faulty"], falsely_isolated=NONE, first=np.zeros((12, 2)))
    assert loss(perfect, SETTINGS_HERE).sum() == 0.0
    idle = cell(right=NONE, falsely_isolated=NONE, first=np.full((12, 2), np.inf))
    found = loss_parts(idle, SETTINGS_HERE | {"wrong_model_share": 0.0})
    assert found[MISSED].mean() == 2 / 4 and found[DELAY].mean() == 0.5 * 3 / 4  # of bias, noise, missing readings, leak


def test_without_mismatch_cases_the_model_is_right_all_the_time() -> None:
    kept = cell()["mismatch"] == ""
    nominal = cell(**{name: v[kept] for name, v in made_up().items() if v.ndim and len(v) == kept.size})
    right = SETTINGS_HERE | {"wrong_model_share": 0.0}
    assert loss(nominal, SETTINGS_HERE).mean() == pytest.approx(loss(cell(), right).mean())


def test_another_detector_costs_less_exactly_where_the_lines_cross() -> None:
    """Right model, wrong model: .75, 0 of the steady one; of the keen one all of it with a wrong model."""

    def made(right: float, wrong: float) -> ComparisonCell:
        wrong_rows = (cell()["mismatch"] != "")[:, None] & np.ones((1, 2), bool)
        samples = cell()["samples"]
        false = np.where(wrong_rows, wrong * samples, right * samples)
        return cell(right=cell()["faulty"], first=np.zeros((12, 2)), falsely_isolated=false)

    cells = {"steady": made(0.75, 0.0), "keen": made(0.0, 1.0), "between": made(0.5, 0.25), "never": made(1.0, 1.0)}
    steady = cheaper_elsewhere(cells, SETTINGS_HERE, "steady")
    # 1.5 - 1.5 w = 1 - .5 w at w = .5; 1 - .5 w = 2 w at w = .4
    assert steady == {"keen": pytest.approx((0.0, 0.4)), "between": pytest.approx((0.4, 0.5))}
    assert cheaper_elsewhere(cells, SETTINGS_HERE, "keen") == {
        "between": pytest.approx((0.4, 0.5)), "steady": pytest.approx((0.5, 1.0)),
    }  # fmt: skip
    for w, best in ((0.2, "keen"), (0.45, "between"), (0.7, "steady")):
        at = {d: loss(c, SETTINGS_HERE | {"wrong_model_share": w}).mean() for d, c in cells.items()}
        assert min(at, key=lambda d: float(at[d])) == best
    assert cheaper_elsewhere({"d": cells["keen"]}, SETTINGS_HERE, "d") == {}


def test_costs_do_not_change_the_work() -> None:
    usual, other = (Comparison().tasks(SCENARIO.settings | {"missed_cost": c}, 2) for c in (1.0, 7.0))
    assert usual == other and not set(COSTS) & set(usual[0])
