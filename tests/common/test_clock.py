from datetime import UTC, datetime, timedelta
from zoneinfo import ZoneInfo

from fusion_sfdia.common.clock import Clock


def test_a_time_is_shown_on_the_wall_clock_of_its_log():
    clock = Clock(datetime(2026, 3, 1, 14, 20, tzinfo=UTC))
    assert clock.at(5.0) == "2026-03-01 14:20:05+00:00"
    assert clock.at(0.25) == "2026-03-01 14:20:00.250+00:00"


def test_without_a_start_a_time_is_in_seconds():
    assert Clock().at(1205.0) == "1205 s"


def test_a_clock_follows_its_zone_where_clocks_change() -> None:
    """On 27 October 2024 the hour from 2 to 3 occurs twice in Amsterdam."""
    clock = Clock(datetime(2024, 10, 27, 1, 30, tzinfo=ZoneInfo("Europe/Amsterdam")))
    assert [clock.at(3600.0 * h) for h in range(3)] == [
        "2024-10-27 01:30:00+02:00",
        "2024-10-27 02:30:00+02:00",
        "2024-10-27 02:30:00+01:00",
    ]
    for h in range(3):  # and back
        moment = datetime(2024, 10, 26, 23, 30, tzinfo=UTC) + timedelta(hours=h)
        assert clock.seconds(moment) == clock.seconds(moment.astimezone(ZoneInfo("Europe/Amsterdam"))) == 3600.0 * h


def test_seconds_since_1970_are_not_rounded() -> None:
    assert Clock().at(1714564805.5) == "1714564806 s" and Clock().at(1714564805.0) == "1714564805 s"
    assert Clock().at(1205.25) == "1205.25 s"
