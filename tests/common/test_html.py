from __future__ import annotations

from dataclasses import replace
from datetime import datetime
from types import SimpleNamespace
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
import pandas
import pytest
from toy_plants import readings, tanks

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.common.html import MOST, as_html
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.diagnosis.diagnose import Diagnosis, diagnose_run
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.plant.log import Log
from fusion_sfdia.study.comparison.compare import ComparisonResult

PLANT = tanks()
NIGHT = datetime(2026, 3, 29, 1, 59)  # a minute before summer time


def found(start: datetime | None) -> Diagnosis:
    t, _, y, u = readings(PLANT, 40, 1, seed=0)
    y = y[:, 0] + 20 * PLANT.sensor_sigma * np.outer(t > 100, np.arange(4) == 2)  # q12 from 105 s on
    return diagnose_run(LeaveOneOutBank(PLANT, false_alarm=1e-6), Log(t, y, u[:, 0]), clock=Clock(start))


def test_texts_are_escaped_and_long_tables_cut() -> None:
    shown = as_html("<b>", "a & b", ("x",), [(f"<script>{k}",) for k in range(MOST + 2)])
    assert "<script" not in shown and "&lt;script&gt;0" in shown and "a &amp; b" in shown
    assert shown.count("<td>") == MOST and "and 2 more" in shown


def test_diagnosis_plant_recording_and_comparison_are_shown_in_notebooks() -> None:
    plant = replace(PLANT, sensors=(replace(PLANT.sensors[0], name="<i>"), *PLANT.sensors[1:]))
    ranked = [
        SimpleNamespace(metric="rank", plant="p", quantity="delay", detector=name, value=k) for k, name in ((2, "b"), (1, "a"))
    ]
    compared = ComparisonResult(ranked, [], [], [], None, "")  # type: ignore[arg-type]
    each: dict[str, Any] = {
        "Flow between the tanks q12 has read": found(None),
        "&lt;i&gt;": plant,
        "Recording of 2 runs": simulate(PLANT, 3, [0, 1]),
        "a, b": compared,
    }
    for text, one in each.items():
        shown = one._repr_html_()
        assert text in shown and "<i>" not in shown and len(shown) < 2000


@pytest.mark.parametrize("zone", [None, ZoneInfo("Europe/Amsterdam")])
def test_times_of_a_frame_are_time_stamps_in_the_zone_of_the_log(zone: ZoneInfo | None) -> None:
    clock = Clock(NIGHT.replace(tzinfo=zone))
    frame = found(clock.start).frame()
    assert [at.isoformat() for at in frame["start"]] == [clock.moment(105.0).isoformat()]  # type: ignore[union-attr]
    assert str(frame["end"].dt.tz) == str(zone)


def test_without_a_clock_they_are_durations_also_of_no_event() -> None:
    frame = found(None).frame()
    assert frame["start"].tolist() == [pandas.Timedelta(seconds=105)]
    none = replace(found(NIGHT), events=()).frame()
    assert len(none) == 0 and none["start"].dtype.kind == "M"
