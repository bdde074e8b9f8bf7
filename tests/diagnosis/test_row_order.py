"""Rows in another order than that of their times: what is put in order, what is lost, and what a restart makes of it."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_plants import readings, tanks

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.diagnosis import row_order as order
from fusion_sfdia.diagnosis.row_order import InOrder, WatchRow
from fusion_sfdia.diagnosis.watch import Watch
from fusion_sfdia.live.saving import SavedWatch

Rows = list[tuple[float, np.ndarray, np.ndarray]]


def rows_of(steps: int = 80) -> Rows:
    """A bias of l1 from the 20th row on, one row each 5 s."""
    t, _, y, u = readings(tanks(), steps, 1, 3)
    y = y[:, 0].copy()
    y[20:50, 0] += 0.15
    return [(float(s), r, a) for s, r, a in zip(t, y, u[:, 0], strict=True)]


def shuffled(rows: Rows, seconds: float, seed: int = 0) -> Rows:
    """The same rows, each arriving up to so many seconds after its time."""
    rng = random.Random(seed)
    return sorted(rows, key=lambda row: row[0] + rng.uniform(0.0, seconds))


def lines_of(watch: Watch, rows: Rows, *, rest: bool = True) -> list[str]:
    found: list[str] = []
    saved = SavedWatch(watch, found.append, samples=True)
    for row in rows:
        saved.update(*row)
    if rest:
        saved.finish()
    return found


def bank() -> LeaveOneOutBank:
    return LeaveOneOutBank(tanks(), window=1)


def pushed(one: InOrder, times: list[float]) -> tuple[list[float], list[list[float]]]:
    """What is returned in all, and after each row, if what is returned is diagnosed."""
    last, found = None, []
    for t in times:
        due = [row.t for row, _ in one.push(WatchRow(t, np.empty(0), np.empty(0)), last, Clock())]
        last = due[-1] if due else last
        found.append(due)
    return [t for due in found for t in due], found


def test_rows_within_the_time_are_put_in_order_and_later_ones_are_lost_and_counted() -> None:
    rows, remarks = rows_of(), []
    disordered = shuffled(rows, 20.0)
    assert [r[0] for r in disordered] != [r[0] for r in rows]
    expected = lines_of(Watch(bank()), rows)
    assert lines_of(Watch(bank(), reorder=20.0, refused=remarks.append), disordered) == expected and not remarks
    straggler, others = rows[30], rows[:30] + rows[31:]
    late = [*others[:40], straggler, *others[40:]]
    watch = Watch(bank(), reorder=20.0, refused=remarks.append)
    assert lines_of(watch, late) == lines_of(Watch(bank()), others)
    assert len(remarks) == 2 and "earlier than the last one" in remarks[0] and remarks[1].startswith("1 row until")
    lines_of(Watch(bank(), refused=(lost := []).append), disordered)
    assert lost  # without the option


def test_each_row_is_returned_when_a_row_that_much_later_has_come() -> None:
    in_order, found = pushed(InOrder(10.0, 1e3, print), [5.0, 0.0, 12.0, 10.0, 15.0, 16.0, 30.0])
    assert in_order == [0.0, 5.0, 10.0, 12.0, 15.0, 16.0]
    assert found == [[], [], [0.0], [], [5.0], [], [10.0, 12.0, 15.0, 16.0]]


def test_the_number_of_rows_held_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(order, "MOST_HELD", 5)
    one = InOrder(1e6, 1e9, print)
    in_order, _ = pushed(one, list(map(float, range(100))))
    assert in_order == list(map(float, range(95))) and len(one.held) == 5


def test_a_wrong_clock_in_one_row_does_not_make_the_rows_after_it_late() -> None:
    remarks: list[str] = []
    one = InOrder(10.0, 100.0, remarks.append)
    in_order, _ = pushed(one, [1e9, 0.0, 5.0, 1e8, 10.0, 20.0, 500.0, 505.0, 520.0])
    assert in_order == [0.0, 5.0, 10.0, 20.0, 500.0, 505.0]
    assert len(remarks) == 2 and all("it is later than the row after it" in r for r in remarks)


@pytest.mark.parametrize("again", ["all", "after"])
def test_killed_with_rows_held_and_started_again_it_writes_the_same_lines(again: str, tmp_path: Path) -> None:
    rows = shuffled(rows_of(), 20.0, seed=1)
    expected = lines_of(Watch(bank(), reorder=20.0), rows)
    settings: dict[str, Any] = {"reorder": 20.0}
    for cut in (3, 33, 60):
        found: list[str] = []
        first = SavedWatch(Watch(bank(), **settings), found.append, tmp_path / "s", every=10, samples=True)
        for row in rows[:cut]:
            first.update(*row)
        assert first.watch.order.held  # not in the state
        if cut == 3:
            assert not (tmp_path / "s").exists()
            continue
        remarks: list[str] = []
        second = Watch.load(tmp_path / "s", bank(), refused=remarks.append, **settings)
        saved = second.t
        assert saved is not None and saved < max(r[0] for r in rows[:cut])
        after = lines_of(second, rows if again == "all" else [r for r in rows if r[0] > saved])
        assert list(dict.fromkeys([*found, *after])) == expected and not remarks
        (tmp_path / "s").unlink()


@pytest.mark.parametrize("keep_last", [False, True])
def test_of_rows_that_are_held_the_last_of_a_time_counts_where_that_is_asked_for(keep_last: bool) -> None:
    said: list[str] = []
    watch = Watch(bank(), reorder=15.0, keep_last=keep_last, refused=said.append)
    corrected = [row for t, y, u in rows_of(20) for row in ((t, y + 1.0, u), (t, y, u))]  # the first of each pair is wrong
    found = [s for row in corrected for s in watch.update(*row)] + list(watch.finish())
    offset = 0.0 if keep_last else 1.0
    for sample, (t, y, _) in zip(found, rows_of(20), strict=True):
        assert sample.t == t and np.array_equal(sample.y, y + offset)
    kept = "last" if keep_last else "first"
    assert set(said) == {f"1 duplicate dropped, the {kept} row of each time kept"} and len(said) == 20
    assert not watch.update(*rows_of(20)[-1]) and watch.order.again["first"] == 1  # it is diagnosed


@pytest.mark.parametrize("steps", [6, 40, 9_000, 10**7])
@pytest.mark.parametrize("at", [1, 15, 40])
def test_a_row_far_ahead_costs_itself_alone(steps: int, at: int) -> None:
    rows, remarks = rows_of(), []
    expected = lines_of(Watch(bank()), rows[:at] + rows[at + 1 :])
    ahead = [*rows[:at], (rows[at][0] + 5.0 * steps, *rows[at][1:]), *rows[at + 1 :]]
    assert lines_of(Watch(bank(), refused=remarks.append), ahead) == expected
    assert len(remarks) == 1 and "it is later than the row after it" in remarks[0]


def test_rows_with_two_clocks_in_turn_are_those_of_the_one_that_goes_on() -> None:
    rows, remarks = rows_of(), []
    mixed = [row for k, r in enumerate(rows) for row in ([r] if k % 3 else [r, (r[0] + 7200.0, r[1] + 1.0, r[2])])]
    assert lines_of(Watch(bank(), refused=remarks.append), mixed) == lines_of(Watch(bank()), rows)
    assert len(remarks) == 27


def test_a_jump_counts_with_the_third_row_and_at_the_end_of_the_input_with_the_second() -> None:
    remarks: list[str] = []
    one = InOrder(0.0, 1e5, remarks.append, step=5.0)
    in_order, found = pushed(one, [0.0, 5.0, 500.0, 505.0, 510.0, 515.0, 9e3])
    assert found == [[], [0.0, 5.0], [], [], [500.0, 505.0, 510.0], [515.0], []] and in_order[-1] == 515.0
    assert one.remaining(515.0, Clock()) == [] and "no row after it confirms its time" in remarks[0]
    two = InOrder(0.0, 1e5, remarks.append, step=5.0)
    pushed(two, [0.0, 5.0, 500.0, 505.0])
    assert [row.t for row, _ in two.remaining(5.0, Clock())] == [500.0, 505.0] and len(remarks) == 1


def test_rows_that_are_usually_far_apart_do_not_wait() -> None:
    one = InOrder(0.0, 1e5, print, step=1.0)
    _, found = pushed(one, [60.0 * k for k in range(10)])
    assert list(map(len, found)) == [0, 1, 0, 3, 1, 1, 1, 1, 1, 1]  # from the third on they are known to be
