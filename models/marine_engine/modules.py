"""The monitoring modules of K24, sec. VII: which equation each tests, with which sensors, gains and bounds.

The modules M(I,q) of a subsystem I each test the equation of one variable, as the index sets of Kougiatsos 2022 state; by that
of K24, sec. IV-C, M(2,3) would test two and M(3,3) three. Those of a state are observers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import plain
from fusion_sfdia.models.marine_engine import equations
from fusion_sfdia.models.marine_engine.equations import ALGEBRAIC, STATES, EngineParameters
from fusion_sfdia.models.marine_engine.equilibrium import follows_law
from fusion_sfdia.models.marine_engine.physics import decay_rates, engine_equations
from fusion_sfdia.plant.modules import Modules, ObserverBound


class Module(NamedTuple):
    """A monitoring module of K24, sec. VII: the variable whose equation it tests and its sensors S(I,q)."""

    variable: str
    sensors: tuple[str, ...]


MODULES = {
    "M(1,1)": Module("fuel", ("S(1){1}",)),
    "M(2,1)": Module("p_cylinder", ("S(2){1}",)),
    "M(2,2)": Module("T_cylinder", ("S(2){2}",)),
    "M(2,3)": Module("torque", ("S(2){2}", "S(2){3}")),
    "M(3,1)": Module("p_receiver", ("S(3){1}", "S(3){2}")),
    "M(3,2)": Module("T_receiver", ("S(3){1}", "S(3){2}")),
    "M(3,3)": Module("T_turbine", ("S(3){1}", "S(3){2}", "S(3){3}")),
    "M(4,1)": Module("p_charge", ("S(4){1}", "S(4){2}")),
    "M(4,2)": Module("T_charge", ("S(4){2}",)),
    "M(4,3)": Module("T_compressor", ("S(4){2}", "S(4){3}")),
}
GAINS = {"fuel": 1.16, "p_receiver": 900.0, "p_charge": 499.98}  # 1/s, gains L of the observers: K24, sec. VII
OBSERVER_BOUNDS = {  # K24, sec. VII; rho < 1 of the last two and rho_d < L of the last contradict their definitions
    "fuel": ObserverBound(1.0, 25.0, 2.0, 20.0),
    "p_receiver": ObserverBound(0.05, 600.0, 900.0, 1000.0),
    "p_charge": ObserverBound(0.03, 500.0, 320.0, 450.0),
}
DRIFT = {"p_receiver": 0.0}  # at a steady load, as in the papers; for a changing load see receiver_drift
LOAD_RANGE = 0.03  # width of the range within which the fuel setting may change, see receiver_drift
RECEIVER_PER_FUEL, RECEIVER_PER_CHARGE = 0.87, 1.25  # A_1 and A_4 over 1 - A_3 there; proved in test_engine_drift
CHARGE_IMBALANCE = 0.3  # upper bound of |g_4 - x_4| there
EVERY = np.ones((1, len(STATES) + len(ALGEBRAIC)), bool)
MARGINS = {  # added to thresholds to reproduce the paper's pattern of modules that fire; our choice
    "p_receiver": 0.037,  # 2.95 noise bounds in all
    **dict.fromkeys(("p_cylinder", "T_cylinder", "torque", "T_receiver", "T_turbine", "T_compressor"), 0.03),
}


def engine_modules(c: EngineParameters, slip: str, nominal: Mapping[str, Any]) -> Modules:
    """The ten monitoring modules of K24 with the gains of its sec. VII."""
    table = engine_equations(slip)
    return Modules(
        equations={v: table[v] for v in (*STATES, *ALGEBRAIC)},
        rates=decay_rates(c),
        nominal={v: float(nominal[v]) for v in (*STATES, *ALGEBRAIC)},
        parameters=c,
        inputs=("fuel_setting",),
        names={module.variable: name for name, module in MODULES.items()},
        gains=GAINS,
        observer_bounds=OBSERVER_BOUNDS,
        margins=MARGINS,
        drift=DRIFT,
        monitor=partial(_monitor, c, follows_law(slip)),
    )


def _monitor(c: EngineParameters, law: bool, *arguments: Any, of: NDArray[Any] = EVERY) -> Any:
    *of_each, dt, s = arguments
    of_runs = s._replace(bound=np.atleast_2d(s.bound), gains=np.atleast_2d(s.gains))
    order = np.arange(len(of_each[0])) if len(of) == 1 else np.argsort(of.argmax(axis=1), kind="stable")
    return equations.monitor(*map(plain, of_each), dt, of_runs, c, law, of, order)  # type: ignore[arg-type, call-arg]


def alone(modules: Modules, variables: Sequence[str]) -> Modules:
    """The engine's compiled modules, of which each run evaluates that of its variable: the others know only their envelopes.

    variables: one for all runs, or one for each.
    """
    if modules.monitor is None:
        raise ValueError("the modules have no compiled form; expected those of `engine_modules` to evaluate one of them alone")
    of = np.array([[v == own for v in modules.equations] for own in variables])
    return replace(modules, monitor=partial(modules.monitor, of=of))


def receiver_drift(c: EngineParameters, dt: float) -> float:
    """Largest change of p_receiver within dt (s), over its nominal value, for any fuel setting within LOAD_RANGE.

    This is the drift of an AdaptiveThreshold for such loads: 0.013 in 0.01 s, for which the threshold of M(3,1) is 2.47 instead
    of 2.22 noise bounds. (The load step from 100 to 80 %, which leaves the usual envelope, changes it by 0.04.)

    With D_i(t) = x_i(t + h) - x_i(t), h <= dt, over nominal values, tau_pd x_3' = g - x_3, tau_TC x_4' = g_4 - x_4, and bounds
    A_i of the slopes dg/dx_i over the envelope:

        |D_1| <= (1 - exp(-dt/tau_X)) LOAD_RANGE        |D_4| <= (1 - exp(-dt/tau_TC)) sup |g_4 - x_4|
        tau_pd d|D_3|/dt <= A_1 |D_1| + A_4 |D_4| - (1 - A_3) |D_3|

    so that |D_3| <= (A_1 |D_1| + A_4 |D_4|) / (1 - A_3) after a steady state.
    """
    fuel, charge = -np.expm1(-dt / c.fuel_delay), -np.expm1(-dt / c.charge_delay)
    return float(RECEIVER_PER_FUEL * LOAD_RANGE * fuel + RECEIVER_PER_CHARGE * CHARGE_IMBALANCE * charge)
