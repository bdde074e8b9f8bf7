"""The engine's equations before discretisation."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rounding import rounding

from fusion_sfdia.derivatives.equation import complex_step_jacobian
from fusion_sfdia.models.marine_engine import equations
from fusion_sfdia.models.marine_engine.equilibrium import equilibrium
from fusion_sfdia.models.marine_engine.parameters import engine_parameters
from fusion_sfdia.models.marine_engine.physics import decay_rates, engine_equations, engine_physics

Array = NDArray[Any]
C = engine_parameters()
X0 = equilibrium(1.0, C)
FULL = np.ones(1)
NOMINAL = equations.unknown_of(C)[None]


def test_the_linearised_engine_is_stable_with_three_time_scales() -> None:
    physics = engine_physics(C, "law", X0, 1.0)

    def slope(x: Array) -> Array:
        z = equations.algebraic(np.ascontiguousarray(x).reshape(-1, 3), NOMINAL, C, True).reshape(*x.shape[:-1], 7)
        return physics.f(0.0, x, z, FULL, C)

    eigenvalues = np.sort(np.linalg.eigvals(complex_step_jacobian(slope, X0)).real)
    np.testing.assert_allclose(eigenvalues, [-112.0, -66.7, -0.279], rtol=2e-3)  # to the digits stated
    # the fuel is a block of its own, its eigenvalue rounded by eps of the matrix scaled to the states' sizes, of norm 112
    assert eigenvalues[1] == pytest.approx(-1 / C.fuel_delay, rel=rounding(112 / 66.7 * 100, 10))


def test_the_physics_is_at_rest_in_equilibrium() -> None:
    physics = engine_physics(C, "law", X0, 1.0)
    z = equations.algebraic(X0[None], NOMINAL, C, True)[0]
    # the equilibrium is found to 1e-12 of each state, so a rate is 1e-12 of the state over its time constant
    assert np.all(np.abs(physics.f(0.0, X0, z, FULL, C)) <= 2e-12 * decay_rates(C) * X0)


def test_only_equations_with_slip_depend_on_its_law() -> None:
    law, constant = engine_equations("law"), engine_equations("constant")
    differing = {name for name in law if law[name] is not constant[name]}
    assert law.keys() == constant.keys() and differing == {"p_receiver", "T_receiver", "p_charge", "T_compressor"}
