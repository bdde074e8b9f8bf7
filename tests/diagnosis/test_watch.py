"""Rows one after another give what `diagnose` gives on all of them, whatever the clock and the process do."""

from __future__ import annotations

import gc
import sys
import tracemalloc
import warnings
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from process_bank import ProcessBank
from toy_plants import chain, changed, declared, readings, tanks

from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.detectors.kalman_banks.robust_bank import RobustBank
from fusion_sfdia.detectors.state import leaves
from fusion_sfdia.diagnoser import diagnose
from fusion_sfdia.diagnosis.changes import Change
from fusion_sfdia.diagnosis.events import Event, events_of
from fusion_sfdia.diagnosis.watch import Sample, Watch, WatchWarning
from fusion_sfdia.plant.plant import Plant

Rows = list[tuple[Any, np.ndarray, np.ndarray]]


def rows_of(plant: Plant, steps: int, seed: int = 0, faults: dict[int, tuple[int, int, float]] | None = None) -> Rows:
    """Rows of a healthy run, in which sensors have a bias of so many sigma from one sample to another."""
    t, _, y, u = readings(plant, steps, 1, seed)
    y = y[:, 0].copy()
    for sensor, (first, last, size) in (faults or {}).items():
        y[first:last, sensor] += size * plant.sensor_sigma[sensor]
    return [(float(s), r, a) for s, r, a in zip(t, y, u[:, 0], strict=True)]


def taken(watch: Watch, rows: Rows) -> list[Sample]:
    return [sample for row in rows for sample in watch.update(*row)]


def changes_of(samples: list[Sample]) -> list[Change]:
    return [change for sample in samples for change in sample.changes]


def final(changes: list[Change]) -> list[Event]:
    """The events that have closed, in the order of `diagnose`."""
    order = {"process": 0, "undecided": 1}
    found = [replace(c.event, sigmas=np.nan) for c in changes if c.what == "closed" and c.event]
    return sorted(found, key=lambda e: (order.get(e.kind, 2), e.start, e.hypothesis))


def events_opened(changes: list[Change]) -> list[Event]:
    return [c.event for c in changes if c.what == "opened" and c.event]


def faulty(steps: int = 150) -> Rows:
    """Two faults of the tanks, one over while the other lasts, missing readings, and an outage of 40 samples."""
    rows = rows_of(tanks(), steps, 3, {0: (20, 50, 15.0), 3: (40, 130, -12.0)})
    for _, y, _ in rows[60:66]:
        y[1] = np.nan
    return rows[:80] + rows[120:]


def bank() -> LeaveOneOutBank:
    return LeaveOneOutBank(tanks(), window=5)


@pytest.mark.parametrize("spacing", [1.0, 0.5], ids=["dt", "half dt"])
def test_the_isolated_samples_and_events_are_those_of_a_diagnosis(spacing: float) -> None:
    detector = bank()
    rows = [(t * spacing, y, u) for t, y, u in faulty()]
    t, y, u = map(np.array, zip(*rows, strict=True))
    expected = diagnose(detector, t, y, u)
    samples = taken(Watch(detector), rows)
    assert [s.t for s in samples] == t.tolist()
    np.testing.assert_array_equal([s.decision.isolated for s in samples], expected.decisions.isolated)
    np.testing.assert_array_equal([s.decision.estimate for s in samples], expected.decisions.estimate)
    assert {e.hypothesis for e in expected.events} >= {"l1", "q2"} and not any(e.open for e in expected.events)
    changes = changes_of(samples)
    assert repr(final(changes)) == repr(list(events_of(detector, t, expected.decisions, 3)))
    first, of_diagnosis = (
        next(e for e in found if e.hypothesis == "l1") for found in (events_opened(changes), expected.events)
    )
    assert (first.confidence, first.alternatives) == (of_diagnosis.confidence, of_diagnosis.alternatives)
    assert first.sigmas == pytest.approx(first.size / 0.01)


def test_an_event_opens_with_its_sample_and_closes_after_gap_samples_without_it() -> None:
    found = changes_of(taken(Watch(bank(), gap=4), faulty()))
    opened = {c.id: c for c in found if c.what == "opened"}
    closed = {c.id: c for c in found if c.what == "closed"}
    assert [c.id for c in opened.values()] == list(range(1, len(opened) + 1)) and opened.keys() == closed.keys()
    times = [row[0] for row in faulty()]
    for number, change in closed.items():
        event = change.event
        assert event and not event.open and opened[number].event and opened[number].t == event.start
        assert times.index(change.t) == times.index(event.end) + 4


def test_verdicts_on_the_process_are_those_of_a_diagnosis() -> None:
    """And an alarm that nothing explains clearly."""
    plant = declared()
    detector: Any = RobustBank(plant)
    t, _, y, u = readings(plant, 160, 1, seed=2)
    y = y[:, 0].copy()
    y[40:90] += 4.0  # no single sensor: the process
    y[110:130, 2] += 4.0
    expected = diagnose(detector, t, y, u[:, 0])
    samples = taken(Watch(detector), list(zip(t.tolist(), y, u[:, 0], strict=True)))
    np.testing.assert_array_equal([s.decision.process for s in samples], expected.decisions.process)
    np.testing.assert_array_equal([s.decision.suspect for s in samples], expected.decisions.suspect)
    changes, events = changes_of(samples), events_of(detector, t, expected.decisions, 3)
    closed = [e for e in events if not e.open]
    assert {e.kind for e in events} >= {"process", "undecided"}
    assert sorted(map(repr, final(changes))) == sorted(map(repr, closed))
    standing = {c.id for c in changes if c.what == "opened"} - {c.id for c in changes if c.what == "closed"}
    assert len(standing) == sum(e.open for e in events)


@pytest.mark.parametrize(("cut", "again"), [(3, "all"), (22, "after"), (79, "after"), (83, "all")])
def test_a_watch_taken_up_again_gives_the_same_changes_and_bits(cut: int, again: str, tmp_path: Path) -> None:
    rows, detector, path = faulty(), bank(), tmp_path / "new" / "watch.state"
    whole = Watch(detector)
    expected = changes_of(taken(whole, rows))
    first = Watch(detector)
    before = changes_of(taken(first, rows[:cut]))
    first.save(path)
    lost = changes_of(taken(first, rows[cut : cut + 10]))  # after the save, before the end of the process
    remarks: list[str] = []
    second = Watch.load(path, bank(), refused=remarks.append)
    assert second.t == rows[cut - 1][0]
    after = changes_of(taken(second, rows if again == "all" else [r for r in rows if r[0] > second.t]))
    assert repr(before + after) == repr(expected)
    assert repr(after[: len(lost)]) == repr(lost)
    assert second.state is not None and whole.state is not None
    for a, b in zip(leaves(second.state), leaves(whole.state), strict=True):
        np.testing.assert_array_equal(a, b)
    assert not remarks


def test_a_state_of_another_kind_or_detector_is_refused(tmp_path: Path) -> None:
    path, watch = tmp_path / "watch.state", Watch(bank())
    watch.save(path)
    assert not path.exists()  # nothing to save yet
    taken(watch, faulty()[:30])
    watch.save(path)
    with pytest.raises(ValueError, match=r"saved by another detector, other settings or another plant.* the same --plant, "):
        Watch.load(path, LeaveOneOutBank(tanks(), window=6))
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(ValueError, match=r"not the saved state of a watch .*damaged.* name another file"):
        Watch.load(path, bank())


def test_late_rows_are_skipped_with_a_line_for_the_first_and_their_number() -> None:
    rows, remarks = faulty()[:40], []
    watch = Watch(bank(), refused=remarks.append)
    disordered = [*rows[:20], rows[4], rows[5], rows[19], *rows[20:30], rows[28], *rows[30:]]
    samples = taken(watch, disordered)
    expected = taken(Watch(bank()), rows)
    assert repr(changes_of(samples)) == repr(changes_of(expected))
    assert remarks[0] == (
        "row at 25 s: it is earlier than the last one, at 100 s; it is not taken, nor is another until then; start with a "
        "new state if the clock was set back"
    )
    assert remarks[1] == "3 rows until 105 s not taken" and remarks[3] == "1 row until 155 s not taken"


def test_duplicates_are_counted_in_a_line_and_the_first_counts() -> None:
    rows, remarks = faulty()[:40], []
    again = [(t, y + 1.0, u) for t, y, u in rows]
    expected = changes_of(taken(Watch(bank()), rows))
    for reorder in (0.0, 20.0):
        watch = Watch(bank(), reorder=reorder, refused=remarks.append)
        given = [rows[0], again[0], *rows[1:20], again[19], again[19], *rows[20:], again[39]]
        samples = [*taken(watch, given), *watch.finish()]
        assert repr(changes_of(samples)) == repr(expected)
        said = [f"{count} dropped, the first row of each time kept" for count in ("1 duplicate", "2 duplicates", "1 duplicate")]
        assert remarks == said
        remarks.clear()


def test_a_wrong_clock_in_one_row_is_noticed_in_the_next() -> None:
    """Also in the first row: otherwise all rows after it would be late."""
    rows = faulty()[:40]
    expected = repr(changes_of(taken(Watch(bank()), rows)))
    for k in (0, 25):
        remarks: list[str] = []
        wrong = (rows[k][0] + 1e9, *rows[k][1:])
        samples = taken(Watch(bank(), refused=remarks.append), [*rows[:k], wrong, *rows[k:]])
        assert repr(changes_of(samples)) == expected
        assert len(remarks) == 1 and "it is later than the row after it" in remarks[0]


def test_after_a_long_pause_the_detector_starts_anew() -> None:
    rows = faulty()
    later = [(t + 1e5, y, u) for t, y, u in rows]
    samples = taken(Watch(bank(), longest_gap=1000.0), rows[:30] + later[:60])
    changes = changes_of(samples)
    reset = next(i for i, c in enumerate(changes) if c.what == "reset")
    assert changes[reset].t == later[0][0] and changes[reset].reason == "no rows for 99855 s"
    closed = changes[reset - 1]
    assert closed.what == "closed" and closed.event and (closed.event.hypothesis, closed.event.end) == ("l1", rows[29][0])
    fresh = taken(Watch(bank()), later[:60])
    np.testing.assert_array_equal([s.decision.estimate for s in samples[30:]], [s.decision.estimate for s in fresh])


def test_a_detector_that_diverges_starts_anew_and_says_so_once() -> None:
    plant = tanks()
    broken = replace(plant, output=lambda t, x, u: plant.output(t, x, u) * (np.nan if 100 <= t <= 115 else 1))
    rows = rows_of(plant, 60, 3, {0: (15, 40, 15.0)})
    samples = taken(Watch(CentralFilter(broken)), rows)
    assert [s.t for s in samples if s.decision.diverged] == [100.0, 105.0, 110.0, 115.0]
    changes = changes_of(samples)
    assert [(c.what, c.t) for c in changes if c.what == "reset"] == [("reset", 100.0)]
    assert changes[-1].what != "reset" and np.isfinite(samples[-1].decision.estimate).all()


def test_missing_inputs_are_held_for_a_time_and_never_guessed() -> None:
    rows, remarks = rows_of(tanks(), 30), []
    missing = [(t, y, np.full(1, np.nan) if 10 <= k < 16 else u) for k, (t, y, u) in enumerate(rows)]
    missing[20] = (rows[20][0], rows[20][1], np.array([-9.0]))  # m3/s, beyond its limits
    watch = Watch(bank(), hold=15.0, refused=remarks.append)
    samples = taken(watch, missing)
    assert [s.t for s in samples] == [t for k, (t, _, _) in enumerate(rows) if not 13 <= k < 16]
    assert all(s.u == rows[9][2] for s in samples[9:13]) and samples[17].u == rows[19][2]
    assert remarks == [
        f"row at {t} s: input inflow is missing, and its last value is held for 15 s only; it is not taken"
        for t in (70, 75, 80)
    ]
    usual = taken(Watch(bank(), nominal_inputs=True), missing)
    assert [float(s.u[0]) for s in usual[10:16]] == [float(tanks().input_at(0.0)[0])] * 6


def test_rows_that_do_not_fit_are_skipped_and_never_end_a_watch() -> None:
    rows, remarks = rows_of(tanks(), 12), []
    watch = Watch(bank(), refused=remarks.append)
    t, y, u = rows[5]
    bad: Rows = [
        (t, y[:3], u),
        (t, y, np.zeros(2)),
        (np.nan, y, u),
        ("noon", y, u),
        (t, ["x"] * 4, u),
        (datetime.now(UTC), y, u),
    ]
    samples = taken(watch, [*rows[:5], *bad, *rows[5:]])
    assert [s.t for s in samples] == [row[0] for row in rows] and len(remarks) == len(bad)
    expected = (
        "(3,); expected (4,)",
        "(2,); expected (1,)",
        "not finite",
        "'noon'; expected a number",
        "y is",
        "as in the rows",
    )
    assert all(what in remark for what, remark in zip(expected, remarks, strict=True))
    fixed = Watch(CentralFilter(changed(tanks(), fixed_dt=True)), refused=remarks.append)
    assert len(taken(fixed, [*rows[:4], (21.5, y, u), *rows[4:]])) == len(rows)
    assert "21.5 s: a step of 1.5 s; plant" in remarks[-1]
    with pytest.warns(WatchWarning, match="not finite; it is not taken"):
        Watch(bank()).update(np.nan, y, u)
    for setting in ({"gap": 0}, {"gap": 1000}, {"hold": np.inf}, {"longest_gap": -1.0}):
        with pytest.raises(ValueError, match="expected"):
            Watch(bank(), **setting)  # type: ignore[arg-type]


def test_time_stamps_become_seconds_since_the_first_also_after_a_restart(tmp_path: Path) -> None:
    rows, start = faulty(), datetime(2026, 3, 1, 14, 0, tzinfo=UTC)
    stamped = [(start + timedelta(seconds=t), y, u) for t, y, u in rows]
    watch = Watch(bank())
    expected = changes_of(taken(watch, stamped))
    assert watch.clock.start == stamped[0][0] and watch.t == rows[-1][0] - rows[0][0]
    first = Watch(bank())
    before = changes_of(taken(first, stamped[:40]))
    first.save(tmp_path / "s")
    second = Watch.load(tmp_path / "s", bank())
    assert second.clock == watch.clock
    assert repr(before + changes_of(taken(second, stamped[40:]))) == repr(expected)
    naive = Watch(bank(), refused=(remarks := []).append)
    taken(naive, [stamped[0], (datetime(2026, 3, 1, 15, 0), *rows[1][1:])])
    assert "offset-naive" in remarks[0]


def endless(plant: Plant, count: int) -> Iterator[tuple[float, np.ndarray, np.ndarray]]:
    """Rows with a fault in a tenth of them, made as they are asked for."""
    rng, nothing = np.random.default_rng(0), np.zeros(0)
    for k in range(1, count + 1):
        y = rng.standard_normal(len(plant.sensors))
        y[0] += 10.0 * (k % 1000 > 900)
        yield float(k), y, nothing


def memory_growth(rows: int) -> tuple[int, int]:
    """Blocks of memory that a watch takes from its 2000th row to its last, and the number of changes."""
    detector, found, blocks = CentralFilter(chain(3, process=1e-3)), 0, 0
    watch = Watch(detector)
    for k, row in enumerate(endless(detector.plant, rows), start=1):
        found += sum(len(sample.changes) for sample in watch.update(*row))
        if k in (2000, rows):
            gc.collect()
            blocks = sys.getallocatedblocks() - blocks
    return blocks, found


@pytest.mark.slow
def test_the_memory_does_not_grow() -> None:
    """What a watch holds is the state, fixed arrays, at most one standing event a hypothesis, and KEPT samples.

    An object a row would be 6000 blocks.
    """
    growth, found = memory_growth(8_000)
    assert found > 8 and growth < 1000


@pytest.mark.long
def test_the_bytes_do_not_grow() -> None:
    """As above, in bytes: a float a row would be 32 kB and more.

    What is left is not of the rows: lists of free objects that the interpreter keeps, and other threads of the process.
    """
    detector = CentralFilter(chain(3, process=1e-3))
    watch, before = Watch(detector), 0
    tracemalloc.start()
    for k, row in enumerate(endless(detector.plant, 5500), start=1):
        watch.update(*row)
        if k in (1500, 5500):
            gc.collect()
            before, growth = tracemalloc.get_traced_memory()[0], tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert growth < 20_000


@pytest.mark.long
def test_the_memory_does_not_grow_over_many_rows() -> None:
    growth, found = memory_growth(60_000)
    assert found > 60 and growth < 1000


def test_the_generator_yields_each_change_with_its_row() -> None:
    rows = faulty()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert repr(list(Watch(bank()).events(rows))) == repr(changes_of(taken(Watch(bank()), rows)))
    first = next(Watch(bank()).events(iter(rows)))
    assert first.what == "opened" and first.event and first.event.hypothesis == "l1"


@pytest.mark.parametrize("kinds", [True, False])
def test_what_follows_a_fault_is_said_as_diagnose_says_it(kinds: bool) -> None:
    plant = tanks()
    l1, q12 = plant.sensor_index("l1"), plant.sensor_index("q12")
    bank = ProcessBank(plant, false_alarm=1e-6, accept=(10**6, 10**6), doubt=(32, 45), between=(q12, l1))
    rows = rows_of(plant, 80, faults={q12: (10, 30, 20.0)})
    whole = diagnose(bank, *(np.array(part) for part in zip(*rows, strict=True)))
    (event,) = (e for e in whole.events if e.hypothesis == "q12" and e.kind == "sensor")
    whether = "it cannot be told whether it or level of the upper tank l1 is at fault"
    assert f"{whether.replace('cannot', 'could not').replace(' is ', ' was ')}, and after 220 s it reads" in whole.sentence(
        event
    )
    watch = Watch(bank, kinds=kinds)
    said = [c.sentence(whole.words, watch.clock) for c in changes_of(taken(watch, rows)) if c.event and not c.event.open]
    texts = [text for text in said if text.startswith("Flow between")]
    assert f"; since 160 s {whether}. " in texts[0]
    assert not kinds or texts[-1] == whole.sentence(event)  # of the second look, when the alarm has ended, too
