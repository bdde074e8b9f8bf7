"""Shared by the scenarios with a faulty area: published times, rows of times, joined runs, settings."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest

from fusion_sfdia.benchmarks.network.support.rows import row, spread, time_rows
from fusion_sfdia.benchmarks.network.support.trials import join_runs
from fusion_sfdia.models.power_network.published import ATTACKS, GOVERNOR, SIGN_FLIP
from fusion_sfdia.study.scenarios import scenario


def test_published_times_state_their_source() -> None:
    delay, at = GOVERNOR.delay(GOVERNOR.detected), GOVERNOR.at(GOVERNOR.detected)
    assert delay is not None and at is not None
    assert (delay.value, at.value) == (8.0, 43.0) and "VIII-A" in delay.source
    times = (SIGN_FLIP.detected, SIGN_FLIP.isolated, SIGN_FLIP.reconfigured)
    assert [p and p.value for p in map(SIGN_FLIP.delay, times)] == [3.0, 16.0, 22.0]
    assert GOVERNOR.delay(GOVERNOR.isolated) is None
    assert [fault.value for _, fault in ATTACKS if fault] == [-1.0, 2.0, 10.0]


def test_summaries_of_times() -> None:
    make = partial(row, "s", "chebyshev:paper", "f", "area 4")
    rows = {r.metric: r.value for r in time_rows(make, "detection", np.array([40.0, 44.0, np.inf]), 35.0, None, None)}
    assert rows == {"detection_delay": 7.0, "first_alarm_time": 40.0, "first_alarm_time_p5": 40.0, "first_alarm_time_p95": 44.0}
    assert spread(np.array([40.0, 44.0, np.inf])) == "44 [40-never]"
    empty = time_rows(make, "isolation", np.array([np.inf]), 35.0, None, None)
    assert all(np.isnan(r.value) and r.n == 0 for r in empty)


def test_runs_of_several_tasks_are_joined_and_one_is_shown() -> None:
    names = ("answer", "alone_angle", "t", "alone_reached", "unplugged_bounds")
    parts = [({"k": 1}, dict.fromkeys(names, np.full(2, v))) for v in (1, 2)]
    both = join_runs(parts, lambda task: task["k"])[1]
    assert [both[name].tolist() for name in names] == [[1, 1, 2, 2]] * 2 + [[1, 1]] * 3


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("network/governor", {"noises": ("large",)}, "one of noises 'large'"),
        ("network/governor", {"duration": 60.0}, "expected more than 70 s, when area 15 is plugged in"),
        ("network/sign-flip", {"cases": ("two",)}, "one of cases 'two'"),
        ("network/sign-flip", {"controller": "none"}, "controller 'none'"),
        ("network/attacks", {"faults": ("3u",)}, "one of faults '3u'"),
    ],
)
def test_settings_that_do_not_fit(name: str, change: dict[str, Any], message: str) -> None:
    one = scenario(name)
    with pytest.raises(ValueError, match=message):
        one.tasks({**one.settings, **change}, 1)
