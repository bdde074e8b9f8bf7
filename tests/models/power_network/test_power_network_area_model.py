"""The model of a single area, and what crosses its border."""

from __future__ import annotations

import numpy as np
import pytest

from fusion_sfdia.models.power_network.area_model import area_model
from fusion_sfdia.models.power_network.model import network_model
from fusion_sfdia.models.power_network.plant import network_sensors

MODEL = network_model()
NAMES = MODEL.names
RNG = np.random.default_rng(1)
X = 0.1 * RNG.standard_normal((15, 4))
LOAD, REFERENCE = 0.2 * RNG.standard_normal((2, 15))
EPS = np.finfo(float).eps


def test_an_area_predicts_itself_from_what_crosses_its_border() -> None:
    after = MODEL.step(X, REFERENCE, LOAD)
    for i, name in enumerate(NAMES):
        area = area_model(MODEL, name)
        theta = X[[NAMES.index(j) for j in area.neighbours], 0]
        own = area.transition @ X[i] + area.by_reference * REFERENCE[i] + area.by_load * LOAD[i] + area.by_angles @ theta
        assert own == pytest.approx(after[i], abs=100 * EPS * np.abs(area.transition).max())


def test_what_crosses_the_border_of_an_area() -> None:
    area = area_model(network_model(unplugged=["13"]), "4")
    assert area.shared == ("theta_3@4", "theta_5@4")
    assert area.sharers == {"4": ("4", "3", "5"), "3": ("3", "2", "4"), "5": ("5", "2", "4", "6")}
    owners = {s.name: s.owner for s in network_sensors(MODEL)}
    assert all(owners[name] == "area 4" for name in area.shared) and owners["theta_3"] == "area 3"
