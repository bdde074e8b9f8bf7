"""Steps of sensors whose readings have inertia: laws of jumps, and the verdicts of a monitor."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from factor_logs import log_of, signals
from numpy.typing import NDArray

from fusion_sfdia.learning.monitor.causes import MOVED, Causes
from fusion_sfdia.learning.monitor.monitor import Monitor
from fusion_sfdia.learning.monitor.steps import BRIEF, INERT, STEEP, JumpLimits, Stepped, steps

Array = NDArray[Any]

JUMP, ROWS = 0.1, 60
LIMITS = JumpLimits(np.full(3, JUMP), np.array([STEEP * JUMP, STEEP * JUMP, np.inf]))  # of two with inertia and one without


def off(z: Array, stopped: Array | None = None, cut: int = ROWS) -> Array:
    """By how much steps have put each sensor off, for readings z (K, 3), judged so many rows at a time."""
    jumps = np.diff(z, axis=0, prepend=z[:1])
    stopped = np.zeros(z.shape, bool) if stopped is None else stopped
    found, before = [], Stepped.none(3, 3)
    for k in range(0, len(z), cut):
        size, _, before = steps(LIMITS, jumps[k : k + cut], stopped[k : k + cut], before)
        found.append(size)
    return np.concatenate(found)


def readings(**changes: tuple[int, int, float]) -> Array:
    """Readings of sensors a, b and c that stand still but for changes from one row to another."""
    z = np.zeros((ROWS, 3))
    for name, (first, end, size) in changes.items():
        z[first:end, "abc".index(name)] += size
    return z


def test_a_step_is_known_a_row_later_until_jumps_take_it_back() -> None:
    found = off(readings(a=(20, 50, 0.5)))
    assert np.flatnonzero(found[:, 0]).tolist() == list(range(21, 51))
    assert found[21:, 0] == pytest.approx(np.where(np.arange(21, ROWS) <= 50, 0.5, 0.0))
    assert not found[:, 1:].any()


@pytest.mark.parametrize("size", [0.3, 1.0, 5.0, 50.0])
def test_a_process_with_a_lag_of_a_row_or_more_makes_no_step(size: float) -> None:
    for lag in (1.0, 3.0, 30.0):
        assert lag > 1 / np.log(STEEP)
        z = readings()
        z[20:, 0] = size * (1 - np.exp(-np.arange(1, ROWS - 19) / lag))
        assert not off(z).any()
    z[20:, 0] = 5.0 * (1 - np.exp(-np.arange(1, ROWS - 19) / 0.2))  # what the rule cannot know: faster than the rows
    assert off(z)[:, 0].any()


def test_several_that_jump_together_are_named_only_once_they_went_back_soon() -> None:
    for gap in (0, 1):  # of rows between their jumps
        assert not off(readings(a=(20, ROWS, 0.5), b=(20 + gap, ROWS, 0.5))).any()
        found = off(readings(a=(20, 23, 0.5), b=(20 + gap, 24, -0.5)))
        assert np.flatnonzero(found[:, 0]).tolist() == [23] and np.flatnonzero(found[:, 1]).tolist() == [24]
    assert not off(readings(a=(20, 21 + BRIEF, 0.5), b=(20, 21 + BRIEF, 0.5))).any()
    assert off(readings(a=(20, 50, 0.5), b=(22, ROWS, 0.05)))[:, 0].any()  # a small jump is no other cause


def test_a_sensor_without_inertia_or_one_that_stood_still_does_not_step() -> None:
    assert not off(readings(c=(20, 50, 5.0))).any()
    z, stopped = readings(a=(20, ROWS, 0.5)), np.zeros((ROWS, 3), bool)
    stopped[10:20, 0] = True
    assert not off(z, stopped).any()


def test_steps_do_not_depend_on_where_a_log_is_cut() -> None:
    z = readings(a=(5, 21, 0.6), b=(30, 33, -0.7)) + readings(a=(25, 40, -0.5), b=(44, ROWS, 0.9))
    stopped = np.zeros((ROWS, 3), bool)
    stopped[41:44, 1] = True
    whole = off(z, stopped)
    assert whole[:, 0].any() and whole[:, 1].any()
    for cut in (1, 2, 7, 23):
        assert np.array_equal(off(z, stopped, cut), whole)


def test_inertia_is_a_range_of_many_jumps_and_no_step_in_a_healthy_block() -> None:
    rng = np.random.default_rng(0)
    blocks = [rng.uniform(-JUMP, JUMP, (100, 3)) for _ in range(4)]
    largest = np.full((5, 3), JUMP)
    ranges = np.array([1.01, 1.01, 0.99]) * INERT * JUMP
    assert np.isfinite(JumpLimits.of(blocks, ranges, largest).step).tolist() == [True, True, False]
    blocks[2][50] = [0.0, 1.01 * STEEP * JUMP, 0.0]  # a recalibration
    assert np.isfinite(JumpLimits.of(blocks, ranges, largest).step).tolist() == [True, False, False]


def slow(seed: int, rows: int = 1200, step: float = 0.0) -> Array:
    """A tank's level with a lag of 60 rows, that nothing else measures, and two noisy flows; step: of the level's inflow."""
    rng = np.random.default_rng(seed)
    level, flow = np.zeros(rows), np.zeros(rows)
    for k in range(1, rows):
        flow[k] = 0.9 * flow[k - 1] + rng.standard_normal()
        level[k] = level[k - 1] + (3.0 * rng.standard_normal() + (step if k >= 600 else 0.0) - level[k - 1]) / 60
    return np.column_stack([level, flow, flow]) + 0.02 * rng.standard_normal((rows, 3))


@pytest.fixture(scope="module")
def monitor() -> Monitor:
    return Monitor.of_logs(signals(3), [log_of(slow(1, 3000))])


def judged(monitor: Monitor, y: Array) -> Causes:
    (found,) = monitor.judge(log_of(y))
    return found.causes


def test_a_step_names_a_sensor_that_nothing_else_measures_and_a_process_does_not(monitor: Monitor) -> None:
    assert np.isfinite(monitor.learnt.jumps.step).tolist() == [True, False, False]
    assert str(monitor).count("unless it steps in one row") == 1
    y = slow(2)
    y[600:700, 0] += 3.0
    by = judged(monitor, y)
    assert by.named[601:700, 0].mean() > 0.9 and not by.named[:, 1:].any()
    process = judged(monitor, slow(2, step=20.0))
    assert (process.kind[600:700] == MOVED).mean() > 0.5 and not process.named[600:700].any()
    without = replace(monitor.learnt, jumps=monitor.learnt.jumps._replace(step=np.full(3, np.inf)))
    assert not judged(replace(monitor, learnt=without), y).named[600:700].any()


def test_a_reading_that_jumps_and_goes_back_is_named_with_its_size(monitor: Monitor) -> None:
    y = slow(3)
    y[600, 0] += 3.0
    (event,) = [e for e in monitor.diagnose(log_of(y)).events if e.kind == "sensor"]
    assert event.hypothesis == "s0" and event.size == pytest.approx(3.0, abs=0.5)
    assert event.start == 601 * 60.0 and not event.confidence < 0.5  # no "perhaps"


def test_row_by_row_and_after_saving_steps_are_the_same(tmp_path: Any) -> None:
    monitor, y = Monitor.of_logs(signals(3), [log_of(slow(1, 1000))]), slow(4, 90)
    y[40:60, 0] += 3.0
    whole = monitor.diagnose(log_of(y)).decisions
    monitor.save(tmp_path / "m.sfdia")
    stream = Monitor.load(tmp_path / "m.sfdia").stream()
    rows = [s.decision for row in zip(*log_of(y), strict=True) for s in stream.update(*row)]
    assert np.array_equal([d.isolated for d in rows], whole.isolated) and whole.isolated[41:60, 0].all()
