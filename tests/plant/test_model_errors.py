"""A model that fails in a diagnosis of a log is named, with the time, its function and the line."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from toy_plants import readings, tanks

from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.diagnoser import diagnose
from fusion_sfdia.plant.model_errors import ModelError, described, require_model


class OwnError(Exception):
    """An error of a model."""


@pytest.mark.parametrize(
    "error", [KeyError("flow"), IndexError("3"), OwnError("own"), ValueError("negative"), ZeroDivisionError(), SystemExit(0)]
)
@pytest.mark.parametrize("which", ["step", "output"])
def test_the_error_names_plant_time_function_line_and_cause(error: BaseException, which: str) -> None:
    plant = tanks()
    own: Any = getattr(plant, which)

    def leaking(t: float, *arguments: Any) -> Any:
        if t == 50.0:
            raise error
        return own(t, *arguments)

    t, _, y, u = readings(plant, 30, 1, seed=1)
    detector = LeaveOneOutBank(replace(plant, **{which: leaking}))
    at = "55 s" if which == "step" else "50 s"
    expected = (
        rf"the model of plant '{plant.name}' failed at {at}: its function `leaking` \(test_model_errors.py, line \d+\) raised "
    )
    with pytest.raises(ModelError, match=expected + type(error).__name__) as caught:
        diagnose(detector, t, y[:, 0], u[:, 0])
    assert caught.value.__cause__ is error


def test_an_error_of_the_caller_stays_what_it_is() -> None:
    t, _, y, u = readings(tanks(), 30, 1, seed=1)
    with pytest.raises(ValueError, match="expected") as caught:
        diagnose(LeaveOneOutBank(tanks()), t, y[:, 0, :2], u[:, 0])
    assert not isinstance(caught.value, ModelError)


@pytest.mark.parametrize(
    ("given", "came"),
    [
        (None, "None"), ("nan", "values of type <U3"), ({}, "dict"), ([[1.0], [1.0, 2.0]], "list"),
        (1.0, r"float of shape \(\)"), (np.ones(3) + 1j, "values of type complex128"), (np.ones(3), r"ndarray of shape \(3,\)"),
    ],
)  # fmt: skip
def test_what_a_model_gives_in_place_of_numbers_is_named(given: Any, came: str) -> None:
    plant = replace(tanks(), step=lambda t, x, u, dt: given if np.ndim(x) == 1 else x)
    with pytest.raises(
        ModelError, match=f"its step gives {came} for one state; expected 2 real numbers, shape \\(2,\\)"
    ) as caught:
        require_model(plant, 0.0, 5.0, plant.x0, plant.input_at(0.0))
    assert described(caught.value) == str(caught.value)
