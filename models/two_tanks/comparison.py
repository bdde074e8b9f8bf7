"""What a comparison tries on the plant `two-tanks`. Kinds and amounts are ours."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.models.two_tanks.plant import (
    FINER,
    INFLOW,
    NOMINAL,
    STEP,
    SWING_PERIOD,
    rest_of_truth,
    true_physics,
    two_tanks,
)
from fusion_sfdia.plant.discretise import discretise
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.study.cases import ComparisonCases, MismatchCase, ProcessFaultCase
from fusion_sfdia.study.truths import double_spread, fluctuating, trending

Array = NDArray[Any]

TREND = 2000.0  # s, in which outlets change: as long as a run of a healthy log


def swinging_inflow(t: float, start: float = 0.0) -> Array:
    """The inflow (1,) that swings by a fifth."""
    return np.array([INFLOW * (1.0 + 0.2 * np.sin(2 * np.pi * t / SWING_PERIOD))])


def less_inflow(t: float, start: float) -> Array:
    """The inflow (1,), a third less from 100 s before the start on."""
    return np.array([INFLOW * (1.0 if t < start - 100.0 else 2 / 3)])


def other_tanks(operation: Callable[[float], Array] | None = None, **changes: float) -> Plant:
    """The high-fidelity model of tanks with other parameters."""
    plant, c = two_tanks(), NOMINAL._replace(**changes)
    return discretise(
        true_physics(c), plant.sensors, dt=STEP, substeps=FINER, x0=rest_of_truth(c), initial_cov=plant.initial_cov,
        process_cov=plant.process_cov, operation=operation,
    )  # fmt: skip


def changing_outlets(first: float, last: float) -> Plant:
    """Tanks whose outlets go from one factor to another within TREND."""
    return trending(two_tanks(outlet=first), two_tanks(outlet=last), TREND)


CASES = ComparisonCases(
    other_operation=swinging_inflow,
    mismatch=(
        MismatchCase("outlets -5 %", "coefficients of discharge are known to some 5 %", partial(two_tanks, outlet=0.95)),
        MismatchCase("inflow swings", "by 20 % within 1200 s", inputs=swinging_inflow),
        MismatchCase(
            "tanks 25 % narrower",
            "built-in parts take room; the inflow swings, at rest it would not matter",
            partial(other_tanks, swinging_inflow, area=0.75 * NOMINAL.area),
            unseen=True,
        ),
        MismatchCase(
            "outlets widen",
            "by 6 % within 2000 s, a fast corrosion; in the log they foul",
            partial(changing_outlets, 1.0, 1.06),
            log=partial(changing_outlets, 1.0, 0.96),
            unseen=True,
        ),
        MismatchCase(
            "inflow fluctuates",
            "by 3 %, correlated over 100 s: a pump on a supply of changing pressure",
            partial(fluctuating, two_tanks, {"inflow": 0.03 * INFLOW}, 100.0),
            unseen=True,
        ),
        MismatchCase("inflow drops", "by a third, 20 samples before", inputs=less_inflow, unseen=True),
        MismatchCase(
            "double spread",
            "both outlets two standard deviations off, to opposite sides",
            partial(double_spread, two_tanks, other_tanks, ("outlet_1", "outlet_2")),
            unseen=True,
        ),
    ),
    process_faults=(
        ProcessFaultCase(
            "leak",
            "a tenth of the inflow is lost before the upper tank",
            lost=(0.9,),
            named=("inflow",),
        ),
    ),
)
