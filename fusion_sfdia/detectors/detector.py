"""The contract that every detector keeps: frozen settings, `init` and `step` with explicit state, a Decision."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from datetime import datetime
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from fusion_sfdia.common.arguments import floats
from fusion_sfdia.common.errors import NotApplicableError
from fusion_sfdia.detectors.state import State
from fusion_sfdia.logs.log_forms import as_log
from fusion_sfdia.plant.border import possible
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]


SHOWN_BY = ("", "freeze", "dropout", "noise")  # what shows a sensor, where it is not its level


class ProcessHypothesis(NamedTuple):
    """Something of the plant that may differ from the model.

    Attributes
    ----------
    name : str
        Of the parameter, input, state or disturbance.
    unit : str
        Of its size.
    kind : str
        "parameter", "input" (a constant error of it), "state" (its equation errs), "disturbance", "unnamed" (something else of
        the process, or several causes), "together" (readings that move as in no healthy log), "outside" (operation as in
        none), "since start" (the model has been wrong since the first sample), "recorder" (several sensors stopped at once) or
        "still" (a reading that never moved in a healthy log does).
    nominal : float
        The value of the model, in the unit; NaN where there is none.

    Examples
    --------
    >>> from fusion_sfdia.detectors import RobustBank
    >>> from fusion_sfdia.plants import two_tanks
    >>> RobustBank(two_tanks()).process_hypotheses[0]
    ProcessHypothesis(name='outlet_1', unit='m2.5/s', kind='parameter', nominal=0.0006)
    """

    name: str
    unit: str
    kind: str
    nominal: float

    @property
    def has_size(self) -> bool:
        """Whether an accepted one has a size, a difference from the model in its unit."""
        return self.kind not in ("unnamed", "together", "outside", "since start", "recorder")

    @property
    def of_operation(self) -> bool:
        """Whether it is no fault of the process, but an operation or a recording that no healthy log has."""
        return self.kind in ("outside", "recorder", "still")


def require_no_cycles(plant: Plant, what: str) -> None:
    """Raise NotApplicableError for a plant with cyclic readings, which `what` would take for large changes."""
    if (found := plant.cyclic_sensors) is not None:
        names = ", ".join(plant.sensor_names[i] for i in found.at)
        raise NotApplicableError(
            f"the readings of {names} are cyclic, which {what} do not take into account; use a detector with a model, such as "
            "loo-glr, or leave these sensors out of the plant"
        )


@dataclass(frozen=True)
class Decision:
    """The result of one step; leading axes are the batch (and time, in a run).

    Attributes
    ----------
    estimate : array (..., n)
        State estimate.
    reconstruction : array (..., N)
        The readings, with missing ones and, where the method accommodates, isolated ones replaced by the values that the method
        expects.
    residual : array (..., N)
        In sensor units; NaN was not evaluated.
    threshold : array (..., N)
        In sensor units; inf allows no decision yet.
    isolated : array (..., hypotheses) of bool
        The isolated hypotheses.
    fault_size : array (..., hypotheses)
        NaN where not isolated.
    diverged : array (...) of bool
        The estimator has broken down or its model gave no finite value, now or in an earlier step: every number of this
        Decision is NaN and nothing is isolated.
    guarded : array (...) of bool
        The estimate, or one of its members or sigma points, left the limits of the model and was moved back.
    nis : array (...)
        Normalised innovation squared per reading used; 1 on average for a consistent filter, NaN where there is none.
    covariance : array (..., n, n) or None
        Of the estimate; None where the method has none.
    capped : array (...) of bool
        Another sensor would be isolated, but as many are left out already as the method allows; may be a single False, where a
        method has no such limit.
    absurd : array (..., N) of bool
        Readings taken as missing (see `border`); may be a single False, likewise.
    absurd_input : array (..., m) of bool
        Inputs replaced (see `border`); may be a single False, likewise.
    process : array (..., P) of bool or None
        Of a detector that tests the process, too, else None, as the following ones: the accepted `process_hypotheses`.
    process_size : array (..., P) or None
        How far the process is above the model, in the unit of the hypothesis; NaN where not accepted.
    process_sd : array (..., P) or None
        Standard deviation of that, likewise.
    suspect : array (..., hypotheses + P) of bool or None
        The hypotheses that explain an alarm without a decision between them.
    probability : array (..., hypotheses + P) or None
        Of each hypothesis at present, what is missing to 1 is that of none; NaN where the method states none.
    shown_by : array (..., N) of int or None
        Of a detector that knows it at each row: the place in ("", "freeze", "dropout", "noise") of what shows a sensor.

    Examples
    --------
    >>> from fusion_sfdia import run, simulate
    >>> from fusion_sfdia.detectors import CentralFilter
    >>> from fusion_sfdia.plants import two_tanks
    >>> detector = CentralFilter(two_tanks(), false_alarm=1e-6)
    >>> recording = simulate(detector.plant, 20, seeds=[1])
    >>> state, decisions = run(detector, detector.init(1), recording)
    >>> decisions.residual.shape, bool(decisions.alarm.any())
    ((20, 1, 4), False)
    """

    estimate: Array
    reconstruction: Array
    residual: Array
    threshold: Array
    isolated: Array
    fault_size: Array
    diverged: Array
    guarded: Array
    nis: Array
    covariance: Array | None = None
    capped: Array = field(default_factory=lambda: np.zeros((), bool))
    absurd: Array = field(default_factory=lambda: np.zeros((), bool))
    absurd_input: Array = field(default_factory=lambda: np.zeros((), bool))
    process: Array | None = None
    process_size: Array | None = None
    process_sd: Array | None = None
    suspect: Array | None = None
    probability: Array | None = None
    shown_by: Array | None = None

    @property
    def scores(self) -> Array:
        """|residual| / threshold of each sensor (..., N); 0 where not evaluated."""
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = np.abs(self.residual) / self.threshold
        return np.where(np.isfinite(self.residual), ratio, 0.0)

    @property
    def score(self) -> Array:
        """The largest of `scores` (...)."""
        return np.asarray(self.scores.max(axis=-1))

    @property
    def alarm(self) -> Array:
        """Whether a residual exceeds its threshold or a hypothesis is isolated (...)."""
        return np.asarray((self.score > 1) | self.isolated.any(axis=-1))


OWN_CLASS = (
    "a class of your own derives from fusion_sfdia.detectors.BatchDetector, or from fusion_sfdia.detectors.detector.Claims"
)

if TYPE_CHECKING:
    Default = property
else:

    class Default:
        """A property that a class or an object may replace by a field or an attribute of that name."""

        def __init__(self, of: Callable[[Any], Any]) -> None:
            self.of, self.__doc__ = of, of.__doc__

        def __get__(self, found: Any, kind: Any = None) -> Any:
            if found is None:  # of the class: a dataclass then takes a field of that name for one without a default
                raise AttributeError("of objects only")
            return self.of(found)


class Claims(Protocol):
    """What a detector states of itself beside its decisions. Each has a default, which a class inherits from this one.

    process_hypotheses: what of the process it tests, too. filter_model: the plant whose state its Kalman filter estimates, None
    where it has no such filter. most_faults: how many sensors it isolates at once at most; `why_no_more` says in words what
    sets that. threshold_scale: factor on all thresholds. false_alarm: the rate of alarms per step over all sensors for which
    its thresholds are designed, fitted_rate that for which they were fitted to healthy readings, None where there is none.
    claimed_rate: alarms per step over all sensors without a fault that it claims at most, NaN where it claims nothing. steps:
    as `step` for each of t (K,), y (K, N), u (K, m) of one run, with the same bits unless it states otherwise, where there is a
    faster way; else None.
    watching: itself without accommodation, where it has any, so that readings are not replaced. dated: itself for readings
    whose seconds begin at a moment of the wall clock, None where that is not known; another where what was learnt ages.
    fit_thresholds: itself with thresholds for that rate from healthy readings.
    """

    @Default
    def process_hypotheses(self) -> tuple[ProcessHypothesis, ...]:
        return ()

    @Default
    def filter_model(self) -> Plant | None:
        return None

    @Default
    def most_faults(self) -> float:
        return np.inf

    def why_no_more(self) -> str:
        return f"the method of {type(self).__name__} names no more"

    @Default
    def threshold_scale(self) -> float:
        return 1.0

    @Default
    def false_alarm(self) -> float | None:
        return None

    @Default
    def fitted_rate(self) -> float | None:
        return None

    @Default
    def claimed_rate(self) -> float:
        if self.fitted_rate is not None:
            return float(self.fitted_rate)
        return np.nan if self.false_alarm is None or self.threshold_scale < 1 else float(self.false_alarm)

    def steps(self, state: State, t: Array, y: Array, u: Array) -> tuple[State, Decision] | None:
        return None

    def watching(self) -> Self:
        return self

    def dated(self, start: datetime | None) -> Self:
        return self

    def fit_thresholds(self, healthy: Any, false_alarm: float = 1e-3) -> Self:
        raise ValueError(f"{type(self).__name__} has no thresholds to fit to healthy readings; set them where it is built")


@runtime_checkable
class Detector(Claims, Protocol):
    """A diagnosis method bound to a plant; a class of one inherits from `BatchDetector`, or from `Claims`.

    A step of a plant begins at its `t_start`; t, as in a state, is the time of readings.

    Attributes
    ----------
    plant : Plant
        The model.
    hypotheses : tuple of str
        What can be isolated, the plant's sensors first.

    Notes
    -----
    init(batch, t, seed): the `State` at time t (s) of a batch of that shape; seed fixes all randomness of the method.
    step(state, t, y, u): y (..., N) read at t (s; NaN where missing), u (..., m) the input that acted from state.t to t;
    returns the next state and a `Decision`. What else a detector states of itself has defaults in `Claims`.

    Examples
    --------
    >>> from fusion_sfdia.detectors import CentralFilter, Detector
    >>> from fusion_sfdia.plants import two_tanks
    >>> isinstance(CentralFilter(two_tanks()), Detector)
    True
    """

    @property
    def plant(self) -> Plant: ...
    @property
    def hypotheses(self) -> tuple[str, ...]: ...
    def init(self, batch: tuple[int, ...] = (), t: float = 0.0, seed: int = 0) -> State: ...
    def step(self, state: State, t: float, y: Array, u: Array) -> tuple[State, Decision]: ...


def check_reading(plant: Plant, y: Array, u: Array, batch: tuple[int, ...]) -> tuple[Array, Array]:
    """Return y as floats (*batch, N), NaN where missing or absurd, and u as (*batch, m), which may be given once for all
    runs.

    ValueError for anything but numbers, for other shapes, infinities and missing inputs.
    """
    y, u = floats("y", y), floats("u", u)
    n, m = len(plant.sensors), len(plant.inputs)
    if y.shape[-1:] == (n,) and y.shape[:-1] != batch:
        raise ValueError(
            f"y has shape {y.shape}; expected {(*batch, n)}: the state is of a batch {batch}; start from init({y.shape[:-1]}), "
            "or pass readings of that batch, of a Recording of one run Log(t, y[:, 0], u)"
        )
    if y.shape != (*batch, n):
        raise ValueError(
            f"y has shape {y.shape}; expected {(*batch, n)}: plant {plant.name!r} has {n} sensors; pass NaN for a missing one"
        )
    expected = (*batch, m)
    if u.shape[-1:] != (m,):
        raise ValueError(
            f"u has shape {u.shape}; plant {plant.name!r} has {m} inputs ({', '.join(s.name for s in plant.inputs)})"
        )
    if u.shape != expected and (
        len(u.shape) > len(expected) or any(a not in (1, b) for a, b in zip(u.shape[-2::-1], batch[::-1], strict=False))
    ):
        raise ValueError(f"u has shape {u.shape}; it does not broadcast to {expected}: give ({m},) or one row for each run")
    if not np.isfinite(u).all():
        raise ValueError("u has values that are not finite; an input must be known")
    u = u if u.shape == expected else np.broadcast_to(u, expected)
    if (np.abs(y) <= plant.largest_readings).all():
        return y, u
    if np.isinf(y).any():
        raise ValueError("y has infinite readings; pass NaN for a missing one")
    return possible(plant, y), u


def run(detector: Detector, state: State, *data: Any, covariance: bool = False) -> tuple[State, Decision]:
    """Step through t (K,), y (K, ..., N), u (K, ..., m); return the last state and the Decisions stacked over time.

    Parameters
    ----------
    detector : Detector
        The method on its plant.
    state : State
        That of the detector before the first reading, from `init`, `run` or `load_state`. The first row of a frame with time
        stamps is at 0 s: start it from init(..., t=-plant.dt).
    *data : arrays, Log, Recording or frame
        t, y, u, or one object that holds them, see `as_log`.
    covariance : bool, default False
        Whether the Decisions keep the covariances (K, ..., n, n), which take most of the memory.

    Returns
    -------
    state : State
        After the last reading.
    decisions : Decision
        Its arrays have the time as first axis.

    Raises
    ------
    ValueError
        Where the data do not fit the plant, or their batch is not that of the state.

    Examples
    --------
    >>> from fusion_sfdia import run, simulate
    >>> from fusion_sfdia.detectors import CentralFilter
    >>> from fusion_sfdia.plants import two_tanks
    >>> detector = CentralFilter(two_tanks())
    >>> state, decisions = run(detector, detector.init(2), simulate(detector.plant, 20, seeds=[0, 1]))
    >>> decisions.residual.shape, int(state.steps)
    ((20, 2, 4), 20)
    """
    if isinstance(detector, type):
        raise ValueError(f"{detector.__name__} is a class; build it on a plant first, as in {detector.__name__}(plant)")
    t, y, u = as_log(detector.plant, *data)
    decisions = []
    with threadpool_limits(1):  # of linear algebra: matrices are small, threads would wait for each other
        for time, reading, applied in zip(t, y, u, strict=True):
            state, decision = detector.step(state, float(time), reading, applied)
            decisions.append(decision)
    return state, stack(decisions, covariance=covariance)


def joined(parts: Sequence[Decision]) -> Decision:
    """One Decision of several whose arrays have time as their first axis."""
    return _each(parts[0], lambda name: np.concatenate([getattr(d, name) for d in parts]))


def room_for(like: Decision, times: int) -> Decision:
    """Arrays as those of `like`, without values, for so many times: a long log has no memory for two copies."""
    return _each(like, lambda name: np.empty((times, *getattr(like, name).shape[1:]), getattr(like, name).dtype))


def place(part: Decision, whole: Decision, first: int) -> None:
    """Write the Decisions of a part to those of the whole, from time `first` on."""
    for f in fields(Decision):
        if (values := getattr(part, f.name)) is not None:
            getattr(whole, f.name)[first : first + len(values)] = values


def chosen(decisions: Decision, times: Any) -> Decision:
    """The Decisions at some of the times, which are the first axis: an index, or (K,) bool."""
    return _each(decisions, lambda name: getattr(decisions, name)[times])


def of_run(decisions: Decision, b: int) -> Decision:
    """The Decisions (time, batch, ...) of run b of a batch; what a method states once for all runs (time,) holds for each."""

    def own(name: str) -> Array:
        values: Array = getattr(decisions, name)
        return values[:, b] if values.ndim > 1 else values

    return _each(decisions, own)


def _each(like: Decision, of: Callable[[str], Array]) -> Decision:
    """A Decision of what `of` gives for the name of each array that `like` has; what is the same at all times stays."""
    found = {f.name: getattr(like, f.name) for f in fields(Decision)}
    return Decision(**{name: of(name) if value is not None and value.ndim else value for name, value in found.items()})


def stack(decisions: list[Decision], *, covariance: bool = False) -> Decision:
    """Return one Decision whose arrays have time as their first axis."""
    stacked = {
        f.name: np.stack([getattr(d, f.name) for d in decisions])
        for f in fields(Decision)
        if getattr(decisions[0], f.name) is not None and (f.name != "covariance" or covariance)
    }
    return Decision(**stacked)
