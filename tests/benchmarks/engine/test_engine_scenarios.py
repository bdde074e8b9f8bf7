"""The engine scenarios end to end: published numbers, decision logic on the papers' timelines, smallest faults, matrices."""

from __future__ import annotations

import numpy as np
import pytest
from engine_signatures import K22_LOCAL, K24_LOCAL
from smallest_scenarios import smallest

from fusion_sfdia.benchmarks.engine import minimum_fault as minimum
from fusion_sfdia.benchmarks.engine import signatures as engine_signatures
from fusion_sfdia.benchmarks.engine.support.trials import (
    BIN,
    DETECTORS,
    NAMES,
    by_detector,
    engine_detector,
    extremes,
    published_first,
    recording,
    tasks,
    timeline,
    trial,
)
from fusion_sfdia.detectors.detector import run
from fusion_sfdia.models.marine_engine.published import (
    SIGNATURES,
    THREE_FAULTS,
    TWO_FAULTS,
    PrintedTable,
    PublishedOffset,
    minimum_fault,
    signatures,
)
from fusion_sfdia.report.results import Row
from fusion_sfdia.study.diagnosis_metrics import smallest_detectable
from fusion_sfdia.study.experiments.scenario import Arrays
from fusion_sfdia.study.scenarios import scenario


def value(rows: list[Row], **expected: str) -> float:
    (found,) = [r for r in rows if all(getattr(r, k) == v for k, v in expected.items())]
    return found.value


def test_published_numbers_state_their_source() -> None:
    assert [minimum_fault(m).value for m in NAMES] == [5.06, 20.36, 14.06, 63.68, 5.0, 50.8, 11.37, 4.88, 0.03, 68.97]
    assert "Table V" in minimum_fault("M(1,1)").source
    first = THREE_FAULTS.first_alarm("M(3,1)")
    assert first is not None and first.value == 45.06 and "Fig. 4" in first.source
    assert TWO_FAULTS.first_alarm("M(1,1)") is None
    runs = [(*(tuple(f) for f in e.faults), e.noise) for e in (THREE_FAULTS, TWO_FAULTS)]
    assert runs == [
        (("S(2){3}", 20.0, -3.8e4), ("S(3){1}", 45.0, 5e4), ("S(4){2}", 70.0, 8.0), 0.05),  # N m, Pa, K
        (("S(3){1}", 10.0, 5e4), ("S(4){2}", 20.0, 8.0), 0.03),
    ]
    assert TWO_FAULTS.duration == 60.0  # K24 states no length
    assert set(THREE_FAULTS.fired) | set(TWO_FAULTS.fired) <= set(NAMES)


def test_the_printed_timelines_checked_by_hand() -> None:
    """K24: 2, 4, 5, 6 sensors isolated from 20, 45.06, 69.9, 70.01 s on. K22: 2, 3, 3, 4 from 10, 20, 22.1, 25.3 s on."""
    for published, counts, onset in ((THREE_FAULTS, [2, 4, 5, 6], 20.0), (TWO_FAULTS, [2, 3, 3, 4], 10.0)):
        lines = timeline(published_first(published.fired), published.faults, published.duration)
        at = np.searchsorted(lines.t, sorted(published.fired.values()))
        assert lines.isolated[at, 0].sum(axis=-1).tolist() == counts
        assert lines.active.any(axis=-1)[:, 0].tolist() == (lines.t >= onset).tolist()
    one = scenario("engine/three-faults")
    rows = list(one.summarise(one.settings, []).rows)
    ours = {m: value(rows, metric=f"{m}_performance_percent") for m in ("isolation", "exoneration")}
    # as in test_diagnosis_metrics: durations 25.06, 24.84, 0.11, 29.99 s of 80
    length, faulty, isolated = np.array([25.06, 24.84, 0.11, 29.99]), np.array([1, 2, 2, 3]), np.array([2, 4, 5, 6])
    assert ours["isolation"] == pytest.approx(100 * length @ (faulty / isolated) / 80, abs=1e-9)
    assert ours["exoneration"] == pytest.approx(100 * length @ (1 - isolated / 10) / 80, abs=1e-9)


def test_first_alarms_are_those_of_the_decisions() -> None:
    """A fault at 1 s: the module of its sensor fires with it; what is kept follows from the Decisions."""
    faults = (PublishedOffset("S(2){3}", 1.0, -3.8e4),)
    settings = {"noise": 0.05, "duration": 2.5, "detectors": DETECTORS[:1]}
    (task,) = tasks(settings, faults, 3)
    found = trial(task)
    detector = engine_detector(DETECTORS[0], 0.05)
    healthy = recording(0.05, 250, (0, 1, 2))
    y = healthy.y + np.where((healthy.t >= 1.0 - 1e-9)[:, None, None] & (np.arange(10) == 3), -3.8e4, 0.0)
    u = np.broadcast_to(healthy.u[:, None], (*y.shape[:2], 1))
    decision = run(detector, detector.init((3,)), healthy.t, y, u)[1]
    fired = np.abs(decision.residual) > decision.threshold
    expected = np.where(fired.any(axis=0), healthy.t[np.argmax(fired, axis=0)], np.inf)
    np.testing.assert_array_equal(found["first"], expected)
    np.testing.assert_allclose(found["first"][:, 3], 1.0, rtol=1e-12)
    np.testing.assert_array_equal(found["healthy"], decision.scores[:99].max(axis=0))
    np.testing.assert_array_equal(found["faulty"], decision.scores[99:].max(axis=0))
    assert np.all(found["healthy"] <= 1)
    lines = timeline(found["first"], faults, 2.5)
    last = np.searchsorted(healthy.t, lines.t[1:], side="right") - 1
    np.testing.assert_array_equal(lines.isolated[1:], decision.isolated[last])
    assert by_detector([(task, found), (task, found)])[DETECTORS[0]]["first"].shape == (6, 10)


def test_a_trace_keeps_the_samples_nearest_to_the_thresholds() -> None:
    rng = np.random.default_rng(0)
    t, residual, threshold = np.arange(4 * BIN) * 0.01, rng.normal(size=(4 * BIN, 3)), rng.uniform(1, 2, (4 * BIN, 3))
    kept = extremes(t, residual, threshold)
    assert kept.shape == (3, 8, 3)
    ratio, found = residual / threshold, kept[1] / kept[2]
    for j in range(3):
        for b in range(4):
            inside, pair = ratio[b * BIN : (b + 1) * BIN, j], found[2 * b : 2 * b + 2, j]
            # stored in single precision: a quotient of two rounded numbers
            assert sorted(pair) == pytest.approx([inside.min(), inside.max()], rel=3e-7)
    assert np.all(np.diff(kept[0], axis=0)[::2] >= 0)
    assert extremes(t[:3], residual[:3], threshold[:3]).shape == (3, 0, 3)


def test_the_smallest_fault_is_the_slack_where_a_module_does_not_read_its_own_sensor() -> None:
    detector = engine_detector(DETECTORS[0], 0.05)
    healthy = recording(0.05, 80, (0, 1))
    u = np.broadcast_to(healthy.u[:, None], (80, 2, 1))
    decision = run(detector, detector.init((2,)), healthy.t, healthy.y, u)[1]
    late = healthy.t >= minimum.ONSET
    algebraic = [NAMES.index(m) for m in ("M(2,1)", "M(2,2)", "M(3,2)", "M(3,3)", "M(4,3)")]
    nominal = np.array([detector.plant.structure.modules.nominal[s.measures] for s in detector.plant.sensors])  # type: ignore[union-attr]
    slack = smallest_detectable(decision.residual[late], -decision.threshold[late], decision.threshold[late]) / nominal
    found = minimum.smallest(detector, healthy.t, healthy.y, u=healthy.u)
    resolution = minimum.LARGEST / 2**minimum.HALVINGS
    assert np.all(
        (found[:, algebraic] > slack[:, algebraic]) & (found[:, algebraic] <= slack[:, algebraic] + 1.001 * resolution)
    )
    quiet = minimum.smallest(detector, healthy.t, healthy.signal[:, :1], u=healthy.u)
    # no other sensor: the noise bound itself
    assert 0.05 < quiet[0, NAMES.index("M(4,2)")] <= 0.05 + 1.001 * resolution


def test_a_module_that_alarms_by_itself_has_no_smallest_fault() -> None:
    detector = engine_detector(DETECTORS[1], 0.05)  # the printed constants: M(4,1) alarms within a second or two
    healthy = recording(0.05, 300, (0,))
    found = minimum.smallest(detector, healthy.t, healthy.y, u=healthy.u)
    assert np.isinf(found[0, NAMES.index("M(4,1)")]) and np.isfinite(found[0, NAMES.index("M(2,1)")])


def test_matrices_differ_from_the_printed_in_three_entries() -> None:
    found: dict[PrintedTable, set[tuple[str, str]]] = {}
    for task in engine_signatures.signature_tasks({}, 1):
        arrays: Arrays = engine_signatures.signature_work(task)
        table = PrintedTable(*task["table"])
        lines, faults = list(signatures(table)), list(engine_signatures.FAULTS)
        found[table] = {(lines[i], faults[j]) for i, j in np.argwhere(arrays["ours"] != arrays["printed"])}
    turbine, speed = {("E(3,3)", "f1(4)")}, {("E(2,1)", "f3(2)"), ("E(2,2)", "f3(2)")}
    assert found == {name: set() for name in SIGNATURES} | {
        PrintedTable("K24", "Table I"): speed,
        PrintedTable("K24", "Table II"): turbine,
        PrintedTable("K22", "Table 1"): turbine,
    }
    rows = smallest("engine/signatures").summary.rows
    assert sum(r.value for r in rows if r.metric == "entries_equal") == 230 - 4
    assert set(K24_LOCAL) == set(K22_LOCAL) == set(engine_signatures.ROWS)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"noise": 0.0}, "expected a share of the nominal values"),
        ({"duration": 71.0}, "a second after the last fault"),
        ({"detectors": ("limits",)}, "setting detectors has limits; known"),
    ],
)
def test_impossible_settings_are_refused_before_any_run(changes: dict[str, object], expected: str) -> None:
    one = scenario("engine/three-faults")
    with pytest.raises(ValueError, match=expected):
        one.tasks({**one.settings, **changes}, 1)
