"""What a user states about an FMU, with what its description states: signals, sensors, parameters and start values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import number, shown
from fusion_sfdia.common.references import did_you_mean
from fusion_sfdia.plant.fmu.interface import Interface, Variable
from fusion_sfdia.plant.signals import Sensor, Signal
from fusion_sfdia.plant.uncertainty import Parameter

Array = NDArray[Any]
Stated = Mapping[str, Any] | float  # by name, or a share of the nominal value of each
TYPES = {"Real": float, "Float64": float, "Boolean": bool, "String": str}  # all others are integers


def table_of(what: str, given: Mapping[str, Any] | None) -> dict[str, Any]:
    """An argument by names, {} for None; ValueError for anything else."""
    if not isinstance(given, Mapping | None):
        raise ValueError(f"{what} is {shown(given)}; expected values by name, {{name: value}}")
    return dict(given or {})


def start_of(interface: Interface, values: Mapping[str, Any]) -> tuple[tuple[str, int, Any], ...]:
    """The setter of FMPy, value reference and value of each start value; ValueError for one that cannot be set."""
    found = []
    for v in interface.of("start value", values):
        value, kind = values[v.name], TYPES.get(v.kind, int)
        if not v.given or "[" in v.kind:
            raise ValueError(
                f"{interface}: {v.name!r} ({v.causality}, {v.kind}) has no start value that can be set; leave it out"
            )
        if not isinstance(value, str if kind is str else int | float | np.number):
            raise ValueError(f"{interface}: the start value of {v.name!r} is {shown(value)}; expected one of type {v.kind}")
        setter = "Integer" if v.kind == "Enumeration" and interface.version == 2 else v.kind
        found.append((f"set{'Int64' if setter == 'Enumeration' else setter}", v.reference, kind(value)))
    return tuple(found)


def fields_of_sensors(interface: Interface, stated: Stated) -> dict[str, dict[str, Any]]:
    """The fields of each sensor by its name; those of a share have none but "measures" and "share"."""
    if not isinstance(stated, Mapping):
        share = number("sensors", stated)
        outputs = [v.name for v in interface.of("sensor", interface.outputs) if v.continuous]
        return {name: {"measures": name, "share": share} for name in outputs}
    return {name: {"measures": name, **_table("sensor", name, value, "sigma", Sensor)} for name, value in stated.items()}


def sensor_of(interface: Interface, name: str, stated: Mapping[str, Any], v: Variable, value: float) -> Sensor:
    """The sensor that reads a variable, whose value at the start is given."""
    given = dict(stated)
    if (share := given.pop("share", None)) is not None:
        given["sigma"] = share * _scale(interface, "sensors", v, value)
    return Sensor(name, **{"unit": v.unit, "quantity": v.quantity, **given})


def states_of(interface: Interface, variables: list[Variable], x0: Array, **stated: Stated) -> tuple[Signal, ...]:
    """The signals of the states; stated: initial_sigma and process_sigma."""
    sigmas: list[dict[str, Any]] = [{} for _ in variables]
    for what, given in stated.items():
        if isinstance(given, Mapping):
            interface.of("state", given)
            if missing := [v.name for v in variables if v.name not in given]:
                raise ValueError(
                    f"{what} has no value for the states {', '.join(missing)} of {interface}; expected a standard deviation "
                    "for each state in its unit, or one number for all: a share of each nominal value"
                )
        for sigma, v, value in zip(sigmas, variables, x0, strict=True):
            sigma[what] = (
                given[v.name] if isinstance(given, Mapping) else number(what, given) * _scale(interface, what, v, value)
            )
    return tuple(
        Signal(v.name, v.unit, float(value), v.low, v.high, **sigma)
        for v, value, sigma in zip(variables, x0, sigmas, strict=True)
    )


def parameters_of(interface: Interface, stated: Mapping[str, Any], start: Mapping[str, Any]) -> tuple[Parameter, ...]:
    """The parameters that are not known exactly, about their start values."""
    found = []
    for v in interface.of("unknown parameter", stated):
        nominal = start.get(v.name, v.start)
        if v.causality != "parameter" or v.kind not in ("Real", "Float64") or nominal is None:
            raise ValueError(
                f"{interface}: {v.name!r} ({v.causality}, {v.kind}) is no real parameter with a start value; expected one for "
                "unknown, inputs with an error stand in input_errors"
            )
        given = _table("unknown parameter", v.name, stated[v.name], "sd", Parameter)
        found.append(Parameter(v.name, **{"unit": v.unit, "nominal": float(nominal), "low": v.low, "high": v.high, **given}))
    return tuple(found)


def _table(what: str, name: str, value: Any, usual: str, kind: type) -> dict[str, Any]:
    """The fields of a table, or of a number that stands for the usual one; ValueError for an unknown field."""
    if not isinstance(value, Mapping):
        return {usual: number(f"{usual} of {what} {name!r}", value)}
    known = [f.name for f in fields(kind) if f.name != "name"]
    if wrong := [key for key in value if key not in known]:
        raise ValueError(f"{what} {name!r} has {wrong[0]!r}; {did_you_mean(wrong[0], known)}expected of: {', '.join(known)}")
    return dict(value)


def _scale(interface: Interface, what: str, v: Variable, value: float) -> float:
    """The nominal value of a variable, or the size of its value at the start."""
    scale = v.scale or abs(float(value))
    if not (scale > 0 and np.isfinite(scale)):
        raise ValueError(
            f"{interface} states no nominal value of {v.name!r}, which is {value:g} at the start; give {what} by name, "
            f"{{{v.name!r}: a standard deviation in {v.unit}, ...}}"
        )
    return scale
