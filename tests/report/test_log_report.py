"""The files of a diagnosis by a detector that tests the process, too; those of others are held in tests/cli."""

from __future__ import annotations

import csv
import html
import re
from dataclasses import replace
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest
from matplotlib.dates import num2date
from matplotlib.figure import Figure
from process_bank import SD, SIZE, ProcessBank
from toy_plants import Array, readings, tanks

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.detectors.detector import joined
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.diagnoser import diagnose
from fusion_sfdia.diagnosis.diagnose import Diagnosis, diagnose_run
from fusion_sfdia.diagnosis.hindsight import Residuals
from fusion_sfdia.diagnosis.sentences import Wording
from fusion_sfdia.logs.columns import Source
from fusion_sfdia.logs.conversion import conversion
from fusion_sfdia.logs.csv_log import read_log
from fusion_sfdia.plant.gaps import Gap
from fusion_sfdia.plant.log import Log
from fusion_sfdia.report.log_figures import MOST_POINTS, broken, label, near, thinned, time_axis
from fusion_sfdia.report.log_page import About, write_page
from fusion_sfdia.report.log_report import FILES, as_text, draw, write_diagnosis
from fusion_sfdia.report.log_units import LogUnits

NEVER = 10**6
PLANT = tanks()
T, _, Y, U = readings(PLANT, 40, 1, seed=0)
BIASED = Y[:, 0] + 20 * PLANT.sensor_sigma * np.outer(T > 100, np.arange(4) == 2)  # q12 from 105 s on


def bank(**settings: object) -> ProcessBank:
    return replace(ProcessBank(PLANT, accept=(NEVER, NEVER), false_alarm=1e-6), **settings)


def found(y: Array, **settings: object) -> Diagnosis:
    return diagnose(bank(**settings), T, y, U[:, 0])


BOTH = found(BIASED, accept=(9, NEVER), doubt=(2, 6), between=(0, 5))


BIAS = (
    "Flow between the tanks q12 has read 1.20e-04 m3/s (1.17e-04 to 1.23e-04) too high since 105 s; the error persists. "
    "Check the sensor's wiring or calibration."
)
FEW = ["Too few healthy readings to tell whether the model fits.", "model not tested: 20 healthy samples are too few"]


def test_what_was_found_is_first() -> None:
    assert as_text(BOTH, "process-bank").splitlines() == [
        "40 readings by process-bank: 1 faulty sensor, 1 process change, 1 unresolved alarm",
        f"  {BIAS}",
        "  Outlet has been 5.0 % (3.4 to 6.6) below its value in the model since 45 s; no single sensor fault explains this. "
        "Check this part of the plant.",
        "  The readings did not show from 10 s to 25 s whether level of the upper tank l1 or the recorded flow into the upper "
        "tank was at fault. Check them on site if it happens again.",
        "If the plant was in order at that time, the model is wrong: tune it to a log without a fault.",
    ]
    healthy = as_text(found(Y[:, 0]), "process-bank").splitlines()
    assert healthy == ["40 readings by process-bank: no fault", *FEW]
    of_sensors = diagnose(LeaveOneOutBank(PLANT, false_alarm=1e-6), T, BIASED, U[:, 0])
    assert as_text(of_sensors, "loo").splitlines() == ["40 readings by loo: 1 faulty sensor", f"  {BIAS}", *FEW]


def test_a_sensor_that_is_off_throughout_has_its_unit_questioned() -> None:
    always = Y[:, 0] + 20 * PLANT.sensor_sigma * (np.arange(4) == 2)
    seen = diagnose(LeaveOneOutBank(PLANT, false_alarm=1e-6), T, always, U[:, 0])
    expected = "q12 is off throughout, since before the log: check its unit and the inputs first"
    assert expected in as_text(seen, "loo").splitlines()
    assert "since before" not in as_text(BOTH, "process-bank")
    frozen = replace(seen, events=tuple(replace(e, fault="freeze") for e in seen.events))
    assert not frozen.remarks


def column(name: str, title: str, unit: str) -> Source:
    i = PLANT.sensor_index(name)
    return Source(title, name, i, False, unit, conversion(unit, PLANT.sensors[i].unit))


def test_people_see_the_tags_and_units_of_their_log_and_tables_those_of_the_plant(tmp_path: Path) -> None:
    shown_in = LogUnits(PLANT, [column("q12", "FI12.PV", "m3/h"), column("l1", "LI1.PV [mm]", "mm"), column("l2", "l2", "")])
    _, sensor, _, undecided, *_ = as_text(shown_in.diagnosis(BOTH), "process-bank").splitlines()
    expected = "Flow between the tanks FI12.PV has read 0.432 m3/h (0.421 to 0.443) too high since 105 s; the error persists."
    assert sensor.startswith(f"  {expected} Check") and "level of the upper tank LI1.PV or the recorded flow" in undecided
    write_diagnosis(tmp_path, PLANT, BIASED, U[:, 0], BOTH, shown_in=shown_in)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert expected in page and "0.432 m3/h" in page and "0.00012" not in page
    assert "sensor,q12,105.0,200.0,0.000119" in (tmp_path / "events.csv").read_text(encoding="utf-8")
    header, row = (tmp_path / "reconstructed.csv").read_text(encoding="utf-8").splitlines()[:2]
    flags = "LI1.PV flag,l2 flag,FI12.PV flag,q2 flag,replaced"
    assert header == f"time [s],LI1.PV [mm],l2 [m],FI12.PV [m3/h],q2 [m3/s],inflow [m3/s],{flags}"
    assert float(row.split(",")[1]) == pytest.approx(1000 * BOTH.decisions.reconstruction[0, 0], rel=1e-15)
    assert (tmp_path / "scores.csv").read_text(encoding="utf-8").startswith("time_s,time,LI1.PV score,l2 score,FI12.PV score,")


def test_a_size_is_a_difference_without_the_offset_of_its_unit() -> None:
    kelvin = replace(PLANT, sensors=(replace(PLANT.sensors[0], unit="K"), *PLANT.sensors[1:]))
    shown_in = LogUnits(kelvin, [Source("TI", "l1", 0, False, "degC", conversion("degC", "K"))])
    five = replace(BOTH.events[-1], hypothesis="l1", size=5.0, low=4.0, high=6.0, unit="K")
    (event,) = shown_in.diagnosis(replace(BOTH, events=(five,))).events
    assert event.extent.startswith("bias 5 degC (4 to 6)")
    assert shown_in.readings(np.full((1, 4), 300.0))[0] == pytest.approx([26.85, 300.0, 300.0, 300.0])
    assert LogUnits(PLANT, [column("l1", "LI1.PV", "m")]).readings(BIASED) is BIASED  # no copy where nothing is converted


def test_the_files_have_kinds_and_standard_deviations(tmp_path: Path) -> None:
    write_diagnosis(tmp_path, PLANT, BIASED, U[:, 0], BOTH)
    assert {p.name for p in tmp_path.iterdir()} == set(FILES)
    lines = (tmp_path / "events.csv").read_text(encoding="utf-8").splitlines()
    added = "fault,start,end,size_low,size_high,size_sigma,confidence,alternatives"
    assert lines[:3] == [
        f"kind,hypothesis,start_s,end_s,size,sd,unit,nominal,open,{added}",
        f"process,outlet,45.0,200.0,{float(SIZE[0])!r},{float(SD[0])!r},m2.5/s,0.0006,true,,45 s,200 s,nan,nan,nan,nan,",
        "undecided,l1 or error of inflow,10.0,25.0,nan,nan,,nan,false,,10 s,25 s,nan,nan,nan,nan,",
    ]
    assert lines[3].startswith("sensor,q12,105.0,200.0,0.000119") and len(lines) == 4


def test_the_figure_begins_with_a_time_line_of_all_verdicts() -> None:
    figure = draw(PLANT, BIASED, BOTH)
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles == [
        "1 faulty sensor, 1 process change, 1 unresolved alarm",
        "outlet",
        "q12: 1 event",
        "l1: not isolated",  # but suspected
    ]
    line, size, *_ = figure.axes
    assert [label.get_text() for label in line.get_yticklabels()] == ["q12", "outlet", "l1 or inflow"]
    assert [text.get_text() for text in line.texts] == ["bias", "process", "undecided"]
    starts = [bars.get_paths()[0].vertices[:, 0].min() for bars in line.collections]
    np.testing.assert_allclose(starts, [105, 45, 10])
    shown = np.asarray(size.get_lines()[0].get_ydata(), dtype=float)
    np.testing.assert_allclose(shown[8:], -0.05)  # of the nominal value
    assert np.isnan(shown[:8]).all()
    assert len({axes.get_xlim() for axes in figure.axes}) == 1
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["above the model", "95 %", "reading", "reconstructed", "fault"]


def test_an_error_of_an_input_is_drawn_in_the_unit_of_the_log() -> None:
    seen = found(Y[:, 0], accept=(NEVER, 9))
    shown_in = LogUnits(PLANT, [Source("FC1", "inflow", 0, True, "m3/h", conversion("m3/h", "m3/s"))])
    axes = draw(shown_in.plant, Y[:, 0], shown_in.diagnosis(seen)).axes[1]
    assert axes.get_title(loc="left") == "FC1" and axes.get_ylabel() == "above the model [m3/h]"
    drawn = np.asarray(axes.get_lines()[0].get_ydata(), dtype=float)
    np.testing.assert_allclose(drawn[-1], 3600 * SIZE[1], rtol=1e-12)


@pytest.mark.parametrize("seconds", [False, True])
def test_readings_are_drawn_on_the_axis_of_the_time_line(seconds: bool) -> None:
    seen = replace(BOTH, t=1000 * T, events=tuple(replace(e, start=1000 * e.start, end=1000 * e.end) for e in BOTH.events))
    line, *rest = draw(PLANT, BIASED, seen if seconds else replace(BOTH, clock=WHEN)).axes
    labels = [axes.get_xlabel() for axes in (line, *rest)]
    assert set(labels) == {"time (s)" if seconds else "time (UTC+01:00) from 2026-03-01 on"}
    for axes in rest:
        x = np.asarray(axes.get_lines()[0].get_xdata(), dtype=float)
        low, high = line.get_xlim()
        assert axes.get_xlim() == (low, high) and np.all((x >= low) & (x <= high)) and np.ptp(x) > 0.9 * (high - low)


def test_without_events_the_figure_shows_that() -> None:
    (axes,) = draw(PLANT, Y[:, 0], found(Y[:, 0])).axes
    assert axes.get_title(loc="left") == "l1: no fault"


def test_of_many_hypotheses_the_first_are_drawn() -> None:
    many = replace(BOTH, events=tuple(replace(BOTH.events[2], hypothesis=f"s{i}") for i in range(14)))
    line = draw(PLANT, BIASED, many).axes[0]
    assert [label.get_text() for label in line.get_yticklabels()] == [*(f"s{i}" for i in range(9)), "and 5 more"]


WHEN = Clock(datetime(2026, 3, 1, 23, 58, tzinfo=timezone(timedelta(hours=1), "CET")))


def test_the_report_states_health_events_and_gaps(tmp_path: Path) -> None:
    y = BIASED.copy()
    y[5, 0] = np.nan
    kept = np.r_[0:30, 33:40]
    wall = diagnose_run(LeaveOneOutBank(PLANT, false_alarm=1e-6), Log(T[kept], y[kept], U[kept, 0]), clock=WHEN)
    write_diagnosis(tmp_path, PLANT, y[kept], U[kept, 0], wall, About("<unit> 4.csv", "loo"))
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.count("<script>") == 1 and not re.search(r'(src|xlink:href|href)="(?!#|data:)', page)  # nothing is fetched
    text = html.unescape(re.sub(r"<svg.*?</svg>|<(style|script)>.*?</\1>|<[^>]*>", " ", page, flags=re.DOTALL))
    for part in (
        "Diagnosis of <unit> 4.csv",
        "37 rows of 4 sensors of two-tanks, from 2026-03-01 23:58:05 to 2026-03-02 00:01:20; all times in UTC+01:00.",
        "1 faulty sensor.",
        "Flow between the tanks q12 has read 1.20e-04 m3/s (1.16e-04 to 1.23e-04) too high since 2026-03-01 23:59:45; the",
        "Confidence > 99 %.",
        "Model not tested: 17 healthy samples are too few.",
        "Verdict: sensor q12.",
        "gap from 2026-03-02 00:00:30+01:00 to 2026-03-02 00:00:50+01:00: predicted in 4 steps",
        "q12: bias",
        "All sensors",
    ):
        assert part in text, part
    assert page.count("<svg") == 2  # q12 from near, all sensors; of one event a time line is none
    opening = text[: text.index("Each finding")]
    assert "NIS" not in opening and "sigma" not in opening and "odel suspect" not in opening

    with (tmp_path / "scores.csv").open(encoding="utf-8", newline="") as file:
        scores = list(csv.DictReader(file))
    assert scores[0]["time"] == "2026-03-01 23:58:05+01:00" and scores[0]["time_s"] == "5.0" and len(scores) == 37
    assert scores[5]["l1 residual [sd]"] == "" and abs(float(scores[-1]["q12 residual [sd]"])) > 15 > 5 > float(
        scores[-1]["l1 residual [sd]"]
    )
    assert float(scores[20]["q12 score"]) > 1 > float(scores[10]["q12 score"])

    with (tmp_path / "reconstructed.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [k for k, row in enumerate(rows) if "l1" in row["replaced"].split(";")] == [5]
    assert [k for k, row in enumerate(rows) if "q12" in row["replaced"].split(";")] == list(range(20, 37))
    assert rows[0]["wall clock"] == "2026-03-01 23:58:05+01:00"
    assert [row["l1 flag"] for row in rows[3:7]] == ["1", "1", "9", "1"] and {row["q12 flag"] for row in rows[20:]} == {"4"}
    again = read_log(tmp_path / "reconstructed.csv", PLANT, other_columns=True)
    np.testing.assert_array_equal(again.y, wall.decisions.reconstruction)


def test_the_axis_of_times_follows_the_clock_or_is_in_seconds() -> None:
    assert time_axis(BOTH).label == "time (s)" and time_axis(BOTH)(120.0) == 120.0
    wall = time_axis(replace(BOTH, clock=WHEN))
    assert wall.label == "time (UTC+01:00) from 2026-03-01 on"
    assert num2date(wall(65.0), tz=WHEN.start.tzinfo).isoformat() == "2026-03-01T23:59:05+01:00"  # type: ignore[union-attr]


def test_a_long_line_is_drawn_with_its_extremes() -> None:
    values = np.random.default_rng(0).standard_normal(50_000)
    values[[17, 31_234]] = [9.0, -9.0]
    values[40_000:41_000] = np.nan
    kept = thinned(values)
    assert kept.size <= MOST_POINTS + 2 and {0, 17, 31_234, 49_999} <= set(kept.tolist())
    assert thinned(values[:100]).tolist() == list(range(100))


def test_no_line_is_drawn_over_a_gap() -> None:
    gaps = [Gap(start, start + 1.0, 1, False) for start in (-2.0, 2.0, 7.0)]
    t, (values,) = broken(np.arange(5.0), [np.arange(5.0) ** 2], gaps)
    np.testing.assert_array_equal(t, [0.0, 1.0, 2.0, 3.0, 3.0, 4.0])
    np.testing.assert_array_equal(values, [0.0, 1.0, 4.0, np.nan, 9.0, 16.0])
    few, _ = broken(np.array([0.0, 4.0]), [np.zeros(2)], gaps)  # thinned, without the end of the gap
    assert few.tolist() == [0.0, 4.0, 4.0]


def test_each_finding_is_a_sentence_and_has_its_picture(tmp_path: Path) -> None:
    (q12,) = (e for e in BOTH.events if e.hypothesis == "q12")
    given = (("spikes", 4.0, 20.0), ("drift", 30.0, 100.0))
    small, large = (replace(q12, fault=f, sigmas=s, start=a, end=a + 20, open=False) for f, s, a in given)
    notes = About("log.csv", "loo", ("false alarms: few",))
    events = (*BOTH.events[:2], small, large)
    write_page(tmp_path / "report.html", PLANT, BIASED, replace(BOTH, events=events), notes)
    page = html.unescape((tmp_path / "report.html").read_text(encoding="utf-8"))
    texts = ("q12 drifted until it read", "q12 had spikes of", "Outlet has been 5.0 %", "The readings did not show", "<h2>Each")
    places = [page.index(text) for text in texts]
    assert places == sorted(places)
    for title in ("1. q12: drift", "2. q12: spikes", "3. outlet: process", "4. Undecided"):
        assert f"<h3>{title}</h3>" in page
    assert "<li>false alarms: few</li>" in page
    articles = page.split("<article")[1:]
    assert len(articles) == 4 and all("<svg" in text for text in articles)
    assert "outlet 5.0 % +- 0.8 below the model since 45 s: not a sensor" in articles[2]


def test_many_times_of_one_sensor_are_one_finding(tmp_path: Path) -> None:
    (q12,) = (e for e in BOTH.events if e.hypothesis == "q12")
    events = tuple(replace(q12, start=5.0 * k, end=5.0 * k, open=False) for k in range(1, 30, 2))
    write_page(tmp_path / "report.html", PLANT, BIASED, replace(BOTH, events=events), About("log.csv", "loo"))
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "15 occurrences in all, from 5 s to 145 s; see Numbers." in page and page.count("<article") == 1
    assert page.count("<td>bias</td>") == 15 and page.count("q12 read") == 1


def test_without_a_second_look_a_figure_shows_what_replaces_readings_and_calls_it_so() -> None:
    q12 = [e for e in BOTH.events if e.hypothesis == "q12"]
    line, reading = near(PLANT, BIASED, replace(BOTH, after=None), q12).axes[0].get_lines()
    assert line.get_label() == "reconstructed" and reading.get_label() == "reading"
    replaced, read = np.asarray(line.get_ydata(), float), np.asarray(reading.get_ydata(), float)
    np.testing.assert_array_equal(np.isfinite(replaced), BOTH.decisions.reconstruction[-len(read) :, 2] != read)
    assert np.isnan(replaced[0]) and np.isfinite(replaced[-1])  # before and during the fault


def test_a_page_alone_names_no_files_beside_it(tmp_path: Path) -> None:
    write_page(tmp_path / "with.html", PLANT, BIASED, BOTH, About("a log", "a detector"))
    write_page(tmp_path / "alone.html", PLANT, BIASED, BOTH, About("a log", "a detector", files=False))
    assert ["events.csv" in (tmp_path / name).read_text(encoding="utf-8") for name in ("with.html", "alone.html")] == [
        True,
        False,
    ]
    alone = diagnose(bank(), Log(T, Y[:, 0], U[:, 0])).report(tmp_path / "result.html").read_text(encoding="utf-8")
    assert "Files beside this page" not in alone


def test_a_figure_and_a_title_of_a_sensor_without_a_unit_show_none() -> None:
    plain = replace(PLANT, sensors=tuple(replace(s, unit="1") for s in PLANT.sensors))
    upper, lower, _ = near(plain, BIASED, BOTH, [e for e in BOTH.events if e.hypothesis == "q12"]).axes
    assert (upper.get_ylabel(), lower.get_ylabel()) == ("q12", "difference")
    assert LogUnits(plain, ()).titles(inputs=False) == list(PLANT.sensor_names)


def test_names_beside_an_axis_are_tags_or_few_words() -> None:
    seen = replace(BOTH, words={**BOTH.words, "outlet": Wording("parameter", "outlet", "the outlet of the upper tank")})
    (outlet,) = (e for e in seen.events if e.hypothesis == "outlet")
    (between,) = (e for e in seen.events if e.kind == "undecided")
    assert label(seen, outlet) == "outlet of the upper tank" and label(seen, outlet, 10) == "outlet"
    several = replace(between, suspects=("outlet", "l1", "q12"))
    assert label(seen, several) == "outlet of the upper tank or 2 more" and label(seen, several, 18) == "outlet or 2 more"
    assert label(seen, between, 11) == "l1 or 1 mo…"
    assert label(seen, replace(between, suspects=("l1",))) == "l1?"


@pytest.mark.parametrize("hours", [2.9, 2.5 * 24, 71.9])
def test_a_span_of_three_of_a_unit_has_ticks_of_the_wall_clock_without_a_warning(hours: float) -> None:
    axis = time_axis(replace(BOTH, clock=WHEN))
    figure = Figure()
    axes = figure.subplots()
    axes.set_xlim(float(axis(0.0)), float(axis(3600 * hours)))
    axis.label_on(axes)
    assert 3 <= len(axes.get_xticks()) <= 7  # warnings are errors


@pytest.mark.long
def test_the_page_of_a_long_log_has_less_than_two_megabytes(tmp_path: Path) -> None:
    count = 100_000
    t, noise = 5.0 * np.arange(1, count + 1), np.random.default_rng(0).normal(size=(count, 4))
    index = np.minimum(np.arange(count), len(T) - 1)
    decisions = joined([BOTH.decisions] * (count // len(T)))
    sd = np.broadcast_to(PLANT.sensor_sigma, (count, 4))
    after = Residuals(noise * sd, sd)
    events = tuple(
        replace(e, hypothesis=s, start=100.0 * k, end=4e5)
        for k in range(10)
        for s in PLANT.sensor_names
        for e in [BOTH.events[2]]
    )
    seen = replace(BOTH, t=t, decisions=decisions, after=after, events=events, clock=WHEN)
    write_page(tmp_path / "report.html", PLANT, BIASED[index] + noise * sd, seen, About("long.csv", "process-bank"))
    assert (tmp_path / "report.html").stat().st_size < 2_000_000
