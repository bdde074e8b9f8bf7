"""Detector: the fusing filters of Shaheen 2024, a bank of N leave-one-out filters with an information mixture.

Step 3 adds information, P_m = (sum P_i^-1)^-1, Q_m = (sum Q_i^-1)^-1, and step 4 feeds it back with the information
distribution factors beta_i, sum beta_i = 1:

    printed     P_i = beta_i P_m,  Q_i = beta_i Q_m
    federated   P_i = P_m / beta_i,  Q_i = Q_m / beta_i           (Carlson 1990), the default

Federated, sum P_i^-1 = P_m^-1: information is shared out and none invented, and Q_i = Q / (N beta_i) from the first step on,
since then Q_m = Q / N; for equal beta that is Q. As printed the sum is N^2 P_m^-1 for beta = 1/N in each step, and Q falls as
N^(-2k), so that the gain vanishes; with "printed" P is as printed and Q is reset in each step. Federated with equal beta and
one kind of filter, x_m and N P_m are the mean and covariance of one filter with the noise R N / (N - 1), as each reading enters
N - 1 of them. All filters begin with the plant's initial covariance, and with unequal beta the NIS is that of the first
filter's prior, not of the mixture's.

Two more changes: the ensemble uses S = H P H' + R, and its feedback, which the paper does not specify, gives the local
ensembles the mean and covariance of the mixture: one update with R N / (N - 1) of all, its spread scaled, for equal beta.

The paper names three extensions as future work: several faults at once (`max_faults`), particle filters as local filters
(`GaussianParticles`), and thresholds that adapt (`adaptive`, see `expected_deviation`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.alike import repeated, single
from fusion_sfdia.common.arguments import floats, shown
from fusion_sfdia.common.errors import NotApplicableError, warn
from fusion_sfdia.common.order_statistics import order_statistic
from fusion_sfdia.derivatives.equation import compiled
from fusion_sfdia.detectors.batch_detector import AccommodatingDetector, TimeStep
from fusion_sfdia.detectors.detector import Decision, run
from fusion_sfdia.detectors.health import broken
from fusion_sfdia.detectors.kalman_banks import mixing
from fusion_sfdia.detectors.kalman_banks.bank_kernels import contiguous
from fusion_sfdia.detectors.kalman_banks.leave_one_out import (
    LeaveOneOut,
    eliminate,
    local_covariances,
    local_estimates,
    normalised_innovation_squared,
    statistics,
)
from fusion_sfdia.detectors.state import State, mapped
from fusion_sfdia.filters.estimators import (
    Core,
    Ensemble,
    Estimator,
    GaussianParticles,
    Prior,
    Reading,
    Unscented,
    drawn_by,
    require_filter,
    require_none_considered,
    step_stream,
)
from fusion_sfdia.filters.gaussian import Joint
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.redundancy import require_max_faults

Array = NDArray[Any]

FEEDBACKS = ("federated", "printed")
SETTLED = 2.0  # times the usual residual: of some thirty runs and sensors that move together the median varies by a half


class Mixed(NamedTuple):
    """Mean x (..., n) and covariance p (..., n, n) of the mixture, the NIS (...), and the statistics of a central filter behind
    the mixture, where there is one.
    """

    x: Array
    p: Array
    nis: Array
    central: LeaveOneOut | None = None


class Local(NamedTuple):
    """The local filters after an update: the statistics of all readings in use, from the prior of the first filter, estimates
    x (..., N, n) and covariances p (..., N, n, n), None where the mixture needs none.
    """

    found: LeaveOneOut
    x: Array
    p: Array | None


@dataclass(frozen=True)
class FusingBank(AccommodatingDetector):
    """N local filters, the i-th without sensor i, mixed and fed back (Shaheen 2024, sec. III).

    Parameters
    ----------
    plant : Plant
        The model.
    estimator : Estimator, default Unscented(redraw=False)
        The kind of local filter: `Extended`, `Unscented`, `Ensemble` or `GaussianParticles`.
    beta : tuple of float (N,), optional
        The information distribution factors, which sum to 1; None for 1/N each.
    thresholds : tuple of float (N,), optional
        On the square root of the state variance (19) of each sensor, in sensor units. The paper gives no values: set them with
        `fit` or `fit_thresholds`. Without them no alarm is raised, and `init` warns; (inf,) * N states that this is intended.
    residual_scale : tuple of float (n,), optional
        Divides the states in the residual (20), which would otherwise add different units; None for the plant's state_scale.
    accommodate : bool, default True
        Treat the isolated sensor as missing in that step.
    literal : bool, default False
        Run N filters one by one, as those of `filterpy_estimators` are meant to; otherwise the algebra of `leave_one_out` and
        `mixing` gives the same numbers at the cost of one filter (equal beta only: unequal beta always runs literally, and an
        ensemble has none).
    feedback : str, default "federated"
        "federated" or "printed", of the covariance of the mixture. The covariance of a Decision is N P_m with the first, P_m
        with the second.
    max_faults : int, default 1
        Sensors that are isolated in one step, one after the other: without those before the bank is asked again. The paper
        isolates one.
    settle : int, default 0
        Samples from the start on in which filters forget their initial covariance: thresholds are infinite until then;
        `fit_thresholds` learns it.
    adaptive : bool, default False
        Thresholds are in units of `expected_deviation` of the present sample, which grows where a filter has just started and
        where readings are missing; equal beta only. With few readings missing and settled filters they differ little from
        constant ones.

    Examples
    --------
    >>> from fusion_sfdia import simulate
    >>> from fusion_sfdia.detectors import FusingBank
    >>> from fusion_sfdia.plants import two_tanks
    >>> plant = two_tanks()
    >>> bank = FusingBank.fit(plant, simulate(plant, 200, seeds=range(4), process_noise=True), false_alarm=0.01)
    >>> len(bank.thresholds), bank.beta, bank.fitted_rate
    (4, None, 0.01)
    """

    estimator: Estimator = field(default_factory=lambda: Unscented(redraw=False))
    beta: tuple[float, ...] | None = None
    thresholds: tuple[float, ...] | None = None
    residual_scale: tuple[float, ...] | None = None
    accommodate: bool = True
    literal: bool = False
    feedback: str = "federated"
    max_faults: int = 1
    settle: int = 0
    adaptive: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        require_filter(self.estimator)
        if self.feedback not in FEEDBACKS:
            raise ValueError(f"feedback is {shown(self.feedback)}; known: {', '.join(FEEDBACKS)}")
        require_none_considered(self.plant, "a mixture of filters")
        n, count = len(self.plant.states), len(self.plant.sensors)
        if count < 2:
            raise NotApplicableError(f"plant {self.plant.name!r} has {count} sensors; leaving one out takes at least 2")
        require_max_faults(self.plant, self.max_faults)
        for what, expected in (("beta", count), ("thresholds", count), ("residual_scale", n)):
            if getattr(self, what) is None:
                continue
            values = floats(what, getattr(self, what))
            if values.shape != (expected,) or not np.all(values > 0):
                least = f"{values.min():g}" if values.size else "undefined"
                raise ValueError(f"{what} has shape {values.shape} with minimum {least}; expected {expected} positive numbers")
            object.__setattr__(self, what, tuple(values.tolist()))
        if self.beta is not None and not np.isclose(sum(self.beta), 1.0, rtol=1e-9):
            raise ValueError(f"beta sums to {sum(self.beta):.6g}; expected information distribution factors that sum to 1")
        if self.beta is not None and len(set(self.beta)) > 1:
            if self.adaptive:
                raise ValueError(
                    "adaptive thresholds are for equal beta, with which all filters have one prior; give beta=None"
                )
            if isinstance(self.estimator, Ensemble):
                raise ValueError("an ensemble takes over the covariance of the mixture for equal beta only; give beta=None")

    @property
    def filter_model(self) -> Plant:
        return self.plant

    @property
    def runs_literally(self) -> bool:
        return self.literal or (self.beta is not None and len(set(self.beta)) > 1)

    @cached_property
    def _plants(self) -> list[Plant]:
        """The plant of each local filter, with its process noise Q_i."""
        count = len(self.plant.sensors)
        if self.beta is None or self.feedback == "printed":
            return [self.plant] * count
        return [replace(self.plant, process_cov=self.plant.process_cov / (count * b)) for b in self.beta]

    def init(self, batch: int | tuple[int, ...] = (), t: float = 0.0, seed: int = 0) -> State:
        """As of every detector; with a UserWarning where there are no thresholds.

        Parameters
        ----------
        batch : int or tuple of int, default ()
            Shape of the batch; a number: that many runs.
        t : float, default 0
            Time in s at which the first step begins.
        seed : int, default 0
            Of the randomness of the filters.

        Returns
        -------
        State
            Before the first reading.
        """
        if self.thresholds is None:
            warn(
                "FusingBank has no thresholds and will never raise an alarm; set them with fit_thresholds(healthy), "
                "or thresholds=(inf,) * N where no alarm is expected"
            )
        return super().init(batch, t, seed)

    def fit_thresholds(self, healthy: Any, false_alarm: float = 1e-3, warm_up: int = 20) -> Self:
        """Return the bank with one threshold for each quantity, for a rate of false alarms per step over all sensors.

        The threshold of a quantity is an order statistic of its largest residual after the first `warm_up` samples, in which
        the filter settles. The quantities share the rate equally. Runs in which the bank diverges are left out.

        Parameters
        ----------
        healthy : Recording, Log, frame or tuple
            As in `fit`.
        false_alarm : float, default 1e-3
            The rate.
        warm_up : int, default 20
            Samples that are left out at the beginning of each run.

        Returns
        -------
        Self
            The fitted bank.

        Raises
        ------
        ValueError
            For too few data: less than one sample expected above a threshold.
        """
        t, y, u = self._healthy(healthy, false_alarm, warm_up)
        groups = self.plant.quantities
        ones = (1.0,) * len(self.plant.sensors)
        silent = replace(self, thresholds=ones, threshold_scale=1.0, settle=0, accommodate=False, max_faults=1)
        _, decisions = run(silent, silent.init(y.shape[1:-1], float(t[0]) - self.plant.dt), t, y, u)
        of_runs = (decisions.residual / decisions.threshold)[:, ~np.any(decisions.diverged, axis=0)]
        settle = _settled(of_runs.reshape(len(t), -1, y.shape[-1]))
        residual = of_runs[max(warm_up, settle) :].reshape(-1, y.shape[-1])
        share = false_alarm / len(groups)
        if share * residual.shape[0] < 1:
            raise ValueError(
                f"{residual.shape[0]} healthy samples cannot set a false-alarm rate of {false_alarm:g} over {len(groups)} "
                f"quantities; give at least {int(np.ceil(len(groups) / false_alarm))} or a higher rate"
            )
        thresholds = np.empty(y.shape[-1])
        for members in groups.values():
            largest = np.nanmax(np.where(np.isfinite(residual[:, members]), residual[:, members], -np.inf), axis=1)
            thresholds[members] = order_statistic(largest, share)
        return replace(self, thresholds=tuple(thresholds.tolist()), threshold_scale=1.0, settle=settle, fitted_rate=false_alarm)

    def _start(self, batch: tuple[int, ...], seed: int) -> Core:
        """The core of the filter, with an axis N after the batch when literal."""
        core = self.estimator.start(self.plant, batch, step_stream(seed, 0))
        if self.runs_literally:
            core = mapped(lambda a: np.repeat(a[:, None], len(self.plant.sensors), axis=1), core)
        return core

    def _judge(self, memory: Core, now: TimeStep, y: Array, u: Array) -> tuple[Core, Decision]:
        plant, scale = self.plant, np.asarray(self.residual_scale or self.plant.state_scale)
        prior = self._predict(memory, now, u)
        joint = self.estimator.joint(plant, prior[0], now.t, u)
        y = plant.near(y, joint.y)
        used = np.isfinite(y)
        local = self._update(prior, joint, now, y, used, u)
        mixed = self._mix(joint, local, y)
        seen, residual, distance = self._disagreement(now, joint, local.x, mixed.x, used, u, scale)
        limits = np.inf if self.thresholds is None else self.threshold_scale * np.asarray(self.thresholds)
        if self.adaptive:
            limits = limits * expected_deviation(local.found, plant.sensor_cov)
        threshold = np.broadcast_to(limits if now.k >= self.settle else np.inf, y.shape)
        alarm = np.any(residual > threshold, axis=-1)
        suspect = np.argmax(np.where(used, distance, -1.0), axis=-1)
        isolated = alarm[..., None] & used & (np.arange(y.shape[-1]) == suspect[..., None])
        kept = used & ~isolated
        if self.accommodate and np.any(isolated):
            mixed = (
                self._without(mixed, joint, local.found, y, kept, suspect)
                if local.p is None
                else self._mix(joint, self._update(prior, joint, now, y, kept, u), y)
            )
        for _ in range(self.max_faults - 1 if np.any(isolated) else 0):
            local = self._update(prior, joint, now, y, kept, u)
            without = self._mix(joint, local, y)
            _, further, distance = self._disagreement(now, joint, local.x, without.x, kept, u, scale)
            alarm = isolated.any(axis=-1) & np.any(further > threshold, axis=-1)
            if not np.any(alarm):
                break
            suspect = np.argmax(np.where(kept, distance, -1.0), axis=-1)
            isolated |= alarm[..., None] & kept & (np.arange(y.shape[-1]) == suspect[..., None])
            kept = used & ~isolated
            if self.accommodate:
                mixed = self._mix(joint, self._update(prior, joint, now, y, kept, u), y)
        kept = kept if self.accommodate else used
        core = self._fed_back(prior, mixed, now, np.where(kept, y, np.nan), u)
        unseen = np.diagonal(seen, axis1=-2, axis2=-1)  # expected y_i of filter i, which does not use y_i
        expected = plant.output(now.t, mixed.x, u)
        decision = Decision(
            estimate=mixed.x,
            reconstruction=np.where(used & ~isolated, y, expected),
            residual=residual,
            threshold=threshold.copy(),
            isolated=isolated,
            fault_size=np.where(isolated, y - unseen, np.nan),
            diverged=np.any([p.lost for p in prior], axis=0) | broken(mixed.x, mixed.p),
            guarded=np.any([p.guarded for p in prior], axis=0),
            nis=mixed.nis,
            covariance=mixed.p * (y.shape[-1] if self.feedback == "federated" else 1),
        )
        return core, decision

    def _disagreement(
        self, now: TimeStep, joint: Joint, local: Array, x: Array, used: Array, u: Array, scale: Array
    ) -> tuple[Array, Array, Array]:
        """What the local filters expect all sensors to read (..., N, N), the square root of (19), and (20) (..., N)."""
        seen = self.plant.near(self.plant.output(now.t, local, u[..., None, :]), joint.y[..., None, :])
        variance, distance = disagreement(local, seen, x, scale)
        return seen, np.where(used, np.sqrt(variance), np.nan), distance

    def _predict(self, core: Core, now: TimeStep, u: Array) -> list[Prior]:
        """The prior of each local filter, or their common prior."""
        cores, plants = [core], [self.plant]
        if self.runs_literally:
            cores = [mapped(lambda a, i=i: a[:, i], core) for i in range(len(self.plant.sensors))]
            plants = self._plants
        return [
            self.estimator.predict(plant, c, now.t_start, u, now.dt, drawn_by(self.estimator, now.seed, now.k))
            for c, plant in zip(cores, plants, strict=True)
        ]

    def _update(self, prior: list[Prior], joint: Joint, now: TimeStep, y: Array, used: Array, u: Array) -> Local:
        """Step 2: the local filters after the readings in use."""
        found = statistics(joint, y, used)
        if self.runs_literally:
            own = without_own(y, used)
            each = [self.estimator.update(self.plant, one, now.t, own[..., i, :], u) for i, one in enumerate(prior)]
            return Local(found, np.stack([x for x, _ in each], axis=-2), np.stack([p for _, p in each], axis=-3))
        x, gains = local_estimates(joint, found)
        if not isinstance(self.estimator, GaussianParticles):
            return Local(found, x, None)
        p, reading = local_covariances(joint, found, gains), Reading(now.t, without_own(y, used), u)
        return Local(found, *self.estimator.weighed(self.plant, prior[0], joint, reading, x, p))

    def _mix(self, joint: Joint, local: Local, y: Array) -> Mixed:
        """Step 3: mixture."""
        plant, central = self.plant, None
        if local.p is not None:
            # LAPACK's eigenvalues fail for the whole batch if one run is not finite; its local estimates are not finite either
            sound = np.all(np.isfinite(local.p), axis=(-3, -2, -1), keepdims=True)
            x, p = mixing.mix(local.x, np.where(sound, local.p, np.diag(plant.state_scale**2)), plant.state_scale)
        elif self.estimator.consistent:
            x, p, central = mixing.mixture(joint, y, local.found.used, plant.sensor_cov)
        else:
            x, p = mixing.mixture_of_any_joint(joint, local.found)
        return Mixed(x, p, normalised_innovation_squared(joint, local.found, y), central)

    def _without(self, mixed: Mixed, joint: Joint, found: LeaveOneOut, y: Array, kept: Array, suspect: Array) -> Mixed:
        """The mixture of the readings `kept` (..., N): again where the suspect (...) is not among them, as it was elsewhere."""
        at = np.any(found.used & ~kept, axis=-1)
        x, P, expected, S, C = (a[at] for a in joint[:5])
        there = Joint(x, P, expected, S, C)
        few = LeaveOneOut(found.whitened[at], found.weight[at], found.inverse[at], found.used[at], None, None)
        few = eliminate(few, suspect[at], np.ones(len(x), bool))
        if (central := mixed.central) is None:
            x, p = mixing.mixture_of_any_joint(there, few)
        else:
            one = replace(central, **{name: getattr(central, name)[at] for name in ("whitened", "weight", "half")})
            x, p = mixing.mixture_without(suspect[at], mixed.x[at], mixed.p[at], one, C)
        nis = normalised_innovation_squared(there, few, y[at])
        return Mixed(_with(mixed.x, at, x), _with(mixed.p, at, p), _with(mixed.nis, at, nis))

    def _fed_back(self, priors: list[Prior], mixed: Mixed, now: TimeStep, y: Array, u: Array) -> Core:
        """Step 4: the core of each local filter, or their common one, of the mixture and the readings y in use."""
        count = len(self.plant.sensors)
        beta = np.full(count, 1.0 / count) if self.beta is None else np.asarray(self.beta)
        factor = beta if self.feedback == "printed" else 1 / beta
        cores = [
            self.estimator.assimilate(
                self.plant,
                prior,
                Reading(now.t, y, u, noise_gain=count / (count - 1), cov_gain=c / count),
                mixed.x,
                repeated(c * single(mixed.p), mixed.p),
                drawn_by(self.estimator, now.seed, now.k + 2**32),
            )
            for prior, c in zip(priors, factor, strict=False)
        ]
        return mapped(lambda *each: np.stack(each, axis=y.ndim - 1), *cores) if self.runs_literally else cores[0]


def without_own(y: Array, used: Array) -> Array:
    """The readings of N local filters (..., N, N): those of y (..., N) that are `used`, NaN for the others and its own."""
    return np.where(used[..., None, :] & ~np.eye(used.shape[-1], dtype=bool), y[..., None, :], np.nan)


def expected_deviation(found: LeaveOneOut, R: Array) -> Array:
    """The root (..., N) of the expected variance (19) over the local filters, in sensor units, for readings in use.

    Filter i expects sensor s to read h_s(x_f) - (H K)_si u_i / w_i, see `leave_one_out`, with u of covariance W = S^-1, w_i =
    W_ii and H K = I - R W. With G_si = (H K)_si / w_i and N filters,

        E[variance_s] = sum_i (H K)_si G_si / N - (G W G')_ss / N^2

    for Gaussian innovations of covariance S. found: the statistics of all readings in use; R (N,). Not in the paper.
    """
    W, count = found.inverse, R.size
    read = -R[:, None] * W
    np.einsum("...ii->...i", read)[...] += found.used
    G = read / np.where(found.used, found.weight, 1.0)[..., None, :]
    variance = np.sum(read * G, axis=-1) / count - np.sum((G @ W) * G, axis=-1) / count**2
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def _settled(residual: Array) -> int:
    """The number of the sample (K, R, N) from which on the median residual, over runs and sensors, is at most `SETTLED` times
    that of the second half of the samples.
    """
    usual = np.nanmedian(residual[len(residual) // 2 :], axis=(0, 1))
    with np.errstate(invalid="ignore", divide="ignore"):
        larger = np.nanmedian(residual / np.where(usual > 0, usual, np.nan), axis=(1, 2)) > SETTLED
    early = larger[: len(residual) // 2]
    return int(np.flatnonzero(early)[-1]) + 1 if early.any() else 0


def _with(a: Array, at: Array, b: Array) -> Array:
    """A copy of a (..., k) that is b at some elements of the batch."""
    changed = np.array(a)
    changed[at] = b
    return changed


def disagreement(local: Array, seen: Array, mixed: Array, scale: Array) -> tuple[Array, Array]:
    """Return the variance (19) of each expected reading over the filters, and the distance (20) of each filter, (..., N).

    Printed, (19) is of the states; the two are the same where every state has a sensor, as in the paper.

    local (..., N, n): estimates x_i of the filters; seen (..., N, N): readings that they expect, a row a filter;
    mixed (..., n): x_m; scale (n,), by which the states are divided:

        variance_s = sum_i (seen_is - mean_s)^2 / N,    distance_i = |(x_i - x_m) / scale|
    """
    variance, distance = _disagreement(contiguous(local), contiguous(seen), contiguous(mixed), scale)
    return variance, distance


@compiled
def _disagreement(local: Array, seen: Array, mixed: Array, scale: Array) -> tuple[Array, Array]:
    B, N, n = local.shape
    variance, distance = np.zeros((B, seen.shape[2])), np.empty((B, N))
    mean, square = np.empty(seen.shape[2]), np.empty(n)
    for r in range(B):
        mean[:] = 0.0
        for i in range(N):
            mean += seen[r, i]
        mean /= N
        into, centre = variance[r], mixed[r]
        for i in range(N):
            of = seen[r, i]
            for s in range(mean.size):
                into[s] += (of[s] - mean[s]) ** 2
        into /= N
        for i in range(N):
            of, width = local[r, i], n
            for j in range(n):
                square[j] = ((of[j] - centre[j]) / scale[j]) ** 2
            while width > 1:  # by halves: one number after the other would wait for each sum
                half = (width + 1) // 2
                for j in range(width - half):
                    square[j] += square[half + j]
                width = half
            distance[r, i] = np.sqrt(square[0])
    return variance, distance
