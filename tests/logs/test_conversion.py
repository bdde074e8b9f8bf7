"""Units as they stand in exports, against conversions known by definition."""

from __future__ import annotations

import math

import pytest

from fusion_sfdia.logs.conversion import conversion


@pytest.mark.parametrize(
    ("unit", "target", "number", "expected"),
    [
        ("degC", "K", 20.0, 293.15),
        ("°C", "K", -273.15, 0.0),
        ("deg F", "K", 212.0, 373.15),
        ("K", "degC", 273.15, 0.0),
        ("bar", "Pa", 1.5, 1.5e5),
        ("bar(g)", "Pa", 0.0, 101325.0),
        ("barg", "bar", 1.0, 2.01325),
        ("bar_a", "Pa", 1.0, 1e5),
        ("kPa(g)", "Pa", 1.0, 102325.0),
        ("psig", "Pa", 0.0, 101325.0),
        ("psi", "kPa", 1.0, 6.894757293168361),
        ("m3/h", "m3/s", 3600.0, 1.0),
        ("m³/h", "m^3/s", 3600.0, 1.0),
        ("l/min", "m3/s", 6e4, 1.0),
        ("t/h", "kg/s", 3.6, 1.0),
        ("mm", "m", 1200.0, 1.2),
        ("%", "1", 50.0, 0.5),
        ("rpm", "rad/s", 30.0, math.pi),
        ("kg/(m2 s)", "kg/m^2/s", 2.0, 2.0),
        ("Nm", "N m", 5.0, 5.0),
        ("kNm", "N m", 5.0, 5000.0),
    ],
)
def test_units_of_exports(unit: str, target: str, number: float, expected: float) -> None:
    assert conversion(unit, target)(number) == pytest.approx(expected, rel=1e-14, abs=1e-12)


def test_equal_units_leave_the_bits() -> None:
    assert conversion("furlong per fortnight", "furlong per fortnight")(0.1) == 0.1
    assert conversion("", "K", 0.1)(30.0) == 30.0 * 0.1
    assert conversion("mm", "m", 0.1)(12000.0) == pytest.approx(1.2, rel=1e-15)


@pytest.mark.parametrize(
    ("unit", "target", "message"),
    [
        ("kg", "K", "unit 'kg' does not convert to 'K'; give the unit that the column is in"),
        ("%", "m", 'unit = "m" and as scale a hundredth of the span, scale = 0.04 for 4 m'),
        ("rpm", "1", 'unit = "1" and as scale 1 over its full value, scale = 0.001 for 1000 rpm'),
        ("kg", "K", 'in a map unit = "K" and as scale the K of 1 kg'),
        ("Nm3/h", "m3/s", "pint does not know 'Nm3/h'"),
        ("C", "K", "unit 'C' does not convert to 'K'"),
        ("furlong/", "m", "pint does not know 'furlong/'"),
        ("Hz", "rad/s", "one of them states an angle, the other does not"),
        ("1/min", "rad/s", "one of them states an angle"),
        ("rad", "1", "one of them states an angle"),
        ("m#m", "m", "pint does not know 'm#m'"),
        ("3 m", "m", "pint does not know '3 m'"),
    ],
)
def test_what_could_be_converted_wrongly_is_refused(unit: str, target: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        conversion(unit, target)
