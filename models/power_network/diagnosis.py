"""The model of a power network in its diagnosers: the areas one by one, and their noise (Boem et al. 2018, sec. VIII)."""

from __future__ import annotations

import numpy as np

from fusion_sfdia.models.power_network.equations import STATES
from fusion_sfdia.models.power_network.model import NOISE_VARIANCE, NetworkModel
from fusion_sfdia.plant.areas import Areas


def network_areas(model: NetworkModel, *, named: bool = True) -> Areas:
    """The areas of a network, their neighbours' angles held over a step, as local diagnosers require.

    named: False leaves out the names of states and owners, which take longer and more memory than all numbers together.
    """
    at, n = model.network.topology, len(model.names)
    return Areas(
        network=model.network,
        states=tuple(tuple(f"{s}_{i}" for s in STATES) for i in model.names if named),
        owners=tuple(f"area {i}" for i in model.names if named),
        matrices=model.area,
        slope=model.side_slope,
        shared_gain=model.area[at.neighbour, 0, 0],
        process_variance=np.tile(model.process_cov, (n, 1)),
        noise=np.tile(NOISE_VARIANCE, (n, 1)),
        shared_noise=np.full(at.node.size, NOISE_VARIANCE[0]),
    )
