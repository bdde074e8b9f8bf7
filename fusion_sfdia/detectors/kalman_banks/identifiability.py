"""Before any data: which sensor faults a plant's model can detect, and which look like an error of the model.

Along the usual operation a fault of size 1 changes the innovations of a Kalman filter by M, see `likelihood_window`: D = e_i
for a bias of sensor i, D = k e_i for a ramp in the k-th sample since the onset, and C = F e_j at the onset for a jump of a
parameter, an error of an input or a disturbance j, which `augment` adds as a state. The likelihood ratio of a fault of size c
with a known onset has the statistic a / sqrt(b), with mean c sqrt(b) and variance 1, b = sum M' S^-1 M. That of sensor and
process is less by the share that both have in common,

    rho = sum M' S^-1 N / sqrt(b_M b_N),    mean c sqrt(b (1 - rho^2))

The smallest detectable size is that with a mean of 5: at a threshold h it is detected with probability Phi(5 - h), .96 at the
3.29 of a false-alarm probability of 1e-3, and one half at 5. A detector that searches many sensors and onsets has a higher
threshold, and one with a window sees no more samples than that. With considered parameters the innovations are correlated in
time, which the variance neglects. Of a sensor that states slow noise (`SlowNoise`) the variance of a is as many times b as a
sum over all samples since the onset varies more.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import count as count_from
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import whole
from fusion_sfdia.detectors.kalman_banks.leave_one_out import LeaveOneOut, posterior, statistics
from fusion_sfdia.detectors.kalman_banks.likelihood_window import Effect, OnsetGrid, Shifted, empty, updated, weigh
from fusion_sfdia.detectors.kalman_banks.window_step import last_update, no_update, window_step
from fusion_sfdia.filters.estimators import Extended, GaussianState, step_stream
from fusion_sfdia.filters.gaussian import gain
from fusion_sfdia.plant.augment import augment
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.slow_noise import inflation_of
from fusion_sfdia.plant.uncertainty import Uncertainty

Array = NDArray[Any]

NEEDED = 5.0  # mean of the statistic, in its standard deviations
FIRST, LAST = 60, 3840  # samples after which, and at most, limits are compared where time is unlimited
SETTLED = 0.01  # relative change of all limits while the samples double
LARGE, CONFOUNDED = 5.0, 0.9  # sigma and |rho| beyond which a limit is marked


@dataclass(frozen=True, eq=False)
class IdentifiabilityResult:
    """The smallest sensor faults that a filter of the plant can detect; N sensors, P hypotheses of the process.

    All sizes (N,) are in standard deviations sigma of the sensor; inf where the readings do not show the fault.

    Attributes
    ----------
    plant : str
        Its name.
    sensors : tuple of str (N,)
        Their names.
    units : tuple of str (N,)
        Of the sensors.
    sigma : array (N,)
        Standard deviations of the readings, in the units.
    hypotheses : tuple of str (P,)
        Of the process.
    bias : array (N,)
        The smallest bias, with what the plant states as its uncertainty estimated along.
    bias_known : array (N,)
        The same with all of that known.
    drift : array (N,)
        The size reached after `samples` of a steady growth, with what the plant states as its uncertainty estimated along.
    drift_known : array (N,)
        The same with all of that known.
    rho, rho_drift : array (N, P)
        What the innovations of a bias and of a drift have in common with those of a jump of each hypothesis, from -1 to 1.
    between : array (N, N)
        The same of the biases of two sensors.
    samples : int
        After the onset.
    settle : int
        Samples before it.

    Examples
    --------
    See `identifiability`.
    """

    plant: str
    sensors: tuple[str, ...]
    units: tuple[str, ...]
    sigma: Array
    hypotheses: tuple[str, ...]
    bias: Array
    bias_known: Array
    drift: Array
    drift_known: Array
    rho: Array
    rho_drift: Array
    between: Array
    samples: int
    settle: int

    @property
    def rival(self) -> tuple[str, ...]:
        """For each sensor the hypothesis that a bias is confounded with most; empty where the plant states none."""
        if not self.hypotheses:
            return ("",) * len(self.sensors)
        return tuple(self.hypotheses[j] for j in np.argmax(np.abs(self.rho), axis=-1))

    @property
    def overlap(self) -> Array:
        """|rho| with that hypothesis (N,)."""
        return np.asarray(np.max(np.abs(self.rho), axis=-1, initial=0.0))

    @property
    def told_apart(self) -> Array:
        """The smallest bias that is also told apart from that hypothesis (N,)."""
        return _apart(self.bias, self.rho)

    @property
    def drift_told_apart(self) -> Array:
        """The smallest drift that is also told apart from the hypothesis that it has most in common with (N,)."""
        return _apart(self.drift, self.rho_drift)

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence for each sensor whose limits are above 5 sigma, or that is confounded by a rho above .9."""
        found = []
        for i, name in enumerate(self.sensors):
            if self.overlap[i] > CONFOUNDED:
                found.append(
                    f"{name}: a bias looks like {self.rival[i]} (rho {self.overlap[i]:.2f}); they are told apart from "
                    f"{self.told_apart[i]:.3g} sigma on"
                )
            elif self.told_apart[i] > LARGE:
                found.append(f"{name}: only a bias of {self.told_apart[i]:.3g} sigma or more is detected and told apart")
            if self.drift[i] > LARGE:
                found.append(f"{name}: only a drift to {self.drift[i]:.3g} sigma or more in {self.samples} samples is detected")
        return tuple(found)

    def __str__(self) -> str:
        header = ("sensor", "sigma", "bias known", "bias", "told apart", "rho", "from", "drift known", "drift")
        rows = [header]
        for i, name in enumerate(self.sensors):
            sizes = self.bias_known, self.bias, self.told_apart, self.drift_known, self.drift
            known, bias, apart, drift_known, drift = (f"{a[i]:.3g}{' !' * bool(a[i] > LARGE)}" for a in sizes)
            rho = f"{self.overlap[i]:.2f}{' !' * bool(self.overlap[i] > CONFOUNDED)}" if self.hypotheses else ""
            noise = f"{self.sigma[i]:.3g} {self.units[i]}"
            rows.append((name, noise, known, bias, apart, rho, self.rival[i], drift_known, drift))
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(f"{cell:<{w}}" for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows]
        title = (
            f"{self.plant}: smallest sensor faults within {self.samples} samples, in sigma; with all parameters known, or not"
        )
        return "\n".join([title, *lines, *self.warnings])

    __repr__ = __str__


def _apart(size: Array, rho: Array) -> Array:
    """The size (N,) that leaves as much evidence beside the rival with the largest |rho| (N, P)."""
    with np.errstate(divide="ignore"):
        return np.asarray(size / np.sqrt(np.maximum(1.0 - np.max(np.abs(rho), axis=-1, initial=0.0) ** 2, 0.0)))


def identifiability(plant: Plant, samples: float = 60, settle: int = 60) -> IdentifiabilityResult:
    """State which sensor faults can be detected on a plant, and with which error of the model a bias is confounded.

    The extended Kalman filter runs along the usual operation (`plant.input_at`) from x0, without noise, on the plant alone and
    on `augment(plant)`.

    Parameters
    ----------
    plant : Plant
        The model.
    samples : float, default 60
        After the onset, or inf for as many as still lower a limit by a hundredth, at most 3840.
    settle : int, default 60
        Samples before the fault begins.

    Returns
    -------
    IdentifiabilityResult
        str(...) of it is a table.

    Raises
    ------
    ValueError
        For other numbers, and where the model has no finite values on the way.

    Examples
    --------
    >>> from fusion_sfdia.plants import IdentifiabilityResult, identifiability, two_tanks
    >>> limits: IdentifiabilityResult = identifiability(two_tanks(), samples=20, settle=20)
    >>> limits.sensors, bool((limits.bias >= limits.bias_known).all())
    (('l1', 'l2', 'q12', 'q2'), True)
    """
    whole("settle", settle, least=0)
    if samples != np.inf and whole("samples", samples, least=1) > LAST:
        raise ValueError(f"samples is {samples}; expected at most {LAST}, or inf")
    free = augment(plant)
    added = len(free.states) - len(plant.states)
    whole_model = _limits(free, added, samples, settle)
    alone = _limits(replace(plant, uncertainty=Uncertainty()), 0, whole_model.samples, settle) if added else whole_model
    sigma = plant.sensor_sigma
    units = sigma / np.sqrt(inflation_of(whole_model.samples, *plant.slow_noise))
    return IdentifiabilityResult(
        plant=plant.name,
        sensors=plant.sensor_names,
        units=tuple(s.unit for s in plant.sensors),
        sigma=sigma,
        hypotheses=tuple(s.name for s in free.states[len(plant.states) :]),
        bias=whole_model.bias / units,
        bias_known=alone.bias / units,
        drift=whole_model.drift / units,
        drift_known=alone.drift / units,
        rho=whole_model.rho,
        rho_drift=whole_model.rho_drift,
        between=whole_model.between,
        samples=whole_model.samples,
        settle=settle,
    )


class _Limits(NamedTuple):
    """Smallest detectable bias and drift (N,), in sensor units, rho (N, P) of either and (N, N), and after how many samples."""

    bias: Array
    drift: Array
    rho: Array
    rho_drift: Array
    between: Array
    samples: int


def _limits(plant: Plant, added: int, samples: float, settle: int) -> _Limits:
    """The limits of a filter on the plant, with jumps of its last `added` states as hypotheses of the process."""
    count = len(plant.sensors)
    window = empty(
        (1,), OnsetGrid(2), len(plant.states), count + added, float
    )  # of biases and jumps, and of ramps, with one onset
    window.eta[0, 0, len(plant.states) - added :, count:] = -np.eye(added)
    last, never = no_update((1,), len(plant.states), count), np.zeros(1, bool)
    common, crossed = np.zeros((count + added, count + added)), np.zeros((count, added))
    before = np.full(count, np.inf)
    for k, update in enumerate(islice(_healthy_updates(plant), settle, settle + LAST), start=1):
        tangent, output_jacobian, found, K = update
        now = Shifted(window, np.arange(2), window.a, window.b, window.age + 1)
        step = window_step(last, tangent, output_jacobian, found, float)
        weighed = weigh(now, step, Effect(np.array([1.0, k])))
        M, of_ramps = weighed.M[0, 0], weighed.M[0, 1, :, :count]
        common += M.T @ found.inverse[0] @ M
        crossed += of_ramps.T @ found.inverse[0] @ M[:, count:]
        window, last = updated(weighed, never), last_update(step, K, never)
        if k == samples or (samples == np.inf and k >= FIRST and (k & (k - 1) == 0 or k == LAST)):
            limits = _of(common, window.b[0, 1, :count], crossed, k)
            if k in (samples, LAST) or np.all(limits.bias >= (1 - SETTLED) * before):
                return limits
            before = limits.bias
    raise AssertionError("the last sample has limits")


class _Update(NamedTuple):
    """F of a step, H of its prediction, S^-1 of its readings and K of its update."""

    tangent: Array
    output_jacobian: Array
    found: LeaveOneOut
    gain: Array


def _healthy_updates(plant: Plant) -> Iterator[_Update]:
    """The updates of an extended Kalman filter along the usual operation, with readings as it expects them."""
    estimator, none = Extended(), step_stream(0, 0)
    state = estimator.start(plant, (1,), none)
    for k in count_from(0):
        t_start, t = k * plant.dt, (k + 1) * plant.dt
        u = plant.input_at(t_start)
        prior = estimator.predict(plant, state, t_start, u, plant.dt, none)
        joint = estimator.joint(plant, prior, t, u)
        if not (np.all(np.isfinite(joint.y)) and np.all(np.isfinite(joint.S))):
            raise ValueError(
                f"the model of plant {plant.name!r} has no finite readings at {t:g} s of its usual operation; give another "
                "`operation` or x0, or fewer samples"
            )
        found = statistics(joint, joint.y, np.ones(joint.y.shape, bool))
        state = GaussianState(*posterior(joint, found))
        assert prior.tangent is not None
        yield _Update(prior.tangent, plant.output_jacobian_at(t, prior.core.x, u), found, gain(joint, found.inverse))


def _of(common: Array, of_ramps: Array, crossed: Array, samples: int) -> _Limits:
    """The limits of sum M' S^-1 M (N + P, N + P) for biases and jumps, b (N,) for ramps of 1 a sample, and what ramps and jumps
    have in common (N, P).
    """
    count, b = of_ramps.size, np.diagonal(common)
    with np.errstate(divide="ignore", invalid="ignore"):
        bias, slope = (np.where(v > 0, NEEDED / np.sqrt(v), np.inf) for v in (b[:count], of_ramps))
        rho = np.clip(np.nan_to_num(common[:count] / np.sqrt(np.outer(b[:count], b))), -1.0, 1.0)
        of_drift = np.clip(np.nan_to_num(crossed / np.sqrt(np.outer(of_ramps, b[count:]))), -1.0, 1.0)
    return _Limits(bias, samples * slope, rho[:, count:], of_drift, rho[:, :count], samples)
