"""Whether the nominal state is steady under the nominal inputs, as far as the plant claims to know it.

A nominal state is rounded: the steady one is x0 + e, where e has the initial covariance P0. With the Jacobian F of a step and
the process noise w, x0 then moves by about w - (F - I) e in a step, of covariance (F - I) P0 (F - I)' + Q. A far larger
movement contradicts what the plant states: a nominal value, or a constant of an equation, in another unit.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fusion_sfdia.common.covariance import dense, diagonal
from fusion_sfdia.learning.inspection.plant_findings import REMARK, PlantFinding
from fusion_sfdia.plant.plant import Plant

MOST = 5.0  # standard deviations: Gaussian chance 6e-7 a state


def of_start(plant: Plant) -> Iterator[PlantFinding]:
    """That x0 moves under the inputs at 0 s by more than its uncertainty and the process noise account for."""
    x, u = plant.x0, plant.input_at(0.0)
    with np.errstate(all="ignore"):
        moved = plant.step(0.0, x, u, plant.dt) - x
        A = plant.step_jacobian_at(0.0, x, u, plant.dt) - np.eye(x.size)
        sigma = np.sqrt(diagonal(A @ dense(plant.initial_cov) @ A.T) + diagonal(plant.process_cov))
        rounding = 64 * np.finfo(float).eps * np.abs(x)
        times = np.where(np.abs(moved) <= rounding, 0.0, np.abs(moved) / sigma)
    worst = int(np.argmax(times))
    if times[worst] > MOST:
        state = plant.states[worst]
        yield PlantFinding(
            REMARK,
            "start",
            f"with the usual inputs the nominal state is not steady: {state.name} moves by {moved[worst]:.2g} {state.unit} in "
            f"a step of {plant.dt:g} s, {times[worst]:.2g} times what initial_sigma and process_sigma account for; if it is "
            f"meant to be steady, check the nominal values that the equation of {state.name} uses, its constants, and their "
            "units",
        )
