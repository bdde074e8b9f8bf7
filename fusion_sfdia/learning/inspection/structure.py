"""Structural analysis of any plant: which sensor faults can be told apart by the pattern of its equations alone.

The pattern is that of A = dF/dt and H at x0: the rate of a state depends on the states of its row, a reading on those of its
own. A fault that is not in the overdetermined part is not detectable, and one that cannot be separated from another by leaving
equations out is not isolable from it, whatever the numbers (Krysander and Frisk 2008, Sensor placement for fault diagnosis).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.learning.inspection.plant_findings import REMARK, PlantFinding
from fusion_sfdia.learning.inspection.stepping import SHORT
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

ABSENT = 1e-6  # relative to the largest of a row: no dependence, above the error of A
MOST = 40  # states and sensors, above which the analysis takes minutes


class Structural(NamedTuple):
    """undetectable: sensors whose fault no equation can contradict. groups: sensors whose faults are not told apart.

    left_out: why it was not analysed, or "".
    """

    undetectable: tuple[str, ...] = ()
    groups: tuple[tuple[str, ...], ...] = ()
    left_out: str = ""


def structural(plant: Plant) -> Structural:
    """The structural detectability and isolability of the plant's sensor faults, by the Fault Diagnosis Toolbox."""
    if len(plant.states) + len(plant.sensors) > MOST:
        return Structural(left_out=f"more than {MOST} states and sensors")
    if plant.numerics.fixed_dt:
        return Structural(left_out="the plant has a fixed dt, and so no rates")
    try:
        import faultdiagnosistoolbox as toolbox  # slow to import
    except ModuleNotFoundError:
        return Structural(left_out="faultdiagnosistoolbox is not installed: pip install 'fusion-sfdia[structural]'")
    x = [s.name for s in plant.states]
    readings, faults = ([f"{what} {name}" for name in plant.sensor_names] for what in ("reading", "fault"))
    rates, reads = _patterns(plant)
    relations: list[Any] = [[f"rate of {v}", *(x[j] for j in np.flatnonzero(row))] for v, row in zip(x, rates, strict=True)]
    relations += [[*(x[j] for j in np.flatnonzero(row)), r, f] for row, r, f in zip(reads, readings, faults, strict=True)]
    relations += [toolbox.DiffConstraint(f"rate of {v}", v) for v in x]
    model = toolbox.DiagnosisModel(
        {"type": "VarStruc", "x": [*x, *(f"rate of {v}" for v in x)], "f": faults, "z": readings, "rels": relations},
        name=plant.name,
    )
    detectable, _ = model.DetectabilityAnalysis()
    alike = np.asarray(model.IsolabilityAnalysis(), bool)  # of fault i from fault j: not isolable
    lost = tuple(n for n, f in zip(plant.sensor_names, faults, strict=True) if f not in detectable)
    groups = {tuple(n for n, same in zip(plant.sensor_names, row, strict=True) if same and n not in lost) for row in alike}
    return Structural(lost, tuple(sorted(g for g in groups if len(g) > 1)))


def _patterns(plant: Plant) -> tuple[Array, Array]:
    """Which states the rate of each state (n, n) and each reading (N, n) depend on."""
    x, u, scale, short = plant.x0, plant.input_at(0.0), plant.state_scale, SHORT * plant.dt
    x = x + 0.1 * scale * np.random.default_rng(2).standard_normal(x.size)  # off a point where a derivative vanishes
    x = plant.guard(x)[0]
    A = (plant.step_jacobian_at(0.0, x, u, short) - np.eye(x.size)) * scale / scale[:, None]
    H = plant.output_jacobian_at(0.0, x, u) * scale
    return tuple(np.abs(m) > ABSENT * np.max(np.abs(m), axis=-1, keepdims=True) for m in (A, H))


def of_structure(found: Structural) -> Iterator[PlantFinding]:
    """What to know about the pattern of the equations."""
    for name in found.undetectable:
        yield PlantFinding(
            REMARK, name, "no other equation contradicts its readings: its fault cannot be detected; add a sensor"
        )
    for group in found.groups:
        yield PlantFinding(
            REMARK,
            ", ".join(group),
            "by the pattern of the equations a fault of one cannot be told from another; only sizes and timing decide",
        )
