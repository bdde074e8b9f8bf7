"""network/sign-flip: detection, isolation and compensation of a flipped sign."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fusion_sfdia.benchmarks.network.support.trials import ALPHA, WatchedRuns, trial
from fusion_sfdia.models.power_network.accommodation import Compensated
from fusion_sfdia.models.power_network.control import generation_control
from fusion_sfdia.models.power_network.model import network_model
from fusion_sfdia.models.power_network.published import ATTACKS, SIGN_FLIP


def flipped(**changes: Any) -> dict[str, Any]:
    watch = {"area": "5", "onset": 45.0, "mode": "corrected", "hypotheses": ATTACKS} | changes
    return trial(network_model(noise="small"), WatchedRuns(**watch), 75, range(6), loads="2", faults=[SIGN_FLIP.fault])


def test_a_sign_flip_is_detected_isolated_and_compensated() -> None:
    alone, helped = flipped(), flipped(reconfigure=True)
    for found in (alone, helped):  # the same until the isolation
        assert np.all((found["detected"][:, 1] >= 48.0) & (found["detected"][:, 1] <= 51.0))
        assert np.all(found["first_answer"] == 0) and np.all(found["answered"] >= found["detected"][:, 1] + 3)
        assert np.array_equal(found["detected"], alone["detected"])
    assert np.all(helped["angle"][:, 4] < 0.5 * alone["angle"][:, 4])
    k = int(helped["answered"][0]) + 1  # acts on the step that begins at the isolation
    assert np.array_equal(helped["reference"][:k], alone["reference"][:k])
    assert helped["reference"][k, 4] == -alone["reference"][k, 4]
    assert np.array_equal(helped["reached"][46:, 4], -helped["reference"][46:, 4])  # by a fault that acts from 45 s on
    assert np.array_equal(helped["reached"][:46], helped["reference"][:46])
    # once they know how the input acts, the diagnosers have no alarms of it: 0.6 % a step each of what is Gaussian
    late = np.abs(helped["residual"][k + 3 :]) > ALPHA * helped["deviation"][k + 3 :]
    assert np.mean(late) < 0.1


def test_a_reference_is_divided_by_its_known_gain_and_stays_within_limits() -> None:
    model, y, load = network_model(), np.zeros((2, 15, 4)), np.full(15, 0.2)
    gain = np.ones((2, 15))
    gain[1, :3] = -1.0, 10.0, 0.1
    control = Compensated(generation_control, gain)
    assert control(model, y, load)[1, :4].tolist() == pytest.approx([-0.2, 0.02, 0.65, 0.2], rel=1e-12)
    gain[0, 0] = 0.0
    with pytest.raises(ValueError, match="unplug the area"):
        control(model, y, load)
