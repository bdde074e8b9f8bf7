"""Readings of a model that jump where a state passes a full turn: a modulo, of which the plant does not state the period."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.learning.inspection.plant_findings import REMARK, PlantFinding
from fusion_sfdia.plant.cyclic import Cyclic
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.regularity import TURNS
from fusion_sfdia.plant.signals import Sensor, Signal

Array = NDArray[Any]

MODULO = ("remainder", "fmod", "floor", "floor_divide", "rint", "trunc", "arctan2", "angle", "fix", "round")
WIDEST = 6  # decades of the scale of a state over which it is moved, from a tenth of it on
POINTS = 2001
JUMP = 20.0  # usual changes between neighbouring points: a larger one is a jump
STEPS = 1000  # of the usual operation, in which an angle may pass a turn
ANGLES = ("deg", "rad", "gon", "turn", "rev")
ALIKE = 0.05  # share by which jumps of one period differ, and more of them than one are needed


class Turn(NamedTuple):
    """What jumps, a sensor or a state after a step, by how much, in its unit, where a state passes a value; of: the variable
    that it is or measures.
    """

    name: str
    unit: str
    period: float
    state: str
    at: float
    of: str


def turns(plant: Plant) -> list[Turn]:
    """Find the jumps of output and step along each state from x0, where either has a modulo or what acts like one.

    A jump is a change between two neighbouring points that is much larger than the others; at least two of one size tell a
    period from a saturation or a switch. What states its period is left out.
    """
    u, dt, found = plant.input_at(0.0), plant.dt, []
    parts: tuple[tuple[str, Sequence[Sensor | Signal], Cyclic | None, Callable[[Array], Array]], ...] = (
        ("output", plant.sensors, plant.cyclic_sensors, lambda x: plant.output(0.0, x, u)),
        ("step", plant.states, plant.cyclic_states, lambda x: plant.step(0.0, x, u, dt)),
    )
    for (_, signals, cyclic, function), uses in zip(parts, reversed(plant.non_analytic), strict=True):
        if not any(use.name in MODULO for use in uses):
            continue
        stated = set() if cyclic is None else set(cyclic.at.tolist())
        along = [_jumps(function, plant, j) for j in range(len(plant.states))]
        for i, signal in enumerate(signals):
            of = signal.measures if isinstance(signal, Sensor) else signal.name
            states = [j for j in range(len(along)) if i in along[j] and i not in stated]
            for j in sorted(states, key=lambda j: plant.states[j].name != of)[:1]:
                found.append(Turn(signal.name, signal.unit, *along[j][i], of=of))
    return found


def _jumps(function: Callable[[Array], Array], plant: Plant, j: int) -> dict[int, tuple[float, str, float]]:
    """Of each value of the function that jumps at least twice by the same along state j, the period, the state and where it
    jumps, nearest to x0.
    """
    found: dict[int, tuple[float, str, float]] = {}
    for decade in range(WIDEST + 1):
        half = 10.0 ** (decade - 1) * plant.state_scale[j]
        at = np.linspace(plant.x0[j] - half, plant.x0[j] + half, POINTS)
        x = np.tile(plant.x0, (POINTS, 1))
        x[:, j] = at
        with np.errstate(all="ignore"):
            try:
                change = np.abs(np.diff(function(x), axis=0))
            except Exception:  # of a model far from x0
                continue
        usual = np.median(change, axis=0)
        for i in range(change.shape[1]):
            jumps = np.flatnonzero(change[:, i] > JUMP * usual[i])
            if i in found or not 2 <= jumps.size < POINTS / 10 or usual[i] == 0:
                continue
            sizes = change[jumps, i]
            if np.ptp(sizes) <= ALIKE * np.median(sizes):
                # a modulo falls by its period less what it rises between the two points
                nearest = jumps[np.argmin(np.abs(jumps - POINTS // 2))]
                found[i] = float(np.median(sizes) + usual[i]), plant.states[j].name, float(at[nearest + 1])
    return found


def of_turns(found: list[Turn]) -> Iterator[PlantFinding]:
    """A remark for the values that jump by one period, with the cure."""
    groups: dict[tuple[str, str, str], list[Turn]] = {}
    for turn in found:
        groups.setdefault((f"{turn.period:.4g}", turn.state, turn.of), []).append(turn)
    for (period, state, of), members in groups.items():
        names, unit = ", ".join(t.name for t in members), members[0].unit
        jumps = "jumps" if len(members) == 1 else "jump"
        yield PlantFinding(
            REMARK,
            names,
            f"{jumps} by {period}{'' if unit == '1' else ' ' + unit} where {state} passes {members[0].at:.4g}, as a modulo "
            f"does: a healthy reading on the other side of the jump is a period off; state Signal(period={period}) of {of}, or "
            "Sensor(period=...) of a sensor alone",
        )


def beyond_a_turn(plant: Plant) -> Iterator[PlantFinding]:
    """A remark for the sensors of angles that the model, in STEPS of its usual operation, counts beyond one turn."""
    stated = () if plant.cyclic_sensors is None else plant.cyclic_sensors.at.tolist()
    angles = {i: TURNS[s.unit] for i, s in enumerate(plant.sensors) if s.unit in ANGLES and i not in stated}
    if not angles:
        return
    x, y = plant.x0, []
    with np.errstate(all="ignore"):
        for k in range(STEPS):
            u = plant.input_at(k * plant.dt)
            x = plant.guard(plant.step(k * plant.dt, x, u, plant.dt))[0]
            y.append(plant.output((k + 1) * plant.dt, x, u))
    values = np.array(y)
    turned = [i for i, turn in angles.items() if np.any(values[:, i] < -turn / 2) or np.any(values[:, i] > turn)]
    if turned:
        of = plant.sensors[turned[0]]
        yield PlantFinding(
            REMARK,
            ", ".join(plant.sensor_names[i] for i in turned),
            f"the model counts beyond a turn: where the sensor shows an angle within one, state "
            f"Signal(period={angles[turned[0]]:.6g}) of {of.measures}, or each turn looks like a fault",
        )
