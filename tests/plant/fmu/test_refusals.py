"""What cannot become a plant is refused in one sentence, and units are written as pint reads them."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import pytest
from conftest import MakeFmu
from tank_fmus import description, write_fmu

from fusion_sfdia.common.errors import MissingPackageError
from fusion_sfdia.logs.conversion import conversion
from fusion_sfdia.plant.fmu.from_fmu import from_fmu
from fusion_sfdia.plant.fmu.interface import read_interface, unit_text

STEPPED = 'canHandleVariableCommunicationStepSize="true" canGetAndSetFMUstate="true"'
NOISE: dict[str, Any] = {"sensors": 0.01, "initial_sigma": 0.01, "process_sigma": 0.001}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"sensors": {"level1": 0.01}}, "has no variable 'level1'; did you mean 'level_1'"),
        ({"inputs": ["area"]}, "'area' is a discrete variable"),
        ({"inputs": ["flow_12"]}, "'flow_12' is no input; expected of: inflow"),
        ({"start_values": {"flow_12": 1.0}}, "'flow_12' .* has no start value that can be set"),
        ({"start_values": {"outlet_1": "wide"}}, "start value of 'outlet_1' is 'wide'; expected one of type Real"),
        ({"start_values": {"level_1": -3.0}}, r"fails: .*status 3 \(error\).*; expected an FMU that initialises"),
        ({"unknown": {"inflow": 1e-5}}, "'inflow' .* is no real parameter with a start value"),
        ({"unknown": {"outlet_1": {"spread": 1.0}}}, "'outlet_1' has 'spread'; .*expected of: unit, nominal, sd"),
        ({"process_sigma": {"level_1": 0.1}}, "process_sigma has no value for the states level_2"),
        ({"initial_sigma": {"level": 0.1}}, "has no variable 'level'"),
        ({"sensors": {"der(level_1)": {"measures": "der(level_1)"}}}, "states no noise; give sigma"),
        ({"states": ["level_1"]}, "has the states level_1, level_2, all of which"),
        ({"kind": "cosimulation"}, "kind is 'cosimulation'; expected 'model exchange' or 'co-simulation'"),
        ({"kind": "co-simulation"}, "has model exchange; expected co-simulation: export it"),
        ({"inputs": "inflow"}, r"inputs is 'inflow'; expected a list of names: \['inflow'\]"),
        ({"unknown": 0.05}, "unknown is 0.05; expected values by name"),
        ({"substeps": 0}, "substeps is 0; expected a whole number of at least 1"),
        ({"dt": float("nan")}, "dt is nan s; it must be positive"),
    ],
)
def test_settings_that_do_not_fit(fmu: MakeFmu, settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        from_fmu(fmu(2, "ModelExchange"), **(NOISE | settings))


def test_a_share_needs_a_nominal_value(fmu: MakeFmu) -> None:
    path = fmu(2, "ModelExchange")
    with pytest.raises(ValueError, match=r"no nominal value of 'flow_12', which is 0 at the start; give sensors by name"):
        from_fmu(path, **NOISE, start_values={"outlet_1": 0.0})


def test_co_simulation_needs_to_get_and_set_its_state(fmu: MakeFmu) -> None:
    with pytest.raises(ValueError, match=r"co-simulation 'TwoTanks' of cc cannot get and set its state.*; expected canGetAnd"):
        from_fmu(fmu(2, "CoSimulation"), **NOISE)


def test_co_simulation_with_a_memory(fmu: MakeFmu) -> None:
    """A hidden inflow behind a lag is lost where a step begins from the levels."""
    path = fmu(2, "CoSimulation", STEPPED)
    with pytest.raises(ValueError, match=r"memory beyond its states: .* in state 1; expected none"):
        from_fmu(path, **NOISE, start_values={"lag": 10.0})
    with pytest.raises(ValueError, match=r"memory beyond its states: .* in sensor 2; expected none: name the others"):
        from_fmu(path, **NOISE, states=["level_1"])  # level_1 does without level_2, which is a sensor


def test_states_of_co_simulation_that_cannot_be_set(fmu: MakeFmu) -> None:
    with pytest.raises(ValueError, match=r"the start of its state 'flow_12' cannot be set; expected states with initial"):
        from_fmu(fmu(2, "CoSimulation", STEPPED), **NOISE, states=["flow_12"])


def edited(path: Path, library: Path, *changes: tuple[str, str], folder: str | None = None) -> Path:
    """An FMU of model exchange 2.0 whose description is changed."""
    xml = description(2, "ModelExchange", "")
    for before, after in changes:
        assert before in xml
        xml = xml.replace(before, after)
    return write_fmu(path / "edited.fmu", 2, xml, library, folder)


@pytest.mark.parametrize("version", [2, 3])
def test_events_in_time(fmu: MakeFmu, version: int) -> None:
    with pytest.raises(ValueError, match=r"has an event at 7 s; expected none: .* export it without events"):
        from_fmu(fmu(version, "ModelExchange"), **NOISE, start_values={"lag": -7.0})


def test_an_fmu_of_both_kinds(library: Path, tmp_path: Path) -> None:
    """Model exchange comes first; where it has events, the error names the other kind."""
    both = ("<UnitDefinitions>", f'<CoSimulation modelIdentifier="two_tanks" {STEPPED}/><UnitDefinitions>')
    path = edited(tmp_path, library, both)
    assert read_interface(path).kind == "model exchange"
    path = edited(tmp_path, library, both, ('numberOfEventIndicators="0"', 'numberOfEventIndicators="2"'))
    with pytest.raises(ValueError, match=r"has 2 event indicators; .* pass kind='co-simulation'"):
        from_fmu(path, **NOISE)
    assert from_fmu(path, **NOISE, kind="co-simulation").sensor_names == ("level_1", "level_2", "flow_12", "flow_out")


def test_variables_that_are_no_real_numbers(library: Path, tmp_path: Path) -> None:
    """A Boolean parameter can be set before the start (here by a function that the FMU lacks), an input cannot be used."""
    added = '<ScalarVariable name="on" valueReference="20" causality="{}" {}><Boolean start="true"/></ScalarVariable>'
    parameter = added.format("parameter", 'variability="fixed" initial="exact"')
    path = edited(tmp_path, library, ("</ModelVariables>", f"{parameter}</ModelVariables>"))
    with pytest.raises(ValueError, match=r"fmi2SetBoolean failed with status 3"):
        from_fmu(path, **NOISE, start_values={"on": False})
    added = added.format("input", 'variability="discrete"')
    path = edited(tmp_path, library, ("</ModelVariables>", f"{added}</ModelVariables>"))
    with pytest.raises(ValueError, match=r"the input 'on' is a discrete variable or one of type Boolean; expected scalar"):
        from_fmu(path, **NOISE)
    assert len(from_fmu(path, **NOISE, inputs=["inflow"]).inputs) == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('fmiVersion="2.0"', 'fmiVersion="1.0"'), "is of FMI 1.0; expected a Functional Mock-up Unit"),
        (('numberOfEventIndicators="0"', 'numberOfEventIndicators="2"'), "has 2 event indicators; expected none"),
        (
            ("<ModelExchange modelIdentifier", "<Other modelIdentifier"),
            "has scheduled execution alone; expected model exchange or",
        ),
        (('stepSize="5"', 'stopTime="5"'), "states no step of its default experiment; expected dt"),
        (
            ('guid="two-tanks"', 'guid="other"'),
            r"cannot be started .*; it reports: the guid does not match\); expected a library",
        ),
        (("<ModelVariables>", "<Variables>"), "modelDescription.xml is no XML"),
        (('derivative="1"', 'derivative="99"'), "modelDescription.xml cannot be read .* expected that of FMI 2.0"),
        (('<Unknown index="3"/><Unknown index="4"/>', ""), "states no continuous states; a plant needs at least one"),
    ],
)
def test_descriptions_that_are_refused(library: Path, tmp_path: Path, change: tuple[str, str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        from_fmu(edited(tmp_path, library, change), **NOISE)


def test_libraries_of_other_platforms_and_broken_ones(library: Path, tmp_path: Path) -> None:
    windows = tmp_path / "tanks.dll"
    windows.write_bytes(b"MZ")
    path = write_fmu(tmp_path / "windows.fmu", 2, description(2, "ModelExchange", ""), windows, "win64")
    with pytest.raises(ValueError, match=r"has libraries for these platforms: win64; expected one for .*: export it for"):
        from_fmu(path, **NOISE)
    broken, here = tmp_path / f"tanks{library.suffix}", Path.cwd()
    broken.write_bytes(b"no library")
    path = write_fmu(tmp_path / "broken.fmu", 2, description(2, "ModelExchange", ""), broken)
    with pytest.raises(ValueError, match=r"cannot be started \(Failed to load shared library"):
        from_fmu(path, **NOISE)
    assert Path.cwd() == here  # FMPy changes into the folder of the library


def test_files_that_are_no_fmu(tmp_path: Path) -> None:
    path = tmp_path / "model.fmu"
    with pytest.raises(ValueError, match=r"model\.fmu cannot be read \(No such file or directory\); expected a Functional"):
        read_interface(path)
    path.write_text("no archive")
    with pytest.raises(ValueError, match=r"model\.fmu is no zip archive; expected"):
        read_interface(path)
    with ZipFile(path, "w") as archive:
        archive.writestr("readme.txt", "nothing else")
    with pytest.raises(ValueError, match=r"model\.fmu has no modelDescription\.xml; expected"):
        read_interface(path)


def test_without_fmpy(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "fmpy", None)
    with pytest.raises(MissingPackageError, match=r"pip install 'fusion-sfdia\[fmu\]'"):
        read_interface(tmp_path / "model.fmu")


class Base:
    """kg m^-1 s^-2, as FMPy gives it."""

    kg, m, s, A, K, mol, cd, rad, factor, offset = 1, -1, -2, 0, 0, 0, 0, 0, 1.0, 0.0


class Unit:
    baseUnit = Base()  # noqa: N815


@pytest.mark.parametrize(
    ("written", "expected"),
    [
        ("", "1"),
        ("m3/s", "m3/s"),
        ("W/(m2.K)", "W/(m2.K)"),
        ("N.m", "N.m"),
        ("s-1", "s-1"),
        ("degC", "degC"),
        ("m2.5/s", "m2.5/s"),
    ],
)
def test_units_are_read_as_they_are_written(written: str, expected: str) -> None:
    assert unit_text(written) == expected
    assert conversion(written, {"W/(m2.K)": "W m-2 K-1", "m2.5/s": "m^2.5/s"}.get(written, expected)).factor == 1.0
    assert conversion("kPa", unit_text("Pascals of pressure", Unit())).factor == 1e3
    assert unit_text("Pascals of pressure") == "Pascals of pressure"
