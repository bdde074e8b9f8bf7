"""What a map states is done, and said among the findings."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_plants import Array, tanks

from fusion_sfdia.common.errors import MissingPackageError
from fusion_sfdia.logs.loaded_log import LoadedLog
from fusion_sfdia.logs.log_forms import as_log
from fusion_sfdia.logs.log_map import Column, LogMap
from fusion_sfdia.logs.reading import load_log
from fusion_sfdia.plant.signals import Signal

PLANT = tanks()
TITLES = ["time", "l1", "l2", "q12", "q2", "inflow"]
RNG = np.random.default_rng(0)
T = 5.0 * np.arange(1, 9)
Y = np.round(np.array([1.0, 1.0, 6e-4, 6e-4]) * (1 + 0.01 * RNG.standard_normal((8, 4))), 8)
U = np.round(6e-4 * (1 + 0.01 * RNG.standard_normal(8)), 8)


def rows() -> list[list[Any]]:
    return [[t, *y, u] for t, y, u in zip(T.tolist(), Y.tolist(), U.tolist(), strict=True)]


def load(folder: Path, cells: list[list[Any]], *, titles: list[str] = TITLES, **log_map: Any) -> LoadedLog:
    path = folder / "log.csv"
    path.write_text("\n".join(",".join(map(str, row)) for row in [titles, *cells]) + "\n", encoding="utf-8")
    return load_log(path, PLANT, LogMap(**log_map))


def words(found: LoadedLog, kind: str) -> list[str]:
    return [f.text for f in found.findings if f.kind == kind]


def test_inputs_act_from_their_row_or_acted_until_it(tmp_path: Path) -> None:
    found = load(tmp_path, rows())
    np.testing.assert_array_equal(found.log.u[:, 0], [U[0], *U[:-1]])
    assert "acting from their row until the next" in words(found, "inputs shifted")[0]
    until = load(tmp_path, rows(), inputs="until the sample")
    np.testing.assert_array_equal(until.log.u[:, 0], U)
    assert "having acted until their row" in words(until, "inputs")[0]
    assert words(load_log(tmp_path / "log.csv", PLANT), "inputs") == words(until, "inputs")  # without a map
    for mine, expected in zip(found.log[:2], (T, Y), strict=True):
        np.testing.assert_array_equal(mine, expected)


def test_rows_of_one_time_that_lack_each_others_readings_are_one(tmp_path: Path) -> None:
    """As where each tag writes a row of its own, by stamps of whole seconds."""
    cells = rows()
    row = cells[2]
    parts = [[row[0], *("" if j != i else v for j, v in enumerate(row[1:]))] for i in range(len(row) - 1)]
    found = load(tmp_path, [*cells[:2], *parts, *cells[3:]])
    whole = load(tmp_path, cells)
    np.testing.assert_array_equal(found.log.y, whole.log.y)
    np.testing.assert_array_equal(found.log.u, whole.log.u)
    (text,) = words(found, "duplicates")
    assert text.startswith(f"{len(parts) - 1} rows joined with the one before of the same time")


@pytest.mark.parametrize(("rule", "expected"), [("first", 1.0), ("last", 3.0), ("mean", 2.0)])
def test_duplicates(tmp_path: Path, rule: str, expected: float) -> None:
    cells = rows()
    cells[2][1] = 1.0
    cells[3:3] = [[*cells[2][:1], 3.0, *cells[2][2:]], [*cells[2][:1], "", *cells[2][2:]]]
    found = load(tmp_path, cells, duplicates=rule)
    assert found.log.t.tolist() == T.tolist() and found.log.y[2, 0] == expected
    assert words(found, "duplicates")[0].startswith("2 duplicates ")
    with pytest.raises(
        ValueError,
        match=r"row 5, column time: 15\.0 s again, as in row 4 \(and in 1 other row\); .* keep one row of each time, or",
    ):
        load(tmp_path, cells)


def test_row_order(tmp_path: Path) -> None:
    found = load(tmp_path, rows()[::-1], order="sort")
    np.testing.assert_array_equal(found.log.y, Y)
    assert words(found, "order") == ["rows sorted by time: the newest came first"]
    with pytest.raises(
        ValueError,
        match=r"row 3, column time: 35\.0 s after 40\.0 s \(and in 6 other rows\); times must increase: sort the rows",
    ):
        load(tmp_path, rows()[::-1], duplicates="last")


def test_a_missing_input_is_held_for_as_long_as_stated(tmp_path: Path) -> None:
    cells = rows()
    for k in (2, 3):
        cells[k][5] = ""
    found = load(tmp_path, cells, hold=10.0, inputs="until the sample")
    np.testing.assert_array_equal(found.log.u[:, 0], [U[0], U[1], U[1], U[1], *U[4:]])
    assert words(found, "held") == ["2 inflow values held"]
    with pytest.raises(ValueError, match=r"row 5, column inflow: ''; expected a finite number: .* longer than hold, 9 s"):
        load(tmp_path, cells, hold=9.0, inputs="until the sample")
    with pytest.raises(
        ValueError, match=r"row 4, column inflow: '' \(and in 1 other row\); expected a finite number: .* state hold in a map"
    ):
        load(tmp_path, cells)
    cells[0][5] = ""
    early = load(tmp_path, cells, hold=True)
    np.testing.assert_array_equal(early.log.t, T[2:])
    assert words(early, "left out") == ["2 rows before the first value of each input left out"]


def test_masked_rows_are_missing_readings_or_left_out(tmp_path: Path) -> None:
    cells = rows()
    cells[3][5] = 1e-4
    found = load(tmp_path, cells, mask="inflow < 3e-4")
    assert np.isnan(found.log.y).any(axis=1).tolist() == [k == 3 for k in range(8)]
    assert words(found, "masked") == ["1 row masked by inflow < 3e-4: readings taken as missing"]
    cells[3][5] = -1.0  # beyond the limits of the model: as the input of row 4, too
    found = load(tmp_path, cells, mask=("inflow < 3e-4", "l1 > 5"))
    np.testing.assert_array_equal(found.log.t, np.delete(T, 4))
    assert words(found, "masked")[0].endswith("1 row left out, whose input is missing or beyond its limits")
    with pytest.raises(ValueError, match="mask inflow < 5 holds in every row; it compares in the units of the log"):
        load(tmp_path, cells, mask="inflow < 5")
    with pytest.raises(ValueError, match="mask 'load < 5' compares 'load', which is no column"):
        load(tmp_path, cells, mask="load < 5")


def test_a_mask_by_a_column_that_is_nothing_else(tmp_path: Path) -> None:
    cells = [[*row, 10.0 * (k != 6)] for k, row in enumerate(rows())]
    found = load(tmp_path, cells, titles=[*TITLES, "load"], mask="load < 5", columns={"inflow": Column(input="inflow")})
    assert np.isnan(found.log.y).all(axis=1).tolist() == [k == 6 for k in range(8)]


def test_mask_compares_in_the_units_of_the_log(tmp_path: Path) -> None:
    cells = rows()
    for row in cells:
        row[5] *= 3600.0
    cells[2][5] = 1.0
    found = load(tmp_path, cells, mask="inflow < 1.5", columns={"inflow": Column(input="inflow", unit="m3/h")})
    assert np.isnan(found.log.y).all(axis=1).tolist() == [k == 2 for k in range(8)]
    np.testing.assert_allclose(found.log.u[1:3, 0], U[:2], rtol=1e-14)


def test_quality_needs_a_rule_for_numbers(tmp_path: Path) -> None:
    titles = [*TITLES, "q"]
    column = {"l1": Column(sensor="l1", quality="q")}
    codes = [[*row, 0 if k == 1 else 192] for k, row in enumerate(rows())]
    found = load(tmp_path, codes, titles=titles, columns=column, good=(192,))
    assert np.isnan(found.log.y[:, 0]).tolist() == [k == 1 for k in range(8)]
    assert words(found, "quality") == ["l1: 1 value not of good quality, taken as missing"]
    with pytest.raises(ValueError, match="row 2, column q: '192' as quality; state which codes are good: good = \"opc-da\""):
        load(tmp_path, codes, titles=titles, columns=column)
    named = [[*row, "Uncertain" if k == 1 else "Good"] for k, row in enumerate(rows())]
    assert np.isnan(load(tmp_path, named, titles=titles, columns=column).log.y[:, 0]).sum() == 1
    with pytest.raises(ValueError, match="no column 'r' with the quality of 'l1'; correct the map"):
        load(tmp_path, named, titles=titles, columns={"l1": Column(sensor="l1", quality="r")})


def test_columns_of_the_map_are_those_of_log_and_plant(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no columns 'L1', which the map names, among 'time', 'l1'"):
        load(tmp_path, rows(), columns={"L1": Column(sensor="l1")})
    titles = ["time", "l1", "LIC102.PV", *TITLES[3:]]
    with pytest.raises(ValueError, match=r"; did you mean 'LIC102.PV' for 'LI102.PV'\? correct the map$"):
        load(tmp_path, rows(), titles=titles, columns={"LI102.PV": Column(sensor="l2")})
    with pytest.raises(ValueError, match=r"; correct the map, or leave out of it what is not logged and give --absent-sensors"):
        load(tmp_path, rows(), titles=titles, columns={"F30": Column(sensor="l2")})
    with pytest.raises(ValueError, match="the map has the sensor 'l9' for column 'l1'; sensors of plant 'two-tanks': 'l1'"):
        load(tmp_path, rows(), columns={"l1": Column(sensor="l9")})
    with pytest.raises(ValueError, match="the map has the sensor 'inflow'"):
        load(tmp_path, rows(), columns={"inflow": Column(sensor="inflow")})
    titles = [*TITLES, "weather"]
    cells = [[*row, "fine"] for row in rows()]
    found = load(tmp_path, cells, titles=titles, columns={"l1": Column(sensor="l1")})
    assert words(found, "ignored") == ["1 column not used: 'weather'"]
    with pytest.raises(ValueError, match=r"the columns 'weather' are no sensors or inputs .*--other-columns"):
        load(tmp_path, cells, titles=titles)


def test_an_input_in_another_unit_is_named_as_such(tmp_path: Path) -> None:
    cells = rows()
    for row in cells:
        row[5] *= 3600.0
    with pytest.raises(ValueError, match=r"row 2, column inflow: .*inflow looks 3600 times too large \(per hour\?\)"):
        load(tmp_path, cells)


def test_the_overview(tmp_path: Path) -> None:
    cells = [row for k, row in enumerate(rows()) if k not in (4, 5)]
    for row in cells:
        row[0] = f"2026-03-01 14:20:{int(row[0]):02d}"
        row[2] = ""
    cells[1][3] = ""
    found = load(tmp_path, cells, tz="Europe/Amsterdam")
    assert found.clock.at(5.0) == "2026-03-01 14:20:10+01:00"
    assert str(found).splitlines() == [
        "6 rows from 2026-03-01 14:20:05+01:00 to 2026-03-01 14:20:40+01:00, usually 5 s apart; times are stamps of "
        "Europe/Amsterdam",
        "1 gap without rows, the longest 15 s after 2026-03-01 14:20:20+01:00",
        "no reading of 'l2'",
        "1 reading missing, of 1 sensor",
        'inputs taken as acting from their row until the next (inputs = "at the sample", as historians log them)',
    ]
    assert found.remarks == (str(found).splitlines()[-1],)


def test_times_in_another_unit_are_suspected(tmp_path: Path) -> None:
    cells = [[1e3 * row[0], *row[1:]] for row in rows()]
    (text,) = words(found := load(tmp_path, cells), "time unit suspected")
    assert found.misread and text in found.remarks
    assert text.startswith(
        "rows are 5000 s apart, the readings of plant 'two-tanks' 5 s: are the times in seconds? They may be "
    )
    assert 'format = "ms" (5 s after a start, rows 5 s apart)' in text
    assert load(tmp_path, cells, format="ms").log.t.tolist() == T.tolist()


def test_a_frame_a_parquet_file_and_csv_are_one(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(rows(), columns=TITLES)
    frame.to_parquet(tmp_path / "log.parquet")
    frame.to_csv(tmp_path / "log.csv", index=False)
    logs = [load_log(source, PLANT).log for source in (frame, tmp_path / "log.parquet", tmp_path / "log.csv")]
    for log in logs:
        for mine, expected in zip(log, (T, Y, U[:, None]), strict=True):
            np.testing.assert_array_equal(mine, expected)


def test_frames_of_arrow_and_polars_are_those_of_pandas() -> None:
    pandas, arrow = pytest.importorskip("pandas"), pytest.importorskip("pyarrow")
    frame = pandas.DataFrame(rows(), columns=TITLES)
    frame.iloc[3, 1] = np.nan
    others = [arrow.Table.from_pandas(frame)]
    with suppress(ModuleNotFoundError):
        others.append(import_module("polars").DataFrame({title: frame[title].to_numpy() for title in TITLES}))
    expected = load_log(frame, PLANT)
    for other in others:
        for mine, theirs in zip(load_log(other, PLANT).log, expected.log, strict=True):
            np.testing.assert_array_equal(mine, theirs)
        assert as_log(PLANT, other).y.tolist()[4:] == expected.log.y.tolist()[4:]
    turned = arrow.table({s.name: Y[:, i] for i, s in reversed([*enumerate(PLANT.sensors)])})
    np.testing.assert_array_equal(as_log(PLANT, T, turned, U[:, None]).y, Y)  # by name


def test_parquet_that_is_none_and_without_its_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "log.parquet").write_text("time,l1\n")
    with pytest.raises(ValueError, match=r"log.parquet is not a Parquet file \(.*\); expected one, or name a CSV file .csv"):
        load_log(tmp_path / "log.parquet", PLANT)
    import pandas

    def none(*_: object, **__: object) -> None:
        raise ImportError("pyarrow")

    monkeypatch.setattr(pandas, "read_parquet", none)
    with pytest.raises(MissingPackageError, match=r"needs pyarrow, .* install fusion-sfdia\[parquet\], or export .* as CSV"):
        load_log(tmp_path / "log.parquet", PLANT)


def test_a_damaged_workbook_is_refused_with_the_cure(tmp_path: Path) -> None:
    (tmp_path / "log.xlsx").write_bytes(b"PK\x03\x04\xff\xff")
    with pytest.raises(ValueError, match="is an Excel workbook that is damaged; copy it again, or save it as CSV"):
        load_log(tmp_path / "log.xlsx", PLANT)


def test_nominal_inputs_are_only_used_where_that_is_asked_for(tmp_path: Path) -> None:
    cells = [row[:-1] for row in rows()]
    with pytest.raises(ValueError, match="no column for the inputs 'inflow'"):
        load(tmp_path, cells, titles=TITLES[:-1])
    found = load_log(tmp_path / "log.csv", PLANT, nominal_inputs=True)
    assert words(found, "nominal inputs")[0].startswith("no column for the inputs 'inflow'; the nominal values")
    np.testing.assert_array_equal(found.log.u, 6e-4)


def test_a_unit_that_does_not_convert_is_refused(tmp_path: Path) -> None:
    plant = replace(PLANT, inputs=(Signal("inflow", "pint of beer", 6e-4),))
    path = tmp_path / "log.csv"
    path.write_text("time,l1,l2,q12,q2,inflow [m3/s]\n1,1,1,1,1,1\n")
    with pytest.raises(ValueError, match="'inflow' is in 'm3/s', plant 'two-tanks' has it in 'pint of beer'"):
        load_log(path, plant)
    path.write_text("time,l1 [%],l2 [%],q12 [rpm],q2,inflow\n1,1,1,1,1,1\n")
    with pytest.raises(ValueError, match=r"columns 'l1', 'l2' are in '%', .* for 4 m\n  column 'q12' is in 'rpm', "):
        load_log(path, PLANT)


@pytest.mark.parametrize("left_out", ["separator", "preamble", "both"])
def test_a_separator_and_a_preamble_that_no_map_states_are_found(tmp_path: Path, left_out: str) -> None:
    (tmp_path / "log.csv").write_text("Plant historian\nof tank 1\ntime;l1;l2\n0;50,1;50,2\n1;50,1;50,2\n")
    stated = {k: v for k, v in {"separator": ";", "preamble": 2}.items() if left_out not in (k, "both")}
    options = {"absent_sensors": True, "nominal_inputs": True}
    found = load_log(tmp_path / "log.csv", PLANT, LogMap(decimal=",", **stated), **options)
    np.testing.assert_array_equal(found.log.y[:, :2], [[50.1, 50.2]] * 2)
    texts = words(found, "file")
    assert ("cells are separated by ';'" in texts) == (left_out != "preamble")
    assert ("the header is line 3; 2 lines before it left out" in texts) == (left_out != "separator")


def test_long_format_duplicates_and_unknown_tags(tmp_path: Path) -> None:
    cells = [[row[0], tag, value] for row in rows() for tag, value in zip(TITLES[1:], row[1:], strict=True)]
    titles = ["time", "tag", "value"]
    found = load(tmp_path, cells, titles=titles, tag="tag", value="value", inputs="until the sample")
    expected: tuple[Array, ...] = (T, Y, U[:, None])
    for mine, right in zip(found.log, expected, strict=True):
        np.testing.assert_array_equal(mine, right)
    with pytest.raises(ValueError, match=r"row 3, column time: 5\.0 s of l1 again; .* keep one row of each time"):
        load(tmp_path, [cells[0], *cells], titles=titles, tag="tag", value="value")
    with pytest.raises(ValueError, match="no column 'Tag' among 'time', 'tag', 'value'; correct the map"):
        load(tmp_path, cells, titles=titles, tag="Tag", value="value")
