"""Which residuals a structure has, checked by hand and against the Fault Diagnosis Toolbox."""

from __future__ import annotations

import numpy as np
import pytest
from structural_plants import PLANTS, plant_of

from fusion_sfdia.derivatives.equation import argument_names
from fusion_sfdia.detectors.structural_residuals.structural_residuals import selected
from fusion_sfdia.detectors.structural_residuals.structure import computable, residual_of, structural_model


def test_the_structure_of_two_tanks_by_hand() -> None:
    """Upper tank: the level by its sensor or its balance, in which the outflow is read or computed; the lower one likewise."""
    found = {(r.target, r.integrated, frozenset(r.read)) for r in computable(plant_of("two-tanks"))}
    upper = {
        ("flow_12", (), frozenset({"level_1", "flow_12"})),
        ("level_1", ("level_1",), frozenset({"level_1", "flow_12"})),
        ("level_1", ("level_1",), frozenset({"level_1"})),
        ("flow_12", ("level_1",), frozenset({"flow_12"})),
    }
    lower = {("flow_out", (), frozenset({"level_2", "flow_out"}))}
    for source, states in (({"flow_12"}, ()), ({"level_1"}, ()), (set(), ("level_1",))):  # of the flow into it
        integrated = (*states, "level_2")
        lower |= {
            ("level_2", integrated, frozenset({"level_2", "flow_out"} | source)),
            ("level_2", integrated, frozenset({"level_2"} | source)),
            ("flow_out", integrated, frozenset({"flow_out"} | source)),
        }
    assert found == upper | lower
    assert len(structural_model(plant_of("two-tanks")).MSO()) == 14 + 3  # these derive a flow from a level's rate of change
    assert [r.read for r in selected(plant_of("two-tanks"))] == [("flow_12",), ("level_1",), ("flow_out",), ("level_2",)]


@pytest.mark.parametrize("name", PLANTS)
def test_what_is_computable_is_what_the_toolbox_computes_in_the_equations_own_direction(name: str) -> None:
    """Each equation matched to its own variable, one after the other, states by integration: by the toolbox's matching."""
    plant = plant_of(name)
    model, modules = structural_model(plant), plant.structure.modules
    assert modules is not None
    variables, count, n = tuple(modules.equations), len(modules.equations), len(plant.sensors)
    own = {v: k for k, v in enumerate(variables)}
    column = {v: k for k, v in enumerate(model.x)}

    def allowed(equation: int, variable: int) -> bool:
        if equation < count:
            v = variables[equation]
            if v not in modules.states and v in argument_names(modules.equations[v]):
                return False  # the torque: to be solved for
            return variable == column[f"rate of {v}" if v in modules.states else v]
        if equation < count + n:
            return variable == column[plant.sensors[equation - count].measures]
        return variable == column[modules.states[equation - count - n]]  # the integral

    sets = model.MSO()
    for mso in sets[:: max(1, len(sets) // 200)]:
        checks = {}
        for equation in map(int, mso):
            matching = model.Matching(np.array([k for k in mso if k != equation])).matching
            pairs = [(int(e), int(v)) for part in matching for e, v in zip(part.row, part.col, strict=True)]
            alone = all(len(part.row) == 1 or part.matchType == "int" for part in matching)
            if alone and all(allowed(e, v) for e, v in pairs):
                checks[equation] = {part.matchType for part in matching}
        found = residual_of(plant, mso)
        assert (found is None) == (not checks)
        if found is not None:
            reading = count + [s.measures for s in plant.sensors].index(found.target)
            checked = own[found.target] if found.target_is_read else reading
            assert checked in checks and ("int" in checks[checked]) == bool(found.integrated)
