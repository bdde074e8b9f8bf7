"""network/attacks: the correct answer, and answers as text."""

from __future__ import annotations

import numpy as np

from fusion_sfdia.benchmarks.network import attacks
from fusion_sfdia.models.power_network.published import ATTACKS


def test_the_correct_answer_to_a_fault_in_no_set_is_none_of_these() -> None:
    assert [attacks._right(f) for f in ("-u", "slow governor")] == ["-u", "none of these"]
    assert attacks._answers(np.array([0, 0, 3, 0]), ATTACKS) == "-u 75%, none of these 25%"
