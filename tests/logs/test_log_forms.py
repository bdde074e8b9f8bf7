"""Recorded readings in every form are the same readings, and what could be misread is refused with the cure."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import fields
from typing import Any

import numpy as np
import pytest
from toy_plants import Array, readings, tanks

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.detectors.data_driven.fixed_limits import FixedLimits
from fusion_sfdia.detectors.detector import Decision, run
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.diagnoser import diagnose
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.logs.check import check_log
from fusion_sfdia.logs.loaded_log import LoadedLog
from fusion_sfdia.logs.log_forms import as_log
from fusion_sfdia.models.marine_engine.plant import marine_engine
from fusion_sfdia.plant.log import Log, one_run

PLANT = tanks()
STEPS = 30
DETECTOR = CentralFilter(PLANT)


def arrays() -> Log:
    """One run of the tanks, two readings missing."""
    t, _, y, u = readings(PLANT, STEPS, 1, seed=0)
    y = y[:, 0].copy()
    y[[4, 9], [0, 2]] = np.nan
    return Log(t, y, u[:, 0].copy())


def frame(log: Log) -> Any:
    """The log as a pandas frame, its columns in another order, some with their unit."""
    pandas = pytest.importorskip("pandas", reason="needs the optional package pandas")
    columns = {"inflow [m3/s]": log.u[:, 0], "time": log.t}
    columns |= {f"{s.name} [{s.unit}]" if i % 2 else s.name: log.y[:, i] for i, s in enumerate(PLANT.sensors)}
    return pandas.DataFrame(columns)[["q2 [m3/s]", "time", "l1", "q12", "inflow [m3/s]", "l2 [m]"]]


def nullable(log: Log) -> Any:
    """The frame with pandas' own missing values, and whole numbers as times."""
    found = frame(log).convert_dtypes()
    assert found["l1"].isna().sum() == 1 and found["time"].dtype.kind == "i"
    return found


def at_times(log: Log) -> Any:
    return frame(log).set_index("time")


FORMS: dict[str, Any] = {
    "tuple": tuple,
    "lists": lambda log: [a.tolist() for a in log],
    "Log": lambda log: log,
    "frame": frame,
    "frame of nullable types": nullable,
    "frame with the index time": at_times,
}


def assert_same_bits(a: Decision, b: Decision) -> None:
    for f in fields(Decision):
        np.testing.assert_array_equal(getattr(a, f.name), getattr(b, f.name), err_msg=f.name)


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
def test_every_form_gives_the_bits_of_arrays(form: Any) -> None:
    log = arrays()
    data = form(log)
    for mine, expected in zip(as_log(PLANT, data), log, strict=True):
        np.testing.assert_array_equal(mine, expected)
    assert_same_bits(run(DETECTOR, DETECTOR.init(), data)[1], run(DETECTOR, DETECTOR.init(), *log)[1])
    assert_same_bits(diagnose(DETECTOR, data).decisions, diagnose(DETECTOR, *log).decisions)
    fitted, expected_fit = (FixedLimits.fit(PLANT, d, 0.1) for d in (data, tuple(log)))
    for what in ("centre", "level", "change"):
        np.testing.assert_array_equal(getattr(fitted, what), getattr(expected_fit, what))
    assert DETECTOR.fit_thresholds(data, 0.1, 5) == DETECTOR.fit_thresholds(tuple(log), 0.1, 5)


def test_a_recording_gives_the_bits_of_its_arrays() -> None:
    recording = simulate(PLANT, STEPS, [1, 2])
    t, y, u = recording.t, recording.y, recording.u_of_runs
    assert_same_bits(run(DETECTOR, DETECTOR.init(2), recording)[1], run(DETECTOR, DETECTOR.init(2), t, y, u)[1])
    assert DETECTOR.fit_thresholds(recording, 0.1) == DETECTOR.fit_thresholds((t, y, u), 0.1)
    one = simulate(PLANT, STEPS, [1])
    assert_same_bits(diagnose(DETECTOR, one).decisions, diagnose(DETECTOR, one.t, one.y[:, 0], one.u).decisions)
    assert_same_bits(diagnose(DETECTOR, one.t, one.y, one.u_of_runs).decisions, diagnose(DETECTOR, one).decisions)


def test_a_batch_is_refused_with_the_cure_where_one_run_is_expected() -> None:
    recording = simulate(PLANT, STEPS, [1, 2])
    with pytest.raises(ValueError, match=r"2 runs side by side, where one is expected; pass one of them, Log\(t, y\[:, i\]"):
        diagnose(DETECTOR, recording)
    with pytest.raises(
        ValueError, match=r"y has shape \(2, 4\); expected \(4,\): .* batch \(\); start from init\(\(2,\)\), or pass"
    ):
        run(DETECTOR, DETECTOR.init(), recording)
    assert one_run(as_log(PLANT, simulate(PLANT, STEPS, [1]))).y.shape == (STEPS, 4)


@pytest.mark.parametrize("zone", [None, "UTC", "America/New_York"])
@pytest.mark.parametrize("as_index", [True, False], ids=["index", "column"])
def test_time_stamps_become_seconds_since_the_first(zone: str | None, as_index: bool) -> None:
    """Clocks go back an hour in New York on 3 November 2024: the stamps run on."""
    log = arrays()
    data = frame(log)
    pandas = pytest.importorskip("pandas")
    start = pandas.Timestamp("2024-11-03 05:59:00", tz="UTC")
    stamps = pandas.DatetimeIndex(start + pandas.to_timedelta(log.t, unit="s"))
    stamps = stamps.tz_localize(None) if zone is None else stamps.tz_convert(zone)
    data = data.drop(columns="time").set_index(stamps) if as_index else data.assign(time=stamps)
    found = as_log(PLANT, data)
    np.testing.assert_array_equal(found.t, log.t - log.t[0])
    np.testing.assert_array_equal(found.y, log.y)
    moved = Log(log.t - log.t[0], log.y, log.u)
    with pytest.warns(UserWarning, match="the stamps state no time zone") if zone is None else nullcontext():
        of_frame = diagnose(DETECTOR, data)
    assert_same_bits(of_frame.decisions, diagnose(DETECTOR, moved).decisions)
    state = DETECTOR.init(t=-PLANT.dt)
    assert_same_bits(run(DETECTOR, state, data)[1], run(DETECTOR, state, moved)[1])


@pytest.mark.parametrize("as_index", [True, False], ids=["index", "column"])
def test_durations_become_seconds(as_index: bool) -> None:
    log = arrays()
    data = frame(log)
    pandas = pytest.importorskip("pandas")
    times = pandas.to_timedelta(log.t, unit="s")
    data = data.drop(columns="time").set_index(times) if as_index else data.assign(time=times)
    np.testing.assert_array_equal(as_log(PLANT, data).t, log.t)


def test_times_that_could_be_misread_are_refused() -> None:
    data = frame(arrays())
    pandas = pytest.importorskip("pandas")
    stamps = pandas.Timestamp("2024-05-01") + pandas.to_timedelta(data["time"], unit="s")
    for times, message in (
        (stamps.dt.strftime("%d/%m/%y"), "row 1, column time: '01/05/24'; expected a time without ambiguity"),
        (stamps.where(data.index != 3), "column time: row 4 has no time; drop such rows"),
    ):
        with pytest.raises(ValueError, match=message):
            as_log(PLANT, data.assign(time=times))
    np.testing.assert_array_equal(as_log(PLANT, data.assign(time=stamps.dt.time)).t, arrays().t)  # times of day
    for same in (stamps, stamps.astype(str), stamps.astype(object)):
        np.testing.assert_array_equal(as_log(PLANT, data.assign(time=same)).t, arrays().t - arrays().t[0])
    with pytest.raises(
        ValueError, match=r"no column 'time' among .*, and its index has the name None; .*rename_axis\('time'\)"
    ):
        as_log(PLANT, data.drop(columns="time"))  # the index counts rows
    np.testing.assert_array_equal(as_log(PLANT, data.rename(columns={"time": "Timestamp"})).t, arrays().t)  # as of a file
    with pytest.raises(ValueError, match=r"t is .*; expected an array of numbers; pass dates as seconds since the first"):
        as_log(PLANT, stamps.to_numpy(), *arrays()[1:])


def test_columns_keep_the_policy_of_read_log() -> None:
    data = frame(arrays())
    without_sensor, without_input = data.drop(columns="l1"), data.drop(columns="inflow [m3/s]")
    with pytest.raises(ValueError, match=r"no column for the sensors 'l1' of plant .*; add them .*absent_sensors=True"):
        as_log(PLANT, without_sensor)
    assert np.all(np.isnan(as_log(PLANT, without_sensor, absent_sensors=True).y[:, 0]))
    with pytest.raises(
        ValueError,
        match=r"of plant 'two-tanks'; name another plant with --plant if it is not this one \(`init` .*, `monitor` .*\); ",
    ):
        as_log(PLANT, data[["time", "inflow [m3/s]"]])
    with pytest.raises(ValueError, match=r"no column for the inputs 'inflow' .*nominal_inputs=True"):
        diagnose(DETECTOR, without_input)
    with pytest.warns(
        UserWarning, match=r"no column for the inputs 'inflow'; the nominal values of plant .* are used"
    ) as warned:
        assumed = as_log(PLANT, without_input, nominal_inputs=True)
    assert warned[0].filename == __file__
    np.testing.assert_array_equal(assumed.u[:, 0], PLANT.inputs[0].nominal)
    with pytest.raises(ValueError, match=r"the columns 'remark' are no sensors or inputs .*other_columns=True"):
        as_log(PLANT, data.assign(remark="fine"))
    np.testing.assert_array_equal(as_log(PLANT, data.assign(remark="fine"), other_columns=True).u, arrays().u)
    in_mm = data.assign(**{"l2 [m]": 1e3 * data["l2 [m]"]}).rename(columns={"l2 [m]": "l2 [mm]"})
    np.testing.assert_allclose(as_log(PLANT, in_mm).y[:, 1], arrays().y[:, 1], rtol=1e-15)
    with pytest.raises(ValueError, match=r"column 'l2' is in 'mbar', plant 'two-tanks' has it in 'm'"):
        as_log(PLANT, data.rename(columns={"l2 [m]": "l2 [mbar]"}))
    with pytest.raises(ValueError, match=r"the column 'l1' occurs twice"):
        as_log(PLANT, data.assign(**{"l1 [m]": data["l1"]}))
    with pytest.raises(ValueError, match=r"the frame, row 1, column l1: 'high'; expected a finite number, or nothing"):
        as_log(PLANT, data.assign(l1="high"))


def test_inputs_beyond_their_limits_are_refused_as_read_log_does() -> None:
    data = frame(arrays())
    data.loc[2, "inflow [m3/s]"] = 7.0
    with pytest.raises(
        ValueError, match=r"the frame, row 3, column inflow: 7 m3/s; plant 'two-tanks' holds from 0 to 0.002 m3/s; correct"
    ):
        as_log(PLANT, data)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ((None,), "the readings are None; expected t, y and u, a Log, a Recording as simulate returns it, or a frame"),
        ((np.ones((4, 4)),), "the readings are array"),
        ((np.arange(4.0), np.ones((4, 4))), "the readings are 2 arguments; expected t, y and u"),
        ((np.arange(4.0), np.ones(4), np.ones((4, 1))), r"t \(4,\), y \(4,\), u \(4, 1\) do not fit; expected \(K,\)"),
        ((np.arange(0.0), np.ones((0, 4)), np.ones((0, 1))), "there are no readings: t is empty"),
    ],
)
def test_anything_else_is_refused(data: tuple[Array, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        as_log(PLANT, *data)


def test_a_recording_of_another_plant_is_refused() -> None:
    with pytest.raises(ValueError, match=r"the readings are of the sensors 'l1', .*; expected those of plant 'marine-engine'"):
        as_log(marine_engine(), simulate(PLANT, 4, [0]))


def test_frames_of_readings_and_inputs_are_taken_by_name() -> None:
    """Columns in another order are not readings of other sensors."""
    pandas = pytest.importorskip("pandas")
    log = arrays()
    names = list(PLANT.sensor_names)
    y = pandas.DataFrame(log.y, columns=names)[names[::-1]]
    u = pandas.DataFrame(log.u, columns=["inflow [m3/s]"])
    for mine, expected in zip(as_log(PLANT, log.t, y, u), log, strict=True):
        np.testing.assert_array_equal(mine, expected)
    np.testing.assert_array_equal(as_log(PLANT, log.t, pandas.DataFrame(log.y), log.u).y, log.y)  # numbered columns
    with pytest.raises(
        ValueError, match="y is a frame with the columns 'l1', 'l2', 'q12', 'q3'; expected 'l1', 'l2', 'q12', 'q2'"
    ):
        as_log(PLANT, log.t, y.rename(columns={"q2": "q3"})[["l1", "l2", "q12", "q3"]], log.u)


def test_a_missing_input_is_named_with_its_row() -> None:
    log = arrays()
    log.u[7, 0] = np.nan
    for read in (lambda: as_log(PLANT, log), lambda: diagnose(DETECTOR, *log), lambda: diagnose(DETECTOR, frame(log))):
        with pytest.raises(ValueError, match=r"u has nan in row 7 \(the first is 0\), input 'inflow'|row 8, column inflow"):
            read()


def test_events_of_a_frame_with_stamps_are_on_the_wall_clock() -> None:
    pandas = pytest.importorskip("pandas")
    stamps = pandas.Timestamp("2024-07-01 12:00", tz="Europe/Amsterdam") + pandas.to_timedelta(arrays().t, unit="s")
    data = frame(arrays()).drop(columns="time").set_index(stamps)
    assert diagnose(DETECTOR, data).clock.at(0.0) == "2024-07-01 12:00:05+02:00"
    checked = check_log(data.assign(**{"l2 [m]": 1e3 * data["l2 [m]"]}), PLANT)
    found = diagnose(DETECTOR, checked)
    assert found.suspects == ("l2",) and np.isnan(found.decisions.residual[:, 1]).all()


def test_dates_of_pandas_as_times_are_not_seconds() -> None:
    pandas = pytest.importorskip("pandas")
    log = arrays()
    dates = pandas.Timestamp("2024-05-01", tz="Europe/Amsterdam") + pandas.to_timedelta(log.t, unit="s")
    for t in (dates, pandas.Series(dates), dates.tz_localize(None)):
        with pytest.raises(ValueError, match=r"t is .*; expected an array of numbers; pass dates as seconds since the first"):
            as_log(PLANT, t, log.y, log.u)
    for unit in (1e3, 1e6, 1e9):
        with pytest.raises(ValueError, match="looks like milli-, micro- or nanoseconds since 1970; pass seconds"):
            as_log(PLANT, unit * (1.7e9 + log.t), log.y, log.u)
    np.testing.assert_array_equal(as_log(PLANT, 1.7e9 + log.t, log.y, log.u).t, 1.7e9 + log.t)


def test_what_was_loaded_is_a_log() -> None:
    plant = tanks()
    t, _, y, u = readings(plant, 5, 1, seed=0)
    loaded = LoadedLog(Log(t, y[:, 0], u[:, 0]), Clock(), ())
    for one, other in zip(as_log(plant, loaded), loaded.log, strict=True):
        np.testing.assert_array_equal(one, other)
