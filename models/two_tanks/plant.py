"""Two water tanks in series, checkable by hand.

    area d level_1 / dt = inflow - flow_12               flow_12  = outlet_1 sqrt(level_1)
    area d level_2 / dt = flow_12 - flow_out - leak      flow_out = outlet_2 sqrt(level_2)

An outlet obeys Torricelli's law v = sqrt(2 g level), so that outlet = (discharge coefficient) (bore area) sqrt(2 g). Both tanks
are equal: at rest inflow = flow_12 = flow_out and level_1 = level_2 = (inflow / outlet)^2. About that level a tank follows its
inflow with the time constant 2 area sqrt(level) / outlet. All numbers here are chosen, none is from a paper: 0.6 litres a
second at a level of 1 m, time constants of 167 s, noise of 1 %.

The high-fidelity model behind simulated readings differs slightly, as a test rig differs from its data sheet. Its outlets are
short pipes, with a viscous head proportional to the flow in addition to the kinetic head (Hagen 1839, Poiseuille 1840):

level = (1 - VISCOUS) (flow / outlet)^2 + VISCOUS sqrt(LEVEL) flow / outlet.

At LEVEL this is Torricelli's law. The upper outlet is wider by TOLERANCE, the lower one narrower, and the pump delivers
DELIVERY more than its setting. At rest, flows are 0.2 % and levels 0.2 % and 0.6 % higher than by the model: 0.2, 0.2 and 0.6
standard deviations of a reading.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import equation
from fusion_sfdia.plant.discretise import discretise
from fusion_sfdia.plant.modules import Modules
from fusion_sfdia.plant.physics import Physics
from fusion_sfdia.plant.plant import Plant, Structure, Truth, with_same_states
from fusion_sfdia.plant.signals import Sensor, Signal
from fusion_sfdia.plant.uncertainty import Parameter

Array = NDArray[Any]

INFLOW = 6e-4  # m3/s
LEVEL = 1.0  # m, at rest under that inflow
LEVELS = (0.01, 3.0)  # m
SWING_PERIOD = 1200.0  # s, about seven time constants: the levels nearly follow
GAIN = 0.05  # 1/s, of the observers: levels integrate flows, so that errors decay by the gains only
NOISE = 0.01  # sigma of each sensor over its value at rest
BOUND = 4.0  # of each sensor's error, in sigma
STEP = 5.0  # s
VISCOUS = 0.02  # share of the head that friction in the outlets takes at rest
TOLERANCE = 0.001  # deviation of each outlet from its nominal value: a bore is accurate to half a thousandth of its diameter
DELIVERY = 0.002  # of the inflow: the flow meters that set pumps have errors of some tenths of a percent
DISCHARGE = 0.05  # standard deviation of each outlet over its nominal value
FOULING = 2e-4  # its change within an hour
LEAK = 0.05  # of the inflow
SETTING = 0.01  # of the inflow: standard deviation of the error of a pump's setting, our choice
FINER = 4  # substeps of the high-fidelity model in one of the model
STATES, TANKS = ("level_1", "level_2"), ("upper", "lower")
PUMP = "Check the pump and the valves downstream of it, and look for leaks from the pipe or the upper tank."
ALGEBRAIC = ("flow_12", "flow_out")


class Tanks(NamedTuple):
    """Parameters of both tanks."""

    area: float = 0.05  # m2
    outlet_1: float = 6e-4  # m2.5/s, flow per root of level
    outlet_2: float = 6e-4  # m2.5/s
    leak: float = 0.0  # m3/s, out of the lower tank beside its outlet


NOMINAL = Tanks()


@equation
def level_1(inflow: Any, flow_12: Any, c: Tanks) -> Any:
    """Rise of the upper level, m/s."""
    return (inflow - flow_12) / c.area


@equation
def level_2(flow_12: Any, flow_out: Any, c: Tanks) -> Any:
    """Rise of the lower level, m/s."""
    return (flow_12 - flow_out - c.leak) / c.area


@equation
def flow_12(level_1: Any, c: Tanks) -> Any:
    """From the upper into the lower tank, m3/s."""
    return c.outlet_1 * np.sqrt(level_1)


@equation
def flow_out(level_2: Any, c: Tanks) -> Any:
    """Out of the lower tank, m3/s."""
    return c.outlet_2 * np.sqrt(level_2)


EQUATIONS: Mapping[str, Callable[..., Any]] = {
    "level_1": level_1, "level_2": level_2, "flow_12": flow_12, "flow_out": flow_out,
}  # fmt: skip


def _rates(t: float, x: Array, z: Array, u: Array, c: Tanks) -> Array:
    return np.stack([level_1(u[..., 0], z[..., 0], c), level_2(z[..., 0], z[..., 1], c)], axis=-1)


def _flows(t: float, x: Array, z: Array, u: Array, c: Tanks) -> Array:
    return np.stack([flow_12(x[..., 0], c), flow_out(x[..., 1], c)], axis=-1)


def _inflow(swing: float, t: float) -> Array:
    return np.array([INFLOW * (1.0 + swing * np.sin(2 * np.pi * t / SWING_PERIOD))])


def tank_physics() -> Physics:
    """The equations on arrays (..., 2)."""
    return Physics(
        name="two-tanks",
        states=tuple(
            Signal(n, "m", LEVEL, *LEVELS, meaning=f"the level of the {which} tank")
            for n, which in zip(STATES, TANKS, strict=True)
        ),
        inputs=(Signal("inflow", "m3/s", INFLOW, 0.0, 2e-3, meaning="flow into the upper tank", check=PUMP),),
        algebraic=tuple(Signal(n, "m3/s", INFLOW) for n in ALGEBRAIC),
        f=_rates,
        phi=_flows,
        parameters=Tanks(),
    )


def tank_modules(c: Tanks = NOMINAL) -> Modules:
    """A monitoring module for each measured variable."""
    return Modules(
        equations=EQUATIONS,
        rates=np.zeros(len(STATES)),
        nominal=dict.fromkeys(STATES, (INFLOW / c.outlet_1) ** 2) | dict.fromkeys(ALGEBRAIC, INFLOW),
        parameters=c,
        inputs=("inflow",),
        names={"level_1": "M(1,1)", "flow_12": "M(1,2)", "level_2": "M(2,1)", "flow_out": "M(2,2)"},
        gains=dict.fromkeys(STATES, GAIN),
    )


def unknown(c: Tanks) -> tuple[Parameter, ...]:
    """What a test rig's data sheet leaves open; a leak of the upper tank is an error of the inflow, one of the same sign.

    At rest q12, the level l1 and the inflow give outlet_1 and the error of the inflow, q2 and l2 outlet_2 and the leak.
    """
    return (
        *(
            Parameter(
                name, "m2.5/s", getattr(c, name), DISCHARGE * getattr(c, name), FOULING * getattr(c, name),
                source="coefficients of discharge are tabulated to some 5 %; deposits of 0.02 % an hour, our choice",
                meaning=f"opening of the {which} tank's outlet", check="Check the outlet for deposits and damage.",
            )
            for name, which in zip(("outlet_1", "outlet_2"), TANKS, strict=True)
        ),
        Parameter(
            "leak", "m3/s", c.leak, LEAK * INFLOW, treatment="frozen",
            source="a healthy tank has none; a twentieth of the flow is our choice of what matters",
            meaning="leak of the lower tank", check="Check the lower tank and its fittings for leaks.",
        ),
    )  # fmt: skip


def true_outlets(c: Tanks) -> Array:
    """The outlets of the high-fidelity model (2,), m2.5/s."""
    return np.array([c.outlet_1 * (1.0 + TOLERANCE), c.outlet_2 * (1.0 - TOLERANCE)])


def _true_flows(t: float, x: Array, z: Array, u: Array, c: Tanks) -> Array:
    half = VISCOUS * np.sqrt(LEVEL) / (2 * (1 - VISCOUS))  # of the quadratic equation for flow / outlet
    return np.asarray(true_outlets(c) * (np.sqrt(half**2 + x / (1 - VISCOUS)) - half))


def _true_rates(t: float, x: Array, z: Array, u: Array, c: Tanks) -> Array:
    return _rates(t, x, z, (1.0 + DELIVERY) * u, c)


def true_physics(c: Tanks) -> Physics:
    """The high-fidelity model: outlets with friction and a tolerance, and a pump that delivers more than its setting."""
    return replace(tank_physics(), f=_true_rates, phi=_true_flows, parameters=c)


def rest_of_truth(c: Tanks) -> Array:
    """Levels of the high-fidelity model at rest (2,), m."""
    ratio = (1.0 + DELIVERY) * INFLOW / true_outlets(c)
    return np.asarray((1 - VISCOUS) * ratio**2 + VISCOUS * np.sqrt(LEVEL) * ratio)


def two_tanks(*, swing: float = 0.0, outlet: float = 1.0) -> Plant:
    """Return the tanks as a plant with the states level_1, level_2 (m); both levels and both flows are measured.

    Parameters
    ----------
    swing : float, default 0
        Amplitude of the inflow over its nominal value, a sine of SWING_PERIOD; 0 for rest.
    outlet : float, default 1
        Factor of both nominal outlets.

    Returns
    -------
    Plant
        With a reading every 5 s.

    Raises
    ------
    ValueError
        Unless swing is from 0 to 0.5 and outlet from 0.8 to 1.2, where no tank runs dry or overflows.

    Examples
    --------
    >>> from fusion_sfdia.plants import two_tanks
    >>> two_tanks().sensor_names, two_tanks().dt
    (('l1', 'l2', 'q12', 'q2'), 5.0)
    """
    if not 0 <= swing <= 0.5:
        raise ValueError(f"swing is {swing}; expected a share of the nominal inflow from 0 to 0.5")
    if not 0.8 <= outlet <= 1.2:
        raise ValueError(f"outlet is {outlet}; expected a factor of the nominal outlets from 0.8 to 1.2")
    c = NOMINAL._replace(outlet_1=outlet * NOMINAL.outlet_1, outlet_2=outlet * NOMINAL.outlet_2)
    sensors = [
        Sensor(
            name,
            variable,
            unit,
            sigma=NOISE * value,
            bound=BOUND * NOISE * value,
            owner=owner,
            quantity=quantity,
            meaning=meaning,
        )
        for name, variable, unit, value, owner, quantity, meaning in (
            ("l1", "level_1", "m", LEVEL, "upper", "level", "level of the upper tank"),
            ("l2", "level_2", "m", LEVEL, "lower", "level", "level of the lower tank"),
            ("q12", "flow_12", "m3/s", INFLOW, "upper", "flow", "flow between the tanks"),
            ("q2", "flow_out", "m3/s", INFLOW, "lower", "flow", "flow out of the lower tank"),
        )
    ]
    start, change = np.full(2, (NOISE * LEVEL) ** 2), np.full(2, (0.1 * NOISE * LEVEL) ** 2)
    operation = partial(_inflow, swing) if swing else None
    physics, x0 = replace(tank_physics(), parameters=c), np.full(2, (INFLOW / c.outlet_1) ** 2)
    plant = discretise(
        physics, sensors, dt=STEP, x0=x0, initial_cov=start, process_cov=change, unknown=unknown(c),
        input_errors={"inflow": SETTING * INFLOW},
    )  # fmt: skip
    truth = Truth(operation=operation, finer=partial(with_same_states, partial(_truth, plant, c, operation)))
    uncertainty = replace(plant.uncertainty, at_rest=True)
    return replace(plant, truth=truth, structure=Structure(modules=tank_modules(c)), uncertainty=uncertainty)


def _truth(plant: Plant, c: Tanks, operation: Callable[[float], Array] | None) -> Plant:
    return discretise(
        true_physics(c), plant.sensors, dt=STEP, substeps=FINER, x0=rest_of_truth(c),
        initial_cov=plant.initial_cov, process_cov=plant.process_cov, operation=operation,
    )  # fmt: skip
