"""The example of a comparison: one faulty run as every detector sees it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fusion_sfdia import simulate
from fusion_sfdia.detectors import LeaveOneOutBank
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plants import two_tanks
from fusion_sfdia.study.comparison.example import NOTHING, PREFIX, RIGHT, SIGMAS, WRONG, example
from fusion_sfdia.study.comparison.figures import VERDICTS, draw_example
from fusion_sfdia.study.comparison.looks import MOST_NAMED, NAMED, looks, prominent, quieted

WINDOW = 10


@pytest.fixture(scope="module")
def plant() -> Plant:
    return two_tanks()


def seen(plant: Plant, *, steps: int = 40, first: int = 5, scale: float = 1.0) -> dict[str, Any]:
    recording = simulate(plant, steps, seeds=[3, 4])
    detector = LeaveOneOutBank(plant, threshold_scale=scale)
    state = detector.init((1,), float(recording.t[first]) - plant.dt)
    arrays = example(detector, recording, state, first, WINDOW)
    return {k.removeprefix(PREFIX): v for k, v in arrays.items()} | {"recording": recording}


def test_a_window_of_healthy_readings_one_with_a_bias_and_one_healthy_again(plant: Plant) -> None:
    found = seen(plant)
    i, recording = int(found["sensor"]), found["recording"]
    assert i == 2 and found["y"].shape == (3 * WINDOW,)
    assert found["t"][0] == 0 and np.allclose(np.diff(found["t"]), plant.dt)
    assert found["active"].tolist() == [0.0] * WINDOW + [1.0] * WINDOW + [0.0] * WINDOW
    added = found["y"] - recording.y[5:35, 0, i]
    expected = found["active"] * SIGMAS * plant.sensor_sigma[i]
    assert np.allclose(added, expected, rtol=0, atol=np.finfo(np.float32).eps * np.abs(found["y"]).max())
    assert np.allclose(found["signal"], recording.signal[5:35, 0, i], rtol=np.finfo(np.float32).eps)
    assert np.array_equal(recording.y, simulate(plant, 40, seeds=[3, 4]).y)  # the recording that others share is as it was


def test_the_verdict_is_right_where_the_faulty_sensor_alone_is_isolated(plant: Plant) -> None:
    found = seen(plant)
    faulty = found["active"] > 0
    assert np.all(found["verdict"][faulty] == RIGHT) and np.all(found["score"][faulty] > 1)
    quiet = found["verdict"] == NOTHING
    assert np.all(found["score"][quiet] <= 1) and np.all(quiet[:WINDOW])
    error = np.abs(found["reconstruction"] - found["signal"])[faulty] / plant.sensor_sigma[2]
    assert error.max() < SIGMAS / 2  # what is restored is not the faulty reading


def test_a_detector_that_cannot_alarm_has_no_verdict_and_one_that_always_does_is_wrong(plant: Plant) -> None:
    assert set(seen(plant, scale=1e6)["verdict"].tolist()) == {NOTHING}
    verdict = seen(plant, scale=1e-3)["verdict"]
    assert WRONG in verdict and NOTHING not in verdict[1:]


def test_a_recording_that_ends_early_gives_what_there_is(plant: Plant) -> None:
    assert seen(plant, steps=20, first=5)["y"].shape == (15,)


def test_every_detector_has_its_row_and_the_named_have_lines(plant: Plant) -> None:
    arrays = {f"{PREFIX}{k}": v for k, v in seen(plant).items() if k != "recording"}
    names = [f"d-{k}" for k in range(MOST_NAMED + 3)]
    figure = draw_example(plant, dict.fromkeys(names, arrays), names[:2])
    readings, restored, scores, verdicts = figure.axes
    assert [label.get_text() for label in verdicts.get_yticklabels()] == names
    assert [text.get_text() for text in scores.get_legend().get_texts()] == [*names[:2], "other detectors"]
    assert [text.get_text() for text in verdicts.get_legend().get_texts()] == list(VERDICTS)
    assert "q12" in readings.get_title(loc="left") and len(restored.lines) == len(names) + 1
    assert verdicts.images[0].get_array().shape == (len(names), 3 * WINDOW)


def test_of_many_detectors_lines_name_the_best_of_each_family() -> None:
    few = {f"loo-{k}": float(k) for k in range(MOST_NAMED)}
    assert prominent(few) == list(few)
    many = few | {"kf-a": 3.5, "kf-b": 20.0, "uio": float("nan"), "pca": 1.0}
    named = prominent(many)
    assert named[:2] == ["kf-b", f"loo-{MOST_NAMED - 1}"] and "uio" in named and len(named) <= NAMED
    grey = quieted(looks(list(many)), named)
    assert {grey[d]["color"] for d in many if d not in named} == {"0.82"}
    assert all(grey[d] == looks(list(many))[d] for d in named)
