"""The least time of calls that are compared with each other, and how long they have been watched."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from time import perf_counter
from typing import NamedTuple

TURN = 0.02  # s of consecutive calls in one turn, so that caches are as in a loop
FEWEST = 3  # turns of each, however slow


class Timing(NamedTuple):
    """Least seconds of a single call, of so many timed."""

    best: float
    calls: int


def best_times(
    calls: Mapping[str, Callable[[], object]], seconds: float = 2.0, clock: Callable[[], float] = perf_counter
) -> dict[str, Timing]:
    """Return the least time of each call; each is called for about `seconds` (at least three times).

    They take turns, so that a busy machine hits all that are compared; the first call of each (compiling, first pages) is
    not counted. The least is the time without disturbance: everything else that runs only ever adds. clock: seconds, such as
    time.thread_time of the processor, for calls that are too long to be left alone once.
    """
    if not 0 < seconds < math.inf:
        raise ValueError(f"seconds is {seconds}; a positive time is expected")
    for call in calls.values():
        call()
    taken: dict[str, list[float]] = {name: [] for name in calls}
    turns = 0
    while waiting := [name for name, times in taken.items() if turns < FEWEST or sum(times) < seconds]:
        for name in waiting:
            times, stop = taken[name], clock() + min(TURN, seconds)
            while True:
                start = clock()
                calls[name]()
                times.append((end := clock()) - start)
                if end >= stop:
                    break
        turns += 1
    return {name: Timing(min(times), len(times)) for name, times in taken.items()}
