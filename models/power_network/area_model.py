"""The model of a single area by itself, and what crosses its border."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.models.power_network import equations
from fusion_sfdia.models.power_network.model import NOISE_VARIANCE, NetworkModel

Array = NDArray[Any]


class AreaModel(NamedTuple):
    """The model of one area for its diagnoser, with what crosses its border; k neighbours are joined to it at present.

    Continuous: dx/dt = A x + B P_ref + L P_L + sum_j coupling[j] x_j. Over dt, the angles of the neighbours held:
    x+ = transition x + by_reference P_ref + by_load P_L + by_angles theta.
    shared: the area's readings of the neighbours' angles.
    sharers: for each angle that the area knows, its own and its neighbours', the areas that read it (S^k of B18).
    """

    name: str
    neighbours: tuple[str, ...]
    A: Array  # (4, 4)
    B: Array  # (4,)
    L: Array  # (4,)
    coupling: Array  # (k, 4, 4)
    transition: Array  # (4, 4)
    by_reference: Array  # (4,)
    by_load: Array  # (4,)
    by_angles: Array  # (4, k)
    process_cov: Array  # (4,) variances over dt
    noise_cov: Array  # (4,) variances of its own readings; a shared angle is read with that of an angle
    shared: tuple[str, ...]
    sharers: dict[str, tuple[str, ...]]


def area_model(model: NetworkModel, name: str) -> AreaModel:
    """One area by itself; ValueError for an unknown name."""
    i = model.network.topology.index(name)
    sides = model.network.sides(i)
    slope = model.side_slope[sides]
    local = equations.area_matrices(model.stiffness[i : i + 1], model.constants[i : i + 1], np.empty(0, int))[0, 0]
    coupling = np.zeros((sides.size, 4, 4))
    coupling[:, :, 0] = slope[:, None] * local[:, 5]
    near = model.network.neighbours(name)
    return AreaModel(
        name=name,
        neighbours=near,
        A=local[:, :4],
        B=local[:, 4],
        L=-local[:, 5],
        coupling=coupling,
        transition=model.area[i, :, :4],
        by_reference=model.area[i, :, 4],
        by_load=-model.area[i, :, 5],
        by_angles=model.area[i, :, 5:] * slope,
        process_cov=model.process_cov,
        noise_cov=np.array(NOISE_VARIANCE),
        shared=tuple(f"theta_{j}@{name}" for j in near),
        sharers={k: (k, *model.network.neighbours(k)) for k in (name, *near)},
    )
