"""Areas of a network: what is refused, and the positions of their sensors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fusion_sfdia.models.power_network.diagnosis import network_areas
from fusion_sfdia.models.power_network.model import network_model
from fusion_sfdia.plant.areas import Areas
from fusion_sfdia.plant.plant import Array

AREAS = network_areas(network_model())
AT = AREAS.network.topology


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"shared_gain": AREAS.shared_gain + np.eye(34)[3]}, "areas 5 and 2 share theta_5 and model it differently"),
        ({"noise": AREAS.noise * 0}, "of readings positive"),
        ({"slope": AREAS.slope[:-1]}, r"slope of 15 areas has shape .33,.; expected .34,."),
        ({"network": AREAS.network.switched(unplug=["4"])}, "the open tie 3-4 has a slope"),
        ({"matrices": np.full_like(AREAS.matrices, np.nan)}, "finite numbers"),
    ],
)
def test_areas_that_cannot_be(change: dict[str, Array], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(AREAS, **change)


def test_the_place_of_a_sensor() -> None:
    assert AREAS.place("omega_3", "area 3") == 9
    sides = {(AT.names[AT.node[s]], AT.names[AT.neighbour[s]]): s for s in range(34)}
    assert AREAS.place("theta_5", "area 4") == 60 + sides["4", "5"]
    with pytest.raises(ValueError, match="owned by 'area 9'"):
        AREAS.place("theta_5", "area 9")
    assert isinstance(AREAS, Areas)
