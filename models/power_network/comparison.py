"""What a comparison tries on the plant `power-network`.

Kinds and amounts of mismatch cases are ours, no paper states them. The process faults are those of B18's scenarios, and a loss
of load; B18 has no sensor fault. Its load steps end after 80 s; here they come again, so that faults meet every phase of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.models.power_network.model import network_model
from fusion_sfdia.models.power_network.operation import AreaFault, load_profile
from fusion_sfdia.models.power_network.parameters import NetworkParameters, load_network, load_steps
from fusion_sfdia.models.power_network.plant import power_network
from fusion_sfdia.models.power_network.published import GOVERNOR
from fusion_sfdia.models.power_network.unknown import altered
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.study.cases import ComparisonCases, MismatchCase, ProcessFaultCase, PublishedDelay, in_operation
from fusion_sfdia.study.truths import double_spread, fluctuating, trending

Array = NDArray[Any]

TREND = 400.0  # s, in which slopes change: as long as a run of a healthy log
LOAD_PERIOD, LOAD_REPEATS = 100.0, 20  # s: the load steps come again with the opposite sign, and so on
LOAD_LOSS = AreaFault("load-loss", "7", 0.05)
SIGN_FLIP = AreaFault("input-gain", "4", -1.0)


@cache
def repeated_loads(scenario: str) -> Callable[[float], Array]:
    """The loads (N,) of a scenario of B18 over and over, every other time with the opposite sign, so that they stay small."""
    steps = load_steps(scenario)
    repeated = [
        step._replace(time=step.time + k * LOAD_PERIOD, change=(-1) ** k * step.change)
        for k in range(LOAD_REPEATS)
        for step in steps
    ]
    return load_profile(network_model(load_network()), repeated)


def repeated_operation(t: float) -> Array:
    """The inputs (2 N,) under the repeated loads of scenario 1."""
    return np.tile(repeated_loads("1")(t), 2)


def other_operation(t: float, start: float) -> Array:
    """The inputs (2 N,) under the repeated loads of scenario 2."""
    return np.tile(repeated_loads("2")(t), 2)


def larger_loads(t: float, start: float) -> Array:
    """The inputs (2 N,) with a step of 0.3 in area 5 and of -0.25 in area 12, 10 s before the start."""
    loads = np.zeros(len(load_network().topology.names))
    if t > start - 10.0:
        loads[[4, 11]] = 0.3, -0.25
    return np.tile(loads, 2)


def network(c: NetworkParameters) -> Plant:
    """A network under the repeated loads."""
    return in_operation(power_network(c), repeated_operation)


def other_slopes(factor: float) -> Plant:
    """The network with all slopes of ties times a factor."""
    c = load_network()
    return network(replace(c, slope=c.slope * factor))


def other_constants(column: int, factor: float) -> Plant:
    """A constant of Table I (0: inertia, 1: droop) larger in every second area and smaller in the others."""
    c = load_network()
    constants = c.constants.copy()
    constants[::2, column] *= factor
    constants[1::2, column] /= factor
    return network(replace(c, constants=constants))


def changing_slopes(first: float, last: float) -> Plant:
    """The network whose slopes of ties go from one factor to another within TREND."""
    return trending(other_slopes(first), other_slopes(last), TREND)


def other_network(**values: float) -> Plant:
    """The network with other values of uncertain parameters."""
    return network(altered(load_network(), **values))


def usual_network() -> Plant:
    """The network under the repeated loads."""
    return network(load_network())


def failing(fault: AreaFault, onset: float) -> Plant:
    """The network with a fault of an area from the onset (s) on."""
    return in_operation(power_network(faults=(replace(fault, onset=onset),)), repeated_operation)


def published_delay(detector: str, fault: str) -> PublishedDelay | None:
    """Delay of the detection of the governor's fault, by the paper's detector in the one run that it describes."""
    if fault == "governor" and detector.startswith("chebyshev:") and (delay := GOVERNOR.delay(GOVERNOR.detected)) is not None:
        return PublishedDelay("confirmed", "all", "third alarm in a row", delay)
    return None


CASES = ComparisonCases(
    operation=repeated_operation,
    other_operation=other_operation,
    mismatch=(
        MismatchCase(
            "slopes +10 %",
            "another flow over the ties: slopes are those of a sine at its operating point",
            partial(other_slopes, 1.1),
        ),
        MismatchCase(
            "inertias 10 % off", "which units of an area are running is not known exactly", partial(other_constants, 0, 1.1)
        ),
        MismatchCase(
            "droops 10 % off",
            "governors as set and as they act differ by dead bands and limits",
            partial(other_constants, 1, 1.1),
        ),
        MismatchCase("other load steps", "those of B18, scenario 2", inputs=other_operation),
        MismatchCase("turbine times 40 % off", "turbines of other units", partial(other_constants, 3, 1.4), unseen=True),
        MismatchCase(
            "slopes rise",
            "flows over the ties fall: from 30 % below to 30 % above; in the log slopes fall",
            partial(changing_slopes, 0.7, 1.3),
            log=partial(changing_slopes, 1.0, 0.7),
            unseen=True,
        ),
        MismatchCase(
            "loads fluctuate",
            "by 0.06 in areas 2, 7 and 12, correlated over 20 s: wind",
            partial(fluctuating, usual_network, {f"load_{i}": 0.06 for i in (2, 7, 12)}, 20.0),
            unseen=True,
        ),
        MismatchCase("larger load steps", "0.3 in area 5 and -0.25 in area 12", inputs=larger_loads, unseen=True),
        MismatchCase(
            "double spread",
            "slopes, inertias and droops two standard deviations off, in turn above and below",
            partial(double_spread, power_network, other_network),
            unseen=True,
        ),
    ),
    process_faults=(
        ProcessFaultCase(
            "governor",
            "the governor of area 4 with a time constant of 1000 s (B18, scenario 1)",
            partial(failing, GOVERNOR.fault),
            named=("p_v_4", "reference_4", "droop_4"),
        ),
        ProcessFaultCase(
            "input-gain",
            "the reference of area 4 arrives with its sign reversed; B18, scenario 2, has area 5, which has no load here",
            partial(failing, SIGN_FLIP),
            named=("p_v_4", "reference_4", "droop_4"),
        ),
        ProcessFaultCase(
            "load-loss",
            "a twentieth of the base power is lost at once in area 7",
            partial(failing, LOAD_LOSS),
            named=("load_7", "omega_7"),
        ),
    ),
    published_delay=published_delay,
)
