"""All problems of a log in one error: each once, none that follows from another."""

from __future__ import annotations

import json
import pickle
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from fusion_sfdia.cli.main import main
from fusion_sfdia.logs.log_map import Column, LogMap, load_map
from fusion_sfdia.logs.problems import LogError, Problem, Problems
from fusion_sfdia.logs.reading import load_log
from fusion_sfdia.plant.linear import linear_plant
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal


def boiler() -> Plant:
    """Three sensors and two inputs whose readings need no equations."""
    return linear_plant(
        "boiler", 0.9 * np.eye(1), np.ones((3, 1)),
        [Sensor("pressure", "p", "bar", sigma=0.1), Sensor("steam", "q", "kg/s", sigma=0.1),
         Sensor("drum", "T", "degC", sigma=0.1)],
        dt=60.0, x0=np.ones(1), initial_cov=np.ones(1), process_cov=np.ones(1), input_matrix=np.ones((1, 2)),
        inputs=[Signal("feed", "kg/s", 1.0, 0.0, 5.0), Signal("fuel", "kg/s", 1.0, 0.0, 5.0)],
    )  # fmt: skip


PLANT = boiler()
HERE = f"{__file__}:boiler"
GOOD = ["time,pressure,steam,drum,feed,fuel", *(f"{60 * k},10,1,180,1,1" for k in range(8))]


def refused(tmp_path: Path, lines: Sequence[str], log_map: LogMap | None = None) -> tuple[Problem, ...]:
    path = tmp_path / "log.csv"
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(LogError) as caught:
        load_log(path, PLANT, log_map)
    return caught.value.problems


def test_one_run_states_problems_of_every_kind(tmp_path: Path) -> None:
    lines = [
        "time,pressure [furlong],steam,drum,feed,extra",
        "0,10,1,180,1,0",
        "60,10,ERR,180,9,0",
        "180,10,1,18o,,0",
        "120,1o,1,180,,0",
        "180,10,1,180,1,0",
    ]
    found = refused(tmp_path, lines)
    places = {(p.kind, p.row, p.column) for p in found}
    assert places == {
        ("unit", 0, ""),  # furlong
        ("inputs", 0, ""),  # no fuel
        ("columns", 0, ""),  # extra
        ("cells", 5, "pressure [furlong]"),  # also of a column whose unit is refused
        ("cells", 3, "steam"),
        ("cells", 4, "drum"),
        ("order", 5, "time"),
        ("order", 6, "time"),  # 180 s again
        ("inputs", 3, "feed"),  # 9 kg/s
        ("inputs", 5, "feed"),  # missing, in the order of the times
    }
    assert all(p.where == str(tmp_path / "log.csv") for p in found)


def test_problems_of_a_kind_in_a_column_are_counted(tmp_path: Path) -> None:
    lines = [GOOD[0], *(f"{60 * k},10,1,180,{'' if k % 2 else 9},1" for k in range(9))]
    beyond, missing = sorted(refused(tmp_path, lines), key=lambda p: p.row)
    assert (beyond.row, beyond.count, missing.row, missing.count) == (2, 5, 3, 4)
    assert "(and in 4 other rows)" in beyond.text and "(and in 3 other rows)" in missing.text


def test_what_follows_from_another_problem_is_not_one(tmp_path: Path) -> None:
    (unit,) = refused(tmp_path, ["time,pressure [furlong],steam,drum,feed,fuel", *GOOD[1:]])
    assert unit.kind == "unit"  # and pressure is no missing sensor
    (time,) = refused(tmp_path, ["when,pressure,steam,drum,feed,fuel", *GOOD[1:]])
    assert time.kind == "time"  # and when no superfluous column, and 0 no wrong order
    (separator,) = refused(tmp_path, GOOD, LogMap(separator=";"))
    assert separator.kind == "separator"
    (cells,) = refused(tmp_path, [*GOOD[:3], "120,10,1,180,on,1", *GOOD[4:]])
    assert (cells.kind, cells.row, cells.column) == ("cells", 4, "feed")  # and feed is not missing
    (stamps,) = refused(tmp_path, [*GOOD[:3], "soon,10,1,180,1,1", *GOOD[4:]])
    assert (stamps.kind, stamps.row, stamps.column) == ("time", 4, "time")
    columns = {"P1": Column("pressure"), "S": Column("steam"), "T": Column("drum"), "feed": Column(input="feed")}
    columns["fuel"] = Column(input="fuel")
    (title,) = refused(tmp_path, [GOOD[0].replace("pressure,steam,drum", "P2,S,T"), *GOOD[1:]], LogMap(columns=columns))
    assert "'P1', which the map names" in str(title)  # and pressure is no missing sensor


def test_a_map_for_another_plant_and_the_log_are_stated_together(tmp_path: Path) -> None:
    columns = {"a": Column("presure"), "steam": Column(input="steam"), "drum": Column("drum")}
    columns |= {"feed": Column(input="feed"), "fuel": Column(input="fuel")}
    found = refused(tmp_path, ["time,a,steam,drum,feed,fuel", "0,1,1,1,1,x"], LogMap(columns=columns))
    assert [(p.kind, p.column) for p in found] == [("map", ""), ("map", ""), ("sensors", ""), ("cells", "fuel")]
    assert "'presure' for column 'a'" in str(found[0]) and "there it is a sensor" in str(found[1])


def test_missing_inputs_are_not_stated_where_the_mask_is_unknown(tmp_path: Path) -> None:
    lines = [*GOOD[:3], "120,x,1,180,,1", *GOOD[4:]]
    (cells,) = refused(tmp_path, lines, LogMap(mask=("pressure < 1",)))
    assert cells.kind == "cells"


def test_inputs_with_unknown_times_are_missing_only_without_any_value(tmp_path: Path) -> None:
    lines = [*GOOD[:3], "soon,10,1,180,,1", *GOOD[4:]]
    (time,) = refused(tmp_path, lines, LogMap(hold=60.0))
    assert time.kind == "time"
    time, feed = refused(tmp_path, lines)
    assert (feed.row, feed.column) == (4, "feed")


def test_the_columns_of_times_are_named_and_their_order_is_looked_at_in_the_same_run(tmp_path: Path) -> None:
    hours = [f"{day:02d}/01/2025,06:00:00,10,1,180,1,1" for day in (13, 14, 16, 15, 17, 18, 19, 20)]
    lines = [f"Day,Clock,{GOOD[0][5:]}", *hours]
    columns = {name: Column(name) for name in ("pressure", "steam", "drum")}
    columns |= {name: Column(input=name) for name in ("feed", "fuel")}
    time, order = refused(tmp_path, lines, LogMap(columns=columns))
    assert 'time = ["Day", "Clock"], format = "%d/%m/%Y %H:%M:%S"' in time.cure
    assert order.kind == "order" and order.row == 5
    lines = [GOOD[0], *(f"0{day}/02/2025 06:00,10,1,180,1,1" for day in (2, 3, 5, 4))]
    time, order = refused(tmp_path, lines)
    assert (time.kind, time.row, order.kind, order.row) == ("time", 2, "order", 5)


def test_a_log_in_which_everything_is_otherwise_is_stated_in_one_run(tmp_path: Path) -> None:
    rows = [f"{13 + k}/02/2025 06:00;1{k},5;1,0;180,0;1,0;1,0" for k in range(8)]
    rows[3] = rows[3].replace("180,0", "Störung")
    rows[5], rows[6] = rows[6], rows[5]
    text = "\n".join(["Kessel Süd", "Zeit;pressure;steam;drum;feed;fuel", *rows]) + "\n"
    (tmp_path / "log.csv").write_bytes(text.encode("cp1252"))
    with pytest.raises(LogError) as caught:
        load_log(tmp_path / "log.csv", PLANT)
    stated = str(caught.value)
    for cure in ("encoding", 'format = "%d/%m/%Y %H:%M"', 'decimal = ","', 'order = "sort"', "bad = ["):
        assert cure in stated, cure
    assert len(stated.splitlines()) <= 7


def test_a_title_with_its_unit_in_the_map_is_in_that_unit(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("time,P [kPa],steam,drum [K],feed,fuel\n0,1000,1,453.15,1,1\n60,1000,1,453.15,1,1\n")
    columns = {"P [kPa]": Column("pressure"), "steam": Column("steam"), "drum [K]": Column("drum")}
    columns |= {name: Column(input=name) for name in ("feed", "fuel")}
    assert load_log(path, PLANT, LogMap(columns=columns)).log.y[0] == pytest.approx([10.0, 1.0, 180.0])


def test_cells_of_columns_that_are_probably_meant_are_looked_at(tmp_path: Path) -> None:
    lines = [GOOD[0].replace("pressure", "presure"), *GOOD[1:4], "180,ERR,1,180,1,1", *GOOD[5:]]
    found = refused(tmp_path, lines)
    assert [(p.kind, p.row, p.column) for p in found] == [("sensors", 0, ""), ("columns", 0, ""), ("cells", 5, "presure")]
    columns = {name: Column(name) for name in ("pressure", "steam", "drum")}
    columns |= {name: Column(input=name) for name in ("feed", "fuel")}
    found = refused(tmp_path, lines, LogMap(columns=columns))
    assert [(p.kind, p.row, p.column) for p in found] == [("columns", 0, ""), ("cells", 5, "presure")]
    assert "did you mean 'presure' for 'pressure'" in str(found[0])


def test_all_problems_of_a_map_are_stated_at_once(tmp_path: Path) -> None:
    path = tmp_path / "map.toml"
    path.write_text(
        '[log]\ntme = "t"\nseparator = "::"\ntz = "Mars/Olympus"\ndecimal = ","\nthousands = "."\ntag = "Tag"\n'
        'value = "Value"\nquality = "Q"\n[columns]\na = { sensr = "x", sensor = "y" }\nb = { sensor = "x", scale = 0 }\nc = 1\n'
        "[extra]\n"
    )
    with pytest.raises(LogError) as caught:
        load_map(path)
    texts = [p.text for p in caught.value.problems]
    assert [t.partition(";")[0][:24] for t in texts] == [
        "unknown key 'extra'", "column 'a': unknown key ", "column 'b': scale is 0", "column 'c': 1", "[log] unknown key 'tme'",
        "separator is '::'", "tz is 'Mars/Olympus'",
    ]  # fmt: skip
    path.write_text('[log]\nthousands = "."\n')
    with pytest.raises(LogError, match=r"map.toml: decimal and thousands are both '.'; give each its own"):
        load_map(path)
    path.write_text('[log]\n[columns]\na = { sensor = "x" }\nb = { sensor = "x" }\n')
    with pytest.raises(LogError, match="the columns 'a' and 'b' are both 'x'"):
        load_map(path)


def test_a_long_table_states_columns_and_tags_together(tmp_path: Path) -> None:
    log_map = LogMap(tag="tag", value="value", columns={"p": Column("pressure"), "s": Column("steam", unit="m")})
    found = refused(tmp_path, ["stamp,tag,value", "0,p,1", "0,s,1", "60,p,x"], log_map)
    assert [p.kind for p in found] == ["columns", "unit", "sensors", "inputs", "cells"]
    assert found[-1].row == 4


def test_columns_with_the_same_problem_share_a_line_and_one_problem_is_as_it_was() -> None:
    problems = Problems("log.csv")
    for k, column in enumerate(("a", "b", "c")):
        problems.add("cells", f"'x{k}'; expected a number", row=k + 2, column=column)
    with pytest.raises(LogError) as caught:
        problems.require_none()
    assert str(caught.value) == "log.csv: 3 problems\n  3 columns (a, b, c), first row 2, column a: 'x0'; expected a number"
    assert str(LogError([problems.problems[0]])) == "log.csv, row 2, column a: 'x0'; expected a number"
    cures = ["".join(chr(97 + (k // 26**i) % 26) for i in range(2)) for k in range(500)]
    many = LogError([Problem("cells", "log.csv", k, f"c{k}", 1, "'x'", cures[k]) for k in range(500)])
    assert str(many).count("\n") == 30 and str(many).endswith("and 471 more problems")
    assert str(pickle.loads(pickle.dumps(many))) == str(many)


@pytest.mark.parametrize(
    ("text", "row", "column", "message"),
    [
        ("log.csv, row 3, column a: b: 'x'; expected y", 3, "a: b", "'x'; expected y"),
        ("log.csv, column a: b: 'x'", 0, "a: b", "'x'"),
        ("log.csv: the row; below", 0, "", "the row; below"),
        ("log.csv, row 12, column time: 1 s after 2 s; sort", 12, "time", "1 s after 2 s; sort"),
        ("another file: x; y", 0, "", "another file: x; y"),
    ],
)
def test_an_error_on_a_place_is_taken_apart(text: str, row: int, column: str, message: str) -> None:
    found = Problem.of("cells", "log.csv", ValueError(text), "a: b")
    assert (found.row, found.column, found.message) == (row, column, message)
    assert str(found) == text


def test_the_command_prints_problems_as_lines_and_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "log.csv"
    path.write_text("\n".join([GOOD[0].replace(",fuel", ""), "0,x,1,180,1", "60,1,1,180,"]) + "\n")
    given = ["check-log", "--plant", HERE, "--data", str(path)]
    assert main(given) == 2
    printed, err = capsys.readouterr()
    assert printed == "" and len(err.splitlines()) == 4 and "log.csv: 3 problems" in err
    assert main([*given, "--json"]) == 2
    found = json.loads(capsys.readouterr().out)
    assert [(p["kind"], p["row"], p["column"]) for p in found] == [
        ("inputs", 0, ""),
        ("cells", 2, "pressure"),
        ("inputs", 3, "feed"),
    ]
    assert all(p["cure"] for p in found)
