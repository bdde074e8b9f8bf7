"""Operating points of the marine engine: its variables at given states, and the states at rest at a given load."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import batch_rows
from fusion_sfdia.models.marine_engine import equations
from fusion_sfdia.models.marine_engine.equations import ALGEBRAIC, STATES, EngineParameters

Array = NDArray[Any]

LOADS = (0.2, 1.0)  # fuel setting; below, the turbocharger delivers almost nothing and the law of the slip does not hold
ITERATIONS = 30
TOLERANCE = 1e-12  # of the equilibrium's residual, relative
CONTINUATION = 0.05  # in load, from full load, where the solution is known


def engine_variables(x: Array, c: EngineParameters, slip: str = "law") -> dict[str, Array]:
    """All variables by name, each (...), of states x (..., 3), and the speed n (1/s), power (W) and slip.

    Raises ValueError for states that are not positive and finite, or with which the cycle gives no torque.
    """
    x = np.asarray(x, dtype=float)
    if x.shape[-1:] != (len(STATES),):
        raise ValueError(f"states have shape {x.shape}; expected (..., {len(STATES)}): {', '.join(STATES)}")
    for i, name in enumerate(STATES):
        if not np.all(np.isfinite(x[..., i]) & (x[..., i] > 0)):
            raise ValueError(f"{name} is {np.min(x[..., i]):g}; fuel and pressures must be positive and finite")
    z = equations.algebraic(batch_rows(x, x.shape[:-1], float), equations.unknown_of(c)[None], c, follows_law(slip))
    z = z.reshape(*x.shape[:-1], len(ALGEBRAIC))
    bad = [name for i, name in enumerate(ALGEBRAIC) if not np.all(z[..., i] > 0)]
    if bad:
        raise ValueError(
            f"the states {x.tolist()} give no positive {', '.join(bad)}; the engine cannot run there: give more fuel "
            "or less air"
        )
    found = dict(zip((*STATES, *ALGEBRAIC), np.moveaxis(np.concatenate([x, z], axis=-1), -1, 0), strict=True))
    speed = np.sqrt(2 * np.pi / c.load * found["torque"])
    return found | {"speed": speed, "power": 2 * np.pi * speed * found["torque"]}


def follows_law(slip: str) -> bool:
    """Whether the slip follows its law; ValueError for a name that is neither "law" nor "constant"."""
    if slip not in ("law", "constant"):
        raise ValueError(f"slip is {slip!r}; known: law, constant")
    return slip == "law"


def equilibrium(load: float, c: EngineParameters, slip: str = "law") -> Array:
    """States (3,) at rest at a constant fuel setting `load` (1 is full load), to 1e-12.

    x(3) = tau_pd h(3) and x(4) = tau_TC h(4) by Newton's method in the logarithms of the pressures, by continuation
    from full load. Raises ValueError for a load out of range, ArithmeticError with the residual where no equilibrium is found.
    """
    if not LOADS[0] <= load <= LOADS[1]:
        raise ValueError(f"load is {load}; the engine's model holds from {LOADS[0]} to {LOADS[1]} of full load")
    law = follows_law(slip)
    logs = np.log([c.p_receiver_nominal, c.p_charge_nominal])
    steps = int(np.ceil((1.0 - load) / CONTINUATION))
    for stage in np.linspace(1.0, load, steps + 1):
        logs = _settle(float(stage), logs, c, law)
    return np.array([c.full_injection * load, *np.exp(logs)])


def _settle(load: float, logs: Array, c: EngineParameters, law: bool) -> Array:
    fuel = c.full_injection * load

    tau, theta = np.array([c.receiver_delay, c.charge_delay]), equations.unknown_of(c)
    h, J = np.empty(2), np.empty((2, len(STATES)))
    with np.errstate(all="ignore"):
        for _ in range(ITERATIONS):
            p = np.exp(logs)
            equations.inflow_derivatives(np.array([fuel, *p]), theta, h, J, c, law)
            r = np.log(h * tau) - logs
            if np.max(np.abs(r)) < TOLERANCE:
                return logs
            slope = J[:, 1:] * p / h[:, None] - np.eye(2)
            if not (np.all(np.isfinite(r)) and np.all(np.isfinite(slope)) and np.linalg.cond(slope) < 1e12):
                break
            step = np.linalg.solve(slope, r)
            logs = logs - step * min(1.0, 0.2 / float(np.max(np.abs(step))))
    raise ArithmeticError(
        f"no equilibrium at load {load:g}: residual {np.max(np.abs(r)):.3g} of the pressures "
        f"{np.exp(logs[0]):.4g} and {np.exp(logs[1]):.4g} Pa, expected {TOLERANCE:g}; choose another load or other parameters"
    )
