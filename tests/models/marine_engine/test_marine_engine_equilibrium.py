"""Equilibria of the engine at every load."""

from __future__ import annotations

import numpy as np
import pytest

from fusion_sfdia.models.marine_engine.equilibrium import engine_variables, equilibrium
from fusion_sfdia.models.marine_engine.parameters import engine_parameters
from fusion_sfdia.models.marine_engine.plant import (
    marine_engine,
)

C = engine_parameters()
PLANT = marine_engine()


def test_the_operating_point_at_full_load() -> None:
    found = engine_variables(PLANT.x0, C)
    # the digits to which the point was computed by hand; half a unit of the last one is allowed for
    for name, value, half_a_digit in (
        ("fuel", 2.835e-3, 5e-7),
        ("p_cylinder", 1.7075e6, 50),
        ("T_cylinder", 1101.4, 0.05),
        ("torque", 51566, 0.5),
        ("p_receiver", 3.95e5, 500),
        ("T_receiver", 840.5, 0.05),
        ("T_turbine", 632.9, 0.05),
        ("p_charge", 4.52e5, 500),
        ("T_charge", 328, 0.5),
        ("T_compressor", 546.8, 0.05),
        ("speed", 1000 / 60, 1e-9),
        ("power", 5.4e6, 1e-3),
    ):
        assert found[name] == pytest.approx(value, abs=half_a_digit), name


@pytest.mark.parametrize("slip", ["law", "constant"])
def test_every_load_has_an_equilibrium_and_more_load_gives_more(slip: str) -> None:
    loads = np.arange(0.2, 1.001, 0.05)
    points = np.array([equilibrium(u, C, slip) for u in loads])
    z = engine_variables(points, C, slip)
    for name in ("fuel", "p_receiver", "p_charge", "torque", "power", "speed", "p_cylinder", "T_compressor"):
        assert np.all(np.diff(z[name]) > 0), name
    if slip == "law":
        assert z["power"][12] == pytest.approx(3.93e6, abs=5e3)
    plant = marine_engine(slip=slip)
    moved = plant.step(0.0, points, loads[:, None], 0.01)
    # the solver stops at 1e-12 of the pressures; a step moves them by at most (1 - e^-1) of the residual
    np.testing.assert_allclose(moved, points, rtol=1e-12)


def test_without_an_equilibrium_the_solver_reports_it() -> None:
    with pytest.raises(ArithmeticError, match=r"no equilibrium at load 1: residual .* of the pressures"):
        equilibrium(1.0, C._replace(loss_nominal=1e6))
