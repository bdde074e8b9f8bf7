"""Tuning of the frozen model: what is not healthy is left out and listed; the file gives the same decisions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from toy_plants import tanks

from fusion_sfdia.common.clock import Clock, posix
from fusion_sfdia.detectors.detector import run
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.learning.frozen_model.frozen_bank import FrozenBank
from fusion_sfdia.learning.tuning.tune import HealthySource, tune
from fusion_sfdia.learning.tuning.tuned import Tuned
from fusion_sfdia.learning.tuning.words import as_text
from fusion_sfdia.plant.log import Log

PLANT = tanks()
NAME = "frozen-model"


@cache
def healthy(seed: int = 1, steps: int = 1500) -> Log:
    found = simulate(PLANT, steps, [seed], process_noise=True)
    return Log(found.t, found.y[:, 0], found.u)


@cache
def tuned() -> Tuned:
    return tune(PLANT, healthy(), false_alarm="1/hour", detector=NAME)


def test_the_file_gives_the_same_decisions(tmp_path: Path) -> None:
    tuned().write(tmp_path / "tuned.toml")
    other = Tuned.read(tmp_path / "tuned.toml").detector(PLANT)
    assert isinstance(other, FrozenBank) and other.threshold_scale == tuned().threshold_scale
    log = healthy(2, 300)
    one, two = (run(d, d.init((), 0.0), log)[1] for d in (tuned().detector(PLANT), other))
    np.testing.assert_array_equal(one.threshold, two.threshold)
    text = as_text(tuned())
    assert "blocks that were not learnt" in text and "stated" in text and "nis" not in tuned().quality


@pytest.mark.slow
def test_what_is_not_healthy_is_left_out_and_listed_on_the_wall_clock() -> None:
    log = healthy()
    y = log.y.copy()
    y[1000:1200, 1] = y[1000, 1]
    y[300:340] += 60 * PLANT.sensor_sigma
    clock = Clock(datetime(2023, 11, 14, 22, 13, tzinfo=UTC))
    found = tune(PLANT, log._replace(y=y), detector=NAME, sources=[HealthySource("day.csv", clock)])
    out = [r for r in found.quality["remarks"] if r.startswith("left out: ")]
    assert len(out) == 2 and found.detector(PLANT).commissioned == posix(clock.moment(float(log.t[-1])))
    assert f"{PLANT.sensor_names[1]} from {clock.at(float(log.t[1000]))} to {clock.at(float(log.t[1199]))}" in out[0]
    assert "all readings from 2023-" in out[1] and "as far off" in out[1]
    with pytest.raises(ValueError, match=r"readings that are not healthy: .*the same reading 200 times; all readings from"):
        tune(PLANT, log._replace(y=y), detector=NAME, sources=[HealthySource("day.csv", clock)], strict=True)
    assert not any(r.startswith("left out") for r in tuned().quality["remarks"])


def test_its_passes_are_shown_step_by_step() -> None:
    log, passes = healthy(steps=400), list[str]()

    def each(steps: Sequence[int], what: str) -> Iterable[int]:
        passes.append(what)
        return iter(steps)

    shown, silent = (tune(PLANT, log, detector=NAME, **given) for given in ({"each": each}, {}))
    assert shown.document == silent.document
    assert passes == [*(f"learning, pass {k} of 4" for k in range(1, 5)), "trying the adaptive bank"]


def test_a_log_too_short_for_slow_drifts_says_so() -> None:
    found = tune(PLANT, healthy(steps=400), detector=NAME)
    assert any("too short for windows of" in remark for remark in found.quality["remarks"])


@pytest.mark.slow
def test_a_fault_in_the_healthy_log_is_named_and_refused_if_strict() -> None:
    log = healthy(steps=450)
    y = log.y.copy()
    y[200:320, 1] += 8 * PLANT.sensor_sigma[1]
    with pytest.raises(
        ValueError, match=rf"are not healthy: from .* this looks like a fault of {PLANT.sensor_names[1]} in the h"
    ):
        tune(PLANT, log._replace(y=y), detector=NAME, strict=True)
    assert not any("fault of" in r for r in tuned().quality["remarks"])
