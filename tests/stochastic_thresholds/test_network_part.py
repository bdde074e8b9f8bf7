"""A part of a network: what crosses its border."""

from __future__ import annotations

import pytest

from fusion_sfdia.models.power_network.diagnosis import network_areas
from fusion_sfdia.models.power_network.model import network_model
from fusion_sfdia.models.power_network.parameters import generate_network
from fusion_sfdia.stochastic_thresholds.network_part import blocks

AREAS = network_areas(network_model(generate_network(23, 3, degree=5.0), unplugged=["7", "8"]))


def test_a_part_is_told_of_no_more_than_its_border() -> None:
    first, second, third = blocks(AREAS, 3)
    at = AREAS.network.topology
    for block in (first, second, third):
        lo, hi = block.areas
        inside = (at.node >= lo) & (at.node < hi)
        crossing = inside & ~((at.neighbour >= lo) & (at.neighbour < hi))
        assert block.border.size == block.sides.size - block.near == crossing.sum()
    with pytest.raises(ValueError, match="23 areas cannot be shared by 24 parts; expected 1 to 23"):
        blocks(AREAS, 24)
