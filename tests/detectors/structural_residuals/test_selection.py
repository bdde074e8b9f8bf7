"""The selected residuals isolate what all usable ones do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from structural_plants import PLANTS, plant_of

from fusion_sfdia.detectors.structural_residuals.selection import isolable, reads, selected, usable
from fusion_sfdia.detectors.structural_residuals.structure import residual_of, structural_model


@pytest.mark.parametrize("name", PLANTS)
def test_the_selection_isolates_what_all_usable_residuals_do_by_the_toolbox(name: str) -> None:
    plant = plant_of(name)
    model, sets = structural_model(plant), {}
    for mso in structural_model(plant).MSO():
        if (found := residual_of(plant, mso)) is not None:
            sets[found] = mso
    kept = [replace(r, feedback=False) for r in usable(plant)]
    theirs = model.IsolabilityAnalysisArrs([sets[r] for r in kept])  # 1: not isolable from each other
    chosen = model.IsolabilityAnalysisArrs([sets[replace(r, feedback=False)] for r in selected(plant)])
    np.testing.assert_array_equal(chosen, theirs)
    ours = isolable(reads(plant, selected(plant)))
    assert np.all(np.diagonal(ours))  # each fault is detectable
    np.testing.assert_array_equal(ours, (theirs == 0) | np.eye(len(ours), dtype=bool))
    torque = [s.measures for s in plant.sensors].index("torque") if name == "marine-engine" else 0
    hidden = {"p_cylinder", "T_cylinder", "T_compressor"} if name == "marine-engine" else set()
    assert {plant.sensors[i].measures for i in np.flatnonzero(~ours[:, torque])} == hidden and np.sum(~ours) == len(hidden)
