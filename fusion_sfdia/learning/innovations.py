"""The extended Kalman filter over a healthy log, sample by sample, and how well it predicts: likelihood, NIS, whiteness.

What may be learnt is held at its value while the filter runs; how the innovations depend on it follows from sensitivities, as
in the separated bias filter (Friedland 1969, Treatment of bias in recursive filtering).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import whole
from fusion_sfdia.common.covariance import diagonal
from fusion_sfdia.filters.estimators import UNUSED, Extended, GaussianState, Prior
from fusion_sfdia.filters.gaussian import Joint, half_inverse, rounding
from fusion_sfdia.filters.sums import difference
from fusion_sfdia.logs.log_forms import as_log
from fusion_sfdia.plant.augment import augment, fixed
from fusion_sfdia.plant.gaps import bridged, parted
from fusion_sfdia.plant.log import Log, one_run
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

STEADY = 100  # samples until the gain is taken as steady
LAGS = 20  # of autocorrelations
WARM_UP = 10  # samples after the start of a run that are not judged
LONGEST = 1000  # samples that are stepped as one run
FORGOTTEN = 0.05  # share of an error of the first estimate that is left after settling


@dataclass(frozen=True, eq=False)
class InnovationStep:
    """One step of the filter, of each run (B, ...).

    x (B, n): the estimate after the readings. tangent F (B, n, n), readout H (B, N, n), half U (B, N, N) with U U' = S^-1, zero
    for readings that are missing, gain_half C U (B, n, N). normal (B, N): the innovation in independent units, U' d. used
    (B, N). log_likelihood (B,) of the readings. standard (B, N): innovations over their standard deviations, NaN where missing.
    The others follow from these, where they are asked for.
    """

    x: Array
    tangent: Array
    readout: Array
    half: Array
    gain_half: Array
    normal: Array
    used: Array
    log_likelihood: Array
    standard: Array

    @cached_property
    def whitened(self) -> Array:
        """S^-1 d (B, N)."""
        return np.asarray((self.half @ self.normal[..., None])[..., 0])

    @cached_property
    def inverse(self) -> Array:
        """S^-1 (B, N, N)."""
        return np.asarray(self.half @ np.swapaxes(self.half, -1, -2))

    @cached_property
    def gain(self) -> Array:
        """K (B, n, N)."""
        return np.asarray(self.gain_half @ np.swapaxes(self.half, -1, -2))

    @cached_property
    def closed(self) -> Array:
        """I - K H (B, n, n)."""
        return np.asarray(np.eye(self.x.shape[-1]) - self.gain @ self.readout)

    @property
    def single(self) -> Array:
        """The error of each reading (B, N) predicted from all others, over its standard deviation; NaN where missing."""
        precision = np.sum(self.half**2, axis=-1)
        return np.where(self.used, self.whitened / np.sqrt(np.where(self.used, precision, 1.0)), np.nan)


def held(plant: Plant) -> Plant:
    """The augmented plant whose parameters and errors of inputs keep their value: without variance, without noise.

    Its disturbances are estimated.
    """
    known = plant.uncertainty
    frozen = tuple(replace(p, treatment="frozen") for p in known.parameters)
    model = augment(replace(plant, uncertainty=replace(known, parameters=frozen, at_rest=False)))
    n, p, m = len(plant.states), len(known.parameters), len(known.inputs)
    cov = model.initial_cov.copy()
    if cov.ndim == 1:
        cov[n + p : n + p + m] = 0.0
    else:
        cov[n + p : n + p + m] = cov[:, n + p : n + p + m] = 0.0
    return replace(model, initial_cov=cov)


def until(log: Log, use: Array) -> Log:
    """The log up to the last sample that is used (K,)."""
    last = int(np.flatnonzero(use)[-1]) + 1
    return log.rows(slice(last))


class InnovationUpdate(NamedTuple):
    """One update of the filter: prior and joint Gaussian, readings y (B, N) on the turn of what is expected, used (B, N), U and
    C U as in `InnovationStep`, normal U' d (B, N), and the state after it.
    """

    prior: Prior
    joint: Joint
    y: Array
    used: Array
    half: Array
    normal: Array
    gain_half: Array
    after: GaussianState


def updated(model: Plant, core: GaussianState, t_start: float, dt: float, y: Array, u: Array) -> InnovationUpdate:
    """The extended filter over [t_start, t_start + dt] and its update by y (B, N), NaN where missing, under u (B, m)."""
    filter_ = Extended()
    prior = filter_.predict(model, core, t_start, u, dt, UNUSED)
    joint = filter_.joint(model, prior, t_start + dt, u)
    y = model.near(y, joint.y)
    used = np.isfinite(y)
    half = half_inverse(joint.S, used)
    normal = (np.swapaxes(half, -1, -2) @ np.where(used, y - joint.y, 0.0)[..., None])[..., 0]
    gain_half = joint.C @ half
    x = joint.x + (gain_half @ normal[..., None])[..., 0]
    p = difference(joint.P, gain_half @ np.swapaxes(gain_half, -1, -2), rounding(joint))
    return InnovationUpdate(prior, joint, y, used, half, normal, gain_half, GaussianState(x, p))


def filtered(model: Plant, log: Log) -> Iterator[InnovationStep]:
    """Yield the samples of a filter on the plant, started at its x0, over a log of runs: t (K,), y (K, B, N), u (K, B, m).

    ValueError where the model gives no finite value.
    """
    core = Extended().start(model, log.y.shape[1:-1], UNUSED)
    before = float(log.t[0]) - model.dt
    for t, y, u in zip(log.t.tolist(), log.y, log.u, strict=True):
        model.check_dt(t - before)
        prior, joint, y, used, half, normal, gain_half, core = updated(model, core, before, t - before, y, u)
        x = core.x
        if not np.all(np.isfinite(x)):
            where = "the healthy log" if log.y.shape[1] == 1 else f"one of the {log.y.shape[1]} stretches of the healthy log"
            raise ValueError(
                f"the filter on plant {model.name!r} diverges {t - float(log.t[0]):g} s after the beginning of {where}; check "
                "its inputs and units, and that it starts near the plant's x0"
            )
        assert prior.tangent is not None and joint.H is not None
        readout = np.broadcast_to(joint.H, np.swapaxes(joint.C, -1, -2).shape)
        scale = np.where(used, np.diagonal(half, axis1=-2, axis2=-1), 1.0)
        log_likelihood = np.sum(np.log(scale) - used * np.log(2 * np.pi) / 2 - normal**2 / 2, axis=-1)
        standard = (y - joint.y) / np.sqrt(np.diagonal(joint.S, axis1=-2, axis2=-1))
        yield InnovationStep(x, prior.tangent, readout, half, gain_half, normal, used, log_likelihood, standard)
        before = t


def settling(model: Plant, log: Log) -> int:
    """The number of samples after which the filter has forgotten its first estimate, from its steady gain.

    An error of the estimate is multiplied by (I - K H) F in each step, in the end by the largest eigenvalue of that product.
    """
    *_, last = filtered(model, log.rows(slice(STEADY)))
    moving = diagonal(model.process_cov) + diagonal(model.initial_cov) > 0
    loop = (last.closed @ last.tangent)[..., moving, :][..., moving]
    slowest = np.max(np.abs(np.linalg.eigvals(loop)))
    return int(np.ceil(np.log(FORGOTTEN) / np.log(slowest))) if slowest < 1 else len(log.t)


class FilterScore(NamedTuple):
    """Of each sample (K, B): log_likelihood, nis (normalised innovation squared per reading), normal (K, B, N) innovations.

    single (K, B, N): errors of each reading predicted from all others, over their standard deviations.
    """

    log_likelihood: Array
    nis: Array
    normal: Array
    single: Array


def fitted(plant: Plant, log: Log) -> FilterScore:
    """Run the filter of a plant and its disturbances over a log of runs."""
    likelihood, nis, normal, single = [], [], [], []
    for now in filtered(fixed(plant), log):
        likelihood.append(now.log_likelihood)
        nis.append(np.sum(now.normal**2, axis=-1) / np.maximum(np.sum(now.used, axis=-1), 1))
        normal.append(np.where(now.used, now.normal, np.nan))
        single.append(now.single)
    return FilterScore(np.stack(likelihood), np.stack(nis), np.stack(normal), np.stack(single))


def coloured(normal: Array) -> float:
    """Return the share of autocorrelations of innovations (K, B, N), lags 1 to 20, outside their 95 % bands: .05 if white."""
    count, outside, total = len(normal), 0, 0
    filled = np.nan_to_num(normal)
    power = np.mean(filled**2, axis=0)
    for lag in range(1, min(LAGS, count // 4) + 1):
        r = np.sum(filled[lag:] * filled[:-lag], axis=0) / (count * np.where(power > 0, power, 1.0))
        outside += int(np.sum(np.abs(r) > 1.96 / np.sqrt(count)))
        total += int(np.sum(power > 0))
    return outside / max(total, 1)


class WhitenessTest(NamedTuple):
    """Statistics of the innovations of a filter.

    Attributes
    ----------
    nis : float
        Normalised innovation squared per reading, 1 where the covariances are right.
    variance : array (N,)
        Of the standardised innovations of each sensor, 1 as well.
    autocorrelation : array (N,)
        At the sensor's next reading one step later, 0 where white.
    pairs : array (N,) of int
        The number of products behind it. A white innovation's autocorrelation has the standard error 1 / sqrt(pairs).

    Examples
    --------
    See `whiteness`.
    """

    nis: float
    variance: Array
    autocorrelation: Array
    pairs: Array


def whiteness(plant: Plant, *healthy: Any, warm_up: int = 20) -> WhitenessTest:
    """Return the statistics of the innovations of the extended Kalman filter after the first samples of one run.

    Parameters
    ----------
    plant : Plant
        The model.
    *healthy : arrays, Log, Recording or frame
        As `as_log` takes it, not the recording that the plant was identified from.
    warm_up : int, default 20
        Samples that are left out at the beginning, and after a gap at which the filter starts anew.

    Returns
    -------
    WhitenessTest
        Gaps are stepped over as in `diagnose`. A sensor that is read every second sample has no pairs; its autocorrelation is
        NaN.

    Examples
    --------
    >>> from fusion_sfdia import simulate
    >>> from fusion_sfdia.learning import WhitenessTest, whiteness
    >>> from fusion_sfdia.plants import two_tanks
    >>> found: WhitenessTest = whiteness(two_tanks(), simulate(two_tanks(), 300, seeds=[1], truth="model", process_noise=True))
    >>> 0.8 < found.nis < 1.2, found.variance.shape
    (True, (4,))
    """
    log = one_run(as_log(plant, *healthy))
    if len(log.t) <= whole("warm_up", warm_up, least=0) + 1:
        raise ValueError(f"{len(log.t)} samples, of which {warm_up} are left out; expected at least two more: record more")
    track, _ = bridged(plant, log)
    rows = []
    for t, y, u in parted(Log(track.t, track.y, track.u), np.isfinite(track.begins[1:])):
        steps = islice(filtered(plant, Log(t, y[:, None], u[:, None])), warm_up, None)
        rows += [(np.full(y.shape[1], np.nan), np.zeros(y.shape[1])), *((now.standard[0], now.normal[0]) for now in steps)]
    e, normal = (np.stack(a) for a in zip(*rows, strict=True))
    known = np.isfinite(e)
    square = np.sum(np.where(known, e, 0.0) ** 2, axis=0)
    products = np.where(known[1:] & known[:-1], e[1:] * e[:-1], 0.0)
    pairs = np.sum(known[1:] & known[:-1], axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        variance = square / known.sum(axis=0)
        autocorrelation = products.sum(axis=0) / pairs / variance
    return WhitenessTest(float(np.sum(normal**2) / known.sum()), variance, autocorrelation, pairs)


class LeftOut(NamedTuple):
    """Sums over the judged readings: log-likelihood in units of `scale`, normalised innovation squared, their number."""

    log_likelihood: float
    chi_square: float
    readings: int

    def plus(self, other: LeftOut) -> LeftOut:
        return LeftOut(
            self.log_likelihood + other.log_likelihood, self.chi_square + other.chi_square, self.readings + other.readings
        )


def side_by_side(logs: Sequence[Log]) -> tuple[Array, Array, Array]:
    """Return runs as a batch: y (K, B, N), u (K, B, m), and which samples are of a run (K, B), the rest being missing.

    A run of more than LONGEST samples is stepped as several.
    """
    parts = [log.rows(slice(a, a + LONGEST)) for log in logs for a in range(0, len(log.t), LONGEST)]
    shape = max(len(part.t) for part in parts), len(parts)
    y, u = np.full((*shape, parts[0].y.shape[1]), np.nan), np.zeros((*shape, parts[0].u.shape[1]))
    for b, (t, readings, applied) in enumerate(parts):
        y[: len(t), b], u[: len(t), b], u[len(t) :, b] = readings, applied, applied[-1]
    return y, u, np.arange(shape[0])[:, None] < [len(part.t) for part in parts]


def left_out(plant: Plant, logs: Sequence[Log], scale: Array) -> LeftOut:
    """The one-step predictions by the extended Kalman filter of runs without gaps, -(e' S^-1 e + log |2 pi S|) / 2.

    scale (N,): the unit of each reading. Runs are stepped `side_by_side`; the first WARM_UP samples of each, or the
    first quarter of a shorter one, are not judged.
    """
    y, u, own = side_by_side(logs)
    judged = np.arange(len(own))[:, None] >= np.minimum(WARM_UP, own.sum(axis=0) // 4)
    total = LeftOut(0.0, 0.0, 0)
    for now, counts in zip(filtered(plant, Log(plant.dt * np.arange(1, 1 + len(y)), y, u)), judged, strict=True):
        used = now.used[counts]
        log_likelihood = np.sum(now.log_likelihood[counts]) + np.sum(used * np.log(scale))
        total = total.plus(LeftOut(float(log_likelihood), float(np.sum(now.normal[counts] ** 2)), int(used.sum())))
    return total
