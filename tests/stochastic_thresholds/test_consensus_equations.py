"""Diagnosers that share variables: their laws on the power network, and that nothing else crosses a border."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rounding import rounding

from fusion_sfdia.core.areas import Areas
from fusion_sfdia.core.plant import Array
from fusion_sfdia.models.power_network.diagnosis import network_areas
from fusion_sfdia.models.power_network.model import network_model
from fusion_sfdia.models.power_network.simulation import run_network
from fusion_sfdia.stochastic_thresholds import consensus_equations as equations
from fusion_sfdia.stochastic_thresholds.consensus import MODES, Diagnosers, initial_state, predict, take

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
        now = take(ahead, own, shared)
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

    Noises are unlike in all copies, shares are found by moving each reading by 1: estimates are linear in them. What is missing
    is held with an error of a standard deviation of up to `doubt`, which adds its share of that to s.
    """
    rng = np.random.default_rng(6)
    noise, shared_noise = rng.uniform(1e-4, 1e-1, AREAS.noise.shape), rng.uniform(1e-4, 1e-1, 34)
    unlike = replace(AREAS, noise=noise, shared_noise=shared_noise)
    count, zero = 60 + 34, np.zeros((1, 15))
    doubt = np.where(rng.random(count) < 0.2, rng.uniform(0.01, 0.1, count), 0.0) if missing else np.zeros(count)

    def ahead(held: Array) -> tuple[Array, Array]:
        """Estimates and deviations (94,) of own readings, then of copies, after these readings."""
        given = (a.reshape(1, 15, 4) if k == 0 else a[None] for v in (held, doubt) for k, a in enumerate(np.split(v, [60])))
        rest = (np.zeros(s) for s in ((1, 15, 4), (1, 34)) * 2)
        found = predict(unlike, Diagnosers(*given, *rest), zero, zero, 0.0, "corrected")
        return tuple(np.concatenate([a.ravel(), b.ravel()]) for a, b in (found[:2], found[2:4]))  # type: ignore[return-value]

    start = rng.standard_normal(count)
    at_start, deviation = ahead(start)
    read_variance = np.where(doubt > 0, 0.0, np.concatenate([noise.ravel(), shared_noise]))
    share = np.stack([ahead(start + e)[0] - at_start for e in np.eye(count)], axis=-1)
    own_noise = np.concatenate([noise.ravel(), shared_noise])
    own_process = np.concatenate([AREAS.process_variance.ravel(), AREAS.process_variance[AT.neighbour, 0]])
    expected = np.sqrt(share**2 @ read_variance + own_process + own_noise) + np.abs(share) @ doubt
    # shares are differences of sums of some ten terms; that of a reading in two ways (as copy, in the drive) is in one number
    size = np.abs(at_start).max() + np.abs(start).max()
    assert np.all(np.abs(deviation - expected) <= rounding(size / np.sqrt(own_noise.min()), 100))


def test_weights_minimise_the_variance_and_do_not_depend_on_the_user() -> None:
    rng = np.random.default_rng(0)
    unlike = replace(
        AREAS, noise=AREAS.noise * rng.uniform(0.2, 5, AREAS.noise.shape), shared_noise=rng.uniform(1e-6, 1e-4, 34)
    )
    now = initial_state(unlike, (1,))
    zero = np.zeros((1, 15))
    now = take(
        predict(unlike, now, zero, zero, 0.0, "corrected"), rng.standard_normal((1, 15, 4)), rng.standard_normal((1, 34))
    )
    ahead = predict(unlike, now, zero, zero, 0.0, "corrected")
    np.testing.assert_array_equal(ahead.estimate_shared, ahead.estimate[:, AT.neighbour, 0])
    i = AT.index("5")
    copies = AREAS.opposite[AREAS.network.sides(i)]
    v = np.array([unlike.noise[i, 0], *unlike.shared_noise[copies]])
    y = np.array([now.held[0, i, 0], *now.held_shared[0, copies]])
    a, drive = unlike.matrices[i, 0, 0], ahead.estimate[0, i, 0] - unlike.matrices[i, 0, 0] * np.sum(y / v) / np.sum(1 / v)
    only = Diagnosers(*(x.copy() for x in now))
    only.held[0, i, 0], only.held_shared[0, copies] = 0.0, 0.0
    np.testing.assert_allclose(predict(unlike, only, zero, zero, 0.0, "corrected").estimate[0, i, 0], drive, atol=1e-12)
    floor = ahead.deviation[0, i, 0] ** 2
    for _ in range(20):  # any other weights give a larger variance
        W = rng.dirichlet(np.ones(v.size))
        assert floor - a**2 / np.sum(1 / v) + a**2 * np.sum(W**2 * v) >= floor


def test_an_area_reads_nothing_but_its_own_and_what_neighbours_tell() -> None:
    rng, i = np.random.default_rng(1), AT.index("5")
    count = AREAS.size[0]
    whole = Diagnosers(*(rng.uniform(0.0, 1.0, a.shape) for a in initial_state(AREAS, (2,))))
    reference, load = rng.standard_normal((2, 2, count))
    near = AT.neighbour[AREAS.network.sides(i)]
    about = np.isin(AT.neighbour, [i, *near])  # copies of the states that area 5 shares
    mine, theirs = AT.node == i, np.isin(AT.node, near)
    poisoned = []
    for k, a in enumerate(whole):
        keep = np.zeros(a.shape, bool)
        if a.ndim == 3:
            keep[:, i] = True
            keep[:, near, 0] = True  # brackets of what they share
            if k in (0, 2):
                keep[:, near] = True  # in the drive, with the readings at their other sides
        else:
            keep[:, about | mine] = True
            if k in (1, 3):
                keep[:, theirs] = True
        poisoned.append(np.where(keep, a, np.nan))
    known = np.isin(np.arange(count), [i, *near])
    for mode in MODES:
        clean = predict(AREAS, whole, reference, load, LAM, mode)
        dirty = predict(
            AREAS, Diagnosers(*poisoned), np.where(known, reference, np.nan), np.where(known, load, np.nan), LAM, mode
        )
        for name in ("estimate", "deviation", "doubt"):
            np.testing.assert_array_equal(getattr(dirty, name)[:, i], getattr(clean, name)[:, i])
            np.testing.assert_array_equal(getattr(dirty, name + "_shared")[:, mine], getattr(clean, name + "_shared")[:, mine])
        assert np.isnan(dirty.estimate).any()


def test_of_a_drive_one_number_crosses_the_border() -> None:
    rng, i = np.random.default_rng(2), AT.index("5")
    j = int(AT.neighbour[AREAS.network.sides(i)][0])
    whole = Diagnosers(*(rng.uniform(0.0, 1.0, a.shape) for a in initial_state(AREAS, (1,))))
    reference, load = rng.standard_normal((2, 1, 15))
    other, given = Diagnosers(*(a.copy() for a in whole)), reference.copy()
    other.held[0, j, 1:] += [1.0, -2.0, 3.0]
    given[0, j] -= AREAS.matrices[j, 0, 1:4] @ [1.0, -2.0, 3.0] / AREAS.matrices[j, 0, 4]  # the drive is the same
    a, b = (predict(AREAS, w, r, load, LAM, "corrected") for w, r in ((whole, reference), (other, given)))
    mine = AT.node == i
    tolerance = 100 * np.finfo(float).eps * np.abs(given).max()
    np.testing.assert_allclose(b.estimate[0, i], a.estimate[0, i], rtol=0, atol=tolerance)
    np.testing.assert_allclose(b.estimate_shared[0, mine], a.estimate_shared[0, mine], rtol=0, atol=tolerance)
    assert abs(b.estimate[0, j, 1] - a.estimate[0, j, 1]) > 0.1


def test_a_copy_starts_from_its_first_reading_and_an_open_tie_has_none() -> None:
    away = network_areas(network_model(unplugged=["4"]))
    now = initial_state(away, (1,))
    zero, y = np.zeros((1, 15)), np.random.default_rng(4).standard_normal((1, 15, 4))
    shared = np.where(away.network.closed, 0.5, np.nan)[None]
    first = predict(away, now, zero, zero, LAM, "corrected")
    assert np.all(first.deviation > 1e50) and np.all(first.deviation_shared > 1e50)
    now = take(first, y, shared)
    np.testing.assert_array_equal(now.held, y)
    assert not now.residual.any() and not now.doubt.any()
    second = predict(away, now, zero, zero, LAM, "corrected")
    assert np.all(second.deviation < 1.0)
    np.testing.assert_array_equal(second.deviation_shared[0] < 1.0, away.network.closed)


def test_equations_take_scalars_and_arrays() -> None:
    assert equations.noise_read(2.0, 0.0) == 2.0 and equations.noise_read(2.0, 0.1) == 0.0
    assert equations.precision_read(4.0, 0.0) == 0.25 and equations.precision_read(4.0, 2.0) == 0.25
    assert equations.shared_term(2.0, 3.0, 1.0, 0.5, 0.3) == pytest.approx(3.7)
    np.testing.assert_array_equal(equations.private_term(np.ones(3), np.ones(3), 0.5), np.full(3, 0.5))
    assert equations.printed_variance(2.0, 0.0, 0.5, 1.0, 4.0) == 0.5 + 1.0 + 4.0 + 2.0
    assert equations.precision_printed(2.0, 0.0, 0.5, 1.0, 4.0) == 1 / 7.5
    # of an estimate the doubt stands for the noise of the reading, which counts besides as that of the next
    assert equations.precision_printed(2.0, 3.0, 0.5, 1.0, 4.0) == 1 / (0.25 * 9.0 + 1.0 + 4.0 + 2.0)
    assert equations.error_deviation(0.25, 3.0, 1.0, 0.5) == 2.75
    assert equations.residual_deviation(0.25, 3.0, 1.0, 5.0, 0.5) == 3.75


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"shared_gain": AREAS.shared_gain + np.eye(34)[3]}, "areas 5 and 2 share theta_5 and model it differently"),
        ({"noise": AREAS.noise * 0}, "of readings positive"),
        ({"slope": AREAS.slope[:-1]}, r"slope of 15 areas has shape .33,.; expected .34,."),
        ({"network": AREAS.network.switched(unplug=["4"])}, "the open tie 3-4 has a slope"),
        ({"matrices": np.full_like(AREAS.matrices, np.nan)}, "finite numbers"),
    ],
)
def test_areas_that_cannot_be(change: dict[str, Array], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(AREAS, **change)


def test_the_place_of_a_sensor() -> None:
    assert AREAS.place("omega_3", "area 3") == 9
    sides = {(AT.names[AT.node[s]], AT.names[AT.neighbour[s]]): s for s in range(34)}
    assert AREAS.place("theta_5", "area 4") == 60 + sides["4", "5"]
    with pytest.raises(ValueError, match="owned by 'area 9'"):
        AREAS.place("theta_5", "area 9")
    assert isinstance(AREAS, Areas)
