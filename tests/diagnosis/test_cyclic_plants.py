"""Detectors on a plant with compasses: the same decisions as on readings and a model that count the turns."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from turning_car import TURN, car, turning, within_a_turn

from fusion_sfdia import diagnose
from fusion_sfdia.common.errors import NotApplicableError
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.detectors.kalman_banks.particle_filter import ParticleFilter
from fusion_sfdia.diagnosis.hindsight import hindsight
from fusion_sfdia.filters.estimators import Ensemble, Unscented
from fusion_sfdia.learning.checks.plants import check_plant
from fusion_sfdia.plant.gaps import bridged

MODELS = ("turns counted", "modulo in the output", "modulo in the step")
NAMED = ("loo-glr", "loo-chi2", "robust-glr", "kf-chi2", "mhe-l1", "chebyshev", "adaptive-threshold", "fusing-ukf")


def built(name: str, plant):  # type: ignore[no-untyped-def]
    special = {
        "particle": lambda p: ParticleFilter(p, size=300),
        "unscented": lambda p: CentralFilter(p, Unscented()),
        "ensemble": lambda p: CentralFilter(p, Ensemble()),
    }
    return special[name](plant) if name in special else registry.detector(name, plant)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("name", [*NAMED, "particle", "unscented", "ensemble"])
def test_decisions_are_those_of_readings_with_the_turns_counted(name: str, model: str) -> None:
    log = turning(seed=7)
    log.y[60:, 0] += 25.0
    expected = built(name, car(period=None)), built(name, car(model))
    reference, detector = (replace(d, thresholds=(5.0,) * 4) if name == "fusing-ukf" else d for d in expected)
    found = []
    for one, readings in ((reference, log), (detector, within_a_turn(log))):
        state = one.init((), 0.0, seed=3)
        decisions = []
        for t, y, u in zip(*readings, strict=True):
            state, decision = one.step(state, float(t), y, u)
            decisions.append(decision)
        found.append(decisions)
    for k, (a, b) in enumerate(zip(*found, strict=True)):
        np.testing.assert_array_equal(a.isolated, b.isolated, err_msg=f"sample {k}")
        np.testing.assert_allclose(a.residual, b.residual, rtol=0, atol=1e-5, err_msg=f"sample {k}")
        np.testing.assert_allclose(a.fault_size, b.fault_size, rtol=0, atol=1e-5, err_msg=f"sample {k}")
        turned = np.mod(a.reconstruction[:3] - b.reconstruction[:3] + TURN / 2, TURN) - TURN / 2
        np.testing.assert_allclose(turned, 0.0, rtol=0, atol=1e-5, err_msg=f"sample {k}")


@pytest.mark.parametrize("model", MODELS)
def test_a_plant_with_a_period_keeps_the_contract(model: str) -> None:
    check_plant(car(model, start=359.5))


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("name", ["loo-glr", "robust-glr"])
def test_a_healthy_compass_is_not_isolated_over_several_turns_and_a_gap(name: str, model: str) -> None:
    log = within_a_turn(turning(seed=4, samples=600))
    kept = np.r_[0:200, 330:600]  # the car turns by 130 degrees unseen
    found = diagnose(name, log.rows(kept), plant=car(model))
    assert found.events == ()
    assert found.health is not None
    assert not found.health.suspect


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("name", ["loo-glr", "robust-glr"])
def test_a_bias_across_the_jump_is_found_with_its_size(name: str, model: str) -> None:
    log = turning(seed=5, samples=200)
    log.y[50:, 1] -= 10.0  # begins before the jump at 360 and lasts beyond it
    found = diagnose(name, within_a_turn(log), plant=car(model))
    assert [e.hypothesis for e in found.events] == ["compass_2"]
    assert found.events[0].start == pytest.approx(51.0, abs=1.0)
    assert found.events[0].size == pytest.approx(-10.0, abs=1.0)
    made = found.decisions.reconstruction[60:, 1] - log.y[60:, 1]
    assert np.max(np.abs(np.mod(made - 10.0 + TURN / 2, TURN) - TURN / 2)) < 5.0


def test_the_second_look_is_that_of_readings_with_the_turns_counted() -> None:
    log = turning(seed=11)
    out = np.zeros(log.y.shape, bool)
    out[40:, 0] = True  # left out, as of an isolated sensor
    a, b = (
        hindsight(plant, bridged(plant, of)[0], out)
        for plant, of in ((car(period=None), log), (car("modulo in the output"), within_a_turn(log)))
    )
    np.testing.assert_allclose(a.error, b.error, rtol=0, atol=1e-6)
    np.testing.assert_allclose(a.nis, b.nis, rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", ["limits", "pca", "one-class", "limits-ewma"])
def test_what_learns_from_readings_alone_refuses_cyclic_ones(name: str) -> None:
    with warnings.catch_warnings(), pytest.raises(NotApplicableError, match="compass_1, compass_2, compass_3 are cyclic"):
        registry.detector(name, car())
