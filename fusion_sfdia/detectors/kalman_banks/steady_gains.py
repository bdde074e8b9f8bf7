"""Gains at rest: what a step of a time-invariant linear filter takes over where its covariance has come to rest.

At the plant's dt, with the same readings in use, the covariance P tends to that of `filters.riccati`, and gains, factors and
the information of windows to what follows from it. They are computed once. Where P differs from it by at most `SAME` of
its standard deviations, a step is u = S^-1 d, x <- x + C u with these.

The score of a hypothesis (see `likelihood_window`) then does not need eta, the change of the state that it causes: one
backward pass suffices, the auxiliary residuals of the disturbance smoother (de Jong and Penzer 1998). With A = F - F K H and
v = H' u

    s_j = sum_(i < j) (A')^i v,    t_j = s_1 + .. + s_j,    s_(2^m + j) = s_(2^m) + (A')^(2^m) s_j    for j < 2^m

an onset of age j, its own sample included, adds to the score M' u:

    bias          u - (F K)' s_(j - 1)               C in each step        C' s_j
    ramp          j u - (F K)' t_(j - 1)             C at the onset        C' (s_j - s_(j - 1))

and to the information what it adds at that age in any step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.alike import single
from fusion_sfdia.derivatives.equation import compiled, plain
from fusion_sfdia.detectors.batch_detector import TimeStep
from fusion_sfdia.detectors.detector import Decision
from fusion_sfdia.detectors.health import decision_of_runs, of_runs
from fusion_sfdia.detectors.kalman_banks import window_step
from fusion_sfdia.detectors.kalman_banks.leave_one_out import LeaveOneOut, posterior_and_gain, statistics
from fusion_sfdia.detectors.kalman_banks.likelihood_window import Effect, Shifted, Weighed, Window, restarted
from fusion_sfdia.detectors.kalman_banks.window_step import LastUpdate, WindowStep
from fusion_sfdia.filters.estimators import Extended, GaussianState, Prior
from fusion_sfdia.filters.gaussian import Joint
from fusion_sfdia.filters.guarded_steps import guarded_step_and_jacobian, readings_and_jacobian
from fusion_sfdia.filters.riccati import steady_prediction
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

LARGE = 128  # states and sensors from which a step takes longer than its calls
SETTLED = 16  # steps in a row with the same readings in use, after which their gains at rest are computed
SAME = 1e-6  # of the standard deviations: what P may differ from that at rest
SAME_DT = 1e-5  # relative difference of steps that are the plant's dt: seconds since 1970 are rounded to 2e-7
LEAST = 1e-30  # below it an entry of a power of A counts as 0: products of denormal numbers take many times as long
ROOM = 2e6  # numbers of a covariance, in all, of which gains are kept
EACH = 20  # times as many numbers a set of gains takes, most of them powers of A


class Gains(NamedTuple):
    """Gains at rest with the readings that are used (N,).

    F (n, n), H (N, n), P before and after the readings (n, n), S (N, N), C (n, N), S^-1 (N, N) and its diagonal (N,), the
    standard deviation (N,) of a reading less what the others that are used state, F K (n, N), A^(2^m) (M, n, n), and of each
    window its hypotheses and the information (ages, q) that they add.
    """

    used: Array
    F: Array
    H: Array
    prior: Array
    posterior: Array
    S: Array
    C: Array
    inverse: Array
    weight: Array
    sd: Array
    gain: Array
    powers: Array
    effects: tuple[Effect, ...]
    growth: tuple[Array, ...]


class Steady(NamedTuple):
    """For how many steps gains have been made from the same, the plant's dt and the readings used (..., N), since (...);
    whether the last step was at rest (...), so that no eta is carried.
    """

    since: Array
    rests: Array
    used: Array


Judged = tuple[Any, Decision]


class SteadyGains:
    """The gains at rest of a plant with windows of the hypotheses `effects`, whose onsets have those ages at most."""

    def __init__(self, plant: Plant, ages: Sequence[int], effects: Sequence[Effect]) -> None:
        self.plant, self.ages = plant, tuple(ages)
        self.effects = tuple(e if e.state is None else e._replace(state=e.state.astype(window_step.NUMBERS)) for e in effects)
        self.kept: dict[bytes, Gains | None] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        return SteadyGains, (self.plant, self.ages, self.effects)  # a copy computes its own

    def of(self, used: Array) -> Gains | None:
        """The gains with the readings `used` (N,); None where the filter has no covariance at rest."""
        key = used.tobytes()
        if key not in self.kept:
            if len(self.kept) >= max(2, ROOM / len(self.plant.states) ** 2):
                del self.kept[next(iter(self.kept))]
            self.kept[key] = self._of(used)
        return self.kept[key]

    def _of(self, used: Array) -> Gains | None:
        plant, x, u = self.plant, self.plant.x0[None], self.plant.input_at(0.0)[None]
        F, H = plant.step_jacobian_at(0.0, plant.x0, u[0], plant.dt), plant.output_jacobian_at(0.0, plant.x0, u[0])
        scale = plant.state_scale
        Q = plant.process_cov / (scale**2 if plant.process_cov.ndim == 1 else np.outer(scale, scale))
        if not used.any():
            return None
        P = steady_prediction(F * scale / scale[:, None], H[used] * scale, Q, plant.sensor_cov[used])
        if P is None:
            return None
        P = P * np.outer(scale, scale)
        joint = Extended().joint(plant, Prior(GaussianState(x, P[None]), np.zeros(1, bool), np.zeros(1, bool)), 0.0, u)
        found = statistics(joint, joint.y, used[None])
        _, p, K = posterior_and_gain(joint, found)
        assert joint.H is not None and found.half is not None
        step = window_step.window_step(LastUpdate(K, H[None]), F, H, found, window_step.NUMBERS)
        powers = [step.A[0]]
        while 2 ** len(powers) <= max(self.ages, default=0):
            powers.append(powers[-1] @ powers[-1])
            powers[-1][np.abs(powers[-1]) < LEAST] = 0.0
        growth = tuple(growth_of(step, effect, ages) for effect, ages in zip(self.effects, self.ages, strict=True))
        p, S, C, inverse = (np.array(a.reshape(a.shape[-2:])) for a in (p, joint.S, joint.C, found.inverse))
        weight, others = found.weight[0], H[~used]
        variance = np.where(used, 1 / np.where(used, weight, 1.0), plant.sensor_cov)
        variance[~used] += np.sum((others @ p) * others, axis=-1)
        return Gains(
            used, F, H, P, p, S, C, inverse, weight, np.sqrt(variance), step.FK[0], np.array(powers), self.effects, growth
        )  # fmt: skip

    def start(self, batch: tuple[int, ...]) -> Steady:
        """The state before the first readings."""
        none = np.zeros(batch, bool)
        return Steady(np.zeros(batch, int), none, np.zeros((*batch, len(self.plant.sensors)), bool))

    def judged(
        self, now: Steady, p: Array, dt: float, at_rest: Callable[[Gains], tuple[Array, Judged]], anew: Callable[[], Judged]
    ) -> Judged:
        """A step: at rest in the runs that can be, and in which that suffices (...), as `at_rest` returns, else `anew`.

        p (B, n, n): P after the last readings.
        """
        left = (now.since >= SETTLED) & self.is_nominal(dt)
        found: Judged | None = None
        while left.any():
            first = int(np.argmax(left))
            alike = left & (now.used == now.used[first]).all(axis=-1)
            left = left & ~alike
            gains = self.of(now.used[first])
            if gains is None or not (alike := alike & near(p, gains.posterior)).any():
                continue
            rests, rested = at_rest(gains)
            if (rests := rests & alike).all():
                return rested
            if rests.any():
                other = found or anew()
                found = of_runs(rests, rested[0], other[0]), decision_of_runs(rests, rested[1], other[1])
        return anew() if found is None else found

    def awake(self, now: Steady, p: Array, windows: Sequence[Window]) -> tuple[Steady, list[Window]]:
        """The windows with the eta that they have not carried in the runs that are at rest.

        Where P after the last readings p (B, n, n) is not that at rest, another model was: there they restart.
        """
        if not now.rests.any():
            return now, list(windows)
        changed = np.zeros(now.rests.shape, bool)
        etas = [np.array(w.eta) for w in windows]
        for r in np.flatnonzero(now.rests):
            gains = self.of(now.used[r])
            if gains is None or not near(p[r : r + 1], gains.posterior)[0]:
                changed[r] = True
                continue
            for eta, window, effect in zip(etas, windows, gains.effects, strict=True):
                eta[r] = eta_of(gains, window.age[r], effect)
        awake = [restarted(w._replace(eta=eta), changed) for w, eta in zip(windows, etas, strict=True)]
        return now._replace(since=np.where(changed, -1, now.since)), awake

    def followed(self, before: Steady, used: Array, dt: float, usual: Array) -> Steady:
        """The state after an ordinary step with the readings used (B, N); usual (B,): runs in which the estimate is that of the
        filter on all of them.
        """
        alike = usual & (used == before.used).all(axis=-1) & self.is_nominal(dt)
        return Steady(np.where(alike, before.since + 1, 0), np.zeros(alike.shape, bool), used)

    def is_nominal(self, dt: float) -> bool:
        """Whether a step of dt (s) is as long as the plant's."""
        return abs(dt - self.plant.dt) <= SAME_DT * dt


def can_rest(plant: Plant) -> bool:
    """Whether gains on the plant can come to rest, and keeping them is worth it: it is linear, and large."""
    return len(plant.states) + len(plant.sensors) >= LARGE and plant.considered is None and all(plant.linear)


def most_kept(n: int) -> float:
    """The bytes that the gains which are kept take at most, with n states and as many sensors."""
    return 8.0 * EACH * max(2 * n**2, ROOM)


def near(p: Array, kept: Array) -> Array:
    """Whether P (B, n, n) differs little from that at rest (n, n): whether |P_ij - P_ij at rest| <= `SAME` sqrt(P_ii P_jj)."""
    if np.may_share_memory(p[0], kept) and len(single(p)) == 1:
        return np.ones(len(p), bool)
    return np.broadcast_to(_near(plain(single(p)), kept, SAME), len(p))


@compiled
def _near(p: Array, kept: Array, same: float) -> Array:
    found, n = np.ones(p.shape[0], np.bool_), p.shape[1]
    for r in range(p.shape[0]):
        for i in range(n):
            limit = same * np.sqrt(p[r, i, i])
            for j in range(n):
                if not abs(p[r, i, j] - kept[i, j]) <= limit * np.sqrt(p[r, j, j]):
                    found[r] = False
                    break
            if not found[r]:
                break
    return found


def growth_of(step: WindowStep, effect: Effect, ages: int) -> Array:
    """What an onset adds to the information of each hypothesis at each age (ages, q): diag(M' S^-1 M), see `window_step`."""
    A, FK, half, seen = step.A[0], step.FK[0], step.half[0], step.seen[0]
    C = np.zeros((len(A), 0), A.dtype) if effect.state is None else effect.state
    N, found = FK.shape[1], np.empty((ages, FK.shape[1] + C.shape[1]))
    eta, M, D = np.zeros((len(A), found.shape[1]), A.dtype), np.zeros((len(half), found.shape[1]), A.dtype), 0.0
    for age in range(1, ages + 1):
        eta = A @ eta
        eta[:, :N] += D * FK
        eta[:, N + (effect.once if age > 1 else 0) :] -= C[:, effect.once if age > 1 else 0 :]
        D = float(age) if effect.ramp else 1.0
        M[: len(seen)] = seen @ eta
        M[len(seen) :] = 0.0
        M[:, :N] += D * half
        found[age - 1] = np.einsum("ij,ij->j", M, M)
    return found


def predicted(plant: Plant, gains: Gains, x: Array, now: TimeStep, u: Array) -> tuple[Prior, Joint, Array]:
    """The prediction from x (B, n), state and readings before the update, and runs in which the model is that of the gains.

    The step is plant.dt, so that a model that depends on it has the same F where times are rounded.
    """
    (_, ahead, moved, stuck, lost), F = guarded_step_and_jacobian(plant, now.t_start, x, u, plant.dt)
    expected, H = readings_and_jacobian(plant, now.t, ahead, u)
    same = all(a is b or np.array_equal(a, b) for a, b in ((F, gains.F), (H, gains.H)))
    P, S, C = (np.broadcast_to(a, (len(x), *a.shape)) for a in (gains.prior, gains.S, gains.C))
    prior = Prior(GaussianState(ahead, P), moved | stuck, lost, F)
    return prior, Joint(ahead, P, expected, S, C, None, H), ~(moved | stuck | lost) & same


def statistics_at_rest(gains: Gains, joint: Joint, y: Array) -> LeaveOneOut:
    """The leave-one-out statistics of the readings y (B, N) that are used."""
    used, weight = (np.broadcast_to(a, y.shape) for a in (gains.used, gains.weight))
    return LeaveOneOut(np.where(used, y - joint.y, 0.0) @ gains.inverse, weight, gains.inverse[None], used, None, None)


def estimate_at_rest(gains: Gains, joint: Joint, found: LeaveOneOut) -> GaussianState:
    """The estimate x + C u (B, n) and P (B, n, n)."""
    return GaussianState(joint.x + found.whitened @ gains.C.T, np.broadcast_to(gains.posterior, joint.P.shape))


def weigh_at_rest(windows: Sequence[Shifted], gains: Gains, whitened: Array, *more: Array) -> list[list[Weighed]]:
    """`likelihood_window.weigh` of all windows, and `with_readings` for each of `more`; whitened u (B, N). The eta is that of
    before.
    """
    each, N = np.stack([whitened, *more], axis=1), whitened.shape[-1]
    back, found = (each @ gains.H).astype(gains.powers.dtype), []
    for now, effect, growth in zip(windows, gains.effects, gains.growth, strict=True):
        b = now.b + growth[np.minimum(now.age, len(growth)).astype(int) - 1]
        D = now.age if effect.ramp else np.ones(now.age.shape)
        a = np.repeat(now.a[None], 1 + len(more), axis=0)  # (readings, B, L, q)
        for r, (u, v, age) in enumerate(zip(each, back, now.age, strict=True)):
            before, then, at_onset = _sums(v, gains.powers, age, effect)
            added = np.empty((len(u), *a.shape[2:]))
            added[..., :N] = D[r][:, None] * u[:, None] - _product(before, gains.gain)
            if effect.state is not None:
                added[..., N:] = _product(then, effect.state)
                added[..., N : N + effect.once] -= _product(at_onset, effect.state[:, : effect.once])
            a[:, r] += np.cumsum(added, axis=0)
        found.append([Weighed(now.before.eta, D, one, b, now.age, gains.H) for one in a])
    return [list(of_readings) for of_readings in zip(*found, strict=True)]


def _product(rows: Array, matrix: Array) -> Array:
    """Rows (L, k, n) times a matrix (n, q), by one product, as (k, L, q)."""
    L, k, n = rows.shape
    return np.swapaxes((rows.reshape(L * k, n) @ matrix).reshape(L, k, matrix.shape[1]), 0, 1)


def eta_of(gains: Gains, age: Array, effect: Effect) -> Array:
    """The eta (L, n, q) of onsets of that age (L,), 0 for none."""
    turned = np.ascontiguousarray(np.swapaxes(gains.powers, -1, -2))
    found, _, _ = _sums(gains.gain.T, turned, age, effect)
    if effect.state is None:
        return np.swapaxes(found, -1, -2)
    _, then, at_onset = _sums(-effect.state.T, turned, age, effect)
    then[:, : effect.once] -= at_onset[:, : effect.once]
    return np.swapaxes(np.concatenate([found, then], axis=1), -1, -2)


def _sums(v: Array, powers: Array, age: Array, effect: Effect) -> tuple[Array, Array, Array]:
    """Of onsets of age j (L,), 0 for none, s_(j - 1), or t_(j - 1) of a ramp, and where states change s_j and s_(j - 1)."""
    L, j = len(age), age.astype(np.int64)
    steps = np.maximum(j - 1, 0) if effect.state is None else np.concatenate([np.maximum(j - 1, 0), j])
    found = sums(np.array(v, powers.dtype, order="C"), powers, steps, effect.ramp)
    return found[:L, int(effect.ramp)], found[L:, 0], found[:L, 0]


def sums(v: Array, powers: Array, steps: Array, ramp: bool) -> Array:
    """s_j = sum_(i < j) v A^i of rows v (k, n), and for a ramp t_j = s_1 + .. + s_j, for each j of `steps` (L,), bit by bit.

    powers: A^(2^m) (M, n, n). Returns (L, 1 or 2, k, n).
    """
    kinds, (k, n) = 1 + ramp, v.shape
    found, whole = np.zeros((len(steps), kinds * k, n), v.dtype), np.concatenate([v] * kinds)  # s_(2^m), t_(2^m)
    room = np.empty((2, (len(steps) + 1) * kinds * k, n), v.dtype)
    _sums_into(found, whole, room[0], room[1], powers, steps, k)
    return found.reshape(len(steps), kinds, k, n)


@compiled
def _sums_into(found: Array, whole: Array, room: Array, ahead: Array, powers: Array, steps: Array, k: int) -> None:
    """The same, added to `found` (L, R, n): rows of s, and behind k of these those of t; `whole` (R, n) is written to."""
    L, R, n = found.shape
    most, bit = 0, 1
    for at in range(L):
        most = max(most, steps[at])
    for m in range(powers.shape[0]):
        if bit > most:
            break
        few = 0
        for at in range(L + 1):  # the last one is `whole`
            if at == L or steps[at] & bit:
                for i in range(R):
                    for j in range(n):
                        room[few, j] = whole[i, j] if at == L else found[at, i, j]
                    few += 1
        np.dot(room[:few], powers[m], ahead[:few])
        few = 0
        for at in range(L):
            if steps[at] & bit:
                below = found.dtype.type(steps[at] % bit)
                for i in range(R):
                    for j in range(n):
                        found[at, i, j] = whole[i, j] + ahead[few, j]
                        if i >= k:
                            found[at, i, j] += below * whole[i - k, j]
                    few += 1
        for i in range(R - 1, -1, -1):
            for j in range(n):
                if i >= k:
                    whole[i, j] += found.dtype.type(bit) * whole[i - k, j]
                whole[i, j] += ahead[few + i, j]
        bit *= 2
