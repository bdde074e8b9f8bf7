"""The list of mutants fits the code, and the quick ones of them are killed; `make mutants` tries all."""

from __future__ import annotations

import ast
import re

import pytest
from mutants import MUTANTS, Mutant, mutated
from run_mutants import ROOT, survivors

SHORT = 3  # mutants that take about half a minute together


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda m: f"{m.file}:{m.old}")
def test_a_mutant_changes_code_that_is_there_and_its_test_exists(mutant: Mutant) -> None:
    before = (ROOT / mutant.file).read_text()
    after = mutated(before, mutant)
    assert ast.dump(ast.parse(after)) != ast.dump(ast.parse(before))
    path, _, name = mutant.test.partition("::")
    assert re.search(rf"^def {name}\(", (ROOT / path).read_text(), re.MULTILINE), f"{path} has no {name}"


def test_mutants_are_many_differ_and_cover_the_schools() -> None:
    assert len({m[:3] for m in MUTANTS}) == len(MUTANTS) >= 60
    files = {m.file.removeprefix("fusion_sfdia/") for m in MUTANTS}
    for folder in (
        "detectors/kalman_banks",
        "detectors/adaptive_thresholds",
        "detectors/stochastic_thresholds",
        "learning/tuning",
        "learning/commissioning",
        "study",
        "diagnosis",
    ):
        assert any(name.startswith(f"{folder}/") for name in files), folder


@pytest.mark.parametrize(("old", "count"), [("PRIOR", 2), ("nothing such", 0)])
def test_text_that_does_not_stand_once_in_the_code_is_refused(old: str, count: int) -> None:
    with pytest.raises(ValueError, match=f"{old!r} stands {count} times in a.py, expected once"):
        mutated("PRIOR = 1\nLOG = PRIOR", Mutant("a.py", old, "x", "test_a.py::test_a"))


@pytest.mark.slow
def test_quick_mutants_are_killed() -> None:
    quick = [m for m in MUTANTS if m.quick]
    assert 0 < len(quick) <= SHORT
    assert not survivors(quick, workers=2)
