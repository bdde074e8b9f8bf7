"""Logs: what is written is read back to the bit; an error names file, row and column."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from toy_plants import chain, changed, tanks

from fusion_sfdia.logs.csv_log import read_log, write_log
from fusion_sfdia.logs.log_map import LogMap
from fusion_sfdia.plant.signals import Signal

HEADER = "time,l1,l2,q12,q2"
ROW = "1,1.0,1.0,6e-4,6e-4"


def log(tmp_path, text):
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="utf-8")
    return path


@settings(max_examples=30, deadline=None)
@given(arrays(float, (4, 4), elements=st.floats(allow_infinity=False)), arrays(float, (4, 1), elements=st.floats(0.0, 2e-3)))
def test_read_back_to_the_bit(tmp_path_factory, y, u):
    path = tmp_path_factory.mktemp("logs") / "log.csv"
    t = np.array([0.1, 0.2, 0.30000000000000004, 1e6 / 3])
    write_log(path, tanks(), t, y, u)
    found = read_log(path, tanks())
    for read, written in zip(found, (t, y, u), strict=True):
        np.testing.assert_array_equal(read, written)


def test_what_is_written(tmp_path):
    path = tmp_path / "new folder" / "log.csv"
    write_log(path, tanks(), np.array([5.0]), np.array([[1.0, np.nan, 6e-4, 6e-4]]))
    assert path.read_text() == "time [s],l1 [m],l2 [m],q12 [m3/s],q2 [m3/s]\n5.0,1.0,,0.0006,0.0006\n"
    assert [p.name for p in path.parent.iterdir()] == ["log.csv"]


def test_header_with_and_without_units_in_any_order(tmp_path):
    path = log(tmp_path, "\ufeffq2 [m3/s], l1 ,time [s],inflow,l2[m],q12\r\n4,1,5,7e-4,2,3\r\n\r\n,NaN,6,8e-4, 2 ,nan\r\n")
    found = read_log(path, tanks())
    np.testing.assert_array_equal(found.t, [5, 6])
    np.testing.assert_array_equal(found.u, [[7e-4], [8e-4]])
    np.testing.assert_array_equal(found.y, [[1, 2, 3, 4], [np.nan, 2, np.nan, np.nan]])


def test_inputs_without_a_column_are_assumed_only_where_that_is_asked_for(tmp_path):
    path = log(tmp_path, HEADER + "\n" + ROW)
    with pytest.raises(ValueError, match=r"no column for the inputs 'inflow' of plant 'two-tanks'; .* --nominal-inputs"):
        read_log(path, tanks())
    with pytest.warns(
        UserWarning, match=r"no column for the inputs 'inflow'; the nominal values of plant 'two-tanks' are used"
    ):
        found = read_log(path, tanks(), nominal_inputs=True)
    np.testing.assert_array_equal(found.u, [[6e-4]])


def test_inputs_default_to_the_plants_operation_since_the_reading_before(tmp_path):
    plant = changed(tanks(), operation=lambda t: np.array([t]))
    path = log(tmp_path, HEADER + "\n10,1,1,1,1\n12,1,1,1,1\n17,1,1,1,1\n40,1,1,1,1\n")
    with pytest.warns(UserWarning, match="the usual inputs of plant"):
        found = read_log(path, plant, nominal_inputs=True)
    np.testing.assert_array_equal(found.u, [[5], [10], [12], [35]])
    given_input = read_log(log(tmp_path, HEADER + ",inflow\n10,1,1,1,1,7e-4\n"), plant)
    np.testing.assert_array_equal(given_input.u, [[7e-4]])


def test_absent_sensors_and_other_columns_when_allowed(tmp_path):
    path = log(tmp_path, "time,l1,weather,inflow\n1,1.0,fine,6e-4\n")
    found = read_log(path, tanks(), absent_sensors=True, other_columns=True)
    np.testing.assert_array_equal(found.y, [[1, np.nan, np.nan, np.nan]])
    with pytest.raises(ValueError, match=r"no column for the sensors 'l2', 'q12', 'q2' .* --absent-sensors"):
        read_log(path, tanks(), other_columns=True)
    with pytest.raises(ValueError, match=r"columns 'weather' are no sensors or inputs .* --other-columns"):
        read_log(path, tanks(), absent_sensors=True)
    with pytest.raises(ValueError, match="no column of any sensor"):
        read_log(log(tmp_path, "time\n1\n"), tanks(), absent_sensors=True)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty; expected a header"),
        (" \n\n", "is empty; expected a header"),
        (HEADER + "\n", "a header and no rows"),
        ("t,l1,l2,q12,q2\n" + ROW, "no column 'time'"),
        ("t" * 200 + "\n1", f"no column 'time' among '{'t' * 20}...'; give the column"),
        (HEADER.replace("l1", "l1 [mbar]") + "\n" + ROW, "column 'l1' is in 'mbar', plant 'two-tanks' has it in 'm': unit"),
        (HEADER.replace("l2", "l1") + "\n" + ROW, "the column 'l1' occurs twice"),
        (HEADER + "\n" + ROW + "\n2,1.0,high,1,1", r"row 3, column l2: 'high'; expected a finite number, or nothing"),
        (HEADER + "\n1,1.0,inf,1,1", "row 2, column l2: 'inf'"),
        (HEADER + "\n1,1.0,1_0,1,1", "row 2, column l2: '1_0'; expected a finite number"),
        (HEADER + "\n1,1.0,１２,1,1", "row 2, column l2: '１２'; expected a finite number"),
        (HEADER + "\n1,1.0," + 5000 * "x" + ",1,1", r"row 2, column l2: 'x{56}\.\.\.; expected a finite number"),
        (HEADER.replace("l1", f"l1 [{5000 * 'm'}]") + "\n" + ROW, r"column 'l1' is in 'm{56}\.\.\., plant"),
        (HEADER + "\n1,1.0,1,1", r"a header and no rows that can be used \(the last row \(2\), which is cut off, left out\)"),
        (
            HEADER + "\n1/5/2024 12:00,1.0,1,1,1",
            'column time: .*; expected a time without ambiguity: state format = "%d/%m/%Y %H:%M" or format = "%m/%d/%Y',
        ),
        (HEADER + "\n,1.0,1,1,1", "row 2, column time: ''; expected a finite number"),
        (HEADER + "\n" + ROW + "\n\n" + ROW, r"row 4, column time: 1\.0 s again, as in row 2; .* keep one row of each time"),
        (HEADER + "\n" + ROW + "\n0" + ROW[1:], r"row 3, column time: 0\.0 s after 1\.0 s; times must increase: sort the rows"),
        (HEADER + ",inflow\n1,1,1,1,1,", "row 2, column inflow: ''; expected a finite number"),
        (HEADER + '\n1,"1.0,1,1,1', "not a CSV text file"),
    ],
)
def test_an_error_names_file_row_and_column(tmp_path, text, message):
    path = log(tmp_path, text)
    with pytest.raises(ValueError, match=message) as caught:
        read_log(path, tanks(), nominal_inputs=True)
    assert str(path) in str(caught.value)


def test_inputs_beyond_their_limits(tmp_path):
    plant = replace(tanks(), inputs=(Signal("inflow", "m3/s", 6e-4, 0.0, 1.0),))
    path = log(tmp_path, HEADER + ",inflow\n1,1,1,1,1,1\n\n2,1,1,1,1,7\n3,1,1,1,1,8\n")
    with pytest.raises(
        ValueError,
        match=r"log.csv, row 4, column inflow: 7 m3/s \(and in 1 other row\); plant 'two-tanks' holds from 0 to 1 m3/s; ",
    ):
        read_log(path, plant)


def test_a_long_list_of_names_is_cut(tmp_path):
    with pytest.raises(ValueError, match=r"sensors 's0', .*'s7' and 12 more of plant 'chain'; .*; add them"):
        read_log(log(tmp_path, "time\n1\n"), chain(20))


def test_bytes_that_are_no_text(tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(b"time,l1\n\xff\x80\x81,1\n\xff\x80\x81,2\n")
    with pytest.raises(ValueError, match="not a CSV text file"):
        read_log(path, tanks())


def test_a_batch_is_no_log(tmp_path):
    with pytest.raises(ValueError, match="one run, without a batch"):
        write_log(tmp_path / "log.csv", tanks(), np.arange(3.0), np.zeros((3, 2, 4)))
    with pytest.raises(ValueError, match="do not fit"):
        write_log(tmp_path / "log.csv", tanks(), np.arange(3.0), np.zeros((3, 4)), np.zeros((3, 2)))
    assert not list(tmp_path.iterdir())


def test_a_map_is_taken(tmp_path):
    path = log(tmp_path, "zeit;l1;l2;q12;q2;inflow\n1;1,5;1;1;1;1e-3\n")
    found = read_log(path, tanks(), log_map=LogMap(time="zeit", separator=";", decimal=","))
    np.testing.assert_array_equal(found.y, [[1.5, 1, 1, 1]])
