"""Ensemble Kalman filters: stochastic, deterministic and square-root, computed in the space of the members.

With anomalies A (members less mean, one a row) of the state and Y of the predicted readings, Ne members, S = Y'Y/(Ne-1) + R:

    K = A'Y/(Ne-1) S^-1 = A' M^-1 Y R^-1,    M = (Ne - 1) I + Y R^-1 Y'

so that only an Ne x Ne matrix of full rank is factorised, and no n x n or N x N matrix is formed. A missing
reading has weight R^-1 = 0. One generator serves a whole batch: draws are (*batch, Ne, ...), so the numbers of a run depend
on the batch that contains it. Call the functions run by run where they must not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import number, whole
from fusion_sfdia.filters.gaussian import Joint, add, half_inverse, inverse, sample, whiten

Array = NDArray[Any]
Model = Callable[[Array], Array]
Method = Literal["stochastic", "deterministic", "square-root"]


class Taper(NamedTuple):
    """Factors between 0 and 1 on sample covariances: cross (n, N) of states and readings, readings (N, N) of readings."""

    cross: Array
    readings: Array


@dataclass(frozen=True)
class EnKFSettings:
    """size: members. method: "stochastic" (perturbed readings, Burgers 1998), "deterministic" (Sakov and Oke 2008) or
    "square-root" (symmetric transform, Bishop 2001, Hunt 2007). inflation: factor on the anomalies after each update.
    rotate: rotate the anomalies at random, which keeps mean and covariance. localisation: see `taper`; not with "square-root".
    """

    size: int = 40
    method: Method = "stochastic"
    inflation: float = 1.0
    rotate: bool = False
    localisation: Taper | None = None

    def __post_init__(self) -> None:
        if whole("size of the ensemble", self.size, least=1) < 2:
            raise ValueError(f"an ensemble of {self.size}; a covariance needs at least 2 members")
        if self.method not in get_args(Method):
            raise ValueError(f"unknown EnKF method {self.method!r}; known: {', '.join(get_args(Method))}")
        if not number("inflation", self.inflation) > 0:
            raise ValueError(f"inflation is {self.inflation}; it must be positive, 1 for none")
        if self.localisation is not None and self.method == "square-root":
            raise ValueError("the square-root update takes no localisation; use method 'deterministic' or 'stochastic'")


def predict(E: Array, f: Model, Q: Array, rng: np.random.Generator) -> Array:
    """Return the members E (..., Ne, n) after a step: f(E) + w, w drawn from N(0, Q) for each; Q (n,) or (n, n)."""
    noise = sample(Q, rng, E.shape[:-1])
    return np.add(f(E), noise, out=noise)


def moments(E: Array) -> tuple[Array, Array]:
    """Return the sample mean (..., n) and covariance (..., n, n) of the members; it is singular for Ne <= n."""
    x = np.mean(E, axis=-2)
    A = E - x[..., None, :]
    return x, np.swapaxes(A, -1, -2) @ A / (E.shape[-2] - 1)


def joint(E: Array, h: Model, R: Array) -> Joint:
    """Return the sample moments of state and readings, S with R (N,) or (N, N) added; P is singular for Ne <= n."""
    A, Y, x, y = _anomalies(E, h(E))
    over = E.shape[-2] - 1
    At, Yt = np.swapaxes(A, -1, -2), np.swapaxes(Y, -1, -2)
    return Joint(x, At @ A / over, y, add(Yt @ Y / over, R), At @ Y / over)


def update(settings: EnKFSettings, E: Array, h: Model, y: Array, R: Array, rng: np.random.Generator) -> Array:
    """Return the members (..., Ne, n) after the readings y (..., N), NaN where missing; R is (N,) or (N, N).

    Numbers are drawn for missing readings too, so that a gap does not shift the stream. Without any reading the members
    do not change and are not inflated.
    """
    size = E.shape[-2]
    if size != settings.size:
        raise ValueError(f"E has {size} members, the settings {settings.size}; give an ensemble of that size")
    HE = h(E)
    A, Y, x, y_mean = _anomalies(E, HE)
    used = np.isfinite(y)
    innovation = np.where(used, y, y_mean) - y_mean
    shift = innovation[..., None, :]
    if settings.method == "stochastic":
        noise = sample(R, rng, HE.shape[:-1])
        mean = np.mean(noise, axis=-2, keepdims=True)
        noise += Y
        noise -= mean
        shift = np.subtract(shift, noise, out=noise)
    if settings.localisation is not None:
        new_x, new_A = _localised(settings, A, Y, shift, R, used)
    else:
        new_x, new_A = _in_member_space(settings, A, Y, shift, R, used)
    if settings.rotate:
        new_A = rotation(size, rng, E.shape[:-2]) @ new_A
    new_A *= np.where(np.any(used, axis=-1), settings.inflation, 1.0)[..., None, None]
    new_A += (x + new_x)[..., None, :]
    return new_A


def _anomalies(E: Array, HE: Array) -> tuple[Array, Array, Array, Array]:
    x, y = np.mean(E, axis=-2), np.mean(HE, axis=-2)
    return E - x[..., None, :], HE - y[..., None, :], x, y


def _in_member_space(settings: EnKFSettings, A: Array, Y: Array, shift: Array, R: Array, used: Array) -> tuple[Array, Array]:
    """Return the change of the mean (..., n) and the new anomalies (..., Ne, n)."""
    over = A.shape[-2] - 1
    Y, shift = whiten(Y, R, used), whiten(shift, R, used)
    Yt = np.swapaxes(Y, -1, -2)
    M = Y @ Yt
    np.einsum("...ii->...i", M)[...] += over
    if settings.method == "square-root":
        sound = np.all(np.isfinite(M), axis=(-2, -1), keepdims=True)  # LAPACK fails for the whole batch otherwise
        values, vectors = np.linalg.eigh(np.where(sound, M, np.eye(M.shape[-1])))
        vt = np.swapaxes(vectors, -1, -2)
        weights = ((shift @ Yt @ vectors) / values[..., None, :]) @ vt
        transform = (vectors * np.sqrt(over / values)[..., None, :]) @ vt
        return (weights @ A)[..., 0, :], transform @ A
    M_inv = inverse(M)
    change = (shift @ Yt @ M_inv) @ A
    if settings.method == "deterministic":  # A - K Y / 2, and Y R^-1 Y' M^-1 = I - (Ne - 1) M^-1
        return change[..., 0, :], 0.5 * A + (0.5 * over) * (M_inv @ A)
    mean = np.mean(change, axis=-2)
    change += A
    change -= mean[..., None, :]
    return mean, change


def _localised(settings: EnKFSettings, A: Array, Y: Array, shift: Array, R: Array, used: Array) -> tuple[Array, Array]:
    """The same with tapered sample covariances: K = (taper o A'Y) (taper o Y'Y + R)^-1."""
    taper, over = settings.localisation, A.shape[-2] - 1
    assert taper is not None
    Yt = np.swapaxes(Y, -1, -2)
    S = add(taper.readings * (Yt @ Y) / over, R)
    C = taper.cross * (np.swapaxes(A, -1, -2) @ Y) / over
    U = half_inverse(S, used)
    Kt = U @ np.swapaxes(C @ U, -1, -2)
    change = shift @ Kt
    if settings.method == "deterministic":
        return change[..., 0, :], A - 0.5 * (Y @ Kt)
    mean = np.mean(change, axis=-2)
    return mean, A + change - mean[..., None, :]


def rotation(size: int, rng: np.random.Generator, batch: tuple[int, ...] = ()) -> Array:
    """Random orthogonal matrices (*batch, size, size) that keep the vector of ones: they rotate anomalies and keep the mean."""
    q, r = np.linalg.qr(rng.standard_normal((*batch, size - 1, size - 1)))
    q = q * np.sign(np.diagonal(r, axis1=-2, axis2=-1))[..., None, :]
    ones = np.full((size, 1), 1.0)
    basis = np.linalg.qr(np.hstack([ones, np.eye(size)[:, 1:]]))[0][:, 1:]
    return np.asarray(basis @ q @ basis.T + ones @ ones.T / size)


def gaspari_cohn(distance: Array, radius: float) -> Array:
    """The fifth-order compact correlation of Gaspari and Cohn 1999, (4.10): 1 at 0, 0 from 2 radius on."""
    z = np.abs(distance) / radius
    near = 1 - 5 / 3 * z**2 + 5 / 8 * z**3 + z**4 / 2 - z**5 / 4
    far_z = np.clip(z, 1.0, 2.0)
    far = 4 - 5 * far_z + 5 / 3 * far_z**2 + 5 / 8 * far_z**3 - far_z**4 / 2 + far_z**5 / 12 - 2 / (3 * far_z)
    return np.where(z <= 1, near, np.where(z < 2, np.maximum(far, 0.0), 0.0))


def taper(states: Array, readings: Array, radius: float, period: float = np.inf) -> Taper:
    """Return the Gaspari-Cohn taper for positions of states (n,) and readings (N,), on a line or a circle of that period."""

    def factors(a: Array, b: Array) -> Array:
        apart = np.abs(a[:, None] - b)
        return gaspari_cohn(apart if np.isinf(period) else np.minimum(apart % period, -apart % period), radius)

    return Taper(factors(states, readings), factors(readings, readings))
