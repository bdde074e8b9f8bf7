"""Fault functions for isolation: the change of an area's next state by a fault (Boem et al. 2018, (3) and sec. VIII)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.models.power_network.model import NetworkModel
from fusion_sfdia.models.power_network.operation import AreaFault

Array = NDArray[Any]


def fault_function(model: NetworkModel, fault: AreaFault) -> Callable[[Array, Array, Array], Array]:
    """phi(x (..., 4), reference (...), external (...)) -> (..., 4) of a fault while it acts: x+ = f + phi.

    external: sum_j P_ij theta_j - P_L, by the neighbours' angles and the load as they are known. Affine for all kinds:
    governor      phi = (F' - F) x + (b' - b) u + (g' - g) e, of the model with the other time constant
    input-gain    phi = (value - 1) b u
    load-loss     phi = value g
    ValueError for an unknown area.
    """
    i = model.network.topology.index(fault.area)
    row = model.area[i]
    change, constant = np.zeros_like(row), np.zeros(row.shape[0])
    match fault.kind:
        case "governor":
            change = model.altered(fault.area, governor_time=fault.value).area[i] - row
        case "input-gain":
            change[:, 4] = (fault.value - 1.0) * row[:, 4]
        case "load-loss":
            constant = fault.value * row[:, 5]

    def phi(x: Array, reference: Array, external: Array) -> Array:
        known = np.concatenate([x, np.asarray(reference)[..., None], np.asarray(external)[..., None]], axis=-1)
        added: Array = known @ change.T + constant
        return added

    return phi
