"""Parameters of the marine engine: a file of values with unit and provenance, and what follows from them.

An engine is a TOML file with one line for each value, as in parameters.toml. What the papers do not state
follows from the equilibrium at full load: the cycle's share at constant volume from the peak pressure, the losses from the
rated power, the turbine's area from the receiver's pressure, the turbocharger's efficiency from the charge-air pressure.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fusion_sfdia.models.marine_engine import equations
from fusion_sfdia.models.marine_engine.equations import EngineParameters

ENGINE_FILE = Path(__file__).with_name("parameters.toml")
PROVENANCE = ("paper", "recalled", "derived", "chosen")
UNITS: dict[str, dict[str, float]] = {  # SI unit: units a file may use, as multiples of it
    "1": {},
    "W": {"kW": 1e3, "MW": 1e6},
    "1/s": {"rpm": 1 / 60},
    "kg/J": {"g/kWh": 1e-3 / 3.6e6},
    "m": {"mm": 1e-3},
    "m3": {},
    "rad": {"deg": np.pi / 180},
    "J/kg": {"MJ/kg": 1e6},
    "Pa": {"bar": 1e5, "kPa": 1e3},
    "J/(kg K)": {},
    "K": {},
    "s": {"ms": 1e-3},
}
FREE = {"X_cv_gradient", "loss_gradient"}  # of any sign
NOT_NEGATIVE = {"X_ct_nominal", "efficiency_curvature", "slip_nominal", "inlet_effectiveness"}
ABOVE_ONE = {"geometric_compression", "n_expansion", "n_blowdown", "kappa_air", "kappa_gas"}
AT_MOST_ONE = {"heat_efficiency", "X_ct_nominal", "turbine_efficiency", "compressor_efficiency", "inlet_effectiveness"}


class SourcedValue(NamedTuple):
    """A number in its SI unit and where it comes from."""

    value: float
    unit: str
    provenance: str
    source: str


EXPECTED = {  # name in the file: SI unit
    "power": "W",
    "speed": "1/s",
    "cylinders": "1",
    "revolutions_per_cycle": "1",
    "fuel_consumption": "kg/J",
    "bore": "m",
    "stroke": "m",
    "rod": "m",
    "geometric_compression": "1",
    "volume": "m3",
    "exhaust_opens": "rad",
    "heat_efficiency": "1",
    "heating_value": "J/kg",
    "X_cv_gradient": "1",
    "X_ct_nominal": "1",
    "peak_pressure": "Pa",
    "n_expansion": "1",
    "loss_gradient": "1",
    "R_air": "J/(kg K)",
    "cp_air": "J/(kg K)",
    "kappa_air": "1",
    "R_gas": "J/(kg K)",
    "cp_gas": "J/(kg K)",
    "kappa_gas": "1",
    "n_blowdown": "1",
    "p_charge": "Pa",
    "p_receiver": "Pa",
    "p_ambient": "Pa",
    "p_exhaust": "Pa",
    "T_ambient": "K",
    "T_cooler": "K",
    "T_inlet": "K",
    "inlet_effectiveness": "1",
    "slip_nominal": "1",
    "slip_temperature": "K",
    "turbine_efficiency": "1",
    "compressor_efficiency": "1",
    "efficiency_curvature": "1",
    "receiver_delay": "s",
    "charge_delay": "s",
}


def load_engine(path: str | Path = ENGINE_FILE) -> dict[str, SourcedValue]:
    """Read an engine's file: {name: Value in SI}.

    Raises ValueError naming the file and the parameter where it is no TOML, a parameter is missing or unknown, an entry lacks
    value, unit, provenance or source, the unit is another quantity's, or the number is outside the range of any engine.
    """
    try:
        document = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(
            f'{path} is not a TOML file ({error}); write lines like power = {{ value = 5.4e6, unit = "W", ... }}'
        ) from error
    missing, unknown = [n for n in EXPECTED if n not in document], [n for n in document if n not in EXPECTED]
    if missing or unknown:
        what = f"lacks {', '.join(missing)}" if missing else f"has the unknown parameters {', '.join(unknown)}"
        raise ValueError(f"{path} {what}; an engine has {', '.join(EXPECTED)}")
    return {name: _value(f"{path}: {name}", name, document[name]) for name in EXPECTED}


def _value(where: str, name: str, entry: Any) -> SourcedValue:
    if not isinstance(entry, dict) or set(entry) != set(SourcedValue._fields):
        raise ValueError(f"{where} is {entry!r}; expected a table of value, unit, provenance, source")
    number, unit, provenance, source = (entry[key] for key in SourcedValue._fields)
    if isinstance(number, bool) or not isinstance(number, int | float) or not np.isfinite(number):
        raise ValueError(f"{where} has the value {number!r}; expected a finite number")
    si = EXPECTED[name]
    factors = {si: 1.0} | UNITS[si]
    if unit not in factors:
        raise ValueError(f"{where} is in {unit!r}; expected one of {', '.join(factors)}")
    if provenance not in PROVENANCE:
        raise ValueError(f"{where} has the provenance {provenance!r}; expected one of {', '.join(PROVENANCE)}")
    if not isinstance(source, str) or not source.strip():
        raise ValueError(f"{where} names no source; state where the number comes from")
    require_range(where, name, number * factors[unit])
    return SourcedValue(float(number) * factors[unit], si, provenance, source)


def require_range(where: str, name: str, value: float) -> None:
    """Raise ValueError for a number outside the range of any engine."""
    if name in FREE:
        return
    least, strict = (1.0, True) if name in ABOVE_ONE else (0.0, name not in NOT_NEGATIVE)
    most = 1.0 if name in AT_MOST_ONE else np.inf
    if not (least < value <= most or (value == least and not strict)):
        expected = f"{'above' if strict else 'at least'} {least:g}" + ("" if most == np.inf else f" and at most {most:g}")
        raise ValueError(f"{where} is {value:g}; expected {expected}")


def engine_parameters(values: Mapping[str, SourcedValue] | str | Path = ENGINE_FILE, **changes: float) -> EngineParameters:
    """Return what the equations need, from an engine's values or its file; `changes` replace single values (SI).

    Raises ValueError for an unknown or impossible value, and where full load cannot be in equilibrium.
    """
    loaded = load_engine(values) if isinstance(values, str | Path) else values
    unknown = [name for name in changes if name not in EXPECTED]
    if unknown:
        raise ValueError(f"unknown engine parameters {', '.join(unknown)}; known: {', '.join(EXPECTED)}")
    for name, value in changes.items():
        if not np.isfinite(value):
            raise ValueError(f"engine parameter {name} is {value}; expected a finite number")
        require_range(f"engine parameter {name}", name, value)
    v = {name: changes.get(name, loaded[name].value) for name in EXPECTED}
    if not v["peak_pressure"] > v["p_charge"] > v["p_receiver"] > v["p_exhaust"]:
        raise ValueError(
            f"peak pressure {v['peak_pressure']:g}, charge air {v['p_charge']:g}, receiver {v['p_receiver']:g} and exhaust "
            f"{v['p_exhaust']:g} Pa must fall in this order, or nothing flows; correct them"
        )
    if not v["cp_air"] > v["R_air"]:
        raise ValueError(f"cp_air is {v['cp_air']:g} J/(kg K), not more than R_air = {v['R_air']:g}; c_v would not be positive")
    fuel = v["fuel_consumption"] * v["power"] * v["revolutions_per_cycle"] / (v["cylinders"] * v["speed"])  # (28)
    clearance = np.pi / 4 * v["bore"] ** 2 * v["stroke"] / (v["geometric_compression"] - 1.0)
    crank, swing = v["stroke"] / 2, v["stroke"] / 2 * np.sin(v["exhaust_opens"])
    if not v["rod"] > v["stroke"] / 2:
        raise ValueError(f"the rod of {v['rod']:g} m is shorter than the crank of {crank:g} m; correct rod or stroke")
    travel = crank * (1 - np.cos(v["exhaust_opens"])) + v["rod"] - np.sqrt(v["rod"] ** 2 - swing**2)
    same = {name: v[name] for name in EngineParameters._fields if name in EXPECTED}
    c = EngineParameters(
        **same,
        fuel_delay=1 / (4 * v["speed"]),
        full_injection=fuel,
        fuel_nominal=fuel,
        load=v["power"] / v["speed"] ** 3,
        speed_nominal=v["speed"],
        compression=v["volume"] / clearance,
        expansion_end=(clearance + np.pi / 4 * v["bore"] ** 2 * travel) / v["volume"],
        heat=v["heat_efficiency"] * v["heating_value"],
        X_cv_nominal=0.0,
        loss_nominal=0.0,
        turbine_area=1.0,
        turbocharger_efficiency=1.0,
        p_receiver_nominal=v["p_receiver"],
        p_charge_nominal=v["p_charge"],
        T_charge_nominal=0.0,
    )
    return closed(c, v["peak_pressure"])


def closed(c: EngineParameters, peak_pressure: float) -> EngineParameters:
    """Return c with the five values that put full load in equilibrium.

    T_1 from (49a); X_cv from p_3 = p_1 r^kappa (1 + X_cv q / (c_v T_2)); the losses from (33), the turbine's area from (36),
    the turbocharger's efficiency from (46). Raises ValueError where one of them is outside the range of any engine.
    """
    fuel, p_d, p_1 = c.fuel_nominal, c.p_receiver_nominal, c.p_charge_nominal
    torque = c.load * c.speed_nominal**2 / (2 * np.pi)
    T_1 = equations.charge_temperature(c)
    hot = c.compression ** (c.kappa_air - 1)
    per_X_cv = c.R_air / (c.cp_air - c.R_air) * equations.heat_release(fuel, p_1, c)
    c = c._replace(T_charge_nominal=T_1, X_cv_nominal=(peak_pressure / (p_1 * c.compression) - hot) / per_X_cv)
    p_6, T_6 = equations.cylinder_pressure(fuel, torque, p_1, c), equations.cylinder_temperature(fuel, torque, p_1, T_1, c)
    c = c._replace(loss_nominal=equations.shaft_torque(fuel, T_6, torque, p_1, T_1, c) - torque)
    T_d = equations.receiver_temperature(fuel, p_6, T_6, torque, p_d, p_1, T_1, c)
    unit_area = equations.receiver_inflow(fuel, torque, p_d, T_d, p_1, T_1, c._replace(p_exhaust=0.0)) * c.receiver_delay
    c = c._replace(turbine_area=unit_area / np.sqrt(p_d**2 - c.p_exhaust**2))
    lossless = (equations.charge_inflow(fuel, torque, p_d, T_d, p_1, T_1, c) * c.charge_delay / c.p_ambient) ** (
        1 - 1 / c.kappa_air
    )
    c = c._replace(turbocharger_efficiency=((p_1 / c.p_ambient) ** (1 - 1 / c.kappa_air) - 1) / (lossless - 1))
    for name, value, most, cure in (
        ("share of the heat at constant volume", c.X_cv_nominal, 1 - c.X_ct_nominal, "peak_pressure"),
        ("loss of torque", c.loss_nominal, torque, "power, fuel_consumption or heat_efficiency"),
        ("efficiency of the turbocharger", c.turbocharger_efficiency, 1.0, "p_charge, p_receiver or T_ambient"),
    ):
        if not 0 <= value <= most:
            raise ValueError(f"full load does not close: the {name} would be {value:g}, expected 0 to {most:g}; correct {cure}")
    return EngineParameters(*(float(x) for x in c))
