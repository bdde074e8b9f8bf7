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
- a sensor that repeats a reading twice as often as it ever did when healthy is frozen.

The numbers below were chosen on one simulated air-handling unit, but `LINEAR`, `BRIEF`, `AGAIN`, `RIGHT` and `BESIDE` on plants
of our tests.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from fusion_sfdia.common.arguments import probability
from fusion_sfdia.common.order_statistics import order_statistic
from fusion_sfdia.detectors.batch_detector import BatchDetector, TimeStep
from fusion_sfdia.detectors.detector import Decision, ProcessHypothesis
from fusion_sfdia.learning.commissioning.commission import as_runs
from fusion_sfdia.learning.frozen_model.commissioned_model import Frozen, beyond, commissioned_without_faults, spread_of, unsure
from fusion_sfdia.learning.frozen_model.frozen_filter import FRESH, FrozenFilter, Tracked, unknowns
from fusion_sfdia.learning.frozen_model.window_means import WINDOWS, Spread, enough, explained
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

LONGEST = WINDOWS[-1]
PART = 10  # rows over which derivatives of errors are kept as one: they change slowly
FALSE_ALARM = 1e-3  # per row, where no rate was fitted
FADES = 60  # rows over which an event's rows count, and without alarm after which it is over
SMALL, LINEAR = 0.15, 0.08  # share of T that a change of an unknown may leave, and an offset, which bends no equation
NEAR, NEAR_SHARE = 0.3, 0.06  # limits, or share of T, by which a rival may leave more than the best cause
BESIDE = 0.5  # share of T that an unknown may leave, beside a lasting fault, and be a rival of a sensor all the same
STILL, LAST = 0.5, 1.5  # of T that the last quarter shows at least, and the factor on what the last rows show
LATELY = 10  # rows at least of the last quarter
SHOWS, HALF = 0.3, 0.5  # share of its limit, and of its T, at which a window shows a cause at all
PROCESS, MOST = 60, 240  # rows of process verdicts above which no sensor is named, and that are counted
BRIEF, AGAIN = 3, 0.5  # rows after which a sensor is named again only from this share of the size that it had
RIGHT = 0.95  # probability of what is named: of the rows that named a sensor, tried on plants with wrong laws, .99 were right
FROZEN = 2  # times the longest run of equal readings in the healthy log
NO_SINGLE_CAUSE = ProcessHypothesis("no single cause", "1", "unnamed", np.nan)
OUTSIDE = ProcessHypothesis("operation outside the healthy log", "1", "outside", np.nan)


class FrozenMemory(NamedTuple):
    """The filter; of the last LONGEST rows, at the place of their number, errors (..., LONGEST, N) and regressors
    (..., LONGEST, q), and means of their derivatives over PART rows (..., LONGEST / PART, N, M); the sums of the derivatives
    since the event began, as each PART began (..., LONGEST / PART + 1, N, M); what causes have left (..., M)
    of the event, and T, and their weight; rows of the event, and whether it began within a few rows; rows without alarm,
    and of process verdicts; the sensor named last, its largest size, and rows since; for how many rows it has been named; the
    sensor with a lasting fault, -1 for none, and rows since a window has shown it; the readings before, and their repeats
    (..., N).
    """

    tracked: Tracked
    errors: Array
    regressors: Array
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


class Lasting(NamedTuple):
    """What windows show of a lasting fault: the largest part of T over its limit that nothing else explains, 0 where none shows
    it; of the shortest that does its size, and sd (...).
    """

    explains: Array
    size: Array
    sd: Array

    def with_window(self, now: Lasting, growth: Array) -> Lasting:
        """With a longer window, the root of whose covariance has grown by so much (...)."""
        first = self.explains == 0
        size, sd = np.where(first, now.size, self.size), np.where(first, growth * now.sd, self.sd)
        return Lasting(np.maximum(self.explains, now.explains), size, sd)


@dataclass(frozen=True)
class FrozenBank(BatchDetector):
    """The detector with what a healthy log has shown; `fit` learns it."""

    frozen: Frozen = field(kw_only=True)

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

    @cached_property
    def _spreads(self) -> tuple[Spread, ...]:
        return tuple(spread_of(cov) for cov in self.frozen.cov)

    @cached_property
    def _named_above(self) -> float:
        """The square of the factor on the limits beyond which a cause is named."""
        return float(max(self.threshold_scale, 1.0) ** 2)

    @cached_property
    def _limits(self) -> Array:
        """The limit of each window: what the healthy log shows, and at least what normal means exceed at the stated rate."""
        rate = FALSE_ALARM if self.fitted_rate is None else self.fitted_rate
        return np.asarray(np.maximum(self.frozen.limit, chi2.isf(rate / len(WINDOWS), len(self.plant.sensors))))

    def _start(self, batch: tuple[int, ...], seed: int) -> FrozenMemory:
        count, _, p = self._filter.counts
        q, none = self.frozen.mean.size, np.zeros(batch)
        return FrozenMemory(
            self._filter.start(batch), np.full((*batch, LONGEST, count), np.nan), np.zeros((*batch, LONGEST, q)),
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
        place, axes = (now.k - 1) % LONGEST, y.ndim - 1
        part = np.take(memory.by_cause, place // PART, axis=axes) if place % PART else np.zeros_like(by_cause)
        first = (now.k - 1) % PART == 0
        memory = memory._replace(
            tracked=tracked,
            errors=_with(memory.errors, axes, place, error),
            regressors=_with(memory.regressors, axes, place, phi),
            by_cause=_with(memory.by_cause, axes, place // PART, part + (by_cause - part) / (place % PART + 1)),
            begun=_with(memory.begun, axes, (now.k - 1) // PART % (LONGEST // PART + 1), before) if first else memory.begun,
        )
        found = self._windows(now.k, memory, by_cause, row.by_begun)
        memory, isolated, size, process, suspect, witness = self._causes(memory, found, y)
        begins = (memory.age == 1) & found.alarm
        if begins.any():
            memory = memory._replace(
                tracked=memory.tracked.since(np.where(found.brief > 0, found.brief, FRESH), begins),
                begun=np.where(begins[..., None, None, None], 0.0, memory.begun),
            )
        no_size = np.isnan(np.where(isolated, size, 0.0))
        expected = row.expected + missed
        reconstruction = np.where(np.isnan(y) | no_size, expected, np.where(isolated, y - np.nan_to_num(size), y))
        residual, threshold = self._shown(now.k, found, error, isolated)
        fault_size = np.where(isolated, np.where(no_size, y - expected, size), np.nan)
        nothing = np.full((*isolated.shape[:-1], 2), np.nan)
        process_size, process_sd = (
            np.where(process, np.concatenate([a[..., count:], nothing], axis=-1), np.nan) for a in (found.size, found.sd)
        )
        lasting = np.concatenate([np.where(isolated, np.nan_to_num(size), 0.0), np.nan_to_num(process_size[..., :-2])], axis=-1)
        estimate = row.x_after + (row.effect_after @ lasting[..., None])[..., 0]
        diverged = row.lost | ~np.isfinite(estimate).all(axis=-1)
        return memory, Decision(
            estimate, reconstruction, residual, threshold, isolated, fault_size, diverged, row.guarded, row.nis, row.covariance,
            process=process, process_size=process_size, process_sd=process_sd, suspect=suspect,
            probability=_probability(np.concatenate([isolated, process], axis=-1) | suspect),
        ), witness  # fmt: skip

    def _windows(self, k: int, memory: FrozenMemory, by_cause: Array, by_begun: Array) -> Found:
        """What the windows show after k rows, of which the last has the derivatives `by_cause` (..., N, M), and `by_begun` by
        causes that began with the event.
        """
        batch, causes = by_cause.shape[:-2], by_cause.shape[-1]
        alarm, outside = np.zeros((2, *batch), bool)
        brief, event = np.zeros(batch, int), memory.abrupt & (memory.calm < FADES)
        total, ratio = np.zeros((2, *batch))
        own, size, sd = (np.zeros((*batch, causes)) for _ in range(3))
        seen, acting = np.zeros((*batch, causes), bool), np.arange(causes) == memory.acting[..., None]
        lasting, level = Lasting(*np.zeros((3, *batch))), self._named_above
        for i, (w, spread) in enumerate(zip(WINDOWS, self._spreads, strict=True)):
            if k - self.frozen.settle < w or not np.isfinite(self._limits[i]):
                continue
            rows = np.arange(k - w, k) % LONGEST
            m, known = self._mean(memory.errors[..., rows, :])
            phi = memory.regressors[..., rows, :].mean(axis=-2)
            off = beyond(phi, self.frozen.low, self.frozen.high)
            growth = self.frozen.growth(i, phi) * off
            g, d, began = growth * float(self._limits[i]), by_cause, event & (memory.age < w)
            if w > PART:
                parts = (k - 1) // PART - np.arange(w // PART)
                d = memory.by_cause[..., parts % (LONGEST // PART), :, :].mean(axis=-3)
            beside = np.sum(np.where(acting[..., None, :], d, 0.0), axis=-1) if acting.any() else None
            t, j, s, power = explained(spread, m, known, d, g, beside)
            then, still = j, t > 0
            others = [memory.tracked.grown[..., w - 1, :, :] / w] if w <= FRESH else []
            if began.any():
                begun = self._mean_since(k, w, memory) if w > PART else by_begun
                others.insert(0, np.where(began[..., None, None], begun, 0.0))
            for other in others:
                _, *than = explained(spread, m, known, other, g, beside)
                j, s, power = (np.where(than[0] > j, b, a) for a, b in zip((j, s, power), than, strict=True))
            if w > FRESH:
                quarter, last = (
                    self._mean(memory.errors[..., np.arange(k - r, k) % LONGEST, :]) for r in (max(w // 4, LATELY), LATELY)
                )
                shown, recent = (explained(spread, *a, d[..., :0], g, beside)[0] for a in (quarter, last))
                still = np.minimum(shown, LAST * recent) >= STILL * t
            if beside is not None:
                means = [(m, known), *([quarter, last] if w > FRESH else [])]
                lasting = lasting.with_window(
                    self._lasting(spread, means, np.concatenate([beside[..., None], d], axis=-1), then, g, t > level),
                    np.sqrt(growth),
                )
            ratio = np.maximum(ratio, np.where(still, t, 0.0))
            seen |= (j >= HALF * t[..., None]) & (still & (t > SHOWS))[..., None]
            outside |= (t <= level) & (t * off > level) & (off > 1)
            now = (t > 1) & still
            if w <= FRESH:
                brief = np.where(now & (brief == 0), w, brief)
            first, most = (a[..., None] for a in (now & ~alarm, now & (t > total)))
            alarm, total, own = alarm | now, np.where(now, np.maximum(t, total), total), np.where(most, j, own)
            size, sd = np.where(first, s, size), np.where(first, np.sqrt(growth[..., None] / power), sd)
        acts = lasting.explains > 0
        column = acting & acts[..., None]
        own, size, sd = (np.where(column, a[..., None], b) for a, b in zip(lasting[:3], (own, size, sd), strict=True))
        return Found(alarm, total, own, size, sd, np.maximum(ratio, lasting.explains), outside, seen, brief, acts)

    def _lasting(
        self, spread: Spread, means: Sequence[tuple[Array, Array]], by_cause: Array, then: Array, g: Array, second: Array
    ) -> Lasting:
        """What the means of a window, and of its last rows, show of a lasting fault.

        by_cause (..., N, 1 + M): derivatives by that fault, and by all causes. then (..., M): J of the causes beside it. second
        (...): whether another one acts, that which explains most.
        """
        (_, alone, size, power), *late = (explained(spread, *mean, by_cause, g) for mean in means)
        own, best = alone[..., 0], np.argmax(then, axis=-1)[..., None]
        left = own + np.where(second, np.take_along_axis(then - alone[..., 1:], best, axis=-1)[..., 0], 0.0)
        shows = (left > self._named_above) & (own > 0)
        if late:
            quarter, last = (j[..., 0] for _, j, _, _ in late)
            shows &= np.minimum(quarter, LAST * last) >= STILL * own
        return Lasting(*(np.where(shows, a, 0.0) for a in (left, size[..., 0], 1 / np.sqrt(power[..., 0]))))

    def _mean_since(self, k: int, w: int, memory: FrozenMemory) -> Array:
        """The mean over the last w of k rows of derivatives (..., N, M) by causes that began with the event."""
        part, row = divmod(k - w, PART)
        first, second = (memory.begun[..., p % (LONGEST // PART + 1), :, :] for p in (part, part + 1))
        return np.asarray((memory.tracked.grown[..., FRESH, :, :] - first - row / PART * (second - first)) / w)

    def _mean(self, errors: Array) -> tuple[Array, Array]:
        """The mean of rows (..., w, N) and whether enough of them are known (..., N)."""
        known = np.isfinite(errors)
        count = known.sum(axis=-2)
        m = np.where(known, errors, 0.0).sum(axis=-2) / np.maximum(count, 1)
        return m, enough(count, self.frozen.share, errors.shape[-2])

    def _causes(self, memory: FrozenMemory, found: Found, y: Array) -> tuple[FrozenMemory, Array, Array, Array, Array, Witness]:
        """The memory, and what is isolated (..., N), of which size, which process hypotheses hold, and the suspects."""
        count = y.shape[-1]
        level = self._named_above
        alarm = found.alarm & (found.total > level)
        kept = np.exp(-1 / FADES)
        over = memory.calm >= FADES
        weight, total = (np.where(over, 0.0, kept * a) for a in (memory.weight, memory.total))
        left = np.where(over[..., None], 0.0, kept * memory.left)
        weight = weight + alarm
        total = total + np.where(alarm, found.total, 0.0)
        column = np.arange(found.own.shape[-1]) == memory.acting[..., None]
        left = left + np.where(alarm[..., None], found.total[..., None] - np.where(column, 0.0, found.own), 0.0)
        calm = np.where(alarm, 0.0, memory.calm + 1)
        age = np.where(over, alarm, memory.age + 1.0)
        abrupt = (memory.abrupt & ~over) | (alarm & (found.brief > 0) & (age <= FRESH))
        a, whole = left / np.maximum(weight, 1e-9)[..., None], total / np.maximum(weight, 1e-9)
        share = np.where(np.arange(a.shape[-1]) < count, LINEAR, SMALL)
        explains = alarm[..., None] & (a <= np.maximum(level, share * whole[..., None]))
        some = np.asarray(explains.any(axis=-1))
        best = np.argmin(np.where(explains | ~some[..., None], a, np.inf), axis=-1)
        least = np.take_along_axis(a, best[..., None], axis=-1)
        rival = explains & (a <= least + np.maximum(NEAR, NEAR_SHARE * whole)[..., None])
        beside = alarm & (memory.acting >= 0)
        rival[..., count:] |= beside[..., None] & (a[..., count:] <= BESIDE * whole[..., None])
        is_sensor = best < count
        rival[..., count:] &= is_sensor[..., None]  # unknowns are no rivals of each other
        np.put_along_axis(rival, best[..., None], False, axis=-1)
        alone = some & ~rival.any(axis=-1)
        size = np.take_along_axis(found.size, best[..., None], axis=-1)[..., 0]
        lasts = (best == memory.named) & (memory.since <= BRIEF)
        largest = np.where(lasts & (np.abs(size) < np.abs(memory.size)), memory.size, size)
        smaller = (memory.since > BRIEF) & (np.abs(size) < AGAIN * np.abs(memory.size))
        returns = (np.sign(size) != np.sign(memory.size)) | smaller
        back = alone & is_sensor & (best == memory.named) & returns & (memory.since < LONGEST)
        sensor = alone & is_sensor & ~back & (memory.process <= PROCESS)
        unknown = alone & ~is_sensor
        unnamed = alarm & (~some | (alone & is_sensor & ~back & ~sensor))
        chosen = np.arange(found.own.shape[-1]) == best[..., None]
        isolated = chosen[..., :count] & sensor[..., None] | column[..., :count] & found.acts[..., None]
        suspect = np.asarray(some & ~alone)[..., None] & (rival | chosen)
        counted = np.where(unknown | unnamed, memory.process + 1, memory.process - 1)
        outside = found.outside & ~alarm
        same = memory.before == y
        known = np.isfinite(y)
        repeats = np.where(known, np.where(same, memory.repeats + 1, 0.0), memory.repeats)
        frozen = (repeats > FROZEN * np.maximum(self.frozen.repeats, 2.0) * self._named_above) & known
        stuck = frozen.any(axis=-1) & ~sensor
        which = np.argmax(frozen, axis=-1)
        size_stuck = np.take_along_axis(found.size, which[..., None], axis=-1)[..., 0]
        named_for = np.where(
            sensor, np.where(lasts, memory.named_for + 1, 1.0), np.where(memory.since < BRIEF, memory.named_for, 0.0)
        )
        gone = np.where((memory.acting >= 0) & ~found.acts, memory.gone + 1, 0.0)
        begins = sensor & (named_for >= LONGEST) & (memory.acting < 0)
        acting = np.where(gone > LATELY, -1, np.where(begins, best, memory.acting))
        process = np.concatenate([chosen[..., count:] & unknown[..., None], np.stack([unnamed, outside], axis=-1)], axis=-1)
        memory = memory._replace(
            left=left,
            total=total,
            weight=weight,
            age=age,
            abrupt=abrupt,
            calm=np.where(begins, FADES, calm),
            process=np.where(begins, 0.0, np.clip(counted, 0.0, MOST)),
            named=np.where(sensor, best, np.where(stuck, which, memory.named)),
            size=np.where(sensor, largest, np.where(stuck, size_stuck, memory.size)),
            since=np.where(sensor | stuck, 0.0, memory.since + 1),
            named_for=np.where(begins, 0.0, named_for),
            acting=acting,
            gone=gone,
            before=np.where(known, y, memory.before),
            repeats=repeats,
        )
        sizes = np.where(isolated & ~frozen, found.size[..., :count], np.nan)
        suspect = np.concatenate([suspect, np.zeros_like(suspect[..., :2])], axis=-1)
        witness = Witness(alarm | outside, age, calm, abrupt, explains, found.shown)
        return memory, isolated | frozen, sizes, process, suspect, witness

    def _shown(self, k: int, found: Found, error: Array, isolated: Array) -> tuple[Array, Array]:
        """Residuals (..., N), and thresholds of which the largest ratio is the root of the largest T over its limit.

        The window's size of each sensor, of those without alarm the row's error. Others than an isolated one stay below theirs.
        """
        count = error.shape[-1]
        largest = np.sqrt(found.ratio)[..., None]
        own = np.where(found.alarm[..., None], found.own[..., :count], (np.nan_to_num(error) / self.plant.sensor_sigma) ** 2)
        share = np.sqrt(own / np.maximum(own.max(axis=-1, keepdims=True), 1e-30))
        named = isolated.any(axis=-1, keepdims=True)
        share = np.where(
            named & ~isolated, np.minimum(share, self.threshold_scale / np.maximum(largest, self.threshold_scale)), share
        )
        ratio = np.maximum(largest * share, 1e-12)
        residual = np.where(found.alarm[..., None], found.size[..., :count], error)
        residual = np.where(np.isfinite(error), np.where(residual == 0, 1e-300, residual), np.nan)
        threshold = np.abs(residual) / ratio * self.threshold_scale
        return residual, np.where(k > self.frozen.settle, threshold, np.inf)


def _probability(held: Array) -> Array:
    """That of causes (..., H): what is named or suspected has equal shares of `RIGHT`."""
    return np.where(held, RIGHT / np.maximum(held.sum(axis=-1, keepdims=True), 1), 0.0)


def _with(ring: Array, axes: int, at: int, row: Array) -> Array:
    """The ring with another row at a place along the axis after so many."""
    ring = ring.copy()
    np.moveaxis(ring, axes, 0)[at] = row
    return ring
