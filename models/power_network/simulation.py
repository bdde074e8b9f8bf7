"""Closed-loop runs of power networks of any size: noise, controllers, faults, areas that join and leave.

The controllers see noisy readings, so each seed has its own inputs. Every seed draws its own streams, so its run has the same
bits alone and among other seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import whole
from fusion_sfdia.common.random_streams import require_seeds, stream
from fusion_sfdia.models.power_network.control import Control, generation_control
from fusion_sfdia.models.power_network.model import NOISE_VARIANCE, NetworkModel
from fusion_sfdia.models.power_network.operation import AreaFault, NetworkCondition, Switch, network_conditions

Array = NDArray[Any]
Draw = Callable[[np.random.Generator, tuple[int, ...]], Array]


class NetworkSample(NamedTuple):
    """The network at a time: B seeds, N areas, 2E sides of ties.

    t (s). x (B, N, 4) true states. own (B, N, 4) the areas' readings of their states, shared (B, 2E) their readings of their
    neighbours' angles, NaN at open ties. reference (B, N) commanded and load (N,) known, both as they acted until t.
    condition: of the network from t on.
    """

    t: float
    x: Array
    own: Array
    shared: Array
    reference: Array
    load: Array
    condition: NetworkCondition

    @property
    def y(self) -> Array:
        """Readings (B, 4N + 2E), in the order of the plant's sensors."""
        return np.concatenate([self.own.reshape(*self.own.shape[:-2], -1), self.shared], axis=-1)

    @property
    def u(self) -> Array:
        """Inputs (B, 2N), in the order of the plant's."""
        return np.concatenate([self.reference, np.broadcast_to(self.load, self.reference.shape)], axis=-1)


def run_network(
    model: NetworkModel,
    steps: int,
    seeds: Sequence[int],
    *,
    loads: Callable[[float], Array],
    control: Control = generation_control,
    faults: Sequence[AreaFault] = (),
    switches: Sequence[Switch] = (),
    process_noise: bool = True,
    draw: Draw = np.random.Generator.standard_normal,
) -> Iterator[NetworkSample]:
    """Yield the moments 0, dt .. steps dt of runs from equilibrium at t = 0, where the first readings are taken.

    model: of the truth, at t = 0. loads: (N,) as a function of the time (s) from which they act. draw: all noise, from a
    generator and a shape, with mean 0 and variance 1. Raises ValueError for seeds, faults or switches that do not fit.
    """
    whole("steps", steps, 0)
    seeds = require_seeds(seeds)
    at = network_conditions(model, faults, switches)
    n, sides = len(model.names), model.network.topology.node.size
    sigma, shared_sigma, disturbance = np.sqrt(NOISE_VARIANCE), np.sqrt(NOISE_VARIANCE[0]), np.sqrt(model.process_cov)
    read = [stream(s, "measurement noise") for s in seeds]
    disturb = [stream(s, "process noise") for s in seeds]
    x = np.zeros((len(seeds), n, 4))
    reference, load = np.zeros(x.shape[:-1]), np.zeros(n)
    for k in range(steps + 1):
        t = k * model.dt
        now = at(t)
        own = x + sigma * np.stack([draw(g, (n, 4)) for g in read])
        theirs = x[..., model.network.topology.neighbour, 0] + shared_sigma * np.stack([draw(g, (sides,)) for g in read])
        yield NetworkSample(t, x, own, np.where(now.known.network.closed, theirs, np.nan), reference, load, now)
        load = loads(t)
        reference = control(now.known, own, load)
        x = now.step(x, reference, load)
        if process_noise:
            x = x + disturbance * np.stack([draw(g, (n, 4)) for g in disturb])
