"""What a comparison tries on the plant `gas-pipeline`.

Kinds and amounts of mismatch cases and process faults are ours, no paper states them. The demand of the paper ends after
2700 s; here it comes again, so that faults meet every phase of it. The sensor faults are those of Shaheen 2024 in their sizes:
where it draws sensor, size and sign at random, size and sign are drawn here and sensors take turns; onset and length are those
of all faults of the comparison.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.random_streams import stream
from fusion_sfdia.diagnosis.fault_draws import PRESETS, draw_faults
from fusion_sfdia.diagnosis.faults import Fault
from fusion_sfdia.models.gas_pipeline import published
from fusion_sfdia.models.gas_pipeline.physics import INLET_PRESSURE, INLET_TEMPERATURE, pipeline_parameters
from fusion_sfdia.models.gas_pipeline.plant import demand, gas_pipeline
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.report.results import Published
from fusion_sfdia.study.cases import ComparisonCases, MismatchCase, PaperFault, ProcessFaultCase, in_operation
from fusion_sfdia.study.truths import double_spread, fluctuating, trending

Array = NDArray[Any]

TREND = 4000.0  # s, in which the gas changes: as long as a run of a healthy log
DEMAND_PERIOD = 3600.0  # s: the ramps of the plant's demand, and back to where it began


@cache
def step_length() -> float:
    """Seconds of a step: an input that acts from t on is that of its end."""
    return gas_pipeline().dt


def repeated_demand(t: float) -> Array:
    """The inputs (3,) that act from t on: 300 to 450 kg/s and down to 350 as in `demand`, then to 300 in 600 s, again."""
    within = (t + step_length()) % DEMAND_PERIOD
    back = 25.0 * (1.0 - float(np.cos(np.pi * np.clip((within - 2850.0) / 600.0, 0.0, 1.0))))
    return np.array([INLET_PRESSURE, INLET_TEMPERATURE, demand(within) - back])


def swinging_demand(t: float, start: float) -> Array:
    """The inputs (3,) of another day, with a sine of 60 kg/s."""
    return np.array([INLET_PRESSURE, INLET_TEMPERATURE, demand(0.0) + 60.0 * np.sin(2 * np.pi * (t + 10.0) / 900.0)])


def falling_demand(t: float, start: float) -> Array:
    """The inputs (3,) when a large consumer shuts down: by 90 kg/s within 600 s, half of it before the start."""
    ramp = float(np.clip((t + 10.0 - start + 300.0) / 600.0, 0.0, 1.0))
    return np.array([INLET_PRESSURE, INLET_TEMPERATURE, demand(0.0) - 90.0 * ramp])


def altered(factor: str, by: float, plus: float = 0.0) -> Plant:
    """The pipeline with a parameter of `by` times its value and `plus`, under the repeated demand."""
    value = by * getattr(pipeline_parameters(), factor) + plus
    return in_operation(gas_pipeline(parameters=pipeline_parameters(**{factor: value})), repeated_demand)


def other_pipe(**changes: float) -> Plant:
    """The pipeline with other parameters, under the repeated demand."""
    return in_operation(gas_pipeline(parameters=pipeline_parameters(**changes)), repeated_demand)


def changing_gas(first: float, last: float) -> Plant:
    """The pipeline whose gas constant goes from one factor of its value to another within TREND."""
    return trending(altered("gas_constant", first), altered("gas_constant", last), TREND)


def drawn_fault(preset: str, plant: Plant, sensor: str, seed: int, onset: float, length: float) -> Fault:
    """A fault of the paper of that sensor, its size and sign drawn."""
    (fault,) = draw_faults(preset, plant, stream(seed, "faults"), window=(onset, onset))
    return replace(fault, sensor=sensor, length=length, rise=length / 2 if fault.kind == "drift" else None)


def published_accuracy(detector: str, fault: str, quantity: str) -> Published | None:
    """Share of a quantity's faults that the paper's bank judges right."""
    return published.accuracy("moderate", detector, quantity, fault) if fault in published.FAULTS else None


CASES = ComparisonCases(
    operation=repeated_demand,
    other_operation=swinging_demand,
    mismatch=(
        MismatchCase("roughness +25 %", "deposits and corrosion; as in pipeline/mismatch", partial(altered, "roughness", 1.25)),
        MismatchCase(
            "ground +2 K", "ground at laying depth follows the seasons by several kelvin", partial(altered, "ambient", 1.0, 2.0)
        ),
        MismatchCase(
            "gas constant -1 %", "gas of another source, its molar mass 1 % higher", partial(altered, "gas_constant", 0.99)
        ),
        MismatchCase(
            "demand swings",
            "another day: by 60 kg/s about 300 within 900 s, as fast as the usual ramps",
            inputs=swinging_demand,
        ),
        MismatchCase("diameter -0.5 %", "tolerance of the wall's thickness", partial(altered, "diameter", 0.995), unseen=True),
        MismatchCase(
            "gas becomes heavier",
            "a change of the source: the gas constant falls by 4 % within 4000 s; in the log it rises",
            partial(changing_gas, 1.0, 0.96),
            log=partial(changing_gas, 1.0, 1.02),
            unseen=True,
        ),
        MismatchCase(
            "outflow fluctuates",
            "by 9 kg/s (3 %), correlated over 200 s, beside the metered demand",
            partial(fluctuating, other_pipe, {"m_outlet": 9.0}, 200.0),
            unseen=True,
        ),
        MismatchCase("demand falls", "by 90 kg/s within 600 s", inputs=falling_demand, unseen=True),
        MismatchCase(
            "double spread",
            "roughness, ground, heat transfer and gas two standard deviations off, in turn above and below",
            partial(double_spread, gas_pipeline, other_pipe, ("roughness", "ambient", "heat_transfer", "gas_constant")),
            unseen=True,
        ),
    ),
    process_faults=(
        ProcessFaultCase(
            "leak", "5 % of the outflow leaves beside the meter at the outlet", lost=(1.0, 1.0, 1.05), named=("m_outlet",)
        ),
    ),
    paper_faults=tuple(PaperFault(name, PRESETS[name].description, partial(drawn_fault, name)) for name in published.FAULTS),
    published_accuracy=published_accuracy,
)
