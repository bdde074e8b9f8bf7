"""A speed governor for load transients of the marine engine: a PI loop with limits.

The papers run at a constant fuel setting; there u is known and no reading acts on the engine. In the model the speed follows
the torque by the propeller law at once, without inertia, so the loop must be slower than the fuel pump. Gains are our choice.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.models.marine_engine.equations import EngineParameters
from fusion_sfdia.models.marine_engine.equilibrium import LOADS
from fusion_sfdia.models.marine_engine.faults import EngineFault, parameter_schedule
from fusion_sfdia.models.marine_engine.parameters import engine_parameters
from fusion_sfdia.models.marine_engine.plant import marine_engine

Array = NDArray[Any]


@dataclass(frozen=True)
class Governor:
    """u = proportional e + integral of e, within the limits of the load, with the speed error e = reference - speed (1/s).

    proportional in setting per 1/s of speed, integral in setting per revolution.
    """

    proportional: float = 0.03
    integral: float = 0.15

    def __post_init__(self) -> None:
        for name in ("proportional", "integral"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise ValueError(f"the governor's {name} gain is {getattr(self, name)}; expected a finite number of at least 0")


def governed_settings(
    speed: Callable[[float], float],
    steps: int,
    *,
    governor: Governor | None = None,
    dt: float = 0.01,
    load: float = 1.0,
    slip: str = "law",
    parameters: EngineParameters | None = None,
    process_faults: Sequence[EngineFault] = (),
) -> Array:
    """Fuel settings (K, 1) by which a governor holds the reference speed (1/s) at each time (s), for `simulate(inputs=...)`.

    The other arguments are those of `marine_engine`: the engine that is governed, from its equilibrium at `load`. The governor
    measures the true speed, starts in balance, and stops integrating at a limit of the load. Raises ValueError for a speed
    that is not positive and finite.
    """
    law = governor or Governor()
    c = engine_parameters() if parameters is None else parameters
    plant = marine_engine(load=load, dt=dt, slip=slip, parameters=c, process_faults=process_faults)
    parameters_at = parameter_schedule(c, process_faults, slip)
    torque = plant.sensor_index("S(2){3}")
    x, u = plant.x0, plant.input_at(0.0)
    memory = float(u[0])
    settings = np.empty((steps, 1))
    for k in range(steps):
        t = k * dt
        expected = speed(t)
        if not (np.isfinite(expected) and expected > 0):
            raise ValueError(f"the reference speed at {t:g} s is {expected}; expected a positive number in 1/s")
        missing = expected - float(np.sqrt(2 * np.pi / parameters_at(t).load * plant.output(t, x, u)[torque]))
        free = memory + law.integral * missing * dt + law.proportional * missing
        u = np.clip([free], *LOADS)
        if u[0] == free:
            memory += law.integral * missing * dt
        settings[k] = u
        x = plant.step(t, x, u, dt)
    return settings
