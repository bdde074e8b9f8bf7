"""The least time of calls that are compared with each other."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping
from time import perf_counter
from typing import NamedTuple, TypeVar

TURN = 0.02  # s of consecutive calls in one turn, so that caches are as in a loop
FEWEST = 3  # turns of each, however slow

Key = TypeVar("Key", bound=Hashable)


class Timing(NamedTuple):
    """Least seconds of a single call, of so many timed."""

    best: float
    calls: int


def best_times(
    calls: Mapping[Key, Callable[[], object]], seconds: float = 2.0, clock: Callable[[], float] = perf_counter
) -> dict[Key, Timing]:
    """Return the least time of each call; each is called for about `seconds` (at least three times).

    They take turns, so that a busy machine slows all of them; the first call of each (compiling, first pages) is not counted.
    The least is the time without disturbance: other processes can only add to it. clock: seconds, such as processor time by
    time.thread_time, for calls that are always interrupted on a busy machine.
    """
    if not 0 < seconds < math.inf:
        raise ValueError(f"seconds is {seconds}; expected a positive time")
    for call in calls.values():
        call()
    taken: dict[Key, list[float]] = {name: [] for name in calls}
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
