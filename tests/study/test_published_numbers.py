"""When a published number counts as met, and how it is shown."""

import math

import pytest

from fusion_sfdia.report.results import AT_MOST, MORE_THAN, Row
from fusion_sfdia.study.published_numbers import readings, render, values_of

TABLE = "Boem 2018, Table I"


def row(value: float, low: float, high: float, source: str, published: float = 10.0) -> Row:
    """A number of ours beside a published 10."""
    return Row("network/x", "power-network", "chebyshev", "none", "all", "delay", value, low, high, 5, published, source)


@pytest.mark.parametrize(
    ("value", "low", "high", "source", "met"),
    [
        (11.0, 9.0, 13.0, TABLE, True),
        (21.0, 9.0, 33.0, TABLE, False),  # wide intervals prove nothing: more than twice the published number
        (11.0, 10.5, 11.5, TABLE, False),
        (10.04, math.nan, math.nan, TABLE, True),
        (1.0, 0.5, 1.5, TABLE + AT_MOST, True),
        (11.0, 10.5, 11.5, TABLE + AT_MOST, False),
        (40.0, math.nan, math.nan, TABLE + MORE_THAN, True),
        (10.0, math.nan, math.nan, TABLE + MORE_THAN, False),
        (9.0, 8.0, 11.0, TABLE + MORE_THAN, True),
        (9.0, 8.0, 9.5, TABLE + MORE_THAN, False),
    ],
)
def test_a_number_is_met_within_our_interval_and_a_bound_where_ours_is_not_beyond(
    value: float, low: float, high: float, source: str, met: bool
) -> None:
    (found,) = values_of([row(value, low, high, source)])
    assert found.by_default == met


def test_a_bound_is_shown_as_one_and_a_paper_with_how_it_is_read() -> None:
    shaheen = row(1.0, 0.5, 1.5, "Shaheen 2024, Table IV")
    page = render(values_of([row(40.0, math.nan, math.nan, TABLE + MORE_THAN), shaheen]))
    assert "| more than 10 |" in page
    assert readings()["shaheen2024"].split(".")[0].split(":")[0] in page
