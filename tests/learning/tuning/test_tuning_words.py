"""What tuning has learnt is printed with units and with the signals that it moves."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from toy_plants import chain

from fusion_sfdia.common.rate import Rate
from fusion_sfdia.learning.commissioning.disturbances import FoundDisturbance, moves
from fusion_sfdia.learning.tuning.tail import Threshold
from fusion_sfdia.learning.tuning.words import _learnt, remarks

RIGHT = Threshold(1.0, 0.9, 1.1, True, 0.0, 20.0)


def test_a_disturbance_is_told_by_the_signals_that_it_moves_most() -> None:
    """Over their noise: a state of 0.1 a step, a sensor of 1; what is not moved is not named."""
    none = np.empty((0, 0))
    found = FoundDisturbance(np.array([0.0, 0.05, 0.0]), np.array([-1.0, 0.0, 0.0]), none, none, 4.0, 0.2, 50.0, 1.0)
    plain = chain(3)
    plant = replace(plain, sensors=(replace(plain.sensors[0], unit="K"), *plain.sensors[1:]))
    assert moves(plant, found) == "s0 by -4 +- 0.2 K, x1 by 0.2 +- 0.01 a step"


def test_what_was_learnt_is_printed_with_units() -> None:
    area = {"value": 2.0, "sd": 0.1, "stated": 1.0, "stated_sd": 0.5, "unit": "m2"}
    moved = {"moves": "TI102 by 0.67 +- 0.02 K", "time_constant": 50.0}
    assert _learnt({"sensors": {}, "parameters": {"area": area}, "disturbance": [moved]}) == [
        "area: 2 +- 0.1, stated 1 +- 0.5 m2",
        "disturbance 1: moves TI102 by 0.67 +- 0.02 K; time constant 50 s",
    ]


def said(nis_before: float, outlet: float, mean: float, first_error: float = 1.0, low: str = "0") -> list[str]:
    """The remarks on a pump as stated, an outlet so many deviations off, a disturbance of that mean, and rates from low on."""
    known = SimpleNamespace(
        names=("outlet", "pump"), value=np.array([1 + 0.03 * outlet, 1.0]), prior=np.ones(2), prior_sd=np.array([0.03, 0.03])
    )
    found: Any = SimpleNamespace(parameters=known, disturbances=(SimpleNamespace(mean=mean),), first_error=first_error)
    achieved = {"rate": "309.3/day", "low": low}
    return remarks(found, {"nis_before": nis_before, "nis": 1.0, "coloured": 0.05, "achieved": achieved}, RIGHT, Rate(1, "day"))


@pytest.mark.parametrize(
    ("nis_before", "outlet", "mean", "of"),
    [
        (1124.0, -4.0, -317.0, "outlet 4.0 of its stated deviations off, a lasting disturbance of 317 of its standard errors"),
        (1124.0, -4.0, 5.0, "outlet 4.0 of its stated deviations off"),
        (1124.0, 1.0, 317.0, "a lasting disturbance of 317 of its standard errors"),
    ],
)
def test_what_is_absurd_comes_first_with_units(nis_before: float, outlet: float, mean: float, of: str) -> None:
    first, *others = said(nis_before, outlet, mean)
    assert first.startswith("check the units of inputs and sensors: ")
    assert "errs 34 times as much as it expects" in first and f"predicted only with {of}, which" in first
    assert len(others) == (abs(outlet) > 3)


def test_a_model_that_is_off_is_not_called_a_wrong_unit() -> None:
    assert said(35.0, 1.0, 4.0) == said(1124.0, 1.0, 4.0) == []
    (off,) = said(35.0, 4.0, 4.0)
    assert off.startswith("outlet is 4.0 of its stated deviations off")


def test_a_rate_that_does_not_hold_is_remarked() -> None:
    (off,) = said(1.0, 1.0, 1.0, low="183.3/day")
    assert off.startswith("with thresholds of one half of the log there are 309.3/day in the other, where 1/day is stated")
    assert said(1.0, 1.0, 1.0, low="0.9/day") == []


def test_runs_that_begin_elsewhere_are_remarked() -> None:
    (off,) = said(1.0, 1.0, 1.0, first_error=33.6)
    assert off.startswith("runs begin 5.8 times as far from the plant's x0 as it expects")
    assert said(1.0, 1.0, 1.0, first_error=8.0) == []
