"""The engine's corrected equations against the laws behind them: the gas law, work, mass, energy, and the paper's tables."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad

from fusion_sfdia.models.marine_engine import equations
from fusion_sfdia.models.marine_engine.equations import CONSTANT_SLIP, EQUATIONS, NOMINAL_SPEED, variables_of
from fusion_sfdia.models.marine_engine.equilibrium import engine_variables, equilibrium
from fusion_sfdia.models.marine_engine.modules import MODULES
from fusion_sfdia.models.marine_engine.parameters import engine_parameters
from fusion_sfdia.models.marine_engine.plant import SENSORS

Array = NDArray[Any]

C = engine_parameters()
CV = C.cp_air - C.R_air
POINTS = [engine_variables(equilibrium(u, C), C) for u in (1.0, 0.7, 0.3)]
every_point = pytest.mark.parametrize("z", POINTS, ids=["1.0", "0.7", "0.3"])
ROUNDING = 1e-12  # a few thousand roundings: powers of numbers of order ten


class Corner(NamedTuple):
    p: float
    V: float
    T: float


def air(z: Any) -> float:
    """Air trapped in a cylinder, by the gas law."""
    return float(z["p_charge"] * C.volume / (C.R_air * z["T_charge"]))


def slip(z: Any) -> float:
    return float(equations.slip_law(z["torque"], z["p_receiver"], z["p_charge"], z["T_charge"], C))


def corners(z: Any) -> list[Corner]:
    """The corners of the Seiliger cycle, each from the one before by the first law or its polytrope, p from p V = m R T."""
    m = air(z)
    heat = z["fuel"] * C.heat / m  # J/kg
    X_cv = C.X_cv_nominal + C.X_cv_gradient * (z["speed"] / C.speed_nominal - 1)
    X_ct = C.X_ct_nominal * z["fuel"] / C.fuel_nominal
    X_cp = 1 - X_cv - X_ct
    T1, V1 = float(z["T_charge"]), C.volume
    V2 = V1 / C.compression
    T2 = T1 * C.compression ** (C.kappa_air - 1)
    T3 = T2 + X_cv * heat / CV
    T4 = T3 + X_cp * heat / C.cp_air
    V4 = V2 * T4 / T3
    V5 = V4 * np.exp(X_ct * heat / (C.R_air * T4))
    V6 = C.expansion_end * V1
    T6 = T4 * (V5 / V6) ** (C.n_expansion - 1)
    return [Corner(m * C.R_air * T / V, V, T) for V, T in ((V1, T1), (V2, T2), (V2, T3), (V4, T4), (V5, T4), (V6, T6))]


@every_point
def test_the_gas_at_the_end_of_the_cycle(z: Any) -> None:
    # (31), (32); printed, the pressure is half as large
    end = corners(z)[-1]
    assert z["p_cylinder"] == pytest.approx(end.p, rel=ROUNDING)
    assert z["T_cylinder"] == pytest.approx(end.T, rel=ROUNDING)


def test_the_peak_pressure_is_that_of_the_file() -> None:
    assert corners(POINTS[0])[2].p == pytest.approx(206e5, rel=ROUNDING)


@pytest.mark.parametrize("gradient", [0.0, 0.3])
@every_point
def test_torque_is_the_area_of_the_indicator_diagram(z: Any, gradient: float) -> None:
    # (33): integral of p dV, by quadrature along each process; printed, it is more than two hundred times as large
    exponents = (C.kappa_air, None, 0.0, 1.0, C.n_expansion)  # of p V^n = constant; None: at constant volume
    work = 0.0
    for (a, b), n in zip(pairwise(corners(z)), exponents, strict=True):
        if n is not None:
            work += quad(lambda V, a=a, n=n: a.p * (a.V / V) ** n, a.V, b.V, epsrel=1e-12)[0]
    losses = C.loss_nominal * (1 + gradient * (C.speed_nominal - z["speed"]) / C.speed_nominal)
    torque = work * C.cylinders / (2 * np.pi * C.revolutions_per_cycle) - losses
    found = equations.shaft_torque(
        *(z[v] for v in ("fuel", "T_cylinder", "torque", "p_charge", "T_charge")), C._replace(loss_gradient=gradient)
    )
    assert found == pytest.approx(torque, rel=1e-9)  # compression and expansion cancel to a third: 1e-12 a quadrature


@every_point
def test_the_propeller_takes_the_power_of_the_shaft(z: Any) -> None:
    assert 2 * np.pi * z["speed"] * z["torque"] == pytest.approx(C.load * z["speed"] ** 3, rel=ROUNDING)
    assert equations.speed_ratio(z["torque"], C) * C.speed_nominal == pytest.approx(z["speed"], rel=ROUNDING)


def test_full_load_gives_the_rated_power_for_the_rated_consumption() -> None:
    z = POINTS[0]
    assert z["power"] == pytest.approx(5.4e6, rel=ROUNDING)
    flow = z["fuel"] * C.cylinders / C.revolutions_per_cycle * z["speed"]  # (27), (28)
    assert flow * 3600 / 5400 == pytest.approx(0.189, rel=ROUNDING)  # kg/kWh
    assert equations.fuel_inflow(1.0, C) * C.fuel_delay == pytest.approx(z["fuel"], rel=ROUNDING)
    assert C.fuel_delay == pytest.approx(1 / (4 * 1000 / 60), rel=ROUNDING)


@every_point
def test_mixing_in_the_receiver_conserves_enthalpy(z: Any) -> None:
    # (37)-(40); what blows down does work against p_d: u_6 + p_d v_6 = h, so T = T_6/n + (n-1)/n (p_d / p_6) T_6
    m = air(z)
    blown = z["T_cylinder"] / C.n_blowdown + (1 - 1 / C.n_blowdown) * z["p_receiver"] / z["p_cylinder"] * z["T_cylinder"]
    gas, fresh = C.cp_gas * (m + z["fuel"]), C.cp_air * slip(z) * m
    assert (gas + fresh) * z["T_receiver"] == pytest.approx(gas * blown + fresh * C.slip_temperature, rel=ROUNDING)
    assert C.slip_temperature < z["T_receiver"] < z["T_cylinder"]


@every_point
def test_all_that_enters_the_cylinders_leaves_through_the_turbine(z: Any) -> None:
    # (36): a turbine of area A passes mdot = A sqrt((p^2 - p_ex^2) / (R T)); printed, the pressure is 1.001 bar
    through = C.turbine_area * np.sqrt((z["p_receiver"] ** 2 - C.p_exhaust**2) / (C.R_gas * z["T_receiver"]))
    into = z["speed"] * C.cylinders / C.revolutions_per_cycle * ((1 + slip(z)) * air(z) + z["fuel"])
    assert through == pytest.approx(into, rel=1e-9)  # the equilibrium's 1e-12, magnified where the pressures are nearly equal


def test_a_turbine_without_losses_is_isentropic() -> None:
    ideal = C._replace(turbine_efficiency=1.0)
    after = equations.turbine_temperature(3e5, 800.0, C.p_charge_nominal, ideal)
    assert after == pytest.approx(800.0 * (C.p_exhaust / 3e5) ** (1 - 1 / C.kappa_gas), rel=ROUNDING)  # (41), (42)


@every_point
def test_the_turbine_drives_the_compressor(z: Any) -> None:
    # (46), (47), (49b) as a balance of power in W; printed, 1.13 bar and -1.5e8 K
    per_second = z["speed"] * C.cylinders / C.revolutions_per_cycle
    m_air = per_second * (1 + slip(z)) * air(z)
    m_gas = m_air + per_second * z["fuel"]
    isentropic = C.T_ambient * (z["p_charge"] / C.p_ambient) ** (1 - 1 / C.kappa_air)
    eta = C.turbocharger_efficiency * (1 - 0.25 * (z["p_charge"] / C.p_charge_nominal - 1) ** 2)
    available = C.cp_gas * m_gas * z["T_receiver"] * (1 - (C.p_exhaust / z["p_receiver"]) ** (1 - 1 / C.kappa_gas))
    assert C.cp_air * m_air * (isentropic - C.T_ambient) == pytest.approx(eta * available, rel=1e-9)
    given = C.compressor_efficiency * C.cp_gas * m_gas * (z["T_receiver"] - z["T_turbine"])
    assert C.cp_air * m_air * (z["T_compressor"] - C.T_ambient) == pytest.approx(given, rel=ROUNDING)
    assert C.p_ambient < z["p_charge"] and isentropic < z["T_compressor"]


def test_the_inlet_duct_warms_the_air() -> None:
    # (49a); printed 318 K, colder than either the cooler or the duct
    assert equations.charge_temperature(C) == pytest.approx(328.0, rel=ROUNDING)
    assert C.T_cooler < equations.charge_temperature(C) < C.T_inlet


def test_the_slip_is_a_nozzle_flow_that_stops_where_pressures_meet() -> None:
    ratio = np.linspace(0.55, 0.999, 50)
    k = C.kappa_air
    exact = np.sqrt(2 * k / (k - 1) * (ratio ** (2 / k) - ratio ** ((k + 1) / k)))
    ours = equations.nozzle(ratio, C)
    np.testing.assert_allclose(ours, exact, rtol=ROUNDING)
    beyond = equations.nozzle(np.array([1.0, 1.05, 1.2, 2.0]), C)
    np.testing.assert_array_equal(beyond, np.sqrt(equations.LEAST_SQUARE))
    slope = equations.nozzle(np.array([0.9, 1.0, 1.1]) + 1e-30j, C).imag / 1e-30
    assert slope[0] < 0 and np.all(slope[1:] == 0)
    full = POINTS[0]
    assert slip(full) == pytest.approx(0.08, rel=ROUNDING)


def rows(table: dict[str, Any]) -> dict[str, set[str]]:
    """Of each module the variables on which its test depends, with its own: its row of the signature matrix."""
    return {module: {m.variable, *variables_of(table[m.variable])} - {"fuel_setting"} for module, m in MODULES.items()}


def test_the_structure_is_that_of_tables_1_to_3() -> None:
    f = {name: variable for name, variable in zip([s[1:] for s in SENSORS], SENSORS.values(), strict=True)}
    published = {  # K24, Tables I to III: the columns that are not 0
        "M(2,1)": "(2){1} (1){1} (4){1}",
        "M(2,2)": "(2){2} (1){1} (4){1} (4){2}",
        "M(2,3)": "(2){2} (2){3} (1){1} (4){1} (4){2}",
        "M(3,1)": "(3){1} (3){2} (1){1} (2){3} (4){1} (4){2}",
        "M(3,2)": "(3){1} (3){2} (1){1} (2){1} (2){2} (2){3} (4){1} (4){2}",
        "M(3,3)": "(3){1} (3){2} (3){3}",
        "M(4,1)": "(4){1} (4){2} (1){1} (2){3} (3){1} (3){2}",
        "M(4,2)": "(4){2}",
        "M(4,3)": "(4){1} (4){2} (4){3} (1){1} (2){3} (3){1} (3){2}",
    }
    ours = rows(EQUATIONS | NOMINAL_SPEED)
    for module, row in published.items():
        expected = {f[name] for name in row.split()}
        if module == "M(3,3)":  # (43) has the turbine's efficiency follow x(4), Table II does not: it peaks at full load
            expected |= {"p_charge"}
        assert ours[module] == expected, module
    peak = equations.turbine_temperature(3.95e5, 840.0, C.p_charge_nominal + 1e-20j, C)
    assert peak.imag == 0.0
    assert ours["M(1,1)"] == {"fuel"}


def test_options_change_the_structure_as_stated() -> None:
    full, constant = rows(EQUATIONS), rows(EQUATIONS | CONSTANT_SLIP)
    assert full["M(2,1)"] - rows(EQUATIONS | NOMINAL_SPEED)["M(2,1)"] == {"torque"}  # K22 (6)
    assert full["M(3,2)"] - constant["M(3,2)"] == {"torque"}
    assert full["M(4,1)"] - constant["M(4,1)"] == {"torque"}
    assert full["M(4,3)"] - constant["M(4,3)"] == {"torque"}
    assert full["M(3,1)"] == constant["M(3,1)"]
    assert variables_of(CONSTANT_SLIP["p_receiver"]) == ("fuel", "torque", "T_receiver", "p_charge", "T_charge")


@pytest.mark.parametrize("name", [*NOMINAL_SPEED, *CONSTANT_SLIP])
def test_options_agree_at_full_load(name: str) -> None:
    z = POINTS[0]
    option = (NOMINAL_SPEED | CONSTANT_SLIP)[name]
    values = [f(*(z[a] for a in variables_of(f)), C) for f in (option, EQUATIONS[name])]
    assert values[0] == pytest.approx(values[1], rel=ROUNDING)
