"""Cyclic values: a residual of a compass is wrapped, whatever turn the model is on."""

import numpy as np
import pytest

from fusion_sfdia import Plant, Sensor, Signal
from fusion_sfdia.plant.cyclic import Cyclic, cyclic, near


def test_differences_are_wrapped_into_half_a_period_on_either_side() -> None:
    of = cyclic([360.0, None])
    expected = np.array([[359.0, 0.0], [-1.0, 0.0], [1081.0, 0.0], [180.0, 0.0], [0.0, 0.0], [10.0, 0.0]])
    y = np.array([[1.0, 500.0], [359.0, 500.0], [2.0, 500.0], [0.0, 500.0], [180.0, 500.0], [np.nan, 500.0]])
    residual = near(y, expected, of) - expected
    np.testing.assert_allclose(residual[:, 0], [2.0, 0.0, 1.0, -180.0, -180.0, np.nan], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(residual[:, 1], 500.0)
    assert y[0, 0] == 1.0, "the readings that are given stay as they are"


def test_nothing_is_copied_without_a_cyclic_value() -> None:
    y = np.array([1.0, 2.0])
    assert cyclic([None, None]) is None
    assert near(y, np.zeros(2), None) is y


def test_an_unknown_prediction_leaves_the_reading() -> None:
    of = Cyclic(np.array([0]), np.array([2.0]))
    np.testing.assert_array_equal(near(np.array([5.0]), np.array([np.nan]), of), [5.0])
    np.testing.assert_array_equal(near(np.array([5.0]), np.array([np.inf]), of), [5.0])


def _compass(**settings: object) -> Plant:
    return Plant(
        "compass",
        (Signal("heading", "deg", initial_sigma=1.0, process_sigma=0.1, period=360.0, **settings),),  # type: ignore[arg-type]
        (Sensor("north", "heading", "deg", sigma=1.0), Sensor("other", "bearing", "deg", sigma=1.0)),
        lambda t, x, u, dt: x,
        lambda t, x, u: np.concatenate([np.mod(x, 360.0), x], axis=-1),
        dt=1.0,
    )


def test_a_sensor_has_the_period_of_what_it_measures_in_its_own_unit() -> None:
    plant = _compass()
    assert plant.cyclic_sensors is not None
    np.testing.assert_array_equal(plant.cyclic_sensors.at, [0])
    in_turns = plant.in_units({"north": ("turn", -1 / 360)}).cyclic_sensors
    assert in_turns is not None
    np.testing.assert_allclose(in_turns.period, [1.0], rtol=1e-15)


def test_the_period_of_a_sensor_itself_counts_before_that_of_the_variable() -> None:
    own = Plant(
        "half-turn",
        (Signal("heading", "deg", initial_sigma=1.0, process_sigma=0.1, period=360.0),),
        (Sensor("axis", "heading", "deg", sigma=1.0, period=180.0),),
        lambda t, x, u, dt: x,
        lambda t, x, u: x,
        dt=1.0,
    )
    assert own.cyclic_sensors is not None
    np.testing.assert_array_equal(own.cyclic_sensors.period, [180.0])
    np.testing.assert_array_equal(own.in_units({"axis": ("turn", 1 / 360)}).cyclic_sensors.period, [0.5])  # type: ignore[union-attr]


def test_the_jacobian_of_a_modulo_is_one_at_its_jump_too() -> None:
    plant = _compass()
    for heading in (0.0, 359.999999, 360.0, 720.0, 100.0):
        np.testing.assert_allclose(
            plant.output_jacobian_at(0.0, np.array([heading]), np.empty(0)), [[1.0], [1.0]], rtol=0, atol=1e-8
        )


def test_limits_a_period_apart_do_not_hold_a_turning_state() -> None:
    low, high = _compass(low=0.0, high=360.0).state_limits
    assert low[0] == -np.inf
    assert high[0] == np.inf
    low, high = _compass(low=-90.0, high=90.0).state_limits
    assert (low[0], high[0]) == (-90.0, 90.0)


@pytest.mark.parametrize("period", [0.0, -360.0, np.inf, np.nan])
def test_a_period_is_positive_and_finite(period: float) -> None:
    with pytest.raises(ValueError, match=r"period is .*; it must be positive and finite"):
        Signal("heading", "deg", period=period)
    with pytest.raises(ValueError, match=r"period is .*; it must be positive and finite"):
        Sensor("north", "heading", "deg", sigma=1.0, period=period)
