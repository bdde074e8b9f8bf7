from datetime import UTC, datetime

from fusion_sfdia.core.clock import Clock


def test_a_time_is_shown_on_the_wall_clock_of_its_log():
    clock = Clock(datetime(2026, 3, 1, 14, 20, tzinfo=UTC))
    assert clock.at(5.0) == "2026-03-01 14:20:05+00:00"
    assert clock.at(0.25) == "2026-03-01 14:20:00.250+00:00"


def test_without_a_start_a_time_is_in_seconds():
    assert Clock().at(1205.0) == "1205 s"
