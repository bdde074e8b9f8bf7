"""Simulated faults of every kind are named as what they are."""

from __future__ import annotations

import pytest
from scipy.stats import binom

from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.diagnosis.fault_kinds import KINDS
from fusion_sfdia.diagnosis.faults import Fault
from fusion_sfdia.models.two_tanks.plant import two_tanks
from fusion_sfdia.study.kind_trials import OTHERS, KindTrial, confusion, kind_trials

RIGHT = 0.95  # of the faults, at least, on the page of results


def test_the_table_counts_what_was_named() -> None:
    bias = Fault("a", "bias", 1.0, magnitude=1.0)
    table = confusion(
        [KindTrial(bias, "bias", True, 0), KindTrial(bias, "drift", None, 0), KindTrial(bias, "not found", None, 0)]
    )
    assert table[0] == [1, 1, 0, 0, 0, 0, 0, 1] and sum(map(sum, table)) == 3
    assert len(table[0]) == len(KINDS) + len(OTHERS)


@pytest.mark.slow
def test_the_main_diagonal_holds_the_faults() -> None:
    """With a rate of at least RIGHT the count falls below the bound once in 10 000 runs of the test."""
    table = confusion(kind_trials(LeaveOneOutBank(two_tanks()), range(200, 205)))
    count = sum(map(sum, table))
    assert count == 5 * len(KINDS)
    assert sum(table[k][k] for k in range(len(KINDS))) >= binom.ppf(1e-4, count, RIGHT)
