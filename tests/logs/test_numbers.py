"""Numbers of a log: each cell alone and a column at once are the same, and nothing is read that is not one."""

from __future__ import annotations

import math
from decimal import Decimal
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion_sfdia.logs.numbers import NotANumberError, Numbers, good_codes

COMMA = Numbers(",", ".")


@settings(max_examples=200, deadline=None)
@given(st.lists(st.text(alphabet="0123456789.,eE+- nabx'", max_size=8), min_size=1, max_size=6), st.sampled_from([0, 1, 2, 3]))
def test_a_column_is_its_cells(cells: list[str], which: int) -> None:
    numbers = (Numbers(), Numbers(","), COMMA, Numbers(".", "'", ("nab", 1.0)))[which]
    try:
        alone = [numbers.cell(c) for c in cells]
    except ValueError:
        with pytest.raises(NotANumberError):
            numbers.column(cells)
        return
    np.testing.assert_array_equal(numbers.column(cells)[0], alone)


@pytest.mark.parametrize(
    ("numbers", "cell", "value"),
    [
        (Numbers(), " 1e3 ", 1000.0),
        (Numbers(), None, math.nan),
        (Numbers(), "NaN", math.nan),
        (Numbers(), Decimal("0.1"), 0.1),
        (Numbers(), np.float32(0.5), 0.5),
        (Numbers(","), "-1,5", -1.5),
        (COMMA, "1.234,5", 1234.5),
        (COMMA, "1234,5", 1234.5),
        (Numbers(",", " "), "1\u202f234\u00a0567,5", 1234567.5),
        (Numbers(".", "'"), "1’234.5", 1234.5),
        (Numbers(bad=("Bad", -9999)), "bAD ", math.nan),
        (Numbers(bad=("Bad", -9999)), "-9999.0", math.nan),
        (Numbers(bad=("-9999",)), -9999.0, math.nan),
    ],
)
def test_what_is_read(numbers: Numbers, cell: Any, value: float) -> None:
    np.testing.assert_equal(numbers.cell(cell), value)
    np.testing.assert_equal(numbers.column([cell])[0], [value])


@pytest.mark.parametrize(
    ("numbers", "cell"),
    [
        (Numbers(), "1,5"),
        (Numbers(), "1_000"),
        (Numbers(), "１２"),
        (Numbers(), "1e999"),
        (Numbers(), np.datetime64("2024-05-01")),
        (Numbers(","), "1.5"),
        (COMMA, "1.5"),
        (COMMA, "12.34,5"),
        (COMMA, "1,234.5"),
        (COMMA, "1.234.56"),
        (Numbers(".", " "), "1 23"),
    ],
)
def test_what_is_refused(numbers: Numbers, cell: Any) -> None:
    with pytest.raises(ValueError):
        numbers.cell(cell)
    with pytest.raises(NotANumberError) as caught:
        numbers.column([1.0, cell])
    assert caught.value.position == 1


def test_codes_of_quality() -> None:
    assert good_codes([192, "192", 216, 0, 24, 64, None, ""], "opc-da").tolist() == [True, True, True] + 5 * [False]
    assert good_codes([0, "0x0", 0x40000000, 0x80000000, -2147483648], "opc-ua").tolist() == [True, True] + 3 * [False]
    assert good_codes(["Good", "good, local", "Uncertain", "BadNoData"], ()).tolist() == [True, True, False, False]
    assert good_codes(["OK", 1, "1", "no"], ("ok", 1)).tolist() == [True, True, True, False]
    for codes in ([192], ["fine"], [0.5j]):
        with pytest.raises(NotANumberError):
            good_codes(codes, ())


@pytest.mark.parametrize(
    ("numbers", "cell", "value", "unit"),
    [
        (Numbers(), "1.0043 m", 1.0043, "m"),
        (Numbers(), "23.5degC", 23.5, "degC"),
        (Numbers(), " -1.5e3 kW ", -1500.0, "kW"),
        (Numbers(), "−12%", -12.0, "%"),
        (Numbers(), ".5 °", 0.5, "°"),
        (Numbers(), "5\u00a0m³/s", 5.0, "m³/s"),
        (Numbers(), "7 [bar]", 7.0, "[bar]"),
        (Numbers(), "1500 1/min", 1500.0, "1/min"),
        (Numbers(), "1eV", 1.0, "eV"),
        (Numbers(","), "23,5 K", 23.5, "K"),
        (Numbers(",", " "), "1\u202f234,5 kW", 1234.5, "kW"),
        (Numbers(".", ","), "12,345 kW", 12345.0, "kW"),
        (Numbers(), "23.5", 23.5, ""),
        (Numbers(), 23.5, 23.5, ""),
        (Numbers(), "", math.nan, ""),
        (Numbers(), None, math.nan, ""),
        (Numbers(bad=("Bad", -9999)), "bad", math.nan, ""),
        (Numbers(bad=("Bad", -9999)), "-9999 m", math.nan, ""),
    ],
)
def test_a_number_and_the_unit_behind_it(numbers: Numbers, cell: Any, value: float, unit: str) -> None:
    np.testing.assert_equal(numbers.quantity(cell), (value, unit))
    if unit:
        with pytest.raises(ValueError, match="unit"):
            numbers.cell(cell)


@pytest.mark.parametrize("cell", ["m", "On", "1,5 m", "1.2.3 m", "1_000 m", "１２ m", "12:30", "2024-07-01", "1e999 m", [1.0]])
def test_what_is_no_number_with_a_unit(cell: Any) -> None:
    with pytest.raises(ValueError):
        Numbers().quantity(cell)
