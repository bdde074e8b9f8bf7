"""Parameters, disturbances and secants: what they hold, what they compute, and what they refuse."""

from __future__ import annotations

import pickle
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rounding import rounding
from toy_plants import chain

from fusion_sfdia.models.two_tanks.plant import two_tanks
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.secants import secants
from fusion_sfdia.plant.uncertainty import Disturbance, Parameter, Uncertainty

Array = NDArray[Any]
NAN, INF = float("nan"), float("inf")
X, U = np.array([[1.2, 0.7], [0.9, 1.4]]), np.full((2, 1), 6e-4)
OUTLET = Parameter("outlet", "1", 1.0, 0.05)


def still(t_start: float, x: Array, u: Array, dt: float, theta: Array) -> Array:
    return x


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"sd": 0.0}, "sd is 0.0; it must be positive and finite"),
        ({"sd": INF}, "sd is inf; it must be positive and finite"),
        ({"rate": -1.0}, "rate is -1.0; it must be finite and at least 0"),
        ({"nominal": NAN}, "nominal"),
        ({"treatment": "known"}, "treatment is 'known'; expected one of estimated, considered, frozen"),
        ({"low": 1.0}, "nominal is 0.0; expected a value from low 1.0 to high inf"),
    ],
)
def test_a_parameter_states_its_spread(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=f"parameter 'a'.*{message}|a.*{message}"):
        Parameter("a", **wrong)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"sd": -1.0}, "sd is -1.0; it must be positive and finite"),
        ({"time_constant": 0.0}, "time_constant is 0.0 s; it must be positive"),
        ({"treatment": ""}, "treatment is ''; expected one of estimated"),
    ],
)
def test_a_disturbance_states_its_size_and_time(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=f"disturbance 'd': {message}"):
        Disturbance("d", np.zeros(2), np.zeros(2), **wrong)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            {"parameters": (Parameter("a"),)},
            "without the model at other values; give step and output, or use fusion_sfdia.plants.secants",
        ),
        ({"parameters": (Parameter("a"), Parameter("a")), "step": still}, "the names a occur more than once"),
        ({"parameters": ("a",), "step": still}, "parameters have 'a'; expected objects of Parameter"),
        ({"step": 1.0}, "step at other values of the parameters is 1.0; expected a function or None"),
        ({"inputs": {"inflow": 0.0}}, "error of input 'inflow' is 0.0"),
        ({"changes": {"roughness": -1.0}}, "change of 'roughness' is -1.0; its standard deviation must be positive and finite"),
    ],
)
def test_what_does_not_fit_together_is_refused(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Uncertainty(**wrong)


def test_a_considered_name_is_that_of_a_state() -> None:
    with pytest.raises(ValueError, match="plant 'chain' has no states y7 to consider; states: x0, x1, x2"):
        with_considered(chain(3), "y7")
    assert list(with_considered(chain(3), "x2", "x1").considered) == [1, 2]
    assert chain(3).considered is None


def with_considered(plant: Plant, *names: str) -> Plant:
    return Plant(
        plant.name, plant.states, plant.sensors, plant.step, plant.output, 1.0, (), plant.x0, plant.initial_cov,
        plant.process_cov, numerics=plant.numerics, uncertainty=Uncertainty(considered=names),
    )  # fmt: skip


def test_secants_are_the_rebuilt_plants_at_one_standard_deviation_and_the_plant_at_the_nominal_value() -> None:
    plant = two_tanks()
    at = secants(plant, [OUTLET], two_tanks)
    for outlet in (0.95, 1.0, 1.05):
        theta, other = np.full((2, 1), outlet), two_tanks(outlet=outlet)
        assert at.step is not None and at.output is not None
        # f + (f+ - f-) / 2 + (f+ + f- - 2 f) / 2: ten roundings of numbers of the size of f
        for got, expected in (
            (at.step(0.0, X, U, 5.0, theta), other.step(0.0, X, U, 5.0)),
            (at.output(0.0, X, U, theta), other.output(0.0, X, U)),
        ):
            np.testing.assert_allclose(got, expected, rtol=rounding(1.0, 10), atol=0)


def test_between_them_secants_err_with_the_third_power_of_the_spread() -> None:
    """The quadratic through three points errs by f''' / 6 times three distances: an eighth for half the spread."""
    errors = []
    for sd in (0.02, 0.01):
        at = secants(two_tanks(), [Parameter("outlet", "1", 1.0, sd)], two_tanks)
        assert at.step is not None
        outlet = 1.0 + 1.5 * sd
        exact = two_tanks(outlet=outlet).step(0.0, X, U, 60.0)
        errors.append(np.abs(at.step(0.0, X, U, 60.0, np.full((2, 1), outlet)) - exact))
    # the next power changes the ratio by about the spread times the ratio of derivatives, some per cent
    np.testing.assert_allclose(errors[0] / errors[1], 8.0, rtol=0.15)


def test_a_plant_built_anew_is_read_in_the_same_units() -> None:
    plant = two_tanks()
    known = replace(plant, uncertainty=secants(plant, [OUTLET], two_tanks)).in_units({"l2": ("mm", 1000.0)}).uncertainty
    assert known.rebuild is not None and known.output is not None
    other = known.rebuild(outlet=1.05)
    assert other.sensors[1].unit == "mm"
    np.testing.assert_allclose(
        known.output(0.0, X, U, np.full(1, 1.05)), other.output(0.0, X, U), rtol=rounding(1.0, 10), atol=0
    )


def test_secants_build_plants_at_first_use_and_can_be_pickled() -> None:
    built = []

    def rebuild(**values: float) -> Plant:
        built.append(values)
        return two_tanks(**values)

    at = secants(two_tanks(), [OUTLET], rebuild)
    assert at.step is not None and not built
    at.step(0.0, X, U, 5.0, np.ones(1))
    at.step(0.0, X, U, 5.0, np.ones(1))
    assert built == [{"outlet": 0.95}, {"outlet": 1.05}]
    copy = pickle.loads(pickle.dumps(secants(two_tanks(), [OUTLET], two_tanks)))
    np.testing.assert_array_equal(copy.step(0.0, X, U, 5.0, np.full(1, 1.01)), at.step(0.0, X, U, 5.0, np.full(1, 1.01)))


def test_a_rebuilt_plant_has_the_same_sensors() -> None:
    at = secants(chain(3), [Parameter("n", nominal=3.0, sd=1.0)], partial(_chain, 0))
    assert at.step is not None
    with pytest.raises(ValueError, match="parameter 'n': the plant rebuilt with the value 2 has other states"):
        at.step(0.0, np.zeros(3), np.zeros(0), 1.0, np.zeros(1))


def _chain(ignored: int, n: float) -> Plant:
    return chain(int(n))
