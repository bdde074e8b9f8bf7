"""What tuning has learnt is printed with units and with the signals that it moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from toy_plants import chain

from fusion_sfdia.learning.commissioning.disturbances import FoundDisturbance, moves
from fusion_sfdia.learning.tuning.words import _learnt


def test_a_disturbance_is_told_by_the_signals_that_it_moves_most() -> None:
    """Over their noise: a state of 0.1 a step, a sensor of 1; what is not moved is not named."""
    none = np.empty((0, 0))
    found = FoundDisturbance(np.array([0.0, 0.05, 0.0]), np.array([-1.0, 0.0, 0.0]), none, none, 4.0, 0.2, 50.0, 1.0)
    plain = chain(3)
    plant = replace(plain, sensors=(replace(plain.sensors[0], unit="K"), *plain.sensors[1:]))
    assert moves(plant, found) == "s0 by -4 +- 0.2 K, x1 by 0.2 +- 0.01 a step"


def test_what_was_learnt_is_printed_with_units() -> None:
    area = {"value": 2.0, "sd": 0.1, "stated": 1.0, "stated_sd": 0.5, "unit": "m2"}
    moved = {"moves": "TI102 by 0.67 +- 0.02 K", "time_constant": 50.0}
    assert _learnt({"sensors": {}, "parameters": {"area": area}, "disturbance": [moved]}) == [
        "area: 2 +- 0.1, stated 1 +- 0.5 m2",
        "disturbance 1: moves TI102 by 0.67 +- 0.02 K; time constant 50 s",
    ]
