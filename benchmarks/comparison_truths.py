"""What the truth of a comparison may be beside what detectors were made for: departures, and faults of the plant itself.

A departure is a plant that is not as its model, or an operation that no detector has been fitted on.

Kinds and amounts are ours, no paper states them; `why` says what happens to real plants and why by so much. A plant without
entries here is compared without them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.discretise import discretise
from fusion_sfdia.models.gas_pipeline import demand, gas_pipeline
from fusion_sfdia.models.gas_pipeline_physics import INLET_PRESSURE, INLET_TEMPERATURE, pipeline_parameters
from fusion_sfdia.models.marine_engine import marine_engine
from fusion_sfdia.models.marine_engine_faults import ProcessFault
from fusion_sfdia.models.marine_engine_parameters import engine_parameters
from fusion_sfdia.models.power_network import power_network
from fusion_sfdia.models.power_network_model import network_model
from fusion_sfdia.models.power_network_operation import AreaFault, load_profile
from fusion_sfdia.models.power_network_parameters import load_network, load_steps
from fusion_sfdia.models.two_tanks import Tanks, tank_physics, two_tanks
from fusion_sfdia.plant import Plant

Array = NDArray[Any]

# Whether the truth is disturbed by the plant's process noise: where its paper says so. The pipeline's belongs to 21 nodes: on
# the finer grid of the truth it is another, and no model error is asked for there.
DISTURBED = ("power-network",)


class Departure(NamedTuple):
    """Healthy runs that differ from the start: plant() is the truth on the detector's own grid, inputs(t) what is known to act.

    None: the plant of the detector, its usual operation.
    """

    name: str
    why: str
    plant: Callable[[], Plant] | None = None
    inputs: Callable[[float], Array] | None = None


class PlantFault(NamedTuple):
    """A fault of no sensor, from `onset` (s) on: plant(onset) is the truth, or inputs are multiplied by `inputs`."""

    name: str
    why: str
    plant: Callable[[float], Plant] | None = None
    inputs: tuple[float, ...] | None = None


def _pipe(**factors: float) -> Callable[[], Plant]:
    believed = pipeline_parameters()._asdict()
    return lambda: gas_pipeline(parameters=pipeline_parameters(**{k: f * believed[k] for k, f in factors.items()}))


def _warmer() -> Plant:
    return gas_pipeline(parameters=pipeline_parameters(ambient=pipeline_parameters().ambient + 2.0))


def _engine(**factors: float) -> Callable[[], Plant]:
    def plant() -> Plant:
        c = engine_parameters()
        changed = marine_engine(parameters=c._replace(**{k: f * getattr(c, k) for k, f in factors.items()}))
        return replace(changed, sensors=marine_engine().sensors)  # whose noise is a share of the usual values

    return plant


def _network(column: int, factor: float) -> Callable[[], Plant]:
    """Constants of a column of Table I (0: inertias) of every second area larger, of the others smaller, or all slopes."""

    def plant() -> Plant:
        c = load_network()
        if column < 0:
            return power_network(replace(c, slope=c.slope * factor))
        constants = c.constants.copy()
        constants[::2, column] *= factor
        constants[1::2, column] /= factor
        return power_network(replace(c, constants=constants))

    return plant


def _tanks(outlet: float) -> Callable[[], Plant]:
    def plant() -> Plant:
        usual = two_tanks()
        physics = replace(tank_physics(), parameters=Tanks(outlet=outlet * Tanks().outlet))
        return discretise(
            physics, usual.sensors, dt=usual.dt, x0=usual.x0, initial_cov=usual.initial_cov, process_cov=usual.process_cov
        )

    return plant


def _swinging_demand(t: float) -> Array:
    return np.array([INLET_PRESSURE, INLET_TEMPERATURE, demand(0.0) + 60.0 * np.sin(2 * np.pi * (t + 10.0) / 900.0)])


def _less_fuel(t: float) -> Array:
    return np.array([1.0 if t < 0.5 - 1e-9 else 0.95])


def _other_loads(t: float) -> Array:
    return np.tile(load_profile(network_model(load_network()), load_steps("2"))(t), 2)


DEPARTURES: dict[str, tuple[Departure, ...]] = {
    "gas-pipeline": (
        Departure("roughness +25 %", "deposits and corrosion; as in pipeline/mismatch", _pipe(roughness=1.25)),
        Departure("ground +2 K", "ground at laying depth follows the seasons by several kelvin", _warmer),
        Departure("gas constant -1 %", "gas of another source, its molar mass 1 % higher", _pipe(gas_constant=0.99)),
        Departure(
            "demand swings",
            "another day: by 60 kg/s about 300 within 900 s, as fast as the usual ramps",
            inputs=_swinging_demand,
        ),
    ),
    "marine-engine": (
        Departure("turbine area -5 %", "fouled turbine: deposits narrow the nozzle ring", _engine(turbine_area=0.95)),
        Departure(
            "turbocharger efficiency -3 %",
            "fouled compressor between two washings",
            _engine(turbocharger_efficiency=0.97),
        ),
        Departure("heat of the fuel -2 %", "another fuel: heating values differ by some 5 %", _engine(heat=0.98)),
        Departure("fuel 100 to 95 %", "a step of the fuel setting 0.1 s before readings are judged", inputs=_less_fuel),
    ),
    "power-network": (
        Departure("slopes +10 %", "another flow over the ties: slopes are those of a sine where it works", _network(-1, 1.1)),
        Departure("inertias 10 % off", "which units of an area are running is not known exactly", _network(0, 1.1)),
        Departure("droops 10 % off", "governors as set and as they act differ by dead bands and limits", _network(1, 1.1)),
        Departure("other load steps", "those of B18, scenario 2", inputs=_other_loads),
    ),
    "two-tanks": (
        Departure("outlets -5 %", "coefficients of discharge are known to some 5 %", _tanks(0.95)),
        Departure("inflow swings", "by 20 % within 1200 s", inputs=two_tanks(swing=0.2).operation),
    ),
}  # fmt: skip


def _ailing(kind: str, severity: float) -> Callable[[float], Plant]:
    return lambda onset: marine_engine(process_faults=[ProcessFault(kind, severity, onset)])


def _area(kind: str, value: float) -> Callable[[float], Plant]:
    return lambda onset: power_network(faults=[AreaFault(kind, "7", value, onset)])


PLANT_FAULTS: dict[str, tuple[PlantFault, ...]] = {
    "gas-pipeline": (PlantFault("leak", "5 % of the outflow leaves beside the meter at the outlet", inputs=(1.0, 1.0, 1.05)),),
    "marine-engine": (
        PlantFault("turbine-fouling", "a tenth of the area is lost at once", _ailing("turbine-fouling", 0.1)),
        PlantFault("injector-loss", "a tenth of the fuel does not reach the cylinder", _ailing("injector-loss", 0.1)),
        PlantFault("heavy-propeller", "a tenth more load, of a line or of weather", _ailing("heavy-propeller", 0.1)),
    ),
    "power-network": (
        PlantFault("governor", "a governor that follows 10 times as slowly", _area("governor", 1.0)),
        PlantFault("input-gain", "the reference arrives with its sign reversed (B18, scenario 2)", _area("input-gain", -1.0)),
        PlantFault("load-loss", "a twentieth of the base power is lost at once", _area("load-loss", 0.05)),
    ),
    "two-tanks": (PlantFault("leak", "a tenth of the inflow is lost before the upper tank", inputs=(0.9,)),),
}


def faulty_inputs(u: Array, t: Array, dt: float, fault: PlantFault, onset: float) -> Array:
    """The inputs (K, m) that act on the plant where the detector is told u (K, m), each until t (K,)."""
    factors = np.ones(u.shape[-1]) if fault.inputs is None else np.asarray(fault.inputs)
    return np.where((t - dt >= onset - 1e-6 * dt)[:, None], u * factors, u)
