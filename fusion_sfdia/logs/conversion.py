"""Conversion of a column to the unit of the plant, and what to state where a unit does not convert."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from functools import cache, lru_cache
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from fusion_sfdia.common import unit_texts as units
from fusion_sfdia.common.arguments import shown
from fusion_sfdia.common.unit_texts import UnitMeaning

USUAL = (  # units that logs have, by what they measure; the first states it
    ("mT", "T"), ("degC", "K", "degF"), ("bar", "bar(g)", "kPa", "psi", "Pa"), ("m3/h", "l/min", "gpm", "m3/s"),
    ("kg/h", "t/h", "kg/s", "lb/h"), ("m", "mm", "inch", "ft"), ("m/s", "km/h", "kn", "ft/min"), ("rpm", "rad/s", "deg/s"),
    ("1/s", "1/min", "Hz"), ("kW", "W", "MW", "hp"), ("1", "%", "ppm"), ("s", "min", "h", "ms"), ("A", "mA"), ("V", "mV"),
    ("N m", "kN m", "lbf ft"), ("m/s2", "g"), ("Pa s", "cP"), ("m2/s", "cSt"), ("S/m", "uS/cm"), ("N", "kN", "kgf", "lbf"),
    ("kg", "g", "t", "lb"), ("m3", "l", "bbl"), ("deg", "rad"), ("kg/m3", "g/l"), ("K/s", "K/min"), ("C", "Ah"),
    ("m2", "cm2"), ("mol/s", "kmol/h"), ("mol/l", "mol/m3"), ("kWh", "kJ"), ("ohm", "kohm"), ("Hz", "kHz"), ("F", "uF"),
    ("H", "mH"), ("Nm3/h", "Nm3/s"), ("Sm3/h", "Sm3/s"), ("scfm", "scfh"), ("slpm", "sccm"),
)  # fmt: skip
GASES = {  # volumes (m3) at reference conditions: temperature (K) and pressure (Pa), as most use them
    "normal_cubic_meter": (1.0, 273.15, 101325.0), "standard_cubic_meter": (1.0, 288.15, 101325.0),
    "standard_liter": (1e-3, 273.15, 101325.0), "standard_cubic_foot": (0.3048**3, 288.706, 101325.0),
}  # fmt: skip
GAS_CONSTANT = 8.314462618  # J/(mol K)
AIR = 0.0289652  # kg/mol, dry


class Conversion(NamedTuple):
    """value = factor * number + offset, from the numbers of a log to the unit of the plant."""

    factor: float = 1.0
    offset: float = 0.0

    def __call__(self, numbers: Any) -> Any:
        scaled = numbers if self.factor == 1.0 else numbers * self.factor
        return scaled if self.offset == 0.0 else scaled + self.offset


def conversion(unit: str, target: str, scale: float = 1.0) -> Conversion:
    """Return the conversion of numbers that are in `unit` after multiplication by scale; equal units need no registry.

    Gauge pressures, bar(g), barg or psig, are above the standard atmosphere. ValueError that names units which are meant
    where a unit is unknown, of another dimension, used for several, a logarithm, or states an angle where the other does not:
    1 Hz is 2 pi rad/s.
    """
    if not unit or unit == target:
        return Conversion(scale)
    found = _converted(unit, target)
    if found is None:
        raise ValueError(f"unit {shown(unit)} does not convert to {target!r}: {_refusal(unit, target)}")
    return Conversion(found.factor * scale, found.offset)


@lru_cache(units.TEXTS)
def _converted(unit: str, target: str) -> Conversion | None:
    """The conversion from one unit to another; None where their texts do not tell it."""
    if units.plain_text(unit) == units.plain_text(target):
        return Conversion()
    for pair in _pairs(unit, target):
        return pair.conversion
    others = [*_pairs(unit, target, ("unknown", "unknown"))]
    given = (units.plain_text(unit), units.plain_text(target))
    same = [p for p in others if not any(_other_prefix(a, b) for a, b in zip(given, p.spelled, strict=True))]
    return same[0].conversion if same and len({p.conversion for p in others}) == 1 else None


def _other_prefix(given: str, spelled: str) -> bool:
    """Whether a name begins with another one of the prefixes milli, mega, pico and peta than it is given with."""
    begins = re.finditer(r"(?<![^\W_])[mMpP]", given)
    return any(m[0] != spelled[m.start()] for m in begins)


class _UnitPair(NamedTuple):
    """A meaning of two texts that converts, and their spellings in the upper and lower case in which they are known."""

    conversion: Conversion
    spelled: tuple[str, str]


def _pairs(unit: str, target: str, cases: tuple[str, str] = ("", ""), *, angles: bool = True) -> Iterator[_UnitPair]:
    """The meanings of two texts in which one converts to the other, the most usual first.

    cases: of the names of units of each, see `unit_texts.spellings`. angles: whether both or none have to state an angle.
    """
    for (source, a), (wanted, b) in product(units.spellings(unit, cases[0]), units.spellings(target, cases[1])):
        if angles and units.has_angle(source.unit) != units.has_angle(wanted.unit):
            continue
        if (found := _between(source, wanted)) is not None:
            yield _UnitPair(found, (a, b))


@cache
def _between(source: UnitMeaning, wanted: UnitMeaning) -> Conversion | None:
    """The conversion between two readings; None for other dimensions, and where it is no factor and offset."""
    if source.unit.dimensionality != wanted.unit.dimensionality:
        return None
    import pint

    quantity = units.registry().Quantity

    def value(x: float) -> float:
        return float(quantity(x, source.unit).m_as(wanted.unit))

    try:
        zero, one, two = value(0.0), value(1.0), value(2.0)
    except (
        pint.DimensionalityError,
        OverflowError,
    ):  # a temperature is no difference of temperatures; a factor without a number
        return None
    if not one - zero or not abs(two - 2 * one + zero) <= 1e-9 * max(abs(one), abs(zero)):  # a logarithm
        return None
    offset = 0.0 if abs(zero) < 1e-300 else zero
    factor = (value(1e6) - value(-1e6)) / 2e6 if offset else one
    if source.above != wanted.above:
        offset += (source.above - wanted.above) / float(quantity(1.0, wanted.unit).m_as("pascal"))
    return Conversion(factor, offset)


@lru_cache(units.TEXTS)
def _refusal(unit: str, target: str) -> str:
    """Why a unit does not convert, and what to state instead in a map."""
    state = f'state in a map unit = "{target}"'
    if logarithms := [text for text in (unit, target) if units.is_logarithm(text)]:
        return (
            f"{logarithms[0]} is a logarithm, which no factor converts; convert the column before, by 10**(x/10) for powers "
            f"in dB, 10**(x/20) for amplitudes and 10**(-x) for pH, or {state} where the plant has the same number"
        )
    if text := _gas(unit, target, state):
        return text
    if clear := [u for u in units.clear_names(unit) if _converted(u, target)]:
        return f"{unit} is used for several units; state in a map {_or(clear)}"
    if clear := [u for u in units.clear_names(target) if _converted(unit, u)]:
        return f"{target} is used for several units; give the plant {_or(clear)}"
    if units.readings(unit) == units.readings("%"):
        same = "degC" if _measures("kelvin", target) else target
        return (
            f'for % of a span that begins at 0 state in a map unit = "{same}" and as scale a hundredth of the span, '
            f"scale = 0.04 for 4{'' if same == '1' else f' {same}'}"
        )
    for pair in _pairs(unit, target, angles=False):
        k, turn = pair.conversion.factor, 2 * np.pi
        turns = k * turn if any(units.has_angle(r.unit) for r in units.readings(target)) else k / turn
        return (
            f"one of them states an angle, the other does not; {state} and scale = {turns:.9g} for revolutions, "
            f"scale = {k:.9g} for radians"
        )
    others = {pair.conversion: pair.spelled[0] for pair in reversed([*_pairs(unit, target, ("any", "unknown"))])}
    meant = list(reversed(others.values()))
    if meant and meant != [units.plain_text(unit)]:
        return f"did you mean {_or(meant)}? State it in a map"
    if not units.readings(target):
        return f"the plant's {shown(target)} is no known unit; {state} for a column in that, or correct the plant"
    unknown = not units.readings(unit)
    usual = next((names for names in USUAL if _converted(names[0], target)), (target,))
    reason = f"{'it is no known unit' if unknown else 'it measures something else'}; state the unit that the column is in"
    if target == "1":
        full = "1000" if unknown else f"1000 {unit}"
        return f'{reason}, as in {_or(usual)}; or unit = "1" and as scale 1 over its full value, scale = 0.001 for {full}'
    if _measures("kelvin", target) or (_measures("pascal", target) and unknown):  # an offset may be between them
        return f"{reason}, as in {_or(usual)}"
    return f'{reason}, as in {_or(usual)}; or, of what is proportional to it, unit = "{target}" and as scale the {target} of 1'


def _gas(unit: str, target: str, state: str) -> str:
    """What to state of a gas whose volume counts at reference conditions; "" of other units."""
    for source, wanted in product(units.readings(unit), units.readings(target)):
        try:
            (given, gases), (expected, others) = _in_moles(source.unit), _in_moles(wanted.unit)
        except OverflowError:  # of a factor beyond all numbers
            continue
        quantity = units.registry().Quantity
        for per_mole, of in (
            (quantity(1.0, ""), ""),
            (quantity(AIR, "kg/mol"), " for dry air"),
            (
                quantity(GAS_CONSTANT * 293.15 / 5e5, "m^3/mol"),
                " for a gas at 5e5 Pa absolute and 293.15 K, and elsewhere in proportion to T / p",
            ),
        ):
            for ratio in (given * per_mole / expected, given / per_mole / expected):
                if ratio.dimensionless and (gases or others):
                    at = " and ".join(
                        f"{t - 273.15:.4g} degC and {p:g} Pa" for _, t, p in (GASES[g] for g in (*gases, *others))
                    )
                    which = " and ".join([*[unit] * bool(gases), *[target] * bool(others)])
                    scale = f"the {target} of 1 {unit} at your conditions, scale = {ratio.m_as(''):.6g}{of}"
                    return f"{which} counts a gas at reference conditions, usually {at}; {state} and as scale {scale}"
    return ""


def _in_moles(unit: Any) -> tuple[Any, list[str]]:
    """One of a unit with the amount of a gas in place of its volume at reference conditions, and which these are."""
    quantity = units.registry().Quantity
    found = quantity(1.0, unit).to_root_units()
    gases = [name for name in GASES if name in found.units._units]
    for name in gases:
        volume, t, p = GASES[name]
        amount = quantity(p * volume / (GAS_CONSTANT * t), "mole") / quantity(1.0, name)
        found = found * amount ** found.units._units[name]
    return found, gases


def _measures(unit: str, target: str) -> bool:
    """Whether a target is of the dimension of a unit of pint."""
    return any(r.unit.dimensionality == units.registry().Unit(unit).dimensionality for r in units.readings(target))


def _or(names: Sequence[str]) -> str:
    quoted = [f'unit = "{name}"' for name in names]
    return quoted[0] if len(quoted) == 1 else f"{', '.join(quoted[:-1])} or {quoted[-1]}"
