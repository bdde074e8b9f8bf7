"""Drift of the receiver's pressure between two readings while the load changes: proved, and tested with the worst noise."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
import pytest

from fusion_sfdia.derivatives.intervals.expression import record
from fusion_sfdia.derivatives.intervals.interval import Interval
from fusion_sfdia.derivatives.intervals.monotone import derivative, gradient
from fusion_sfdia.detectors.adaptive_thresholds.adaptive_threshold import AdaptiveThreshold
from fusion_sfdia.detectors.detector import run
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.models.marine_engine import equations, modules
from fusion_sfdia.models.marine_engine.equilibrium import engine_variables, equilibrium
from fusion_sfdia.models.marine_engine.parameters import engine_parameters
from fusion_sfdia.models.marine_engine.plant import marine_engine

C = engine_parameters()
# fuel, torque, p_receiver, p_charge about their nominal values: the load's range, and the envelope less twice the noise
BOX = np.array([modules.LOAD_RANGE, 0.05, 0.05, 0.05])


def followed(fuel: Any, torque: Any, p_receiver: Any, p_charge: Any) -> tuple[Any, Any]:
    """What p_receiver and p_charge run to, tau h (Pa), given the torque."""
    T_charge = equations.charge_temperature(C)
    p_cylinder = equations.cylinder_pressure(fuel, torque, p_charge, C)
    T_cylinder = equations.cylinder_temperature(fuel, torque, p_charge, T_charge, C)
    slip = equations.slip_law(torque, p_receiver, p_charge, T_charge, C)
    T_receiver = equations.receiver_temperature_at(fuel, p_cylinder, T_cylinder, slip, p_receiver, p_charge, T_charge, C)
    receiver = equations.receiver_inflow_at(fuel, torque, slip, T_receiver, p_charge, T_charge, C)
    charge = equations.charge_inflow_at(fuel, slip, p_receiver, T_receiver, p_charge, T_charge, C)
    return C.receiver_delay * receiver, C.charge_delay * charge


def swept(fuel: Any, torque: Any, p_charge: Any) -> Any:
    """The torque is the fixed point of this."""
    return equations.swept_torque(fuel, torque, p_charge, equations.charge_temperature(C), C)


def slopes(function: Callable[..., Any], middle: np.ndarray, share: np.ndarray, parts: int) -> list[Interval]:
    """Of each argument, times its middle: hulls over the box middle (1 +- share), cut into parts^n."""
    n = middle.size
    edges = [np.linspace(m * (1 - s), m * (1 + s), parts + 1) for m, s in zip(middle, share, strict=True)]
    index = np.array(list(product(range(parts), repeat=n)))
    boxes = [Interval(e[i], e[i + 1]) for e, i in zip(edges, index.T, strict=True)]
    expression = record(function, n)
    values = expression.evaluate(boxes)
    backward = gradient(expression, values)
    found = []
    for k in range(n):
        slope = backward[k].intersection(derivative(expression, values, k))
        found.append(Interval(float(np.min(slope.lo)), float(np.max(slope.hi))) * float(middle[k]))
    return found


@pytest.mark.parametrize("load", [1.0, 0.8, 0.6])
def test_the_receivers_drift_is_proved(load: float) -> None:
    """Interval slopes over the box in which load changes of LOAD_RANGE take place; the torque's by its fixed point."""
    x = equilibrium(load, C)
    middle = np.array([x[0], float(engine_variables(x, C)["torque"]), x[1], x[2]])
    t_fuel, t_torque, t_charge = (s / float(middle[1]) for s in slopes(swept, middle[[0, 1, 3]], BOX[[0, 1, 3]], 20))
    per_fuel, per_charge = t_fuel / (1 - t_torque), t_charge / (1 - t_torque)
    a: list[tuple[Interval, Interval, Interval]] = []
    for state in (0, 1):
        of = slopes(lambda *v, s=state: followed(*v)[s], middle, BOX, 12)
        fuel, torque, receiver, charge = (s / float(x[1 + state]) for s in of)
        a.append((fuel + torque * per_fuel, receiver, charge + torque * per_charge))
    (a1, a3, a4), imbalance = a[0], a[1]
    assert float(a3.hi) < 0 and float(a1.lo) > 0 and float(a4.lo) > 0
    assert float(a1.hi) / (1 - float(a3.hi)) <= modules.RECEIVER_PER_FUEL
    assert float(a4.hi) / (1 - float(a3.hi)) <= modules.RECEIVER_PER_CHARGE
    # g_4 - x_4 is 0 at rest: the mean value theorem over the box
    g1, g3, g4 = (max(-float(g.lo), float(g.hi)) for g in (imbalance[0], imbalance[1], imbalance[2] - 1))
    assert g1 * BOX[0] + g3 * BOX[2] + g4 * BOX[3] <= modules.CHARGE_IMBALANCE


LOADS: dict[str, Callable[[float], float]] = {
    **{f"down to {to}": lambda t, to=to: 1.0 if t < 0.2 else to for to in (0.99, 0.98, 0.97)},
    **{f"up from {of}": lambda t, of=of: of if 0.2 <= t < 0.7 else 1.0 for of in (0.98, 0.97)},
    "square waves": lambda t: 0.97 if int(t / 0.02 + 1e-6) % 2 else 1.0,
    "ramp": lambda t: 1.0 - 0.03 * min(1.0, t / 0.3),
}


def worst_noise(detector: AdaptiveThreshold, steps: int) -> np.ndarray:
    """Noise (K, 40, N) at its bounds: for each variable, sign and phase, what by its slopes moves its prediction away from
    its reading; a state's own reading changes its sign each sample, since its observer has followed the last one."""
    signs = np.where(detector.slopes.signs[:, :10] == 0, 1.0, detector.slopes.signs[:, :10])
    bound = np.array([s.noise_bound for s in detector.plant.sensors])
    runs = []
    for e, sign, phase in product(range(10), (1.0, -1.0), (0, 1)):
        noise = np.tile(-sign * signs[e], (steps, 1))
        noise[:, e] = sign * (-1.0) ** (np.arange(steps) + phase) if e < 3 else sign
        runs.append(noise[:, detector._variable] * bound)
    return np.stack(runs, axis=1)


def worst_score(detector: AdaptiveThreshold, load: Callable[[float], float], steps: int = 120) -> float:
    plant = detector.plant
    u = np.array([[load(k * plant.dt + 1e-9)] for k in range(steps)])
    recording = simulate(plant, steps, [0], inputs=u)
    y = recording.signal + worst_noise(detector, steps)
    start = detector.init((y.shape[1],), 0.0)
    return float(run(detector, start, recording.t, y, np.broadcast_to(u[:, None], (*y.shape[:2], 1)))[1].scores.max())


@pytest.mark.parametrize("name", LOADS)
def test_no_noise_within_its_bounds_alarms_while_the_load_moves_within_its_range(name: str) -> None:
    plant = marine_engine()
    moving = AdaptiveThreshold(plant, drift={"p_receiver": modules.receiver_drift(C, plant.dt)})
    assert worst_score(moving, LOADS[name]) <= 1.0


def test_the_default_thresholds_are_for_a_steady_load() -> None:
    """None alarms there; a step of 2 % within the envelope causes an alarm, so the search above can fail."""
    usual = AdaptiveThreshold(marine_engine())
    assert 0.999 < worst_score(usual, lambda t: 1.0) <= 1.0
    assert worst_score(usual, LOADS["down to 0.98"]) > 1.0
