"""What a comparison tries on the plant `marine-engine`.

Kinds and amounts of mismatch cases and process faults are ours, no paper states them. The sensor faults are the offsets of K24
and K22, of one sensor each; onset and length are those of all faults of the comparison.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.diagnosis.faults import Fault
from fusion_sfdia.models.marine_engine.faults import EngineFault
from fusion_sfdia.models.marine_engine.parameters import engine_parameters
from fusion_sfdia.models.marine_engine.plant import marine_engine
from fusion_sfdia.models.marine_engine.published import THREE_FAULTS, PublishedOffset
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.report.results import Published
from fusion_sfdia.study.cases import ComparisonCases, MismatchCase, PaperFault, ProcessFaultCase, PublishedDelay
from fusion_sfdia.study.truths import double_spread, fluctuating, trending

Array = NDArray[Any]

TREND = 5.0  # s, in which the turbine changes: as long as a run
# name, module, unit of the offset, where it is found; in the order of THREE_FAULTS
OFFSETS = (
    ("torque-offset", "M(2,3)", "N m", "K24, Fig. 4"),
    ("receiver-pressure-offset", "M(3,1)", "Pa", "K24, Fig. 4; K22, Fig. 3"),
    ("charge-temperature-offset", "M(4,2)", "K", "K24, Fig. 4; K22, Fig. 3"),
)


def altered(parameter: str, factor: float) -> Plant:
    """The engine with another parameter."""
    c = engine_parameters()
    return marine_engine(parameters=c._replace(**{parameter: factor * getattr(c, parameter)}))


def less_fuel(t: float, start: float) -> Array:
    """The fuel setting (1,), a step down 0.1 s before the start."""
    return np.array([1.0 if t < start - 0.1 - 1e-9 else 0.95])


def part_load(t: float, start: float) -> Array:
    """The fuel setting (1,), down to 85 % within a second that ends 0.5 s after the start."""
    return np.array([1.0 - 0.15 * float(np.clip(t - start + 0.5, 0.0, 1.0))])


def partly_loaded(t: float, start: float) -> Array:
    """The fuel setting (1,) about 90 %, with a sine of 4 % within 3 s, after a second from full load."""
    return np.array([1.0 - (0.1 + 0.04 * np.sin(2 * np.pi * t / 3.0)) * float(np.clip(t, 0.0, 1.0))])


def other_engine(**changes: float) -> Plant:
    """The engine with other parameters of its equations."""
    return marine_engine(parameters=engine_parameters()._replace(**changes))


def changing_turbine(first: float, last: float) -> Plant:
    """The engine whose turbine area goes from one factor of its value to another within TREND."""
    return trending(altered("turbine_area", first), altered("turbine_area", last), TREND)


def failing(kind: str, severity: float, onset: float) -> Plant:
    """The engine with a process fault from the onset (s) on."""
    return marine_engine(process_faults=[EngineFault(kind, severity, onset)])


def offset_fault(offset: PublishedOffset, plant: Plant, sensor: str, seed: int, onset: float, length: float) -> Fault:
    """An offset of the papers."""
    return Fault(sensor, "bias", onset, length, offset.magnitude)


def published_delay(detector: str, fault: str) -> PublishedDelay | None:
    """Delay of the faulty sensor's module, by the papers' detector in the one run that K24 describes."""
    for (name, module, _, _), offset in zip(OFFSETS, THREE_FAULTS.faults, strict=True):
        if name == fault and detector.startswith("adaptive-threshold") and (fired := THREE_FAULTS.first_alarm(module)):
            return PublishedDelay("own", module, "first alarm", Published(fired.value - offset.onset, fired.source))
    return None


CASES = ComparisonCases(
    other_operation=partly_loaded,
    mismatch=(
        MismatchCase(
            "turbine area -5 %", "fouled turbine: deposits narrow the nozzle ring", partial(altered, "turbine_area", 0.95)
        ),
        MismatchCase(
            "turbocharger efficiency -3 %",
            "fouled compressor between two washings",
            partial(altered, "turbocharger_efficiency", 0.97),
        ),
        MismatchCase(
            "heat of the fuel -2 %", "another fuel: heating values differ by some 5 %", partial(altered, "heat", 0.98)
        ),
        MismatchCase("fuel 100 to 95 %", "a step of the fuel setting 0.1 s before", inputs=less_fuel),
        MismatchCase(
            "exhaust back pressure +4 kPa",
            "a fouled boiler behind the turbine",
            partial(other_engine, p_exhaust=engine_parameters().p_exhaust + 4e3),
            unseen=True,
        ),
        MismatchCase(
            "turbine clears itself",
            "from 3 % less area to 5 % more within 5 s, since runs are short; in the log it fouls",
            partial(changing_turbine, 0.97, 1.05),
            log=partial(changing_turbine, 1.0, 0.95),
            unseen=True,
        ),
        MismatchCase(
            "fuel fluctuates",
            "by 3 %, correlated over 0.3 s: a governor that hunts",
            partial(fluctuating, marine_engine, {"fuel_setting": 0.03}, 0.3),
            unseen=True,
        ),
        MismatchCase("fuel 100 to 85 %", "a ramp of a second about the onset", inputs=part_load, unseen=True),
        MismatchCase(
            "double spread",
            "load, heat, turbine, turbocharger and cooler two standard deviations off, in turn above and below",
            partial(
                double_spread,
                marine_engine,
                other_engine,
                ("load", "heat", "turbine_area", "turbocharger_efficiency", "T_cooler"),
            ),
            unseen=True,
        ),
    ),
    process_faults=(
        ProcessFaultCase(
            "turbine-fouling",
            "a tenth of the area is lost at once",
            partial(failing, "turbine-fouling", 0.1),
            named=("turbine_area",),
        ),
        ProcessFaultCase(
            "injector-loss",
            "a tenth of the fuel does not reach the cylinder",
            partial(failing, "injector-loss", 0.1),
            named=("fuel_setting", "fuel"),
        ),
        ProcessFaultCase(
            "heavy-propeller",
            "a tenth more load, of a line or of weather",
            partial(failing, "heavy-propeller", 0.1),
            named=("load",),
        ),
    ),
    paper_faults=tuple(
        PaperFault(name, f"an offset of {offset.magnitude:g} {unit} ({sources})", partial(offset_fault, offset), offset.sensor)
        for (name, _, unit, sources), offset in zip(OFFSETS, THREE_FAULTS.faults, strict=True)
    ),
    published_delay=published_delay,
    settle=400,  # the filter forgets with 145 samples (charge-air pressure); twice the rate still in samples 200-300
)
