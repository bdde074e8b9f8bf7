"""Isolation over fault functions: the equations of the detection with other models, answers checked by hand, and guarantees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from fusion_sfdia.detectors.stochastic_thresholds.consensus import MODES, Diagnosers, initial_state, predict, take
from fusion_sfdia.detectors.stochastic_thresholds.fault_functions import effects
from fusion_sfdia.detectors.stochastic_thresholds.fault_hypotheses import (
    NONE,
    NOT_ISOLATED,
    UNDECIDED,
    FaultHypotheses,
    exclusion_alpha,
)
from fusion_sfdia.detectors.stochastic_thresholds.guarantees import exceeds_next
from fusion_sfdia.models.power_network.diagnosis import network_areas
from fusion_sfdia.models.power_network.faults import fault_function
from fusion_sfdia.models.power_network.model import network_model
from fusion_sfdia.models.power_network.operation import AreaFault, load_profile, network_conditions
from fusion_sfdia.models.power_network.parameters import load_steps
from fusion_sfdia.models.power_network.simulation import run_network
from fusion_sfdia.plant.areas import Areas
from fusion_sfdia.plant.plant import Array

MODEL = network_model(unplugged=["3"])  # area 4 has an open tie
AREAS = network_areas(MODEL)
LAM, AREA = 0.3, 3
FAULTS = {
    "slow governor": AreaFault("governor", "4", 1000.0),
    "sign flip": AreaFault("input-gain", "4", -1.0),
    "twice": AreaFault("input-gain", "4", 2.0),
    "ten times": AreaFault("input-gain", "4", 10.0),
    "lost load": AreaFault("load-loss", "4", 0.1),
}
SET = {name: fault_function(MODEL, fault) for name, fault in FAULTS.items()}


def nothing(x: Array, u: Array, e: Array) -> Array:
    return np.zeros(x.shape)


def anything(runs: int, seed: int = 0) -> tuple[Diagnosers, Array, Array]:
    """Diagnosers after one reading of every sensor, and reference and load."""
    rng = np.random.default_rng(seed)
    empty = initial_state(AREAS, (runs,))
    own, shared = (rng.standard_normal(a.shape) for a in empty[:2])
    start = take(AREAS, predict(AREAS, empty, np.zeros((runs, 15)), np.zeros((runs, 15)), LAM, "corrected"), own, shared)
    reference, load = rng.standard_normal((2, runs, 15))
    return start, reference, load


def same_model(fault: AreaFault | None) -> Areas:
    """The areas whose diagnosers have the model with the fault."""
    if fault is None or fault.kind != "governor":
        return AREAS
    altered = MODEL.altered(fault.area, governor_time=fault.value)
    return network_areas(altered)


def as_known(fault: AreaFault | None, reference: Array, load: Array) -> tuple[Array, Array]:
    reference, load = reference.copy(), load.copy()
    if fault is not None and fault.kind == "input-gain":
        reference[:, AREA] *= fault.value
    if fault is not None and fault.kind == "load-loss":
        load[:, AREA] -= fault.value
    return reference, load


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("missing", [False, True])
def test_each_hypothesis_is_the_diagnoser_with_the_model_of_its_fault(mode: str, missing: bool) -> None:
    """(24) to (28) are (5), (6), (14), (15), (17) for the model with the fault; without one, those of the detection."""
    runs, everyone = 4, {"none": None} | FAULTS
    observer = FaultHypotheses(AREAS, "4", {"none": nothing} | SET, lam=LAM, mode=mode)
    start, reference, load = anything(runs)
    state = observer.begin(observer.idle(runs), np.ones(runs, bool), start)
    clean = start._replace(
        residual=0 * start.residual, residual_shared=0 * start.residual_shared,
        deviation=0 * start.deviation, deviation_shared=0 * start.deviation_shared,
    )  # fmt: skip
    knowing = dict.fromkeys(everyone, clean)
    detection = clean
    rng = np.random.default_rng(1)
    there = AREAS.opposite[AREAS.network.topology.start[AREA] : AREAS.network.topology.start[AREA + 1]]
    for _ in range(4):
        own, shared = rng.standard_normal((runs, 15, 4)), rng.standard_normal(start.held_shared.shape)
        shared[:, ~AREAS.network.closed] = np.nan
        if missing:
            own[1, AREA, 2], shared[2, there[0]] = np.nan, np.nan
        state = observer.step(state, detection, reference, load, own, shared)
        for place, (name, fault) in enumerate(everyone.items()):
            areas = same_model(fault)
            # what the area holds of its neighbours' angles is that of the detection, as B18 has no hypothesis of theirs
            at = AREAS.network.topology
            sides = np.arange(at.start[AREA], at.start[AREA + 1])
            knows = knowing[name]
            mixed = {k: np.array(getattr(knows, k)) for k in ("held_shared", "error_bound_shared")}
            for k, a in mixed.items():
                a[:, sides] = getattr(detection, k)[:, sides]
            ahead = predict(areas, knows._replace(**mixed), *as_known(fault, reference, load), LAM, mode)
            knowing[name] = knows = take(areas, ahead, own, shared)
            open_there = ~AREAS.network.closed[there]
            for k in ("held", "error_bound", "residual", "deviation"):
                expected = np.concatenate([getattr(knows, k)[:, AREA], getattr(knows, f"{k}_shared")[:, there]], axis=-1)
                expected[:, 4:][:, open_there] = found_open = getattr(state, k)[:, place, 4:][:, open_there]
                assert np.all(np.isfinite(found_open))
                # the derivatives are differences over 3e-3, so of the sums of some 10 terms up to 10 each they keep 1e-11
                np.testing.assert_allclose(getattr(state, k)[:, place], expected, rtol=1e-9, atol=1e-9, err_msg=f"{name}, {k}")
        detection = knowing["none"]


def test_a_curved_fault_function_counts_to_second_order() -> None:
    """phi = c x_2^2 in the row of p_m adds c (y^2 - v) to the estimate, where v is the variance of the reading y, 2 c y
    to its slope by x_2, and 2 c^2 v^2 to the variance.
    """
    c = 0.7

    def curved(x: Array, u: Array, e: Array) -> Array:
        return np.stack([0 * u, 0 * u, c * x[..., 2] ** 2, 0 * u], axis=-1)

    observer = FaultHypotheses(AREAS, "4", {"none": nothing, "curved": curved}, lam=LAM)
    start, reference, load = anything(5)
    begun = observer.begin(observer.idle(5), np.ones(5, bool), start)
    estimate, deviation, _ = observer._predict(begun, start, reference, load)
    y, row, v = start.held[:, AREA, 2], AREAS.matrices[AREA, 2], AREAS.noise[AREA, 2]
    np.testing.assert_allclose(estimate[:, 1, 2] - estimate[:, 0, 2], c * (y**2 - v), rtol=1e-9, atol=1e-14)  # of up to 10
    more = ((row[2] + 2 * c * y) ** 2 - row[2] ** 2) * v + 2 * c**2 * v**2
    np.testing.assert_allclose(deviation[:, 1, 2] ** 2 - deviation[:, 0, 2] ** 2, more, rtol=1e-9, atol=1e-15)


def test_moments_of_quadratic_fault_functions_are_exact() -> None:
    """phi = b' z + z' A z / 2 of Gaussian z: E = phi - tr(A V) / 2 at what was read, Var beyond its slope tr(A V A V) / 2."""
    rng = np.random.default_rng(3)
    A, b, sigma = rng.standard_normal((5, 5)), rng.standard_normal(5), rng.uniform(0.5, 2.0, 5)
    A, V = A + A.T, np.diag(sigma**2)

    def phi(x: Array, u: Array, e: Array) -> Array:
        z = np.concatenate([x, e[..., None]], axis=-1)
        value = z @ b + np.einsum("...i,ij,...j->...", z, A, z) / 2
        return np.stack([value, 0 * u, 2 * value, 0 * u], axis=-1)

    z = rng.standard_normal((3, 5))
    found = effects({"quadratic": phi}, z[:, None, :4], np.zeros((3, 1)), z[:, 4:], np.ones(5), np.tile(sigma**2, (3, 1, 1)))
    mean = z @ b + np.einsum("bi,ij,bj->b", z, A, z) / 2 - np.trace(A @ V) / 2
    # second differences over sigma of values up to some 100
    np.testing.assert_allclose(found.mean[:, 0], np.stack([mean, 0 * mean, 2 * mean, 0 * mean], axis=-1), atol=1e-12)
    np.testing.assert_allclose(found.slopes[:, 0, 0], b + z @ A, atol=1e-12)
    beyond = np.trace(A @ V @ A @ V) / 2
    np.testing.assert_allclose(found.curvature[:, 0], np.tile([beyond, 0.0, 4 * beyond, 0.0], (3, 1)), rtol=1e-12, atol=1e-12)


def test_a_fault_function_curved_in_what_crosses_the_border_counts_the_noise_of_all_ties() -> None:
    """phi = c e^2 with e = sum_j P_ij z_j - d: its mean is less by c Var e, and 2 c^2 Var[e]^2 is in the variance."""
    c = 50.0

    def curved(x: Array, u: Array, e: Array) -> Array:
        return np.stack([0 * u, 0 * u, c * e**2, 0 * u], axis=-1)

    observer = FaultHypotheses(AREAS, "4", {"none": nothing, "curved": curved}, lam=LAM)
    start, reference, load = anything(5)
    begun = observer.begin(observer.idle(5), np.ones(5, bool), start)
    estimate, deviation, _ = observer._predict(begun, start, reference, load)
    sides = observer._sides
    slope = np.where(AREAS.network.closed[sides], AREAS.slope[sides], 0.0)
    v = np.where(start.error_bound_shared[:, sides] == 0, AREAS.shared_noise[sides], 0.0) @ slope**2
    e, row = start.held_shared[:, sides] @ slope - load[:, AREA], AREAS.matrices[AREA, 2]
    np.testing.assert_allclose(estimate[:, 1, 2] - estimate[:, 0, 2], c * (e**2 - v), rtol=1e-9, atol=1e-11)
    more = ((row[5] + 2 * c * e) ** 2 - row[5] ** 2) * v + 2 * c**2 * v**2
    np.testing.assert_allclose(deviation[:, 1, 2] ** 2 - deviation[:, 0, 2] ** 2, more, rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize("away", [0.0, 1.5, 3.0])
def test_a_strongly_curved_true_fault_crosses_no_more_often_than_chebyshev_states(away: float) -> None:
    """phi = c x_2^2 with x_2 `away` deviations of its reading from 0; to first order 2.8 % of draws crossed alpha = 10."""

    def curved(x: Array, u: Array, e: Array) -> Array:
        return np.stack([0 * u, 0 * u, 1e5 * x[..., 2] ** 2, 0 * u], axis=-1)

    runs, rng, sigma, size = 4000, np.random.default_rng(1), np.sqrt(AREAS.noise), AREAS.size
    observer = FaultHypotheses(AREAS, "4", {"curved": curved}, lam=LAM, alpha=10.0)
    x, sides, zero = np.zeros((runs, *size[:2])), AREAS.network.topology.node.size, np.zeros((runs, size[0]))
    x[:, AREA, 2] = away * sigma[AREA, 2]
    y, shared = x + sigma * rng.standard_normal(x.shape), np.sqrt(AREAS.shared_noise) * rng.standard_normal((runs, sides))
    now = take(AREAS, predict(AREAS, initial_state(AREAS, (runs,)), zero, zero, LAM, "corrected"), y, shared)
    state = observer.begin(observer.idle(runs), np.ones(runs, bool), now)
    x = MODEL.step(x, zero, zero)
    x[:, AREA] += curved(np.broadcast_to(away * sigma[AREA, 2] * np.eye(4)[2], (runs, 4)), zero[:, 0], zero[:, 0])
    state = observer.step(state, now, zero, zero, x + sigma * rng.standard_normal(x.shape), shared)
    crossed = np.mean(np.abs(state.residual[:, 0, 2]) > 10 * state.deviation[:, 0, 2])
    assert crossed <= 1 / 10**2
    residual = state.residual[:, 0, 2]
    assert abs(residual.mean()) < 4 * residual.std() / np.sqrt(
        runs
    )  # without the mean of second order at 0: 45 standard errors


@pytest.mark.parametrize("name", FAULTS)
def test_fault_functions_are_the_effects_of_the_faults(name: str) -> None:
    rng = np.random.default_rng(2)
    x, reference, load = rng.standard_normal((6, 15, 4)), rng.standard_normal((6, 15)), rng.standard_normal((6, 15))
    faulty = network_conditions(MODEL, [FAULTS[name]])(0.0).step(x, reference, load)
    added = SET[name](x[:, AREA], reference[:, AREA], MODEL.external(x[..., 0], load)[:, AREA])
    # sums of 10 terms of both signs, of magnitude up to some 30
    np.testing.assert_allclose(added, (faulty - MODEL.step(x, reference, load))[:, AREA], atol=1e-12)


def observed(outcomes: Sequence[Sequence[bool]], **settings: Any) -> list[str]:
    """The answers, step by step, when the residuals of each hypothesis exceed their thresholds or not as given."""
    observer = FaultHypotheses(AREAS, "4", {f"h{i}": nothing for i in range(len(outcomes[0]))}, **settings)
    start, reference, load = anything(1)
    state = observer.begin(observer.idle(1), np.ones(1, bool), start)
    said = []
    for step in outcomes:
        # each hypothesis gets a last residual of its own by what it held, so that one reading does what is expected
        estimate, deviation, _ = observer._predict(state, start, 0 * reference, 0 * load)
        own, shared = np.zeros((1, 15, 4)), np.where(AREAS.network.closed, 0.0, np.nan)[None]
        own[0, AREA] = estimate[0, 0, :4]
        shift = np.array([1.5 if beyond else 0.0 for beyond in step]) * observer.alpha * deviation[0, :, 1] / LAM
        state = state._replace(held=np.broadcast_to(estimate[:, :1], state.held.shape).copy())
        residual = np.zeros_like(state.residual)
        residual[0, :, 1] = shift
        state = state._replace(residual=residual)
        expected, _, _ = observer._predict(state, start, 0 * reference, 0 * load)
        own[0, AREA] = expected[0, 0, :4]
        own[0, AREA, 1] = expected[0, 0, 1] + LAM * shift[0]
        state = observer.step(state, start, 0 * reference, 0 * load, own, shared)
        said.append(observer.answers[int(observer.answer(state)[0])])
    return said


YES, NO = True, False


def test_the_one_left_none_of_these_and_time_out() -> None:
    p2 = {"confirmations": 2, "patience": 6}
    assert observed([[NO, YES], [NO, YES], [NO, YES]], **p2) == [UNDECIDED, "h0", "h0"]
    assert observed([[NO, YES], [NO, NO], [NO, YES], [NO, YES]], **p2) == [UNDECIDED] * 3 + ["h0"]
    # the last one is isolated when its own residual is within its threshold, otherwise excluded, too
    assert observed([[NO, YES], [YES, YES], [YES, YES]], **p2) == [UNDECIDED, UNDECIDED, NONE]
    assert observed([[NO, YES], [YES, YES], [NO, YES]], **p2) == [UNDECIDED, UNDECIDED, "h0"]
    # an answer may change within the patience, and is final after it
    assert observed([[NO, YES]] * 3 + [[YES, NO]] * 2, **p2) == [UNDECIDED, "h0", "h0", UNDECIDED, NONE]
    assert observed([[NO, YES]] * 6 + [[YES, NO]] * 3, **p2)[-4:] == ["h0"] * 4
    assert observed([[NO, NO]] * 7, **p2) == [UNDECIDED] * 5 + [NOT_ISOLATED] * 2
    assert observed([[NO, NO]] * 6 + [[NO, YES]] * 3, **p2)[-1] == NOT_ISOLATED
    assert observed([[NO]] * 3, **p2) == [UNDECIDED, "h0", "h0"]


def test_nothing_happens_before_the_start_or_without_a_reading() -> None:
    observer = FaultHypotheses(AREAS, "4", SET, alpha=1.1, confirmations=1)
    start, reference, load = anything(3)
    state = observer.begin(observer.idle(3), np.array([False, True, True]), start)
    own, shared = np.full((3, 15, 4), 50.0), np.full(start.held_shared.shape, np.nan)
    own[2] = np.nan
    after = observer.step(state, start, reference, load, own, shared)
    assert after.excluded.any(axis=-1).tolist() == [False, True, False]
    assert after.age.tolist() == [-1, 1, 1]
    assert [observer.answers[a] for a in observer.answer(after)] == [UNDECIDED, NONE, UNDECIDED]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"faults": {}}, "no fault function"),
        ({"faults": {"x": lambda x, u, e: x[..., :3]}}, r"'x' gives float64 \(3, 3\).*expected 4 finite numbers"),
        ({"faults": {"x": lambda x, u, e: np.zeros(4)}}, r"gives float64 \(4,\) for states \(3, 4\)"),
        ({"faults": {"x": lambda x, u, e: x + np.nan}}, "finite"),
        ({"faults": {"x": lambda x, u, e: x.astype(str)}}, "expected 4 finite numbers"),
        ({"faults": {NONE: nothing}}, "more than once"),
        ({"area": "16"}, "unknown node '16'"),
        ({"alpha": 0.9}, "expected a finite number above 1"),
        ({"rule": "conformal"}, "conformal"),
        ({"lam": 1.0}, "lam is 1.0"),
        ({"mode": "printed"}, "known: corrected, paper"),
        ({"confirmations": 0}, "confirmations"),
        ({"patience": 2}, "patience is 2; expected a whole number of at least 3"),
    ],
)
def test_invalid_settings_are_rejected(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        FaultHypotheses(**({"areas": AREAS, "area": "4", "faults": SET} | change))


def test_the_guarantee_is_one_alarm_for_each_block_of_confirmations() -> None:
    """For all sequences of alarms: those that contain p in a row have an alarm at a multiple of p."""
    for p, steps in product((1, 2, 3), (3, 7)):
        for alarms in product((False, True), repeat=steps):
            excluded = any(all(alarms[k : k + p]) for k in range(steps - p + 1))
            at_multiples = sum(alarms[k] for k in range(p - 1, steps, p))
            assert excluded <= at_multiples
    alpha = exclusion_alpha("chebyshev", 0.05, 4, 30)
    observer = FaultHypotheses(AREAS, "4", SET, alpha=alpha)
    assert observer.false_exclusion() == pytest.approx(0.05, rel=1e-12)
    assert observer.false_exclusion(2) == 0.0  # not excluded before the third step
    assert observer.false_exclusion(3) == pytest.approx(0.005, rel=1e-12)
    assert replace(observer, alpha=2.0).false_exclusion() == 1.0
    assert replace(observer, mode="paper").false_exclusion() == 1.0


def shares_excluded(noise: str, alpha: float, rule: str, confirmations: int, runs: int = 200) -> tuple[float, float]:
    """In how many runs the true fault, a sign flip from 0 on, is excluded within 30 steps of the start; and the bound."""
    model = network_model(noise=noise)
    flip = AreaFault("input-gain", "5", -1.0)
    areas = network_areas(model)
    observer = FaultHypotheses(
        areas, "5", {"flip": fault_function(model, flip)}, alpha=alpha, rule=rule, confirmations=confirmations
    )
    now, state = initial_state(areas, (runs,)), observer.idle(runs)
    loads = load_profile(model, load_steps("2"))
    for moment in run_network(model, 35, range(runs), loads=loads, faults=[flip]):
        load = np.broadcast_to(moment.load, moment.reference.shape)
        state = observer.step(state, now, moment.reference, load, moment.own, moment.shared)
        now = take(areas, predict(areas, now, moment.reference, load, LAM, "corrected"), moment.own, moment.shared)
        if moment.t == 5.0:
            state = observer.begin(state, np.ones(runs, bool), now)
    assert state.age.tolist() == [30] * runs
    return float(state.excluded[:, 0].mean()), observer.false_exclusion()


@pytest.mark.parametrize("noise", ["lit", "small"])
def test_the_true_fault_is_excluded_no_more_often_than_stated(noise: str) -> None:
    """Residuals here are Gaussian, of a deviation at most s, so both rules hold; started at a fixed time."""
    runs = 200
    for rule, confirmations in (("chebyshev", 3), ("gaussian", 1)):
        alpha = exclusion_alpha(rule, 0.2, 4, 30, confirmations)
        share, bound = shares_excluded(noise, alpha, rule, confirmations, runs)
        assert bound == pytest.approx(0.2, rel=1e-12)
        assert share <= bound + 3 * np.sqrt(bound * (1 - bound) / runs)


def test_a_hypothesis_whose_difference_from_the_true_fault_is_large_enough_crosses_its_threshold() -> None:
    """(38), (39) by `exceeds_next`, for p_m and p_v of area 5 with a sign flip of its input, hypothesis no fault, alpha = 5."""
    model, runs = network_model(noise="small"), 50
    areas, flip = network_areas(model), fault_function(model, AreaFault("input-gain", "5", -1.0))
    observer = FaultHypotheses(areas, "5", {"none": nothing}, alpha=5.0)
    rng, size = np.random.default_rng(2), (runs, *areas.size[:2])
    sigma, sides, zero = np.sqrt(areas.noise), areas.network.topology.node.size, np.zeros((runs, areas.size[0]))
    area = areas.network.topology.index("5")
    x, now, state, sure = np.zeros(size), initial_state(areas, (runs,)), observer.idle(runs), 0
    for k in range(30):
        reference = np.zeros_like(zero)
        reference[:, area] = rng.uniform(-0.5, 0.5, runs)  # the limit of the reference
        after = model.step(x, reference, zero)
        phi = flip(x[:, area], reference[:, area], zero[:, area])
        after[:, area] += phi
        after += np.sqrt(areas.process_variance) * rng.standard_normal(size)
        y = after + sigma * rng.standard_normal(size)
        shared = after[:, areas.network.topology.neighbour, 0] + np.sqrt(areas.shared_noise) * rng.standard_normal(
            (runs, sides)
        )
        before, started = state, k > 1
        state = observer.step(state, now, reference, zero, y, shared)
        now = take(areas, predict(areas, now, reference, zero, LAM, "corrected"), y, shared)
        if k == 1:
            state = observer.begin(state, np.ones(runs, bool), now)
        if not started:
            x = after
            continue
        e, s, s_after = (a[:, 0, 2:4] for a in (before.residual, before.deviation, state.deviation))
        known = exceeds_next(phi[:, 2:], e, s, s_after, LAM, observer.alpha)
        crossed = np.abs(state.residual[:, 0, 2:4]) > observer.alpha * s_after
        assert np.all(crossed[known])  # |chi| beyond 5 deviations has a probability below 1e-6
        sure, x = sure + int(known.sum()), after
    assert sure > 100
