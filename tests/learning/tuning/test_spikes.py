"""Spikes are named with their times, and put down to the convention of inputs only where they are beside its steps."""

from __future__ import annotations

import numpy as np
import pytest
from toy_plants import chain

from fusion_sfdia.learning.tuning.spikes import require_no_spike
from fusion_sfdia.plant.linear import linear_plant
from fusion_sfdia.plant.signals import Signal

PLANT = chain(3)


def test_a_spike_is_named() -> None:
    residual = np.random.default_rng(1).standard_normal((800, 2, 3))
    residual[[70, 90], 1, 1] = 15.0, -30.0
    with pytest.raises(ValueError, match=r"'s1' contradicts all others at 90 s of run 1, .* as does 1 more reading; leave"):
        require_no_spike(PLANT, residual, np.empty((800, 2, 0)), "{} s of run {}".format)
    residual[70, 1, 1] = 0.0
    with pytest.raises(ValueError, match=r"by \d+\.\d of its standard deviations; leave spikes out"):
        require_no_spike(PLANT, residual, np.empty((800, 2, 0)), "{} s of run {}".format)


@pytest.mark.parametrize(("shift", "convention"), [(1, "until the sample"), (-1, "at the sample")])
def test_spikes_at_steps_of_an_input_are_put_down_to_its_convention(shift: int, convention: str) -> None:
    given = {"dt": 1.0, "input_matrix": np.ones((3, 2)), "inputs": (Signal("other"), Signal("speed"))}
    plant = linear_plant(
        "driven", np.eye(3) / 2, np.eye(3), PLANT.sensors, **given, initial_cov=np.ones(3), process_cov=np.ones(3)
    )
    rng = np.random.default_rng(3)
    speed = np.repeat(rng.standard_normal((10, 2)), 80, axis=0)
    acted = np.stack([rng.standard_normal(speed.shape), np.roll(speed, shift, axis=0)], axis=-1)
    residual = rng.standard_normal((800, 2, 3))
    residual[..., 1] += 40 * (speed - acted[..., 1])
    cure = rf"1\d of 1\d rows .* a step of input 'speed', .* state inputs = \"{convention}\" in the map"
    with pytest.raises(ValueError, match=cure):
        require_no_spike(plant, residual, acted, "{} s of run {}".format)
    elsewhere = np.roll(acted, 40, axis=0)
    with pytest.raises(ValueError, match="; leave spikes out"):
        require_no_spike(plant, residual, elsewhere, "{} s of run {}".format)
