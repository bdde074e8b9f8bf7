"""Kinds and health as rows arrive are those of `diagnose` on the same rows, and survive a restart."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_plants import readings, tanks

from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.diagnoser import diagnose
from fusion_sfdia.diagnosis.changes import Change
from fusion_sfdia.diagnosis.events import Event
from fusion_sfdia.diagnosis.second_look import EACH, WINDOW
from fusion_sfdia.diagnosis.watch import Watch

Rows = list[tuple[float, np.ndarray, np.ndarray]]


def rows_of() -> Rows:
    """A bias of l1, a drift of q2, spikes of l2, noise of l1, a freeze of q12 and a dropout of q2."""
    t, _, y, u = readings(tanks(), 420, 1, seed=5)
    y, sigma, rng = y[:, 0].copy(), tanks().sensor_sigma, np.random.default_rng(2)
    y[40:70, 0] += 15 * sigma[0]
    y[110:160, 3] += sigma[3] * np.linspace(0, 30, 50)
    y[[200, 206, 212], 1] += 30 * sigma[1]
    y[250:290, 0] += 10 * sigma[0] * rng.standard_normal(40)
    y[320:350, 2] = y[320, 2] + 15 * sigma[2]
    y[370:400, 3] = np.nan
    return [(float(s), r, a) for s, r, a in zip(t, y, u[:, 0], strict=True)]


def bank(**settings: Any) -> LeaveOneOutBank:
    return LeaveOneOutBank(tanks(), window=5, **settings)


def diagnosed(rows: Rows, detector: Any) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return diagnose(detector, *map(np.array, zip(*rows, strict=True)))


def changes_of(watch: Watch, rows: Rows, *, last: bool = True) -> list[Change]:
    found = [change for row in rows for sample in watch.update(*row) for change in sample.changes]
    return [*found, *watch.last()] if last else found


def named(changes: list[Change]) -> list[Event]:
    """The events as they were last named."""
    found = {c.id: c.event for c in changes if c.what == "named" and c.event}
    return sorted(found.values(), key=lambda e: (e.start, e.hypothesis))


def test_the_events_and_kinds_are_those_of_a_diagnosis() -> None:
    rows = rows_of()
    expected = diagnosed(rows, bank())
    changes = changes_of(Watch(bank()), rows)
    events = [e for e in expected.events if e.kind == "sensor"]
    assert {e.fault for e in events} == {"bias", "drift", "spikes", "noise", "freeze", "dropout"}
    assert list(map(repr, named(changes))) == list(map(repr, events))
    first = next(c for c in changes if c.what == "named" and c.event and c.event.hypothesis == "l1")
    opened = next(c for c in changes if c.what == "opened" and c.event and c.event.hypothesis == "l1")
    assert first.id == opened.id and first.t == opened.t + EACH * 5.0
    assert first.event and first.event.open and first.event.fault == "bias"
    assert [c.reason for c in changes if c.what == "health"] == [expected.health.line]
    freeze = next(e for e in events if e.fault == "freeze")
    assert freeze.end == rows[349][0]
    (*_, closed, again) = (c for c in changes if c.event and c.event.hypothesis == "q12")  # the isolation ends later
    assert (closed.what, again.what, again.id) == ("closed", "named", closed.id)
    assert closed.event and closed.event.end > freeze.end and again.event and again.event.end == freeze.end


@pytest.mark.parametrize("cut", [55, 128, 214, 333, 384])
def test_a_watch_taken_up_again_names_the_same(cut: int, tmp_path: Path) -> None:
    rows = rows_of()
    expected = changes_of(Watch(bank()), rows)
    first = Watch(bank())
    before = changes_of(first, rows[:cut], last=False)
    first.save(tmp_path / "s")
    second = Watch.load(tmp_path / "s", bank())
    assert repr(before + changes_of(second, rows[cut:])) == repr(expected)


def test_a_model_that_does_not_fit_is_suspect_once_and_then_fits_again() -> None:
    t, _, y, u = readings(tanks(), 5 * WINDOW, 1, seed=6)
    y = y[:, 0].copy()
    rng = np.random.default_rng(3)
    y[WINDOW : 3 * WINDOW] += 1.5 * tanks().sensor_sigma * rng.standard_normal((2 * WINDOW, 4))
    rows = [(float(s), r, a) for s, r, a in zip(t, y, u[:, 0], strict=True)]
    changes = changes_of(Watch(bank(threshold_scale=3.0)), rows, last=False)
    found = [(c.reason.partition(":")[0], c.t) for c in changes if c.what == "health"]
    assert [what for what, _ in found] == ["model fits", "model suspect", "model fits"]
    assert [round(when / (5 * WINDOW)) for _, when in found] == [1, 2, 4]


def test_a_fault_that_never_ends_is_named_ever_more_rarely_in_bounded_memory() -> None:
    t, _, y, u = readings(tanks(), 3 * WINDOW, 1, seed=7)
    y = y[:, 0].copy()
    y[50:, 0] += 15 * tanks().sensor_sigma[0]
    y[90:, 3] = np.nan
    watch = Watch(bank())
    changes = changes_of(watch, [(float(s), r, a) for s, r, a in zip(t, y, u[:, 0], strict=True)], last=False)
    seen = [(c.event.hypothesis, c.event.fault, c.event.start) for c in changes if c.what == "named" and c.event]
    assert {(h, f, s) for h, f, s in seen} >= {("l1", "bias", 255.0), ("q2", "dropout", 455.0)} and len(seen) < 10
    look = watch.findings.look
    assert look and len(look.window) == WINDOW and len(look.named) < 5


def test_it_can_be_left_out() -> None:
    rows = rows_of()[:120]
    without = changes_of(Watch(bank(), kinds=False), rows)
    assert repr([c for c in changes_of(Watch(bank()), rows) if c.what in ("opened", "closed")]) == repr(without)
