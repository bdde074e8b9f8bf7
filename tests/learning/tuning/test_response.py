"""A tuned file notices that the equations of its plant have changed, and accepts what rounding or its age explain."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from toy_plants import Array, tanks

from fusion_sfdia.learning.tuning.response import ModelChangedWarning, response, warn_of_change
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal


def level(t: float, x: Array, u: Array, dt: float, *, area: float) -> Array:
    return np.asarray(x + dt * (u - 1e-3 * np.sqrt(x)) / area)


def reading(t: float, x: Array, u: Array, *, gain: float = 1.0) -> Array:
    return gain * x


def tank(area: float = 4.0, **settings: Any) -> Plant:
    """A tank that begins at rest, where its area shows in nothing."""
    state = Signal("level", "m", nominal=1.0, low=0.1, initial_sigma=0.02, process_sigma=1e-3)
    return replace(
        Plant(
            "tank", (state,), (Sensor("l", "level", "m", sigma=0.01),), partial(level, area=area), reading, 60.0,
            inputs=(Signal("inflow", "m^3/s", nominal=1e-3),),
        ),
        **settings,
    )  # fmt: skip


@pytest.mark.parametrize("changed", [tank(8.0), tank(4.004), tank(output=partial(reading, gain=1.001))])
def test_a_changed_equation_is_warned_of(changed: Plant) -> None:
    with pytest.warns(ModelChangedWarning, match="plant 'tank' has changed since it was tuned.*tune again"):
        warn_of_change({"response": response(tank())}, changed)


@pytest.mark.parametrize("kept", [{}, {"response": []}, {"response": [v * (1 + 1e-12) for v in response(tank())]}])
def test_the_same_equations_and_older_files_are_accepted(kept: dict[str, Any]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_change(kept, tank())
        warn_of_change({"response": response(tanks())}, tanks())


def test_what_tune_does_not_write_is_refused() -> None:
    for wrong in (1.0, ["x"]):
        with pytest.raises(ValueError, match="response is"):
            warn_of_change({"response": wrong}, tank())


def fails(*given: Any) -> Array:
    raise ArithmeticError("no solution")


def test_a_plant_that_cannot_be_evaluated_beside_its_start_is_not_watched() -> None:
    assert response(replace(tank(), step=partial(level, area=0.0))) == []
    ready = tank()
    object.__setattr__(ready, "step", fails)
    assert response(ready) == []
