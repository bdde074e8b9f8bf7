"""The acceptance of what healthy logs teach: its page, how it counts, and a quick form of its conditions."""

from __future__ import annotations

import importlib
from itertools import islice
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest


@pytest.fixture
def folder(root: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    found = root / "docs" / "results"
    monkeypatch.syspath_prepend(str(found))
    return found


@pytest.fixture
def acceptance(folder: Path) -> ModuleType:
    return importlib.import_module("acceptance")


@pytest.fixture
def model(folder: Path) -> ModuleType:
    return importlib.import_module("acceptance_model")


@pytest.fixture
def monitor(folder: Path) -> ModuleType:
    return importlib.import_module("acceptance_monitor")


def test_its_page_is_that_of_its_numbers_and_gives_a_reason_for_each_miss(folder: Path, acceptance: ModuleType) -> None:
    rows = acceptance.load()
    assert acceptance.render(rows) == (folder / "acceptance.md").read_text(encoding="utf-8"), "run docs/results/acceptance.py"
    assert {r.condition for r in rows} == set(acceptance.TITLES)
    assert {r.condition for r in rows if not r.met} == set(acceptance.REASONS)
    assert len({(r.condition, r.plant, r.what) for r in rows}) == len(rows)


def test_a_row_is_right_with_exactly_its_sensor_and_wrong_with_any_other(model: ModuleType) -> None:
    """Two runs of four rows and three sensors, one unknown; their faults are of sensors 0 and 2."""
    isolated = np.zeros((4, 2, 3), bool)
    isolated[0, :, 0] = isolated[1, :, [0, 1]] = isolated[3, 0, 0] = isolated[3, 1, 2] = True
    suspect = np.zeros((4, 2, 4), bool)
    suspect[2:, :, [0, 3]] = True
    said = model.Said(isolated, suspect, np.zeros((4, 2, 1), bool))
    right = [0, 2]
    assert said.named(right).tolist() == [[True, False], [False, False], [False, False], [True, True]]
    assert said.wrong(right).tolist() == [[False, True], [True, True], [False, False], [False, False]]
    assert said.suspected(right).tolist() == [[False, False], [False, False], [True, False], [False, False]]


@pytest.mark.parametrize(("limit", "value", "met"), [("<= 0.02", 0.02, True), ("<= 0.02", 0.021, False), (">= 1", 0.9, False)])
def test_a_limit_is_held_or_missed(acceptance: ModuleType, limit: str, value: float, met: bool) -> None:
    assert acceptance.Row("S1", "plant", "what", limit, value, 1).met is met


def test_what_follows_a_fault_without_a_model(monitor: ModuleType) -> None:
    rows = list(monitor.after_faults(monitor.Sizes(Path(), plants=2)))
    assert [r.condition for r in rows] == ["M8", "M12", "M12", "M13", "M13"]
    assert all(0 <= r.value <= 1 for r in rows) and all(r.met for r in rows if "reported" in r.what)
    assert rows[-1].value >= 0.8  # a sensor's fault after one of the process is named


@pytest.mark.long
def test_beside_a_wrong_law_no_other_sensor_is_isolated(model: ModuleType) -> None:
    """One plant, two days learnt, two clean days and a drift of each sensor: what has to be seldom, not what is found."""
    sizes = model.Sizes(days=2.0, plants=model.UNSEEN[1:2], clean=2, runs=1)
    drifts = list(islice(model.faults_beside_a_wrong_law(sizes), 3))
    assert [r.what.split(":")[0] for r in drifts] == ["drift"] * 3
    assert drifts[0].met and drifts[2].met and all(r.met for r in model.clean_days(sizes))


@pytest.mark.long
def test_slow_changes_of_two_tanks_are_the_process(model: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model, "CHANGES", {"two-tanks": model.CHANGES["two-tanks"]})
    rows = list(model.slow_changes(model.Sizes(lengths=(300,), repeats=4)))
    assert rows and all(r.met for r in rows if "process" in r.what or "another" in r.what or "healthy" in r.what)
