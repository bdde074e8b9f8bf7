"""What a model costs, and why it is slow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from toy_plants import Array, chain, tanks

from fusion_sfdia.learning.inspection.cost import Cost, cost, of_cost
from fusion_sfdia.learning.inspection.inspect import inspect


def test_a_fast_model_has_no_remark() -> None:
    assert not list(of_cost(tanks(), Cost(2e-4, 7e-4, 1.0)))


@pytest.mark.parametrize(
    ("found", "reason"),
    [
        (Cost(2e-3, 6e-3, 7e-3), "a batch of 4 states takes 4 times as long as one"),
        (
            Cost(2e-3, 2e-3, 2.1e-3),
            "a step takes 2 ms and its Jacobian 2 ms, so that a stream has at most 2.5e.02 rows a second",
        ),
        (Cost(2e-3, 2e-3, 2.1e-3), "give the equations to `discretise`"),
    ],
)
def test_why_a_model_is_slow(found: Cost, reason: str) -> None:
    plant = replace(chain(3), numerics=replace(chain(3).numerics, step_jacobian=None), step=by_state)
    (remark,) = of_cost(plant, found)
    assert np.char.find(str(remark), "speed: ") == 0
    assert reason.replace(".02", "+02") in remark.text


def test_a_slow_jacobian_of_its_own() -> None:
    plant = replace(chain(3), numerics=replace(chain(3).numerics, step_jacobian=lambda *_: np.eye(3)))
    (remark,) = of_cost(plant, Cost(1e-4, 5e-3, 1.0))
    assert "the Jacobian that the plant states" in remark.text


def by_state(t_start: float, x: Array, u: Array, dt: float) -> Array:
    """A step that counts the states that it takes, one by one."""
    COUNT[0] += x.size // x.shape[-1]
    return 0.9 * x


COUNT = [0]


def test_the_clock_is_that_of_the_calls() -> None:
    """With the number of states that were stepped as the clock: 1, the complex step's 3 and a batch of 4."""
    plant = replace(chain(3), numerics=replace(chain(3).numerics, step_jacobian=None), step=by_state)
    plant.step_jacobian_at(0.0, plant.x0, plant.input_at(0.0), plant.dt)
    assert cost(plant, lambda: float(COUNT[0])) == (1.0, 3.0, 4.0)


def test_an_inspection_states_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fusion_sfdia.learning.inspection.inspect.cost", lambda plant: Cost(2e-3, 2e-3, 2e-3))
    assert "speed" in {f.about for f in inspect(chain(3), simulated=False).findings}
