"""Bounds of the algebraic variables by inclusion and set inversion against the corners."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest
from engine_runs import BOUND, DETECTOR, healthy, judge, recording_of

from fusion_sfdia.detectors.adaptive_thresholds.algebraic_bounds import TOLERANCE

BOUND_OF_VARIABLE = DETECTOR._bound


def test_inclusion_and_set_inversion_enclose_the_corners() -> None:
    """Inclusion is the widest; set inversion is within it, to its tolerance, for explicit equations."""
    recording = healthy(300, 5)
    y = recording.y[:3].copy()
    y[2, 0, 0] = np.nan
    ends = {}
    for bounds in ("corners", "inclusion", "sivia"):
        d = judge(replace(DETECTOR, bounds=bounds), y, recording_of(recording, 3))
        middle, radius = y - d.residual, d.threshold - BOUND
        ends[bounds] = np.stack([middle - radius, middle + radius])[..., [1, 2, 3, 5, 6, 8, 9]] / BOUND[[1, 2, 3, 5, 6, 8, 9]]
    known = ~np.isnan(ends["corners"][0])
    # the slack of corners is that of the whole envelope: at most this much where a slope has no sign
    slack = (DETECTOR._settings.unproved[3:, :10] @ BOUND_OF_VARIABLE / BOUND_OF_VARIABLE[3:]) + 1e-9
    for bounds in ("inclusion", "sivia"):
        assert np.all((ends[bounds][0] <= ends["corners"][0] + slack)[known])
        assert np.all((ends[bounds][1] >= ends["corners"][1] - slack)[known])
    others = [0, 1, 3, 4, 5, 6]  # all but the torque
    beyond = (ends["sivia"] - ends["inclusion"])[..., others] * np.array([-1, 1])[:, None, None, None]
    assert np.all(beyond[np.broadcast_to(known[..., others], beyond.shape)] <= 0.01 + 1e-9)
    width = {bounds: np.nanmean(np.diff(e, axis=0)[0], axis=(0, 1)) for bounds, e in ends.items()}
    assert np.all(width["inclusion"][[0, 1, 3]] > 1.05 * width["corners"][[0, 1, 3]])


@pytest.mark.skipif(find_spec("codac") is None, reason="needs the optional package codac")
def test_set_inversion_by_codac_lies_between() -> None:
    """Ours contracts the readings' intervals with a narrow z too, which are constants to codac; inclusion is the widest."""
    recording = healthy(300, 5)
    y = recording.y[:1, :2].copy()
    first = replace(recording_of(recording, 1), u=recording.u[:1])
    ends = {}
    for bounds in ("sivia", "codac", "inclusion"):
        d = judge(replace(DETECTOR, bounds=bounds), y, first)
        middle, radius = y - d.residual, d.threshold - BOUND
        ends[bounds] = np.stack([-(middle - radius), middle + radius]) / BOUND
    # a hull exceeds the solutions by at most the smallest box, TOLERANCE wide
    assert np.all(ends["sivia"] <= ends["codac"] + TOLERANCE)
    assert np.all(ends["codac"] <= ends["inclusion"] + TOLERANCE)
