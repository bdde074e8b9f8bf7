"""What may differ from the model: rates that act within a step, effects, sizes before any reading, and names."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rounding import rounding
from scipy.integrate import quad_vec
from scipy.linalg import expm
from toy_plants import chain, changed, declared, tanks

from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.detector import ProcessHypothesis
from fusion_sfdia.detectors.kalman_banks.hypotheses import (
    EQUATION_SIZE,
    NODES,
    PARAMETER_SIZE,
    SENSOR_SIZE,
    UNNAMED,
    Hypotheses,
    phi_1,
)
from fusion_sfdia.detectors.kalman_banks.likelihood_window import averaged
from fusion_sfdia.models.two_tanks.plant import DISCHARGE, INFLOW, LEAK, SETTING
from fusion_sfdia.plant.uncertainty import Disturbance

Array = NDArray[Any]
DRIFT = Disturbance("drift", np.array([0.1, 0.0, 0.0, 0.0]), np.zeros(7), sd=2.0, time_constant=20.0)


def three() -> Hypotheses:
    """A parameter, an error of an input and a disturbance."""
    plant = declared()
    return Hypotheses(replace(plant, uncertainty=replace(plant.uncertainty, disturbances=(DRIFT,))))


def error_of_quadrature(eigenvalue: float) -> float:
    """Bound on the error of int_0^1 ds / (1 + s (l - 1)) by Gauss-Legendre quadrature with m = NODES nodes.

    64/15 M r^-2m / (1 - r^-2) where |f| <= M in the ellipse with foci -1, 1 and semi-axes that add up to r (Trefethen 2013,
    Approximation Theory and Approximation Practice, Theorem 19.3), halved for the interval 0 to 1.
    """
    r = np.linspace(1.001, (1 + np.sqrt(eigenvalue)) / abs(1 - np.sqrt(eigenvalue)) - 1e-6, 2000)
    reach = (r + 1 / r) / 2  # the pole is real: f is largest at an end of the ellipse
    largest = np.max([1 / np.abs(1 + (x + 1) / 2 * (eigenvalue - 1)) for x in (-reach, reach)], axis=0)
    return float(np.min(32 / 15 * largest * r ** (-2.0 * NODES) / (1 - r**-2)))


@pytest.mark.parametrize("eigenvalue", [0.01, 0.1, 0.5, 0.9, 0.999, 1.001, 1.5])
def test_phi_1_of_a_number_is_its_integral(eigenvalue: float) -> None:
    logarithm = np.log(eigenvalue)
    found, expected = phi_1(np.array([[eigenvalue]]))[0, 0], np.expm1(logarithm) / logarithm
    # of the inverse, relative; the numbers about 1 are rounded in each node
    assert abs(1 / found - 1 / expected) <= error_of_quadrature(eigenvalue) + rounding(1 / eigenvalue, 4 * NODES)


@pytest.mark.parametrize("stiff", [0.5, 2.0])
def test_phi_1_is_the_integral_of_the_exponential(stiff: float) -> None:
    """Of F = exp(A), int_0^1 exp(A s) ds by adaptive quadrature: A with a complex pair, slow, and fast modes to exp(-stiff)."""
    A = np.array([[-0.1, 0.4, 0.0], [-0.4, -0.1, 0.2], [0.3, 0.0, -stiff]])
    expected, error = quad_vec(lambda s: expm(A * s), 0.0, 1.0, epsabs=1e-13)
    _, vectors = np.linalg.eig(expm(A))
    of_inverse = error_of_quadrature(float(np.exp(-stiff - 0.1))) + rounding(np.exp(stiff), 30 * NODES)
    allowed = np.linalg.cond(vectors) * of_inverse  # |phi_1| <= 1, so that it differs by no more than its inverse
    np.testing.assert_allclose(phi_1(expm(A)), expected, rtol=0, atol=allowed + error)
    assert allowed < 1e-3  # the bound is worth testing


def test_phi_1_of_a_plant_that_does_not_change_is_1_and_of_one_that_forgets_within_a_step_exists() -> None:
    np.testing.assert_allclose(phi_1(np.eye(3)), np.eye(3), rtol=0, atol=rounding(1.0, 4 * NODES))
    mixed = phi_1(np.diag([0.0, 1e-9, 0.9]))
    # int_0^1 0^s ds = 0; the quadrature gives 1 over twice the harmonic number of its nodes or so, small and positive
    assert 0 < mixed[0, 0] < 0.2 and 0 < mixed[1, 1] < 0.2
    assert mixed[2, 2] == pytest.approx(-0.1 / np.log(0.9), rel=rounding(1.0, 8 * NODES))
    shift = phi_1(np.array([[0.0, 1.0], [0.0, 0.0]]))  # not diagonalisable
    assert np.all(np.isfinite(shift))


def test_an_error_of_an_equation_is_a_rate_that_acts_within_the_step() -> None:
    """Columns over their own state; that of x1 moves x0, which follows it, by half the coupling."""
    of = Hypotheses(declared())
    assert np.all(np.diagonal(of.rates) == 1.0)
    F = of.plant.step_jacobian_at(0.0, of.plant.x0, np.zeros(1), 1.0)
    phi = phi_1(F)
    np.testing.assert_allclose(of.rates * np.diagonal(phi), phi, rtol=4 * np.finfo(float).eps)
    assert of.rates[0, 1] == pytest.approx(0.03 / 0.95 / 2, rel=0.03) and not np.any(np.tril(of.rates, -1).round(12))


def test_hypotheses_are_the_augmented_states_and_the_equations() -> None:
    assert three().process == (
        ProcessHypothesis("load", "1", "parameter", 0.0),
        ProcessHypothesis("error of push", "1", "input", 0.0),
        ProcessHypothesis("drift", "1", "disturbance", 0.0),
        *(ProcessHypothesis(f"equation of x{i}", "1", "state", h.nominal) for i, h in enumerate(three().process[3:])),
    )
    assert all(np.isnan(h.nominal) for h in three().process[3:])
    of = Hypotheses(tanks())
    found = [(h.name, h.unit, h.kind, h.nominal) for h in of.process]
    assert found[:4] == [
        ("outlet_1", "m2.5/s", "parameter", INFLOW), ("outlet_2", "m2.5/s", "parameter", INFLOW),
        ("leak", "m3/s", "parameter", 0.0), ("error of inflow", "m3/s", "input", 0.0),
    ]  # fmt: skip
    assert [f[:3] for f in found[4:]] == [(f"equation of level_{i}", "m", "state") for i in (1, 2)]
    nothing = Hypotheses(chain(3))
    assert [h.name for h in nothing.process] == [f"equation of x{i}" for i in range(3)] and nothing.added == 0
    assert nothing.model is nothing.plant


def test_sizes_before_any_reading() -> None:
    of = three()
    recent = of.recent_sizes
    np.testing.assert_array_equal(recent[:7], SENSOR_SIZE * of.plant.sensor_sigma)
    np.testing.assert_array_equal(recent[7:10], PARAMETER_SIZE * np.array([0.2, 0.1, 2.0]))
    np.testing.assert_array_equal(recent[10:], EQUATION_SIZE * np.sqrt(of.plant.process_cov))
    np.testing.assert_array_equal(of.handicap, [0, 0, 0, *[UNNAMED] * 4])
    slow = of.slow_sizes(np.array([[0.0, 1.0], [4.0, 10.0]]))  # by now: over the samples since the onset
    assert slow.shape == (2, 2, 10)
    np.testing.assert_array_equal(slow[0, 0], recent[:10])
    np.testing.assert_allclose(slow[1, 1] * 10, recent[:10], rtol=4 * np.finfo(float).eps)


def test_large_faults_lose_little_of_their_evidence_by_the_sizes_that_are_expected() -> None:
    """Of one reading that is 20 sigma off at most a twentieth; of a process whose change is 3 times the usual one a tenth.

    Averaged over sizes N(0, s^2) the evidence of c^2 is c^2 b / (1 + b) - ln(1 + b), with b the expected square over that of
    the noise.
    """
    of = three()
    of_sensors = (of.recent_sizes[:7] / of.plant.sensor_sigma) ** 2
    assert np.all(averaged(np.full(7, 400.0), of_sensors) > 0.95 * 400.0)
    usual = np.array([0.2, 0.1, 2.0])
    known = (of.recent_sizes[7:10] / usual) ** 2
    assert np.all(known / (1 + known) > 0.9)


def test_a_cause_without_a_name_has_a_twentieth_of_the_odds_of_one_with_a_name() -> None:
    of = three()
    np.testing.assert_allclose(np.exp(-of.handicap / 2), [1.0] * 3 + [1 / 20] * 4, rtol=0.01)


def test_a_frozen_parameter_has_its_standard_deviation_as_size() -> None:
    of = Hypotheses(tanks())
    expected = [DISCHARGE * INFLOW, DISCHARGE * INFLOW, LEAK * INFLOW, SETTING * INFLOW]
    np.testing.assert_allclose(of.sd, expected, rtol=4 * np.finfo(float).eps)


def test_an_equation_without_noise_errs_by_a_share_of_its_state() -> None:
    plant = changed(chain(3), process_cov=np.array([0.04, 0.0, 0.01]))
    np.testing.assert_allclose(Hypotheses(plant).equation_sd, [0.2, 0.1 * plant.state_scale[1], 0.1], rtol=1e-15)
    full = np.diag([0.04, 0.09, 0.01])
    full[0, 1] = full[1, 0] = 0.01
    np.testing.assert_allclose(Hypotheses(changed(chain(3), process_cov=full)).equation_sd, [0.2, 0.3, 0.1], rtol=1e-15)


def test_effects_act_on_one_sensor_at_the_onset_or_in_each_step() -> None:
    of = three()
    F = np.random.default_rng(0).standard_normal((2, 7, 7))
    recent, slow = of.recent(F, 5), of.slow(F, np.array([[1.0, 3.0], [2.0, 4.0]]))
    np.testing.assert_array_equal(recent.readings, np.ones(5))
    assert recent.state is not None and slow.state is not None and slow.once == 0
    np.testing.assert_array_equal(recent.state[..., :3], F[..., 4:])  # F e_j of augmented states
    np.testing.assert_array_equal(recent.state[..., :4, 3:], np.broadcast_to(of.rates, (2, 4, 4)))
    assert not np.any(recent.state[..., 4:, 3:])  # errors of equations do not move augmented states
    assert recent.once == 3
    np.testing.assert_array_equal(slow.readings, [[1, 3], [2, 4]])
    np.testing.assert_array_equal(slow.state, F[..., 4:])


@pytest.mark.parametrize(("name", "leading"), [("power-network", 60), ("gas-pipeline", 70)])
def test_states_that_hardly_any_other_depends_on_come_after_the_leading_ones(name: str, leading: int) -> None:
    """A slope acts on two areas of a network, a roughness on the whole pipe."""
    of = Hypotheses(registry.plant(name))
    assert of.leading == leading and len(of.model.states) == leading + (of.added if name == "power-network" else 0)
