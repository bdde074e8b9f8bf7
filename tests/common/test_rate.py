"""Rates of false alarms: texts, and their conversion with the sampling step."""

from __future__ import annotations

import pytest

from fusion_sfdia.common.rate import Rate, lasting


@pytest.mark.parametrize(
    ("text", "dt", "per_sample"),
    [
        ("1/day", 60.0, 60 / 86400),
        ("1/day", 1.0, 1 / 86400),
        ("2/hour", 5.0, 10 / 3600),
        ("0.5/week", 10.0, 5 / 604800),
        ("1e-3", 7.0, 1e-3),
        ("1e-3/sample", 7.0, 1e-3),
        (" 3 / minute ", 2.0, 0.1),
        ("3/min", 2.0, 0.1),
        ("2/h", 5.0, 10 / 3600),
        ("1/d", 60.0, 60 / 86400),
    ],
)
def test_a_rate_is_converted_with_the_sampling_step(text: str, dt: float, per_sample: float) -> None:
    rate = Rate.of(text)
    assert rate.per_sample(dt) == pytest.approx(per_sample, rel=1e-14)
    assert rate.samples(dt) == pytest.approx(1 / per_sample, rel=1e-14)
    assert Rate.of(str(rate)) == rate
    assert rate.same(rate.per_sample(dt), dt).count == pytest.approx(rate.count, rel=1e-14)


def test_a_number_is_a_rate_per_sample() -> None:
    assert Rate.of(0.01) == Rate(0.01) == Rate.of(Rate(0.01))
    assert str(Rate(0.01)) == "0.01" and str(Rate(1.0, "day")) == "1/day"


@pytest.mark.parametrize("text", ["1/fortnight", "day", "", "-1/day", "0", "nan", "inf/day", "1_0/day", "1/day/week"])
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="expected such as 1/day, 2/hour or 1e-3"):
        Rate.of(text)


def test_a_rate_of_one_in_each_sample_is_refused() -> None:
    with pytest.raises(ValueError, match="2/minute is 2 in each sample of 60 s; expected less than one"):
        Rate.of("2/minute").per_sample(60.0)


def test_durations_in_words() -> None:
    assert [lasting(s) for s in (45.0, 600.0, 10800.0, 7 * 86400.0)] == ["45 s", "10 minutes", "3.0 hours", "7.0 days"]
