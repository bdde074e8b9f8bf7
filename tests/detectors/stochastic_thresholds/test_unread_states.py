"""Areas that do not read all their states: variances, rates of false alarms, faults, and where there is no estimate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from area_chain import AB, BA, BC, CB, CD, DC, TOPOLOGY, chain_areas, chain_runs
from rounding import EPS

from fusion_sfdia.detectors.stochastic_thresholds.consensus import Diagnosers, NetworkReadings, predict, require_mode, take
from fusion_sfdia.detectors.stochastic_thresholds.fault_hypotheses import FaultHypotheses
from fusion_sfdia.detectors.stochastic_thresholds.guarantees import spectral_radius
from fusion_sfdia.detectors.stochastic_thresholds.network_step import network_step
from fusion_sfdia.detectors.stochastic_thresholds.unread_states import error_matrix, require_estimable, settle
from fusion_sfdia.plant.areas import Areas
from fusion_sfdia.plant.plant import Array

RUNS, STEPS = 4000, 12
# Of up to 18 variances and covariances in ten cases the largest: five standard errors, each sqrt(2 / RUNS) or less.
ERROR = 5 * np.sqrt(2 / RUNS)
NOWHERE = [AB, CB]  # sides of the first state of area b

CASES = {
    "a private state": chain_areas([(1, 1)]),
    "a first state that neighbours read": chain_areas([(1, 0)]),
    "a first state, and a private one": chain_areas([(1, 0), (1, 2)]),
    "states of several areas": chain_areas([(0, 2), (1, 0), (2, 1), (3, 0)]),
    "an area that reads nothing": chain_areas([(1, 0), (1, 1), (1, 2)]),
    "a neighbour that does not read a first state": chain_areas([], [AB]),
    "an unread state beside such neighbours": chain_areas([(1, 1)], [AB, BA, BC]),
}


def later_missing(k: int, own: Array, shared: Array) -> None:
    if k >= STEPS - 3:
        own[:, 1, 0 if k % 2 else 2] = np.nan


@pytest.mark.parametrize("missing", [False, True])
@pytest.mark.parametrize("case", CASES)
def test_thresholds_have_the_variance_of_residuals(case: str, missing: bool) -> None:
    """With lam = 0, (14) and (15) are sd(chi), and Sigma is the covariance of x - x_bar."""
    areas = CASES[case]
    gaps = {"missing": later_missing} if missing and areas.unread[1].any() else {}
    *_, last = chain_runs(areas, RUNS, STEPS, **gaps)
    pairs = (
        (last.own - last.ahead.estimate, last.ahead.deviation),
        (last.shared - last.ahead.estimate_shared, last.ahead.deviation_shared),
    )
    for residual, deviation in pairs:
        tested = np.isfinite(residual[0])
        assert np.all(deviation == deviation[0])
        ratio = np.mean(residual[:, tested] ** 2, axis=0) / deviation[0, tested] ** 2
        np.testing.assert_allclose(ratio, 1.0, atol=ERROR)
    for i in np.flatnonzero(areas.unread.any(axis=1)):
        error, Sigma = (last.x - last.now.held)[:, i], last.now.covariance[0, i]
        size = np.sqrt(np.outer(np.diag(Sigma), np.diag(Sigma)))
        np.testing.assert_allclose(error.T @ error / RUNS / size, Sigma / size, atol=ERROR)


def test_estimates_of_neighbours_and_missing_readings_at_sides_give_bounds() -> None:
    def gap(k: int, own: Array, shared: Array) -> None:
        if k >= STEPS - 3:
            shared[:, BA] = np.nan

    for areas, missing in ((chain_areas([(1, 0)], NOWHERE), None), (chain_areas([(1, 1)]), gap)):
        *_, last = chain_runs(areas, RUNS, STEPS, **({} if missing is None else {"missing": missing}))
        for i in range(4):
            residual = last.own[:, i] - last.ahead.estimate[:, i]
            tested = np.isfinite(residual[0])
            assert np.all(np.mean(residual[:, tested] ** 2, axis=0) <= (1 + ERROR) * last.ahead.deviation[0, i, tested] ** 2)
        error, Sigma = (last.x - last.now.held)[:, 1], last.now.covariance[0, 1]
        # eigenvalues of a sample covariance in the coordinates in which Sigma is 1: 3 of 5 standard errors each
        half = np.linalg.inv(np.linalg.cholesky(Sigma))
        assert np.linalg.eigvalsh(half @ (error.T @ error / RUNS) @ half.T).max() <= 1 + 3 * ERROR


def seldom(rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """Numbers of variance 1 with long tails: 0 but for one of 8."""
    return np.sqrt(8.0) * rng.choice([-1.0, 1.0], shape) * (rng.random(shape) < 1 / 8)


@pytest.mark.parametrize("lam", [0.0, 0.3])
@pytest.mark.parametrize("case", ["a private state", "a first state, and a private one", "nowhere"])
def test_false_alarms_are_at_most_those_of_chebyshev(case: str, lam: float) -> None:
    *_, last = chain_runs(CASES.get(case, chain_areas([(1, 0)], NOWHERE)), RUNS, STEPS, lam, draw=seldom)
    for alpha in (2.0, 3.0):
        most = 1 / alpha**2
        most += 5 * np.sqrt(most * (1 - most) / RUNS)
        for residual, s in ((last.now.residual, last.now.deviation), (last.now.residual_shared, last.now.deviation_shared)):
            assert np.all(np.mean(np.abs(residual) > alpha * s, axis=0) <= most)


def test_without_knowledge_of_the_start_thresholds_come_down_to_those_with_it() -> None:
    """Of a deviation of FAR at the start lam^t is left, or less than a hundredth after 20 steps."""
    areas = CASES["a first state, and a private one"]
    *_, a = chain_runs(areas, 1, 20, 0.3)
    *_, b = chain_runs(areas, 1, 20, 0.3, known=False)
    np.testing.assert_allclose(b.now.deviation, a.now.deviation, rtol=0.01)
    assert np.all(b.now.deviation >= a.now.deviation * (1 - 1e-9))


def test_an_unread_state_on_which_nothing_depends_changes_nothing() -> None:
    """The equations of unread states are then those of read ones: the same numbers for all other states."""
    whole = chain_areas()
    whole.matrices[1, [0, 2], 1] = 0.0
    missing = replace(whole, noise=np.where(np.arange(12).reshape(4, 3) == 4, np.inf, whole.noise))
    gaps = {"missing": lambda k, own, shared: own.__setitem__((slice(None), 1, 1), np.nan)}
    for a, b in zip(chain_runs(whole, 3, 60, 0.3, **gaps), chain_runs(missing, 3, 60, 0.3), strict=True):
        last = a, b
    for field in ("estimate", "deviation"):
        for one in (field, f"{field}_shared"):
            x, y = (np.delete(getattr(s.ahead, one).reshape(3, -1), 4 if one == field else [], axis=1) for s in last)
            # what a large covariance at the start leaves decays; sums of some ten terms of size 10 each
            np.testing.assert_allclose(y, x, rtol=1000 * EPS, atol=1000 * EPS)


def test_other_areas_keep_their_bits() -> None:
    """Areas c and d share nothing with what a does not read."""
    for a, b in zip(chain_runs(chain_areas(), 3, 20, 0.3), chain_runs(chain_areas([(0, 1)]), 3, 20, 0.3), strict=True):
        for name in ("estimate", "deviation", "error_bound"):
            for field, mine in ((name, [2, 3]), (f"{name}_shared", [CB, CD, DC])):
                x, y = (getattr(s.ahead, field)[:, mine] for s in (a, b))
                assert x.tobytes() == y.tobytes(), field


def test_steps_are_predictions_and_readings_by_turns() -> None:
    areas = chain_areas([(1, 0), (2, 1), (0, 2)], [AB, CD])
    *_, last = chain_runs(areas, 2, STEPS, 0.3, missing=later_missing)
    given = NetworkReadings(last.own, last.shared, *np.random.default_rng(4).standard_normal((2, 2, 4)))
    by_turns = take(areas, predict(areas, last.now, given.reference, given.load, 0.3, "corrected"), given.own, given.shared)
    stepped, _ = network_step(areas, last.now, given, 2.0, 0.3)
    assert [a.tobytes() for a in stepped] == [a.tobytes() for a in by_turns]
    with pytest.raises(ValueError, match="covariance"):
        network_step(areas, Diagnosers(*last.now[:8]), given, 2.0, 0.3)
    whole = np.where(areas.unread, 1e6, last.own)  # readings of sensors that the model does not have
    for a, b in zip(network_step(areas, last.now, given._replace(own=whole), 2.0, 0.3)[0], stepped, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("areas", [CASES["states of several areas"], chain_areas([(1, 0), (0, 1), (2, 2)], NOWHERE)])
def test_errors_without_noise_follow_the_matrix_of_proposition_2(areas: Areas) -> None:
    rng, at = np.random.default_rng(5), TOPOLOGY
    x, before = rng.standard_normal((1, 4, 3)), np.where(areas.unread, rng.standard_normal((1, 4, 3)), 0.0)
    still, now = np.zeros((1, 4)), settle(areas)[0]
    held = x - before
    shared = np.where(areas.received, held[:, at.neighbour, 0], x[:, at.neighbour, 0])
    now = now._replace(held=held, held_shared=shared)
    inflow = np.array([np.sum(areas.slope[at.node == i] * x[0, at.neighbour[at.node == i], 0]) for i in range(4)])
    x = np.einsum("irc,ic->ir", areas.matrices, np.concatenate([x[0], np.zeros((4, 1)), inflow[:, None]], axis=-1))[None]
    own, theirs = np.where(areas.unread, np.nan, x), np.where(areas.received, np.nan, x[:, at.neighbour, 0])
    after = take(areas, predict(areas, now, still, still, 0.0, "corrected"), own, theirs)
    matrix = error_matrix(areas, now)
    # sums of some twenty products of numbers up to 3; K has settled to a share of SETTLED
    np.testing.assert_allclose((x - after.held).ravel(), matrix @ before.ravel(), rtol=1e-8, atol=100 * EPS)
    radius = np.abs(np.linalg.eigvals(matrix)).max()
    assert [spectral_radius(areas, lam) for lam in (0.0, 0.9)] == pytest.approx([radius, 0.9], rel=1e-9)


def test_a_fault_in_the_dynamics_of_an_unread_state_is_seen_by_others() -> None:
    """(33): where the effect without noise is above 2 alpha s, the alarm has at least the probability 1 - 1 / alpha^2."""
    areas, alpha, lam, fault = CASES["a private state"], 3.0, 0.3, np.zeros((4, 3))
    fault[1, 1] = 45.0
    *_, effect = chain_runs(areas, 1, 40, lam, noise=0.0, fault=fault)
    certain = (np.abs(effect.now.residual) > 2 * alpha * effect.now.deviation)[0]
    assert certain[1].tolist() == [True, False, False]
    *_, noisy = chain_runs(areas, RUNS, 40, lam, fault=fault)
    beyond = np.mean(np.abs(noisy.now.residual) > alpha * noisy.now.deviation, axis=0)
    assert np.all(beyond[certain] >= 1 - 1 / alpha**2)


def undetectable() -> Areas:
    """The second state of area b keeps its errors, and no other state depends on it."""
    areas = chain_areas([(1, 1)])
    areas.matrices[1, :, 1] = [0.0, 1.0, 0.0]
    return areas


def test_unread_states_that_cannot_be_estimated_are_refused() -> None:
    message = r"area 'b': errors of estimates of b1 do not decay \(factor 1 a step\) with readings of b0, b2; .* sensor of b1"
    with pytest.raises(ValueError, match=message):
        require_estimable(undetectable())
    growing = undetectable()
    growing.matrices[1, 1, 1] = 1.5
    with pytest.raises(ValueError, match=r"factor 1\.5 a step"):
        require_estimable(growing)
    away = undetectable()
    network = away.network.switched(unplug=["b"])
    slope = np.where(network.closed, away.slope, 0.0)
    assert require_estimable(replace(away, network=network, slope=slope)) == 0.0  # an area that is not there
    # both first states are unread and each drives the other; their sum keeps its errors, though each alone decays
    sums = chain_areas([(0, 0), (1, 0)], [AB, BA, CB])
    sums.matrices[:2, 0, :3], sums.matrices[:2, 1:, 0], sums.matrices[:2, 1:, 4] = [0.5, 0.0, 0.0], 0.0, 0.0
    sums.slope[[AB, BA]] = 0.5 / sums.matrices[:2, 0, 4]
    sums = replace(sums, shared_gain=sums.matrices[TOPOLOGY.neighbour, 0, 0])
    with pytest.raises(
        ValueError, match=r"grow in the network \(factor 1 a step\).* none of a0, b0, b0 at a, a0 at b, b0 at c"
    ):
        require_estimable(sums)


def test_what_needs_all_states_says_so() -> None:
    areas = CASES["a private state"]
    with pytest.raises(ValueError, match="no sensor of its area reads b1; the mode 'paper'"):
        require_mode(areas, "paper")
    with pytest.raises(ValueError, match="no sensor of its area reads b1; fault functions"):
        FaultHypotheses(areas, "a", {"none": lambda x, u, e: 0.0 * x})
    assert require_estimable(chain_areas()) == 0.0
    with pytest.raises(ValueError, match="or inf of a state without a sensor"):
        replace(areas, noise=-areas.noise)


@pytest.mark.parametrize("scale", [(1e3, 1e-2), (1e-6, 1e6)])
def test_units_of_states_that_are_not_shared_do_not_matter(scale: tuple[float, float]) -> None:
    """Sums of some ten terms; what the start leaves has decayed; the gain has settled to a share of SETTLED in each."""
    areas, units = chain_areas([(1, 1), (2, 0)], [AB, CB]), np.array([1.0, *scale])
    matrices = areas.matrices * units[:, None] / np.array([*units, 1.0, 1.0])
    other = replace(areas, matrices=matrices, process_variance=areas.process_variance * units**2, noise=areas.noise * units**2)
    other = replace(other, shared_gain=other.matrices[TOPOLOGY.neighbour, 0, 0])
    a, b = ([*chain_runs(one, 1, 40, 0.3, known=False)][-1].ahead.deviation for one in (areas, other))
    np.testing.assert_allclose(b / units, a, rtol=1e-6)
    assert spectral_radius(other, 0.0) == pytest.approx(spectral_radius(areas, 0.0), rel=1e-6)
