"""engine/virtual-sensors: intervals of the faults' sizes, and the arrays that are kept of a run."""

from __future__ import annotations

import numpy as np
import pytest
from smallest_scenarios import smallest

from fusion_sfdia.benchmarks.engine.support.trials import NAMES, offsets, recording
from fusion_sfdia.benchmarks.engine.support.virtual_trials import (
    FAULTS,
    GUARANTEED,
    INTERSECTED,
    INVERSIONS,
    KEPT,
    LEARNING_RATES,
    MAPE,
    PRINTED,
    SINCE,
    SIZED,
    VARIANTS,
    WITHIN,
    follow,
    virtual_sensors,
)
from fusion_sfdia.benchmarks.engine.virtual_sensors import sensor_rows
from fusion_sfdia.models.marine_engine.published import PublishedOffset
from fusion_sfdia.report.results import Row
from fusion_sfdia.study.experiments.scenario import Arrays
from fusion_sfdia.study.scenarios import scenario

NAME = "engine/virtual-sensors"


def value(rows: list[Row], **expected: str) -> float:
    (found,) = [r for r in rows if all(getattr(r, k) == v for k, v in expected.items())]
    return found.value


@pytest.mark.long
def test_intervals_contain_the_faults_and_narrow_when_intersected() -> None:
    found = smallest(NAME).summary
    assert len(found.figures) == 3
    rows = list(found.rows)
    assert not any(r.published for r in rows if r.metric == "fault_mape_percent")  # those are of 100 s
    for n in SIZED:
        for kind in (*VARIANTS, *INVERSIONS):
            assert value(rows, quantity=n, condition=kind, metric="interval_coverage") == 1
    mape = {v: value(rows, quantity="M(2,3)", condition=v, metric="fault_mape_percent") for v in VARIANTS}
    assert mape[INTERSECTED] < mape[PRINTED] and mape[GUARANTEED] == pytest.approx(mape[INTERSECTED])
    widths = [value(rows, quantity="M(2,3)", condition=i, metric="fault_interval_percent") for i in INVERSIONS]
    assert widths[0] <= widths[1]


def short(variant: str) -> tuple[Arrays, list[PublishedOffset]]:
    """Three runs with larger faults, early: 3 s."""
    faults = [PublishedOffset(f.sensor, f.onset / 50, 5 * f.magnitude) for f in FAULTS[:1]] + [FAULTS[2]._replace(onset=1.0)]
    detector = virtual_sensors(0.03, variant, "corners")
    healthy = recording(0.03, 300, (0, 1, 2))
    y = offsets(detector.plant, healthy.t, healthy.y, faults)
    return follow(detector, healthy.t, y, healthy.u, healthy.signal, faults, (2.0, 2.0)), faults


def test_the_arrays_of_a_run() -> None:
    found, faults = short(GUARANTEED)
    own = [NAMES.index("M(2,3)"), NAMES.index("M(4,2)")]
    np.testing.assert_allclose(found["first"][:, own], [[0.2, 1.0]] * 3, rtol=1e-12)
    assert np.isinf(np.delete(found["first"], own, axis=-1)).all()
    np.testing.assert_array_equal(found["inside"], found["isolated"])
    np.testing.assert_array_equal(found["isolated"], [[281, 201]] * 3)  # samples from 0.2 and 1.0 to 3.0 s
    time, size, low, high = found["trace"]
    assert time.shape == (3, round(3.0 / KEPT), 10)
    for i, (column, fault) in enumerate(zip(own, faults, strict=True)):
        late = time[0, :, column] >= 2.0
        sampled = 100 * np.abs(size[:, late, column] / fault.magnitude - 1).mean(axis=-1)
        # a sample every KEPT s of an estimate that changes seldom, by less than a tenth of itself
        np.testing.assert_allclose(found["mape"][:, i], sampled, rtol=0.1, atol=0.01)
        known = np.isfinite(low[..., column])
        assert np.all(((low <= fault.magnitude) & (fault.magnitude <= high))[..., column][known]) and known[:, late].all()
        last = (high - low)[:, -1, column] / fault.magnitude
        np.testing.assert_allclose(found["width"][:, i], last, rtol=1e-3)  # of two numbers in single precision
        inside = np.abs(size[:, :, column] / fault.magnitude - 1) <= WITHIN  # of a sample every KEPT s, so within 0.1 s
        since = [0 if i.all() else np.flatnonzero(~i)[-1] + 1 for i in inside]
        ends = [time[0, k, column] if k < i.size else np.inf for k, i in zip(since, inside, strict=True)]
        np.testing.assert_allclose(found["settled"][:, i] + found["first"][:, column], ends, atol=KEPT + 1e-6)
    assert np.all(found["square"] < found["square_faulty"])


def test_an_undetected_fault_counts_as_an_error_of_100_percent() -> None:
    detector = virtual_sensors(0.03, GUARANTEED, "corners")
    healthy = recording(0.03, 40, (0, 1, 2))
    unseen = [PublishedOffset("S(2){3}", 0.1, 1.0)]
    y = offsets(detector.plant, healthy.t, healthy.y, unseen)
    found = follow(detector, healthy.t, y, healthy.u, healthy.signal, unseen, (0.2,))
    assert np.isinf(found["first"]).all() and found["mape"].tolist() == [[100.0]] * 3
    assert np.isnan(found["rise"]).all() and np.isinf(found["settled"]).all() and not found["isolated"].any()


def test_impossible_settings_are_refused() -> None:
    one = scenario(NAME)
    with pytest.raises(ValueError, match=r"duration is 41\.0 s; expected more than 41"):
        one.tasks({**one.settings, "duration": 41.0}, 1)
    with pytest.raises(ValueError, match="inversion_seeds is -1; expected 0 or more"):
        one.tasks({**one.settings, "inversion_seeds": -1}, 1)
    with pytest.raises(ValueError, match="expected a share of the nominal values"):
        one.tasks({**one.settings, "noise": 0.0}, 1)
    assert len(one.tasks({**one.settings, "inversion_seeds": 0}, 1)) == 1 + len(VARIANTS)


def test_published_numbers() -> None:
    assert (MAPE, SINCE) == ((8.76, 0.26, 3.74), (40.0, 20.0, 20.0))
    assert [tuple(f) for f in FAULTS] == [("S(2){3}", 10.0, 5e3), ("S(3){1}", 10.0, 5e4), ("S(4){2}", 20.0, 100.0)]
    assert LEARNING_RATES == {"fuel": 0.5, "p_receiver": 8.7, "p_charge": 5.0}
    nothing = {name: np.zeros((2, 3)) for name in ("mape", "inside", "width", "square", "square_faulty", "rise")}
    found = {**nothing, "first": np.full((2, 10), 10.5), "isolated": np.ones((2, 3)), "settled": np.full((2, 3), 20.0)}
    times = ("isolation_delay", "identification_time")
    rows = {(r.quantity, r.metric): r for r in sensor_rows({INTERSECTED: found}, 100.0) if r.metric in times}
    assert {k: (r.value, r.published) for k, r in rows.items() if r.published} == {
        ("M(2,3)", "isolation_delay"): (0.5, 10.0),
        ("M(2,3)", "identification_time"): (20.0, 30.0),
        ("M(3,1)", "identification_time"): (0.0, 10.0),
    }
    assert [r.agrees for r in rows.values() if r.metric == "identification_time"] == [True, True]  # upper bounds
    assert not any(r.published for r in sensor_rows({INTERSECTED: found}, 50.0))
