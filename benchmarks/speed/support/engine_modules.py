"""Cost of the bounds in a step of the engine's modules: all ten over a batch of runs, and set inversion by codac.

Set inversion as in Kougiatsos 2024 (11): the z with 0 in z - phi(z, box), a call for each algebraic variable and step.
A call builds codac's function too, with the step's readings in it as constants.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np

from fusion_sfdia.benchmarks.engine.support.campaign import noise, steady_detector, truth
from fusion_sfdia.benchmarks.engine.support.trials import NAMES
from fusion_sfdia.derivatives.equation import argument_names
from fusion_sfdia.derivatives.intervals.codac_adapter import codac_sivia
from fusion_sfdia.derivatives.intervals.expression import Expression, record
from fusion_sfdia.derivatives.intervals.interval import Interval
from fusion_sfdia.derivatives.intervals.sivia import Paving
from fusion_sfdia.detectors.adaptive_thresholds.adaptive_threshold import AdaptiveThreshold
from fusion_sfdia.plant.modules import Modules

Call = Callable[[], object]

RUNS = 100  # seeds in a batch, as many as the paper has at a noise level
SETTLED = 50  # steps before the one that is timed
WIDEST = 5.0  # the initial box is the nominal value divided and multiplied by this, as in algebraic_bounds


@cache
def detector() -> AdaptiveThreshold:
    """The engine's modules with valid thresholds at 5 % noise."""
    return steady_detector("adaptive-threshold")


def step_call(runs: int = RUNS) -> Call:
    """A call that repeats one step of all modules over a batch of healthy runs, from the same settled state."""
    one, run = detector(), truth(1.0)
    draws = noise(one.plant, SETTLED + 1, range(runs))
    state = one.init((runs,), float(run.t[0]) - one.plant.dt)
    for k in range(SETTLED):
        state, _ = one.step(state, float(run.t[k]), run.signal[k] + next(draws), run.u[k])
    y = run.signal[SETTLED] + next(draws)
    return lambda: one.step(state, float(run.t[SETTLED]), y, run.u[SETTLED])


def codac_calls(tolerance: float) -> dict[str, Callable[[], Paving]]:
    """By module: bounds of its algebraic variable, from readings at full load without noise, to so many noise bounds."""
    one, run = detector(), truth(1.0)
    modules, sensors = one.plant.structure.modules, one.plant.sensors
    assert modules is not None
    over = {s.measures: Interval(y - s.noise_bound, y + s.noise_bound) for s, y in zip(sensors, run.signal[0], strict=True)}
    over |= {name: Interval(float(v)) for name, v in zip(modules.inputs, run.u[0], strict=True)}
    calls: dict[str, Callable[[], Paving]] = {}
    for name, sensor in zip(NAMES, sensors, strict=True):
        z = sensor.measures
        if z in modules.states:
            continue
        others = [a for a in argument_names(modules.equations[z]) if a not in (z, "c")]
        ends = np.array([modules.nominal[z] / WIDEST]), np.array([modules.nominal[z] * WIDEST])
        calls[name] = partial(
            codac_sivia,
            residual(modules, z, others),
            Interval(0.0),
            Interval(*ends),
            tolerance * sensor.noise_bound,
            parameters=[over[a] for a in others],
        )
    return calls


def residual(modules: Modules, z: str, others: list[str]) -> Expression:
    """Z - phi of z and the other arguments of its equation."""
    function = modules.equations[z]
    names = [a for a in argument_names(function) if a != "c"]

    def difference(value: Any, *given: Any) -> Any:
        known = dict(zip(others, given, strict=True)) | {z: value}
        return value - function(*(known[a] for a in names), modules.parameters)

    return record(difference, 1 + len(others))
