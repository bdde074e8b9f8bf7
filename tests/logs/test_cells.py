"""What cells state: units, states, truth values and quality; the same log in every form it has."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from fusion_sfdia.learning.monitor.unmodelled_logs import load, signals_of
from fusion_sfdia.live.text_rows import TextRows
from fusion_sfdia.logs.columns import split_title
from fusion_sfdia.logs.loaded_log import LoadedLog
from fusion_sfdia.logs.log_map import Column, LogMap, load_map
from fusion_sfdia.logs.reading import load_log
from fusion_sfdia.logs.single_rows import row_reader
from fusion_sfdia.plant.linear import linear_plant
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal


def pump(names: Sequence[str] = ("level", "flow"), inputs: Sequence[Signal] = (Signal("power", "W", 2000.0),)) -> Plant:
    """Readings in m and m3/s that need no equations, and an input in W of which 2000 is usual."""
    return linear_plant(
        "pump", 0.9 * np.eye(1), np.ones((2, 1)),
        [Sensor(names[0], "h", "m", sigma=0.1), Sensor(names[1], "q", "m3/s", sigma=0.1)],
        dt=60.0, x0=np.ones(1), initial_cov=np.ones(1), process_cov=np.ones(1), input_matrix=np.ones((1, len(inputs))),
        inputs=inputs,
    )  # fmt: skip


PLANT = pump()
RATED = {name: Column(sensor=name, quality=f"{name}.Q") for name in ("level", "flow")}
POWER = {"level": Column(sensor="level"), "flow": Column(sensor="flow")}


def write(tmp_path: Path, columns: Mapping[str, Sequence[Any]], separator: str = ",") -> Path:
    path = tmp_path / "log.csv"
    rows = [[str(60 * k), *map(str, cells)] for k, cells in enumerate(zip(*columns.values(), strict=True))]
    path.write_text("\n".join(separator.join(row) for row in [["time", *columns], *rows]) + "\n", encoding="utf-8")
    return path


def log(tmp_path: Path, cells: Mapping[str, Sequence[Any]], **stated: Any) -> LoadedLog:
    return load_log(write(tmp_path, cells), PLANT, LogMap(inputs="until the sample", **stated))


def refusal(tmp_path: Path, cells: Mapping[str, Sequence[Any]], **stated: Any) -> str:
    with pytest.raises(ValueError) as caught:
        log(tmp_path, cells, **stated)
    return str(caught.value)


def found(read: LoadedLog, kind: str) -> list[str]:
    return [f.text for f in read.findings if f.kind == kind]


# units in cells


def test_a_unit_in_each_cell_is_that_of_the_column(tmp_path: Path) -> None:
    read = log(tmp_path, {"level": ["1200 mm", "", "1100 mm"], "flow": ["36 m³/h"] * 3, "power": ["2 kW", "1.5 kW", "2 kW"]})
    np.testing.assert_allclose(read.log.y, [[1.2, 0.01], [np.nan, 0.01], [1.1, 0.01]], rtol=1e-14)
    np.testing.assert_allclose(read.log.u[:, 0], [2000, 1500, 2000], rtol=1e-14)
    assert [c.unit for c in read.columns] == ["mm", "m³/h", "kW"]
    assert found(read, "cell unit") == ["units as the cells state them: mm of 'level', m³/h of 'flow', kW of 'power'"]
    assert not found(read, "mixed units")


def test_cells_in_several_units_of_one_dimension_count_each_in_its_own(tmp_path: Path) -> None:
    """As a dashboard scales them: 800 W, 1.2 kW."""
    read = log(tmp_path, {"level": ["1 m"] * 4, "flow": [0.1] * 4, "power": ["800 W", "1.2 kW", "1.1 kW", "0.002 MW"]})
    np.testing.assert_allclose(read.log.u[:, 0], [800, 1200, 1100, 2000], rtol=1e-14)
    (text,) = found(read, "mixed units")
    assert text == "power: units behind the numbers are W (1), kW (2), MW (1); each cell counts in its own"
    assert text in read.remarks


def test_a_unit_of_the_cell_counts_before_that_of_the_title(tmp_path: Path) -> None:
    read = log(tmp_path, {"level": [1] * 3, "flow": [0.1] * 3, "power [W]": ["1.2 kW", "1.1 kW", "900"]})
    np.testing.assert_allclose(read.log.u[:, 0], [1200, 1100, 900], rtol=1e-14)
    assert found(read, "mixed units") == [
        "power [W]: units behind the numbers are kW (2), none, so W (1); each cell counts in its own"
    ]


def test_offsets_of_cells_in_several_units(tmp_path: Path) -> None:
    plant = linear_plant(
        "room", np.eye(1), np.ones((1, 1)), [Sensor("T", "T", "K", sigma=0.1)], dt=60.0, x0=np.ones(1),
        initial_cov=np.ones(1), process_cov=np.ones(1),
    )  # fmt: skip
    path = write(tmp_path, {"T": ["20 °C", "68 °F", "293.15 K", "20.0°C"]})
    np.testing.assert_allclose(load_log(path, plant).log.y, np.full((4, 1), 293.15), rtol=1e-14)


@pytest.mark.parametrize(
    ("power", "words"),
    [
        (["2 kW", "2000", "2 kW"], "row 3, column power: '2000' states no unit, where other cells state kW"),
        (["2000", "2000", "2 kW"], "row 4, column power: '2 kW' states kW, where other cells state none"),
        (
            ["2 kW", "2 kg", "2 kW"],
            "row 3, column power: '2 kg'; expected a finite number, alone or with its unit: unit 'kg' does not convert to 'W'",
        ),
        (
            ["2 kW", "2 Bad", "2 kW"],
            "'2 Bad'; expected a finite number, alone or with its unit: unit 'Bad' does not convert to 'W'",
        ),
        (
            ["2 dBm", "2 dBm", "2 dBm"],
            "unit 'dBm' does not convert to 'W': dBm is a logarithm",
        ),
        (["2 Nm3/h", "2 W", "2 W"], "unit 'Nm3/h' does not convert"),
    ],
)
def test_units_of_cells_that_do_not_fit_are_refused(tmp_path: Path, power: list[str], words: str) -> None:
    assert words in refusal(tmp_path, {"level": [1] * 3, "flow": [0.1] * 3, "power": power})


def test_units_in_the_cells_of_a_long_format(tmp_path: Path) -> None:
    path = tmp_path / "long.csv"
    lines = ["time,tag,value"]
    for k in range(3):
        lines += [f"{60 * k},LT,{1200 + k} mm", f"{60 * k},FT,36 m3/h", f"{60 * k},JT,{'On' if k else 'Off'}"]
    path.write_text("\n".join(lines) + "\n")
    columns = {
        "LT": Column(sensor="level"),
        "FT": Column(sensor="flow"),
        "JT": Column(input="power", unit="kW", states={"on": 2, "off": 0}),
    }
    read = load_log(path, PLANT, LogMap(tag="tag", value="value", columns=columns, inputs="until the sample"))
    np.testing.assert_allclose(read.log.y, [[1.2, 0.01], [1.201, 0.01], [1.202, 0.01]], rtol=1e-14)
    np.testing.assert_allclose(read.log.u[:, 0], [0, 2000, 2000])
    path.write_text(path.read_text().replace("On", "Tripped"))
    with pytest.raises(ValueError, match=r"row 7, column value: 'Tripped'; expected a number or a state that states has, 'on'"):
        load_log(path, PLANT, LogMap(tag="tag", value="value", columns=columns, inputs="until the sample"))


# states


STATES: list[tuple[dict[Any, float], list[Any], list[float]]] = [
    ({"On": 2000.0, "Off": 0.0}, ["On", "off", "ON "], [2000, 0, 2000]),
    ({"on": 2000.0}, ["On", "1500", "ON"], [2000, 1500, 2000]),  # numbers beside a word are numbers
    ({"TRUE": 1.0, "FALSE": 0.0}, ["True", "false", "TRUE"], [1, 0, 1]),
    ({True: 2000.0, False: 0.0}, [True, False, True], [2000, 0, 2000]),
    ({"true": 2000.0, "false": 0.0}, [1, 0, 1], [2000, 0, 2000]),
    ({"0": 0.0, "1": 1000.0, "2": 2000.0}, ["2", "1", "0"], [2000, 1000, 0]),
    ({0: 0.0, 1: 1000.0, 2: 2000.0}, [2.0, 1.0, 0.0], [2000, 1000, 0]),
]


@pytest.mark.parametrize(("states", "cells", "expected"), STATES)
def test_states_are_numbers(tmp_path: Path, states: dict[Any, float], cells: list[Any], expected: list[float]) -> None:
    columns = POWER | {"power": Column(input="power", states=states)}
    read = log(tmp_path, {"level": [1] * 3, "flow": [0.1] * 3, "power": cells}, columns=columns)
    assert read.log.u[:, 0].tolist() == expected
    frame = pd.DataFrame({"time": [0.0, 60.0, 120.0], "level": 1.0, "flow": 0.1, "power": cells})
    assert load_log(frame, PLANT, LogMap(inputs="until the sample", columns=columns)).log.u[:, 0].tolist() == expected
    frame.to_parquet(tmp_path / "log.parquet")
    read = load_log(tmp_path / "log.parquet", PLANT, LogMap(inputs="until the sample", columns=columns))
    assert read.log.u[:, 0].tolist() == expected
    rows = row_reader(PLANT, LogMap(columns=columns), ["time", "level", "flow", "power"])
    assert [rows.values({"level": 1, "flow": 0.1, "power": c})[1][0] for c in cells] == expected


def test_states_count_in_the_unit_and_scale_of_the_column(tmp_path: Path) -> None:
    columns = POWER | {"power": Column(input="power", unit="kW", scale=0.5, states={"On": 4, "Off": 0})}
    assert log(tmp_path, {"level": [1], "flow": [0.1], "power": ["On"]}, columns=columns).log.u[0, 0] == 2000.0


def test_states_beside_bad_texts_and_of_a_sensor(tmp_path: Path) -> None:
    columns = POWER | {"level": Column(sensor="level", states={"high": 2.0, "low": 0.5}), "power": Column(input="power")}
    cells = {"level": ["High", "Bad", "low"], "flow": [0.1] * 3, "power": [1] * 3}
    read = log(tmp_path, cells, columns=columns, bad=["Bad"])
    np.testing.assert_array_equal(read.log.y[:, 0], [2.0, np.nan, 0.5])


def test_states_in_a_map_file(tmp_path: Path) -> None:
    path = tmp_path / "map.toml"
    path.write_text('[columns]\npower = { input = "power", states = { On = 2000, "Stand by" = 50.5 } }\n')
    assert load_map(path).columns["power"].states == {"On": 2000, "Stand by": 50.5}
    for wrong, words in (
        ('"On"', "expected a number for each text"),
        ('{ On = "2" }', "the number of state 'On' is '2'"),
        ("{ On = inf }", "expected a finite one"),
        ('{ " " = 1 }', "expected the text of a state"),
        ("{ On = 1, ON = 2 }", "the states 'On' and 'ON' are the same"),
        ("{ true = 1, 1 = 2 }", "the states 'true' and '1' are the same"),
    ):
        path.write_text(f'[columns]\npower = {{ input = "power", states = {wrong} }}\n')
        with pytest.raises(ValueError, match=re.escape(words)):
            load_map(path)


@pytest.mark.parametrize(
    ("cells", "line"),
    [
        (["On", "Off", "On"], 'power = { input = "power", states = { On = 2000, Off = 0 } }'),
        (["TRUE", "FALSE", "TRUE"], 'power = { input = "power", states = { TRUE = 2000, FALSE = 0 } }'),
        (["Stand by", "Run", "Stand by"], 'power = { input = "power", states = { Run = 0, "Stand by" = 1 } }'),
        (["On", "1500", "On"], 'power = { input = "power", states = { On = 2000 } }'),
    ],
)
def test_the_refusal_of_an_inputs_texts_has_the_line_of_their_states(tmp_path: Path, cells: list[str], line: str) -> None:
    columns = {"level": [1] * 3, "flow": [0.1] * 3, "power": cells}
    message = refusal(tmp_path, columns)
    assert f"state numbers for its states in a map, as in {line} with yours in W" in message
    assert ("bad = " in message) == ("1500" in cells)  # a text beside numbers may mark a missing value
    column = Column(**tomllib.loads(line)["power"])
    assert np.isfinite(log(tmp_path, columns, columns=POWER | {"power": column}).log.u).all()


def test_a_status_is_not_given_numbers(tmp_path: Path) -> None:
    message = refusal(tmp_path, {"level": ["Bad"] * 3, "flow": [0.1] * 3, "power": [1] * 3})
    assert "this is a status, not numbers" in message and "leave the column out" in message
    assert 'bad = ["Bad"]' in message and "states" not in message


def test_the_line_is_in_the_unit_of_the_column(tmp_path: Path) -> None:
    columns = {"level": [1] * 2, "flow": [0.1] * 2, "JT 1 [kW]": ["On", "Off"]}
    message = refusal(tmp_path, columns, columns=POWER | {"JT 1": Column(input="power")})
    assert '"JT 1 [kW]" = { input = "power", unit = "kW", states = { On = 2, Off = 0 } } with yours in kW' in message


def test_an_unknown_state_is_refused_with_what_occurs(tmp_path: Path) -> None:
    columns = POWER | {"power": Column(input="power", states={"On": 1.0, "Off": 0.0})}
    message = refusal(tmp_path, {"level": [1] * 4, "flow": [0.1] * 4, "power": ["On", "Trip", "Auto", "Trip"]}, columns=columns)
    assert "row 3, column power: 'Trip'; expected a number or a state that states has, 'On', 'Off'" in message
    assert "'Trip' (2), 'Auto' (1); add its number to states" in message
    numbered = POWER | {"power": Column(input="power", states={"0": 0.0, "1": 1.0})}
    assert "row 3" in refusal(tmp_path, {"level": [1] * 2, "flow": [0.1] * 2, "power": [1, 3]}, columns=numbered)


def test_truth_values_are_no_numbers_unless_states_say_so(tmp_path: Path) -> None:
    """The same for a frame with booleans as for a file with TRUE and FALSE: a watt for true would be wrong."""
    frame = pd.DataFrame({"time": [0.0, 60.0], "level": 1.0, "flow": 0.1, "power": [True, False]})
    with pytest.raises(ValueError, match=r"states = \{ True = 2000, False = 0 \}"):
        load_log(frame, PLANT)


def test_texts_of_a_sensor_mark_missing_readings(tmp_path: Path) -> None:
    message = refusal(tmp_path, {"level": [1, "I/O Timeout", "Bad"], "flow": [0.1] * 3, "power": [1] * 3})
    assert 'state bad = ["Bad", "I/O Timeout"] in a map where such a text marks a missing reading' in message
    assert "states" not in message
    read = log(tmp_path, {"level": [1, "I/O Timeout", "Bad"], "flow": [0.1] * 3, "power": [1] * 3}, bad=["Bad", "I/O Timeout"])
    assert np.isnan(read.log.y[1:, 0]).all()


# decimal marks


@pytest.mark.parametrize(
    ("cell", "hint"),
    [
        ("1,5", 'state in a map decimal = "," (1,5 is 1.5)'),
        ("1.234,5", 'state in a map decimal = "," and thousands = "." (1.234,5 is 1234.5)'),
        ("1 234.5", 'state in a map thousands = " " (1 234.5 is 1234.5)'),
        ("1,234", 'decimal = "," (1,234 is 1.234) or thousands = "," (1,234 is 1234.0)'),
        ("1'234", "thousands = \"'\" (1'234 is 1234.0)"),
        ("1.2.3", ""),
        ("12:30", ""),
        ("1-2", ""),
        ("0x1F", ""),
    ],
)
def test_the_hint_on_decimal_marks_comes_only_where_it_helps(tmp_path: Path, cell: str, hint: str) -> None:
    path = write(tmp_path, {"level": [1, cell], "flow": [1, 1], "power": [1, 1]}, separator=";")
    with pytest.raises(ValueError) as caught:
        load_log(path, PLANT, LogMap(separator=";", inputs="until the sample"))
    assert hint in str(caught.value)
    assert hint or not re.search("decimal =|thousands =", str(caught.value))
    for decimal, thousands, value in re.findall(r'decimal = "(.)"(?: and thousands = "(.)")? \(.*? is ([\d.]+)\)', hint):
        read = load_log(write(tmp_path, {"level": ["1", cell], "flow": [1, 1], "power": [1, 1]}, ";"), PLANT,
                        LogMap(separator=";", inputs="until the sample", decimal=decimal, thousands=thousands))  # fmt: skip
        assert read.log.y[1, 0] == float(value)


# quality


FORMS: list[Callable[[list[bool]], list[Any]]] = [
    list,
    lambda good: [str(g) for g in good],
    lambda good: [str(g).lower() for g in good],
    lambda good: [str(g).upper() for g in good],
    lambda good: [int(g) for g in good],
    lambda good: [float(g) for g in good],
    lambda good: [str(int(g)) for g in good],
]


@pytest.mark.parametrize("stated", [(True,), ("true",), ("True",), (1,), ("1",), 1.0])
@pytest.mark.parametrize("form", FORMS)
def test_a_truth_value_as_quality_is_the_same_in_every_form(
    tmp_path: Path, stated: Any, form: Callable[[list[bool]], list[Any]]
) -> None:
    cells = {"level": [1.0] * 3, "flow": [0.1] * 3, "power": [1.0] * 3, "level.ok": form([True, False, True])}
    columns = POWER | {"level": Column(sensor="level", quality="level.ok"), "power": Column(input="power")}
    chosen = LogMap(columns=columns, good=stated, inputs="until the sample")
    frame = pd.DataFrame({"time": [0.0, 60.0, 120.0], **cells})
    frame.to_parquet(tmp_path / "log.parquet")
    for source in (write(tmp_path, cells), tmp_path / "log.parquet", frame):
        read = load_log(source, PLANT, chosen)
        np.testing.assert_array_equal(read.log.y[:, 0], [1.0, np.nan, 1.0])
    rows = row_reader(PLANT, chosen, ["time", *cells])
    values = [rows.values({name: column[k] for name, column in cells.items()})[0][0] for k in range(3)]
    np.testing.assert_array_equal(values, [1.0, np.nan, 1.0])


@pytest.mark.parametrize(
    ("good", "codes", "expected"),
    [
        ([0, 4], [0, 1, 2, 4, 6], [True, False, False, True, False]),
        (["0", "4"], [0.0, 1.0, 2.0, 4.0, 6.0], [True, False, False, True, False]),
        ([0], ["0", "0x0", "00", "1", "OK"], [True, True, True, False, False]),
        (["OK", "manual"], ["ok", "Manual ", "Questionable", "", "0"], [True, True, False, False, False]),
    ],
)
def test_statuses(tmp_path: Path, good: list[Any], codes: list[Any], expected: list[bool]) -> None:
    cells = {"level": [1] * 5, "flow": [0.1] * 5, "power": [1] * 5, "level.Q": codes}
    read = log(tmp_path, cells, columns=RATED | POWER | {"level": RATED["level"]}, good=good)
    assert np.isfinite(read.log.y[:, 0]).tolist() == expected


@pytest.mark.parametrize(
    ("good", "words"),
    [
        (["yes"], "no value is of good quality by good = [\"yes\"], the quality columns have 'True' (5), 'False' (1)"),
        ([7, True][:1], "no value is of good quality by good = [7]"),
    ],
)
def test_a_list_that_no_value_fits_is_refused_with_what_occurs(tmp_path: Path, good: list[Any], words: str) -> None:
    cells: dict[str, list[Any]] = {"level": [1] * 3, "flow": [0.1] * 3, "power": [1] * 3}
    cells |= {"level.Q": [True, True, False], "flow.Q": [True] * 3}
    assert words in refusal(tmp_path, cells, columns=RATED, good=good)
    frame = pd.DataFrame({"time": [0.0, 60.0, 120.0], **cells})
    with pytest.raises(ValueError, match=re.escape(words)):
        load_log(frame, PLANT, LogMap(columns=RATED, good=good, inputs="until the sample"))


def test_one_sensor_of_poor_quality_is_no_refusal_and_all_of_them_are(tmp_path: Path) -> None:
    cells: dict[str, list[Any]] = {
        "level": [1] * 3,
        "flow": [0.1] * 3,
        "power": [1] * 3,
        "level.Q": [24] * 3,
        "flow.Q": [192] * 3,
    }
    assert np.isnan(log(tmp_path, cells, columns=RATED, good="opc-da").log.y[:, 0]).all()
    message = refusal(tmp_path, cells | {"flow.Q": [24] * 3}, columns=RATED, good="opc-da")
    assert "no value is of good quality by good = \"opc-da\", the quality columns have '24' (6)" in message


def test_truth_values_are_no_codes_of_opc(tmp_path: Path) -> None:
    cells: dict[str, list[Any]] = {
        "level": [1] * 2,
        "flow": [0.1] * 2,
        "power": [1] * 2,
        "level.Q": [True, False],
        "flow.Q": [True, True],
    }
    for source in (write(tmp_path, cells), pd.DataFrame({"time": [0.0, 60.0], **cells})):
        with pytest.raises(ValueError, match=r"True'? as quality; state which codes are good.*has 'True' \(1\), 'False' \(1\)"):
            load_log(source, PLANT, LogMap(columns=RATED, good="opc-da", inputs="until the sample"))


# titles


@pytest.mark.parametrize(
    ("title", "names", "expected"),
    [
        ("level [m]", (), ("level", "m")),
        ("level[m]", (), ("level", "m")),
        ("T[1]", (), ("T[1]", "")),
        ("T[1,2]", (), ("T[1,2]", "")),
        ("T[1] [K]", (), ("T[1]", "K")),
        ("u[1] [1]", (), ("u[1]", "1")),
        ("share [1]", (), ("share", "1")),
        ("share[1]", ("share",), ("share", "1")),
        ("T[1]", ("T", "T[1]"), ("T[1]", "")),
        ("level [m]", ("level [m]",), ("level [m]", "")),
        ("flow [-]", (), ("flow", "-")),
        ("plain", (), ("plain", "")),
    ],
)
def test_name_and_unit_of_a_title(title: str, names: tuple[str, ...], expected: tuple[str, str]) -> None:
    assert split_title(title, names) == expected


def test_a_plant_whose_signals_are_elements_of_arrays_reads_its_log(tmp_path: Path) -> None:
    plant = pump(("T[1]", "T[2]"), (Signal("u[1]", "1", 0.5), Signal("u[2]", "1", 0.5)))
    bare = write(tmp_path, {"T[1]": [1, 2], "T[2]": [3, 4], "u[1]": [5, 6], "u[2]": [7, 8]})
    read = load_log(bare, plant)
    assert [*read.log.y.ravel(), *read.log.u.ravel()] == [1, 3, 2, 4, 5, 7, 6, 8]
    mapped = {name: Column(sensor=name) for name in ("T[1]", "T[2]")} | {n: Column(input=n) for n in ("u[1]", "u[2]")}
    mapped_log = load_log(bare, plant, LogMap(columns=mapped, inputs="until the sample"))
    units = write(tmp_path, {"T[1] [m]": [1, 2], "T[2] [m3/s]": [3, 4], "u[1] [-]": [5, 6], "u[2] [1]": [7, 8]})
    for other in (mapped_log, load_log(units, plant)):
        np.testing.assert_array_equal(other.log.y, read.log.y)
        np.testing.assert_array_equal(other.log.u, read.log.u)


def test_monitoring_keeps_the_titles_of_arrays_and_units_of_cells(tmp_path: Path) -> None:
    path = write(tmp_path, {"T[1]": ["20 °C", "21 °C"], "T[2] [K]": [293, 294], "v[m/s]": [1, 2]})
    sensors, _ = signals_of(path)
    assert [(s.name, s.unit) for s in sensors] == [("T[1]", "°C"), ("T[2]", "K"), ("v", "m/s")]
    np.testing.assert_array_equal(load(path, sensors).log.y, [[20, 293, 1], [21, 294, 2]])


# the mask, and rows one by one


def test_a_mask_compares_states_truth_values_and_numbers_with_units(tmp_path: Path) -> None:
    cells = {"level": [1] * 3, "flow": [0.1] * 3, "power": ["On", "Off", "On"], "runs": ["TRUE", "FALSE", "TRUE"]}
    columns = POWER | {"power": Column(input="power", states={"On": 2, "Off": 0})}
    for mask in ("runs == 0", "power < 1"):
        read = log(tmp_path, cells, columns=columns, mask=mask)
        assert np.isnan(read.log.y[:, 0]).tolist() == [False, True, False]
    warm = log(tmp_path, cells | {"runs": ["5 %", "0 %", "7 %"]}, columns=columns, mask="runs < 1")
    assert np.isnan(warm.log.y[:, 0]).tolist() == [False, True, False]


def test_lines_with_units_and_states(tmp_path: Path) -> None:
    columns = POWER | {"power": Column(input="power", unit="kW", states={"On": 2, "Off": 0})}
    rows = TextRows(PLANT, LogMap(columns=columns, mask="power < 1"))
    rows.row("time,level,flow,power")
    for line, level, power in (
        ("0,1200 mm,0.1,On", 1.2, 2000.0),
        ("60,1.3,0.1,off", np.nan, 0.0),
        ("120,1.3,0.1,3", 1.3, 3000.0),
    ):
        row = rows.row(line)
        assert row is not None
        np.testing.assert_allclose([row[1][0], row[2][0]], [level, power])


def test_a_unit_in_each_cell_costs_no_closer_look_at_each(tmp_path: Path) -> None:
    """The numbers of a column in one unit are read at once: its cells are not matched one by one."""
    from fusion_sfdia.logs.numbers import Numbers

    looks = 0

    class Counting(Numbers):
        def quantity(self, cell: Any) -> tuple[float, str]:
            nonlocal looks
            looks += 1
            return super().quantity(cell)

    values, _, units = Counting().quantities([f"{k} kW" for k in range(1000)])
    assert looks == 1
    assert values.tolist() == list(range(1000))
    assert units["kW"].tolist() == list(range(1000))
