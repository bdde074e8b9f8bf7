"""One contract for every registered detector on every registered plant: a new one joins by registering."""

from __future__ import annotations

import pickle
import re
from collections.abc import Iterator
from dataclasses import fields, replace
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import betabinom, binom
from toy_plants import Array, chain

from fusion_sfdia import registry
from fusion_sfdia.builders import CALIBRATION_SEEDS, CALIBRATION_STEPS, WARM_UP
from fusion_sfdia.core.detector import Decision, Detector, run
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.core.state import State, leaves, mapped, names
from fusion_sfdia.core.storage import load_state, save_state
from fusion_sfdia.data_driven.ewma_limits import EwmaLimits
from fusion_sfdia.data_driven.fixed_limits import FixedLimits
from fusion_sfdia.data_driven.one_class import OneClass
from fusion_sfdia.data_driven.pca import PrincipalComponents
from fusion_sfdia.detectors import FALSE_ALARM
from fusion_sfdia.evaluation.simulate import simulate
from fusion_sfdia.kalman_banks.fusing_bank import FusingBank
from fusion_sfdia.structural_residuals.structural_residuals import StructuralResiduals

TOYS = ("chain", "two-tanks")
WITH_MODULES = {"marine-engine", "two-tanks"}
OF_INPUTS = ("uio",)  # not applicable to the chain, which has none
OF_MODULES = ("adaptive-threshold:", "virtual-sensors", "structural-residuals")
WITHOUT = {"structural-residuals"} if find_spec("faultdiagnosistoolbox") is None else set()  # an optional package
SLOW = {("gas-pipeline", "fusing-ukf"), ("gas-pipeline", "fusing-enkf")}  # several seconds of calibration
SLOW |= {("power-network", f"fusing-{kind}") for kind in ("ekf", "ukf", "enkf")}

# Faults of 30 sigma that a method misses, by quantity. Shaheen 2024, (20), adds MPa to kg/s, so the extended filter's bank
# sees a pressure fault but blames another sensor; the printed unscented update leaves the process noise out of its gain,
# which dies away with the covariance that the mixture divides by the number of sensors: it follows no reading any more. On
# the engine the sum is of kg, MPa, K and N m, and S(4){2} reads what depends on no state: no filter differs without it.
# In the power network a valve moves by 1/R = 12 to 20 times what the speed does: by the sum the fault of an angle is a
# valve's, and one Kalman filter, which takes on 0.9 of a wrong speed at once, blames valve and turbine from then on. An
# ensemble of 40 has no covariance of 60 states. Fixed limits are as wide as the operation moves the readings, on the pipeline
# by 465 sigma of pressure and 60 of mass flow: what stays within them shows by its onset alone, of a moving average too. On the
# network the statistic of a one-class machine, of all 94 readings, hides what is 30 sigma of one reading and 7 to 9 of what the
# others leave open of it; the contributions of single readings in pca do not.
# The network's own disturbances move a reading by several sigma in a step and by tens in the end, under its controllers too:
# what learns its thresholds from such recordings, the printed unscented bank too, finds no bias of 30 sigma in most of them.
# Structural residuals: all that read the receiver's pressure but one read the torque, too, and that one, of the turbine's
# temperature, shows an eighth of the fault, hardly its limit: without it either sensor alone explains the alarms.
# Without trust in the inputs of an area a wrong reading of its valve is a wrong reference or load, which it shows best.
MISSED = {
    ("power-network", "uio"): {"valve"},
    ("gas-pipeline", "fusing-ekf"): {"pressure"},
    ("gas-pipeline", "fusing-ukf"): {"pressure", "mass flow", "temperature"},
    ("marine-engine", "fusing-ekf"): {"fuel", "temperature", "torque"},
    ("marine-engine", "fusing-enkf"): {"temperature"},
    ("power-network", "fusing-ekf"): {"angle"},
    ("power-network", "fusing-ukf"): {"angle", "speed", "mechanical power", "valve"},
    ("power-network", "fusing-enkf"): {"angle", "speed", "mechanical power", "valve"},
    ("power-network", "limits"): {"angle", "mechanical power", "valve"},
    ("power-network", "limits-ewma"): {"angle", "mechanical power", "valve"},
    ("power-network", "kf-chi2"): {"speed"},
    ("power-network", "one-class"): {"speed", "mechanical power", "valve"},
    ("gas-pipeline", "limits"): {"pressure", "mass flow"},
    ("gas-pipeline", "limits-ewma"): {"pressure", "mass flow"},
    ("marine-engine", "structural-residuals"): {"pressure"},
}
FITTED = (FusingBank, FixedLimits, EwmaLimits, PrincipalComponents, OneClass, StructuralResiduals)  # limits from healthy data
NAMELESS = {"chebyshev:corrected", "chebyshev:paper"}  # as published it tells that there is a fault, not of which sensor
FLAGS = {"isolated", "diverged", "guarded", "capped", "absurd", "absurd_input"}
SETTLED = 20  # samples in which the filters forget their initial covariance
LATER = {("power-network", "dynamic-pca"): 40}  # more of them: it learns from a network whose disturbances have built up


def plants() -> tuple[str, ...]:
    return ("chain", *registry.plants())


@cache
def plant_of(name: str) -> Plant:
    if name == "chain":
        plant = chain(6)
        return replace(plant, sensors=tuple(replace(s, quantity="level") for s in plant.sensors))
    return registry.plant(name)


@cache
def detector_of(plant: str, name: str) -> Detector:
    return registry.detector(name, plant_of(plant))


def pairs() -> Iterator[object]:
    for plant in plants():
        for name in registry.detectors():
            if name.startswith(OF_MODULES) and plant not in WITH_MODULES:
                continue  # it has no scalar equations to monitor, see the test that says so
            if name in OF_INPUTS and plant == "chain":
                continue
            marks = [pytest.mark.slow] if (plant, name) in SLOW else []
            marks += [pytest.mark.skip(reason="needs faultdiagnosistoolbox")] if name in WITHOUT else []
            yield pytest.param((plant, name), id=f"{plant}/{name}", marks=marks)


every_pair = pytest.mark.parametrize("pair", list(pairs()))


@cache
def healthy(plant: str, steps: int, runs: int) -> tuple[Array, Array, Array]:
    """Times (K,), healthy readings (K, B, N), inputs (K, B, m); not to be written to."""
    recording = simulate(plant_of(plant), steps, range(50, 50 + runs))
    recording.y.flags.writeable = False
    return recording.t, recording.y, recording.u_of_runs


def assert_same_bits(a: Decision, b: Decision) -> None:
    for f in fields(Decision):
        np.testing.assert_array_equal(getattr(a, f.name), getattr(b, f.name), err_msg=f.name)


def assert_same_state(a: State, b: State) -> None:
    assert names(a) == names(b)
    for one, other in zip(leaves(a), leaves(b), strict=True):
        np.testing.assert_array_equal(one, other)
        assert np.asarray(one).dtype == np.asarray(other).dtype


@every_pair
@pytest.mark.parametrize("batch", [(), (2,)], ids=["single", "batch"])
def test_shapes_and_types(pair: tuple[str, str], batch: tuple[int, ...]) -> None:
    detector, plant = detector_of(*pair), plant_of(pair[0])
    n, count, names = len(plant.states), len(plant.sensors), detector.hypotheses
    assert isinstance(detector, Detector) and names[:count] == plant.sensor_names and len(set(names)) == len(names)
    t, y, u = healthy(pair[0], 3, 2)
    state = detector.init(batch)
    assert isinstance(state, State) and all(isinstance(a, np.ndarray) and a.dtype != object for a in leaves(state))
    for k in range(3):
        state, d = detector.step(state, float(t[k]), y[k] if batch else y[k, 0], u[k] if batch else u[k, 0])
    expected = {
        "estimate": (n,), "reconstruction": (count,), "residual": (count,), "threshold": (count,), "isolated": (len(names),),
        "fault_size": (len(names),), "diverged": (), "guarded": (), "nis": (), "capped": (), "absurd": (count,),
        "absurd_input": (len(plant.inputs),),
    }  # fmt: skip
    for name, shape in expected.items():
        value = np.asarray(getattr(d, name))
        assert value.shape == (*batch, *shape), name
        assert value.dtype == (bool if name in FLAGS else float), name
    assert d.covariance is None or d.covariance.shape == (*batch, n, n)
    assert d.scores.shape == (*batch, count) and d.score.shape == d.alarm.shape == batch and d.alarm.dtype == bool
    assert np.all(d.threshold > 0) and np.all(np.isfinite(d.estimate))
    np.testing.assert_array_equal(np.isnan(d.fault_size), ~d.isolated)


@every_pair
def test_the_same_seed_gives_the_same_bits_and_a_state_is_left_as_it_was(pair: tuple[str, str]) -> None:
    detector = detector_of(*pair)
    t, y, u = healthy(pair[0], 8, 2)
    first = detector.init((2,), seed=11)
    before = mapped(np.array, first)
    end, decisions = run(detector, first, t, y, u)
    assert_same_state(first, before)
    again, repeated = run(detector, detector.init((2,), seed=11), t, y, u)
    assert_same_bits(decisions, repeated)
    assert_same_state(end, again)


@every_pair
def test_step_by_step_a_run_and_a_batch_of_one_are_the_same_bits(pair: tuple[str, str]) -> None:
    detector = detector_of(*pair)
    t, y, u = healthy(pair[0], 10, 1)
    y = y.copy()
    y[6:, 0, 0] += 30 * plant_of(pair[0]).sensor_sigma[0]
    y[8, 0, 1] = np.nan
    batch, batch_of_one = run(detector, detector.init((1,)), t, y, u, covariance=True)
    _, whole = run(detector, detector.init(), t, y[:, 0], u[:, 0], covariance=True)
    state = detector.init()
    for k in range(10):
        state, d = detector.step(state, float(t[k]), y[k, 0], u[k, 0])
        for f in fields(Decision):
            value = getattr(d, f.name)
            if value is not None:
                np.testing.assert_array_equal(getattr(whole, f.name)[k], value, err_msg=f.name)
                np.testing.assert_array_equal(getattr(batch_of_one, f.name)[k, 0], value, err_msg=f.name)
    for alone, one in zip(leaves(state), leaves(batch), strict=True):
        np.testing.assert_array_equal(np.ravel(alone), np.ravel(one))


@every_pair
def test_an_input_may_be_shared_by_the_batch(pair: tuple[str, str]) -> None:
    detector = detector_of(*pair)
    t, y, u = healthy(pair[0], 5, 3)
    _, shared = run(detector, detector.init((3,)), t, y, u[:, 0])
    _, each = run(detector, detector.init((3,)), t, y, np.repeat(u[:, :1], 3, axis=1))
    assert_same_bits(shared, each)


@every_pair
def test_silence_when_healthy(pair: tuple[str, str]) -> None:
    detector = detector_of(*pair)
    runs = 20 if pair[0] in TOYS else 3
    settled = SETTLED + LATER.get(pair, 0)
    t, y, u = healthy(pair[0], settled + 100, runs)
    _, d = run(detector, detector.init((runs,)), t, y, u)
    assert not d.diverged.any()
    if pair[1] in NAMELESS:  # its claim, of each sensor by itself: Chebyshev's inequality for 2 standard deviations
        assert np.all(np.mean(d.scores[settled:] > 1, axis=(0, 1)) < 1 / 4)
        return
    alarm = d.alarm[settled:]
    begun = np.sum(alarm[1:] & ~alarm[:-1]) + np.sum(alarm[0])  # an alarm is held until readmission: its beginnings count
    # In each step an alarm begins with a probability of at most FALSE_ALARM. Where it is exact, their number is binomial. A
    # threshold that is an order statistic of M samples has a rate of its own, Beta(FALSE_ALARM M, M) distributed about that
    # probability; neighbouring samples correlate, so that M counts by half.
    law = binom(alarm.size, FALSE_ALARM)
    if isinstance(detector, FITTED):
        samples = len(CALIBRATION_SEEDS) * (CALIBRATION_STEPS - WARM_UP) / 2
        law = betabinom(alarm.size, FALSE_ALARM * samples, (1 - FALSE_ALARM) * samples)
    assert begun <= law.ppf(0.999)


@pytest.mark.parametrize("name", registry.detectors())
def test_a_state_has_named_and_documented_fields_and_the_time_of_the_last_reading(name: str, tmp_path: Path) -> None:
    if name in WITHOUT:
        pytest.skip("needs faultdiagnosistoolbox")
    detector = detector_of("two-tanks", name)
    t, y, u = healthy("two-tanks", 4, 2)
    state = detector.init((2,), t=float(t[0]) - detector.plant.dt)
    assert state.t == float(t[0]) - detector.plant.dt and state.steps == 0
    for k in range(4):
        state, _ = detector.step(state, float(t[k]), y[k], u[k])
        assert isinstance(state, State) and state.t == t[k] and state.steps == k + 1
    for nested in tuples(state):
        documented = nested.__doc__ or ""
        assert not documented.startswith(f"{type(nested).__name__}("), f"{type(nested).__name__} has no docstring of its own"
        assert not any(re.fullmatch(r"_\d+", field) for field in nested._fields)
    save_state(tmp_path / "state.npz", detector, state)
    loaded = load_state(tmp_path / "state.npz", detector)
    assert_same_state(loaded, state)
    assert [type(a) for a in tuples(loaded)] == [type(a) for a in tuples(state)]
    assert_same_state(pickle.loads(pickle.dumps(state)), state)


def tuples(state: Any) -> list[Any]:
    """The named tuples in a state, itself first."""
    own = [state] if hasattr(state, "_fields") else []
    return own + [found for value in state if isinstance(value, tuple) for found in tuples(value)]


@every_pair
def test_thresholds_scale(pair: tuple[str, str]) -> None:
    detector = detector_of(*pair)
    t, y, u = healthy(pair[0], 5, 2)
    twice = replace(detector, threshold_scale=2.0)
    _, a = run(detector, detector.init((2,)), t, y, u)
    _, b = run(twice, twice.init((2,)), t, y, u)
    quiet = ~np.any(a.alarm, axis=0)  # what is left out after an alarm changes the numbers that follow
    # a few roundings; where a detector shows the worse of two residuals it may show the other at a tie
    np.testing.assert_allclose(b.threshold[:, quiet], 2 * a.threshold[:, quiet], rtol=1e-12)
    with pytest.raises(ValueError, match="threshold_scale is 0"):
        replace(detector, threshold_scale=0)


@every_pair
def test_a_state_knows_no_threshold_until_the_first_alarm(pair: tuple[str, str]) -> None:
    """So that a run may be watched without thresholds and go on with them."""
    detector = detector_of(*pair)
    runs = 6
    t, y, u = healthy(pair[0], 30, runs)

    def end(scale: float) -> tuple[list[Array], Array]:
        scaled = replace(detector, threshold_scale=scale * detector.threshold_scale)
        state, decisions = run(scaled, scaled.init((runs,)), t, y, u)
        return leaves((state.diverged, state.memory)), decisions.alarm.any(axis=0)

    beyond_reach, alarmed = end(1e6)
    assert not alarmed.any()
    for scale in (1e7, 1.0):
        state, alarmed = end(scale)
        assert scale == 1.0 or not alarmed.any()
        for one, other in zip(state, beyond_reach, strict=True):
            np.testing.assert_array_equal(one[~alarmed], other[~alarmed])


@every_pair
def test_decisions_do_not_change_with_the_unit_of_a_quantity_read(pair: tuple[str, str]) -> None:
    """Of the sensors. The paper's residual (20) depends on the units of the states: test_fusing_bank holds that."""
    plant, detector = plant_of(pair[0]), detector_of(*pair)
    chosen = next(iter(plant.quantities.values()))
    factor = np.ones(len(plant.sensors))
    factor[chosen] = 1e-5  # Pa as bar
    units = {plant.sensors[i].name: ("other", 1e-5) for i in chosen}
    if isinstance(detector, FusingBank):  # test_fusing_bank_thresholds holds that its thresholds follow the unit
        other: Detector = replace(
            detector, plant=detector.plant.in_units(units), thresholds=tuple(np.array(detector.thresholds) * factor)
        )
    else:
        other = registry.detector(pair[1], plant.in_units(units))
    t, y, u = healthy(pair[0], 60, 2)
    y = y.copy()
    y[35:55, 0, chosen[0]] += 30 * plant.sensor_sigma[chosen[0]]
    _, a = run(detector, detector.init((2,)), t, y, u)
    _, b = run(other, other.init((2,)), t, y * factor, u)
    assert a.alarm.any() or pair in MISSED
    np.testing.assert_array_equal(a.isolated, b.isolated)
    np.testing.assert_array_equal(a.alarm, b.alarm)
    # 50 roundings of values of 100 sigma, which sigma points with alpha = 1e-3 magnify by 1e6
    tolerance = 50 * np.finfo(float).eps * 1e2 * 1e6
    for name in ("reconstruction", "residual", "threshold", "fault_size"):
        one, two = getattr(a, name) / plant.sensor_sigma, getattr(b, name) / factor / plant.sensor_sigma
        np.testing.assert_allclose(one, two, rtol=tolerance, atol=tolerance, err_msg=name)


@every_pair
def test_a_large_bias_raises_an_alarm_and_has_the_right_name(pair: tuple[str, str]) -> None:
    detector, plant = detector_of(*pair), plant_of(pair[0])
    chosen = {quantity: int(members[members.size // 2]) for quantity, members in plant.quantities.items()}
    onset = 35 + LATER.get(pair, 0)
    t, y, u = healthy(pair[0], onset + 25, len(chosen))
    y = y.copy()
    for run_index, i in enumerate(chosen.values()):  # one run for each quantity
        y[onset : onset + 20, run_index, i] += 30 * plant.sensor_sigma[i]
    _, d = run(detector, detector.init((len(chosen),)), t, y, u)
    missed = set()
    for run_index, (quantity, i) in enumerate(chosen.items()):
        during = d.isolated[onset : onset + 20, run_index]
        if np.mean(during[:, i]) < 0.9:
            missed.add(quantity)
            continue
        assert during[0, i] and np.all(d.alarm[onset : onset + 20, run_index][during[:, i]])
        if pair[1].startswith("adaptive-threshold"):
            continue  # its diagnosis sets hold every sensor whose fault would explain the decisions
        # at most two of the twenty samples name another sensor, too
        assert np.sum(np.any(np.delete(during, i, axis=-1), axis=-1)) <= 2
        size = d.fault_size[onset, run_index, i] / plant.sensor_sigma[i]
        # reading less what the others say: 30 with the noise of a reading and of its estimate, at most sqrt(2) together
        assert size == pytest.approx(30.0, abs=4 * np.sqrt(2))
    assert missed == (set(chosen) if pair[1] in NAMELESS else MISSED.get(pair, set()))


@every_pair
def test_missing_readings_neither_raise_nor_alarm_nor_poison(pair: tuple[str, str]) -> None:
    detector, plant = detector_of(*pair), plant_of(pair[0])
    t, y, u = healthy(pair[0], 40, 2)
    gone = np.random.default_rng(1).random(y.shape) < 0.3
    gone[0] = True  # before anything was read
    gone[20:24] = True
    gone[30:34, 0, 1:] = True  # one sensor left
    gone[30:34, 1, next(iter(plant.quantities.values()))] = True  # a whole quantity
    y = np.where(gone, np.nan, y)
    _, d = run(detector, detector.init((2,)), t, y, u)
    assert not d.diverged.any() and np.all(np.isfinite(d.estimate)) and np.all(np.isfinite(d.reconstruction))
    assert not d.isolated[..., : gone.shape[-1]][gone].any()
    assert np.all(np.isnan(d.residual[gone])) and np.all(d.scores[gone] == 0)
    assert not d.alarm[np.all(gone, axis=-1)].any()
    np.testing.assert_array_equal(
        d.reconstruction[~gone & ~d.isolated[..., : gone.shape[-1]]], y[~gone & ~d.isolated[..., : gone.shape[-1]]]
    )


@every_pair
def test_absurd_readings_are_missing_ones_and_absurd_inputs_the_usual_ones(pair: tuple[str, str]) -> None:
    detector, plant = detector_of(*pair), plant_of(pair[0])
    values = 1e303, -1e303, 1e308, -1e308, 1e160, -1e160, 1e30, -1e30
    t, y, u = healthy(pair[0], SETTLED + 6, len(values))
    bad_y, gone = y.copy(), y.copy()
    bad_u, usual = u.copy(), u.copy()
    for b, value in enumerate(values):  # one run for each
        i = b * len(plant.sensors) // len(values)
        bad_y[SETTLED, b, i], gone[SETTLED, b, i] = value, np.nan
        if plant.inputs:  # of all inputs in turn, two steps later
            j = b * len(plant.inputs) // len(values)
            bad_u[SETTLED + 2, b, j], usual[SETTLED + 2, b, j] = value, plant.input_at(float(t[SETTLED + 1]))[j]
    _, d = run(detector, detector.init((len(values),)), t, bad_y, bad_u)
    _, expected = run(detector, detector.init((len(values),)), t, gone, usual)
    assert not d.diverged.any() and np.all(np.isfinite(d.estimate)) and np.all(np.isfinite(d.reconstruction))
    np.testing.assert_array_equal(d.absurd, np.isnan(gone))
    np.testing.assert_array_equal(d.absurd_input, bad_u != u)
    assert not expected.absurd.any() and not expected.absurd_input.any()
    assert_same_bits(replace(d, absurd=expected.absurd, absurd_input=expected.absurd_input), expected)


@every_pair
def test_a_sensor_that_was_silent_comes_back_trusted(pair: tuple[str, str]) -> None:
    detector, plant = detector_of(*pair), plant_of(pair[0])
    t, y, u = healthy(pair[0], 50, 2)
    y = y.copy()
    i = len(plant.sensors) // 2
    y[SETTLED:40, :, i] = np.nan
    _, d = run(detector, detector.init((2,)), t, y, u)
    assert np.all(np.isfinite(d.estimate)) and not d.isolated[SETTLED:, :, i].any()
    assert np.all(np.isfinite(d.residual[40:, :, i]))
    np.testing.assert_array_equal(d.reconstruction[40:, :, i], y[40:, :, i])


@every_pair
@pytest.mark.parametrize("batch", [(), (2,)], ids=["single", "batch"])
def test_a_saved_state_goes_on_with_the_same_bits(pair: tuple[str, str], batch: tuple[int, ...], tmp_path: Path) -> None:
    detector, plant = detector_of(*pair), plant_of(pair[0])
    t, y, u = healthy(pair[0], 14, 2)
    y = y.copy()
    y[6:, 0, 1] += 30 * plant.sensor_sigma[1]  # saved with a sensor left out
    y[7, :, 0] = np.nan
    y, u = (y, u) if batch else (y[:, 0], u[:, 0])
    middle, _ = run(detector, detector.init(batch, seed=5), t[:8], y[:8], u[:8])
    save_state(tmp_path / "state.npz", detector, middle)
    loaded = load_state(tmp_path / "state.npz", detector)
    assert_same_state(loaded, middle)
    end, went_on = run(detector, middle, t[8:], y[8:], u[8:], covariance=True)
    resumed_end, resumed = run(detector, loaded, t[8:], y[8:], u[8:], covariance=True)
    assert_same_bits(went_on, resumed)
    assert_same_state(end, resumed_end)


@every_pair
def test_a_pickled_detector_goes_on_with_the_same_bits(pair: tuple[str, str]) -> None:
    """So that pools of processes can take it, also after it was used: what it keeps of its own has to go with it."""
    detector = detector_of(*pair)
    t, y, u = healthy(pair[0], 8, 2)
    middle, _ = run(detector, detector.init((2,), seed=5), t[:4], y[:4], u[:4])
    copy, state = pickle.loads(pickle.dumps((detector, middle)))
    end, went_on = run(detector, middle, t[4:], y[4:], u[4:])
    copied_end, copied = run(copy, state, t[4:], y[4:], u[4:])
    assert_same_bits(went_on, copied)
    assert_same_state(end, copied_end)


@every_pair
def test_wrong_readings_inputs_and_times_are_named(pair: tuple[str, str]) -> None:
    detector, plant = detector_of(*pair), plant_of(pair[0])
    times, ys, us = healthy(pair[0], 2, 1)
    t, y, u = float(times[0]), ys[0, 0], us[0, 0]
    state = detector.init()
    inf = np.where(np.arange(y.size) == 0, np.inf, y)
    for bad_y, message in (
        (y[:-1], f"expected .{y.size},."), (np.append(y, 0.0), "y has shape"), (y[None], "y has shape"), (inf, "infinite"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=message):
            detector.step(state, t, bad_y, u)
    with pytest.raises(ValueError, match=f"has {len(plant.inputs)} inputs"):
        detector.step(state, t, y, np.append(u, 0.0))
    with pytest.raises(ValueError, match="does not broadcast"):
        detector.step(state, t, y, np.stack([u, u]))
    if u.size:
        with pytest.raises(ValueError, match="an input must be known"):
            detector.step(state, t, y, np.full_like(u, np.nan))
    for bad_t in (0.0, -plant.dt, np.nan, np.inf):
        with pytest.raises(ValueError, match="times must be finite and increase"):
            detector.step(state, bad_t, y, u)
    with pytest.raises(ValueError, match="y has shape"):
        detector.step(detector.init((2,)), t, y, u)
