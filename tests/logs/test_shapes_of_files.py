"""Files as loggers write them: what fits in one way alone is read and stated, what fits in none is left out and counted."""

from __future__ import annotations

import bz2
import gzip
import lzma
import zipfile
from pathlib import Path

import numpy as np
import pytest
from realistic_logs import vessel

from fusion_sfdia.logs.kinds import LINES, MAGIC, PARQUET, TDMS
from fusion_sfdia.logs.loaded_log import LoadedLog
from fusion_sfdia.logs.log_map import LogMap
from fusion_sfdia.logs.reading import load_log

PLANT = vessel()
K = 40
T = 60.0 * np.arange(K)
VALUES = np.round([350.0, 4e5, 1.2, 2e-3] * (1 + 1e-3 * np.random.default_rng(5).standard_normal((K, 4))), 8)
NAMES = ["TT101", "PT101", "LT101", "feed"]
HEADER = ",".join(["time", *NAMES])
ROWS = [",".join([f"{t:.1f}", *(f"{v:.8f}" for v in row)]) for t, row in zip(T, VALUES, strict=True)]
LEFT_OUT = ("rows left out", "short rows")


def load(folder: Path, text: str | bytes, log_map: LogMap | None = None) -> LoadedLog:
    path = folder / "log.csv"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return load_log(path, PLANT, log_map)


def holds(found: LoadedLog, rows: object = slice(None), missing: tuple[tuple[int, int], ...] = ()) -> None:
    """The log has these rows of the recording, and no number that is not in it."""
    at = np.arange(K)[rows]  # type: ignore[call-overload]
    expected = VALUES[at].copy()
    for k, i in missing:
        expected[np.flatnonzero(at == k), i] = np.nan
    np.testing.assert_array_equal(found.log.t - found.log.t[0], T[at] - T[at][0])
    np.testing.assert_array_equal(found.log.y, expected[:, :3])
    np.testing.assert_array_equal(found.log.u, expected[:, 3:])


def texts(found: LoadedLog, *kinds: str) -> str:
    return "; ".join(f.text for f in found.findings if f.kind in kinds)


def lines(rows: list[str] = ROWS, header: str = HEADER) -> str:
    return "\n".join([header, *rows]) + "\n"


STAMPED = [f"2024-07-01 10:{k:02d}:00,{row.partition(',')[2]}" for k, row in enumerate(ROWS)]
TOA5 = [
    '"TOA5","Site","CR1000"',
    '"time","RN","TT101","PT101","LT101","feed"',
    '"TS","","K","Pa","m","m3/s"',
    '"","","Avg","Avg","Smp","Avg"',
]


@pytest.mark.parametrize(
    ("text", "stated"),
    [
        ("sep=;\n" + lines().replace(",", ";"), "separated by ';'"),
        ("sep=\t\r\n" + lines().replace(",", "\t"), "separated by '\\t'"),
        (lines().replace(",", "|"), "separated by '|'"),
        (
            "\n".join(["Exported by: historian", "Time;10:00", "", lines().replace(",", ";")]),
            "the header is line 4; 2 lines before",
        ),
        ("# logger 7\n# Sensors: 4\n" + lines(), "the header is line 3"),
        ("# logger 7\n# " + lines(), "the header is line 2"),
        (lines().replace("\n", "\r"), ""),
        (lines().replace("\n", "\r\r\n"), ""),
        ("\r\n".join([HEADER, *ROWS[:9]]) + "\n" + "\n".join(ROWS[9:]), ""),
        (lines().encode("utf-16"), "read as UTF-16"),
        (lines().encode("utf-16-le"), "read as UTF-16"),
        (lines().encode("utf-32"), "read as UTF-32"),
        (lines([", ".join(f'"{c}"' for c in row.split(",")) for row in ROWS]), ""),
        (lines([" ,".join(f'"{c}"' for c in row.split(",")) for row in ROWS]), ""),
        (lines([ROWS[0] + ",", *ROWS[1:]], HEADER), ""),
        (lines([row + "," for row in ROWS]), ""),
        (lines(["s,K,Pa,m,m3/s", *ROWS]), "row 2 read as the units"),
        (lines(["[s],[K],[Pa],[m],[m3/s]", ",Avg,Avg,Avg,Avg", *ROWS]), "row 3 below the header"),
        (lines([f'{row},"{k}\nnote"' for k, row in enumerate(ROWS)], HEADER + ",remark"), ""),
    ],
)
def test_what_is_read(tmp_path: Path, text: str | bytes, stated: str) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    found = load_log(path, PLANT, LogMap(inputs="until the sample"), other_columns=True)
    holds(found)
    assert stated in texts(found, "file") and not texts(found, *LEFT_OUT)


@pytest.mark.parametrize("stated", [{}, {"preamble": 1, "unit_row": True}, {"preamble": 1, "unit_row": True, "skip_rows": 1}])
def test_a_toa5_table(tmp_path: Path, stated: dict[str, int]) -> None:
    rows = [row.replace(",", f",{k},", 1) for k, row in enumerate(STAMPED)]
    log_map = LogMap(inputs="until the sample", **stated)  # type: ignore[arg-type]
    path = tmp_path / "log.dat"
    path.write_text("\n".join([*TOA5, *rows[:20], *TOA5, *rows[20:]]) + "\n")
    found = load_log(path, PLANT, log_map, other_columns=True)
    holds(found)
    assert "the header again in 4 rows (25, 26, 27, 28), left out" in texts(found, *LEFT_OUT)
    in_kelvin = found.log.y[:, 0]
    path.write_text(path.read_text().replace('"K"', '"degC"'))
    np.testing.assert_allclose(load_log(path, PLANT, log_map, other_columns=True).log.y[:, 0], in_kelvin + 273.15, rtol=1e-15)


@pytest.mark.parametrize(
    ("rows", "kept", "missing", "stated"),
    [
        ([*ROWS[:9], HEADER, *ROWS[9:]], slice(None), (), "the header again in row 11, left out"),
        ([*ROWS[:9], "Logger restarted", *ROWS[9:]], slice(None), (), "row 11 left out, whose cells do not fit the 5 columns"),
        ([*ROWS[:9], "\0" * 300, *ROWS[9:]], slice(None), (), "row 11 with NUL bytes"),
        ([*ROWS[:9], ROWS[9][:20] + "\0" * 9 + ROWS[11][8:], *ROWS[12:]], np.r_[0:9, 12:K], (), "row 11 with NUL bytes"),
        ([*ROWS, "\0" * 4096], slice(None), (), "row 42 with NUL bytes"),
        ([*ROWS[:9], ROWS[9] + ROWS[10], *ROWS[11:]], np.r_[0:9, 11:K], (), "row 11 left out, whose cells"),
        ([*ROWS[:9], ROWS[9].replace(",", ";"), *ROWS[10:]], np.r_[0:9, 10:K], (), "row 11 left out, whose cells"),
        ([*ROWS[:9], ",".join(ROWS[9].split(",")[:4]), *ROWS[10:]], np.r_[0:9, 10:K], (), "row 11 left out, which end before"),
        ([*ROWS[:9], ROWS[9].replace(",", ",,", 1), *ROWS[10:]], np.r_[0:9, 10:K], (), "row 11 left out, whose cells"),
        ([*ROWS[:9], "540.0," + ROWS[9].split(",", 2)[2], *ROWS[10:]], np.r_[0:9, 10:K], (), "row 11 left out"),
        ([*ROWS[:9], '"' + ROWS[9], *ROWS[10:]], np.r_[0:9, 10:K], (), "row 11 whose quotes do not close left out"),
        ([*ROWS[:9], ROWS[9][:-3], *ROWS[10:]], np.r_[0:9, 10:K], (), "row 11 with a last number that is not finished"),
    ],
)  # fmt: skip
def test_single_rows_cost_themselves_and_are_counted(
    tmp_path: Path, rows: list[str], kept: object, missing: tuple[tuple[int, int], ...], stated: str
) -> None:
    found = load(tmp_path, lines(rows))
    holds(found, kept, missing)
    assert stated in texts(found, *LEFT_OUT) and stated in "; ".join(found.remarks)


def test_rows_that_end_early_lack_their_last_readings(tmp_path: Path) -> None:
    header, rows = "time,feed,TT101,PT101,LT101,remark", []
    for row in ROWS:
        t, *y, u = row.split(",")
        rows.append(",".join([t, u, *y]))
    short = [*rows[:5], rows[5].rpartition(",")[0], *rows[6:]]
    for ends in (short, [f"{short[0]},begin", *short[1:]]):
        (tmp_path / "log.csv").write_text(lines(ends, header))
        found = load_log(tmp_path / "log.csv", PLANT, other_columns=True)
        holds(found, missing=((5, 2),))
        assert "rows (" in texts(found, "short rows") and "end early: no cells of" in texts(found, "short rows")


@pytest.mark.parametrize("end", ["", "\n"])
@pytest.mark.parametrize("stamped", [False, True])
def test_a_cut_last_row_is_left_out(tmp_path: Path, end: str, stamped: bool) -> None:
    rows = STAMPED if stamped else ROWS
    whole = lines(rows).rstrip("\n")
    for gone in range(1, len(rows[-1])):
        if end and whole[-gone - 1] == ",":
            continue  # an input that is missing, as any other
        if end and gone >= len(rows[-1]) - 1:
            continue
        found = load(tmp_path, whole[:-gone] + end)
        holds(found, slice(K - 1))
        assert texts(found, *LEFT_OUT), gone
    holds(load(tmp_path, whole))


@pytest.mark.parametrize("last", ["1.", "1", "1.2e", "1.2e-", "-", "", "1.23"])
def test_unfinished_last_numbers(tmp_path: Path, last: str) -> None:
    rows = [*(f"{k},2e-3,350,4e5,{1 + k / 40:.2f}" for k in range(9)), f"9,2e-3,350,4e5,{last}"]
    assert len(load(tmp_path, "\n".join(["time,feed,TT101,PT101,LT101", *rows])).log.t) == 9 + (last == "1.23")


def test_an_unfinished_last_word(tmp_path: Path) -> None:
    rows = [f"{row},{'Bad' if k == 5 else 'Good'}" for k, row in enumerate(ROWS)]
    for gone in range(5):
        (tmp_path / "log.csv").write_text("\n".join([f"{HEADER},Q", *rows])[: -gone or None])
        assert len(load_log(tmp_path / "log.csv", PLANT, other_columns=True).log.t) == K - (gone > 0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            lines([row.replace(".", ",") for row in ROWS]),
            r"row 2: 10 cells under a header of 5 \(as 39 more rows\); where these are decimal",
        ),
        (lines([*ROWS[:9], "feed,time,TT101,PT101,LT101", *ROWS[9:]]), "row 11"),
        (lines([*ROWS[:9], "time,PT101,TT101,LT101,feed", *ROWS[9:]]), "row 11: a second header with other columns"),
        (HEADER + "\n" + "1," * 600_000, "row 2: a line of 1200000 characters; expected one row a line"),
        ("1," * 600_000, "row 1: a line of 1200000 characters"),
        (
            "time,T °C\n0,1\n".encode("cp1252"),
            r'not a CSV text file in utf-8-sig \(row 1\); state its encoding .* "cp1252" gives .°C',
        ),
    ],
)
def test_what_is_refused(tmp_path: Path, text: str | bytes, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        load(tmp_path, text)


def test_comments_and_blanks_as_a_map_states_them(tmp_path: Path) -> None:
    rows = [*ROWS[:9], "% pump on", *ROWS[9:]]
    found = load(tmp_path, lines(rows), LogMap(comment="%", inputs="until the sample"))
    holds(found)
    assert "1 line that begins with '%' taken as comments" in texts(found, "file")
    found = load(tmp_path, lines().replace(",", "   "), LogMap(separator=" ", inputs="until the sample"))
    holds(found)


def test_packed_files(tmp_path: Path) -> None:
    data = lines(STAMPED).encode()
    with zipfile.ZipFile(tmp_path / "log.zip", "w") as archive:
        archive.writestr("folder/log.csv", data)
    for name, pack in (("log.csv.gz", gzip.compress), ("log.csv.bz2", bz2.compress), ("log.csv.xz", lzma.compress)):
        (tmp_path / name).write_bytes(pack(data))
        holds(load_log(tmp_path / name, PLANT))
        (tmp_path / name).write_bytes(pack(data)[:-20])
        with pytest.raises(ValueError, match="does not unpack"):
            load_log(tmp_path / name, PLANT)
    holds(load_log(tmp_path / "log.zip", PLANT))
    with zipfile.ZipFile(tmp_path / "log.zip", "a") as archive:
        archive.writestr("other.csv", data)
    with pytest.raises(
        ValueError, match=r"is a zip archive; unpack it, and give one of its 2 files: 'folder/log.csv', 'other.csv'"
    ):
        load_log(tmp_path / "log.zip", PLANT)


NAMED = [(magic, kind) for magic, kind in MAGIC if kind.cure]
WRITTEN = {
    "JSON lines": '{"time": 0, "TT101": 350}\n{"time": 60, "TT101": 350}\n',
    "JSON": '[{"time": 0},\n {"time": 60}]',
    "XML": '<?xml version="1.0"?>\n<log/>',
    "an HTML page": "<!DOCTYPE html>\n<html><body>Log in</body></html>",
    "line protocol of InfluxDB": 'tank,site=a level=1.5,state="on" 1719792000000000000\n',
}


@pytest.mark.parametrize(("magic", "kind"), NAMED, ids=[str(magic) for magic, _ in NAMED])
def test_a_binary_file_is_named(tmp_path: Path, magic: bytes, kind: object) -> None:
    with pytest.raises(ValueError) as caught:
        load(tmp_path, magic + bytes(range(256)) * 3)
    name, cure = kind  # type: ignore[misc]
    assert str(caught.value) == f"{tmp_path / 'log.csv'} is {name}; {cure}"


def test_a_text_file_of_another_kind_is_named(tmp_path: Path) -> None:
    assert {kind.name for _, kind in LINES} == {*WRITTEN}
    for name, text in WRITTEN.items():
        with pytest.raises(ValueError, match=f"log.csv is {name}; "):
            load(tmp_path, text)
    with pytest.raises(ValueError, match="is a binary file of a kind that is not known; expected CSV"):
        load(tmp_path, bytes(range(256)) * 3)
    for title in ("PAR1", "ORC", "LOGG", "RIFF", "GIF8", "TDSm"):  # titles are no first bytes of these
        holds(load_log(_written(tmp_path, lines([f"1,{row}" for row in ROWS], f"{title},{HEADER}")), PLANT, other_columns=True))


def _written(folder: Path, text: str) -> Path:
    (folder / "log.csv").write_text(text)
    return folder / "log.csv"


def test_parquet_and_arrow_by_their_first_bytes(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
    import pandas

    frame = pandas.DataFrame(np.column_stack([T, VALUES]), columns=HEADER.split(","))
    frame.to_parquet(tmp_path / "log.dat")
    frame.to_feather(tmp_path / "log.csv")
    assert (tmp_path / "log.dat").read_bytes().startswith(PARQUET[:3].upper().encode() + b"1")
    for name in ("log.dat", "log.csv"):
        holds(load_log(tmp_path / name, PLANT))


def test_an_excel_workbook(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl", reason="the extra excel is not installed")
    from datetime import datetime, timedelta

    book = openpyxl.Workbook()
    sheet = book.active
    sheet.title = "Readings"
    for row in (["Export of tank 1"], [], ["Stamp", *NAMES], [None, "K", "Pa", "m", "m3/s"]):
        sheet.append(row)
    for k, row in enumerate(VALUES):
        sheet.append([datetime(2024, 7, 1, 10) + timedelta(seconds=T[k]), *map(float, row)])
    sheet["B9"] = "#N/A"
    book.create_sheet("Notes").append(["made by hand"])
    path = tmp_path / "log.xlsx"
    book.save(path)
    log_map = LogMap(time="Stamp", tz="Europe/Amsterdam", inputs="until the sample")  # type: ignore[arg-type]
    found = load_log(path, PLANT, log_map)
    holds(found, missing=((4, 0),))
    assert found.clock.at(0.0) == "2024-07-01 10:00:00+02:00"
    assert "read from the sheet 'Readings'; the header is row 3; 1 row before it left out" in texts(found, "file")
    assert "1 cell with an error of Excel" in "; ".join(found.remarks)
    with pytest.raises(ValueError, match="has no sheet 'Data'; its sheets are 'Readings', 'Notes'"):
        load_log(path, PLANT, LogMap(sheet="Data"))
    with pytest.raises(ValueError, match="has the sheets 'Readings', 'Notes'; state the one in a map, as in sheet ="):
        load_log(path, PLANT, LogMap(time="Zeit"))  # type: ignore[arg-type]


def test_tdms(tmp_path: Path) -> None:
    nptdms = pytest.importorskip("nptdms", reason="the extra tdms is not installed")
    wave = {"wf_increment": 60.0, "wf_start_time": np.datetime64("2024-07-01T10:00:00"), "wf_start_offset": 0.0}
    units = ["degC", "Pa", "m", "m3/s"]
    numbers = VALUES - [273.15, 0, 0, 0]
    channels = [
        nptdms.ChannelObject("tank", n, numbers[:, i].copy(), {**wave, "unit_string": units[i]}) for i, n in enumerate(NAMES)
    ]
    path = tmp_path / "log.tdms"
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment([*channels, nptdms.ChannelObject("events", "text", np.arange(3.0))])
    found = load_log(path, PLANT, other_columns=True)
    np.testing.assert_allclose(found.log.y, VALUES[:, :3], rtol=1e-14)
    np.testing.assert_array_equal(found.log.t, T)
    assert found.clock.at(0.0) == "2024-07-01 10:00:00+00:00"
    assert "no times of the channels 'text': not used" in texts(found, "ignored")
    with nptdms.TdmsWriter(path) as writer:  # with a channel of times
        writer.write_segment(
            [
                nptdms.ChannelObject("tank", "time", T),
                *(nptdms.ChannelObject("tank", n, VALUES[:, i].copy()) for i, n in enumerate(NAMES)),
            ]
        )
    holds(load_log(path, PLANT))
    path.write_bytes(TDMS.encode()[:2] + b"Sm" + bytes(99))
    with pytest.raises(ValueError, match=r"log.tdms is a TDMS file that npTDMS does not read"):
        load_log(path, PLANT)


def test_mdf(tmp_path: Path) -> None:
    asammdf = pytest.importorskip("asammdf", reason="the extra mdf is not installed")
    from datetime import UTC, datetime

    path = tmp_path / "log.mf4"
    for version in ("4.10", "3.30"):
        with asammdf.MDF(version=version) as mdf:
            mdf.start_time = datetime(2024, 7, 1, 10, tzinfo=UTC)
            units = ["K", "Pa", "m"]
            mdf.append([asammdf.Signal(VALUES[:, i], T, name=NAMES[i], unit=units[i]) for i in range(3)])
            mdf.append([asammdf.Signal(VALUES[::2, 3] * 3600, T[::2], name="feed", unit="m3/h")])
            saved = mdf.save(tmp_path / f"saved{version}.{'mf4' if version[0] == '4' else 'mdf'}", overwrite=True)
        found = load_log(saved, PLANT, LogMap(inputs="until the sample", hold=60))
        np.testing.assert_array_equal(found.log.y, VALUES[:, :3])
        np.testing.assert_allclose(found.log.u[:, 0], np.repeat(VALUES[::2, 3], 2), rtol=1e-14)
        np.testing.assert_array_equal(found.log.t, T)
        assert "the channels have 2 tracks of times" in texts(found, "file")
    path.write_bytes(b"MDF     4.10    asammdf " + bytes(range(256)))
    with pytest.raises(ValueError, match=r"log.mf4 is an MDF file that asammdf does not read"):
        load_log(path, PLANT)


@pytest.mark.parametrize(
    ("column", "cut"),
    [
        ([f"{7 + k / 1000:.3f}" for k in range(30)], ["7.0", "7.", "7"]),
        ([repr(7 + (k + 0.5) ** 0.5) for k in range(60)], ["7.41", "8.1234567"]),
        ([f"{7 + k / 1000:.3f}".rstrip("0") for k in range(1, 200)], ["7.", "7"]),
        ([str(7000 + 7 * k) for k in range(30)], ["70", "7", "71"]),
        ([f"7,{k:03d}" for k in range(30)], ["7,0"]),
        ([str(1000 + k) for k in range(30)], ["1"]),
    ],
)
def test_last_numbers_that_a_line_end_cuts_off(tmp_path: Path, column: list[str], cut: list[str]) -> None:
    """Missing where no other number ends so early; an empty cell, a smaller whole number and a rare state are what they are."""
    from fusion_sfdia.logs.ragged import _cut_numbers

    for number in cut:
        assert _cut_numbers([*column[:9], number, *column[9:]]) == [9]
    for number in ("", "999", "6998") if column[0].isdigit() else ("", column[0], "-" + column[0]):
        assert _cut_numbers([*column[:9], number, *column[9:]]) == []
    assert _cut_numbers(["0.5"] * 30 + ["0"] + ["0.5"] * 9) == []


def test_channels_of_several_rates_in_common_rows(tmp_path: Path) -> None:
    asammdf = pytest.importorskip("asammdf", reason="the extra mdf is not installed")
    with asammdf.MDF(version="4.10") as mdf:
        mdf.append([asammdf.Signal(VALUES[:, i], T, name=NAMES[i]) for i in range(3)])
        mdf.append([asammdf.Signal(np.repeat(VALUES[:, 3], 6), 10.0 * np.arange(6 * K), name="feed")])
        saved = mdf.save(tmp_path / "log.mf4")
    found = load_log(saved, PLANT, LogMap(step=60))
    np.testing.assert_array_equal(found.log.y[:K], VALUES[:, :3])
    assert "step in a map" in texts(found, "file")
