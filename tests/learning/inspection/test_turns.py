"""A modulo in a model is named with its period, unless the plant states it."""

import numpy as np
import pytest
from turning_car import TURN, car

from fusion_sfdia import Plant, Sensor, Signal, inspect
from fusion_sfdia.detectors import registry
from fusion_sfdia.learning.inspection.turns import beyond_a_turn, of_turns, turns


@pytest.mark.parametrize("model", ["modulo in the output", "modulo in the step"])
def test_the_jumps_of_a_modulo_are_found_with_their_period(model: str) -> None:
    found = turns(car(model, period=None))
    assert {t.name for t in found} >= {"compass_1", "compass_2", "compass_3"}
    for turn in found:
        assert turn.period == pytest.approx(TURN, rel=1e-6)
        assert (turn.state, turn.of, turn.unit) == ("heading", "heading", "deg")
        assert turn.at == pytest.approx(TURN, abs=2.0)
    (finding,) = of_turns(found)
    assert finding.kind == "remark"
    assert "jump by 360 deg where heading passes 36" in finding.text
    assert "Signal(period=360) of heading" in finding.text


@pytest.mark.parametrize("model", ["turns counted", "modulo in the output", "modulo in the step"])
def test_a_stated_period_is_no_remark(model: str) -> None:
    assert turns(car(model)) == []
    assert list(beyond_a_turn(car(model))) == []


def test_an_angle_that_the_model_counts_beyond_a_turn_is_a_remark() -> None:
    (finding,) = beyond_a_turn(car(period=None))
    assert finding.about == "compass_1, compass_2, compass_3"
    assert "state Signal(period=360) of heading" in finding.text
    assert turns(car(period=None)) == []


def test_a_saturation_or_a_switch_is_no_period() -> None:
    plant = Plant(
        "switched",
        (Signal("flow", "m3/s", nominal=1.0, initial_sigma=0.1, process_sigma=0.1),),
        (Sensor("meter", "flow", "m3/s", sigma=0.1),),
        lambda t, x, u, dt: x,
        lambda t, x, u: np.where(np.floor(x) < 3.0, x, x + 5.0),
        dt=1.0,
    )
    assert turns(plant) == []


@pytest.mark.parametrize("name", ["two-tanks", "gas-pipeline", "marine-engine", "power-network"])
def test_the_plants_of_the_package_have_none(name: str) -> None:
    plant = registry.plant(name)
    assert turns(plant) == []
    assert list(beyond_a_turn(plant)) == []


def test_inspect_states_it() -> None:
    found = inspect(car("modulo in the output", period=None), simulated=False)
    assert any("Signal(period=360) of heading" in f.text for f in found.remarks)
    assert not any("Signal(period" in f.text for f in inspect(car("modulo in the output"), simulated=False).findings)
