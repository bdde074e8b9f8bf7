"""Lines of text as rows, and what is said of lines that are none."""

import io
from datetime import UTC, datetime

import numpy as np
import pytest
from toy_plants import tanks

from fusion_sfdia.live.left_out_lines import Remarks
from fusion_sfdia.live.text_rows import TextRows, lines
from fusion_sfdia.logs.log_map import Column, LogMap

HEADER = "inflow,time [s],q2,q12,l2,l1\n"


def test_csv_by_the_names_of_the_header() -> None:
    rows = TextRows(tanks())
    assert rows.row("\ufeff" + HEADER) is None and rows.row("\n") is None
    t, y, u = rows.row("6e-4, 5 ,1e-3,,0.9,1.1\r\n")
    assert t == 5.0 and u.tolist() == [6e-4]
    np.testing.assert_array_equal(y, [1.1, 0.9, np.nan, 1e-3])
    assert rows.row(HEADER) is None  # of a writer that began again
    assert rows.row("6e-4,2026-03-01T14:20:05Z,,,,\n")[0] == datetime(2026, 3, 1, 14, 20, 5, tzinfo=UTC)
    assert np.isnan(rows.row(",10,,,,")[2]).all()


@pytest.mark.parametrize("title", ["Time", "Timestamp [s]", "Date-Time"])
def test_a_usual_title_of_times_is_taken_as_by_a_log_file(title: str) -> None:
    rows = TextRows(tanks())
    assert rows.row(HEADER.replace("time [s]", title)) is None
    assert rows.row("6e-4,5,1e-3,,0.9,1.1\n")[0] == 5.0


@pytest.mark.parametrize("end", ["1.0", "1.", "", "1.03\x00"])
def test_a_last_line_that_is_cut_off_is_no_row(end: str) -> None:
    rows = TextRows(tanks())
    rows.row(HEADER)
    for k in range(5):
        rows.row(f"6e-4,{5 * (k + 1)},5e-4,1e-3,0.9,1.03{k}5\n", ended=True)
    with pytest.raises(ValueError, match="the last line, without a line end, is cut off"):
        rows.row(f"6e-4,30,5e-4,1e-3,0.9,{end}", ended=False)
    found = rows.row("6e-4,30,5e-4,1e-3,0.9,1.0355", ended=False)  # whole, of a writer that ends its last line without one
    assert found is not None and found[1][0] == 1.0355


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("1,2,3", r"3 cells under a header of 6; leave a missing value's cell empty"),
        ("6e-4,yesterday,1,1,1,1", r"time \[s\]: 'yesterday'; expected a time"),
        ('6e-4,5,1,1,1,"1', r"not CSV"),
    ],
)
def test_csv_that_is_none(line: str, message: str) -> None:
    rows = TextRows(tanks())
    rows.row(HEADER)
    with pytest.raises(ValueError, match=message):
        rows.row(line)


def test_a_cell_that_is_no_number_is_a_missing_value_and_the_row_counts() -> None:
    said: list[str] = []
    log_map = LogMap(columns={"s": Column(sensor="l1", quality="q"), "m": Column(sensor="l2", unit="mm")}, good=(1, "fine"))
    rows = TextRows(tanks(), log_map, refused=said.append)
    rows.row("time,s,q,m,q12,q2,inflow")
    for line, y, u in (
        ("1,1.5,1,1500,inf,5e-4,6e-4", [1.5, 1.5, np.nan, 5e-4], 6e-4),
        ("2,Bad,FINE,1500,-Infinity,5e-4,none", [np.nan, 1.5, np.nan, 5e-4], np.nan),
        ('3,1.5,2,"1 m",1e999,"5e-4",6 m3/h', [np.nan, 1.0, np.nan, 5e-4], 6 / 3600),
        ('4,"1,5",?,1_0,' + "9" * 400 + ",,true", [np.nan, np.nan, np.nan, np.nan], np.nan),
    ):
        found = rows.row(line)
        np.testing.assert_allclose(found[1], y)
        np.testing.assert_allclose(found[2], [u])
    first = [remark.split(":")[0] for remark in said]
    assert first == ["line 2, column q12", "line 3, column s", "line 5, column m", "line 5, column inflow"]
    assert all(remark.endswith("; its value is missing") for remark in said)
    rows.end()
    assert said[4:] == ["column q12: 4 values could not be used and are missing, the first one as said"]
    json_rows = TextRows(tanks(), refused=said.append)
    line = '{"time": 5, "l1": %s, "l2": 0.9, "q12": "5e-4", "q2": null, "inflow": 6e-4}'
    for cell in ("[1]", "9" * 400, "{}", "true", "1e999", str(2**64), "NaN", '"Bad"'):
        np.testing.assert_array_equal(json_rows.row(line % cell)[1], [np.nan, 0.9, 5e-4, np.nan])
    assert len(said) == 6


def test_states_of_a_map_are_numbers() -> None:
    said: list[str] = []
    columns = {"pump": Column(input="inflow", unit="m3/h", states={"On": 3.6, "TRUE": 3.6, "Off": 0.0})}
    rows = TextRows(tanks(), LogMap(columns=columns), absent_sensors=True, refused=said.append)
    with pytest.raises(ValueError, match="no column of any sensor"):
        rows.row("time,pump")
    rows = TextRows(tanks(), LogMap(columns=columns), absent_sensors=True, refused=said.append)
    rows.row("time,l1,pump")
    found = [rows.row(f"{k},1,{cell}")[2][0] for k, cell in enumerate(("on", "true", "Off", "7.2", "broken"))]
    np.testing.assert_allclose(found, [1e-3, 1e-3, 0.0, 2e-3, np.nan])
    assert len(said) == 1 and "'broken'" in said[0]


def test_a_text_in_what_a_mask_compares_is_a_missing_value() -> None:
    rows = TextRows(tanks(), LogMap(columns={"l1": Column(sensor="l1")}, mask=("state < 1",)), absent_sensors=True)
    rows.row("time,l1,state,inflow")
    masked = [bool(np.isnan(rows.row(f"{k},1,{s},6e-4")[1][0])) for k, s in enumerate(("2", "off", "0", "off", "inf", "2"))]
    assert masked == [False, False, True, True, True, False]


def test_csv_by_a_map() -> None:
    """Titles, separator, decimal comma, units and bad texts of a historian, below a preamble."""
    columns = {"T1.LT1": Column(sensor="l1", unit="mm"), "feed": Column(input="inflow", unit="m3/h")}
    written = LogMap(
        time="Timestamp", tz="Europe/Amsterdam", separator=";", decimal=",", preamble=1, bad=("Bad",), columns=columns
    )
    rows = TextRows(tanks(), written, absent_sensors=True)
    assert rows.row("Export; of today") is None and rows.row("Timestamp;T1.LT1;feed;q2") is None
    t, y, u = rows.row("2026-07-01 14:00:00;1100,5;3,6;Bad")
    assert isinstance(t, datetime) and t.isoformat() == "2026-07-01T14:00:00+02:00"
    np.testing.assert_allclose(y, [1.1005, np.nan, np.nan, np.nan], rtol=1e-15)
    np.testing.assert_allclose(u, [1e-3], rtol=1e-15)
    with pytest.raises(ValueError, match="long format, which a watch cannot take"):
        TextRows(tanks(), LogMap(tag="Tag", value="Value"))


def test_a_mask_takes_readings_as_missing() -> None:
    """In the units of the rows, here m3/h; without a value it compares the one before."""
    columns = {"feed": Column(input="inflow", unit="m3/h")}
    rows = TextRows(tanks(), LogMap(columns=columns, mask=("feed < 1",)))
    rows.row("time,l1,l2,q12,q2,feed")
    feeds = [(2, False), (0.5, True), ("", True), (1, False), ("", False)]
    found = [rows.row(f"{k},1,1,6e-4,6e-4,{feed}") for k, (feed, _) in enumerate(feeds)]
    assert [bool(np.isnan(row[1]).all()) for row in found] == [masked for _, masked in feeds]
    for mask, message in (("feed", "expected a comparison"), ("level < 1", "'level', which is no column")):
        with pytest.raises(ValueError, match=message):
            TextRows(tanks(), LogMap(columns=columns, mask=(mask,))).row("time,l1,l2,q12,q2,feed")


def test_json_by_its_keys() -> None:
    rows = TextRows(tanks(), other_columns=True)
    t, y, u = rows.row('{"time": 5, "l1": 1.1, "l2": null, "q12": "0.5", "q2": 1, "inflow": 6e-4, "note": "x"}')
    assert t == 5.0 and u.tolist() == [6e-4]
    np.testing.assert_array_equal(y, [1.1, np.nan, 0.5, 1.0])
    assert np.isnan(rows.row('{"time": 10, "l1": 1}')[1][1:]).all()
    for line, message in (
        ('{"time": 5, ', "not JSON"),
        ("[1, 2]", "no JSON object"),
        ('{"time": [1]}', r"time: \[1\]; expected"),
        ('{"l1": 1}', "no 'time' among"),
        ('{"time": 5, "l1": 1, "l1": 2}', "the key 'l1' occurs twice"),
        ("[" * 100_000, "not JSON"),
    ):
        with pytest.raises(ValueError, match=message):
            rows.row(line)


def test_a_first_line_that_does_not_fit_the_plant_is_refused_as_that_of_a_log() -> None:
    for line in ("time,l1\n", '{"time": 5, "l1": 1}'):
        with pytest.raises(ValueError, match="the first line: 2 problems\n  no column for the sensors 'l2', 'q12', 'q2'"):
            TextRows(tanks()).row(line)
    with pytest.raises(ValueError, match="no column for the inputs 'inflow'"):
        TextRows(tanks(), absent_sensors=True).row("time,l1\n")
    assert TextRows(tanks(), absent_sensors=True, nominal_inputs=True).row("time,l1\n") is None


def test_remarks_stay_few_however_many_there_are() -> None:
    said: list[str] = []
    remarks = Remarks(said.append)
    for k in range(1, 5001):
        remarks(f"{k}")
    assert said == [*map(str, range(1, 11)), *(f"{n} (the {n}th such line; others are not shown)" for n in (100, 1000))]
    for name in ("l1", "l2"):  # is not hidden by what was said before
        remarks(f"topic {name}: payload '{len(said)}': no number")
    for k in range(2, 100):
        remarks(f"topic 7: payload 'it\\'s {k}': no number at 14:00:{k}")
    assert len(said) == 24 and remarks.count == 5100
    for k in range(5000):  # kinds without end stay few in memory
        remarks("x" * (k % 200) + "y" * (k // 200))
    assert len(remarks.kinds) <= 1001 and remarks.count == 10_100


@pytest.mark.parametrize("longest", [6, 10, 1000])
def test_of_a_line_that_is_too_long_nothing_is_taken_as_a_row(longest: int) -> None:
    given = [
        b"1,2,3\n",
        b"9" * (3 * longest) + b",5,6\n",
        b"7,8,9\n",
        b"x" * longest + b"\n",
        b"y" * (longest + 1) + b"\n",
        b"0",
    ]
    found = list(lines(io.BytesIO(b"".join(given)), longest))
    assert found == [given[0], None, given[2], given[3], None, given[5]]
    assert list(lines(io.BytesIO(b"1\n" + b"2" * 5000), longest)) == [b"1\n", None if longest < 5000 else b"2" * 5000]


def test_comment_lines_are_no_rows() -> None:
    plant = tanks()
    rows = TextRows(plant, LogMap(comment="%", inputs="until the sample"), nominal_inputs=True)
    assert rows.row("time,l1,l2,q12,q2\n") is None and rows.row("  % restarted, 3\n") is None
    found = rows.row("1,1,1,1,1\n")
    assert found is not None and found[0] == 1.0
