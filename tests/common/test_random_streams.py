"""A stream of random numbers depends on its seed and its purpose, and on nothing else."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fusion_sfdia.common.random_streams import require_seeds, stream


def test_a_seed_and_a_purpose_make_a_stream() -> None:
    draws = {key: stream(*key).random() for key in [(1, "a"), (1, "b"), (2, "a"), (1, "a", 2), (1, "a", 3)]}
    assert len(set(draws.values())) == len(draws)
    assert stream(1, "a", 2).random() == draws[1, "a", 2]
    assert stream(np.int64(1), "a").random() == draws[1, "a"]


@pytest.mark.parametrize("seed", [-1, 1.0, True, "1", None])
def test_a_seed_is_a_whole_number_from_0(seed: Any) -> None:
    with pytest.raises(ValueError, match="expected an integer of at least 0"):
        stream(seed)


@pytest.mark.parametrize("seeds", [[], [1, 1], [0, -1], 3])
def test_seeds_are_several_and_different(seeds: Any) -> None:
    with pytest.raises(ValueError, match=r"seeds? (is|are)"):
        require_seeds(seeds)
    assert require_seeds(range(2)) == (0, 1)
