"""Detector: means of the innovations of a commissioned, frozen model over windows, and the single cause that explains them.

Nothing is learnt after commissioning (`commissioned_model`), so that nothing absorbs a slow drift, and when a fault ends the
residuals are as before. In each row

- a window is in alarm where its T (`window_means`) exceeds its limit, and its last quarter still shows it;
- of the causes, offsets of sensors and changes of unknowns, that have just begun, began with an abrupt event or last, since
  windows that contain a beginning show the filter on its way, those explain the event that leave little of T: on average over
  its rows in alarm, the latest more, at most the limit, or of T the share `SMALL`, an offset of a sensor `LINEAR`;
- one that explains much better than all others is named, a sensor or an unknown; otherwise those that explain are suspects,
  and where none does it is the process, or several causes: "no single cause";
- while the verdict has mostly been the process no sensor is named;
- a sensor that has been named for as long as the longest window has a lasting fault: from then on, and until none shows it any
  more, the windows are judged beside it, so that a second fault is named as well;
- what looks like the sensor named last with the other sign, or again but much smaller, is the filter on its way back;
- an unknown whose plant states a rate r, the deviation of its change in the root of an hour, may have changed since the model
  was commissioned, at an age of a hours: with D_c, the mean derivatives by the unknowns, over a window, its covariance is
  S g + D_c diag(r^2 a) D_c', so that ageing as stated explains itself, at the price of what looks alike;
- a sensor that repeats a reading twice as often as it ever did when healthy is frozen.

The numbers below were chosen on one simulated air-handling unit, but `LINEAR`, `BRIEF`, `AGAIN`, `RIGHT` and `BESIDE` on plants
of our tests.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from fusion_sfdia.common.arguments import probability
from fusion_sfdia.common.clock import posix
from fusion_sfdia.common.order_statistics import order_statistic
from fusion_sfdia.detectors.batch_detector import BatchDetector, TimeStep
from fusion_sfdia.detectors.detector import Decision, ProcessHypothesis
from fusion_sfdia.filters.gaussian import half_inverse
from fusion_sfdia.learning.commissioning.commission import as_runs
from fusion_sfdia.learning.frozen_model.commissioned_model import Frozen, beyond, commissioned_without_faults, unsure
from fusion_sfdia.learning.frozen_model.frozen_filter import FRESH, FrozenFilter, Tracked, unknowns
from fusion_sfdia.learning.frozen_model.window_means import WINDOWS, Spread, enough, explained, latest, sums
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.uncertainty import HOUR

Array = NDArray[Any]

LONGEST = WINDOWS[-1]
PART = 10  # rows over which derivatives of errors are kept as one: they change slowly
FALSE_ALARM = 1e-3  # per row, where no rate was fitted
FADES = 60  # rows over which an event's rows count, and without alarm after which it is over
KEPT = float(np.exp(-1 / FADES))
SMALL, LINEAR = 0.15, 0.08  # share of T that a change of an unknown may leave, and an offset, which bends no equation
NEAR, NEAR_SHARE = 0.3, 0.06  # limits, or share of T, by which a rival may leave more than the best cause
BESIDE = 0.5  # share of T that an unknown may leave, beside a lasting fault, and be a rival of a sensor all the same
STILL, LAST = 0.5, 1.5  # of T that the last quarter shows at least, and the factor on what the last rows show
LATELY = 10  # rows at least of the last quarter
SHORT = sum(w <= FRESH for w in WINDOWS)
QUARTERS = [max(w // 4, LATELY) for w in WINDOWS[SHORT:]]
RANGES = (*WINDOWS, *sorted({*QUARTERS, LATELY} - {*WINDOWS}))  # rows of which means are taken
LATE = np.array([[RANGES.index(r) for r in QUARTERS], [RANGES.index(LATELY)] * len(QUARTERS)])
LENGTHS, LATEST = np.array(RANGES, float)[:, None, None], latest(RANGES, LONGEST)
PARTS = latest([w // PART for w in WINDOWS[SHORT:]], LONGEST // PART)
SHOWS, HALF = 0.3, 0.5  # share of its limit, and of its T, at which a window shows a cause at all
PROCESS, MOST = 60, 240  # rows of process verdicts above which no sensor is named, and that are counted
BRIEF, AGAIN = 3, 0.5  # rows after which a sensor is named again only from this share of the size that it had
RIGHT = 0.95  # probability of what is named: of the rows that named a sensor, tried on plants with wrong laws, .99 were right
FROZEN = 2  # times the longest run of equal readings in the healthy log
NO_SINGLE_CAUSE = ProcessHypothesis("no single cause", "1", "unnamed", np.nan)
OUTSIDE = ProcessHypothesis("operation outside the healthy log", "1", "outside", np.nan)


class FrozenMemory(NamedTuple):
    """The filter; of the last LONGEST rows, at the place of their number, errors, 0 where missing, whether they are known, and
    regressors (..., LONGEST, 2 N + q); means of the derivatives over PART rows (..., LONGEST / PART, N, M); their sums
    since the event began, as each PART began (..., LONGEST / PART + 1, N, M); what causes have left (..., M)
    of the event, and T, and their weight; rows of the event, and whether it began within a few rows; rows without alarm,
    and of process verdicts; the sensor named last, its largest size, and rows since; for how many rows it has been named; the
    sensor with a lasting fault, -1 for none, and rows since a window has shown it; the readings before, and their repeats
    (..., N).
    """

    tracked: Tracked
    rows: Array
    by_cause: Array
    begun: Array
    left: Array
    total: Array
    weight: Array
    age: Array
    abrupt: Array
    calm: Array
    process: Array
    named: Array
    size: Array
    since: Array
    named_for: Array
    acting: Array
    gone: Array
    before: Array
    repeats: Array


class Found(NamedTuple):
    """What windows show in a row: whether one is in alarm (...); the largest T over its limit (...), and of that window J over
    the limit (..., M); of the shortest one size and sd of the causes (..., M), as they are now; the largest ratio of any window
    (...), alarm or not; whether one would be in alarm were operation within the range of the healthy log (...); which causes
    explain half of what a window shows, at `SHOWS` of its limit at least (..., M); whether a window of at most `FRESH` rows is
    in alarm (...); whether a window shows the lasting fault (...), beside which all of this is.
    """

    alarm: Array
    total: Array
    own: Array
    size: Array
    sd: Array
    ratio: Array
    outside: Array
    shown: Array
    brief: Array
    acts: Array


def _silent(batch: int, causes: int) -> Found:
    """Windows that show nothing in so many runs."""
    no, none = np.zeros(batch, bool), np.zeros((batch, causes))
    return Found(no, none[:, 0], none, none, none, none[:, 0], no, none > 0, np.zeros(batch, int), no)


class Means(NamedTuple):
    """Means over RANGES (R, B, N) and whether they are known; of the windows, the first W of these, their covariances and
    growths times limits (W, B).
    """

    spread: Spread
    m: Array
    known: Array
    g: Array

    def explained(self, by_cause: Array, beside: Array | None = None) -> tuple[Array, Array, Array, Array]:
        """What causes explain of the windows (`window_means`); by_cause (W, B, N, M), beside (W, B, N)."""
        many = len(self.g)
        return explained(self.spread, self.m[:many], self.known[:many], by_cause, self.g, beside)

    def late(self, by_cause: Array, beside: Array | None = None) -> tuple[Array, Array, Array, Array]:
        """What they explain of the last quarter of each of the L long windows, and of the last rows (2, L, B)."""
        late, long = LATE[:, : len(self.g) - SHORT], slice(SHORT, None)
        spread, beside = Spread(*(a[long] for a in self.spread)), None if beside is None else beside[long]
        return explained(spread, self.m[late], self.known[late], by_cause[long], self.g[long], beside)


class Witness(NamedTuple):
    """What the windows say in a row beside the verdict: whether they are in alarm, or would be were operation within the
    healthy log (...); rows since the event began and since its last alarm, and whether it began within a few (...); which
    causes explain it, and which a window shows at all (..., M).
    """

    alarm: Array
    age: Array
    calm: Array
    abrupt: Array
    explains: Array
    shown: Array


class Explanation(NamedTuple):
    """Which causes explain an event (B, M); whether a sensor is named (B,), the best cause, its size, the largest while it is
    named; the sensor that is isolated (B, N); process hypotheses that hold, "no single cause" the last (B, P + 1); suspects
    (B, M).
    """

    explains: Array
    sensor: Array
    best: Array
    size: Array
    isolated: Array
    process: Array
    suspect: Array


@dataclass(frozen=True)
class FrozenBank(BatchDetector):
    """The detector with what a healthy log has shown; `fit` learns it.

    commissioned: when that log ended, in s since 1970. age: from then to second 0 of the readings, in s; None where that is not
    known, and nothing ages.
    """

    frozen: Frozen = field(kw_only=True)
    commissioned: float | None = field(default=None, kw_only=True, compare=False)
    age: float | None = field(default=None, kw_only=True, compare=False)

    @classmethod
    def fit(cls, plant: Plant, healthy: Any, false_alarm: float = 1e-3, **settings: Any) -> Self:
        """Commission on healthy readings; alarms at most at a rate per step over all sensors, on blocks that were left out.

        They are above the largest that such blocks have shown, whatever the rate. ValueError where the readings are too few.
        """
        probability("false_alarm", false_alarm)
        learnt, *_ = commissioned_without_faults(plant, as_runs(plant, (healthy,)))
        scores = np.sqrt(learnt.held_out)
        if scores.size * false_alarm < 1:
            raise ValueError(
                f"{scores.size} healthy samples cannot set thresholds that one in {1 / false_alarm:.0f} exceeds; give at least "
                f"that many after the first {learnt.frozen.settle} of each run, or choose a higher false-alarm rate"
            )
        scale = float(order_statistic(scores, false_alarm))
        return cls(plant, frozen=learnt.frozen, threshold_scale=max(scale, 1.0), fitted_rate=false_alarm, **settings)

    @property
    def process_hypotheses(self) -> tuple[ProcessHypothesis, ...]:
        """The unknowns of the plant, and that no single cause explains the readings."""
        return (*unknowns(self.plant), NO_SINGLE_CAUSE, OUTSIDE)

    @property
    def filter_model(self) -> Plant:
        return self.model

    def __getstate__(self) -> dict[str, Any]:
        """Without the plant as commissioned, whose functions cannot be pickled; it is made again when it is needed."""
        return {name: value for name, value in vars(self).items() if name != "model"}

    @cached_property
    def model(self) -> Plant:
        """The plant as it was commissioned: at its values, with what its equations miss added to the readings."""
        commissioned, frozen, n = self._filter.model, self.frozen, len(self.plant.states)
        if not frozen.coef.any():
            return commissioned

        def output(t: float, z: Array, u: Array) -> Array:
            missed = frozen.regressors(z[..., :n], np.broadcast_to(u, (*z.shape[:-1], u.shape[-1]))) @ frozen.coef.T
            return np.asarray(commissioned.output(t, z, u) + missed)

        along = frozen.along_states(n)
        stated = commissioned.jacobians[1]

        def jacobian(t: float, z: Array, u: Array) -> Array:
            assert stated is not None
            found = np.array(stated(t, z, u), dtype=float)
            found[..., :n] += along
            return found

        numerics = replace(commissioned.numerics, output_jacobian=None if stated is None else jacobian)
        return replace(commissioned, output=output, numerics=numerics)

    @cached_property
    def _filter(self) -> FrozenFilter:
        return FrozenFilter(self.plant, self.frozen.values, along=self.frozen.along_states(len(self.plant.states)))

    def dated(self, start: datetime | None) -> Self:
        if start is None or self.commissioned is None or not self._rates.any():
            return self
        return replace(self, age=posix(start) - self.commissioned)

    @cached_property
    def _rates(self) -> Array:
        """Standard deviation (p,) of the change of each unknown in the root of a second."""
        rates = [p.rate / np.sqrt(HOUR) for p in self.plant.uncertainty.parameters]
        return np.array([*rates, *[0.0] * (len(unknowns(self.plant)) - len(rates))])

    def _aged(self, spread: Spread, t: float, d: Array, growth: Array) -> Spread:
        """The covariances with what unknowns may have changed until t (s), with derivatives d (W, B, N, M) of the windows."""
        if self.age is None:
            return spread
        by = d[..., len(self.plant.sensors) :] * self._rates * np.sqrt(max(self.age + t, 0.0))
        cov = spread.cov + by @ np.swapaxes(by, -1, -2) / growth[..., None, None]
        return Spread(half_inverse(cov), cov)

    @cached_property
    def _spreads(self) -> Spread:
        """Of each window (W, 1, N, N)."""
        return Spread(half_inverse(self.frozen.cov)[:, None], self.frozen.cov[:, None])

    @cached_property
    def _bounded(self) -> bool:
        """Whether an error depends on a regressor, whose range counts."""
        return bool(np.isfinite([self.frozen.low, self.frozen.high]).any())

    @cached_property
    def _named_above(self) -> float:
        """The square of the factor on the limits beyond which a cause is named."""
        return float(max(self.threshold_scale, 1.0) ** 2)

    @cached_property
    def _limits(self) -> Array:
        """The limit of each window: what the healthy log shows, and at least what normal means exceed at the stated rate."""
        rate = FALSE_ALARM if self.fitted_rate is None else self.fitted_rate
        return np.asarray(np.maximum(self.frozen.limit, chi2.isf(rate / len(WINDOWS), len(self.plant.sensors))))

    @cached_property
    def _lengths(self) -> tuple[int, ...]:
        """The windows that have a limit, the first ones."""
        return WINDOWS[: int(np.isfinite(self._limits).sum())]

    def _start(self, batch: tuple[int, ...], seed: int) -> FrozenMemory:
        count, _, p = self._filter.counts
        q, none = self.frozen.mean.size, np.zeros(batch)
        return FrozenMemory(
            self._filter.start(batch), np.zeros((*batch, LONGEST, 2 * count + q)),
            np.zeros((*batch, LONGEST // PART, count, count + p)),
            np.zeros((*batch, LONGEST // PART + 1, count, count + p)), np.zeros((*batch, count + p)), none, none.copy(),
            none.copy(), np.zeros(batch, bool), np.full(batch, float(FADES)), none.copy(), np.full(batch, -1), none.copy(),
            np.full(batch, float(LONGEST)), none.copy(), np.full(batch, -1), none.copy(), np.full((*batch, count), np.nan),
            np.zeros((*batch, count)),
        )  # fmt: skip

    def _judge(self, memory: Any, now: TimeStep, y: Array, u: Array) -> tuple[Any, Decision]:
        return self._witnessed(memory, now, y, u)[:2]

    def _witnessed(self, memory: FrozenMemory, now: TimeStep, y: Array, u: Array) -> tuple[FrozenMemory, Decision, Witness]:
        """The memory after the readings, the verdict, and what the windows say beside it."""
        frozen, count = self.frozen, y.shape[-1]
        tracked, row = self._filter.step(memory.tracked, now.t_start, now.dt, y, u)
        phi = frozen.regressors(row.x, u)
        missed = phi @ frozen.coef.T
        error = np.where(unsure(row.variance, frozen.variance), np.nan, row.innovation - missed)
        by_cause, before = row.by_cause, memory.tracked.grown[..., FRESH, :, :]
        place, known = (now.k - 1) % LONGEST, np.isfinite(error)
        at, age = divmod(place, PART)
        part = memory.by_cause[:, at] if age else np.zeros_like(by_cause)
        begun = _with(memory.begun, (now.k - 1) // PART % (LONGEST // PART + 1), before) if age == 0 else memory.begun
        memory = memory._replace(
            tracked=tracked,
            rows=_with(memory.rows, place, np.concatenate([np.where(known, error, 0.0), known, phi], axis=-1)),
            by_cause=_with(memory.by_cause, at, part + (by_cause - part) / (age + 1)),
            begun=begun,
        )
        found = self._windows(now.k, now.t, memory, by_cause, row.by_begun)
        memory, isolated, size, process, suspect, witness = self._causes(memory, found, y)
        begins = (memory.age == 1) & found.alarm
        if begins.any():
            memory = memory._replace(
                tracked=memory.tracked.since(np.where(found.brief > 0, found.brief, FRESH), begins),
                begun=np.where(begins[..., None, None, None], 0.0, memory.begun),
            )
        sized = isolated & np.isfinite(size)
        expected = row.expected + missed
        unsized = isolated & ~sized
        reconstruction = np.where(np.isnan(y) | unsized, expected, np.where(isolated, y - size, y))
        residual, threshold = self._shown(now.k, found, error, isolated)
        fault_size = np.where(isolated, np.where(sized, size, y - expected), np.nan)
        process_size, process_sd = np.full((2, *process.shape), np.nan)
        estimate = row.x_after
        if (held := np.concatenate([sized, process[:, :-2]], axis=-1)).any():
            known, own = process[:, :-2], slice(count, None)
            process_size[:, :-2][known], process_sd[:, :-2][known] = found.size[:, own][known], found.sd[:, own][known]
            estimate = estimate + (row.effect_after @ np.where(held, found.size, 0.0)[..., None])[..., 0]
        diverged = row.lost | ~np.isfinite(estimate).all(axis=-1)
        return memory, Decision(
            estimate, reconstruction, residual, threshold, isolated, fault_size, diverged, row.guarded, row.nis, row.covariance,
            process=process, process_size=process_size, process_sd=process_sd, suspect=suspect,
            probability=shares_of_right(np.concatenate([isolated, process], axis=-1) | suspect),
        ), witness  # fmt: skip

    def _windows(self, k: int, t_now: float, memory: FrozenMemory, by_cause: Array, by_begun: Array) -> Found:
        """What the windows show after k rows, of which the last has the derivatives `by_cause` (B, N, M), and `by_begun` by
        causes that began with the event, at t_now (s). The windows are the first axis of arrays.
        """
        batch, causes, many = len(by_cause), by_cause.shape[-1], bisect_right(self._lengths, k - self.frozen.settle)
        if many == 0:
            return _silent(batch, causes)
        short, w, runs = min(many, SHORT), np.array(self._lengths[:many])[:, None], np.arange(batch)
        m, known, phi = self._means(k, memory.rows)
        off = beyond(phi[:many], self.frozen.low, self.frozen.high) if self._bounded else np.ones((many, batch))
        growth = self.frozen.growth(phi[:many]) * off
        kinds = self._derivatives(k, memory, by_cause, by_begun, w)
        d, acting = kinds[0], np.arange(causes) == memory.acting[:, None]
        beside = np.sum(np.where(acting[:, None], d, 0.0), axis=-1) if acting.any() else None
        spread = self._aged(Spread(*(a[:many] for a in self._spreads)), t_now, d, growth)
        means = Means(spread, m, known, growth * self._limits[:many, None])
        t, *each = means.explained(np.concatenate(kinds, axis=-1), beside)
        ways = np.stack(each).reshape(3, many, batch, len(kinds), causes)
        lasting, best = ways[0, ..., 0, :], ways[..., 0, :]
        for i in range(1, len(kinds)):
            best = np.where(ways[0, ..., i, :] > best[0], ways[..., i, :], best)
        j, s, power = best
        still = t > 0
        if many > short:
            shown, recent = means.late(d[..., :0], beside)[0]
            still[short:] = np.minimum(shown, LAST * recent) >= STILL * t[short:]
        now, level = (t > 1) & still, self._named_above
        found = _silent(batch, causes)._replace(
            ratio=np.where(still, t, 0.0).max(axis=0),
            shown=((j >= HALF * t[..., None]) & (still & (t > SHOWS))[..., None]).any(axis=0),
        )
        if self._bounded:
            found = found._replace(outside=np.any((t <= level) & (t * off > level) & (off > 1), axis=0))
        if now.any():
            above = np.where(now, t, 0.0)
            alarm, first, most = np.any(now, axis=0), np.argmax(now, axis=0), np.argmax(above, axis=0)
            sd = np.sqrt(growth[first, runs, None] / power[first, runs])
            own, size, sd = (np.where(alarm[:, None], a, 0.0) for a in (j[most, runs], s[first, runs], sd))
            brief = np.where(np.any(now[:short], axis=0), w[np.argmax(now[:short], axis=0), 0], 0)
            found = found._replace(alarm=alarm, total=above.max(axis=0), own=own, size=size, sd=sd, brief=brief)
        if beside is None:
            return found
        both, which = np.concatenate([beside[..., None], d], axis=-1), np.argmax(lasting, axis=-1)[..., None]
        _, alone, every, power = means.explained(both)
        second = np.take_along_axis(lasting - alone[..., 1:], which, axis=-1)[..., 0]
        left = alone[..., 0] + np.where(t > level, second, 0.0)
        shows = (left > level) & (alone[..., 0] > 0)
        if many > short:
            quarter, last = means.late(both[..., :1])[1][..., 0]
            shows[short:] &= np.minimum(quarter, LAST * last) >= STILL * alone[short:, :, 0]
        acts, first = np.any(shows, axis=0), np.argmax(shows, axis=0)
        explains, column = np.max(np.where(shows, left, 0.0), axis=0), acting & acts[:, None]
        fault = explains, every[first, runs, 0], np.sqrt(growth[first, runs] / power[first, runs, 0])
        own, size, sd = (np.where(column, a[:, None], b) for a, b in zip(fault, found[2:5], strict=True))
        return found._replace(own=own, size=size, sd=sd, ratio=np.maximum(found.ratio, explains), acts=acts)

    def _derivatives(self, k: int, memory: FrozenMemory, by_cause: Array, by_begun: Array, w: Array) -> list[Array]:
        """Mean derivatives over windows w (W, 1), each (W, B, N, M), by causes that last, that began with the event, 0 in
        windows that began later, where there is one, and by those that begin with the window, 0 in long ones.
        """
        d, long = np.empty((len(w), *by_cause.shape)), w[SHORT:]
        d[:SHORT] = by_cause
        if len(long):
            parts = sums(memory.by_cause.reshape(len(by_cause), LONGEST // PART, -1), PARTS, (k - 1) // PART)
            parts = np.swapaxes(parts[:, : len(long)], 0, 1) * (PART / long[..., None])
            d[SHORT:] = parts.reshape(-1, *by_cause.shape)
        kinds, began = [d], memory.abrupt & (memory.calm < FADES) & (memory.age < w)
        if began.any():
            begun = [by_begun if rows <= PART else self._mean_since(k, rows, memory) for rows in w[:, 0].tolist()]
            kinds.append(np.where(began[..., None, None], np.stack(begun), 0.0))
        fresh = np.zeros_like(d)
        fresh[:SHORT] = np.swapaxes(memory.tracked.grown[:, w[:SHORT, 0] - 1], 0, 1) / w[:SHORT, :, None, None]
        return [*kinds, fresh]

    def _mean_since(self, k: int, w: int, memory: FrozenMemory) -> Array:
        """The mean over the last w of k rows of derivatives (..., N, M) by causes that began with the event."""
        part, row = divmod(k - w, PART)
        first, second = (memory.begun[..., p % (LONGEST // PART + 1), :, :] for p in (part, part + 1))
        return np.asarray((memory.tracked.grown[..., FRESH, :, :] - first - row / PART * (second - first)) / w)

    def _means(self, k: int, rows: Array) -> tuple[Array, Array, Array]:
        """Over each of RANGES of the last of k rows (B, LONGEST, 2 N + q): the mean of the errors (R, B, N), whether enough of
        them are known, and the mean regressors (R, B, q).
        """
        total, count = np.swapaxes(sums(rows, LATEST, k - 1), 0, 1), len(self.plant.sensors)
        known = total[..., count : 2 * count]
        m = total[..., :count] / np.maximum(known, 1.0)
        return m, enough(known, self.frozen.share, LENGTHS), total[..., 2 * count :] / LENGTHS

    def _causes(self, memory: FrozenMemory, found: Found, y: Array) -> tuple[FrozenMemory, Array, Array, Array, Array, Witness]:
        """The memory, and what is isolated (B, N), of which size, which process hypotheses hold, and the suspects."""
        count = y.shape[-1]
        alarm = found.alarm & (found.total > self._named_above)
        over = memory.calm >= FADES
        kept = np.where(over, 0.0, KEPT)
        column = np.arange(found.own.shape[-1]) == memory.acting[:, None]
        more = np.where(alarm[:, None], found.total[:, None] - np.where(column, 0.0, found.own), 0.0)
        age = np.where(over, alarm, memory.age + 1.0)
        known = np.isfinite(y)
        gone = np.where((memory.acting >= 0) & ~found.acts, memory.gone + 1, 0.0)
        memory = memory._replace(
            left=kept[:, None] * memory.left + more,
            total=kept * memory.total + np.where(alarm, found.total, 0.0),
            weight=kept * memory.weight + alarm,
            age=age,
            abrupt=(memory.abrupt & ~over) | (alarm & (found.brief > 0) & (age <= FRESH)),
            calm=np.where(alarm, 0.0, memory.calm + 1),
            gone=gone,
            before=np.where(known, y, memory.before),
            repeats=np.where(known, np.where(memory.before == y, memory.repeats + 1, 0.0), memory.repeats),
        )
        said = self._explanation(memory, found, alarm)
        frozen = (memory.repeats > FROZEN * np.maximum(self.frozen.repeats, 2.0) * self._named_above) & known
        stuck, sensor = frozen.any(axis=-1) & ~said.sensor, said.sensor
        which = np.argmax(frozen, axis=-1)
        lasts = (said.best == memory.named) & (memory.since <= BRIEF)
        named_for = np.where(
            sensor, np.where(lasts, memory.named_for + 1, 1.0), np.where(memory.since < BRIEF, memory.named_for, 0.0)
        )
        begins = sensor & (named_for >= LONGEST) & (memory.acting < 0)
        counted = np.where(said.process.any(axis=-1), memory.process + 1, memory.process - 1)
        outside = found.outside & ~alarm
        process = np.concatenate([said.process, outside[:, None]], axis=-1)
        witness = Witness(alarm | outside, age, memory.calm, memory.abrupt, said.explains, found.shown)
        isolated = said.isolated | (column[:, :count] & found.acts[:, None])
        sizes = np.where(isolated & ~frozen, found.size[:, :count], np.nan)
        suspect = np.concatenate([said.suspect, np.zeros((len(y), 2), bool)], axis=-1)
        stuck_size = found.size[np.arange(len(y)), which]
        memory = memory._replace(
            calm=np.where(begins, FADES, memory.calm),
            process=np.where(begins, 0.0, np.clip(counted, 0.0, MOST)),
            named=np.where(sensor, said.best, np.where(stuck, which, memory.named)),
            size=np.where(sensor, said.size, np.where(stuck, stuck_size, memory.size)),
            since=np.where(sensor | stuck, 0.0, memory.since + 1),
            named_for=np.where(begins, 0.0, named_for),
            acting=np.where(gone > LATELY, -1, np.where(begins, said.best, memory.acting)),
        )
        return memory, isolated | frozen, sizes, process, suspect, witness

    def _explanation(self, memory: FrozenMemory, found: Found, alarm: Array) -> Explanation:
        """Which causes explain the event, in the runs in alarm (B,)."""
        count, (batch, causes) = len(self.plant.sensors), found.own.shape
        if not alarm.any():
            no = np.zeros((batch, causes + 1), bool)
            none = no[:, :causes]
            return Explanation(none, no[:, 0], no[:, 0] - 1, np.zeros(batch), no[:, :count], no[:, count:], none)
        weight = np.maximum(memory.weight, 1e-9)
        a, whole = memory.left / weight[:, None], memory.total / weight
        share = np.where(np.arange(causes) < count, LINEAR, SMALL)
        explains = alarm[:, None] & (a <= np.maximum(self._named_above, share * whole[:, None]))
        some = np.asarray(explains.any(axis=-1))
        best, runs = np.argmin(np.where(explains | ~some[:, None], a, np.inf), axis=-1), np.arange(batch)
        rival = explains & (a <= a[runs, best, None] + np.maximum(NEAR, NEAR_SHARE * whole)[:, None])
        beside = alarm & (memory.acting >= 0)
        rival[:, count:] |= beside[:, None] & (a[:, count:] <= BESIDE * whole[:, None])
        is_sensor = best < count
        rival[:, count:] &= is_sensor[:, None]  # unknowns are no rivals of each other
        rival[runs, best] = False
        alone = some & ~rival.any(axis=-1)
        size = found.size[runs, best]
        again, smaller = best == memory.named, np.abs(size) < np.abs(memory.size)
        largest = np.where(again & (memory.since <= BRIEF) & smaller, memory.size, size)
        smaller = (memory.since > BRIEF) & (np.abs(size) < AGAIN * np.abs(memory.size))
        returns = (np.sign(size) != np.sign(memory.size)) | smaller
        back = alone & is_sensor & again & returns & (memory.since < LONGEST)
        sensor = alone & is_sensor & ~back & (memory.process <= PROCESS)
        unnamed = alarm & (~some | (alone & is_sensor & ~back & ~sensor))
        chosen = np.arange(causes) == best[:, None]
        unknown = chosen[:, count:] & (alone & ~is_sensor)[:, None]
        return Explanation(
            explains,
            sensor,
            best,
            largest,
            chosen[:, :count] & sensor[:, None],
            np.concatenate([unknown, unnamed[:, None]], axis=-1),
            (some & ~alone)[:, None] & (rival | chosen),
        )

    def _shown(self, k: int, found: Found, error: Array, isolated: Array) -> tuple[Array, Array]:
        """Residuals (B, N), and thresholds of which the largest ratio is the root of the largest T over its limit.

        The window's size of each sensor, of those without alarm the row's error. Others than an isolated one stay below theirs.
        """
        known, alarm = np.isfinite(error), found.alarm[:, None]
        largest = np.sqrt(found.ratio)[:, None]
        own = np.where(alarm, found.own[:, : error.shape[-1]], np.where(known, error / self.plant.sensor_sigma, 0.0) ** 2)
        share = np.sqrt(own / np.maximum(own.max(axis=-1, keepdims=True), 1e-30))
        others = isolated.any(axis=-1, keepdims=True) & ~isolated
        share = np.where(others, np.minimum(share, self.threshold_scale / np.maximum(largest, self.threshold_scale)), share)
        ratio = np.maximum(largest * share, 1e-12)
        residual = np.where(alarm, found.size[:, : error.shape[-1]], error)
        residual = np.where(known, np.where(residual == 0, 1e-300, residual), np.nan)
        threshold = np.abs(residual) / ratio * self.threshold_scale
        return residual, threshold if k > self.frozen.settle else np.full(threshold.shape, np.inf)


def shares_of_right(held: Array) -> Array:
    """That of causes (..., H): what is named or suspected has equal shares of `RIGHT`."""
    return np.where(held, RIGHT / np.maximum(held.sum(axis=-1, keepdims=True), 1), 0.0)


def _with(ring: Array, at: int, row: Array) -> Array:
    """The ring (B, ...) with another row at a place."""
    ring = ring.copy()
    ring[:, at] = row
    return ring
