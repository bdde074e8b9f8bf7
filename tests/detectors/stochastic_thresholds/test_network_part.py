"""A part of a network: what crosses its border."""

from __future__ import annotations

import pytest

from fusion_sfdia.detectors.stochastic_thresholds.network_part import part_layouts
from fusion_sfdia.models.power_network.diagnosis import network_areas
from fusion_sfdia.models.power_network.model import network_model
from fusion_sfdia.models.power_network.parameters import generate_network

AREAS = network_areas(network_model(generate_network(23, 3, degree=5.0), unplugged=["7", "8"]))


def test_a_part_receives_no_more_than_its_border() -> None:
    first, second, third = part_layouts(AREAS, 3)
    at = AREAS.network.topology
    for layout in (first, second, third):
        lo, hi = layout.areas
        inside = (at.node >= lo) & (at.node < hi)
        crossing = inside & ~((at.neighbour >= lo) & (at.neighbour < hi))
        assert layout.border.size == layout.sides.size - layout.near == crossing.sum()
    with pytest.raises(ValueError, match="23 areas cannot be shared by 24 parts; expected 1 to 23"):
        part_layouts(AREAS, 24)
