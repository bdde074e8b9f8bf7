"""Diagnosers that share variables: their statistics on the power network, and which data areas exchange."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rounding import rounding

from fusion_sfdia.detectors.stochastic_thresholds import consensus_equations as equations
from fusion_sfdia.detectors.stochastic_thresholds.consensus import Diagnosers, initial_state, predict, take
from fusion_sfdia.models.power_network.diagnosis import network_areas
from fusion_sfdia.models.power_network.model import network_model
from fusion_sfdia.models.power_network.simulation import run_network
from fusion_sfdia.plant.areas import Areas
from fusion_sfdia.plant.plant import Array

LAM, SEEDS, STEPS, SETTLED = 0.3, 400, 24, 12
MODEL = network_model()
AREAS = network_areas(MODEL)
AT = AREAS.network.topology


def healthy_run(mode: str, missing: float = 0.0, lam: float = LAM, model: object = MODEL) -> tuple[Array, Array, Array, Array]:
    """Residuals and deviations of a settled closed loop: own (K, B, N, 4), (K, B, N, 4), shared (K, B, 2E), (K, B, 2E)."""
    areas, rng = network_areas(model), np.random.default_rng(3)
    now, found = initial_state(areas, (SEEDS,)), []
    for moment in run_network(model, STEPS, range(SEEDS), loads=lambda t: np.zeros(15)):
        load = np.broadcast_to(moment.load, moment.reference.shape)
        ahead = predict(areas, now, moment.reference, load, lam, mode)
        own = np.where(rng.random(moment.own.shape) < missing, np.nan, moment.own)
        shared = np.where(rng.random(moment.shared.shape) < missing, np.nan, moment.shared)
        now = take(areas, ahead, own, shared)
        if moment.t >= SETTLED:
            found.append((own - ahead.estimate, ahead.deviation, shared - ahead.estimate_shared, ahead.deviation_shared))
    return tuple(np.stack(a) for a in zip(*found, strict=True))


def ratios(residual: Array, deviation: Array) -> Array:
    """RMS of residual / deviation over seeds and times, one for each component."""
    return np.sqrt(np.nanmean((residual / deviation) ** 2, axis=(0, 1)))


# The mean of M squares of unit normals has the standard error sqrt(2 / M), its root half of that; neighbouring times correlate,
# so M counts seeds alone: 5 of them for the largest of 94 components.
ERROR = 5 / np.sqrt(2 * SEEDS)


@pytest.mark.parametrize("noise", ["lit", "small"])
@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_the_deviation_dominates_that_of_the_residual(noise: str, missing: float) -> None:
    own, s, shared, s_shared = healthy_run("corrected", missing, model=network_model(noise=noise))
    assert np.all(ratios(own, s) < 1 + ERROR) and np.all(ratios(shared, s_shared) < 1 + ERROR)
    assert np.all(np.abs(np.nanmean(own / s, axis=(0, 1))) < 5 / np.sqrt(SEEDS)), "residuals are biased"


def test_without_memory_the_deviation_is_exact() -> None:
    own, s, shared, s_shared = healthy_run("corrected", lam=0.0)
    np.testing.assert_allclose(ratios(own, s), 1.0, atol=ERROR)
    np.testing.assert_allclose(ratios(shared, s_shared), 1.0, atol=ERROR)


def test_noise_that_alternates_breaks_the_bound() -> None:
    """Of z+ = z read with noise of three values: chi = r+ - a r = 2 r for r+ = -r, where white noise has the variance 2 r^2.

    |chi| > alpha sd(chi) wherever r is not 0, up to a probability of 2 / alpha^2: twice what Chebyshev's inequality allows.
    """
    a, alpha, p, count = 1.0, 5.0, 0.076, 100_000
    rng = np.random.default_rng(2)
    size = rng.choice([-1.0, 0.0, 1.0], count, p=[p / 2, 1 - p, p / 2]) / np.sqrt(p)  # variance 1
    other = rng.permutation(size)
    deviation = equations.residual_deviation(0.0, a**2, 0.0, 1.0, 0.0)
    white, alternating = (np.mean(np.abs(after - a * size) > alpha * deviation) for after in (other, -size))
    error = 3 * np.sqrt(p / count)
    assert white <= 1 / alpha**2 and abs(alternating - p) < error and alternating > 1 / alpha**2


def test_as_printed_the_deviation_of_shared_states_is_too_small() -> None:
    own, s, *_ = healthy_run("paper")
    sharers = 1 + np.bincount(AT.node)
    assert np.all(ratios(own, s)[sharers > 2, 0] > 1 + ERROR) and np.all(ratios(own, s)[:, 0] > 1 - ERROR)
    np.testing.assert_array_equal(s[..., 1:], healthy_run("corrected")[1][..., 1:])  # of others it is the same


@pytest.mark.parametrize("missing", [False, True])
def test_each_deviation_is_that_of_its_own_receivers_noise(missing: bool) -> None:
    """Without memory s^2 is the variance of the receiver's reading, of w, and of every reading by its share of the estimate.

    Noises are unlike in all copies, shares are found by moving each reading by 1: estimates are linear in them. A missing
    reading is replaced by an estimate with the bound `error_bound`, whose share is added to s.
    """
    rng = np.random.default_rng(6)
    noise, shared_noise = rng.uniform(1e-4, 1e-1, AREAS.noise.shape), rng.uniform(1e-4, 1e-1, 34)
    unlike = replace(AREAS, noise=noise, shared_noise=shared_noise)
    count, zero = 60 + 34, np.zeros((1, 15))
    error_bound = np.where(rng.random(count) < 0.2, rng.uniform(0.01, 0.1, count), 0.0) if missing else np.zeros(count)

    def ahead(held: Array) -> tuple[Array, Array]:
        """Estimates and deviations (94,) of own readings, then of copies, after these readings."""
        given = (
            a.reshape(1, 15, 4) if k == 0 else a[None] for v in (held, error_bound) for k, a in enumerate(np.split(v, [60]))
        )
        rest = (np.zeros(s) for s in ((1, 15, 4), (1, 34)) * 2)
        found = predict(unlike, Diagnosers(*given, *rest), zero, zero, 0.0, "corrected")
        return tuple(np.concatenate([a.ravel(), b.ravel()]) for a, b in (found[:2], found[2:4]))  # type: ignore[return-value]

    start = rng.standard_normal(count)
    at_start, deviation = ahead(start)
    read_variance = np.where(error_bound > 0, 0.0, np.concatenate([noise.ravel(), shared_noise]))
    share = np.stack([ahead(start + e)[0] - at_start for e in np.eye(count)], axis=-1)
    own_noise = np.concatenate([noise.ravel(), shared_noise])
    own_process = np.concatenate([AREAS.process_variance.ravel(), AREAS.process_variance[AT.neighbour, 0]])
    expected = np.sqrt(share**2 @ read_variance + own_process + own_noise) + np.abs(share) @ error_bound
    # shares are differences of sums of some ten terms; that of a reading in two ways (as copy, in the drive) is in one number
    size = np.abs(at_start).max() + np.abs(start).max()
    assert np.all(np.abs(deviation - expected) <= rounding(size / np.sqrt(own_noise.min()), 100))


def test_weights_minimise_the_variance_and_do_not_depend_on_the_receiver() -> None:
    rng = np.random.default_rng(0)
    unlike = replace(
        AREAS, noise=AREAS.noise * rng.uniform(0.2, 5, AREAS.noise.shape), shared_noise=rng.uniform(1e-6, 1e-4, 34)
    )
    now = initial_state(unlike, (1,))
    zero = np.zeros((1, 15))
    now = take(
        unlike,
        predict(unlike, now, zero, zero, 0.0, "corrected"),
        rng.standard_normal((1, 15, 4)),
        rng.standard_normal((1, 34)),
    )
    ahead = predict(unlike, now, zero, zero, 0.0, "corrected")
    np.testing.assert_array_equal(ahead.estimate_shared, ahead.estimate[:, AT.neighbour, 0])
    i = AT.index("5")
    v, _, a, rest = noises_of(unlike, i)
    best = (1 / v) / np.sum(1 / v)
    variance = ahead.deviation[0, i, 0] ** 2
    np.testing.assert_allclose(variance, a**2 * best**2 @ v + rest, rtol=SUMMED)
    for _ in range(20):  # any other weights give a larger variance, by a^2 sum v_j (W_j - best_j)^2
        W = rng.dirichlet(np.ones(v.size))
        assert a**2 * W**2 @ v + rest > variance * (1 + SUMMED)


SUMMED = 50 * float(np.finfo(float).eps)  # relative: sums of some ten positive terms of four roundings each


def noises_of(areas: Areas, i: int) -> tuple[Array, Array, float, float]:
    """Of area i: sigma_j^2 of the readings of z_i, own first; v_j as printed; a; the terms of Var[chi_i] without W."""
    sides, row = areas.network.sides(i), areas.matrices[i, 0]
    n, a = areas.noise.shape[-1], row[0]
    sigma2 = np.array([areas.noise[i, 0], *areas.shared_noise[areas.opposite[sides]]])
    drive = row[1:n] ** 2 @ areas.noise[i, 1:] + row[n + 1] ** 2 * (areas.slope[sides] ** 2 @ areas.shared_noise[sides])
    process = areas.process_variance[i, 0]
    return sigma2, a**2 * sigma2 + drive + process + sigma2, a, drive + process + sigma2[0]


@pytest.mark.parametrize("mode", ["corrected", "paper"])
def test_each_reading_has_its_weight_in_the_estimate(mode: str) -> None:
    """(17): the estimate is linear in the readings; the share of z_i as read by area j is a (1 / v_j) / sum (1 / v)."""
    rng, i, zero = np.random.default_rng(4), AT.index("5"), np.zeros((1, 15))
    shared_noise = rng.uniform(1e-6, 1e-1, 34)
    unlike = replace(AREAS, noise=rng.uniform(1e-4, 1e-1, AREAS.noise.shape), shared_noise=shared_noise)
    at_zero = take(
        unlike, predict(unlike, initial_state(unlike, (1,)), zero, zero, 0.0, mode), np.zeros((1, 15, 4)), np.zeros((1, 34))
    )
    copies = AREAS.opposite[AREAS.network.sides(i)]

    def estimate(reading: int) -> float:
        """Of z_i, where this reading of it is 1 and all others are 0."""
        held, held_shared = at_zero.held.copy(), at_zero.held_shared.copy()
        if reading == 0:
            held[0, i, 0] = 1.0
        else:
            held_shared[0, copies[reading - 1]] = 1.0
        now = at_zero._replace(held=held, held_shared=held_shared)
        return float(predict(unlike, now, zero, zero, 0.0, mode).estimate[0, i, 0])

    sigma2, printed, a, rest = noises_of(unlike, i)
    v = printed if mode == "paper" else sigma2
    W = (1 / v) / np.sum(1 / v)
    np.testing.assert_allclose([estimate(j) for j in range(v.size)], a * W, rtol=SUMMED)
    variance = predict(unlike, at_zero, zero, zero, 0.0, mode).deviation[0, i, 0] ** 2
    expected = W**2 @ printed if mode == "paper" else a**2 * W**2 @ sigma2 + rest  # (15) as printed, and corrected
    np.testing.assert_allclose(variance, expected, rtol=SUMMED)


def test_equations_take_scalars_and_arrays() -> None:
    assert equations.noise_read(2.0, 0.0) == 2.0 and equations.noise_read(2.0, 0.1) == 0.0
    assert equations.precision_read(4.0, 0.0) == 0.25 and equations.precision_read(4.0, 2.0) == 0.25
    assert equations.shared_term(2.0, 3.0, 1.0, 0.5, 0.3) == pytest.approx(3.7)
    np.testing.assert_array_equal(equations.private_term(np.ones(3), np.ones(3), 0.5), np.full(3, 0.5))
    assert equations.printed_variance(2.0, 0.0, 0.5, 1.0, 4.0) == 0.5 + 1.0 + 4.0 + 2.0
    assert equations.precision_printed(2.0, 0.0, 0.5, 1.0, 4.0) == 1 / 7.5
    # the error bound of an estimate stands for the noise of its reading, which also counts as that of the next
    assert equations.precision_printed(2.0, 3.0, 0.5, 1.0, 4.0) == 1 / (0.25 * 9.0 + 1.0 + 4.0 + 2.0)
    assert equations.error_deviation(0.25, 3.0, 1.0, 0.5) == 2.75
    assert equations.residual_deviation(0.25, 3.0, 1.0, 5.0, 0.5) == 3.75
