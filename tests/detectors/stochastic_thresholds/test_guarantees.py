"""What is detected or excluded for certain is, in every run; exclusion errors are bounds; and errors decay like lam^t."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from toy_plants import tanks

from fusion_sfdia.detectors.detector import run
from fusion_sfdia.detectors.stochastic_thresholds.chebyshev import Chebyshev
from fusion_sfdia.detectors.stochastic_thresholds.consensus import initial_state, predict, take
from fusion_sfdia.detectors.stochastic_thresholds.fault_hypotheses import FaultHypotheses
from fusion_sfdia.detectors.stochastic_thresholds.guarantees import (
    accumulated,
    detectable,
    exceeds_next,
    excludable,
    excludable_faults,
    exclusion_error,
    isolation_probability,
    margins,
    spectral_radius,
)
from fusion_sfdia.diagnosis.fault_effects import apply_faults
from fusion_sfdia.diagnosis.faults import Fault
from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.models.power_network.diagnosis import network_areas
from fusion_sfdia.models.power_network.faults import fault_function
from fusion_sfdia.models.power_network.model import network_model
from fusion_sfdia.models.power_network.operation import AreaFault, load_profile
from fusion_sfdia.models.power_network.parameters import load_steps
from fusion_sfdia.models.power_network.simulation import run_network
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Array

LAM = 0.3


def test_a_constant_fault_is_detectable_from_twice_the_noise_on_and_not_before() -> None:
    """phi / (1 - lam) against 2 alpha chi / (1 - lam): ratio phi / (2 alpha chi) in the limit; as printed at once."""
    chi, alpha, phi = 0.5, 3.0, 4.0
    s = accumulated(np.full((60, 1), chi), LAM)
    effect = np.where(np.arange(60)[:, None] >= 20, phi, 0.0)
    ratio = margins(effect, s, LAM, alpha)[:, 0]
    assert not ratio[:20].any() and np.all(np.diff(ratio[20:40]) > 0)
    assert ratio[-1] == pytest.approx(phi / (2 * alpha * chi), rel=1e-9)  # lam^40 is below a rounding of it
    assert ratio[20] == pytest.approx(phi * (1 - LAM) / (2 * alpha * chi), rel=1e-9)
    printed = margins(effect, s, LAM, alpha, mode="paper")[20:, 0]
    np.testing.assert_allclose(printed, phi / (2 * alpha * chi), rtol=1e-9)
    for bad, message in (({"phi": effect[:5]}, "do not fit"), ({"mode": "printed"}, "known: corrected, paper")):
        with pytest.raises(ValueError, match=message):
            margins(**{"phi": effect, "deviation": s, "lam": LAM, "alpha": alpha, **bad})


def test_as_printed_a_fault_seems_detectable_that_need_not_be() -> None:
    """Noise before the fault holds the residual at -alpha s: a fault between (33) as printed and corrected is not seen then."""
    chi, alpha, start = 1.0, 2.0, 10
    s = accumulated(np.ones(12), LAM)
    phi = np.where(np.arange(12) == start, 1.2 * 2 * alpha * chi, 0.0)
    assert margins(phi, s, LAM, alpha, "paper")[start] > 1 > margins(phi, s, LAM, alpha)[start]
    noise = np.full(12, -alpha * chi)  # within the bound of each chi
    assert np.all(np.abs(accumulated(phi + noise, LAM)) <= alpha * s)


def test_a_fault_that_satisfies_the_condition_is_detected_in_every_run() -> None:
    """Tanks, a bias of the smallest detectable size: detected by that sensor at that time in all runs with |U| <= alpha s."""
    plant, alpha, runs = tanks(), 5.0, 100
    detector = Chebyshev(plant, alpha=alpha)
    made = simulate(plant, 60, range(runs), truth="model")
    fault = Fault("l2", "bias", onset=150.0, magnitude=0.2)
    clean = apply_faults(plant, made.t, made.signal, [fault]).y
    found = detectable(detector, Log(made.t, clean[:, 0], made.u_of_runs[:, 0]))
    assert found.probability == pytest.approx(1 - 1 / alpha**2) and found.smallest < 1
    scaled = Fault("l2", "bias", onset=150.0, magnitude=0.2 * found.smallest * 1.001)
    again = detectable(detector, Log(made.t, apply_faults(plant, made.t, made.signal, [scaled]).y[:, 0], made.u_of_runs[:, 0]))
    k, i = np.argwhere(again.certain)[0]
    # linear but for the square root of the levels, of which 0.2 m of some 0.5 m bend the effect by some percent
    assert again.certain.any() or again.ratio.max() > 0.95
    y = apply_faults(plant, made.t, made.y, [scaled]).y
    plain = Chebyshev(plant, alpha=alpha, accommodate=False)
    _, decisions = run(plain, plain.init((runs,), float(made.t[0]) - plant.dt), made.t, y, made.u_of_runs)
    # Gaussian: |U| <= 5 s in all but 6e-7 of the numbers
    assert np.all(decisions.scores[k, :, i] > 1)
    assert detectable(detector, Log(made.t, made.signal[:, 0], made.u_of_runs[:, 0])).ratio[:29].max() < 0.05


def test_the_difference_to_healthy_readings_counts_where_the_truth_is_not_the_model() -> None:
    plant = tanks()
    made = simulate(plant, 40, [0], truth="model")
    own = Log(made.t, made.signal[:, 0] + 0.02, made.u_of_runs[:, 0])  # all levels off by a constant
    same = detectable(Chebyshev(plant), own, own)
    assert not same.ratio.any()
    with pytest.raises(ValueError, match="the times of the healthy and the faulty readings differ"):
        detectable(Chebyshev(plant), own, own._replace(t=own.t + 1.0))


def test_a_hypothesis_that_is_excludable_is_excluded_and_the_true_one_is_not() -> None:
    """Two tanks, a leak of the second from 100 s on: by the detector without it excluded in each run, by its own in none."""
    usual, runs = tanks(), 50

    def step(t: float, x: Array, u: Array, dt: float) -> Array:
        return np.asarray(usual.step(t, x, u, dt) - 0.2 * np.sqrt(np.maximum(x, 0.0)) * np.array([0.0, 1.0]) * (t >= 100))

    leaking = replace(usual, step=step)
    made = simulate(leaking, 60, range(runs), truth="model")
    hypotheses = {"usual": Chebyshev(usual, alpha=3.0), "leak": Chebyshev(leaking, alpha=3.0)}
    found = excludable(hypotheses, Log(made.t, made.signal[:, 0], made.u_of_runs[:, 0]))
    assert found["usual"].ratio.max() > 1.5 and found["leak"].ratio.max() < 0.05
    exceeded = {}
    for name, detector in hypotheses.items():
        plain = replace(detector, accommodate=False)
        _, decisions = run(plain, plain.init((runs,), float(made.t[0]) - usual.dt), made.t, made.y, made.u_of_runs)
        exceeded[name] = decisions.scores > 1
    k, i = np.unravel_index(np.argmax(found["usual"].ratio), found["usual"].ratio.shape)
    assert exceeded["usual"][k, :, i].all()
    # Chebyshev: at most 1 / 9 of the numbers
    assert exceeded["leak"][k, :, i].mean() <= 1 / 9 + 3 * np.sqrt(1 / 9 / runs)


def test_one_step_ahead_it_is_the_distance_to_the_threshold_that_counts() -> None:
    alpha, before, chi = 2.0, 1.0, 0.7
    after = LAM * before + chi
    for e in (-1.9, 0.0, 1.5):
        need = LAM * (alpha * before - e) + 2 * alpha * chi
        ratio = np.array([0.999, 1.001])
        assert exceeds_next(ratio * need, e, before, after, LAM, alpha).tolist() == [False, True]
        worst = LAM * e + 1.001 * need - alpha * chi  # noise against the fault as far as its bound
        assert worst > alpha * after
        need = LAM * (-alpha * before - e) - 2 * alpha * chi
        assert exceeds_next(ratio * need, e, before, after, LAM, alpha).tolist() == [False, True]


@pytest.mark.slow
def test_in_the_network_what_is_detectable_or_excludable_is_so_in_every_run() -> None:
    """Area 5 with ten times its input, evaluated along the true states of each of 100 runs, from a fixed start on.

    At alpha = 4 Gaussian noise exceeds its bound in 6e-5 of the numbers, and s is an upper bound of its deviation.
    """
    model, runs, start = network_model(), 100, 5
    ten = AreaFault("input-gain", "5", 10.0)
    area, areas = 4, network_areas(model)
    faults = {
        "ten": fault_function(model, ten),
        "flip": fault_function(model, AreaFault("input-gain", "5", -1.0)),
        "none": lambda x, u, e: np.zeros(x.shape),
    }
    alpha = 4.0
    observer = FaultHypotheses(areas, "5", faults, lam=LAM, alpha=alpha, rule="gaussian", confirmations=1, patience=60)
    now, state = initial_state(areas, (runs,)), observer.idle(runs)
    xs, us, es, s, residuals, s_l, e_l = [], [], [], [], [], [], []
    last = np.zeros((runs, 15, 4))
    for moment in run_network(model, 45, range(runs), loads=load_profile(model, load_steps("2")), faults=[ten]):
        load = np.broadcast_to(moment.load, moment.reference.shape)
        state = observer.step(state, now, moment.reference, load, moment.own, moment.shared)
        now = take(areas, predict(areas, now, moment.reference, load, LAM, "corrected"), moment.own, moment.shared)
        xs.append(last[:, area])
        us.append(moment.reference[:, area])
        es.append(model.external(last[..., 0], load)[:, area])
        s.append(now.deviation[:, area])
        residuals.append(now.residual[:, area])
        s_l.append(state.deviation[..., :4])
        e_l.append(state.residual[..., :4])
        last = moment.x
        if moment.t == start * model.dt:
            state = observer.begin(state, np.ones(runs, bool), now)
    x, u, e = map(np.array, (xs, us, es))
    phi = faults["ten"](x, u, e)
    phi[0] = 0.0  # no step leads to the first reading
    ratio = margins(phi[1:], np.array(s)[1:], LAM, alpha)
    certain = ratio > 1
    assert certain.any(axis=(0, 2)).all()  # in every run at some time
    assert np.all((np.abs(residuals) > alpha * np.array(s))[1:][certain])
    after = slice(start + 1, None)
    for b in range(runs):
        of_run = excludable_faults(observer, faults["ten"], x[after, b], u[after, b], e[after, b], np.array(s_l)[after, b])
        beyond = np.any(np.abs(np.array(e_l)[after, b]) > alpha * np.array(s_l)[after, b], axis=-1)
        assert not of_run[:, 0].any() and of_run[:, 1:].max() > 1
        assert np.all(beyond[of_run > 1])


@pytest.mark.parametrize("rule", ["chebyshev", "gaussian"])
def test_the_error_of_an_exclusion_is_at_most_the_stated_one(rule: str) -> None:
    """Residuals of deviation s: those with a stated error of at most p are p of all at most; with a prior, its share of p."""
    rng = np.random.default_rng(0)
    s = np.array([1.0, 2.0, 0.5])
    residual = s * rng.standard_normal((100_000, 1, 3))
    stated = exclusion_error(residual, np.broadcast_to(s, residual.shape), rule)[:, 0]
    for p in (0.3, 0.05, 0.01):
        share = np.mean(stated <= p)
        assert share <= p + 3 * np.sqrt(p / len(stated))
        assert rule == "chebyshev" or share >= 0.8 * p  # Bonferroni's factor is nearly sharp for independent readings
    both = exclusion_error(np.repeat(residual[:5], 2, axis=1), np.ones((5, 2, 3)), rule, prior=(0.7, 0.2))
    alone = exclusion_error(np.repeat(residual[:5], 2, axis=1), np.ones((5, 2, 3)), rule)
    np.testing.assert_allclose(both, alone * [0.7, 0.2], rtol=1e-15)
    assert isolation_probability(0.7, 0.1) == pytest.approx(0.63)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"prior": (0.5, 0.6)}, "expected 2 probabilities with a sum of at most 1"),
        ({"prior": (0.5,)}, "expected 2 probabilities"),
        ({"rule": "conformal"}, "does not give a probability of a residual"),
        ({"rule": "none"}, "known"),
    ],
)
def test_what_is_no_prior_or_rule_is_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        exclusion_error(np.ones((2, 3)), np.ones((2, 3)), **given)


def test_errors_decay_like_powers_of_lam_in_any_network() -> None:
    for model in (network_model(), network_model(unplugged=["3", "7"])):
        for lam in (0.0, 0.3, 0.9):
            # eigenvalues of a matrix of rank one of at most 6 rows: some roundings of numbers up to 1
            assert spectral_radius(network_areas(model), lam) == pytest.approx(lam, abs=1e-13)
