"""A watch that judges nothing says so, whatever the model does, and goes on when it can judge again."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from optional_packages import STRUCTURAL
from toy_plants import changed, readings, tanks

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.detectors.verdicts import Verdict
from fusion_sfdia.diagnosis.changes import Change
from fusion_sfdia.diagnosis.watch import Sample, Watch
from fusion_sfdia.live.lines import change_line, results, sample_line
from fusion_sfdia.plant.plant import Plant

Rows = list[tuple[float, np.ndarray, np.ndarray]]
WRITE = {"alarm": "A", "verdict": "V", "l1": {"value": "v", "sigma": "s", "verdict": "w"}}
FIRST, LAST = 150.0, 200.0  # s, while the model fails


def rows_of(steps: int = 60, seed: int = 1) -> Rows:
    t, _, y, u = readings(tanks(), steps, 1, seed)
    return [(float(s), r.copy(), a) for s, r, a in zip(t, y[:, 0], u[:, 0], strict=True)]


def taken(watch: Watch, rows: Rows) -> list[Sample]:
    return [sample for row in rows for sample in watch.update(*row)]


def sight(samples: list[Sample]) -> list[Change]:
    return [c for s in samples for c in s.changes if c.what in ("reset", "blind", "sees again")]


class OwnError(Exception):
    """An error of a model."""


def raising(error: BaseException) -> Callable[[Any], Any]:
    def fails(value: Any) -> Any:
        raise error

    return fails


def without_end(value: Any) -> Any:
    return without_end(value)


FAILURES: dict[str, Callable[[Any], Any]] = {
    "KeyError": raising(KeyError("flow")),
    "IndexError": raising(IndexError("index 3")),
    "TypeError": raising(TypeError("no number")),
    "AttributeError": raising(AttributeError("no x")),
    "ValueError": raising(ValueError("negative")),
    "ZeroDivisionError": lambda value: 1 / 0,
    "FloatingPointError": raising(FloatingPointError("overflow")),
    "OverflowError": raising(OverflowError("too large")),
    "RecursionError": without_end,
    "RuntimeError": raising(RuntimeError("solver")),
    "NotImplementedError": raising(NotImplementedError()),
    "AssertionError": raising(AssertionError()),
    "StopIteration": raising(StopIteration()),
    "OSError": raising(FileNotFoundError(2, "No such file", "table.csv")),
    "MemoryError": raising(MemoryError()),
    "UnicodeDecodeError": raising(UnicodeDecodeError("utf-8", b"x", 0, 1, "bad")),
    "OwnError": raising(OwnError("own")),
    "SystemExit": raising(SystemExit(0)),
    "GeneratorExit": raising(GeneratorExit()),
    "complex": lambda value: value + 1e-3j,
    "complex of reals": lambda value: value + 0j,
    "None": lambda value: None,
    "object": lambda value: object(),
    "objects": lambda value: np.array([None] * value.shape[-1]),
    "text": lambda value: "nan",
    "texts": lambda value: value.astype(str),
    "ragged list": lambda value: [[1.0], [2.0, 3.0]],
    "dict": lambda value: {},
    "generator": lambda value: (v for v in value),
    "times": lambda value: np.full(value.shape, np.datetime64("2026-03-01")),
    "one less": lambda value: value[..., :-1],
    "twice as many": lambda value: np.concatenate([value, value], axis=-1),
    "a number": lambda value: 1.0,
    "nothing": lambda value: np.empty(0),
    "more axes": lambda value: value[None, None],
    "NaN": lambda value: value * np.nan,
    "infinity": lambda value: value * np.inf,
}


def failing(plant: Plant, which: str, failure: Callable[[Any], Any]) -> Plant:
    """The plant whose step or output fails while FIRST <= t < LAST."""
    own: Any = getattr(plant, which)

    def fails(t: float, *arguments: Any) -> Any:
        found = own(t, *arguments)
        return failure(found) if FIRST <= t < LAST else found

    return replace(plant, **{which: fails})


@pytest.mark.parametrize("which", ["step", "output"])
@pytest.mark.parametrize("kind", FAILURES)
def test_a_model_that_fails_is_blind_until_it_works_again(which: str, kind: str) -> None:
    remarks: list[str] = []
    detector = LeaveOneOutBank(failing(tanks(), which, FAILURES[kind]), window=1)
    rows = rows_of()
    rows[50][1][0] += 1.0  # seen after the failure
    watch = Watch(detector, refused=remarks.append)
    samples = taken(watch, rows)
    assert [s.t for s in samples] == [row[0] for row in rows]
    bad = [s for s in samples if s.verdict is Verdict.BLIND]
    assert {s.t for s in bad} == {
        t for t in np.arange(FIRST, LAST + 1, 5) if FIRST <= t < LAST or (which == "step" and t > FIRST)
    } - ({FIRST} if which == "step" else set())
    found = sight(samples)
    assert [c.what for c in found] == ["reset", "blind", "sees again"]
    assert found[0].t == found[1].t == bad[0].t and found[2].t == bad[-1].t + 15.0 and found[2].id == found[1].id
    assert found[2].reason == "rows are judged again; the verdict is healthy"
    expected = 0 if kind in ("NaN", "infinity") else 1
    assert len(remarks) == expected and all("there is no verdict until the model works again" in r for r in remarks)
    assert samples[50].verdict is Verdict.SENSOR and samples[-1].verdict is Verdict.HEALTHY
    for sample in bad:
        line = json.loads(sample_line(sample, detector.plant, detector.hypotheses, watch.clock))
        assert (line["verdict"], line["alarm"], line["score"], line["isolated"]) == ("blind", None, None, [])
        written = dict(results(detector, sample, WRITE))
        assert written["A"] is None and str(written["V"]).startswith("no verdict: ") and written["w"] == "no verdict"
        assert np.isnan(float(written["v"] or 0.0)) and np.isnan(float(written["s"] or 0.0))


def test_a_failure_names_function_line_and_error() -> None:
    remarks: list[str] = []
    taken(Watch(LeaveOneOutBank(failing(tanks(), "step", FAILURES["KeyError"])), refused=remarks.append), rows_of())
    assert remarks[0].startswith("row at 155 s: the model failed: its function `fails` (test_blind.py, line ")
    assert remarks[0].endswith(") raised KeyError: 'flow'; there is no verdict until the model works again")
    remarks.clear()
    taken(Watch(LeaveOneOutBank(failing(tanks(), "output", FAILURES["one less"])), refused=remarks.append), rows_of())
    assert "its output gives ndarray of shape (3,) for one state; expected 4 real numbers, shape (4,)" in remarks[0]


def test_jacobians_may_fail_too_and_the_second_look_with_them() -> None:
    plant = tanks()
    own = plant.step_jacobian_at
    for first, last in ((FIRST, LAST), (10.0, 30.0), (FIRST, 1e9)):

        def jacobian(t: float, x: Any, u: Any, dt: float, span: tuple[float, float] = (first, last)) -> Any:
            if span[0] <= t < span[1]:
                raise KeyError(t)
            return own(t, x, u, dt)

        remarks: list[str] = []
        watch = Watch(LeaveOneOutBank(changed(plant, step_jacobian=jacobian)), refused=remarks.append)
        samples = taken(watch, rows_of())
        assert {s.t for s in samples if s.verdict is Verdict.BLIND} == {s.t for s in samples if first <= s.t - 5.0 < last}
        assert len(remarks) == 1 and watch.last() is not None


def test_an_interruption_passes() -> None:
    def fails(value: Any) -> Any:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        taken(Watch(LeaveOneOutBank(failing(tanks(), "step", fails))), rows_of())


@pytest.mark.parametrize("kinds", [True, False])
@pytest.mark.parametrize("value", [np.nan, 1e300])
def test_readings_that_are_all_missing_or_impossible_are_no_verdict(value: float, kinds: bool) -> None:
    rows = rows_of()
    for k in (10, *range(20, 40)):
        rows[k][1][:] = value
    detector = LeaveOneOutBank(tanks())
    samples = taken(Watch(detector, kinds=kinds), rows)
    assert [k for k, s in enumerate(samples) if s.verdict is Verdict.BLIND] == [10, *range(20, 40)]
    what = "no sensor has a reading" if np.isnan(value) else "all readings are missing or impossible"
    found = sight(samples)
    assert [(c.what, c.t) for c in found] == [("blind", rows[22][0]), ("sees again", rows[42][0])]  # one row alone is no change
    assert found[0].reason == what
    expected = {"event": "blind", "id": found[0].id, "t": rows[22][0], "device_health": "CHECK_FUNCTION", "reason": what}
    assert json.loads(change_line(found[0], Clock(), {})) == expected | {"alarm_id": 1, "alarm_new": True, "alarm_active": True}
    written = dict(results(detector, samples[30], WRITE))
    assert written["A"] is None and written["V"] == f"no verdict: {what}"
    assert written["w"] == ("missing" if np.isnan(value) else "no verdict")


@pytest.mark.parametrize("name", ["loo-chi2", "kf-chi2", "chebyshev:paper", "limits", "pca", STRUCTURAL])
def test_readings_that_are_all_far_off_are_not_healthy(name: str) -> None:
    rows = rows_of()
    for _, y, _ in rows[30:]:
        y += 1e4 * tanks().sensor_sigma * np.array([1.0, -1.0, 1.0, -1.0])
    detector = registry.detector(name, tanks())
    samples = taken(Watch(detector), rows)
    assert all(s.verdict in (Verdict.HEALTHY, Verdict.SENSOR, Verdict.UNDECIDED) for s in samples[:30])
    assert all(s.verdict not in (Verdict.HEALTHY, Verdict.SENSOR) for s in samples[32:36])
    for sample in samples[30:]:
        written = dict(results(detector, sample, WRITE))
        assert written["A"] is not False and "none isolated" not in str(written["V"]) and written["w"] != "healthy"


def test_a_blind_watch_saved_and_loaded_sees_again_with_the_same_line(tmp_path: Path) -> None:
    rows, detector = rows_of(), LeaveOneOutBank(tanks())
    for _, y, _ in rows[20:40]:
        y[:] = np.nan
    expected = [repr(c) for c in sight(taken(Watch(detector), rows))]
    first = Watch(detector)
    before = sight(taken(first, rows[:41]))
    first.save(tmp_path / "w.state")
    after = sight(taken(Watch.load(tmp_path / "w.state", detector), rows[41:]))
    assert [repr(c) for c in (*before, *after)] == expected and len(expected) == 2


def test_an_alarm_without_a_cause_is_neither_healthy_nor_false() -> None:
    """Thresholds of infinity, and hypotheses that all explain an alarm."""
    rows, detector = rows_of(), registry.detector("kf-chi2", tanks())
    with np.errstate(over="ignore"):
        samples = taken(Watch(replace(detector, threshold_scale=1e308)), rows)
    written = dict(results(detector, samples[-1], WRITE))
    assert written["A"] is None and written["V"] == "cannot tell: the thresholds allow no decision yet"


def test_repeats_of_slow_sensors_leave_the_verdict_as_it_was() -> None:
    """Sensors that are new every fifth row: the rows between are judged by none, and nothing is lost by that."""
    rows = rows_of(400)
    for k, (_, y, _) in enumerate(rows):
        y[:] = rows[k - k % 5][1]
    samples = taken(Watch(LeaveOneOutBank(tanks()), refused=[].append), rows)
    assert not sight(samples) and {s.verdict for s in samples[5:]} == {Verdict.HEALTHY}
    for _, y, _ in rows[200:300]:
        y[:] = np.nan
    assert [c.what for c in sight(taken(Watch(LeaveOneOutBank(tanks()), refused=[].append), rows))] == ["blind", "sees again"]
