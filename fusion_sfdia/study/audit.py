"""Audit of a detector on a plant: which of the errors and causes of `error_protocol` it survives, as numbers and in words."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from fusion_sfdia.common.run_statistics import Estimate, proportion, rate_over_runs
from fusion_sfdia.detectors.detector import Decision, Detector, of_run
from fusion_sfdia.diagnosis.diagnose import SECONDS, DiagnosisWarning, decided
from fusion_sfdia.diagnosis.events import Event
from fusion_sfdia.diagnosis.prepared import Prepared, prepared
from fusion_sfdia.logs.loaded_log import LoadedLog
from fusion_sfdia.plant.gaps import bridged
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.report.results import Row, row_of
from fusion_sfdia.study.error_protocol import GROUPS, STEPS, Case, ErrorTrial, cases_for, trial
from fusion_sfdia.study.experiments.workers import in_processes

Array = NDArray[Any]

GRACE = 20  # rows after a repair, in which a sensor may still be isolated and the process still be named
LEVELS = ((0.0, 0.5), (0.5, 0.9), (0.9, 1.0))  # of confidence
FEWEST = 90  # rows of a trial
SURVIVED = 0.02  # largest share of rows in which a healthy sensor is isolated


KINDS = ("false", "right", "undecided", "wrong", "missed")
METRICS = {"false": "false_isolation_probability", **{k: f"{k}_verdict_probability" for k in KINDS[1:]}}  # in results files
DELAY, RIGHT_EVENT = "median_delay_rows", "right_event_probability"


class TrialOutcome(NamedTuple):
    """A trial: how many rows it has, how many are judged, and how many are of each of `KINDS`, of all or of those judged.

    Judged are the rows with a cause, without one all. False, of all rows: a healthy sensor is isolated. Right: exactly the
    faulty sensors are isolated, and the process is named if and only if it differs. Wrong: a healthy sensor is isolated, or the
    process named that is as modelled. Undecided: neither, with suspects or without an estimate. Missed: neither, and nothing
    is reported. delay: judged rows before the first right one, inf for none. at_end: whether a healthy sensor is isolated in
    the last row. events: of each event of a sensor its confidence, and whether that sensor was faulty then.
    """

    rows: int
    judged: int
    counts: tuple[int, ...]
    delay: float
    at_end: bool
    events: tuple[tuple[float, bool], ...]


class CaseResult(NamedTuple):
    """What a detector makes of a case over `runs` trials: shares of `KINDS` with 95 % intervals, and the median delay (rows).

    at_end: trials in the last row of which a healthy sensor is isolated. absent: trials that are left out, left_out: why, ""
    where none is.
    """

    case: Case
    runs: int
    shares: dict[str, Estimate]
    delay: float
    at_end: int
    absent: int
    left_out: str

    @property
    def survived(self) -> bool:
        """Whether healthy sensors are isolated in at most `SURVIVED` of the rows."""
        return not self.shares["false"].value > SURVIVED


def outcomes(
    detector: Detector, case: Case, seeds: Sequence[int], steps: int = STEPS, plant: Plant | None = None
) -> tuple[list[TrialOutcome], str]:
    """Diagnose the trials of a case as `diagnose` does: those of one detector are stepped through at once, then each is judged.

    The trials have the same times. A trial whose truth leaves the limits of the plant is left out, and the text says why.
    plant: of which the trials are, where it is not the detector's, which may be tuned to it.
    """
    trials, why = [], ""
    for seed in seeds:
        try:
            trials.append(trial(plant or detector.plant, case, seed, steps))
        except ArithmeticError as error:
            why = str(error)
    if not trials:
        return [], why
    logs = [prepared(detector, LoadedLog(made.log, SECONDS, ())) for made in trials]
    with warnings.catch_warnings(), threadpool_limits(1):
        warnings.simplefilter("ignore", DiagnosisWarning)
        decisions = _decisions(logs)
        return [judged_trial(case, *one) for one in zip(trials, logs, decisions, strict=True)], why


def _decisions(logs: Sequence[Prepared]) -> list[Decision]:
    """The decisions on each log; a detector steps through all of its logs, which have the same times, at once."""
    found: dict[int, Decision] = {}
    for detector in {id(one.detector): one.detector for one in logs}.values():
        own = [k for k, one in enumerate(logs) if one.detector is detector]
        tracks = [bridged(detector.plant, logs[k].log)[0] for k in own]
        y, u = (np.stack([getattr(track, what) for track in tracks], axis=1) for what in ("y", "u"))
        together = decided(detector, tracks[0]._replace(y=y, u=u), iter)
        found |= {k: of_run(together, b) for b, k in enumerate(own)}
    return [found[k] for k in range(len(logs))]


def judged_trial(case: Case, made: ErrorTrial, log: Prepared, decisions: Decision) -> TrialOutcome:
    """What the diagnosis of a trial is worth, given the decisions on its log. Without anything isolated, named or suspected it
    is healthy, and the second look at the readings is left out.
    """
    plant, (_, faulty, process) = log.detector.plant, made
    events: tuple[Event, ...] = ()
    if any(held is not None and np.any(held) for held in (decisions.isolated, decisions.process, decisions.suspect)):
        found, _ = log.diagnose(decisions=decisions)
        events, decisions = found.events, found.decisions
    isolated = decisions.isolated[:, : len(plant.sensors)]
    named, suspected = (
        np.zeros(len(faulty), bool) if held is None else held.any(axis=-1) for held in (decisions.process, decisions.suspect)
    )
    suspected = suspected | bool(log.suspects)

    def faulty_between(start: float, end: float) -> set[str]:
        fails = np.any(faulty[(made.log.t >= start) & (made.log.t <= end)], axis=0)
        return {plant.sensor_names[i] for i in np.flatnonzero(fails)}

    cause = faulty.any(axis=-1) | process
    judged = cause if cause.any() else np.ones(len(faulty), bool)
    false: Array = np.any(isolated & ~lasting(faulty), axis=-1)
    wrong = false | (named & ~lasting(process) & (not case.model_is_off))
    right = ~wrong & (isolated == faulty).all(axis=-1) & ((named == process) | case.model_is_off) & (cause | ~suspected)
    undecided = ~right & ~wrong & (suspected | decisions.diverged)
    judged_kinds = (right, undecided, wrong, ~(right | undecided | wrong))
    first = np.flatnonzero(right[judged])
    return TrialOutcome(
        rows=len(faulty),
        judged=int(judged.sum()),
        counts=(int(false.sum()), *(int((which & judged).sum()) for which in judged_kinds)),
        delay=float(first[0]) if first.size else np.inf,
        at_end=bool(false[-1]),
        events=tuple(
            (e.confidence, e.hypothesis in faulty_between(e.start, e.end))
            for e in events
            if e.kind == "sensor" and np.isfinite(e.confidence)
        ),
    )


def lasting(held: Array) -> Array:
    """Where it holds, or held within the last `GRACE` rows (K, ...)."""
    found = held.copy()
    for k in range(1, min(GRACE, len(held) - 1) + 1):
        found[k:] |= held[:-k]
    return found


def result_of(case: Case, seeds: int, found: Sequence[TrialOutcome], left_out: str) -> CaseResult:
    """The shares over the trials of a case, one of each seed but those that are left out."""
    counts = np.array([o.counts for o in found]).reshape(-1, len(KINDS))
    rows, judged = (np.array([getattr(o, what) for o in found], int) for what in ("rows", "judged"))
    shares = {kind: rate_over_runs(counts[:, k], judged if k else rows) for k, kind in enumerate(KINDS)}
    delay = float(np.median([o.delay for o in found])) if found else np.nan
    return CaseResult(case, len(found), shares, delay, sum(o.at_end for o in found), seeds - len(found), left_out)


@dataclass(frozen=True)
class AuditResult:
    """The results of an audit, by case; str(audit) is the table that `fusion-sfdia audit` prints.

    Attributes
    ----------
    plant : str
        Its name.
    detector : str
        Its name.
    steps : int
        Rows of a trial.
    results : tuple of CaseResult
        One of each case.
    reliability : tuple of (float, float, Estimate)
        Of the events of sensors with a confidence in [low, high] their number and the share that was right.

    Examples
    --------
    See `audit`.
    """

    plant: str
    detector: str
    steps: int
    results: tuple[CaseResult, ...]
    reliability: tuple[tuple[float, float, Estimate], ...]

    def rows(self) -> list[Row]:
        """The numbers as rows of a results file: the case as condition, its group as quantity.

        Returns
        -------
        list of Row
            As in metrics.csv.
        """
        found = []
        for r in self.results:
            of = partial(row_of, self.plant, "audit", self.detector, "none", r.case.group, condition=r.case.name)
            found += [of(metric=METRICS[kind], estimate=estimate) for kind, estimate in r.shares.items()]
            found.append(
                of(metric=DELAY, estimate=Estimate(r.delay if np.isfinite(r.delay) else np.nan, np.nan, np.nan, r.runs))
            )
        for low, high, estimate in self.reliability:
            of = partial(row_of, self.plant, "audit", self.detector, "none", "all", condition=f"confidence {low:g} to {high:g}")
            found.append(of(metric=RIGHT_EVENT, estimate=estimate))
        return found

    def __str__(self) -> str:
        width, trials = (max(of) for of in zip(*((len(r.case.about), r.runs) for r in self.results), strict=True))
        lines = [
            f"{self.detector} on {self.plant}: {trials} trials a case, of {self.steps} rows, judged from the first one",
            f"{'':{width}}  healthy sensor  right  cannot  wrong  missed  rows until",
            f"{'':{width}}  isolated               tell                   right",
        ]
        for group in dict.fromkeys(r.case.group for r in self.results):
            lines.append(f"{group}:")
            lines += [f"{r.case.about:{width}}  {_cells(r)}" for r in self.results if r.case.group == group]
        broken = [r.case.about for r in self.results if not r.survived]
        lines.append(
            f"isolates healthy sensors in more than {SURVIVED:.0%} of the rows under: {'; '.join(broken)}"
            if broken
            else f"isolates healthy sensors in at most {SURVIVED:.0%} of the rows in every case"
        )
        lines += [
            f"of {e.n} events with a confidence of {low:g} to {high:g}, {e.value:.0%} are right ({e.low:.0%} to {e.high:.0%})"
            for low, high, e in self.reliability
            if e.n
        ]
        return "\n".join(lines)


def _cells(r: CaseResult) -> str:
    if not r.runs:
        return f"left out: {r.left_out}"
    (p, low, high, _), *others = r.shares.values()
    right, undecided, wrong, missed = (f"{e.value:.2f}" for e in others)
    delay = f"{r.delay:.0f}" if np.isfinite(r.delay) else "-"
    absent = f"  {r.absent} left out: {r.left_out}" if r.absent else ""
    return f"{p:.2f} ({low:.2f}-{high:.2f})  {right}  {undecided:>6}  {wrong:>5}  {missed:>6}  {delay:>7}{absent}"


class _Work(NamedTuple):
    """A case with its trials, and what makes the detector."""

    make: Callable[[], Detector]
    position: int
    case: Case
    seeds: tuple[int, ...]
    steps: int


def _done(work: _Work) -> tuple[int, list[TrialOutcome], str]:
    """The outcomes of a case, and why trials are left out."""
    return work.position, *outcomes(work.make(), work.case, work.seeds, work.steps)


def _itself(detector: Detector) -> Detector:
    return detector


def audit(
    detector: Detector | Callable[[], Detector],
    *,
    seeds: Sequence[int] = range(8),
    steps: int = STEPS,
    groups: Sequence[str] = GROUPS,
    more: Sequence[Case] = (),
    workers: int = 1,
    each: Callable[[Iterator[Any], int], Iterator[Any]] = lambda done, count: done,
    name: str = "",
) -> AuditResult:
    """Run all cases that a plant can have, and judge what the detector says.

    Parameters
    ----------
    detector : Detector or callable
        With its plant, or what makes it, in each process.
    seeds : sequence of int, default range(8)
        Of the trials of each case.
    steps : int, default 300
        Rows of a trial, at least `FEWEST`.
    groups : sequence of str, optional
        Of cases; by default all of them.
    more : sequence of Case, default ()
        Further cases, such as `stated_cases`.
    workers : int, default 1
        Processes.
    each : callable, optional
        Wraps the cases as they are done, with their number, to show progress.
    name : str, default ""
        Of the detector in the result.

    Returns
    -------
    AuditResult
        str(...) of it is a table.

    Raises
    ------
    ValueError
        For settings that do not fit.

    Examples
    --------
    >>> from fusion_sfdia import audit
    >>> from fusion_sfdia.detectors import CentralFilter
    >>> from fusion_sfdia.plants import two_tanks
    >>> result = audit(CentralFilter(two_tanks()), seeds=[0], steps=90, groups=["cause"])
    >>> sorted({case.case.group for case in result.results})
    ['cause']
    """
    if steps < FEWEST or not seeds:
        raise ValueError(f"{steps} steps and {len(seeds)} seeds; expected at least {FEWEST} rows a trial and one seed")
    if unknown := [g for g in groups if g not in GROUPS]:
        raise ValueError(f"unknown group {unknown[0]!r}; known: {', '.join(GROUPS)}")
    make = partial(_itself, detector) if isinstance(detector, Detector) else detector
    made = make()
    cases = (*cases_for(made.plant, groups), *more)
    work = [_Work(make, i, case, tuple(seeds), steps) for i, case in enumerate(cases)]
    done = map(_done, work) if workers == 1 else in_processes(_done, work, workers)
    found = sorted(each(iter(done), len(work)), key=lambda one: one[0])
    results = tuple(result_of(cases[i], len(seeds), those, why) for i, those, why in found)
    events = np.array([event for _, those, _ in found for o in those for event in o.events], float).reshape(-1, 2)
    stated, right = events[:, 0], events[:, 1] == 1
    reliability = tuple(
        (low, high, proportion(int(right[inside].sum()), int(inside.sum())))
        for low, high in LEVELS
        for inside in [(stated >= low) & ((stated < high) | (high == 1.0))]
    )
    return AuditResult(made.plant.name, name or type(made).__name__, steps, results, reliability)
