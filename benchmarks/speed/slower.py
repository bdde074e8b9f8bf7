"""What has become slower by more than its noise: the ratios of a run against those of earlier runs on the same machine.

x = ln(ratio of a time to its reference). A row is slower where x exceeds the median of its last BASELINE runs by more than

    t(FALSE_ALARM / rows, dof) s sqrt(1 + 1.6 / runs)      (1.6 / n: variance of the median of n)
    s^2 = (PRIOR_DOF s_0^2 + runs v) / (PRIOR_DOF + runs)   (Smyth 2004, sec. 4; at least the spread within the run)

with v from the median of the differences between successive runs, which one lasting change leaves as it is, and s_0^2 the
median of v over all rows; PRIOR_NOISE^2 before there are three runs. All rows of a run together give a false alarm with a
probability of FALSE_ALARM where the noise of the logarithms is normal and that of all rows the same, and otherwise more often.
So the command measures a part again before it reports a row of it, which has to be slower both times.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import exp, expm1, log, sqrt
from statistics import median
from typing import NamedTuple

from scipy import special

Key = tuple[str, ...]

FALSE_ALARM = 0.01  # of a comparison of all rows
RUNS, BASELINE = 20, 5  # the last ones, from which noise is learnt, and of which the median is compared
PRIOR_NOISE = 0.05  # of a ratio, from run to run, before there is a history of three runs
PRIOR_DOF = 10
NORMAL = 0.954  # median |difference| of two standard normal variables


class Ratio(NamedTuple):
    """A ratio to a reference, and the spread of its logarithm within the run."""

    value: float
    spread: float


class Slowdown(NamedTuple):
    """A row that was compared: its ratio before and now, its noise, and the increase that would be reported, as shares."""

    key: Key
    before: float
    now: float
    noise: float
    limit: float
    runs: int

    @property
    def slower(self) -> bool:
        return self.now / self.before - 1 > self.limit


def compared(history: Sequence[Mapping[Key, Ratio]], now: Mapping[Key, Ratio]) -> list[Slowdown]:
    """All rows that the history (oldest first) has, too."""
    before = {key: [log(run[key].value) for run in history if key in run][-RUNS:] for key in now}
    before = {key: x for key, x in before.items() if x}
    variance = {key: (median(abs(b - a) for a, b in pairwise(x)) / NORMAL) ** 2 for key, x in before.items() if len(x) > 2}
    usual = median(variance.values()) if variance else PRIOR_NOISE**2
    changes = []
    for key, x in before.items():
        runs = len(x) if key in variance else 0
        dof, last = PRIOR_DOF + runs, x[-BASELINE:]
        s = max(sqrt((PRIOR_DOF * usual + runs * variance.get(key, 0.0)) / dof), now[key].spread)
        limit = -special.stdtrit(dof, FALSE_ALARM / len(before)) * s * sqrt(1 + 1.6 / len(last))
        changes.append(Slowdown(key, exp(median(last)), now[key].value, s, float(expm1(limit)), len(x)))
    return changes


def confirmed(changes: Sequence[Slowdown], again: Sequence[Slowdown]) -> list[Slowdown]:
    """The changes, those that are slower in both runs with the lower of their ratios, others as they were before."""
    second = {c.key: c for c in again}
    return [
        c if not c.slower else c._replace(now=min(c.now, second[c.key].now if c.key in second else c.before)) for c in changes
    ]


def as_text(changes: Sequence[Slowdown]) -> list[str]:
    """A line for each row that is slower, and one for all."""
    slower = [c for c in changes if c.slower]
    lines = [
        f"slower: {' '.join(filter(None, c.key))}: {c.before:.4g} -> {c.now:.4g} ({c.now / c.before - 1:+.0%}; noise "
        f"{c.noise:.0%}, limit {c.limit:+.0%})"
        for c in slower
    ]
    runs, limit = max(c.runs for c in changes), median(c.limit for c in changes)
    return [*lines, f"{len(slower)} of {len(changes)} ratios slower, against {runs} runs; half of them show {limit:+.0%}"]
