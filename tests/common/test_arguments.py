"""Arguments of callers: accepted where unambiguous, otherwise refused in one line that names the argument."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_plants import Array, chain, changed, readings, tanks

from fusion_sfdia.common.arguments import batch_shape, floats, number, probability, shown, whole
from fusion_sfdia.detectors.detector import Detector, run
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.detectors.kalman_banks.fusing_bank import FusingBank
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.detectors.kalman_banks.particle_filter import ParticleFilter
from fusion_sfdia.detectors.state import leaves
from fusion_sfdia.diagnoser import diagnose
from fusion_sfdia.diagnosis.fault_effects import apply_faults
from fusion_sfdia.diagnosis.faults import Fault
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.filters.enkf import EnKFSettings
from fusion_sfdia.filters.estimators import Ensemble, Extended, Unscented
from fusion_sfdia.filters.ukf import SigmaPoints
from fusion_sfdia.logs.csv_log import write_log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal

PLANT = tanks()
DETECTORS: list[Detector] = [
    CentralFilter(PLANT),
    CentralFilter(PLANT, Unscented()),
    CentralFilter(PLANT, Ensemble()),
    LeaveOneOutBank(PLANT, window=5),
    FusingBank(PLANT, Extended(), thresholds=(1.0,) * 4),
    FusingBank(PLANT, Extended(), thresholds=(1.0,) * 4, literal=True),
    ParticleFilter(PLANT, size=100),
]
IDS = ["central", "central-ukf", "central-enkf", "loo", "fusing", "fusing-literal", "particles"]
every_detector = pytest.mark.parametrize("detector", DETECTORS, ids=IDS)


def one_line(error: pytest.ExceptionInfo[ValueError]) -> None:
    text = str(error.value)
    assert "\n" not in text and len(text) < 250, text


@pytest.mark.parametrize("value", ["1", None, True, [1.0], np.zeros(2), 1j, Sensor], ids=repr)
def test_a_number_is_a_number(value: object) -> None:
    for read in (lambda: number("sigma", value), lambda: whole("sigma", value, 0), lambda: probability("sigma", value)):
        with pytest.raises(ValueError, match=r"sigma is .*; expected a "):
            read()
    assert number("sigma", np.array(2)) == number("sigma", np.float32(2)) == 2.0 and whole("n", np.int8(2), 2) == 2
    assert np.isnan(number("sigma", np.nan))  # whether it may be NaN is not the type's question
    for bad in (2.0, np.nan, 1):
        with pytest.raises(ValueError, match=r"n is .*; expected a whole number of at least 2"):
            whole("n", bad, 2)


def test_numbers_of_any_kind_become_floats_and_what_is_missing_nan() -> None:
    same = np.zeros(3)
    assert floats("y", same) is same
    for given in ([1, 2.0, None], (1, 2, np.nan), np.ma.array([1, 2, 3], mask=[0, 0, 1]), np.array([1, 2, None], object)):
        np.testing.assert_array_equal(floats("y", given), [1.0, 2.0, np.nan])
        assert floats("y", given).dtype == np.float64
    assert floats("y", np.array([1, 2], np.float32)).dtype == np.float64 and floats("y", []).shape == (0,)
    for bad in ("abc", ["1", "2"], [1, "x"], [[1.0], [1.0, 2.0]], [1j], {"a": 1}, [{}]):
        with pytest.raises(ValueError, match=r"^y is .*; expected an array of numbers$") as error:
            floats("y", bad)
        one_line(error)
    assert len(shown(np.zeros((50, 50)))) == 60 and shown("a") == "'a'"


def test_a_batch_is_a_shape_or_a_length() -> None:
    assert batch_shape(()) == () and batch_shape(3) == batch_shape([3]) == batch_shape((np.int64(3),)) == (3,)
    for bad in (-1, (2, -1), 2.0, "3", None, (2.0,), True):
        with pytest.raises(ValueError, match=r"batch is .*; expected a shape: \(\) for a single run"):
            batch_shape(bad)


def test_lists_make_the_same_plant() -> None:
    plant = replace(chain(3), x0=np.array([1.0, 2.0, 3.0]), process_cov=np.diag([1.0, 2.0, 3.0]))
    lists: Any = {
        "states": list(plant.states), "sensors": list(plant.sensors), "x0": [1, 2, 3], "initial_cov": [1, 1, 1],
        "process_cov": [[1, 0, 0], [0, 2, 0], [0, 0, 3]], "process_bound": [1, 2, 3],
    }  # fmt: skip
    other: Plant = replace(plant, **lists)
    assert other.states == plant.states and other.sensors == plant.sensors
    for name in ("x0", "initial_cov", "process_cov"):
        np.testing.assert_array_equal(getattr(other, name), getattr(plant, name))
        assert getattr(other, name).dtype == np.float64
    t, y, u = np.arange(1.0, 4.0), np.zeros((3, 3)), np.zeros((3, 0))
    for estimator in (Extended(), Unscented(), Ensemble()):
        a, b = CentralFilter(plant, estimator), CentralFilter(other, estimator)
        np.testing.assert_array_equal(run(a, a.init(), t, y, u)[1].estimate, run(b, b.init(), t, y, u)[1].estimate)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Sensor("s", "x", sigma="x"), "sensor 's': sigma is 'x'; expected a number"),  # type: ignore[arg-type]
        (lambda: Sensor("s", "x", bound=[1.0]), r"sensor 's': bound is \[1.0\]; expected a number"),  # type: ignore[arg-type]
        (lambda: Signal("p", nominal="1"), "signal 'p': nominal is '1'; expected a number"),  # type: ignore[arg-type]
        (lambda: Signal("p", low=None), "signal 'p': low is None; expected a number"),  # type: ignore[arg-type]
        (lambda: replace(PLANT, dt="1"), "plant 'two-tanks': dt is '1'; expected a number"),
        (lambda: changed(PLANT, max_dt=None), "max_dt is None; expected a number"),
        (lambda: changed(PLANT, max_dt=np.nan), "max_dt is nan s; it must be positive"),
        (lambda: replace(PLANT, x0="ab"), "plant 'two-tanks': x0 is 'ab'; expected an array of numbers"),
        (lambda: replace(PLANT, x0=[1.0, None]), "expected 2 finite values"),
        (lambda: replace(PLANT, initial_cov=[[1.0], [0.0, 1.0]]), "initial_cov is .*; expected an array of numbers"),
        (lambda: replace(PLANT, process_cov=None), "no process_sigma of the states level_1, level_2; give Signal"),
        (lambda: replace(PLANT, states=("level_1", "level_2")), "states is .'level_1', 'level_2'.; expected a tuple of Signal"),
        (lambda: replace(PLANT, sensors="l1"), "sensors is 'l1'; expected a tuple of Sensor objects"),
        (lambda: replace(PLANT, inputs=None), "inputs is None; expected a tuple of Signal objects"),
        (lambda: replace(PLANT, step=None), "plant 'two-tanks': step is None; expected a function"),
        (lambda: replace(PLANT, output=3), "plant 'two-tanks': output is 3; expected a function"),
        (lambda: changed(PLANT, operation=lambda t: [1.0, 2.0]).input_at(0.0), r"operation .* gives shape \(2,\); expected"),
        (lambda: changed(PLANT, operation=lambda t: "x").input_at(0.0), "that operation of plant 'two-tanks' gives is 'x'"),
        (lambda: PLANT.in_units({"l1": "mm"}), "unit of sensor 'l1' is 'mm'; expected the unit and readings in it per m"),  # type: ignore[dict-item]
        (lambda: PLANT.in_units({"l1": ("mm", "1")}), "scale of sensor 'l1' is '1'; expected a number"),  # type: ignore[dict-item]
        (lambda: LeaveOneOutBank(PLANT, window=np.nan), "window, in samples, is nan; expected a whole number"),  # type: ignore[arg-type]
        (lambda: LeaveOneOutBank(PLANT, window=2.5), "window, in samples, is 2.5; expected"),  # type: ignore[arg-type]
        (lambda: LeaveOneOutBank(PLANT, window="a"), "window, in samples, is 'a'; expected"),  # type: ignore[arg-type]
        (lambda: LeaveOneOutBank(PLANT, max_faults=1.5), "max_faults is 1.5; expected a whole number"),  # type: ignore[arg-type]
        (lambda: LeaveOneOutBank(PLANT, max_faults=4), "max_faults is 4; plant 'two-tanks' has 4 sensors"),
        (lambda: LeaveOneOutBank(PLANT, false_alarm="x"), "false_alarm is 'x'; expected a number"),  # type: ignore[arg-type]
        (lambda: LeaveOneOutBank(PLANT, Extended), "estimator is <class .*Extended'>; expected Extended()"),  # type: ignore[arg-type]
        (lambda: CentralFilter(PLANT, "ekf"), "estimator is 'ekf'; expected Extended()"),  # type: ignore[arg-type]
        (lambda: CentralFilter("tanks"), "plant is 'tanks'; expected a Plant"),  # type: ignore[arg-type]
        (lambda: FusingBank(PLANT, thresholds="abcd"), "thresholds is 'abcd'; expected an array of numbers"),  # type: ignore[arg-type]
        (lambda: FusingBank(PLANT, thresholds=1.0), r"thresholds has shape \(\) .*expected 4 positive numbers"),  # type: ignore[arg-type]
        (lambda: FusingBank(PLANT, residual_scale=(1.0, np.nan)), "residual_scale has shape .*expected 2 positive numbers"),
        (lambda: FusingBank(PLANT, None), "estimator is None; expected Extended()"),  # type: ignore[arg-type]
        (lambda: ParticleFilter(PLANT, size=10.0), "size is 10.0; expected a whole number"),  # type: ignore[arg-type]
        (lambda: EnKFSettings(size=8.0), "size of the ensemble is 8.0; expected a whole number"),  # type: ignore[arg-type]
        (lambda: EnKFSettings(inflation="1"), "inflation is '1'; expected a number"),  # type: ignore[arg-type]
        (lambda: SigmaPoints(alpha="1"), "alpha is '1'; expected a number"),  # type: ignore[arg-type]
    ],
)  # fmt: skip
def test_a_wrong_setting_is_refused_by_name(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        make()
    one_line(error)


def test_settings_may_be_arrays() -> None:
    bank = FusingBank(PLANT, Extended(), np.full(4, 0.25), PLANT.sensor_sigma, np.ones(2))  # type: ignore[arg-type]
    assert bank == FusingBank(PLANT, Extended(), (0.25,) * 4, tuple(PLANT.sensor_sigma.tolist()), (1.0, 1.0))


@every_detector
def test_an_impossible_start_is_refused(detector: Detector) -> None:
    for arguments, message in (
        ({"batch": 2.5}, "batch is 2.5; expected"), ({"batch": -1}, "batch is -1"), ({"seed": -1}, "seed is -1; expected"),
        ({"seed": 1.5}, "seed is 1.5"), ({"seed": None}, "seed is None"), ({"seed": 2**64}, "a seed below 2.64"),
        ({"t": "0"}, "t is '0'; expected a number"), ({"t": np.nan}, "t is nan.*; expected a finite time"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=message) as error:
            detector.init(**arguments)  # type: ignore[arg-type]
        one_line(error)
    assert detector.init(3).diverged.shape == (3,)  # type: ignore[arg-type]


@every_detector
def test_readings_may_be_lists_and_anything_else_is_refused(detector: Detector) -> None:
    y, u = PLANT.output(5.0, PLANT.x0, PLANT.input_at(0.0)), PLANT.input_at(0.0)
    state = detector.init()
    _, expected = detector.step(state, 5.0, np.where(np.arange(4) == 2, np.nan, y), u)
    for given in ([*y[:2], None, y[3]], np.ma.array(y, mask=[0, 0, 1, 0])):
        _, got = detector.step(state, 5, given, u.tolist())  # type: ignore[arg-type]
        np.testing.assert_array_equal(got.estimate, expected.estimate)
        np.testing.assert_array_equal(got.residual, expected.residual)
    for arguments, message in (
        ((5.0, None, u), r"y has shape \(\); expected \(4,\): .* pass NaN for a missing one"),
        ((5.0, "abcd", u), "y is 'abcd'; expected an array of numbers"),
        ((5.0, ["a", 1, 2, 3], u), "y is .*; expected an array of numbers"),
        ((5.0, y, None), r"u has shape \(\); plant 'two-tanks' has 1 inputs"),
        ((5.0, y, ["on"]), "u is .'on'.; expected an array of numbers"),
        (("5", y, u), "t is '5'; expected a number"),
        ((None, y, u), "t is None; expected a number"),
    ):
        with pytest.raises(ValueError, match=message) as error:
            detector.step(state, *arguments)  # type: ignore[arg-type]
        one_line(error)


@every_detector
def test_the_state_of_another_detector_is_refused(detector: Detector) -> None:
    y, u = np.ones(4), PLANT.input_at(0.0)
    own = detector.init()
    others = [replace(d, plant=chain(3)) for d in DETECTORS if not isinstance(d, FusingBank)]  # type: ignore[type-var]
    strangers = [d.init() for d in (*others, *DETECTORS)]
    foreign = [s for s in strangers if [a.shape for a in leaves(s)] != [a.shape for a in leaves(own)]]
    assert len(foreign) >= 7
    broken = own[:-1], own._replace(memory=()), detector.init((2,))._replace(memory=own.memory), tuple(leaves(own))
    for state in (*foreign, *broken, (), None, "state", own.diverged):
        with pytest.raises(
            ValueError, match=rf"no state of {type(detector).__name__} on plant 'two-tanks' .*; take it from"
        ) as error:
            detector.step(state, 5.0, y, u)  # type: ignore[arg-type]
        one_line(error)


@every_detector
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"step": lambda t, x, u, dt: x[..., :1]}, r"step of plant 'two-tanks' gives shape .*1\) for states .*2\); expected"),
        ({"step": lambda t, x, u, dt: np.ones(2)}, r"step of plant 'two-tanks' gives shape \(2,\)"),
        ({"step": lambda t, x, u, dt: None}, r"step of plant 'two-tanks' gives shape \(\)"),
        ({"output": lambda t, x, u: x}, r"output of plant 'two-tanks' gives shape .*; expected .*4\): one number for"),
        ({"output": lambda t, x, u: x[..., 0]}, "output of plant 'two-tanks' gives shape"),
        ({"step_jacobian": lambda t, x, u, dt: np.eye(3)}, r"step_jacobian .* gives shape \(3, 3\); expected .*2, 2"),
        ({"output_jacobian": lambda t, x, u: np.eye(2)}, r"output_jacobian .* gives shape \(2, 2\); expected .*4, 2"),
    ],
)  # fmt: skip
def test_a_model_of_another_width_is_refused(detector: Detector, change: dict[str, Any], message: str) -> None:
    if "jacobian" not in message:
        with pytest.raises(ValueError, match=message):  # at once; Jacobians, which not all filters take, at their first use
            replace(PLANT, **change)
        return
    wide = replace(detector, plant=changed(PLANT, **change))  # type: ignore[type-var]
    state, y, u = wide.init((3,)), np.ones((3, 4)), PLANT.input_at(0.0)
    if not isinstance(getattr(detector, "estimator", None), Extended):
        wide = replace(wide, max_faults=1) if hasattr(wide, "max_faults") else wide  # None follows from the Jacobians
        wide.step(state, 5.0, y, u)  # these filters take no Jacobian
        return
    with pytest.raises(ValueError, match=message) as error:
        wide.step(state, 5.0, y, u)
    one_line(error)


def test_runs_and_calibrations_take_lists_and_name_what_does_not_fit() -> None:
    t, _, y, u = readings(PLANT, 30, 1, seed=0)
    y, u = y[:, 0], u[:, 0]
    detector = CentralFilter(PLANT)
    lists: Any = (t.tolist(), y.tolist(), u.tolist())
    np.testing.assert_array_equal(
        run(detector, detector.init(), *lists)[1].estimate, run(detector, detector.init(), t, y, u)[1].estimate
    )
    bank = FusingBank(PLANT, Extended())
    assert bank.fit_thresholds(lists, 0.2).thresholds == bank.fit_thresholds((t, y, u), 0.2).thresholds
    for read in (lambda *a: run(detector, detector.init(), *a), lambda *a: bank.fit_thresholds(a, 0.2)):
        for arguments in ((t, y[:-1], u), (t[:-1], y, u), (t, y, u[:-1]), (t[0], y, u)):
            with pytest.raises(ValueError, match="do not fit; expected") as error:
                read(*arguments)
            one_line(error)
        with pytest.raises(ValueError, match=r"t is .*; expected an array of numbers"):
            read("noon", y, u)
    with pytest.raises(ValueError, match="warm_up is -1; expected a whole number of at least 0"):
        bank.fit_thresholds((t, y, u), 0.2, warm_up=-1)


def test_an_array_of_readings_is_not_written_to() -> None:
    detector = CentralFilter(PLANT)
    y: Array = np.ones(4)
    y.flags.writeable = False
    _, d = detector.step(detector.init(), 5.0, y, PLANT.input_at(0.0))
    assert not np.shares_memory(d.reconstruction, y)


SECONDS = 5.0 * np.arange(1, 7)
NANOSECONDS = np.datetime64("2024-05-01T12:00:00", "ns") + (SECONDS * 1e9).astype("timedelta64[ns]")
DATES = {
    "numpy": NANOSECONDS,
    "numpy-days": np.datetime64("2024-05-01") + np.arange(6),
    "masked": np.ma.array(NANOSECONDS),
    "durations": NANOSECONDS - NANOSECONDS[0],
    "list": list(NANOSECONDS),
    "python": [datetime(2024, 5, 1, tzinfo=UTC) + timedelta(seconds=s) for s in SECONDS],
    "objects": np.array([datetime(2024, 5, 1, tzinfo=UTC) + timedelta(seconds=s) for s in SECONDS], object),  # as of pandas
}


@pytest.mark.parametrize("dates", DATES.values(), ids=DATES)
def test_dates_are_not_read_as_seconds(dates: Any, tmp_path: Path) -> None:
    """pandas stores nanoseconds: read as numbers they would be steps of 5e9 s."""
    y, u = np.ones((6, 4)), np.full((6, 1), 6e-4)
    detector, bank = CentralFilter(PLANT), FusingBank(PLANT, Extended())
    for read in (
        lambda: run(detector, detector.init(), dates, y, u),
        lambda: diagnose(detector, dates, y, u),
        lambda: apply_faults(PLANT, dates, y, [Fault("l1", "bias", onset=10.0, magnitude=1.0)]),
        lambda: simulate(PLANT, dates, [0]),
        lambda: write_log(tmp_path / "log.csv", PLANT, dates, y, u),
        lambda: bank.fit_thresholds((dates, y, u)),
    ):
        with pytest.raises(
            ValueError, match=r"expected an array of numbers; pass dates as seconds since the first, .*timedelta64"
        ):
            read()
    for read in (lambda: detector.step(detector.init(), dates[0], y[0], u[0]), lambda: detector.init(t=dates[0])):
        with pytest.raises(ValueError, match=r"t is .*; expected a number"):
            read()
    assert not list(tmp_path.iterdir())
