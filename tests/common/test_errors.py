"""Warnings point at the caller's line at every entrance, however deep the package warns."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
import pytest

import fusion_sfdia as sfdia
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plants import two_tanks

PLANT = two_tanks()
STEPS = PLANT.dt * np.arange(30)
LOG = Log(STEPS, np.tile([np.nan, *PLANT.output(0.0, PLANT.x0, PLANT.input_at(0.0))[1:]], (30, 1)), np.full((30, 1), 6e-4))


@pytest.mark.parametrize(
    "entrance", [lambda: sfdia.diagnose("kf-chi2", LOG, plant=PLANT), lambda: sfdia.detector("kf-chi2", PLANT).diagnose(LOG)]
)
def test_a_diagnosis_warns_at_the_line_that_asked_for_it(entrance: Callable[[], object]) -> None:
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        entrance()
    assert found and {w.filename for w in found} == {__file__}
