"""What detectors share: checked arguments, one `State`, and a batch of at least one run.

A single run is stepped as a batch of one, so that both have the same bits: products of matrices round differently from those
of vectors.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import prod
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from fusion_sfdia.common.arguments import Array, batch_shape, floats, number, probability, shown, whole
from fusion_sfdia.common.order_statistics import order_statistic
from fusion_sfdia.detectors.detector import Claims, Decision, check_reading
from fusion_sfdia.detectors.health import keep_broken_out, of_runs, without_broken, without_readings
from fusion_sfdia.detectors.silent import silent, silent_scores
from fusion_sfdia.detectors.state import State, as_batch, as_single, leaves, mapped, with_runs
from fusion_sfdia.detectors.verdicts import FAR, far_off, judged
from fusion_sfdia.logs.log_forms import as_log
from fusion_sfdia.plant.border import InputLimits
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.redundancy import most_faults, redundancy

HELD = 30  # samples in a row in which all readings are far from the model and are not taken; what lasts longer is believed


class TimeStep(NamedTuple):
    """A step from t_start to t, the time of its readings, dt seconds long: the k-th since `init` with that seed.

    Attributes
    ----------
    t_start : float
        Time at which the step begins, in s.
    t : float
        Time of the readings in s.
    dt : float
        Length of the step in s.
    seed : int
        Of the randomness of the method.
    k : int
        Number of the step since `init`.

    Examples
    --------
    >>> from fusion_sfdia.detectors import TimeStep
    >>> TimeStep(t_start=55.0, t=60.0, dt=5.0, seed=0, k=12).dt
    5.0
    """

    t_start: float
    t: float
    dt: float
    seed: int
    k: int


def without_false_alarms(plant: Plant) -> float:
    """The rate of false alarms of thresholds that bounded noise cannot cross: 0, NaN where a sensor states no bound."""
    return 0.0 if all(np.isfinite(s.noise_bound) for s in plant.sensors) else np.nan


@dataclass(frozen=True)
class BatchDetector(Claims, ABC):
    """A detector whose state is a `State`: a subclass defines its memory, how it starts, and how it judges readings.

    The memory is a NamedTuple of arrays with the batch as leading axes, or of such tuples, see `detectors.state`.

    Parameters
    ----------
    plant : Plant
        The model.
    threshold_scale : float, default 1
        Factor on all thresholds, for the comparison of detectors at one false-alarm rate.
    fitted_rate : float, optional
        The rate per step over all sensors for which that factor was fitted to healthy readings, None where it was not:
        `false_alarm`, where a detector has it, is what its thresholds have at a factor of 1 on the model itself.

    Examples
    --------
    >>> from fusion_sfdia import simulate
    >>> from fusion_sfdia.detectors import BatchDetector, CentralFilter
    >>> from fusion_sfdia.plants import two_tanks
    >>> plant = two_tanks()
    >>> detector: BatchDetector = CentralFilter(plant)
    >>> fitted = detector.fit_thresholds(simulate(plant, 200, seeds=[0, 1]), false_alarm=0.05)
    >>> detector.fitted_rate, fitted.fitted_rate
    (None, 0.05)
    """

    estimates: ClassVar[bool] = True  # a state, which readings that are far off would spoil

    plant: Plant
    threshold_scale: float = field(default=1.0, kw_only=True)
    fitted_rate: float | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        if not isinstance(self.plant, Plant):
            raise ValueError(f"plant is {shown(self.plant)}; expected a Plant")
        if not 0 < number("threshold_scale", self.threshold_scale) < np.inf:
            raise ValueError(
                f"threshold_scale is {self.threshold_scale}; expected a positive number; 1 leaves the thresholds unchanged"
            )
        if self.fitted_rate is not None:
            probability("fitted_rate", self.fitted_rate)

    @abstractmethod
    def _start(self, batch: tuple[int, ...], seed: int) -> Any:
        """The memory of a batch of one axis at the plant's x0."""

    @abstractmethod
    def _judge(self, memory: Any, now: TimeStep, y: Array, u: Array) -> tuple[Any, Decision]:
        """The memory after the readings y (B, N) of B runs under the input u (B, m).

        `diverged` of the Decision states whether the estimate broke down in this step.
        """

    @classmethod
    def fit(cls, plant: Plant, healthy: Any, false_alarm: float = 1e-3, **settings: Any) -> Self:
        """The detector fitted to healthy readings, at a false-alarm rate per step over all sensors.

        Parameters
        ----------
        plant : Plant
            The model.
        healthy : Recording, Log, frame or tuple
            A Recording, a Log, a pandas frame or (t, y, u), see `as_log`.
        false_alarm : float, default 1e-3
            The rate. By default only the thresholds are fitted to it, see `fit_thresholds`.
        **settings
            Of the detector, by name.

        Returns
        -------
        Self
            The fitted detector.

        Raises
        ------
        ValueError
            Where the readings are too few for the rate.
        """
        return cls(plant, **settings).fit_thresholds(healthy, false_alarm)

    def fit_thresholds(self, healthy: Any, false_alarm: float = 1e-3, warm_up: int = 20) -> Self:
        """The detector with the threshold_scale at which healthy readings alarm at a given rate per step over all sensors.

        The scale is an order statistic of the scores after the first `warm_up` samples of each run, while nothing is isolated;
        runs in which the estimate diverges are left out.

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
            The fitted detector.

        Raises
        ------
        ValueError
            Where they are too few for the rate (less than one sample expected above the thresholds), and where no scale of the
            thresholds has that rate.
        """
        log = self._healthy(healthy, false_alarm, warm_up)
        state, scores = silent_scores(silent(replace(self, threshold_scale=1.0)), *log)
        found = scores[warm_up:, ~state.diverged].ravel()
        if found.size * false_alarm < 1:
            raise ValueError(
                f"{found.size} healthy samples cannot set thresholds that one in {1 / false_alarm:.0f} exceeds; give at least "
                f"that many after the first {warm_up} of each run, or choose a higher false-alarm rate"
            )
        if not 0 < (scale := float(order_statistic(found, false_alarm))) < np.inf:
            raise ValueError(
                f"one score in {1 / false_alarm:.0f} of the healthy readings exceeds {scale:g}, so that no scale of the "
                f"thresholds of {type(self).__name__} has that false-alarm rate; use the detector unchanged"
            )
        return replace(self, threshold_scale=scale, fitted_rate=false_alarm)

    def _healthy(self, healthy: Any, false_alarm: float, warm_up: int) -> Log:
        """The healthy readings as a Log; ValueError where they or the numbers do not fit."""
        probability("false_alarm", false_alarm)
        whole("warm_up", warm_up, least=0)
        return as_log(self.plant, healthy)

    def with_sensors_of(self, plant: Plant) -> Self:
        """The detector on the same plant with other noise, resolutions or periods of its sensors.

        Parameters
        ----------
        plant : Plant
            Which has those sensors.

        Returns
        -------
        Self
            With that plant.
        """
        return replace(self, plant=plant)

    @property
    def hypotheses(self) -> tuple[str, ...]:
        return self.plant.sensor_names

    @property
    def most_faults(self) -> int:
        """How many sensors it isolates at once at most: all of the plant where its method sets no limit."""
        return len(self.plant.sensors)

    def init(self, batch: int | tuple[int, ...] = (), t: float = 0.0, seed: int = 0) -> State:
        """State at time t of a batch of runs.

        Parameters
        ----------
        batch : int or tuple of int, default ()
            Shape of the batch; a number: that many runs.
        t : float, default 0
            Time in s at which the first step begins.
        seed : int, default 0
            Of the randomness of the method, from 0 to 2^64 - 1.

        Returns
        -------
        State
            Before the first reading.

        Raises
        ------
        ValueError
            For any other shape, and unless t is finite and seed an integer within its limits.
        """
        shape, t, seed = batch_shape(batch), number("t", t), whole("seed", seed, least=0)
        if not np.isfinite(t) or seed >= 2**64:
            raise ValueError(f"t is {t}, seed {seed}; expected a finite time in seconds and a seed below 2^64")
        memory = self._start((prod(shape),), seed)
        if len(shape) != 1:
            memory = mapped(lambda a: a.reshape((*shape, *a.shape[1:])), memory)
        never = np.full(shape, -1)
        return State(np.array(seed, np.uint64), np.array(0), np.array(t), np.zeros(shape, bool), never, memory)

    def step(self, state: State, t: float, y: Array, u: Array) -> tuple[State, Decision]:
        """Diagnose readings under the input that acted until then.

        Absurd readings count as missing, absurd inputs are replaced (see `border`); the Decision reports both. Samples in which
        all readings are far from a model that they were near to before (`far_off`) are not taken, up to `HELD` in a row: their
        Decision has residuals and thresholds, and isolates nothing more.

        Parameters
        ----------
        state : State
            After the last reading, or of `init`.
        t : float
            Time of the readings in s.
        y : array (*batch, N)
            Readings in the units of the sensors, NaN where missing.
        u : array (*batch, m) or (m,)
            Input that acted from state.t to t; the latter for all runs.

        Returns
        -------
        state : State
            After these readings.
        decision : Decision
            What the detector states of them.

        Raises
        ------
        ValueError
            For a state of another detector, values or shapes that do not fit, and a time for which the model does not hold.
        """
        batch = self._batch_of(state)
        single = batch == ()
        given = floats("y", y)
        y, applied = check_reading(self.plant, given, u, batch)
        if len(batch) > 1:
            return self._step_of_axes(batch, state, t, given, applied)
        now = self._time_step(state, number("t", t))
        u = self._input_limits.applied(now.t_start, now.dt, applied)
        taken = y, u, np.isnan(y) & ~np.isnan(given), u != applied
        y, u, absurd, absurd_input = (a[None] for a in taken) if single else taken
        diverged, far, memory = state.diverged, state.far, state.memory
        if single:
            diverged, far, memory = diverged[None], far[None], as_batch(memory)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            after, decision = self._judge(memory, now, y, u)
            all_far = far_off(decision, self.threshold_scale)
            off = (all_far | decision.diverged) & self.estimates & (far >= 0)
            if (held := off & (far < HELD)).any():
                without, expected = self._judge(memory, now, np.where(held[..., None], np.nan, y), u)
                off = off & (~held | self._all_far(decision, expected, y))
                held = held & off
                after, decision = of_runs(held, without, after), without_readings(held, decision, expected)
                all_far = far_off(decision, self.threshold_scale)
        near = judged(decision) & ~all_far & self.estimates
        far = np.where(off, far + 1, np.where(near, 0, far))
        capped = decision.capped
        if capped.shape != diverged.shape:
            capped = np.broadcast_to(capped, diverged.shape)
        found = {**vars(decision), "capped": capped, "absurd": absurd, "absurd_input": absurd_input}
        diverged = diverged | decision.diverged
        if diverged.any():
            after = keep_broken_out(diverged, after, self._start(diverged.shape, now.seed))
            found = vars(without_broken(Decision(**found), diverged))
        if self.plant.cyclic_sensors is not None:
            found["reconstruction"] = self.plant.near(found["reconstruction"], y)
        if single:
            diverged, far, after = diverged[0, ...], far[0, ...], as_single(after)
            found = {name: None if a is None else a[0, ...] for name, a in found.items()}
        return State(state.seed, np.array(now.k), np.array(now.t), diverged, far, after), Decision(**found)

    def _step_of_axes(self, batch: tuple[int, ...], state: State, t: float, y: Array, u: Array) -> tuple[State, Decision]:
        """A step of a batch of several axes, whose runs are stepped as one of a single axis."""
        count = prod(batch)
        flat = with_runs(state, lambda a: a.reshape(count, *a.shape[len(batch) :]))
        after, found = self.step(flat, t, y.reshape(count, y.shape[-1]), u.reshape(count, u.shape[-1]))
        arrays: dict[str, Any] = {
            name: None if a is None else a.reshape(*batch, *a.shape[1:]) for name, a in vars(found).items()
        }
        return with_runs(after, lambda a: a.reshape(*batch, *a.shape[1:])), Decision(**arrays)

    def _all_far(self, decision: Decision, expected: Decision, y: Array) -> Array:
        """Whether all readings y (B, N), and at least two, are `FAR` thresholds from those expected without them."""
        known = np.isfinite(decision.threshold)
        limit = np.where(known, decision.threshold / self.threshold_scale, 3.0 * self.plant.sensor_sigma)
        distance = np.abs(self.plant.near(y, expected.reconstruction) - expected.reconstruction)
        far = distance > FAR * limit
        return np.asarray(np.all(far | np.isnan(y), axis=-1) & (np.sum(far, axis=-1) > 1))

    def readmit(self, state: State, sensors: str | Iterable[str]) -> State:
        """The state in which sensors are used again in all runs: after their repair, or where an isolation was wrong.

        A sensor that alone sees a lasting mode of the plant may never be used again on its own, since the estimate without it
        keeps its error (`inspect` lists them): a bank then also widens the covariance of its estimate by what the
        readings differed from it, so that it follows the repaired sensor. Nor is any of a detector whose alarms latch.
        Detectors that judge each reading anew keep none out; they return the state as it is.

        Parameters
        ----------
        state : State
            After the last reading.
        sensors : str or iterable of str
            Their names.

        Returns
        -------
        State
            From which the run goes on.

        Raises
        ------
        ValueError
            For a state of another detector and an unknown sensor.
        """
        self._batch_of(state)
        named = [sensors] if isinstance(sensors, str) else list(sensors)
        which = np.zeros(len(self.plant.sensors), bool)
        which[[self.plant.sensor_index(name) for name in named]] = True
        return state._replace(memory=self._readmitted(state.memory, float(state.t), which))

    def _readmitted(self, memory: Any, t: float, which: Array) -> Any:
        """The memory at t (s) with the sensors `which` (N,) in use again."""
        return memory

    @cached_property
    def _input_limits(self) -> InputLimits:
        return InputLimits(self.plant)

    def _time_step(self, state: State, t: float) -> TimeStep:
        t_start = float(state.t)
        self.plant.check_dt(t - t_start)
        return TimeStep(t_start, t, t - t_start, int(state.seed), int(state.steps) + 1)

    @cached_property
    def _layout(self) -> tuple[type, list[tuple[int, ...]]]:
        """The class of the memory and the shapes of its arrays in a single run."""
        memory = self._start((1,), 0)
        return type(memory), [a.shape[1:] for a in leaves(memory)]

    def _batch_of(self, state: State) -> tuple[int, ...]:
        """The shape of the state's batch; ValueError where it is no state of this detector."""
        kind, expected = self._layout
        if isinstance(state, State) and isinstance(state.memory, kind):
            batch = np.shape(state.diverged)
            found = [getattr(a, "shape", None) for a in leaves(state)]
            if found == [(), (), (), batch, batch, *([(*batch, *s) for s in expected] if batch else expected)]:
                return batch
        raise ValueError(
            f"this is no state of {type(self).__name__} on plant {self.plant.name!r} with these settings; take it from "
            "its init, its last step or load_state"
        )


class IsolatingDetector(BatchDetector):
    """One with a setting max_faults: how many sensors it isolates at once, None for what the plant's redundancy allows."""

    max_faults: int | None

    @cached_property
    def most_faults(self) -> int:
        """How many sensors it isolates at once at most."""
        return min(self.max_faults or most_faults(self.plant), len(self.plant.sensors))

    def why_no_more(self) -> str:
        return redundancy(self.plant).reason if self.max_faults is None else "as max_faults states"


class AccommodatingDetector(IsolatingDetector):
    """One with a setting `accommodate`, too: whether it goes on without the readings of isolated sensors."""

    accommodate: bool

    def watching(self) -> Self:
        settings: Any = self  # a dataclass in each detector
        quiet: Self = replace(settings, accommodate=False)
        return quiet
