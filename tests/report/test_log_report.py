"""The files of a diagnosis by a detector that tests the process, too; those of others are held in tests/cli."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from process_bank import SD, SIZE, ProcessBank
from toy_plants import Array, readings, tanks

from fusion_sfdia.evaluation.diagnose import Diagnosis
from fusion_sfdia.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.named import diagnose
from fusion_sfdia.report.log_report import FILES, as_text, draw, write_diagnosis

NEVER = 10**6
PLANT = tanks()
T, _, Y, U = readings(PLANT, 40, 1, seed=0)
BIASED = Y[:, 0] + 20 * PLANT.sensor_sigma * np.outer(T > 100, np.arange(4) == 2)  # q12 from 105 s on


def bank(**settings: object) -> ProcessBank:
    return replace(ProcessBank(PLANT, accept=(NEVER, NEVER), false_alarm=1e-6), **settings)


def found(y: Array, **settings: object) -> Diagnosis:
    return diagnose(bank(**settings), T, y, U[:, 0])


BOTH = found(BIASED, accept=(9, NEVER), doubt=(2, 6), between=(0, 5))


def test_the_verdict_is_first() -> None:
    assert as_text(BOTH, "process-bank").splitlines() == [
        "model suspect: outlet 5.0 % +- 0.8 below the model",
        "process or model: outlet; cannot tell: l1 or error of inflow; sensor q12",
        "40 readings, 3 events by process-bank",
        "  outlet 5.0 % +- 0.8 below the model since 45 s: not a sensor",
        "  cannot tell: l1 or error of inflow, from 10 s to 25 s",
        "  q12: 105 s to end of the log, bias 0.00012 m3/s (0.0001169 to 0.000123), 20 sigma",
    ]
    first, *rest = as_text(found(Y[:, 0]), "process-bank").splitlines()
    assert (
        rest == ["no fault", "40 readings, 0 events by process-bank"]
        and first == "model not tested: 20 healthy samples are too few"
    )
    of_sensors = diagnose(LeaveOneOutBank(PLANT, false_alarm=1e-6), T, BIASED, U[:, 0])
    assert as_text(of_sensors, "loo").splitlines()[1:] == [
        "40 readings, 1 event by loo",
        "  q12: 105 s to end of the log, bias 0.00012 m3/s (0.0001169 to 0.000123), 20 sigma",
    ]


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
        "process or model: outlet; cannot tell: l1 or error of inflow; sensor q12",
        "outlet: process or model",
        "q12: 1 event(s)",
        "l1: not isolated",  # but suspected
    ]
    line, size, *_ = figure.axes
    assert [label.get_text() for label in line.get_yticklabels()] == ["outlet", "l1 or error of inflow", "q12"]
    assert [text.get_text() for text in line.texts] == ["process or model", "cannot tell", "bias"]
    starts = [bars.get_paths()[0].vertices[:, 0].min() for bars in line.collections]
    np.testing.assert_allclose(starts, [45 / 60, 10 / 60, 105 / 60])
    shown = np.asarray(size.get_lines()[0].get_ydata(), dtype=float)
    np.testing.assert_allclose(shown[8:], -0.05)  # of the nominal value
    assert np.isnan(shown[:8]).all()
    assert len({axes.get_xlim() for axes in figure.axes}) == 1


def test_without_events_the_figure_shows_that() -> None:
    (axes,) = draw(PLANT, Y[:, 0], found(Y[:, 0])).axes
    assert axes.get_title(loc="left") == "l1: no fault"


def test_of_many_hypotheses_the_first_are_drawn() -> None:
    many = replace(BOTH, events=tuple(replace(BOTH.events[2], hypothesis=f"s{i}") for i in range(14)))
    line = draw(PLANT, BIASED, many).axes[0]
    assert [label.get_text() for label in line.get_yticklabels()] == [*(f"s{i}" for i in range(9)), "and 5 more"]
