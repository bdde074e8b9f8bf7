"""What the truth of a comparison may be beside what detectors were made for: departures, and faults of the plant itself.

A departure is a plant that is not as its model, or an operation that no detector has been fitted on. Kinds and amounts are
ours, no paper states them; `why` says what happens to real plants and why by so much. A plant without entries here is compared
without them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.comparison.recordings import repeated_loads, simulated
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.evaluation.simulate import Recording
from fusion_sfdia.models.gas_pipeline.physics import INLET_PRESSURE, INLET_TEMPERATURE, pipeline_parameters
from fusion_sfdia.models.gas_pipeline.plant import demand, gas_pipeline
from fusion_sfdia.models.marine_engine.faults import ProcessFault
from fusion_sfdia.models.marine_engine.parameters import engine_parameters
from fusion_sfdia.models.marine_engine.plant import marine_engine
from fusion_sfdia.models.power_network.operation import AreaFault
from fusion_sfdia.models.power_network.parameters import NetworkParameters, load_network
from fusion_sfdia.models.power_network.plant import power_network
from fusion_sfdia.models.power_network.published import GOVERNOR
from fusion_sfdia.models.two_tanks.plant import two_tanks

Array = NDArray[Any]

LOAD_LOSS = AreaFault("load-loss", "7", 0.05)
SIGN_FLIP = AreaFault("input-gain", "4", -1.0)
PIPELINE, ENGINE, NETWORK, TANKS = "gas-pipeline", "marine-engine", "power-network", "two-tanks"


class Departure(NamedTuple):
    """Healthy runs of another plant, or in another operation: record(steps, seeds, s from which they are judged)."""

    name: str
    why: str
    record: Callable[..., Recording]


class PlantFault(NamedTuple):
    """A fault of no sensor: record(steps, seeds, onset in s)."""

    name: str
    why: str
    record: Callable[..., Recording]


def _pipe(**changes: float) -> Plant:
    return gas_pipeline(parameters=pipeline_parameters(**changes))


def _engine(**factors: float) -> Plant:
    c = engine_parameters()
    return marine_engine(parameters=c._replace(**{k: f * getattr(c, k) for k, f in factors.items()}))


def _slopes(factor: float) -> NetworkParameters:
    c = load_network()
    return replace(c, slope=c.slope * factor)


def _constants(column: int, factor: float) -> NetworkParameters:
    """A constant of Table I (0: inertia, 1: droop) larger in every second area and smaller in the others."""
    c = load_network()
    constants = c.constants.copy()
    constants[::2, column] *= factor
    constants[1::2, column] /= factor
    return replace(c, constants=constants)


def _network(c: NetworkParameters | None = None, scenario: str = "1", faults: tuple[AreaFault, ...] = ()) -> Plant:
    return power_network(c or load_network(), loads=repeated_loads(scenario), faults=faults)


def _of(plant: str, truth: Callable[[], Plant]) -> Callable[..., Recording]:
    return lambda steps, seeds, onset: simulated(plant, steps, seeds, truth=truth())


def _under(plant: str, inputs: Callable[[float], Array]) -> Callable[..., Recording]:
    return lambda steps, seeds, onset: simulated(plant, steps, seeds, inputs=inputs)


def _swinging_demand(t: float) -> Array:
    return np.array([INLET_PRESSURE, INLET_TEMPERATURE, demand(0.0) + 60.0 * np.sin(2 * np.pi * (t + 10.0) / 900.0)])


def _less_fuel(steps: int, seeds: tuple[int, ...], onset: float) -> Recording:
    return simulated(ENGINE, steps, seeds, inputs=lambda t: np.array([1.0 if t < onset - 0.1 - 1e-9 else 0.95]))


DEPARTURES: dict[str, tuple[Departure, ...]] = {
    PIPELINE: (
        Departure(
            "roughness +25 %",
            "deposits and corrosion; as in pipeline/mismatch",
            _of(PIPELINE, lambda: _pipe(roughness=1.25 * pipeline_parameters().roughness)),
        ),
        Departure(
            "ground +2 K",
            "ground at laying depth follows the seasons by several kelvin",
            _of(PIPELINE, lambda: _pipe(ambient=pipeline_parameters().ambient + 2.0)),
        ),
        Departure(
            "gas constant -1 %",
            "gas of another source, its molar mass 1 % higher",
            _of(PIPELINE, lambda: _pipe(gas_constant=0.99 * pipeline_parameters().gas_constant)),
        ),
        Departure(
            "demand swings",
            "another day: by 60 kg/s about 300 within 900 s, as fast as the usual ramps",
            _under(PIPELINE, _swinging_demand),
        ),
    ),
    ENGINE: (
        Departure(
            "turbine area -5 %",
            "fouled turbine: deposits narrow the nozzle ring",
            _of(ENGINE, lambda: _engine(turbine_area=0.95)),
        ),
        Departure(
            "turbocharger efficiency -3 %",
            "fouled compressor between two washings",
            _of(ENGINE, lambda: _engine(turbocharger_efficiency=0.97)),
        ),
        Departure(
            "heat of the fuel -2 %",
            "another fuel: heating values differ by some 5 %",
            _of(ENGINE, lambda: _engine(heat=0.98)),
        ),
        Departure(
            "fuel 100 to 95 %",
            "a step of the fuel setting 0.1 s before",
            _less_fuel,
        ),
    ),
    NETWORK: (
        Departure(
            "slopes +10 %",
            "another flow over the ties: slopes are those of a sine where it works",
            _of(NETWORK, lambda: _network(_slopes(1.1))),
        ),
        Departure(
            "inertias 10 % off",
            "which units of an area are running is not known exactly",
            _of(NETWORK, lambda: _network(_constants(0, 1.1))),
        ),
        Departure(
            "droops 10 % off",
            "governors as set and as they act differ by dead bands and limits",
            _of(NETWORK, lambda: _network(_constants(1, 1.1))),
        ),
        Departure("other load steps", "those of B18, scenario 2", _of(NETWORK, lambda: _network(scenario="2"))),
    ),
    TANKS: (
        Departure(
            "outlets -5 %", "coefficients of discharge are known to some 5 %", _of(TANKS, lambda: two_tanks(outlet=0.95))
        ),
        Departure("inflow swings", "by 20 % within 1200 s", _of(TANKS, lambda: two_tanks(swing=0.2))),
    ),
}


def _leak(plant: str, *factors: float) -> Callable[..., Recording]:
    return lambda steps, seeds, onset: simulated(plant, steps, seeds, lost=(onset, factors))


def _ailing(kind: str, severity: float) -> Callable[..., Recording]:
    def record(steps: int, seeds: tuple[int, ...], onset: float) -> Recording:
        return simulated(ENGINE, steps, seeds, truth=marine_engine(process_faults=[ProcessFault(kind, severity, onset)]))

    return record


def _area(fault: AreaFault) -> Callable[..., Recording]:
    def record(steps: int, seeds: tuple[int, ...], onset: float) -> Recording:
        return simulated(NETWORK, steps, seeds, truth=_network(faults=(replace(fault, onset=onset),)))

    return record


PLANT_FAULTS: dict[str, tuple[PlantFault, ...]] = {
    PIPELINE: (PlantFault("leak", "5 % of the outflow leaves beside the meter at the outlet", _leak(PIPELINE, 1, 1, 1.05)),),
    ENGINE: (
        PlantFault("turbine-fouling", "a tenth of the area is lost at once", _ailing("turbine-fouling", 0.1)),
        PlantFault("injector-loss", "a tenth of the fuel does not reach the cylinder", _ailing("injector-loss", 0.1)),
        PlantFault("heavy-propeller", "a tenth more load, of a line or of weather", _ailing("heavy-propeller", 0.1)),
    ),
    NETWORK: (
        PlantFault(
            "governor", "the governor of area 4 with a time constant of 1000 s (B18, scenario 1)", _area(GOVERNOR.fault)
        ),
        PlantFault(
            "input-gain",
            "the reference of area 4 arrives with its sign reversed; in B18, scenario 2, that of area 5, which has no load "
            "here",
            _area(SIGN_FLIP),
        ),
        PlantFault("load-loss", "a twentieth of the base power is lost at once in area 7", _area(LOAD_LOSS)),
    ),
    TANKS: (PlantFault("leak", "a tenth of the inflow is lost before the upper tank", _leak(TANKS, 0.9)),),
}


def departed(plant: str, name: str, steps: int, seeds: tuple[int, ...], onset: float) -> Recording:
    """Readings of a departure by name, which are judged from `onset` (s) on."""
    (found,) = (d for d in DEPARTURES[plant] if d.name == name)
    return found.record(steps, seeds, onset)


def failing(plant: str, name: str, steps: int, seeds: tuple[int, ...], onset: float) -> Recording:
    """Readings of a plant that fails at the onset (s)."""
    (found,) = (f for f in PLANT_FAULTS[plant] if f.name == name)
    return found.record(steps, seeds, onset)
