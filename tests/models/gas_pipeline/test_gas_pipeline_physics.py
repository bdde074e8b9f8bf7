"""Steady states of the pipe against other sources, its parameters and its largest step."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from fusion_sfdia.models.gas_pipeline import equations
from fusion_sfdia.models.gas_pipeline.fit_natural_gas import gerg_2008
from fusion_sfdia.models.gas_pipeline.physics import (
    INLET_PRESSURE,
    INLET_TEMPERATURE,
    courant_step,
    pipeline_parameters,
    steady_state,
)
from fusion_sfdia.models.gas_pipeline.plant import coarse_state, gas_pipeline

Array = NDArray[Any]
C = pipeline_parameters()
AREA = np.pi / 4 * C.diameter**2


@pytest.mark.parametrize("flow", [300.0, 450.0])
def test_steady_state_by_the_general_flow_equation(flow: float) -> None:
    """p_in^2 - p_out^2 = f (L/d) (m/A)^2 z R T at mean pressure and temperature, to 5e-4 of the pressure."""
    x = steady_state(151, flow, C)
    p, T = x[:151], x[302:]
    mean_p, mean_T = 2 / 3 * (p[0] ** 3 - p[-1] ** 3) / (p[0] ** 2 - p[-1] ** 2), T.mean()
    z = equations.gas(mean_p, mean_T, C)[0]
    f = equations.friction_factor(flow, C)
    drop = f * C.length / C.diameter * (flow / AREA) ** 2 * z * C.gas_constant * mean_T
    assert p[-1] == pytest.approx(np.sqrt(p[0] ** 2 - drop), rel=5e-4)


@pytest.mark.parametrize("flow", [300.0, 450.0])
def test_steady_state_of_the_gas_itself(flow: float) -> None:
    """Momentum p_s + rho v v_s = -f rho v^2 / 2d and energy m (cp T_s - cp mu p_s + v v_s) = -pi d k (T - T_a), along the
    pipe with the properties of GERG-2008 (mu: Joule and Thomson) where this package has the fit, and f by a root finder.
    """
    pytest.importorskip("pyaga8")
    d = C.diameter
    reynolds = 4 * flow / (np.pi * d * C.viscosity)
    root = brentq(lambda r: r + 2 * np.log10(C.roughness / (3.7 * d) + 2.51 / reynolds * r), 1.0, 100.0, xtol=1e-14)

    def along(s: float, y: Array) -> Array:
        p, T = y
        gas, gas_constant = gerg_2008(y[:1], y[1:])
        z, alpha_1, alpha_2, cp, _, mu = (value[0] for value in gas.values())
        rho = p / (z * gas_constant * T)
        v = flow / (rho * AREA)
        v_p, v_T = -v * alpha_2 / p, v * alpha_1 / T
        matrix = np.array([[1 + rho * v * v_p, rho * v * v_T], [v * v_p - cp * mu, v * v_T + cp]])
        heat = np.pi * d * C.heat_transfer * (T - C.ambient) / flow
        slope: Array = np.linalg.solve(matrix, np.array([-(root**-2) * rho * v**2 / (2 * d), -heat]))
        return slope

    start, places = [INLET_PRESSURE, INLET_TEMPERATURE], [C.length / 2, C.length]
    p, T = solve_ivp(along, (0.0, C.length), start, "DOP853", t_eval=places, rtol=1e-9, atol=1e-6).y
    x = steady_state(21, flow, C)
    # the fit errs by 3e-4 in cp and 4e-4 in mu (test_natural_gas): of 20 K exchanged with the ground, whose influence has
    # decayed to a third, 2 mK, of 2.5 K of throttling, 1 mK; the drop of up to 0.6 MPa by that over T and by 5e-6 in z
    np.testing.assert_allclose(x[[52, 62]], T, rtol=0, atol=4e-3)
    np.testing.assert_allclose(x[[10, 20]], p, rtol=0, atol=10.0)


@pytest.mark.parametrize(("case", "viscosity", "tolerance"), [("PC", 1.193e-5, 4e-5), ("N", 1e-12, 2e-4)])
def test_one_pipe_of_a_commercial_solver(shared_fixtures: Path, case: str, viscosity: float, tolerance: float) -> None:
    """STANET's outlet pressure by Prandtl-Colebrook, and by Nikuradse's law, the limit of ours for vanishing viscosity.

    Its gas: z = 1, 0.84 kg/m3 at 101325 Pa and 273.15 K, isothermal (here by a huge heat capacity); pressures are above
    1.01325 bar; k/(3.71 d) where Shaheen 2024 has k/(3.7 d). What is left: acceleration, which STANET leaves out (2e-5 of
    the pressure), the digits of its molar volume, and for "N" its constant (8e-4 of f is 1.3e-4 of the pressure).
    """
    file = shared_fixtures / "pandapipes_stanet" / "one_pipe" / f"pipe_1_{case}.json"
    net = json.loads(file.read_text())["_object"]

    def table(name: str) -> dict[str, Any]:
        frame = json.loads(net[name]["_object"])
        return {c: [row[i] for row in frame["data"]] for i, c in enumerate(frame["columns"])}

    pipe, junction, sink = table("pipe"), table("junction"), table("sink")
    c = C._replace(
        length=1e3 * pipe["length_km"][0],
        diameter=pipe["diameter_m"][0],
        roughness=1e-3 * pipe["k_mm"][0] * 3.7 / 3.71,
        viscosity=viscosity,
        heat_transfer=0.0,
        gas_constant=101325 / (0.84 * 273.15),
        z=np.zeros_like(C.z),
        cp0=np.array([1e15, 0.0, 0.0]),
    )
    inlet, outlet = (1e5 * (p + 1.01325) for p in junction["p_stanet"])
    x = steady_state(21, sink["mdot_kg_per_s"][0], c, inlet, junction["tfluid_k"][0])
    assert x[20] == pytest.approx(outlet, rel=tolerance)
    mean_p = 2 / 3 * (inlet**3 - outlet**3) / (inlet**2 - outlet**2)
    v = x[21] * c.gas_constant * x[42] / (mean_p * np.pi / 4 * c.diameter**2)
    assert v == pytest.approx(pipe["v_stanet"][0], rel=5e-4)


def test_cfl_condition_names_the_cure() -> None:
    with pytest.raises(ValueError, match=r"81 nodes .* largest admissible step is 3\.\d+ s; use substeps=3"):
        gas_pipeline(nodes=81, substeps=1)
    assert gas_pipeline(nodes=81, substeps=3).numerics.max_dt >= 10.0
    plant = gas_pipeline()
    with pytest.raises(ValueError, match="largest admissible step"):
        plant.check_dt(30.0)
    assert plant.numerics.max_dt == courant_step(21, C, plant.x0)
    # (9) by the definition, with the slower sound at the plant's own state: the limit used is the stricter
    p, T = plant.x0[0], plant.x0[42]
    z, alpha_1, alpha_2, cp = equations.gas(p, T, C)
    rho = p / (z * C.gas_constant * T)
    a = np.sqrt(equations.wave_speed_squared(p, rho, T, alpha_1, alpha_2, cp))
    assert plant.numerics.max_dt < 7500.0 / (a + 300.0 / (rho * AREA))


def test_bad_parameters() -> None:
    with pytest.raises(ValueError, match="unknown pipeline parameters width; known: length"):
        pipeline_parameters(width=1.0)
    with pytest.raises(ValueError, match="diameter is nan"):
        pipeline_parameters(diameter=float("nan"))
    with pytest.raises(ArithmeticError, match="lower the flow or shorten the pipe"):
        steady_state(21, 1500.0, C)
    with pytest.raises(ValueError, match="no 21 stations"):
        coarse_state(np.zeros(3 * 30), 21)


def test_a_friction_factor_stands_for_the_roughness() -> None:
    """That of Colebrook and White at a flow gives the same pipe at rest, and a given one takes its share of the pressure."""
    f = float(equations.friction_factor(300.0, C))
    x = steady_state(21, 300.0, pipeline_parameters(friction=f))
    np.testing.assert_allclose(x, steady_state(21, 300.0, C), rtol=1e-9)
    plant = gas_pipeline(parameters=pipeline_parameters(friction=0.05))
    assert plant.x0[20] < x[20] - 1e6
    ahead = plant.step(0.0, plant.x0, np.array([8.4e6, 303.15, 300.0]), plant.dt)
    # at rest but for the error of the grid of 21 nodes, of fourth order: less than a sensor's sigma
    assert np.all(np.abs(ahead - plant.x0) < np.sqrt(plant.initial_cov))
    for m, expected in ((300.0, 0.02), (-1.0, np.nan)):
        with np.errstate(invalid="ignore"):
            np.testing.assert_equal(equations.friction_factor(np.float64(m), C._replace(friction=0.02)), expected)
    with pytest.raises(ValueError, match=r"friction is 1.5; expected a Darcy factor below 1"):
        pipeline_parameters(friction=1.5)


def test_a_pipe_that_cannot_carry_the_flow_names_the_largest() -> None:
    narrow = pipeline_parameters(diameter=0.5)
    with pytest.raises(
        ValueError, match=r"no steady state at 300 kg/s .* carries at most [\d.]+ kg/s; give a smaller"
    ) as raised:
        gas_pipeline(parameters=narrow)
    most = float(str(raised.value).split("at most ")[1].split()[0])
    plant = gas_pipeline(parameters=narrow, outlet_flow=0.99 * most)
    np.testing.assert_allclose(plant.input_at(50.0), [8.4e6, 303.15, 0.99 * most], rtol=1e-12)
    with pytest.raises(ValueError, match="no steady state"):
        gas_pipeline(parameters=narrow, outlet_flow=1.01 * most)
    with pytest.raises(ValueError, match="not even 1 kg/s; shorten or widen"):
        gas_pipeline(parameters=pipeline_parameters(diameter=0.01))
    with pytest.raises(ValueError, match="a flow of 0 kg/s; the model holds from 1 to 2000 kg/s"):
        gas_pipeline(outlet_flow=0.0)
