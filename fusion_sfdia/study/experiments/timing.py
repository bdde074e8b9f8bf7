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
    """Return the least time of each call, see `turns_of`.

    The least is the time without disturbance: other processes can only add to it.
    """
    turns = turns_of(calls, seconds, clock)
    return {name: Timing(min(map(min, times)), sum(map(len, times))) for name, times in turns.items()}


def turns_of(
    calls: Mapping[Key, Callable[[], object]], seconds: float = 2.0, clock: Callable[[], float] = perf_counter
) -> dict[Key, list[list[float]]]:
    """Return the times of each call by turn; each is called for about `seconds`, in at least three turns.

    They take turns, so that a busy machine slows all of them; the first call of each (compiling, first pages) is not counted.
    clock: seconds, such as processor time by time.thread_time, for calls that are always interrupted on a busy machine.
    """
    if not 0 < seconds < math.inf:
        raise ValueError(f"seconds is {seconds}; expected a positive time")
    for call in calls.values():
        call()
    taken: dict[Key, list[list[float]]] = {name: [] for name in calls}
    total = dict.fromkeys(calls, 0.0)
    turns = 0
    while waiting := [name for name in calls if turns < FEWEST or total[name] < seconds]:
        for name in waiting:
            times: list[float] = []
            stop = clock() + min(TURN, seconds)
            while True:
                start = clock()
                calls[name]()
                times.append((end := clock()) - start)
                if end >= stop:
                    break
            taken[name].append(times)
            total[name] += sum(times)
        turns += 1
    return taken
