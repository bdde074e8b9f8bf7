"""The pipeline's equations against the conservation laws, the printed matrix, and closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rounding import rounding, rounding_of_solution
from scipy.optimize import brentq

from fusion_sfdia.derivatives.equation import COMPLEX_STEP, complex_step_jacobian
from fusion_sfdia.models.gas_pipeline import equations
from fusion_sfdia.models.gas_pipeline.natural_gas import PRESSURES, TEMPERATURES
from fusion_sfdia.models.gas_pipeline.physics import STENCIL, pipeline_parameters, pipeline_physics, steady_state

Array = NDArray[Any]

C = pipeline_parameters()
AREA = np.pi / 4 * C.diameter**2
NO_ALGEBRAIC = np.zeros(0)
RNG = np.random.default_rng(2)
STATES = [
    (RNG.uniform(*PRESSURES), RNG.uniform(20.0, 900.0), RNG.uniform(*TEMPERATURES), *(RNG.normal(size=3) * [1.0, 1e-2, 1e-3]))
    for _ in range(20)
]  # p, m, T, and gradients of the size they have in a transient


def density(p: Any, T: Any) -> Any:
    return p / (equations.gas(p, T, C)[0] * C.gas_constant * T)


def printed_matrix(p: float, m: float, T: float) -> tuple[Array, float, float]:
    """A of Shaheen 2024 (6) as printed, v and a_s."""
    z, a1, a2, cp = equations.gas(p, T, C)
    R, A = C.gas_constant, AREA
    rho = density(p, T)
    s2 = equations.wave_speed_squared(p, rho, T, a1, a2, cp)
    matrix = np.array(
        [
            [-m * (s2 * a2 - R * T * z) / (A * p), s2 / A, s2 * m * a1 / (A * T)],
            [
                -(s2 * a2**2 * cp * m**2 - R * s2 * a2**2 * a2 * m**2 * z) / (A * cp * p**2),
                m * (a2 * cp * s2 - R * z * s2 * a1**2 + R * T * cp * z) / (A * cp * p),
                s2 * a1 * m**2 * (a2 * cp - R * a1**2 * z) / (A * T * cp * p),
            ],
            [
                -R * T * s2 * a1 * a2 * m * z / (A * cp * p**2),
                R * T * s2 * a1 * z / (A * cp * p),
                R * m * z * (s2 * a1**2 + T * cp) / (A * cp * p),
            ],
        ]
    )
    return matrix, m / (rho * A), float(np.sqrt(s2))


def gradient_matrix(p: float, m: float, T: float) -> Array:
    """A of (5), read off the rates."""
    zero = np.zeros(3)
    return -complex_step_jacobian(
        lambda g: np.stack(
            equations.rates(p, m, T, g[..., 0], g[..., 1], g[..., 2], equations.friction_factor(m, C), C)[:3], axis=-1
        ),
        zero,
    )


@pytest.mark.parametrize(("p", "m", "T", "p_s", "m_s", "T_s"), STATES)
def test_conservation_laws(p: float, m: float, T: float, p_s: float, m_s: float, T_s: float) -> None:
    """(1)-(4) written out with rho(p, T) and h(p, T), all derivatives by the complex step, solved for the three rates."""
    h = COMPLEX_STEP
    rho, rho_p, rho_T = density(p, T), density(p + 1j * h, T).imag / h, density(p, T + 1j * h).imag / h
    h_T = equations.gas(p, T, C)[3]
    h_p = (T / rho * rho_T + 1) / rho
    v = m / (rho * AREA)
    w = equations.friction_factor(m, C) / 8 * rho * v * abs(v) * np.pi * C.diameter
    q = -np.pi * C.diameter * C.heat_transfer * (T - C.ambient)
    v_of = np.array([-v * rho_p / rho, 1 / (rho * AREA), -v * rho_T / rho])  # dv = v_of . (dp, dm, dT)
    gradient = np.array([p_s, m_s, T_s])
    matrix = np.array([[rho_p, 0.0, rho_T], rho * v_of, [rho * h_p - 1, 0.0, rho * h_T]])
    right = -np.array(
        [
            m_s / AREA,
            p_s + rho * v * v_of @ gradient + w / AREA,
            rho * v * (h_p * p_s + h_T * T_s) - v * p_s - (q + w * v) / AREA,
        ]
    )
    scale = np.abs(matrix).max(axis=0)
    expected = np.linalg.solve(matrix / scale, right) / scale
    # rates of a thousandth of their terms are left where these cancel; an entry is a product of some twenty factors and sums
    h_p_terms = (abs(T / rho * rho_T) + 1) / rho
    terms, size = np.abs(matrix), np.abs(gradient)
    terms[2, 0] = rho * h_p_terms + 1
    right_terms = np.array(
        [
            abs(m_s) / AREA,
            abs(p_s) + rho * v * np.abs(v_of) @ size + w / AREA,
            rho * v * (h_p_terms * abs(p_s) + h_T * abs(T_s)) + v * abs(p_s) + (abs(q) + w * v) / AREA,
        ]
    )
    allowed = rounding_of_solution(matrix, terms, expected, right_terms, operations=20)
    found = np.array(equations.rates(p, m, T, p_s, m_s, T_s, equations.friction_factor(m, C), C)[:3])
    assert np.all(np.abs(found - expected) <= allowed), (found - expected, allowed)


@pytest.mark.parametrize(("p", "m", "T"), [s[:3] for s in STATES])
def test_matrix_of_the_paper_but_for_one_entry(p: float, m: float, T: float) -> None:
    printed, v, a = printed_matrix(p, m, T)
    ours = gradient_matrix(p, m, T)
    z, _, alpha_2, _ = equations.gas(p, T, C)
    expected = printed.copy()
    expected[1, 0] = AREA - m**2 * alpha_2 * C.gas_constant * T * z / (AREA * p**2)
    # products of some twenty factors; three entries are differences, of terms that much larger than they are
    _, a1, _, cp = equations.gas(p, T, C)
    R = C.gas_constant
    cancel = np.ones((3, 3))
    cancel[0, 0] = (a**2 * alpha_2 + R * T * z) / abs(a**2 * alpha_2 - R * T * z)
    heat, wave, gas = alpha_2 * cp * a**2, R * z * a**2 * a1**2, R * T * cp * z
    cancel[1, 1] = (heat + wave + gas) / abs(heat - wave + gas)
    cancel[1, 2] = (alpha_2 * cp + R * a1**2 * z) / abs(alpha_2 * cp - R * a1**2 * z)
    assert np.all(np.abs(ours - expected) <= rounding(1, 20) * cancel * np.abs(expected))
    scale = np.array([1e6, 1e3, 1e2])
    np.testing.assert_allclose(
        np.sort(np.linalg.eigvals(ours * scale / scale[:, None]).real), [v - a, v, v + a], rtol=1e-9, atol=1e-9 * a
    )
    # as printed it is not hyperbolic, by far more than rounding (1e-16 of the condition, 1e4)
    assert np.abs(np.linalg.eigvals(printed * scale / scale[:, None]).imag).max() > 1e-3 * a


@pytest.mark.parametrize(("p", "m", "T", "p_s", "m_s", "T_s"), STATES[:5])
def test_boundaries_keep_the_waves_that_leave(p: float, m: float, T: float, p_s: float, m_s: float, T_s: float) -> None:
    """What the boundary adds to the rates is invisible to the left eigenvectors of the outgoing characteristics."""
    scale = np.array([1e6, 1e3, 1e2])
    values, left = np.linalg.eig((gradient_matrix(p, m, T) * scale / scale[:, None]).T)
    backward, still, forward = left[:, np.argsort(values.real)].T.real
    local = equations.rates(p, m, T, p_s, m_s, T_s, equations.friction_factor(m, C), C)
    inner = np.array(local[:3]) / scale
    inlet = np.array(equations.inlet_rates(p, T, local, 1e3, 0.1, C)) / scale
    outlet = np.array(equations.outlet_rates(p, T, local, 5.0, C)) / scale
    size = 1e-9 * max(np.abs(inner).max(), np.abs(inlet).max(), np.abs(outlet).max())
    assert abs(backward @ (inlet - inner)) < size
    assert abs(still @ (outlet - inner)) < size
    assert abs(forward @ (outlet - inner)) < size
    np.testing.assert_allclose(inlet[[0, 2]] * scale[[0, 2]], [1e3, 0.1], rtol=1e-15)
    assert outlet[1] * scale[1] == pytest.approx(5.0, rel=1e-15)


@pytest.mark.parametrize("m", [1.0, 5.0, 50.0, 300.0, 2000.0])
@pytest.mark.parametrize("roughness", [0.0, 0.016e-3, 0.5e-3])
def test_colebrook_white(m: float, roughness: float) -> None:
    c = C._replace(roughness=roughness)
    reynolds = 4 * m / (np.pi * c.diameter * c.viscosity)

    def defect(root: float, reynolds: float = reynolds) -> float:
        return root + 2 * np.log10(roughness / (3.7 * c.diameter) + 2.51 / reynolds * root)

    root = brentq(defect, 1.0, 100.0, xtol=1e-14, rtol=1e-14)
    f = equations.friction_factor(m, c)
    assert f == pytest.approx(root**-2, rel=4e-14)  # brentq: the root to 1e-14 + 1e-14 root
    # d root / d m from the equation itself, against the complex step through its solution
    inside = roughness / (3.7 * c.diameter) + 2.51 / reynolds * root
    by_root, by_m = 1 + 2 / np.log(10) * 2.51 / reynolds / inside, -2 / np.log(10) * 2.51 / reynolds * root / m / inside
    slope = equations.friction_factor(m + 1j * COMPLEX_STEP, c).imag / COMPLEX_STEP
    assert slope == pytest.approx(-2 * root**-3 * -by_m / by_root, rel=1e-12)


def test_reversed_flow_gives_nan() -> None:
    with np.errstate(invalid="ignore", divide="ignore"):
        assert np.isnan(equations.friction_factor(np.float64(-10.0), C))


def differences(nodes: int) -> Array:
    """The matrix of (8) for one variable, at distance 1."""
    matrix = np.zeros((nodes, nodes))
    for i in range(nodes):
        first = min(max(i - 2, 0), nodes - 5)
        matrix[i, first : first + 5] = STENCIL[i - first] / 12
    return matrix


def test_differences_are_exact_for_quartics() -> None:
    s = np.arange(9.0)
    for power in range(5):
        np.testing.assert_allclose(
            differences(9) @ s**power, power * s ** max(power - 1, 0), rtol=0, atol=rounding(9.0**power, 15)
        )


@pytest.mark.parametrize("nodes", [7, 21, 40])
def test_driver_and_arrays_are_one_source(nodes: int) -> None:
    physics = pipeline_physics(nodes, C)
    rng = np.random.default_rng(3)
    x = np.array([s.nominal for s in physics.states]) * (1 + 0.01 * rng.normal(size=(4, 3 * nodes)))
    given = rng.normal(size=(4, 3)) * [100.0, 0.01, 1.0]
    by_arrays = physics.f(0.0, x, NO_ALGEBRAIC, given, C)
    lanes = np.zeros((3 * nodes, equations.LANES))
    boundary, rate, room = np.zeros((3, equations.LANES)), np.zeros_like(lanes), np.zeros(equations.ROOM * equations.LANES)
    lanes[:, :4], boundary[:, :4] = x.T, given.T
    equations.slope(4, lanes, boundary, C, STENCIL / (12 * C.length / (nodes - 1)), room, rate)
    by_driver = rate[:, :4].T
    # sums of five terms in another order: x differs by 1 % from node to node, so differences are of a hundredth of their terms
    size = np.abs(by_arrays).reshape(4, 3, nodes).max(axis=(0, 2)).repeat(nodes)
    np.testing.assert_allclose(by_driver / size, by_arrays / size, rtol=0, atol=rounding(100, 50))


def plain(nodes: int, x: Array) -> Array:
    """dx/dt (..., 3 nodes) with one-sided differences, and no more, at the boundary."""
    matrix = differences(nodes).T * (nodes - 1) / C.length
    p, m, T = (x[..., v * nodes : (v + 1) * nodes] for v in range(3))
    return np.concatenate(
        equations.rates(p, m, T, p @ matrix, m @ matrix, T @ matrix, equations.friction_factor(m, C), C)[:3], axis=-1
    )


def eigenvalues(nodes: int, characteristic: bool) -> Array:
    """Of the semi-discrete equations at the steady state, without the three values that are given."""
    physics = pipeline_physics(nodes, C)
    x = np.array([s.nominal for s in physics.states])
    rest = np.zeros(3)
    jacobian = complex_step_jacobian(
        lambda s: physics.f(0.0, s, NO_ALGEBRAIC, rest, C) if characteristic else plain(nodes, s), x
    )
    keep = np.setdiff1d(np.arange(3 * nodes), [0, 2 * nodes, 2 * nodes - 1])
    scale = np.repeat([1e5, 1e2, 1e1], nodes)[keep]
    values: Array = np.linalg.eigvals(jacobian[np.ix_(keep, keep)] * scale / scale[:, None])
    return values


@pytest.mark.parametrize("nodes", [21, 41, 81])
def test_boundaries_are_stable(nodes: int) -> None:
    values = eigenvalues(nodes, characteristic=True)
    assert values.real.max() < 0
    # times the step of (9), ds/(a + v) with a + v > 400 m/s: RK4 reaches 2.8 along the imaginary axis
    assert np.abs(values).max() * C.length / (nodes - 1) / 400.0 < 2.0


def test_plain_boundaries_are_not() -> None:
    """Why the boundaries are characteristic: an 81-node grid without them grows by a factor e in 150 s."""
    assert eigenvalues(41, characteristic=False).real.max() < 0
    assert eigenvalues(81, characteristic=False).real.max() > 0.005


def test_steady_state_holds_still() -> None:
    """The profile by an ODE solver is a steady state of the semi-discrete equations to their order, ds^4."""
    worst = []
    for nodes in (21, 41, 81):
        physics = pipeline_physics(nodes, C)
        x = steady_state(nodes, 300.0, C)
        worst.append(np.abs(physics.f(0.0, x, NO_ALGEBRAIC, np.zeros(3), C)).reshape(3, nodes).max(axis=1))
    orders = np.log2(np.array(worst)[:-1] / np.array(worst)[1:])
    assert np.all(orders > 3.5)
