"""One contract for every registered detector on every registered plant: a new one joins by registering."""

from __future__ import annotations

import pickle
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from optional_packages import REGISTERED, STRUCTURAL
from scipy.stats import betabinom, binom
from toy_plants import Array, chain

from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.data_driven.ewma_limits import EwmaLimits
from fusion_sfdia.detectors.data_driven.fixed_limits import FixedLimits
from fusion_sfdia.detectors.data_driven.one_class import OneClass
from fusion_sfdia.detectors.data_driven.pca import PrincipalComponents
from fusion_sfdia.detectors.detector import Detector, run
from fusion_sfdia.detectors.kalman_banks.fusing_bank import FusingBank
from fusion_sfdia.detectors.named import FALSE_ALARM
from fusion_sfdia.detectors.state import State
from fusion_sfdia.detectors.storage import load_state, save_state
from fusion_sfdia.detectors.structural_residuals.structural_residuals import StructuralResiduals
from fusion_sfdia.diagnosis.simulate import Recording, simulate
from fusion_sfdia.learning import builders
from fusion_sfdia.learning.builders import CALIBRATION_SEEDS, CALIBRATION_STEPS, WARM_UP, healthy_data
from fusion_sfdia.learning.checks.detectors import DETECTOR_CHECKS
from fusion_sfdia.learning.checks.plants import PLANT_CHECKS
from fusion_sfdia.learning.checks.readings import Healthy, healthy_readings
from fusion_sfdia.learning.checks.require import require_same_state
from fusion_sfdia.learning.frozen_model.frozen_bank import FrozenBank
from fusion_sfdia.plant.plant import Plant

TOYS = ("chain", "two-tanks")
WITH_MODULES = {"marine-engine", "two-tanks"}
OF_FEW_SENSORS = (*TOYS, "marine-engine")  # where slow references run: with 63 or 94 filters, a step takes a fifth of a second
OF_INPUTS = ("uio",)  # not applicable to the chain, which has none
OF_MODULES = ("adaptive-threshold:", "virtual-sensors", "structural-residuals")
SLOW = {("gas-pipeline", "fusing-ukf"), ("gas-pipeline", "fusing-enkf")}  # several seconds of calibration
SLOW |= {("power-network", f"fusing-{kind}") for kind in ("ekf", "ukf", "enkf")}
LONG = {("gas-pipeline", "frozen-model"), ("power-network", "frozen-model")}  # a minute each
LONG |= {(plant, f"filterpy-{kind}") for plant in ("chain", "marine-engine") for kind in ("ekf", "ukf")} | {
    ("two-tanks", "filterpy-ukf")
}

# Faults of 30 sigma that a method misses, by quantity. Shaheen 2024, (20), adds MPa to kg/s, so the extended filter's bank
# detects a pressure fault but isolates another sensor.
# In the power network a valve moves by 1/R = 12 to 20 times what the speed does: by the sum the fault of an angle is a
# valve's, and one Kalman filter, which follows a wrong speed by 0.9 in one step, isolates valve and turbine from then on. An
# ensemble of 40 has no covariance of 60 states. Fixed limits are as wide as the operation moves the readings, on the pipeline
# by 465 sigma of pressure and 60 of mass flow: what stays within them shows by its onset alone, of a moving average too. On the
# network the statistic of a one-class machine, of all 94 readings, hides what is 30 sigma of one reading and 7 to 9 of what the
# others leave open of it; the contributions of single readings in pca do not.
# The network's own disturbances move a reading by several sigma in a step and by tens in the end, under its controllers too:
# what learns its thresholds from such recordings, the printed unscented bank too, finds no bias of 30 sigma in most of them.
# Structural residuals: all that read the receiver's pressure but one read the torque, too, and that one, of the turbine's
# temperature, shows an eighth of the fault, hardly its limit: without it either sensor alone explains the alarms.
# Without trust in the inputs of an area a wrong reading of its valve is a wrong reference or load, which it shows best.
LATE = {("two-tanks", "robust-glr"): 4}  # samples in which a change of an outlet explains a flow as well
MISSED = {
    ("power-network", "uio"): {"valve"},
    ("gas-pipeline", "fusing-ekf"): {"pressure"},
    ("power-network", "fusing-ekf"): {"angle"},
    ("power-network", "fusing-ukf"): {"angle", "speed", "mechanical power"},
    ("power-network", "fusing-enkf"): {"angle", "speed", "mechanical power", "valve"},
    ("power-network", "limits"): {"angle", "mechanical power", "valve"},
    ("power-network", "limits-ewma"): {"angle", "mechanical power", "valve"},
    ("power-network", "kf-chi2"): {"speed"},
    ("power-network", "one-class"): {"speed", "mechanical power", "valve"},
    ("gas-pipeline", "limits"): {"pressure", "mass flow"},
    ("gas-pipeline", "limits-ewma"): {"pressure", "mass flow"},
    ("marine-engine", "structural-residuals"): {"pressure"},
}
FITTED = (
    FusingBank,
    FixedLimits,
    EwmaLimits,
    PrincipalComponents,
    OneClass,
    StructuralResiduals,
    FrozenBank,
)  # limits from healthy data
NAMELESS = {"chebyshev:corrected", "chebyshev:paper"}  # as published it detects a fault and does not isolate its sensor
SETTLED = 20  # samples in which the filters forget their initial covariance
UNIT = 1e-5  # of another unit
KEPT = 4  # simulations of healthy readings
LATER = {("power-network", "dynamic-pca"): 40}  # more: it learns from a network whose disturbances have built up
LATER |= {(plant, "frozen-model"): 20 for plant in ("chain", "two-tanks", "gas-pipeline")}  # it waits for the slowest mode
LATER |= {("marine-engine", "frozen-model"): 100}
LATER |= {
    ("marine-engine", f"{bank}-{kind}"): 60 for bank in ("fusing", "filterpy") for kind in ("ekf", "ukf", "enkf")
}  # until then their thresholds are infinite


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
        for name, entry in registry.detectors().items():
            if entry.reference and plant not in OF_FEW_SENSORS:
                continue
            if name.startswith(OF_MODULES) and plant not in WITH_MODULES:
                continue  # it has no scalar equations to monitor, see the test of that
            if name in OF_INPUTS and plant == "chain":
                continue
            marks = [pytest.mark.slow] if (plant, name) in SLOW else [pytest.mark.long] if (plant, name) in LONG else []
            marks += STRUCTURAL.marks if name in STRUCTURAL.values else []
            yield pytest.param((plant, name), id=f"{plant}/{name}", marks=marks)


every_pair = pytest.mark.parametrize("pair", list(pairs()), scope="module")  # one pair after the other: one process builds it


@cache
def in_another_unit(plant: str) -> Plant:
    """The plant with the readings of its first quantity in another unit: Pa as bar."""
    of = plant_of(plant)
    return of.in_units({of.sensors[i].name: ("other", UNIT) for i in next(iter(of.quantities.values()))})


@pytest.fixture(scope="module", autouse=True)
def learnt_from_one_simulation() -> Iterator[None]:
    """Detectors that learn from as many healthy readings of a plant share them: each would simulate the same."""
    made: dict[tuple[int, float, int], tuple[Plant, Recording]] = {}  # with the plant, so that no other gets its id

    def once(plant: Plant, false_alarm: float = FALSE_ALARM, checks: int = 2) -> Recording:
        if (key := (id(plant), false_alarm, checks)) not in made:
            if len(made) == KEPT:
                made.pop(next(iter(made)))
            made[key] = plant, healthy_data(plant, false_alarm, checks)
        return made[key][1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(builders, "healthy_data", once)
        yield


@cache
def readings_of(plant: str) -> Healthy:
    return healthy_readings(plant_of(plant))


def healthy(plant: str, steps: int, runs: int) -> tuple[Array, Array, Array]:
    return readings_of(plant)(steps, runs)


@pytest.mark.parametrize("check", PLANT_CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("name", plants())
def test_a_plant_keeps_the_contract(name: str, check: Callable[[Plant], None]) -> None:
    check(plant_of(name))


@every_pair
@pytest.mark.parametrize("check", DETECTOR_CHECKS, ids=lambda check: check.__name__)
def test_a_detector_keeps_the_contract(pair: tuple[str, str], check: Callable[[Detector, Healthy], None]) -> None:
    check(detector_of(*pair), readings_of(pair[0]))


@every_pair
def test_silence_when_healthy(pair: tuple[str, str]) -> None:
    detector = detector_of(*pair)
    runs = 20 if pair[0] in TOYS else 3
    settled = SETTLED + LATER.get(pair, 0)
    t, y, u = healthy(pair[0], settled + 100, runs)
    if detector.plant.truth.disturbed and detector.process_hypotheses:
        # The claim is that of the model. Without the stated process noise the gains of estimated parameters are wrong (Ljung
        # 1979) and they drift away; the exact discretisation of the truth is a mismatch, which is reported as such.
        recording = simulate(detector.plant, settled + 100, range(50, 50 + runs), truth="model", process_noise=True)
        t, y, u = recording.t, recording.y, recording.u_of_runs
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


@pytest.mark.parametrize("name", REGISTERED)
def test_a_detector_that_tests_the_process_is_registered_as_such(name: str) -> None:
    assert bool(detector_of("two-tanks", name).process_hypotheses) == registry.detectors()[name].tests_process


@pytest.mark.parametrize("name", REGISTERED)
def test_a_detector_isolates_no_more_sensors_at_once_than_it_states(name: str) -> None:
    detector: Any = detector_of("two-tanks", name)
    count = len(detector.plant.sensors)
    t, y, u = healthy("two-tanks", 50, 8)
    y = y.copy()
    for b in range(8):  # one to four sensors off, in either direction
        wrong = np.arange(b, b + b % 4 + 1) % count
        y[SETTLED + 10 :, b, wrong] += 40 * (-1) ** b * detector.plant.sensor_sigma[wrong] * (1 + np.arange(wrong.size))
    _, d = run(detector, detector.init((8,)), t, y, u)
    at_once = d.isolated[..., :count].sum(axis=-1).max()
    stated = registry.detectors()[name].most_faults
    assert at_once <= detector.most_faults == min(detector.most_faults if stated is None else stated, count)


@pytest.mark.parametrize("name", REGISTERED)
def test_a_state_has_named_and_documented_fields_and_the_time_of_the_last_reading(name: str, tmp_path: Path) -> None:
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
    require_same_state(loaded, state, "a loaded state")
    assert [type(a) for a in tuples(loaded)] == [type(a) for a in tuples(state)]
    require_same_state(pickle.loads(pickle.dumps(state)), state, "a pickled state")


def tuples(state: Any) -> list[Any]:
    """The named tuples in a state, itself first."""
    own = [state] if hasattr(state, "_fields") else []
    return own + [found for value in state if isinstance(value, tuple) for found in tuples(value)]


@every_pair
def test_decisions_do_not_change_with_the_unit_of_a_quantity_read(pair: tuple[str, str]) -> None:
    """Of the sensors. The paper's residual (20) depends on the units of the states: test_fusing_bank holds that."""
    plant, detector = plant_of(pair[0]), detector_of(*pair)
    chosen = next(iter(plant.quantities.values()))
    factor = np.ones(len(plant.sensors))
    factor[chosen] = UNIT
    if isinstance(detector, FusingBank):  # test_fusing_bank_thresholds holds that its thresholds follow the unit
        units = {plant.sensors[i].name: ("other", UNIT) for i in chosen}
        other: Detector = replace(
            detector, plant=detector.plant.in_units(units), thresholds=tuple(np.array(detector.thresholds) * factor)
        )
    else:
        other = registry.detector(pair[1], in_another_unit(pair[0]))
    onset = 35 + LATER.get(pair, 0)
    t, y, u = healthy(pair[0], onset + 25, 2)
    y = y.copy()
    y[onset : onset + 20, 0, chosen[0]] += 30 * plant.sensor_sigma[chosen[0]]
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
        late = LATE.get(pair, 2)
        if np.mean(during[:, i]) < 1 - late / 20:
            missed.add(quantity)
            continue
        first = int(np.argmax(during[:, i]))
        if (
            first
        ):  # a reading that may be an outlier, or among the suspects, as well explained by the process, or not by it alone
            before = slice(onset, onset + first)
            assert d.suspect is not None and d.process is not None and first <= late
            unnamed = np.array([h.kind == "unnamed" for h in getattr(detector, "process_hypotheses", ())])
            undecided = d.suspect[before, run_index, i] | d.process[before, run_index][:, unnamed].any(axis=-1)
            assert np.all(undecided | ~d.alarm[before, run_index])
        assert np.all(d.alarm[onset : onset + 20, run_index][during[:, i]])
        if pair[1].startswith("adaptive-threshold"):
            continue  # its diagnosis sets hold every sensor whose fault would explain the decisions
        # at most two of the twenty samples isolate another sensor, too
        assert np.sum(np.any(np.delete(during, i, axis=-1), axis=-1)) <= 2
        if isinstance(detector, FrozenBank):
            continue  # its size is that of a window, part of which may be from before the fault
        size = d.fault_size[onset + first, run_index, i] / plant.sensor_sigma[i]
        # reading less its estimate: 30 with the noise of a reading and of its estimate, at most sqrt(2) together
        assert size == pytest.approx(30.0, abs=4 * np.sqrt(2))
    assert missed == (set(chosen) if pair[1] in NAMELESS else MISSED.get(pair, set()))


@every_pair
def test_wrong_readings_inputs_and_times_are_refused(pair: tuple[str, str]) -> None:
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
