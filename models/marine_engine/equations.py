"""Mean-value model of a marine diesel engine: scalar equations and the compiled drivers that join them.

Kougiatsos and Reppa 2024 (K24), appendix, (27)-(49), with Kougiatsos et al. 2022 (K22), who take the model from Geertsma et
al. 2017. As printed it cannot be evaluated; each docstring names the equation and the misprint that was corrected. Symbols of
the papers:

    fuel         x(1)    kg per cylinder and cycle       p_receiver    x(3)    Pa, exhaust receiver, before the turbine
    p_cylinder   z1(2)   Pa, when the exhaust opens      T_receiver    z1(3)   K, before the turbine
    T_cylinder   z2(2)   K, when the exhaust opens       T_turbine     z2(3)   K, after the turbine
    torque       z3(2)   N m at the shaft                p_charge      x(4)    Pa, after the compressor
    T_charge     z1(4)   K, after the intercooler        T_compressor  z2(4)   K, before the intercooler

K24's text swaps the labels of z1(4) and z2(4); its equations do not. The engine's speed is not a variable: the propeller law
determines it from the torque, n = sqrt(2 pi torque / load). The argument names of an equation, without the parameters c, are
its structure. Nothing branches on a value, and everything is analytic except for a kink where the slip stops, so the equations
take floats, complex numbers, batches and intervals.
Where the model has no solution (a negative pressure) real numbers give NaN.
"""

from __future__ import annotations

from collections.abc import Callable
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.dual import dual
from fusion_sfdia.derivatives.equation import argument_names, compiled, equation

Array = NDArray[Any]

STATES = ("fuel", "p_receiver", "p_charge")
ALGEBRAIC = ("p_cylinder", "T_cylinder", "torque", "T_receiver", "T_turbine", "T_charge", "T_compressor")
LEAST_SQUARE = 1e-6  # of the nozzle function, whose slope is infinite at equal pressures; our choice
LANES = 64  # runs for which modules are evaluated at once: their operations overlap, and their boxes fit the first cache
CHORDS = 5  # steps of the chord method for the torque: to rounding, also from a quarter off in the states


class EngineParameters(NamedTuple):
    """Parameters of the equations, in SI; `parameters` makes them from a file."""

    fuel_delay: float  # s, tau_X
    receiver_delay: float  # s, tau_pd
    charge_delay: float  # s, tau_TC
    full_injection: float  # kg per cylinder and cycle at the setting 1
    fuel_nominal: float  # kg, x_nom(1)
    cylinders: float  # i_e
    revolutions_per_cycle: float  # k_e
    load: float  # W s3, c of n = sqrt(2 pi torque / c)
    speed_nominal: float  # 1/s, n_nom
    volume: float  # m3, v_1, of a cylinder when compression begins
    compression: float  # r_c, effective
    expansion_end: float  # r_eo = V_6 / V_1
    heat: float  # J/kg, eta h_L
    X_cv_nominal: float  # share of the heat at constant volume, at nominal speed
    X_cv_gradient: float
    X_ct_nominal: float  # share at constant temperature, at nominal fuel
    loss_nominal: float  # N m
    loss_gradient: float
    n_expansion: float
    n_blowdown: float
    R_air: float  # J/(kg K)
    cp_air: float  # J/(kg K)
    kappa_air: float
    R_gas: float  # J/(kg K)
    cp_gas: float  # J/(kg K)
    kappa_gas: float
    slip_nominal: float  # slip air over trapped air
    slip_temperature: float  # K, T_sl
    turbine_area: float  # m2, a_Z A_eff
    turbine_efficiency: float  # largest
    turbocharger_efficiency: float  # largest
    efficiency_curvature: float  # of both over p_charge / p_charge_nominal
    compressor_efficiency: float  # mechanical, eta_com
    p_receiver_nominal: float  # Pa
    p_charge_nominal: float  # Pa
    T_charge_nominal: float  # K
    p_ambient: float  # Pa
    p_exhaust: float  # Pa, after the turbine
    T_ambient: float  # K
    T_cooler: float  # K, T_c
    T_inlet: float  # K, T_inl
    inlet_effectiveness: float  # eps_inl


UNKNOWN = ("load", "heat", "turbine_area", "turbocharger_efficiency", "T_cooler")  # which may be given for each state
_values = attrgetter(*UNKNOWN)


@equation
def with_unknown(c: EngineParameters, theta: Any) -> EngineParameters:
    """The parameters with other values theta (5,) of those in UNKNOWN."""
    return EngineParameters(
        c.fuel_delay, c.receiver_delay, c.charge_delay, c.full_injection, c.fuel_nominal, c.cylinders,
        c.revolutions_per_cycle, theta[0], c.speed_nominal, c.volume, c.compression, c.expansion_end, theta[1],
        c.X_cv_nominal, c.X_cv_gradient, c.X_ct_nominal, c.loss_nominal, c.loss_gradient, c.n_expansion, c.n_blowdown,
        c.R_air, c.cp_air, c.kappa_air, c.R_gas, c.cp_gas, c.kappa_gas, c.slip_nominal, c.slip_temperature, theta[2],
        c.turbine_efficiency, theta[3], c.efficiency_curvature, c.compressor_efficiency, c.p_receiver_nominal,
        c.p_charge_nominal, c.T_charge_nominal, c.p_ambient, c.p_exhaust, c.T_ambient, theta[4], c.T_inlet,
        c.inlet_effectiveness,
    )  # fmt: skip


def unknown_of(c: EngineParameters) -> Array:
    """The parameters UNKNOWN (5,), read only."""
    found = np.array(_values(c))
    found.flags.writeable = False
    return found


@equation
def fuel_inflow(fuel_setting: Any, c: EngineParameters) -> Any:
    """h(1) = x_nom u / tau_X, kg/s (27). The setting u is a fraction, where the text states percent."""
    return c.full_injection / c.fuel_delay * fuel_setting


@equation
def heat_release(fuel: Any, p_charge: Any, c: EngineParameters) -> Any:
    """The share g = eta h_L x(1) / (v_1 x(4)): the heat of a cycle over p V of the trapped air, so q = g R_a z1(4) J/kg."""
    return c.heat / c.volume * fuel / p_charge


@equation
def speed_ratio(torque: Any, c: EngineParameters) -> Any:
    """The ratio n / n_nom with n = sqrt(2 pi torque / load) (below (33)), which holds for load = 2 pi torque / n^2."""
    return np.sqrt(2.0 * np.pi / c.load * torque) / c.speed_nominal


@equation
def share_at_constant_volume(n: Any, c: EngineParameters) -> Any:
    """X_cv = X_cv,nom + X_cv,grad (n - n_nom) / n_nom (below (33)); n is n / n_nom here."""
    return c.X_cv_nominal + c.X_cv_gradient * (n - 1.0)


@equation
def end_of_cycle(fuel: Any, n: Any, p_charge: Any, c: EngineParameters) -> Any:
    """T_6 / T_1 of the Seiliger cycle at n times the nominal speed.

    T_2 = T_1 r_c^(kappa-1), T_3 = T_2 + X_cv q / c_v, T_4 = T_3 + X_cp q / c_p, b = T_4 / T_3, c = exp(X_ct q / (R T_4)),
    T_6 = T_4 (b c / (r_eo r_c))^(n_exp - 1).
    """
    g = heat_release(fuel, p_charge, c)
    X_cv = share_at_constant_volume(n, c)
    X_ct = c.X_ct_nominal / c.fuel_nominal * fuel
    T_3 = c.compression ** (c.kappa_air - 1.0) + c.R_air / (c.cp_air - c.R_air) * X_cv * g
    per_X_cv = c.R_air / (c.cp_air - c.R_air) - c.R_air / c.cp_air
    T_4 = c.compression ** (c.kappa_air - 1.0) + (per_X_cv * X_cv + c.R_air / c.cp_air * (1.0 - X_ct)) * g
    stretch = T_4 / T_3 * np.exp(X_ct * g / T_4) / (c.expansion_end * c.compression)
    return T_4 * stretch ** (c.n_expansion - 1.0)


@equation
def cylinder_pressure(fuel: Any, torque: Any, p_charge: Any, c: EngineParameters) -> Any:
    """p_6 = p_1 (T_6 / T_1) / r_eo, Pa: K24 (31), K22 (7), in closed form.

    Printed exp(-(n-1) q_45 / (R T_4)): the sign is +, as p_6 = p_4 (r_eo r_c / b)^-n c^(n-1). K24 has stray c_v x(4), too.
    """
    return p_charge * end_of_cycle(fuel, speed_ratio(torque, c), p_charge, c) / c.expansion_end


@equation
def cylinder_temperature(fuel: Any, torque: Any, p_charge: Any, T_charge: Any, c: EngineParameters) -> Any:
    """T_6 = T_4 (r_eo r_c / (b c))^(1-n), K: K24 (32), K22 (8), derived by us since neither is legible."""
    return T_charge * end_of_cycle(fuel, speed_ratio(torque, c), p_charge, c)


@equation
def shaft_torque(fuel: Any, T_cylinder: Any, torque: Any, p_charge: Any, T_charge: Any, c: EngineParameters) -> Any:
    """Work of the cycle over its angle, less the losses, N m: K24 (33), K22 (9).

    The work over p_1 V_1, process by process, is

        -(r^(k-1) - 1)/(k-1) + X_cp (R/c_p) g + X_ct g + [r^(k-1) + g R (X_cv/c_v + X_cp/c_p) - T_6/T_1]/(n-1),

    here collected in g, X_cv and X_ct with X_cp = 1 - X_cv - X_ct. Printed are compression and expansion with the opposite
    sign, and a factor R_a in the term of X_ct. The gradient of the losses is a number, not a torque.
    """
    g = heat_release(fuel, p_charge, c)
    n = speed_ratio(torque, c)
    X_cv = share_at_constant_volume(n, c)
    X_ct = c.X_ct_nominal / c.fuel_nominal * fuel
    m = 1.0 / (c.n_expansion - 1.0)
    at_p = c.R_air / c.cp_air * (1.0 + m)
    per_X_cv = c.R_air / (c.cp_air - c.R_air) * m - at_p
    hot = c.compression ** (c.kappa_air - 1.0)
    work = (at_p + per_X_cv * X_cv + (1.0 - at_p) * X_ct) * g - (hot - 1.0) / (c.kappa_air - 1.0)
    work = work + m * (hot - T_cylinder / T_charge)
    losses = c.loss_nominal * (1.0 + c.loss_gradient * (1.0 - n))
    return c.volume * c.cylinders / (2.0 * np.pi * c.revolutions_per_cycle) * p_charge * work - losses


@equation
def nozzle(ratio: Any, c: EngineParameters) -> Any:
    """Psi of isentropic flow through a nozzle, its square cut off where the pressure behind is no lower.

    Subcritical, as slip flow is: the pressure behind is more than half the pressure before.
    """
    k = c.kappa_air
    square = 2.0 * k / (k - 1.0) * ratio ** (2.0 / k) * (1.0 - ratio ** ((k - 1.0) / k))
    return np.sqrt(np.maximum(square, LEAST_SQUARE))


@equation
def slip_law(torque: Any, p_receiver: Any, p_charge: Any, T_charge: Any, c: EngineParameters) -> Any:
    """Slip air over trapped air: s = s_nom (n_nom / n) sqrt(T_1 / T_1nom) Psi(x(3)/x(4)) / Psi_nom.

    The papers refer to Geertsma et al. 2017. The law is the flow through the valves while both are open.
    """
    psi = nozzle(p_receiver / p_charge, c) / nozzle(c.p_receiver_nominal / c.p_charge_nominal, c)
    return c.slip_nominal * psi * np.sqrt(T_charge / c.T_charge_nominal) / speed_ratio(torque, c)


@equation
def trapped_air(p_charge: Any, T_charge: Any, c: EngineParameters) -> Any:
    """m_1 = x(4) v_1 / (R_a z1(4)), kg per cylinder and cycle."""
    return c.volume / c.R_air * p_charge / T_charge


@equation
def efficiency(largest: Any, p_charge: Any, c: EngineParameters) -> Any:
    """(43) and (47b): a + b x(4) + c x(4)^2 in the form that shows where it is largest, at the nominal pressure.

    So the turbine's hardly depends on x(4) near the nominal point; by Table II, row E(3,3), it must not depend on it at all.
    """
    return largest * (1.0 - c.efficiency_curvature * (p_charge / c.p_charge_nominal - 1.0) ** 2)


@equation
def expansion_ratio(p_receiver: Any, c: EngineParameters) -> Any:
    """Pi_tur = (p_ex / x(3))^((kappa_g - 1) / kappa_g) (42)."""
    return (c.p_exhaust / p_receiver) ** ((c.kappa_gas - 1.0) / c.kappa_gas)


@equation
def receiver_inflow_at(
    fuel: Any, torque: Any, slip: Any, T_receiver: Any, p_charge: Any, T_charge: Any, c: EngineParameters
) -> Any:
    """h(3) = sqrt(p_ex^2 + R_g T_d mdot^2 / (a_Z A_eff)^2) / tau_pd, mdot = n (i_e/k_e) ((1+s) m_1 + x(1)), Pa/s: (36).

    Printed with A_eff for its square, sqrt(R_g) on the air alone, and the slip air without the trapped air.
    """
    n = speed_ratio(torque, c) * c.speed_nominal
    flow = n * c.cylinders / c.revolutions_per_cycle * ((1.0 + slip) * trapped_air(p_charge, T_charge, c) + fuel)
    return np.sqrt(c.p_exhaust**2 + c.R_gas * T_receiver * (flow / c.turbine_area) ** 2) / c.receiver_delay


@equation
def receiver_temperature_at(
    fuel: Any, p_cylinder: Any, T_cylinder: Any, slip: Any, p_receiver: Any, p_charge: Any, T_charge: Any, c: EngineParameters
) -> Any:
    """z1(3) = (psi_2 T_sl + psi~_3 z2(2)) / (psi_2 + psi_3), K: (37)-(40), where T_s1 is T_sl.

    In (40) x(3) stands for tau_pd h(3): equal at equilibrium, and T_d does not depend on itself.
    """
    psi_3_by_psi_2 = c.cp_gas / c.cp_air * (1.0 + fuel / trapped_air(p_charge, T_charge, c)) / slip
    blown_down = T_cylinder / c.n_blowdown * (1.0 + (c.n_blowdown - 1.0) * p_receiver / p_cylinder)
    return blown_down - (blown_down - c.slip_temperature) / (1.0 + psi_3_by_psi_2)


@equation
def turbine_temperature(p_receiver: Any, T_receiver: Any, p_charge: Any, c: EngineParameters) -> Any:
    """z2(3) = psi_4 z1(3), psi_4 = 1 + eta_tur(x(4)) (Pi_tur - 1), K: (37), (41)."""
    return T_receiver * (1.0 - efficiency(c.turbine_efficiency, p_charge, c) * (1.0 - expansion_ratio(p_receiver, c)))


@equation
def charge_temperature(c: EngineParameters) -> Any:
    """z1(4) = T_c + eps_inl (T_inl - T_c), K: (49a), printed with a minus, as if the hot duct cooled the air."""
    return c.T_cooler + c.inlet_effectiveness * (c.T_inlet - c.T_cooler)


@equation
def gas_over_air(fuel: Any, slip: Any, p_charge: Any, T_charge: Any, c: EngineParameters) -> Any:
    """delta_f = 1 + x(1) / ((1+s) m_1) (47a), printed with the denominator 1 + s m_1."""
    return 1.0 + fuel / ((1.0 + slip) * trapped_air(p_charge, T_charge, c))


@equation
def charge_inflow_at(
    fuel: Any, slip: Any, p_receiver: Any, T_receiver: Any, p_charge: Any, T_charge: Any, c: EngineParameters
) -> Any:
    """h(4) = p_amb (1 + chi_g delta_f eta_TC r_TC (1 - Pi_tur))^(kappa/(kappa-1)) / tau_TC, Pa/s: (46), (47).

    Printed with the inverse of the exponent. r_TC = z1(3) / T_amb, chi_g = c_pg / c_pa.
    """
    delta_f = gas_over_air(fuel, slip, p_charge, T_charge, c)
    eta = efficiency(c.turbocharger_efficiency, p_charge, c)
    rise = c.cp_gas / c.cp_air * delta_f * eta * T_receiver / c.T_ambient * (1.0 - expansion_ratio(p_receiver, c))
    return c.p_ambient / c.charge_delay * (1.0 + rise) ** (c.kappa_air / (c.kappa_air - 1.0))


@equation
def compressor_temperature_at(
    fuel: Any, slip: Any, p_receiver: Any, T_receiver: Any, p_charge: Any, T_charge: Any, c: EngineParameters
) -> Any:
    """z2(4) = T_amb + chi_g delta_f eta_com (z1(3) - z2(3)), K: (49b), the turbine's power heats the air.

    Printed with a stray eta_tur and x(3), delta_f + eta_com for the product, and the difference with the opposite sign. With
    z2(3) = psi_4 z1(3) put in, as here, its structure is that of Table III.
    """
    delta_f = gas_over_air(fuel, slip, p_charge, T_charge, c)
    drop = T_receiver * efficiency(c.turbine_efficiency, p_charge, c) * (1.0 - expansion_ratio(p_receiver, c))
    return c.T_ambient + c.cp_gas / c.cp_air * c.compressor_efficiency * delta_f * drop


# The same with the slip by its law: each equation then depends on the torque and both pressures.


@equation
def receiver_inflow(
    fuel: Any, torque: Any, p_receiver: Any, T_receiver: Any, p_charge: Any, T_charge: Any, c: EngineParameters
) -> Any:
    """h(3), Pa/s (36), slip by its law."""
    slip = slip_law(torque, p_receiver, p_charge, T_charge, c)
    return receiver_inflow_at(fuel, torque, slip, T_receiver, p_charge, T_charge, c)


@equation
def receiver_temperature(
    fuel: Any, p_cylinder: Any, T_cylinder: Any, torque: Any, p_receiver: Any, p_charge: Any, T_charge: Any, c: EngineParameters
) -> Any:
    """z1(3), K (37), slip by its law."""
    slip = slip_law(torque, p_receiver, p_charge, T_charge, c)
    return receiver_temperature_at(fuel, p_cylinder, T_cylinder, slip, p_receiver, p_charge, T_charge, c)


@equation
def charge_inflow(
    fuel: Any, torque: Any, p_receiver: Any, T_receiver: Any, p_charge: Any, T_charge: Any, c: EngineParameters
) -> Any:
    """h(4), Pa/s (46), slip by its law."""
    slip = slip_law(torque, p_receiver, p_charge, T_charge, c)
    return charge_inflow_at(fuel, slip, p_receiver, T_receiver, p_charge, T_charge, c)


@equation
def compressor_temperature(
    fuel: Any, torque: Any, p_receiver: Any, T_receiver: Any, p_charge: Any, T_charge: Any, c: EngineParameters
) -> Any:
    """z2(4), K (49b), slip by its law."""
    slip = slip_law(torque, p_receiver, p_charge, T_charge, c)
    return compressor_temperature_at(fuel, slip, p_receiver, T_receiver, p_charge, T_charge, c)


# The same with the nominal slip: the equations no longer depend on the variables of the slip alone.


@equation
def receiver_inflow_constant(fuel: Any, torque: Any, T_receiver: Any, p_charge: Any, T_charge: Any, c: EngineParameters) -> Any:
    """h(3), Pa/s (36), slip nominal."""
    return receiver_inflow_at(fuel, torque, c.slip_nominal, T_receiver, p_charge, T_charge, c)


@equation
def receiver_temperature_constant(
    fuel: Any, p_cylinder: Any, T_cylinder: Any, p_receiver: Any, p_charge: Any, T_charge: Any, c: EngineParameters
) -> Any:
    """z1(3), K (37), slip nominal."""
    return receiver_temperature_at(fuel, p_cylinder, T_cylinder, c.slip_nominal, p_receiver, p_charge, T_charge, c)


@equation
def charge_inflow_constant(
    fuel: Any, p_receiver: Any, T_receiver: Any, p_charge: Any, T_charge: Any, c: EngineParameters
) -> Any:
    """h(4), Pa/s (46), slip nominal."""
    return charge_inflow_at(fuel, c.slip_nominal, p_receiver, T_receiver, p_charge, T_charge, c)


@equation
def compressor_temperature_constant(
    fuel: Any, p_receiver: Any, T_receiver: Any, p_charge: Any, T_charge: Any, c: EngineParameters
) -> Any:
    """z2(4), K (49b), slip nominal."""
    return compressor_temperature_at(fuel, c.slip_nominal, p_receiver, T_receiver, p_charge, T_charge, c)


# The same at nominal speed.


@equation
def cylinder_pressure_nominal(fuel: Any, p_charge: Any, c: EngineParameters) -> Any:
    """p_6, Pa, with X_cv at nominal speed."""
    return p_charge * end_of_cycle(fuel, 1.0, p_charge, c) / c.expansion_end


@equation
def cylinder_temperature_nominal(fuel: Any, p_charge: Any, T_charge: Any, c: EngineParameters) -> Any:
    """T_6, K, with X_cv at nominal speed."""
    return T_charge * end_of_cycle(fuel, 1.0, p_charge, c)


# Of a state the equation is h of x' = -x / tau + h, of an algebraic variable phi of z = phi.
EQUATIONS: dict[str, Callable[..., Any]] = {
    "fuel": fuel_inflow,
    "p_cylinder": cylinder_pressure,
    "T_cylinder": cylinder_temperature,
    "torque": shaft_torque,
    "p_receiver": receiver_inflow,
    "T_receiver": receiver_temperature,
    "T_turbine": turbine_temperature,
    "p_charge": charge_inflow,
    "T_charge": charge_temperature,
    "T_compressor": compressor_temperature,
}
CONSTANT_SLIP: dict[str, Callable[..., Any]] = {
    "p_receiver": receiver_inflow_constant,
    "T_receiver": receiver_temperature_constant,
    "p_charge": charge_inflow_constant,
    "T_compressor": compressor_temperature_constant,
}
NOMINAL_SPEED: dict[
    str, Callable[..., Any]
] = {  # K24 (30) and Table I, where these do not depend on the torque; in K22 (6) they do
    "p_cylinder": cylinder_pressure_nominal,
    "T_cylinder": cylinder_temperature_nominal,
}


def variables_of(function: Callable[..., Any]) -> tuple[str, ...]:
    """The variables on which an equation depends: its argument names but for the parameters."""
    return tuple(name for name in argument_names(function) if name != "c")


@equation
def swept_torque(fuel: Any, torque: Any, p_charge: Any, T_charge: Any, c: EngineParameters) -> Any:
    """The shaft_torque at the speed of the given torque, N m, also in T_6: it multiplies errors by 0.08 at full load."""
    return shaft_torque(fuel, cylinder_temperature(fuel, torque, p_charge, T_charge, c), torque, p_charge, T_charge, c)


@equation
def solved_torque(fuel: Any, p_charge: Any, T_charge: Any, c: EngineParameters) -> Any:
    """The fixed point of swept_torque: one sweep, then the chord method, which multiplies errors by 1e-3 each time.

    The number of steps is fixed, so that a derivative by the complex step settles with the value.
    """
    start = c.load * c.speed_nominal**2 / (2.0 * np.pi * c.fuel_nominal) * fuel
    torque = swept_torque(fuel, start, p_charge, T_charge, c)
    nearby = 1.001 * torque
    rise = swept_torque(fuel, nearby, p_charge, T_charge, c) - swept_torque(fuel, torque, p_charge, T_charge, c)
    slope = rise / (nearby - torque)
    for _ in range(CHORDS):
        torque = torque + (swept_torque(fuel, torque, p_charge, T_charge, c) - torque) / (1.0 - slope)
    return torque


@equation
def variables(fuel: Any, p_receiver: Any, p_charge: Any, c: EngineParameters, law: Any) -> tuple[Any, ...]:
    """The algebraic variables in the order of ALGEBRAIC, and the slip; law: whether it follows its law or is nominal."""
    return variables_at(fuel, solved_torque(fuel, p_charge, charge_temperature(c), c), p_receiver, p_charge, c, law)


@equation
def variables_at(fuel: Any, torque: Any, p_receiver: Any, p_charge: Any, c: EngineParameters, law: Any) -> tuple[Any, ...]:
    """`variables` with the torque that solved_torque gives."""
    T_charge = charge_temperature(c)
    p_cylinder = cylinder_pressure(fuel, torque, p_charge, c)
    T_cylinder = cylinder_temperature(fuel, torque, p_charge, T_charge, c)
    slip = slip_law(torque, p_receiver, p_charge, T_charge, c) if law else c.slip_nominal + 0.0 * torque
    T_receiver = receiver_temperature_at(fuel, p_cylinder, T_cylinder, slip, p_receiver, p_charge, T_charge, c)
    T_turbine = turbine_temperature(p_receiver, T_receiver, p_charge, c)
    T_compressor = compressor_temperature_at(fuel, slip, p_receiver, T_receiver, p_charge, T_charge, c)
    return p_cylinder, T_cylinder, torque, T_receiver, T_turbine, T_charge, T_compressor, slip


@equation
def inflow_of(fuel: Any, p_receiver: Any, p_charge: Any, c: EngineParameters, law: Any) -> tuple[Any, Any]:
    """h(3) and h(4) of the states, Pa/s."""
    return inflow_at(fuel, solved_torque(fuel, p_charge, charge_temperature(c), c), p_receiver, p_charge, c, law)


@equation
def inflow_at(fuel: Any, torque: Any, p_receiver: Any, p_charge: Any, c: EngineParameters, law: Any) -> tuple[Any, Any]:
    """`inflow_of` with the torque that solved_torque gives."""
    _, _, _, T_receiver, _, T_charge, _, slip = variables_at(fuel, torque, p_receiver, p_charge, c, law)
    h3 = receiver_inflow_at(fuel, torque, slip, T_receiver, p_charge, T_charge, c)
    h4 = charge_inflow_at(fuel, slip, p_receiver, T_receiver, p_charge, T_charge, c)
    return h3, h4


@compiled
def advance(states: Any, inputs: Any, theta: Any, dt: float, substeps: int, c: EngineParameters, law: bool) -> Array:
    """The exponential midpoint rule (discretise) in `substeps` of dt, for states (B, 3) with inputs (B, 1) held.

    theta: the parameters UNKNOWN of all states (1, 5) or of each one (B, 5).
    """
    result: Array = states.copy()
    tau = np.array([c.fuel_delay, c.receiver_delay, c.charge_delay])
    half, whole = -np.expm1(-dt / (2 * substeps) / tau), -np.expm1(-dt / substeps / tau)
    for b in range(states.shape[0]):
        e = with_unknown(c, theta[min(b, theta.shape[0] - 1)])
        x1, x3, x4 = states[b, 0], states[b, 1], states[b, 2]
        level_1 = c.fuel_delay * fuel_inflow(inputs[b, 0], c)
        for _ in range(substeps):
            h3, h4 = inflow_of(x1, x3, x4, e, law)
            middle_1 = x1 + half[0] * (level_1 - x1)
            middle_3, middle_4 = x3 + half[1] * (tau[1] * h3 - x3), x4 + half[2] * (tau[2] * h4 - x4)
            h3, h4 = inflow_of(middle_1, middle_3, middle_4, e, law)
            x1 = x1 + whole[0] * (level_1 - x1)
            x3, x4 = x3 + whole[1] * (tau[1] * h3 - x3), x4 + whole[2] * (tau[2] * h4 - x4)
        result[b, 0], result[b, 1], result[b, 2] = x1, x3, x4
    return result


# Derivatives are along the states and then the parameters UNKNOWN, of which the first `count` are asked: a direction each.
@equation
def unknown_along(a: int, theta: Any, c: EngineParameters) -> EngineParameters:
    """The parameters with slopes along the direction a."""
    t0, t1, t2 = 1.0 if a == 3 else 0.0, 1.0 if a == 4 else 0.0, 1.0 if a == 5 else 0.0
    t3, t4 = 1.0 if a == 6 else 0.0, 1.0 if a == 7 else 0.0
    return with_unknown(c, (dual(theta[0], t0), dual(theta[1], t1), dual(theta[2], t2), dual(theta[3], t3), dual(theta[4], t4)))


@equation
def torque_and_slopes(x: Any, theta: Any, slopes: Any, c: EngineParameters) -> Any:
    """The torque of the state x (3,); its derivatives are written to slopes (3 + count,).

    It is the fixed point of phi = swept_torque, so that they are those of phi over 1 - d phi / d torque.
    """
    own, left = with_unknown(c, theta), 1.0
    torque = solved_torque(x[0], x[2], charge_temperature(own), own)
    for a in range(-1, slopes.shape[0]):  # once in the compiled code; -1: along the torque
        e = unknown_along(a, theta, c)
        fuel, p_charge = dual(x[0], 1.0 if a == 0 else 0.0), dual(x[2], 1.0 if a == 2 else 0.0)
        phi = swept_torque(fuel, dual(torque, 1.0 if a < 0 else 0.0), p_charge, charge_temperature(e), e)
        if a < 0:
            left = 1.0 - phi.slope
        else:
            slopes[a] = phi.slope / left
    return torque


@equation
def states_along(a: int, x: Any) -> tuple[Any, Any, Any]:
    """Fuel and both pressures of the state x (3,) with slopes along the direction a."""
    of_fuel, of_receiver, of_charge = 1.0 if a == 0 else 0.0, 1.0 if a == 1 else 0.0, 1.0 if a == 2 else 0.0
    return dual(x[0], of_fuel), dual(x[1], of_receiver), dual(x[2], of_charge)


@compiled
def inflow_derivatives(x: Any, theta: Any, h: Any, J: Any, c: EngineParameters, law: bool) -> None:
    """Write h(3) and h(4) of the state x (3,), Pa/s, to h (2,), and their derivatives to J (2, 3 + count)."""
    slopes = np.empty(J.shape[1])
    torque = torque_and_slopes(x, theta, slopes, c)
    for a in range(slopes.shape[0]):
        fuel, p_receiver, p_charge = states_along(a, x)
        h3, h4 = inflow_at(fuel, dual(torque, slopes[a]), p_receiver, p_charge, unknown_along(a, theta, c), law)
        h[0], h[1], J[0, a], J[1, a] = h3.value, h4.value, h3.slope, h4.slope


@compiled
def advance_tangent(
    states: Any, inputs: Any, theta: Any, count: int, dt: float, substeps: int, c: EngineParameters, law: bool
) -> tuple[Array, Array]:
    """States (B, 3) as by `advance`, and their derivatives (B, 3, 4 + count) with respect to states, input and parameters, by
    the chain rule through the stages.
    """
    columns = 4 + count
    reached, result = np.empty((states.shape[0], 3)), np.empty((states.shape[0], 3, columns))
    tau = np.array([c.fuel_delay, c.receiver_delay, c.charge_delay])
    stages = -np.expm1(-dt / (2 * substeps) / tau), -np.expm1(-dt / substeps / tau)
    x, at, aims, h, of_h = np.empty(3), np.empty(3), np.empty(3), np.empty(2), np.empty((2, 3 + count))
    J, direct = np.zeros((3, 3)), np.zeros((3, columns))
    dx, dat, ahead = np.empty((3, columns)), np.empty((3, columns)), np.empty((3, columns))
    for b in range(states.shape[0]):
        own = theta[min(b, theta.shape[0] - 1)]
        level = fuel_inflow(dual(inputs[b, 0], 1.0), c)
        aims[0], direct[0, 3] = c.fuel_delay * level.value, c.fuel_delay * level.slope
        for i in range(3):  # elements one by one: numba takes seconds to compile the same by arrays
            x[i] = states[b, i]
            for j in range(columns):
                dx[i, j] = 1.0 if i == j else 0.0
        for _ in range(substeps):
            for i in range(3):
                at[i] = x[i]
                for j in range(columns):
                    dat[i, j] = dx[i, j]
            for share in stages:
                inflow_derivatives(at, own, h, of_h, c, law)
                for i in range(1, 3):
                    aims[i] = tau[i] * h[i - 1]
                    for a in range(3 + count):
                        if a < 3:
                            J[i, a] = tau[i] * of_h[i - 1, a]
                        else:
                            direct[i, 1 + a] = tau[i] * of_h[i - 1, a]
                for i in range(3):
                    at[i] = x[i] + share[i] * (aims[i] - x[i])
                    for j in range(columns):
                        moved = J[i, 0] * dat[0, j] + J[i, 1] * dat[1, j] + J[i, 2] * dat[2, j] + direct[i, j]
                        ahead[i, j] = dx[i, j] + share[i] * (moved - dx[i, j])
                dat, ahead = ahead, dat
            x, at, dx, dat = at, x, dat, dx
        for i in range(3):
            reached[b, i] = x[i]
            for j in range(columns):
                result[b, i, j] = dx[i, j]
    return reached, result


@compiled
def algebraic(states: Any, theta: Any, c: EngineParameters, law: bool) -> Array:
    """The algebraic variables (B, 7) of states (B, 3), in the order of ALGEBRAIC; theta as of `advance`."""
    result = np.empty((states.shape[0], 7), states.dtype)
    for b in range(states.shape[0]):
        e = with_unknown(c, theta[min(b, theta.shape[0] - 1)])
        z = variables(states[b, 0], states[b, 1], states[b, 2], e, law)
        result[b, 0], result[b, 1], result[b, 2] = z[0], z[1], z[2]
        result[b, 3], result[b, 4], result[b, 5], result[b, 6] = z[3], z[4], z[5], z[6]
    return result


@compiled
def variables_tangent(states: Any, theta: Any, count: int, c: EngineParameters, law: bool) -> tuple[Array, Array]:
    """States and algebraic variables (B, 10), and their derivatives (B, 10, 4 + count) with respect to states, input and
    parameters.
    """
    found, result = np.empty((states.shape[0], 10)), np.zeros((states.shape[0], 10, 4 + count))
    x, slopes = np.empty(3), np.empty(3 + count)
    for b in range(states.shape[0]):
        own = theta[min(b, theta.shape[0] - 1)]
        for i in range(3):
            x[i] = found[b, i] = states[b, i]
        torque = torque_and_slopes(x, own, slopes, c)
        for a in range(3 + count):
            fuel, p_receiver, p_charge = states_along(a, x)
            z = variables_at(fuel, dual(torque, slopes[a]), p_receiver, p_charge, unknown_along(a, own, c), law)
            for i in range(7):
                found[b, 3 + i], result[b, 3 + i, a if a < 3 else 1 + a] = z[i].value, z[i].slope
            if a < 3:
                result[b, a, a] = 1.0
    return found, result


@compiled
def values_at(variable: int, v: Array, found: Array, n: int, c: EngineParameters, law: bool) -> None:
    """Write the equation of a variable, by its place in (*STATES, *ALGEBRAIC), for the first n of v (11, L): these variables
    and the fuel setting of L runs.
    """
    if variable in (1, 2, 6, 9):  # the slip first, where the result will be
        for k in range(n):
            found[k] = slip_law(v[5, k], v[1, k], v[2, k], v[8, k], c) if law else c.slip_nominal
    if variable == 0:
        for k in range(n):
            found[k] = fuel_inflow(v[10, k], c)
    elif variable == 1:
        for k in range(n):
            found[k] = receiver_inflow_at(v[0, k], v[5, k], found[k], v[6, k], v[2, k], v[8, k], c)
    elif variable == 2:
        for k in range(n):
            found[k] = charge_inflow_at(v[0, k], found[k], v[1, k], v[6, k], v[2, k], v[8, k], c)
    elif variable == 3:
        for k in range(n):
            found[k] = cylinder_pressure(v[0, k], v[5, k], v[2, k], c)
    elif variable == 4:
        for k in range(n):
            found[k] = cylinder_temperature(v[0, k], v[5, k], v[2, k], v[8, k], c)
    elif variable == 5:
        for k in range(n):
            found[k] = shaft_torque(v[0, k], v[4, k], v[5, k], v[2, k], v[8, k], c)
    elif variable == 6:
        for k in range(n):
            found[k] = receiver_temperature_at(v[0, k], v[3, k], v[4, k], found[k], v[1, k], v[2, k], v[8, k], c)
    elif variable == 7:
        for k in range(n):
            found[k] = turbine_temperature(v[1, k], v[6, k], v[2, k], c)
    elif variable == 8:
        for k in range(n):
            found[k] = charge_temperature(c)
    else:
        for k in range(n):
            found[k] = compressor_temperature_at(v[0, k], found[k], v[1, k], v[6, k], v[2, k], v[8, k], c)


@compiled
def bounds_at(
    e: int, middle: Array, radius: Array, v: Array, lower: Array, upper: Array, n: int, s: Any, c: EngineParameters, law: bool
) -> None:
    """Write lower and upper bounds of an equation, by its place, over the first n of boxes (11, L): corner_bounds, compiled.

    v (11, L): to work in.
    """
    for j in range(11):
        for k in range(n):
            v[j, k] = middle[j, k] - s.signs[e, j] * radius[j, k]
    values_at(e, v, lower, n, c, law)
    for j in range(11):
        for k in range(n):
            v[j, k] = middle[j, k] + s.signs[e, j] * radius[j, k]
    values_at(e, v, upper, n, c, law)
    slack = v[0]
    for k in range(n):
        slack[k] = 0.0
    for j in range(11):
        if s.unproved[e, j] != 0.0:
            for k in range(n):
                slack[k] += s.unproved[e, j] * radius[j, k]
    for k in range(n):
        slack[k] += s.rounding * max(abs(lower[k]), abs(upper[k]))
        lower[k] -= slack[k]
        upper[k] += slack[k]


@compiled
def inside_at(e: int, k: int, middle: Array, radius: Array, s: Any, c: EngineParameters, law: bool) -> Any:
    """The same over the k-th box moved into the envelope: its lower and upper bound."""
    own, wide, v = np.empty((11, 1)), np.empty((11, 1)), np.empty((11, 1))
    lower, upper = np.empty(1), np.empty(1)
    own[10, 0], wide[10, 0] = middle[10, k], radius[10, k]
    for j in range(10):
        least, most = s.nominal[j] - s.half_width[j], s.nominal[j] + s.half_width[j]
        low = min(max(middle[j, k] - radius[j, k], least), most)
        high = min(max(middle[j, k] + radius[j, k], least), most)
        own[j, 0], wide[j, 0] = (low + high) / 2, (high - low) / 2
    bounds_at(e, own, wide, v, lower, upper, 1, s, c, law)
    return lower[0], upper[0]


@equation
def boxes(before: Array, reading: Array, u: Array, runs: Array, s: Any, middle: Array, radius: Array) -> None:
    """Write middle and radius (11, L) of the boxes of runs between two readings (B, 10), the envelope for a missing one."""
    for k in range(runs.size):
        b = runs[k]
        middle[10, k], radius[10, k] = u[b, 0], 0.0
        for j in range(10):
            y0, y1 = before[b, j], reading[b, j]
            missing = np.isnan(y0) or np.isnan(y1)
            middle[j, k] = s.nominal[j] if missing else (y0 + y1) / 2
            radius[j, k] = s.half_width[j] if missing else abs(y1 - y0) / 2 + s.bound[min(b, len(s.bound) - 1), j]


@equation
def any_asks(of: Array, runs: Array, e: int) -> bool:
    """Whether one of the runs asks for an equation."""
    for b in runs:
        if of[min(b, len(of) - 1), e]:
            return True
    return False


@compiled
def monitor(
    x: Array,
    error: Array,
    before: Array,
    reading: Array,
    u: Array,
    dt: float,
    s: Any,
    c: EngineParameters,
    law: bool,
    of: Array,
    order: Array,
) -> Any:
    """The result of monitoring.monitor, compiled, for the equations `of` (.., 10) bool; of the other variables, the envelope.

    `of`, and of s the bound (.., 10) and the gains (.., 3), are those of all runs (1, ..) or of each one (B, ..). An equation
    is evaluated for LANES runs at a time, which follow each other in `order` (B,), where one of them asks for it.
    """
    size = x.shape[0]
    ahead, bound, lower, upper = np.empty((size, 3)), np.empty((size, 3)), np.empty((size, 7)), np.empty((size, 7))
    ahead[:], bound[:] = s.nominal[:3], s.half_width[:3]
    lower[:], upper[:] = s.nominal[3:] - s.half_width[3:], s.nominal[3:] + s.half_width[3:]
    middle, radius, v = np.empty((11, LANES)), np.empty((11, LANES)), np.empty((11, LANES))
    at, m, r, low, high = np.empty(LANES), np.empty(LANES), np.empty(LANES), np.empty(LANES), np.empty(LANES)
    for first in range(0, size, LANES):
        runs = order[first : first + LANES]
        n = runs.size
        boxes(before, reading, u, runs, s, middle, radius)
        for e in range(3):
            if not any_asks(of, runs, e):
                continue
            for k in range(n):
                m[k], r[k] = middle[e, k], radius[e, k]
                middle[e, k] = x[runs[k], e]
            values_at(e, middle, at, n, c, law)
            for k in range(n):  # contains the truth and the estimate
                least, most = min(m[k] - r[k], middle[e, k]), max(m[k] + r[k], middle[e, k])
                middle[e, k], radius[e, k] = (least + most) / 2, (most - least) / 2
            bounds_at(e, middle, radius, v, low, high, n, s, c, law)
            for k in range(n):
                b, h, least, most = runs[k], at[k], low[k], high[k]
                if not of[min(b, len(of) - 1), e]:
                    continue
                if not np.isfinite(h + least + most):
                    least, most = inside_at(e, k, middle, radius, s, c, law)
                    h = (least + most) / 2
                known = not np.isnan(before[b, e])
                noise, gain = s.bound[min(b, len(s.bound) - 1), e], s.gains[min(b, len(s.gains) - 1), e] if known else 0.0
                rate = s.rates[e]
                a = rate + gain
                lam = np.exp(-a * dt)
                held = (1 - lam) / a if a > 0 else dt
                ahead[b, e] = lam * x[b, e] + held * (h + gain * (before[b, e] if known else 0.0))
                speed = max(abs(most - rate * x[b, e]), abs(least - rate * x[b, e])) + rate * error[b, e]
                moved = min(gain * held * s.drift[e] * dt, gain * (dt - held) / a * speed if a > 0 else 0.0)
                grown = lam * error[b, e] + held * (max(most - h, h - least) + gain * noise) + moved
                bound[b, e] = min(grown, abs(ahead[b, e] - s.nominal[e]) + s.half_width[e])
            for k in range(n):
                middle[e, k], radius[e, k] = m[k], r[k]
        boxes(reading, reading, u, runs, s, middle, radius)
        for e in range(3, 10):
            if not any_asks(of, runs, e):
                continue
            bounds_at(e, middle, radius, v, low, high, n, s, c, law)
            for k in range(n):
                if not of[min(runs[k], len(of) - 1), e]:
                    continue
                if not np.isfinite(low[k] + high[k]):
                    low[k], high[k] = inside_at(e, k, middle, radius, s, c, law)
                lower[runs[k], e - 3], upper[runs[k], e - 3] = low[k], high[k]
    return ahead, bound, lower, upper
