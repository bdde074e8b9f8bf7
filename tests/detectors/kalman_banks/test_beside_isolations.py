"""A healthy run has the bits that it has alone, also beside a run of which a sensor is isolated or a reading is missing."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.detector import Decision
from fusion_sfdia.diagnosis.simulate import simulate

STEPS, FAULT, RUNS = 16, 8, 3


@pytest.mark.parametrize("detector", ["loo-chi2", "loo-glr"])
@pytest.mark.parametrize("name", ["two-tanks", "gas-pipeline", "power-network"])  # written out, by matrices, repeated sensors
def test_a_run_has_the_bits_that_it_has_alone(name: str, detector: str) -> None:
    plant = registry.plant(name)
    found = registry.detector(detector, plant)
    recording = simulate(plant, STEPS, seeds=range(RUNS), truth="model")
    y = recording.y.copy()
    y[FAULT:, 0, 0] += 30 * plant.sensor_sigma[0]
    y[FAULT + 2, 1, 1] = np.nan
    start = float(recording.t[0]) - plant.dt
    together, alone, isolated = found.init((RUNS,), start), [found.init((1,), start) for _ in range(RUNS)], False
    for k in range(STEPS):
        t, u = float(recording.t[k]), recording.u_of_runs[k]
        together, decision = found.step(together, t, y[k], u)
        isolated |= bool(decision.isolated[0, 0])
        for r in range(RUNS):
            alone[r], own = found.step(alone[r], t, y[k, r : r + 1], u[r : r + 1] if u.ndim == 2 else u)
            for field in fields(Decision):
                if (of_all := getattr(decision, field.name)) is not None:
                    np.testing.assert_array_equal(of_all[r : r + 1], getattr(own, field.name), err_msg=field.name)
    assert isolated
