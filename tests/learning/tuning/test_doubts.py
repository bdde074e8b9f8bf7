"""What was learnt is doubted first of all where only a wrong unit is likely to explain it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fusion_sfdia.common.rate import Rate
from fusion_sfdia.learning.tuning.doubts import remarks
from fusion_sfdia.learning.tuning.tail import Threshold

RIGHT = Threshold(1.0, 0.9, 1.1, True, 0.0, 20.0)


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
