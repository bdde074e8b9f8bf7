"""Virtual sensors: intervals that contain the fault, empty intervals, adaptive observers, readings for other modules."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from toy_plants import changed, readings, tanks

from fusion_sfdia.derivatives.intervals.interval import Interval
from fusion_sfdia.detectors.adaptive_thresholds.adaptive_threshold import AdaptiveThreshold
from fusion_sfdia.detectors.adaptive_thresholds.virtual_sensors import VirtualSensors
from fusion_sfdia.detectors.detector import Decision, run, stack
from fusion_sfdia.detectors.state import State
from fusion_sfdia.diagnosis.simulate import Recording, simulate
from fusion_sfdia.models.marine_engine.plant import marine_engine

Array = NDArray[Any]

ENGINE = marine_engine()
DETECTOR = VirtualSensors(ENGINE)
NOMINAL = np.array([ENGINE.structure.modules.nominal[s.measures] for s in ENGINE.sensors])  # type: ignore[union-attr]
TORQUE, RECEIVER, CHARGE = (ENGINE.sensor_index(name) for name in ("S(2){3}", "S(3){1}", "S(4){2}"))
RATES = {"fuel": 0.5, "p_receiver": 8.7, "p_charge": 5.0}


@cache
def healthy(steps: int, runs: int) -> Recording:
    return simulate(ENGINE, steps, range(runs), truth="model")


def watch(detector: VirtualSensors, recording: Recording, y: Array) -> tuple[State, Decision, Interval]:
    """The last state, the decisions and the faults' intervals (K, B, N)."""
    state, decided, low, high = detector.init((y.shape[1],)), [], [], []
    for k, t in enumerate(recording.t):
        state, decision = detector.step(state, float(t), y[k], recording.u[k])
        found = detector.fault_interval(state)
        decided.append(decision)
        low.append(found.lo)
        high.append(found.hi)
    return state, stack(decided), Interval.unchecked(np.stack(low), np.stack(high))


def with_offsets(recording: Recording, start: int, faults: dict[int, float | Array]) -> Array:
    y = recording.y.copy()
    for sensor, size in faults.items():
        y[start:, :, sensor] += size
    return y


def test_the_interval_contains_the_fault_and_only_narrows() -> None:
    """Random sensors and sizes; without guarantee for a sensor that is isolated falsely instead of the faulty one."""
    rng = np.random.default_rng(4)
    runs, start = 60, 20
    recording = healthy(120, runs)
    sensor = rng.integers(0, 10, runs)
    size = rng.choice([-1.0, 1.0], runs) * rng.uniform(0.3, 0.9, runs) * NOMINAL[sensor]
    everyone = np.arange(runs)
    y = recording.y.copy()
    y[start:, everyone, sensor] += size
    _, decision, interval = watch(DETECTOR, recording, y)
    assert not decision.isolated[:start].any()
    truth = np.zeros((runs, 10), bool)
    truth[everyone, sensor] = True
    right = (decision.isolated[-1] == truth).all(axis=-1)
    assert right.sum() > 0.9 * runs  # a third of the torque is less than its module's threshold: noise must help
    low, high = (end[start:, everyone[right], sensor[right]] for end in (interval.lo, interval.hi))
    assert np.all((low <= size[right]) & (size[right] <= high))
    assert np.all(low[1:] >= low[:-1]) and np.all(high[1:] <= high[:-1])
    found = decision.fault_size[-1, everyone[right], sensor[right]]
    np.testing.assert_array_equal(found, (low[-1] + high[-1]) / 2)


def test_two_simultaneous_faults_are_contained_and_the_first_interval_restarts() -> None:
    """An interval that depends on a sensor isolated later is reset: the effect of the faulty torque does not stay."""
    recording = healthy(200, 20)
    faults = {RECEIVER: 1.5e5, TORQUE: -3.8e4}
    y = with_offsets(recording, 20, {RECEIVER: 1.5e5})
    y[60:, :, TORQUE] += faults[TORQUE]
    _, decision, interval = watch(DETECTOR, recording, y)
    named = np.isin(np.arange(10), list(faults))
    right = (decision.isolated[-1] == named).all(axis=-1)
    assert right.sum() >= 18
    for i, size in faults.items():
        low, high = interval.lo[-1, right, i], interval.hi[-1, right, i]
        assert np.all((low <= size) & (size <= high)) and np.all(np.isfinite(high - low))
    width = interval.hi[..., RECEIVER] - interval.lo[..., RECEIVER]
    second = np.argmax(decision.isolated[..., TORQUE], axis=0)
    assert np.all(second >= 60) and np.all(np.array([width[k, b] > width[k - 1, b] for b, k in enumerate(second)])[right])


def test_with_reconstructed_readings_other_modules_do_not_fire() -> None:
    """Without them, the modules that read the faulty torque fire, too."""
    recording = healthy(300, 10)
    y = with_offsets(recording, 30, {TORQUE: -3.8e4})
    u = np.broadcast_to(recording.u[:, None], (300, 10, 1))
    _, alone = run(AdaptiveThreshold(ENGINE), AdaptiveThreshold(ENGINE).init((10,)), recording.t, y, u)
    fired = (np.abs(alone.residual) > alone.threshold).any(axis=0)
    assert fired[:, [RECEIVER, TORQUE]].all()
    _, fed, _ = watch(DETECTOR, recording, y)
    np.testing.assert_array_equal(fed.isolated.any(axis=0), np.broadcast_to(np.arange(10) == TORQUE, (10, 10)))
    neighbours = np.delete(fed.scores, TORQUE, axis=-1)
    assert neighbours.max() <= 1
    error = np.abs(fed.reconstruction - recording.signal)[100:, :, TORQUE]
    assert error.max() < 0.6 * 3.8e4  # what is left of the interval and the noise; see the scenario for the usual error


def test_healthy_readings_isolate_no_sensor() -> None:
    recording = healthy(500, 20)
    for detector in (DETECTOR, replace(DETECTOR, learning_rates=RATES, intersect=False)):
        _, decision, interval = watch(detector, recording, recording.y)
        assert not decision.isolated.any() and np.isnan(decision.fault_size).all() and decision.scores.max() <= 1
        assert np.isinf(interval.lo).all() and np.isinf(interval.hi).all()
        np.testing.assert_array_equal(decision.reconstruction, recording.y)


def test_an_empty_intersection_is_no_constant_offset_and_the_sensor_counts_as_missing() -> None:
    """A drift: its reading is then the equation's value, and the neighbours get no reading."""
    recording = healthy(200, 4)
    y = with_offsets(recording, 20, {CHARGE: (50.0 + 0.5 * np.arange(180))[:, None]})
    _, drifting, interval = watch(replace(DETECTOR, learning_rates=RATES), recording, y)
    empty = interval.is_empty[..., CHARGE]
    # it drifts by 90 K, twice the noise bound is 33 K: the last interval and the first have nothing in common
    assert empty[-1].all() and np.all(empty[1:] >= empty[:-1])
    assert drifting.isolated[-1].sum(axis=-1).tolist() == [1] * 4
    gone = with_offsets(recording, 0, {})
    gone[:, :, CHARGE] = np.nan
    _, missing, _ = watch(DETECTOR, recording, gone)
    others = np.delete(np.arange(10), CHARGE)
    # algebraic modules have no memory; modules of states still contain earlier readings
    algebraic = [i for i in others if ENGINE.sensors[i].measures not in ENGINE.structure.modules.states]  # type: ignore[union-attr]
    np.testing.assert_array_equal(drifting.threshold[-1][:, algebraic], missing.threshold[-1][:, algebraic])
    np.testing.assert_array_equal(drifting.reconstruction[-1, :, CHARGE], missing.reconstruction[-1, :, CHARGE])
    np.testing.assert_array_equal(drifting.fault_size[-1, :, CHARGE], drifting.residual[-1, :, CHARGE])


@pytest.mark.parametrize(
    "changes", [{}, {"learning_rates": RATES}, {"intersect": False}], ids=["usual", "adaptive", "memoryless"]
)
def test_a_batch_has_the_bits_of_its_runs(changes: dict[str, Any]) -> None:
    detector = replace(DETECTOR, **changes)
    recording = healthy(80, 6)
    y = with_offsets(recording, 20, {TORQUE: -3.8e4, RECEIVER: 1.5e5})
    y[40:45, 1, TORQUE], y[50, 2], y[60:, 3, ::2] = np.nan, np.nan, np.nan
    _, whole, interval = watch(detector, recording, y)
    for b in range(6):
        _, alone, held = watch(detector, recording, y[:, [b]])
        for f in fields(Decision):
            if getattr(whole, f.name) is not None:
                np.testing.assert_array_equal(getattr(whole, f.name)[:, [b]], getattr(alone, f.name), err_msg=f.name)
        np.testing.assert_array_equal(interval.lo[:, [b]], held.lo)


def test_a_single_run_is_stepped_without_a_batch() -> None:
    recording = healthy(30, 2)
    y = with_offsets(recording, 20, {TORQUE: -4.5e4})
    _, whole, held = watch(DETECTOR, recording, y)
    state = DETECTOR.init()
    for k, t in enumerate(recording.t):
        state, decision = DETECTOR.step(state, float(t), y[k, 1], recording.u[k])
    found = DETECTOR.fault_interval(state)
    assert found.shape == (10,) and decision.isolated[TORQUE]
    np.testing.assert_array_equal([found.lo, found.hi], [held.lo[-1, 1], held.hi[-1, 1]])
    np.testing.assert_array_equal(decision.reconstruction, whole.reconstruction[-1, 1])


def test_results_without_compiled_modules_are_the_same() -> None:
    assert ENGINE.structure.modules is not None
    plain = replace(DETECTOR, plant=changed(ENGINE, modules=replace(ENGINE.structure.modules, monitor=None)))
    recording = healthy(60, 4)
    y = with_offsets(recording, 20, {TORQUE: -3.8e4, RECEIVER: 1.5e5})
    (_, one, a), (_, other, b) = (watch(d, recording, y) for d in (DETECTOR, plain))
    np.testing.assert_array_equal(one.isolated, other.isolated)
    # a hundred operations' rounding a step, as between the two drivers
    np.testing.assert_allclose(a.hi, b.hi, rtol=1e-10)
    np.testing.assert_allclose(one.reconstruction, other.reconstruction, rtol=1e-10)


def test_missing_readings_widen_and_are_replaced() -> None:
    recording = healthy(120, 5)
    y = with_offsets(recording, 20, {TORQUE: -3.8e4})
    y[60:90, :, CHARGE] = np.nan
    y[70:75, :, TORQUE] = np.nan
    y[80] = np.nan
    memoryless = replace(DETECTOR, intersect=False)
    _, decision, interval = watch(memoryless, recording, y)
    width = (interval.hi - interval.lo)[..., TORQUE]
    named = decision.isolated[-1] == (np.arange(10) == TORQUE)
    right = named.all(axis=-1)
    assert right.any() and np.isfinite(decision.reconstruction).all()
    assert np.all(width[60:70, right].min(axis=0) > width[50:60, right].max(axis=0))
    np.testing.assert_array_equal(interval.lo[70:75, :, TORQUE], np.broadcast_to(interval.lo[69, :, TORQUE], (5, 5)))
    _, kept, held = watch(DETECTOR, recording, y)
    low, high = held.lo[25:, right, TORQUE], held.hi[25:, right, TORQUE]
    assert np.all((low <= -3.8e4) & (-3.8e4 <= high)) and not kept.diverged.any()


def test_an_adaptive_observer_sizes_the_fault_of_its_state() -> None:
    recording = healthy(3000, 3)
    y = with_offsets(recording, 20, {RECEIVER: 1.5e5})
    fast = replace(DETECTOR, learning_rates={"p_receiver": 100.0})
    _, decision, interval = watch(fast, recording, y)
    assert decision.isolated[-1].sum(axis=-1).tolist() == [1] * 3
    size = decision.fault_size[-1, :, RECEIVER]
    assert np.all((interval.lo[-1, :, RECEIVER] <= size) & (size <= interval.hi[-1, :, RECEIVER]))
    assert np.all(np.abs(size / 1.5e5 - 1) < 0.1)  # of the noise's 20 kPa a rate of 1 1/s leaves about 1 kPa


def test_set_inversion_encloses_the_corners() -> None:
    recording = healthy(40, 3)
    y = with_offsets(recording, 20, {TORQUE: -4.5e4, CHARGE: 80.0})
    (_, corners, a), (_, sivia, b) = (watch(replace(DETECTOR, inversion=i), recording, y) for i in ("corners", "sivia"))
    np.testing.assert_array_equal(corners.isolated, sivia.isolated)
    assert corners.isolated[-1, :, [TORQUE, CHARGE]].all()
    tolerance = 0.01 * ENGINE.sensors[TORQUE].noise_bound  # up to which boxes are cut
    assert np.all(b.lo[-1, :, TORQUE] <= a.lo[-1, :, TORQUE] + tolerance)
    assert np.all(b.hi[-1, :, TORQUE] >= a.hi[-1, :, TORQUE] - tolerance)
    assert np.all((b.lo[-1, :, TORQUE] <= -4.5e4) & (b.hi[-1, :, TORQUE] >= -4.5e4))


def test_tanks_whose_levels_are_integrals() -> None:
    """rate = 0: an uncorrected observer keeps its estimate, and its bound grows to the envelope."""
    plant = tanks()
    detector = VirtualSensors(plant, envelope=0.4)
    t, _, y, u = readings(replace(plant, process_cov=np.zeros(2), initial_cov=np.full(2, 1e-12)), 100, 5, 1)
    y[30:, :, 0] += 0.8
    state, decision = run(detector, detector.init((5,)), t, y, u)
    assert not decision.isolated[:30].any() and decision.isolated[-1, :, 0].all()
    found = detector.fault_interval(state)
    right = decision.isolated[-1].sum(axis=-1) == 1
    assert right.any() and np.all((found.lo[right, 0] <= 0.8) & (found.hi[right, 0] >= 0.8))


def test_unsuitable_plants_and_settings_are_rejected() -> None:
    with pytest.raises(ValueError, match="inversion is 'newton'; known: corners, sivia"):
        replace(DETECTOR, inversion="newton")
    with pytest.raises(ValueError, match="learning_rates has torque; the states are fuel, p_receiver, p_charge"):
        replace(DETECTOR, learning_rates={"torque": 1.0})
    with pytest.raises(ValueError, match=r"learning rates fuel=-1.0; expected positive numbers in 1/s"):
        replace(DETECTOR, learning_rates={"fuel": -1.0})
    with pytest.raises(ValueError, match="does not state its scalar equations"):
        VirtualSensors(changed(ENGINE, modules=None))
    with pytest.raises(ValueError, match="envelope has nothing"):
        VirtualSensors(ENGINE, envelope={"nothing": (0.0, 1.0)})
    with pytest.raises(ValueError, match="no state of VirtualSensors"):
        DETECTOR.fault_interval(DETECTOR.init()._replace(memory=()))
