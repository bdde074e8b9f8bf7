"""Operation of a power network: load steps, faults of areas, and areas that join and leave, as functions of time.

An event at time T acts from T on: on the step that begins at T, and on the readings of the ties at T.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.models.power_network.model import NetworkModel
from fusion_sfdia.models.power_network.parameters import LoadStep

Array = NDArray[Any]

AREA_FAULTS = {  # kind: effect of a value
    "governor": "the governor's time constant is `value` s (B18, scenario 1: 1000 instead of 0.1)",
    "input-gain": "`value` times the reference reaches the area (B18, scenario 2: -1, or 2 or 10)",
    "load-loss": "`value` per unit of the load known to the area is lost",
}


@dataclass(frozen=True)
class AreaFault:
    """A process fault of an area of the power network from `onset` until `end`, for `power_network(faults=[...])`.

    Parameters
    ----------
    kind : str
        "governor" (its time constant is `value`, s), "input-gain" (`value` times the reference reaches the area) or "load-loss"
        (`value`, per unit, of the load known to the area is lost). Source: the first two are those of B18, scenarios 1 and 2;
        the third is ours.
    area : str
        Its name.
    value : float
        As the kind states.
    onset : float, default 0
        In s.
    end : float, default inf
        In s.

    Raises
    ------
    ValueError
        For another kind, a value that is not finite, not positive for a time constant, or means no fault, and an end that is
        not after the onset.

    Examples
    --------
    >>> from fusion_sfdia.faults import AreaFault
    >>> from fusion_sfdia.plants import power_network
    >>> faulty = power_network(faults=[AreaFault("input-gain", "1", 0.5, onset=10.0)])  # the `truth` of `simulate`
    >>> faulty.name == power_network().name
    True
    """

    kind: str
    area: str
    value: float
    onset: float = 0.0
    end: float = np.inf

    def __post_init__(self) -> None:
        if self.kind not in AREA_FAULTS:
            raise ValueError(f"unknown fault {self.kind!r} of area {self.area}; known: {', '.join(AREA_FAULTS)}")
        who = f"{self.kind} of area {self.area}"
        if not np.isfinite(self.value) or (self.kind == "governor" and self.value <= 0):
            raise ValueError(f"{who}: value is {self.value}; expected a finite number, positive for a time constant")
        if self.value == {"input-gain": 1.0, "load-loss": 0.0}.get(self.kind):
            raise ValueError(f"{who}: a value of {self.value:g} means no fault; give another")
        if not (np.isfinite(self.onset) and self.end > self.onset):
            raise ValueError(f"{who}: onset {self.onset} s, end {self.end} s; expected a finite onset before the end")


@dataclass(frozen=True)
class Switch:
    """Areas, by name, that are plugged in and unplugged at `time`, at once; for `power_network(switches=[...])`.

    Parameters
    ----------
    time : float
        In s.
    plug_in : tuple of str, default ()
        Areas that join.
    unplug : tuple of str, default ()
        Areas that leave.

    Notes
    -----
    Source: B18, sec. VI. The network raises ValueError for an unknown area, one that is plugged in or out already, and a
    switch of no area.

    Examples
    --------
    >>> from fusion_sfdia.plants import Switch, power_network
    >>> leaving = power_network(switches=[Switch(60.0, unplug=("4",))])  # the `truth` of `simulate`
    >>> leaving.name == power_network().name
    True
    """

    time: float
    plug_in: tuple[str, ...] = ()
    unplug: tuple[str, ...] = ()


class NetworkCondition(NamedTuple):
    """The network at a time: its known model, the true one, and the faults of the true inputs, (N,) each."""

    known: NetworkModel
    true: NetworkModel
    gain: Array  # of the reference
    lost: Array  # load, per unit

    def step(self, x: Array, reference: Array, load: Array) -> Array:
        """The true state (..., N, 4) after dt, from the commanded reference and the known load."""
        return self.true.step(x, self.gain * reference, load - self.lost)


def network_conditions(
    model: NetworkModel, faults: Sequence[AreaFault] = (), switches: Sequence[Switch] = ()
) -> Callable[[float], NetworkCondition]:
    """The condition of a network as a function of time (s); each is made once.

    ValueError for an unknown area, a switch that does not fit what is plugged in by then, or faults of a kind that overlap
    in one area.
    """
    for j, fault in enumerate(faults):
        model.network.topology.index(fault.area)
        for other in faults[:j]:
            same = (fault.kind, fault.area) == (other.kind, other.area)
            if same and fault.onset < other.end and other.onset < fault.end:
                raise ValueError(f"two faults {fault.kind!r} of area {fault.area} overlap in time; give one after the other")
    ordered = sorted(switches, key=lambda s: s.time)
    times = sorted({s.time for s in ordered} | {f.onset for f in faults} | {f.end for f in faults if np.isfinite(f.end)})
    made = [_condition(model, faults, ordered, t) for t in (-np.inf, *times)]
    return partial(_at, times, made)


def _at(times: Sequence[float], made: Sequence[NetworkCondition], t: float) -> NetworkCondition:
    return made[bisect_right(times, t + 1e-9)]


def _condition(model: NetworkModel, faults: Sequence[AreaFault], switches: Sequence[Switch], t: float) -> NetworkCondition:
    known = model
    for switch in switches:
        if switch.time <= t:
            known = known.switched(plug_in=switch.plug_in, unplug=switch.unplug)
    true, gain, lost = known, np.ones(len(model.names)), np.zeros(len(model.names))
    for fault in faults:
        if fault.onset <= t < fault.end:
            i = model.network.topology.index(fault.area)
            match fault.kind:
                case "governor":
                    true = true.altered(fault.area, governor_time=fault.value)
                case "input-gain":
                    gain[i] = fault.value
                case "load-loss":
                    lost[i] = fault.value
    return NetworkCondition(known, true, gain, lost)


def load_profile(model: NetworkModel, steps: Sequence[LoadStep]) -> Callable[[float], Array]:
    """The loads (N,) as a function of time (s), the sum of the steps so far; ValueError for an unknown area."""
    areas = [model.network.topology.index(step.area) for step in steps]
    return partial(_load, len(model.names), tuple(zip(steps, areas, strict=True)))


def _load(n: int, steps: Sequence[tuple[LoadStep, int]], t: float) -> Array:
    load = np.zeros(n)
    for step, i in steps:
        if step.time <= t + 1e-9:
            load[i] += step.change
    return load
