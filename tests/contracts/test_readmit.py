"""A sensor that was repaired is used again on request, whatever kept it out; the estimate then follows it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from toy_plants import Array, tanks

from fusion_sfdia import Plant, Sensor, Signal, linear_plant, run, simulate
from fusion_sfdia.detectors import BatchDetector, LeaveOneOutBank, RobustBank, registry
from fusion_sfdia.detectors.state import leaves
from fusion_sfdia.models.two_tanks.plant import two_tanks
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.redundancy import redundancy

FAULT, OUT_UNTIL = 20, 40


def counter() -> Plant:
    """A counter of a flow, which only `total` reads, and the flow itself with two sensors."""
    return linear_plant(
        "counter",
        np.array([[1.0, 1.0], [0.0, 0.9]]),
        np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 1.0]]),
        [Sensor("total", "count", sigma=0.1), Sensor("flow_1", "flow", sigma=0.1), Sensor("flow_2", "flow", sigma=0.1)],
        dt=1.0,
        states=(
            Signal("count", initial_sigma=0.1, process_sigma=0.01),
            Signal("flow", initial_sigma=0.1, process_sigma=0.05),
        ),
    )


@cache
def leaking() -> Log:
    """Readings of the counter: `total` has a bias from sample 20 to 39, while 1 a sample enters uncounted."""
    recording = simulate(counter(), 120, seeds=[1, 2], process_noise=True)
    y = recording.y.copy()
    y[FAULT:OUT_UNTIL, :, 0] += 5.0
    uncounted = np.clip(np.arange(120) - FAULT, 0, OUT_UNTIL - FAULT)
    y[:, :, 0] += uncounted[:, None]
    return Log(recording.t, y, recording.u_of_runs)


@pytest.mark.parametrize("kind", [LeaveOneOutBank, RobustBank])
def test_a_sensor_that_alone_sees_a_lasting_mode_returns_only_on_request(kind: Any) -> None:
    plant, log = counter(), leaking()
    assert redundancy(plant).indispensable == ("total",)
    detector = kind(plant)
    before = log.rows(slice(OUT_UNTIL))
    after = log.rows(slice(OUT_UNTIL, None))
    state, decisions = run(detector, detector.init((2,)), before)
    assert decisions.isolated[-1, :, 0].all()
    _, alone = run(detector, state, after)
    assert alone.isolated[-1, :, 0].all(), "it is not readmitted on its own"
    repaired = detector.readmit(state, "total")
    _, found = run(detector, repaired, after)
    assert not found.isolated[:, :, 0].any()
    off = np.abs(found.estimate[-1, :, 0] - after.y[-1, :, 0])
    assert np.all(off < 5 * plant.sensor_sigma[0]), "the estimate follows the repaired sensor"


def test_readmission_is_undone_by_a_fault_that_is_still_there() -> None:
    plant = tanks()
    detector = LeaveOneOutBank(plant)
    recording = simulate(plant, 80, seeds=[3])
    y = recording.y.copy()
    y[FAULT:, :, 0] += 20 * plant.sensor_sigma[0]
    state, _ = run(detector, detector.init((1,)), recording.t[:40], y[:40], recording.u_of_runs[:40])
    _, found = run(detector, detector.readmit(state, ["l1"]), recording.t[40:], y[40:], recording.u_of_runs[40:])
    assert found.isolated[-1, 0].tolist() == [True, False, False, False]


KEEPING = {"LeaveOneOutBank", "SequentialBank", "MovingHorizon", "UnknownInputFilter", "RobustBank", "Chebyshev"}
LATCHING = ["adaptive-threshold", "virtual-sensors"]


def test_no_detector_that_keeps_sensors_out_is_left_out_here() -> None:
    keeping = {
        type(built).__name__
        for name, entry in registry.detectors().items()
        if not entry.learns and type(built := registry.detector(name, two_tanks()))._readmitted is not BatchDetector._readmitted
    }
    assert keeping == {*KEEPING, "AdaptiveThreshold", "VirtualSensors"}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["loo-glr", "loo-cusum", "mhe-l1", "uio", "robust-glr", "chebyshev", *LATCHING])
def test_every_detector_that_keeps_sensors_out_uses_them_again(name: str) -> None:
    plant = tanks()
    detector: Any = registry.detector(name, plant)
    recording = simulate(plant, 80, seeds=[3])
    y, u = recording.y.copy(), recording.u_of_runs
    i = plant.sensor_index("l2")
    y[FAULT:OUT_UNTIL, :, i] += 50 * plant.sensor_sigma[i]
    t, end = recording.t, OUT_UNTIL
    state, decisions = run(detector, detector.init((1,)), t[:end], y[:end], u[:end])
    assert decisions.isolated[-1, 0, i]
    state, at_once = run(detector, detector.readmit(state, "l2"), t[end : end + 1], y[end : end + 1], u[end : end + 1])
    assert not at_once.isolated.any()
    assert at_once.reconstruction[-1, 0, i] == y[end, 0, i]
    _, later = run(detector, state, t[end + 1 :], y[end + 1 :], u[end + 1 :])
    assert not later.isolated[:, :, i].any()
    if name in LATCHING:
        _, kept = run(detector, detector.init((1,)), t, y, u)
        assert kept.isolated[-1, 0, i], "without it the alarm latches"


def test_nothing_changes_where_no_sensor_is_kept_out() -> None:
    detector: Any = registry.detector("kf-chi2", tanks())
    state = detector.init((2,))
    assert detector.readmit(state, "l1") is not None
    for a, b in zip(leaves(state), leaves(detector.readmit(state, "l1")), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("kind", [LeaveOneOutBank, RobustBank])
def test_a_sensor_in_use_stays_as_it_is(kind: Any) -> None:
    detector = kind(replace(tanks(), name="tanks"))
    log = simulate(detector.plant, 10, seeds=[1])
    state, _ = run(detector, detector.init((1,)), log)
    again = detector.readmit(state, detector.plant.sensor_names)
    same: list[Array] = [getattr(s.memory, "estimate") for s in (state, again)]  # noqa: B009
    for a, b in zip(leaves(same[0]), leaves(same[1]), strict=True):
        np.testing.assert_array_equal(a, b)


def test_an_unknown_sensor_and_a_foreign_state_are_refused() -> None:
    detector = LeaveOneOutBank(tanks())
    with pytest.raises(ValueError, match="unknown sensor 'l9'"):
        detector.readmit(detector.init(), "l9")
    with pytest.raises(ValueError, match="this is no state of LeaveOneOutBank"):
        detector.readmit(LeaveOneOutBank(tanks(), window=3).init(), "l1")
