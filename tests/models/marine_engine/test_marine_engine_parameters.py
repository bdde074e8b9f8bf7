"""Engine files: units, provenance, refused files, and another engine from another file."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from fusion_sfdia.models.marine_engine.equilibrium import engine_variables, equilibrium
from fusion_sfdia.models.marine_engine.parameters import (
    ENGINE_FILE,
    EXPECTED,
    PROVENANCE,
    UNITS,
    engine_parameters,
    load_engine,
)

TEXT = ENGINE_FILE.read_text(encoding="utf-8")
LINES = {line.split(" = ")[0]: line for line in TEXT.splitlines() if " = {" in line}


def edited(folder: Path, old: str, new: str) -> Path:
    assert TEXT.count(old) == 1
    path = folder / "engine.toml"
    path.write_text(TEXT.replace(old, new), encoding="utf-8")
    return path


def test_every_value_has_a_unit_and_a_provenance() -> None:
    values = load_engine()
    assert list(values) == list(EXPECTED) == sorted(values, key=list(EXPECTED).index)
    assert all(v.unit in UNITS and v.source and np.isfinite(v.value) for v in values.values())
    assert set(Counter(v.provenance for v in values.values())) == set(PROVENANCE)


def test_units_are_converted() -> None:
    values = load_engine()
    assert values["speed"].value == pytest.approx(1000 / 60)
    assert values["fuel_consumption"].value == pytest.approx(5.25e-8)
    assert values["exhaust_opens"].value == pytest.approx(np.deg2rad(119.0))
    assert values["peak_pressure"].value == pytest.approx(206e5)


def test_what_follows_from_the_file() -> None:
    c = engine_parameters()
    # computed by hand to these digits
    assert c.compression == pytest.approx(12.536, abs=5e-4)
    assert c.expansion_end == pytest.approx(0.8888, abs=5e-5)
    assert c.fuel_nominal == pytest.approx(2.835e-3, rel=1e-12)
    assert c.load == pytest.approx(1166.4, rel=1e-12)
    assert c.X_cv_nominal == pytest.approx(0.1800, abs=5e-5)
    assert c.loss_nominal == pytest.approx(5524.6, abs=0.05)
    assert c.turbine_area == pytest.approx(0.013675, abs=5e-7)
    assert c.turbocharger_efficiency == pytest.approx(0.6018, abs=5e-5)


def test_another_engine_is_another_file(tmp_path: Path) -> None:
    path = edited(tmp_path, LINES["cylinders"], LINES["cylinders"].replace("value = 12", "value = 16"))
    path.write_text(path.read_text().replace("value = 5.4e6", "value = 7.2e6").replace("value = 3.95", "value = 4.05"))
    c = engine_parameters(path)
    z = engine_variables(equilibrium(1.0, c), c)
    assert z["power"] == pytest.approx(7.2e6, rel=1e-10)
    assert z["p_receiver"] == pytest.approx(4.05e5, rel=1e-10)
    by_change = engine_parameters(cylinders=16, power=7.2e6, p_receiver=4.05e5)
    np.testing.assert_allclose(c, by_change, rtol=1e-14)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (LINES["bore"], "", "engine.toml lacks bore; an engine has power, speed"),
        (LINES["bore"], LINES["bore"] + "\nbores = 1", "has the unknown parameters bores; an engine has power"),
        (LINES["bore"], "bore = 0.28", "bore is 0.28; expected a table of value, unit, provenance, source"),
        (LINES["bore"], LINES["bore"].replace('"m"', '"K"'), "bore is in 'K'; expected one of m, mm"),
        (LINES["bore"], LINES["bore"].replace("0.28,", "-0.28,"), "bore is -0.28; expected above 0"),
        (LINES["bore"], LINES["bore"].replace("0.28,", "nan,"), "bore has the value nan; expected a finite number"),
        (LINES["bore"], LINES["bore"].replace("0.28,", '"0.28",'), "bore has the value '0.28'; expected a finite number"),
        (LINES["bore"], LINES["bore"].replace("recalled", "guessed"), "has the provenance 'guessed'; expected one of paper"),
        (LINES["bore"], LINES["bore"].replace("28/33 engine", " "), "bore names no source; state where the number comes from"),
        (LINES["T_cooler"], LINES["T_cooler"].replace("323.0", "0.0"), "T_cooler is 0; expected above 0"),
        (LINES["p_ambient"], LINES["p_ambient"].replace("1.0", "-1.0"), "p_ambient is -100000; expected above 0"),
        (LINES["kappa_air"], LINES["kappa_air"].replace("1.4", "1.0"), "kappa_air is 1; expected above 1"),
        (LINES["slip_nominal"], LINES["slip_nominal"].replace("0.08", "-0.1"), "slip_nominal is -0.1; expected at least 0"),
        (LINES["heat_efficiency"], LINES["heat_efficiency"].replace("0.915", "91.5"), "above 0 and at most 1"),
        (LINES["power"], "power = {", "engine.toml is not a TOML file"),
    ],
)
def test_a_bad_file_is_named_with_the_cure(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(ValueError) as error:
        load_engine(edited(tmp_path, old, new))
    assert message in str(error.value)


def test_a_full_load_without_equilibrium_is_refused() -> None:
    for changes, message in (
        ({"p_receiver": 5e5}, "must fall in this order"),
        ({"cp_air": 200.0}, "c_v would not be positive"),
        ({"rod": 0.1}, r"the rod of 0\.1 m is shorter than the crank"),
        ({"peak_pressure": 100e5}, "share of the heat at constant volume would be -.* correct peak_pressure"),
        ({"heating_value": 30e6}, "loss of torque would be -.* correct power, fuel_consumption or heat_efficiency"),
        ({"p_receiver": 1.5e5}, "efficiency of the turbocharger would be .* correct p_charge"),
        ({"wheels": 4.0}, "unknown engine parameters wheels; known: power"),
        ({"bore": np.inf}, "engine parameter bore is inf; expected a finite number"),
        ({"bore": -1.0}, "engine parameter bore is -1; expected above 0"),
    ):
        with pytest.raises(ValueError, match=message):
            engine_parameters(**changes)
