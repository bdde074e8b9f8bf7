"""A stretch of a log by its times, in seconds or by the clock."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone

import numpy as np
import pytest

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.learning.tuning.stretch import within

T = np.arange(0.0, 100.0, 10.0)
ZONE = timezone(timedelta(hours=1))
CLOCK = Clock(datetime(2026, 3, 1, 12, 0, tzinfo=ZONE))


@pytest.mark.parametrize(
    ("between", "first", "last"),
    [
        ("20..50", 20, 50),
        ("..50", 0, 50),
        ("20..", 20, 90),
        ("2026-03-01T12:00:15..2026-03-01 12:01", 20, 60),
        ("2026-03-01T11:00:15Z..45", 20, 40),
    ],
)
def test_a_stretch(between: str, first: float, last: float) -> None:
    inside = T[within(T, between, CLOCK)]
    assert (inside[0], inside[-1]) == (first, last)


@pytest.mark.parametrize(
    ("between", "clock", "reason"),
    [
        ("20-50", CLOCK, r"expected FROM\.\.TO, such as 0\.\.3600 \(s\) or 2026-03-01T"),
        ("200..300", Clock(), r"no reading from 200 to 300; the log goes from 0 s to 90 s"),
        ("a..50", CLOCK, "neither seconds nor such as 2026-03-01T14:20"),
        ("2026-03-01..50", Clock(), "the log has seconds alone"),
        ("2026-03-01T12:00Z..50", Clock(datetime(2026, 3, 1)), "has a zone, those of the log have none"),
    ],
)
def test_what_is_no_stretch_is_refused(between: str, clock: Clock, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        within(T, between, clock)
