"""Closed-loop runs of the power network with a faulty area: detection, isolation, unplugging, reconfiguration."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.registry import require_known
from fusion_sfdia.detectors.stochastic_thresholds.consensus import Diagnosers, initial_state, predict, take
from fusion_sfdia.detectors.stochastic_thresholds.fault_hypotheses import FaultHypotheses
from fusion_sfdia.models.power_network.accommodation import Compensated
from fusion_sfdia.models.power_network.control import Control, PredictiveControl, generation_control
from fusion_sfdia.models.power_network.diagnosis import network_areas
from fusion_sfdia.models.power_network.faults import fault_function
from fusion_sfdia.models.power_network.model import NetworkModel
from fusion_sfdia.models.power_network.operation import AreaFault, Switch, load_profile
from fusion_sfdia.models.power_network.parameters import load_steps
from fusion_sfdia.models.power_network.simulation import NetworkSample, run_network
from fusion_sfdia.plant.areas import Areas
from fusion_sfdia.study.experiments.scenario import Settings

Array = NDArray[Any]
Arrays = dict[str, Array]

CONTROLLERS: dict[str, Callable[[], Control]] = {"generation": lambda: generation_control, "predictive": PredictiveControl}
ALPHA, LAM = 2.0, 0.3  # B18, sec. VIII
CONFIRMATIONS = 3  # B18, sec. VIII-A: "after 3 consecutively alarms"
ALARM_RULES = ("single alarms", f"{CONFIRMATIONS} consecutive")  # the last axis of `RunAlarms`
PATIENCE = 30  # steps until the isolation ends; our choice
BOUND = 0.0427  # of noise and disturbances (B18, sec. VIII-A), the largest of 10 series of samples there
LATE = 70.0  # s; the angles from then on show whether the area is under control
SHOWN = ("t", "reference", "reached", "load", "angles", "speeds", "residual", "deviation")


@dataclass(frozen=True)
class WatchedRuns:
    """The diagnosis of the runs: the area whose alarms count from `onset` (s) on, and the mode of the diagnosers.

    hypotheses: faults of the area by name, None for no fault; none at all for no isolation. alpha, exclusions: thresholds and
    confirmations of the isolation. reconfigure: compensate for an isolated gain of the input.
    """

    area: str
    onset: float
    mode: str
    hypotheses: tuple[tuple[str, AreaFault | None], ...] = ()
    alpha: float = ALPHA
    exclusions: int = CONFIRMATIONS
    reconfigure: bool = False


def trial(
    model: NetworkModel,
    watch: WatchedRuns,
    steps: int,
    seeds: Sequence[int],
    *,
    loads: str,
    faults: Sequence[AreaFault],
    switches: Sequence[Switch] = (),
    controller: str = "generation",
    each: Callable[[NetworkSample], None] | None = None,
) -> Arrays:
    """Runs of B seeds over K = steps + 1 samples; loads: "1" or "2" of B18. Isolation where no area is switched.

    Arrays: of `RunAlarms` and `Answers`; angle (B, N), root mean squares of the areas' from LATE on; of the first run SHOWN: t
    (K,), reference, reached (what of it does reach the areas), load, angles, speeds (K, N), residual, deviation (K, n) of the
    area's own readings.
    """
    areas, runs = network_areas(model), len(seeds)
    area = model.network.topology.index(watch.area)
    control = Compensated(CONTROLLERS[controller](), np.ones((runs, len(model.names))))
    alarms, answers = RunAlarms(areas, area, watch.onset, runs), Answers(areas, model, watch, runs)
    now, condition = initial_state(areas, (runs,)), None
    acted, true_gain = control.gain.copy(), np.ones(len(model.names))
    late: list[Array] = []
    shown: dict[str, list[Any]] = {name: [] for name in SHOWN}
    profile = load_profile(model, load_steps(loads))
    for moment in run_network(model, steps, seeds, loads=profile, control=control, faults=faults, switches=switches):
        load = np.broadcast_to(moment.load, moment.reference.shape)
        answers.step(now, moment, load)
        ahead = predict(areas, now, acted * moment.reference, load, LAM, watch.mode)
        now = take(areas, ahead, moment.own, moment.shared)
        if moment.condition is not condition:  # of the steps from here on
            condition, areas = moment.condition, network_areas(moment.condition.known)
        answers.take(alarms.take(moment.t, now), moment.t, now)
        if watch.reconfigure:
            control.gain[:, area] = answers.gain
        acted = control.gain.copy()
        if each is not None:
            each(moment)
        if moment.t >= LATE:
            late.append(moment.x[..., 0])
        x, sent = moment.x[0], moment.reference[0]
        record = (
            moment.t, sent, true_gain * sent, moment.load, x[:, 0], x[:, 1], now.residual[0, area], now.deviation[0, area],
        )  # fmt: skip
        true_gain = moment.condition.gain
        for name, value in zip(SHOWN, record, strict=True):
            shown[name].append(np.array(value))
    angle = np.sqrt(np.mean(np.square(late), axis=0)) if late else np.full(acted.shape, np.nan)
    return {
        **alarms.arrays(),
        **answers.arrays(),
        "angle": angle,
        **{name: np.stack(values) for name, values in shown.items()},
    }


@dataclass
class RunAlarms:
    """When an area alarms, from the onset on, and how many areas alarmed before it; B runs.

    detected (B, 2): time (s) of its first alarm and of its first CONFIRMATIONS consecutive ones, inf for never.
    false_alarms (B, 2): number of areas with such alarms before the onset. other_alarms (B, 2): number of other areas with such
    alarms after it. deterministic (B,): time at which a residual of the area first exceeds `bounds` (n,).
    """

    areas: Areas
    area: int
    onset: float
    runs: int
    _in_a_row: Array = field(init=False)

    def __post_init__(self) -> None:
        count = self.areas.size[0]
        self._in_a_row = np.zeros((self.runs, count), int)
        self.false, self.later = np.zeros((2, self.runs, count, 2), bool)
        self.detected, self.deterministic = np.full((self.runs, 2), np.inf), np.full(self.runs, np.inf)
        self.bounds = deterministic_thresholds(self.areas)[self.area]

    def take(self, t: float, now: Diagnosers) -> Array:
        """Which runs (B,) have their first confirmed alarm now."""
        shared_alarm = np.abs(now.residual_shared) > ALPHA * now.deviation_shared
        start = self.areas.network.topology.start[:-1]
        alarm = np.any(np.abs(now.residual) > ALPHA * now.deviation, axis=-1)
        alarm |= np.logical_or.reduceat(shared_alarm, start, axis=-1)
        self._in_a_row = np.where(alarm, self._in_a_row + 1, 0)
        both = self._in_a_row[..., None] >= np.array([1, CONFIRMATIONS])
        if t <= self.onset:
            self.false |= both
            return np.zeros(self.runs, bool)
        self.later |= both
        fresh = both[:, self.area] & np.isinf(self.detected)
        self.detected[fresh] = t
        beyond = np.any(np.abs(now.residual[:, self.area]) > self.bounds, axis=-1)
        self.deterministic = np.minimum(self.deterministic, np.where(beyond, t, np.inf))
        started: Array = fresh[:, 1]
        return started

    def arrays(self) -> Arrays:
        return {
            "detected": self.detected,
            "false_alarms": self.false.sum(axis=1),
            "other_alarms": np.delete(self.later, self.area, axis=1).sum(axis=1),
            "deterministic": self.deterministic,
            "bounds": self.bounds,
        }


class Answers:
    """The answers of the isolation, which starts at the first confirmed alarm; places in FaultHypotheses.answers.

    answered (B,): time (s) of the first answer, inf for none, and first_answer which it was; answer: at the end. excluded
    (B, L): time at which each hypothesis was excluded. gain (B,): of the input as isolated last, 1 before.
    """

    def __init__(self, areas: Areas, model: NetworkModel, watch: WatchedRuns, runs: int) -> None:
        self.observer = observer(areas, model, watch)
        self.faults = [fault for _, fault in watch.hypotheses]
        self.state = None if self.observer is None else self.observer.idle(runs)
        self.answered, self.first_answer = np.full(runs, np.inf), np.full(runs, len(self.faults) + 2)
        self.answer, self.gain = self.first_answer.copy(), np.ones(runs)
        self.excluded = np.full((runs, len(self.faults)), np.inf)

    def step(self, before: Diagnosers, moment: NetworkSample, load: Array) -> None:
        if self.observer is not None and self.state is not None:
            self.state = self.observer.step(self.state, before, moment.reference, load, moment.own, moment.shared)

    def take(self, started: Array, t: float, now: Diagnosers) -> None:
        if self.observer is None or self.state is None:
            return
        self.state = self.observer.begin(self.state, started, now)
        self.excluded = np.where(self.state.excluded, np.minimum(self.excluded, t), np.inf)
        self.answer = self.observer.answer(self.state)
        fresh = np.isinf(self.answered) & (self.answer <= len(self.faults))
        self.answered[fresh], self.first_answer[fresh] = t, self.answer[fresh]
        for place, fault in enumerate(self.faults):
            if fault is not None and fault.kind == "input-gain":
                self.gain[self.answer == place] = fault.value

    def arrays(self) -> Arrays:
        names = ("answered", "first_answer", "answer", "excluded")
        return {name: getattr(self, name) for name in names} if self.faults else {}


def observer(areas: Areas, model: NetworkModel, watch: WatchedRuns) -> FaultHypotheses | None:
    """The isolation of the diagnosed area; None without hypotheses."""
    functions = {
        name: (lambda x, u, e: np.zeros(x.shape)) if fault is None else fault_function(model, fault)
        for name, fault in watch.hypotheses
    }
    if not functions:
        return None
    return FaultHypotheses(
        areas, watch.area, functions, lam=LAM, alpha=watch.alpha, rule="gaussian", mode=watch.mode,
        confirmations=watch.exclusions, patience=PATIENCE,
    )  # fmt: skip


def deterministic_thresholds(areas: Areas, bound: float = BOUND) -> Array:
    """(N, n): the limit over time of the largest residuals while all noise and all disturbances are within the bound.

    B18 takes them from its reference [22]: eps+ = lam eps + sum |coefficient| bound + 2 bound for the same residuals, whose
    limit is the sum over 1 - lam.
    """
    inflow = np.add.reduceat(np.abs(areas.slope), areas.network.topology.start[:-1])
    n = areas.matrices.shape[1]
    spread = np.abs(areas.matrices[..., :n]).sum(axis=-1) + np.abs(areas.matrices[..., n + 1]) * inflow[:, None]
    thresholds: Array = bound * (spread + 2.0) / (1.0 - LAM)
    return thresholds


def require_settings(settings: Settings, **known: Iterable[str]) -> None:
    """ValueError for a setting, or an entry of one, that is not among the known names."""
    for name, names in known.items():
        one = isinstance(settings[name], str)
        for value in (settings[name],) if one else settings[name]:
            require_known(name if one else f"one of {name}", value, names)


def join_runs(results: Sequence[tuple[Any, Arrays]], key: Callable[[Any], Any]) -> dict[Any, Arrays]:
    """The joined runs of all tasks with the same key; arrays of a single run (also with a prefix) are of the first task."""
    parts: dict[Any, list[Arrays]] = {}
    for task, arrays in results:
        parts.setdefault(key(task), []).append(arrays)
    single = (*SHOWN, "bounds")
    one = {name for found in parts.values() for name in found[0] if name in single or name.partition("_")[2] in single}
    return {
        k: {name: found[0][name] if name in one else np.concatenate([p[name] for p in found]) for name in found[0]}
        for k, found in parts.items()
    }
