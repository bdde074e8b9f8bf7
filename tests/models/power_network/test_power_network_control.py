"""Generation control and predictive control of the network."""

from __future__ import annotations

import numpy as np
import pytest
from network_loop import LOADS, MODEL, closed_loop

from fusion_sfdia.models.power_network.control import BY_ANGLE, BY_SPEED, PredictiveControl, generation_control
from fusion_sfdia.models.power_network.model import NetworkModel, network_model
from fusion_sfdia.models.power_network.operation import load_profile
from fusion_sfdia.models.power_network.parameters import LoadStep, generate_network

RNG = np.random.default_rng(5)
X = 0.1 * RNG.standard_normal((15, 4))
LOAD, REFERENCE = 0.2 * RNG.standard_normal((2, 15))


def spectral_radius(model: NetworkModel) -> float:
    f, by_reference, _ = model.matrices
    n = len(model.names)
    gain = np.zeros((n, 4 * n))
    gain[np.arange(n), 4 * np.arange(n)], gain[np.arange(n), 4 * np.arange(n) + 1] = -BY_ANGLE, -BY_SPEED
    return float(np.abs(np.linalg.eigvals(f + by_reference @ gain)).max())


def test_generation_control_is_stable() -> None:
    # without it the common angle is an integrator
    assert np.abs(np.linalg.eigvals(MODEL.matrices[0])).max() == pytest.approx(1.0, abs=1e-9)
    assert spectral_radius(MODEL) == pytest.approx(0.9624, abs=5e-5)
    assert spectral_radius(network_model(discretisation="exact")) == pytest.approx(0.9557, abs=5e-5)
    assert spectral_radius(network_model(unplugged=["4"])) < 1
    for seed in range(10):
        assert spectral_radius(network_model(generate_network(15, seed))) < 1
    assert spectral_radius(network_model(generate_network(60, 0))) < 1


def test_references_stay_within_their_limits() -> None:
    limit = MODEL.parameters.reference_limit
    heavy = load_profile(MODEL, [LoadStep(1.0, "4", 2.0), LoadStep(1.0, "9", -2.0)])
    moments = closed_loop(generation_control, 20, loads=heavy)
    references = np.abs([m.reference for m in moments])
    assert np.all(references <= limit) and references[-1, 0, 3] == limit[3]


def test_predictive_control_keeps_the_limits_and_balances_the_loads() -> None:
    pytest.importorskip("osqp", reason="the predictive controller needs osqp")
    control = PredictiveControl()
    x = np.zeros((1, 15, 4))
    model, largest = MODEL, 0.0
    for k in range(150):  # readings without noise, so the angles' limits can be kept
        reference = control(model, x, LOADS(float(k)))
        assert np.all(np.abs(reference) <= model.parameters.reference_limit)
        x = model.step(x, reference, LOADS(float(k)))
        largest = max(largest, float(np.abs(x[..., 0]).max()))
    assert largest < 0.1
    assert x[0, :, 2] == pytest.approx(LOADS(150.0), abs=1e-3)
    # an angle beyond its limit comes back to it, at a cost above that of the reference
    x = np.zeros((1, 15, 4))
    x[0, 3, 0] = 0.2
    assert control(model, x, np.zeros(15))[0, 3] < 0


def test_predictive_control_is_set_up_again_where_the_model_changed() -> None:
    pytest.importorskip("osqp", reason="the predictive controller needs osqp")
    control = PredictiveControl()
    control(MODEL, X, LOAD)
    before = dict(control._problems)
    control(MODEL.switched(unplug=["4"]), X, LOAD)
    assert {name for name in before if control._problems[name] is not before[name]} == {"3", "4", "5", "13"}
    with pytest.raises(ValueError, match="horizon is 0"):
        PredictiveControl(horizon=0)


def test_predictive_control_reports_what_it_could_not_solve() -> None:
    pytest.importorskip("osqp", reason="the predictive controller needs osqp")
    with pytest.raises((ArithmeticError, ValueError)):
        PredictiveControl()(MODEL, np.full((15, 4), np.nan), LOAD)
