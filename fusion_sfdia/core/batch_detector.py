"""What the filter-based detectors share: arguments checked at the border, one layout of the state, and a batch of at least one.

A single run is stepped as a batch of one, so that both have the same bits: products of matrices round differently from those
of vectors.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np

from fusion_sfdia.core.arguments import Array, batch_shape, floats, number, probability, shown, whole
from fusion_sfdia.core.border import InputLimits
from fusion_sfdia.core.detector import Decision, State, check_reading
from fusion_sfdia.core.health import keep_broken_out, without_broken
from fusion_sfdia.core.log import as_log
from fusion_sfdia.core.order_statistics import order_statistic
from fusion_sfdia.core.plant import Plant

SILENT = 1e6  # a scale of thresholds that no residual reaches: nothing is isolated
CLOCK = 3  # scalars at the head of a state: seed, steps so far, time
FIELDS = tuple(f.name for f in fields(Decision))


class Moment(NamedTuple):
    """A step over [last, t], dt seconds long: the k-th since init with that seed."""

    last: float
    t: float
    dt: float
    seed: int
    k: int


@dataclass(frozen=True)
class BatchDetector(ABC):
    """A detector whose state is (seed, steps so far, time, diverged (*batch), *core), the core's arrays with the batch first.

    A subclass says how the core starts and judges readings of a batch with at least one axis.
    threshold_scale: all thresholds are multiplied by it, as where detectors are compared at one rate of false alarms.
    """

    plant: Plant
    threshold_scale: float = field(default=1.0, kw_only=True)

    def __post_init__(self) -> None:
        if not isinstance(self.plant, Plant):
            raise ValueError(f"plant is {shown(self.plant)}; expected a Plant")
        if not 0 < number("threshold_scale", self.threshold_scale) < np.inf:
            raise ValueError(
                f"threshold_scale is {self.threshold_scale}; expected a positive number, 1 for thresholds as they are"
            )

    @abstractmethod
    def _start(self, batch: tuple[int, ...], seed: int) -> State:
        """The core of a batch at the plant's x0."""

    @abstractmethod
    def _judge(self, core: State, now: Moment, y: Array, u: Array) -> tuple[State, Decision]:
        """The core after the readings y (*batch, N) under the input u (*batch, m); diverged: in this step."""

    @classmethod
    def fit(cls, plant: Plant, healthy: Any, false_alarm: float = 1e-3, **settings: Any) -> Self:
        """The detector with what it learns from healthy readings, at a rate of false alarms per step over all sensors.

        healthy: a Recording, a Log, a pandas frame or (t, y, u), see `as_log`. settings: of the detector, by name. What is
        learnt here are the thresholds, see `fit_thresholds`. ValueError where the readings are too few for the rate.
        """
        return cls(plant, **settings).fit_thresholds(healthy, false_alarm)

    def fit_thresholds(self, healthy: Any, false_alarm: float = 1e-3, warm_up: int = 20) -> Self:
        """The detector with the threshold_scale at which healthy readings alarm at a rate per step over all sensors.

        healthy: as in `fit`. The scale is an order statistic of the scores after the first `warm_up` samples of each run,
        while nothing is isolated; runs in which the estimate diverges are left out. ValueError where they are too few for the
        rate, less than one sample expected above the thresholds, and where no scale of the thresholds has that rate.
        """
        probability("false_alarm", false_alarm)
        whole("warm_up", warm_up, least=0)
        t, y, u = as_log(self.plant, healthy)
        silent = replace(self, threshold_scale=SILENT)
        state, scores = silent.init(y.shape[1:-1], float(t[0]) - self.plant.dt), []
        diverged = np.zeros(y.shape[1:-1], bool)
        for time, reading, applied in zip(t, y, u, strict=True):
            state, decision = silent.step(state, float(time), reading, applied)
            scores.append(decision.score * SILENT)
            diverged = diverged | decision.diverged
        found = np.stack(scores)[warm_up:, ~diverged].ravel()
        if found.size * false_alarm < 1:
            raise ValueError(
                f"{found.size} healthy samples cannot set thresholds that one in {1 / false_alarm:.0f} exceeds; give at least "
                f"that many after the first {warm_up} of each run, or ask for a higher rate of false alarms"
            )
        if not 0 < (scale := float(order_statistic(found, false_alarm))) < np.inf:
            raise ValueError(
                f"one score in {1 / false_alarm:.0f} of the healthy readings exceeds {scale:g}, so that no scale of the "
                f"thresholds of {type(self).__name__} has that rate of false alarms; use the detector as it is"
            )
        return replace(self, threshold_scale=scale)

    @property
    def hypotheses(self) -> tuple[str, ...]:
        return self.plant.sensor_names

    def init(self, batch: int | tuple[int, ...] = (), t: float = 0.0, seed: int = 0) -> State:
        """State at time t of a batch of that shape (a number: of that many runs); ValueError for anything else, and unless
        t is finite and seed an integer from 0 to 2^64 - 1.
        """
        shape, t, seed = batch_shape(batch), number("t", t), whole("seed", seed, least=0)
        if not np.isfinite(t) or seed >= 2**64:
            raise ValueError(f"t is {t}, seed {seed}; expected a finite time in seconds and a seed below 2^64")
        return np.array(seed, np.uint64), np.array(0), np.array(t), np.zeros(shape, bool), *self._start(shape, seed)

    def step(self, state: State, t: float, y: Array, u: Array) -> tuple[State, Decision]:
        """Diagnose the readings y (*batch, N) at t, NaN where missing, under the input u (*batch, m) or (m,) for all runs.

        Absurd readings count as missing, absurd inputs are replaced (see `border`); the Decision reports both. ValueError for a
        state of another detector, values or shapes that do not fit, and a time for which the model does not hold.
        """
        batch = self._batch_of(state)
        single = batch == ()
        given = floats("y", y)
        y, applied = check_reading(self.plant, given, u, batch)
        now = self._moment(state, number("t", t))
        u = self._input_limits.applied(now.last, now.dt, applied)
        taken = y, u, np.isnan(y) & ~np.isnan(given), u != applied
        y, u, absurd, absurd_input = (a[None] for a in taken) if single else taken
        diverged, *core = (a[None] for a in state[CLOCK:]) if single else state[CLOCK:]
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            after, decision = self._judge(tuple(core), now, y, u)
        capped = np.broadcast_to(decision.capped, diverged.shape)
        decision = replace(decision, capped=capped, absurd=absurd, absurd_input=absurd_input)
        diverged = diverged | decision.diverged
        if diverged.any():
            after = keep_broken_out(diverged, after, self._start(diverged.shape, now.seed))
            decision = without_broken(decision, diverged)
        batched = (diverged, *after)
        if single:
            batched = tuple([a[0, ...] for a in batched])  # of one number too an array
            told = (getattr(decision, name) for name in FIELDS)
            only: list[Any] = [None if a is None else a[0, ...] for a in told]
            decision = Decision(*only)
        return (state[0], np.array(now.k), np.array(now.t), *batched), decision

    @cached_property
    def _input_limits(self) -> InputLimits:
        return InputLimits(self.plant)

    def _moment(self, state: State, t: float) -> Moment:
        last = float(state[2])
        self.plant.check_dt(t - last)
        return Moment(last, t, t - last, int(state[0]), int(state[1]) + 1)

    @cached_property
    def _layout(self) -> tuple[tuple[int, ...], ...]:
        return tuple(a.shape for a in self._start((), 0))

    def _batch_of(self, state: State) -> tuple[int, ...]:
        """The shape of the state's batch; ValueError where it is no state of this detector."""
        if isinstance(state, tuple | list) and len(state) == CLOCK + 1 + len(self._layout):
            shapes = [a.shape if isinstance(a, np.ndarray) else np.shape(a) for a in state]
            batch = shapes[CLOCK]
            if shapes == [(), (), (), batch, *((*batch, *s) for s in self._layout)]:
                return batch
        raise ValueError(
            f"this is no state of {type(self).__name__} on plant {self.plant.name!r} with these settings; take it from "
            "its init, its last step or load_state"
        )
