"""Numbers as people and spreadsheets write them."""

from __future__ import annotations

import math

import pytest

from fusion_sfdia.common.numerals import decimal, integer


def test_numbers_in_plain_digits() -> None:
    assert [decimal(text) for text in ("12", " 1.5 ", "-2e-3", "inf")] == [12.0, 1.5, -0.002, math.inf]
    assert math.isnan(decimal("nan")) and integer(" -7 ") == -7


@pytest.mark.parametrize("text", ["1_0", "١٢", "one", "", "1,5"])
def test_what_is_no_number_in_the_digits_0_to_9(text: str) -> None:
    for read in (decimal, integer):
        with pytest.raises(ValueError, match=r"expected only digits|could not convert|invalid literal"):
            read(text)
