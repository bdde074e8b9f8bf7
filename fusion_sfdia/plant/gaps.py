"""Gaps of a log: steps of the plant's dt without readings, or, where that takes too many, a fresh start."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.equation import step_of_change
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

MOST_BRIDGES = 10_000  # steps in a gap: a day's outage in steps of 10 s; and in all gaps, in addition to ten for each reading
LONG = 60  # steps: what is learnt from a log is learnt from each side of a longer gap by itself
SKIPPED = 1.5  # steps: rows are missing in a longer gap
REPORTED = 2.0  # times the median distance of readings: a shorter gap is uneven sampling


class Gap(NamedTuple):
    """No reading between start and end (s).

    Attributes
    ----------
    start : float
        Time of the last reading before it, in s.
    end : float
        Time of the next reading, in s.
    steps : int
        How many the plant takes from one to the other.
    reset : bool
        The gap takes more than `MOST_BRIDGES` steps, and the detector starts anew at its end.

    Examples
    --------
    >>> import numpy as np
    >>> from fusion_sfdia import Log, diagnose, simulate
    >>> from fusion_sfdia.plants import two_tanks
    >>> recording = simulate(two_tanks(), 40, seeds=[1])
    >>> rows = np.r_[:20, 30:40]
    >>> diagnose("kf-chi2", Log(recording.t[rows], recording.y[rows, 0], recording.u[rows]), plant=two_tanks()).gaps[0]
    Gap(start=100.0, end=155.0, steps=11, reset=False)
    """

    start: float
    end: float
    steps: int
    reset: bool


class Track(NamedTuple):
    """A log with the steps through its gaps: times t (S,), readings y (S, N), NaN in gaps, inputs u (S, m); without gaps they
    are the log's own arrays.

    own (S,): whether a step has a sample of the log. begins (S,): the time at which a fresh start begins, NaN where a step
    follows the one before.
    """

    t: Array
    y: Array
    u: Array
    own: Array
    begins: Array


def stated_step(plant: Plant) -> float:
    """The longest step (s) that a plant admits: its dt where it holds for no other, its max_dt, inf where it states none."""
    return plant.dt if plant.numerics.fixed_dt else plant.numerics.max_dt


def parted(log: Log, breaks: Array) -> list[Log]:
    """The stretches of a log of K samples, t (K,), where breaks (K - 1,) states between which ones a new stretch begins."""
    ends = np.flatnonzero(breaks) + 1
    return [Log(*parts) for parts in zip(*(np.split(a, ends) for a in log), strict=True)]


def longest_step(plant: Plant) -> float:
    """The longest step (s) to take at once: the plant's max_dt, or, where it states none, max(dt, 0.1 / |D^-1 A D|).

    A = (F - I) / dt, with F = d step / d x at x0, and D the scales of the states. Within such a step a deviation changes by at
    most a tenth, so that process noise in proportion to the time is right to a tenth (see `discretise.largest_step`), and an
    explicit Euler step, stable up to 2 / |A|, is far from its limit. It is inf where F = I, and dt where the model fails at x0.
    """
    if np.isfinite(stated := stated_step(plant)):
        return stated
    with np.errstate(all="ignore"):
        try:
            f = plant.step_jacobian_at(0.0, plant.x0, plant.input_at(0.0), plant.dt)
        except ArithmeticError:
            return plant.dt
        return step_of_change((f - np.eye(plant.x0.size)) / plant.dt, plant.state_scale, plant.dt)


def lead_in(plant: Plant, ahead: float = np.inf) -> float:
    """How long (s) before the first reading a detector starts; ahead: from that to the second one."""
    return plant.dt if plant.numerics.fixed_dt else min(plant.dt, ahead)


def steps_in(gap: Any, dt: float) -> Any:
    """The number of equal steps, of dt or just below, in gaps (s)."""
    return np.ceil(gap / dt * (1 - 1e-9))


def between(before: Array, now: Array, share: Any) -> Array:
    """The input in a gap, that share of it before its end, interpolated between those before and at its end."""
    return np.asarray(now * (1 - share) + before * share)


def steps_over(
    plant: Plant, longest: float, before: tuple[float, Array], now: tuple[float, Array]
) -> list[tuple[float, Array]]:
    """Times and inputs of the steps strictly between two rows, given by times and inputs (m,), as `bridged` has them; none up
    to `longest` s.
    """
    (t_before, u_before), (t, u) = before, now
    gap = t - t_before
    if gap <= longest * (1 + 1e-9):
        return []
    parts = int(steps_in(gap, plant.dt))
    return [(t - ahead * (gap / parts), between(u_before, u, ahead / parts)) for ahead in range(parts - 1, 0, -1)]


def bridged(plant: Plant, log: Log) -> tuple[Track, tuple[Gap, ...]]:
    """Return the steps through a log of one run, and the gaps that are worth a report.

    Where two times are further apart than `longest_step`, steps of dt (or just below) without readings lead from one to the
    other, under inputs interpolated between those before and after; so the covariance grows as in a log with empty rows. A
    gap of more than MOST_BRIDGES steps is not bridged. ValueError for a time for which the model does not hold, and where all
    gaps take more than MOST_BRIDGES steps and ten for each reading.
    """
    t, y, u = log
    first = float(t[0]) - lead_in(plant, float(t[1] - t[0]) if len(t) > 1 else np.inf)
    gaps = np.diff(t, prepend=first)
    with np.errstate(invalid="ignore"):
        long = (gaps > longest_step(plant) * (1 + 1e-9)) & np.isfinite(gaps)
        parts = np.where(long, steps_in(gaps, plant.dt), 1)
    fresh = parts > MOST_BRIDGES
    usual = float(np.median(gaps[1:])) if t.size > 1 else plant.dt
    reported = tuple(
        Gap(float(t[k - 1]), float(t[k]), int(min(parts[k], 2**62)), bool(fresh[k]))
        for k in np.flatnonzero(long & (gaps > REPORTED * (usual if np.isfinite(usual) else plant.dt)))
    )
    fresh[0] = True
    gaps, parts = np.where(fresh, t[0] - first, gaps), np.where(fresh, 1, parts)
    if np.sum(parts) > MOST_BRIDGES + 10 * t.size:
        raise ValueError(
            f"{t.size} readings take {np.sum(parts):.5g} steps of {plant.dt:g} s, as they are up to {np.max(gaps):g} s apart; "
            "give times in seconds, or split the log at long gaps"
        )
    for k, step in enumerate(gaps / parts):
        try:
            plant.check_dt(float(step))
        except ValueError as error:
            raise ValueError(f"reading {k + 1}, {t[k]:.10g} s, is {gaps[k]:.10g} s after the one before: {error}") from error
    if np.all(parts == 1):
        return Track(t, y, u, np.ones(t.size, bool), np.where(fresh, t - gaps, np.nan)), reported
    filled, own = with_rows(log, gaps, parts.astype(int))
    begins = np.full(own.size, np.nan)
    begins[np.flatnonzero(own)[fresh]] = (t - gaps)[fresh]
    return Track(*filled, own, begins), reported


def stretches(log: Log, step: float) -> list[Log]:
    """The stretches of a log of one run between gaps of more than `LONG` steps (s), with rows without readings in shorter ones,
    about a step apart.
    """
    gaps = np.diff(log.t, prepend=log.t[0] - step)
    parts = np.where(gaps > SKIPPED * step, np.rint(gaps / step), 1).astype(int)
    breaks = parts[1:] > LONG
    parts[1:][breaks] = 1
    ends = np.flatnonzero(breaks) + 1
    each = zip(parted(log, breaks), np.split(gaps, ends), np.split(parts, ends), strict=True)
    return [part if np.all(steps == 1) else with_rows(part, before, steps)[0] for part, before, steps in each]


def with_rows(log: Log, gaps: Array, parts: Array) -> tuple[Log, Array]:
    """A log of one run with rows in its gaps (K,), each before its row: as many equal steps as `parts` (K,) states, without
    readings, under inputs interpolated between those before and after. Also which of the rows (S,) are the log's own.
    """
    t, y, u = log
    last, which = np.cumsum(parts) - 1, np.repeat(np.arange(t.size), parts)
    ahead = last[which] - np.arange(which.size)  # steps of the gap that are still to come
    times = t[which] - ahead * (gaps / parts)[which]
    share = (ahead / parts[which])[:, None]  # 0 at a reading
    inputs = between(np.concatenate([u[:1], u[:-1]])[which], u[which], share)
    return Log(times, np.where(share == 0, y[which], np.nan), inputs), ahead == 0
