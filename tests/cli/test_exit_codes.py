"""Exit codes of a diagnosis: what --fail-on names, whatever else is undecided; a log that could not be judged comes first."""

from __future__ import annotations

import argparse
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fusion_sfdia.cli.options import exit_code
from fusion_sfdia.detectors.verdicts import Verdict


def code(fail_on: str | None, state: Verdict, *kinds: tuple[str, float], misread: bool = False, diverged: bool = False) -> int:
    """The exit code where events of these kinds and confidences were found."""
    found: Any = SimpleNamespace(
        events=[SimpleNamespace(kind=kind, confidence=confidence) for kind, confidence in kinds],
        state=state,
        health=None,
        decisions=SimpleNamespace(diverged=np.array([False, diverged])),
    )
    read: Any = SimpleNamespace(misread=misread)
    return exit_code(argparse.Namespace(fail_on=fail_on), found, read)


@pytest.mark.parametrize("state", [Verdict.SENSOR, Verdict.UNDECIDED])  # undecided: more than can be isolated disagree, too
def test_a_sensor_that_is_named_counts_whatever_else_is_undecided(state: Verdict) -> None:
    assert [code(what, state, ("sensor", 0.9)) for what in (None, "fault", "process", "suspect")] == [0, 3, 3, 3]
    assert code("fault", state, ("sensor", np.nan)) == 3  # of a detector that states no confidence


def test_the_process_is_no_fault_of_a_sensor_and_what_is_unlikely_is_neither() -> None:
    assert [code(what, Verdict.PROCESS, ("process", 0.8)) for what in ("fault", "process", "suspect")] == [0, 3, 3]
    assert [code(what, Verdict.UNDECIDED, ("sensor", 0.3)) for what in ("fault", "process", "suspect")] == [0, 0, 3]
    assert [code(what, Verdict.HEALTHY) for what in ("fault", "process", "suspect")] == [0, 0, 0]


@pytest.mark.parametrize("fail_on", [None, "fault", "process", "suspect"])
def test_a_log_that_could_not_be_judged_comes_first(fail_on: str | None) -> None:
    assert code(fail_on, Verdict.BLIND) == 1
    assert code(fail_on, Verdict.SENSOR, ("sensor", 0.9), misread=True) == 1
    assert code(fail_on, Verdict.SENSOR, ("sensor", 0.9), diverged=True) == 1
