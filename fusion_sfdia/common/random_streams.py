"""Independent random numbers for each purpose of each seed, unaffected by other draws."""

from __future__ import annotations

from collections.abc import Sequence
from zlib import crc32

import numpy as np


def stream(seed: int, *purpose: str | int) -> np.random.Generator:
    """Return the generator of a seed (an integer of at least 0) for a purpose such as ("fault readings", 2).

    It depends only on the seed and the purpose. Another source of randomness, or other seeds in the same run, do not
    change its draws (numpy's SeedSequence keeps the streams independent).
    """
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ValueError(f"a seed is {seed!r}; expected an integer of at least 0")
    key = tuple(crc32(part.encode()) if isinstance(part, str) else int(part) for part in purpose)
    return np.random.default_rng(np.random.SeedSequence(int(seed), spawn_key=key))


def require_seeds(seeds: Sequence[int]) -> tuple[int, ...]:
    """Return seeds as a tuple; ValueError for none, for one that occurs twice and for anything but integers of at least 0."""
    try:
        seeds = tuple(seeds)
    except TypeError as error:
        raise ValueError(f"seeds are {seeds!r}; expected several integers of at least 0, such as [0] or range(10)") from error
    for seed in seeds:
        stream(seed)
    if not seeds or len(set(seeds)) < len(seeds):
        raise ValueError(f"seeds are {seeds}; expected at least one, each different: the same seed gives the same run twice")
    return tuple(int(s) for s in seeds)
