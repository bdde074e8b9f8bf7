"""Conversion of a column to the unit of the plant, by pint."""

from __future__ import annotations

import re
from functools import cache
from typing import Any, NamedTuple

from fusion_sfdia.core.arguments import shown

ANGLES = ("radian", "degree", "revolution", "turn", "grade", "arcminute", "arcsecond", "steradian")
PRESSURES = ("Pa", "hPa", "kPa", "MPa", "mbar", "bar", "psi")
UNIT = re.compile(r"[\w\s^*/().%°·²³⁴¹⁻-]+")
ATMOSPHERE = 101325.0  # Pa


class Conversion(NamedTuple):
    """value = factor * number + offset, from the numbers of a log to the unit of the plant."""

    factor: float = 1.0
    offset: float = 0.0

    def __call__(self, numbers: Any) -> Any:
        scaled = numbers if self.factor == 1.0 else numbers * self.factor
        return scaled if self.offset == 0.0 else scaled + self.offset


@cache
def conversion(unit: str, target: str, scale: float = 1.0) -> Conversion:
    """Return the conversion of numbers that are in `unit` after multiplication by scale; equal units need no registry.

    Gauge pressures, bar(g), barg or psig, are above the standard atmosphere. ValueError for a unit that is unknown, of
    another dimension, or that states an angle where the other does not: 1 Hz is 2 pi rad/s.
    """
    if not unit or unit == target:
        return Conversion(scale)
    import pint

    try:
        source, wanted = (_units(text) for text in (unit, target))
        ends = [float(_registry().Quantity(x, source).m_as(wanted)) for x in (0.0, -1e6, 1e6)]
    except pint.DimensionalityError as error:
        raise ValueError(f"unit {shown(unit)} does not convert to {target!r}; {_cure(unit, target)}") from error
    except Exception as error:  # pint raises errors of many kinds for texts that are no units
        unknown = unit if is_unknown(unit) else target
        raise ValueError(
            f"unit {shown(unit)} does not convert to {target!r}: pint does not know {shown(unknown)}; write it as in "
            '"degC", "m3/h", "bar(g)", or give scale alone'
        ) from error
    if _has_angle(source) != _has_angle(wanted):
        raise ValueError(
            f"unit {shown(unit)} does not convert to {target!r}: one of them states an angle, the other does not; write rpm, "
            "rad/s or deg/s, or give scale alone"
        )
    offset = 0.0 if abs(ends[0]) < 1e-300 else ends[0]
    factor = (ends[2] - ends[1]) / 2e6 if offset else float(_registry().Quantity(1.0, source).m_as(wanted))
    return Conversion(factor * scale, offset)


def _cure(unit: str, target: str) -> str:
    """What to state in a map of a column in a unit of another dimension."""
    of = "" if target == "1" else f" {target}"
    if unit.strip() in ("%", "percent"):
        return f'for % of a span state in a map unit = "{target}" and as scale a hundredth of the span, scale = 0.04 for 4{of}'
    if target == "1":
        scale = f"1 over its full value, scale = 0.001 for 1000 {unit}"
        return f'give the unit that the column is in, or in a map unit = "1" and as scale {scale}'
    return f'give the unit that the column is in, or in a map unit = "{target}" and as scale the {target} of 1 {unit}'


@cache
def _registry() -> Any:
    import pint

    registry = pint.UnitRegistry(cache_folder=None)
    registry.define("Nm = newton * meter")
    for unit in PRESSURES:
        in_pascal = float(registry.Quantity(1.0, unit).m_as("Pa"))
        registry.define(f"{unit}_gauge = {in_pascal!r} * pascal; offset: {ATMOSPHERE}")
    return registry


def _units(text: str) -> Any:
    """The units of a text as they stand in exports: m3/h, kg/(m2 s), °C, bar(g), psig."""
    plain = text.strip()
    if not UNIT.fullmatch(plain):  # pint reads what follows # as a comment
        raise ValueError(f"{text!r} is no unit")
    if match := re.fullmatch(rf"({'|'.join(PRESSURES)})[ _-]?(?:\(?([ag])\)?)", plain):
        plain = match[1] if match[2] == "a" else f"{match[1]}_gauge"
    plain = re.sub(r"(?<![A-Za-z])([kcdm]?m|ft|in|s|min|h)([234])(?![\w.])", r"\1^\2", plain)
    plain = re.sub(r"°\s*([CF])|deg\s+([CF])", r"deg\1\2", plain)
    return _registry().parse_units(plain)


def is_unknown(text: str) -> bool:
    """Whether pint does not know a unit as it stands in exports."""
    try:
        _units(text)
    except Exception:  # see above
        return True
    return False


def _has_angle(units: Any) -> bool:
    return any(angle in name for name in units._units for angle in ANGLES if not name.startswith("degree_"))
