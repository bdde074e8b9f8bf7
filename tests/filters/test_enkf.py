"""Laws of the ensemble Kalman filters."""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rounding import rounding
from scipy.integrate import quad

from fusion_sfdia.filters import enkf
from fusion_sfdia.filters.enkf import EnKFSettings, Method
from fusion_sfdia.filters.gaussian import condition

Array = NDArray[Any]

NAN = np.nan
METHODS: tuple[Method, ...] = ("stochastic", "deterministic", "square-root")
n, N = 5, 4
H = np.random.default_rng(9).standard_normal((N, n))
R = np.array([0.1, 0.4, 0.2, 0.3])


def h(x: Array) -> Array:
    return np.asarray(x @ H.T)


def ensemble(size: int, *batch: int) -> Array:
    return np.random.default_rng(3).standard_normal((*batch, size, n)) * np.arange(1, n + 1)


def near(E: Array, noise: Array = R, operations: int = 4 * (n + N)) -> dict[str, float]:
    """What rounding allows of members and moments after updates of E, which solve with S."""
    joint = enkf.joint(E, h, noise)
    size = max(np.abs(joint.P).max(), np.abs(joint.C).max(), np.abs(E).max())
    return {"rtol": 0.0, "atol": rounding(size * np.linalg.cond(joint.S).max(), operations)}


def moments(E: Array) -> tuple[Array, Array]:
    A = E - E.mean(-2, keepdims=True)
    return E.mean(-2), np.swapaxes(A, -1, -2) @ A / (E.shape[-2] - 1)


def readings(*batch: int) -> Array:
    """In the first element of a batch none is missing, in the last all are."""
    y = np.random.default_rng(4).standard_normal((*batch, N))
    y[1::2, 1], y[2::2, 0], y[-1] = NAN, NAN, NAN
    return y


@pytest.mark.parametrize("size", [3, 12])
@pytest.mark.parametrize("full", [False, True])
def test_square_root_has_exactly_the_moments_of_the_kalman_update(size: int, full: bool) -> None:
    """Of fewer and of more members than states and readings; R as a diagonal and as a matrix."""
    noise = np.diag(R) + 0.05 if full else R
    E, y = ensemble(size, 4), readings(4)
    joint = enkf.joint(E, h, noise)
    expected = condition(joint, y)
    got = moments(enkf.update(EnKFSettings(size, "square-root"), E, h, y, noise, np.random.default_rng(0)))
    np.testing.assert_allclose(got[0], expected.x, **near(E, noise))
    np.testing.assert_allclose(got[1], expected.P, **near(E, noise))


@pytest.mark.parametrize("method", METHODS)
def test_the_mean_moves_by_the_kalman_gain(method: Method) -> None:
    """With centred perturbations the mean of the members is that of the Kalman update by the sample's moments, exactly."""
    E, y = ensemble(8, 4), readings(4)
    got = enkf.update(EnKFSettings(8, method), E, h, y, R, np.random.default_rng(0)).mean(-2)
    np.testing.assert_allclose(got, condition(enkf.joint(E, h, R), y).x, **near(E))


def test_the_deterministic_anomalies_move_by_half_the_gain() -> None:
    """A - K H A / 2 (Sakov and Oke 2008), hence P - K H P + K H P H' K' / 4."""
    E, y = ensemble(8), readings(1)[0] * 0 + 1.0
    y[:] = [0.5, NAN, 1.0, -1.0]
    joint = enkf.joint(E, h, R)
    found = condition(joint, y)
    K = joint.C @ found.inverse
    new = enkf.update(EnKFSettings(8, "deterministic"), E, h, y, R, np.random.default_rng(0))
    A = E - E.mean(0)
    np.testing.assert_allclose(new - new.mean(0), A - 0.5 * h(A) @ K.T, **near(E))


def test_the_stochastic_covariance_approaches_the_kalman_filters() -> None:
    """Over 400 updates of one large ensemble, the mean covariance is within 5 standard errors and a bias of 2 / size."""
    size, repeats = 200, 400
    E = ensemble(size)
    y = np.array([0.5, NAN, 1.0, -1.0])
    expected = condition(enkf.joint(E, h, R), y).P
    batch = np.broadcast_to(E, (repeats, size, n))
    got = moments(enkf.update(EnKFSettings(size), batch, h, y, R, np.random.default_rng(0)))[1]
    error = got.mean(0) - expected
    allowed = 5 * got.std(0) / np.sqrt(repeats) + 2 * np.sqrt(np.outer(np.diagonal(expected), np.diagonal(expected))) / size
    assert np.all(np.abs(error) < allowed)


@pytest.mark.parametrize("method", METHODS)
def test_a_missing_reading_is_no_reading_and_does_not_shift_the_stream(method: Method) -> None:
    E, y = ensemble(9), np.array([0.5, NAN, 1.0, -1.0])
    rng, other = np.random.default_rng(0), np.random.default_rng(0)
    with_gap = enkf.update(EnKFSettings(9, method), E, h, y, R, rng)
    enkf.update(EnKFSettings(9, method), E, h, np.ones(N), R, other)
    assert rng.standard_normal() == other.standard_normal()
    far = enkf.update(EnKFSettings(9, method), E, h, np.nan_to_num(y, nan=3.0), R * [1, 1e30, 1, 1], np.random.default_rng(0))
    np.testing.assert_allclose(with_gap, far, **near(E))  # a reading of infinite noise has as little effect, in any method


@pytest.mark.parametrize(("method", "localised"), [*((m, False) for m in METHODS), *((m, True) for m in METHODS[:2])])
def test_without_readings_the_members_stay(method: Method, localised: bool) -> None:
    taper = enkf.taper(np.arange(n), np.arange(N), 2.0) if localised else None
    settings = EnKFSettings(6, method, inflation=1.2, localisation=taper)
    E = ensemble(6, 2)
    new = enkf.update(settings, E, h, np.full((2, N), NAN), R, np.random.default_rng(0))
    np.testing.assert_allclose(new, E, rtol=0, atol=rounding(np.abs(E).max(), 6))  # mean and anomalies, added again


@pytest.mark.parametrize("method", ["stochastic", "deterministic"])
def test_a_taper_of_ones_changes_nothing(method: Method) -> None:
    """The gain in the space of readings equals the one in the space of members (Woodbury)."""
    ones = enkf.Taper(np.ones((n, N)), np.ones((N, N)))
    E, y = ensemble(7, 4), readings(4)
    for noise in (R, np.diag(R) + 0.05):
        plain = enkf.update(EnKFSettings(7, method), E, h, y, noise, np.random.default_rng(0))
        tapered = enkf.update(EnKFSettings(7, method, localisation=ones), E, h, y, noise, np.random.default_rng(0))
        np.testing.assert_allclose(tapered, plain, **near(E, noise))


def test_a_reading_out_of_reach_changes_nothing() -> None:
    taper = enkf.taper(np.arange(n) * 10.0, np.array([0.0]), 2.0)
    E = ensemble(7)
    settings = EnKFSettings(7, localisation=taper)
    new = enkf.update(settings, E, lambda s: s[..., :1], np.array([5.0]), np.array([0.1]), np.random.default_rng(0))
    np.testing.assert_allclose(new[:, 1:], E[:, 1:], rtol=0, atol=rounding(np.abs(E).max(), 7))
    assert np.all(np.abs(new[:, 0] - E[:, 0]) > 0)


def test_rotation_keeps_mean_and_covariance_and_is_orthogonal() -> None:
    turn = enkf.rotation(7, np.random.default_rng(0), (3,))
    np.testing.assert_allclose(
        turn @ np.swapaxes(turn, -1, -2), np.broadcast_to(np.eye(7), (3, 7, 7)), rtol=0, atol=rounding(1, 4 * 7)
    )
    np.testing.assert_allclose(turn.sum(-1), 1.0, rtol=0, atol=rounding(7**0.5, 4 * 7))
    E, y = ensemble(7, 3), readings(3)
    rng = np.random.default_rng(0)
    plain = moments(enkf.update(EnKFSettings(7, "square-root"), E, h, y, R, rng))
    turned = moments(enkf.update(EnKFSettings(7, "square-root", rotate=True), E, h, y, R, rng))
    np.testing.assert_allclose(turned[0], plain[0], **near(E))
    np.testing.assert_allclose(turned[1], plain[1], **near(E))


def test_rotations_are_uniform() -> None:
    """The mean of many is the projection on the ones; each entry's variance is below 1 / (size - 1)."""
    turn = enkf.rotation(5, np.random.default_rng(0), (4000,))
    np.testing.assert_allclose(turn.mean(0), np.full((5, 5), 0.2), atol=5 * np.sqrt(1 / 4 / 4000))


@pytest.mark.parametrize("method", METHODS)
def test_inflation_scales_the_anomalies(method: Method) -> None:
    E, y = ensemble(7), np.ones(N)
    plain = moments(enkf.update(EnKFSettings(7, method), E, h, y, R, np.random.default_rng(0)))
    inflated = moments(enkf.update(EnKFSettings(7, method, inflation=1.1), E, h, y, R, np.random.default_rng(0)))
    np.testing.assert_allclose(inflated[0], plain[0], **near(E))
    np.testing.assert_allclose(inflated[1], plain[1] * 1.21, **near(E))


def test_prediction_adds_process_noise() -> None:
    """The variance added to 20 000 members is Q within 5 standard errors, Q sqrt(2 / members); none where Q is zero."""
    E, Q = np.zeros((20_000, 2)), np.array([0.25, 0.0])
    new = enkf.predict(E, lambda s: s + 1.0, Q, np.random.default_rng(0))
    assert abs(new[:, 0].var() - 0.25) < 5 * 0.25 * np.sqrt(2 / 20_000)
    np.testing.assert_array_equal(new[:, 1], 1.0)


def test_gaspari_cohn_is_a_correlation_with_compact_support() -> None:
    z = np.linspace(0, 3, 301)
    rho = enkf.gaspari_cohn(z, 1.0)
    assert rho[0] == 1.0 and np.all(np.diff(rho) <= 0) and np.all(rho[z >= 2] == 0)
    assert enkf.gaspari_cohn(np.array(1.0), 1.0) == pytest.approx(5 / 24)  # both branches of (4.10) at 1
    assert enkf.gaspari_cohn(np.array(1.0 + 1e-12), 1.0) == pytest.approx(5 / 24)
    circle = enkf.taper(np.arange(40.0), np.arange(0.0, 40.0, 3), 4.0, period=40.0)
    np.testing.assert_allclose(circle.cross[39, 0], enkf.gaspari_cohn(np.array(1.0), 4.0))
    assert np.linalg.eigvalsh(enkf.taper(np.arange(40.0), np.arange(40.0), 4.0, period=40.0).cross)[0] > -1e-12


@pytest.mark.parametrize("distance", [0.5, 2.0, 3.5, 4.5, 6.0, 7.5])
def test_gaspari_cohn_is_the_self_convolution_of_a_cone_in_space(distance: float) -> None:
    """Of B(s) = 1 - s / radius: (2 pi / r) int s B(s) int_|r - s|^(r + s) t B(t) dt ds, over that at 0, 2 pi radius^3 / 15."""
    radius = 4.0

    def moment(t: float) -> float:
        """int_0^t s B(s) ds."""
        t = min(t, radius)
        return t**2 / 2 - t**3 / (3 * radius)

    def inner(s: float) -> float:
        return s * (1 - s / radius) * (moment(distance + s) - moment(abs(distance - s)))

    kinks = [s for s in (distance, abs(distance - radius)) if 0 < s < radius]
    total = quad(inner, 0.0, radius, points=kinks or None, epsabs=1e-12, epsrel=1e-12)[0]
    expected = 2 * np.pi / distance * total / (2 * np.pi * radius**3 / 15)
    assert enkf.gaspari_cohn(np.array(-distance), radius) == pytest.approx(expected, abs=1e-12)  # of the quadrature


def test_many_states_few_members() -> None:
    """6003 states and readings: a matrix of either size takes 288 MB, the members 1 MB; the update needs copies of those."""
    size, many = 20, 6003
    rng = np.random.default_rng(0)
    E = rng.standard_normal((size, many))
    y = np.where(rng.random(many) < 0.1, NAN, 0.0)
    for method in METHODS:
        tracemalloc.start()
        new = enkf.update(EnKFSettings(size, method), E, lambda s: s, y, np.full(many, 0.5), np.random.default_rng(1))
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 30e6
        assert np.linalg.norm(new.mean(0)[np.isfinite(y)]) < np.linalg.norm(E.mean(0)[np.isfinite(y)])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"size": 1}, "ensemble of 1; a covariance needs at least 2"),
        ({"method": "cubist"}, "unknown EnKF method 'cubist'; known: stochastic, deterministic, square-root"),
        ({"inflation": 0.0}, "inflation is 0.0; it must be positive"),
        ({"method": "square-root", "localisation": enkf.Taper(np.ones((1, 1)), np.ones((1, 1)))}, "use method 'deterministic'"),
    ],
)
def test_bad_settings(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        EnKFSettings(**options)


def test_two_members_are_an_ensemble() -> None:
    assert EnKFSettings(2).size == 2


def test_an_ensemble_of_another_size() -> None:
    with pytest.raises(ValueError, match="E has 6 members, the settings 7"):
        enkf.update(EnKFSettings(7), ensemble(6), h, np.ones(N), R, np.random.default_rng(0))
