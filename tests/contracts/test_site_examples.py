"""The files of docs/examples that the site shows, an own plant among them, run as they stand; `make docs` runs its pages."""

from __future__ import annotations

import re
import runpy
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest


@pytest.fixture
def folder(root: Path, tmp_path: Path) -> Path:
    """A folder with the files."""
    return Path(shutil.copytree(root / "docs" / "examples", tmp_path / "examples"))


@pytest.fixture
def printed(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Iterator[Callable[[str], str]]:
    """What a file prints that is run in the folder, without what another file of it has left in this process."""
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(folder)

    def output_of(name: str) -> str:
        sys.modules.pop("tank", None)
        runpy.run_path(name, run_name="__main__")
        return capsys.readouterr().out

    yield output_of
    sys.modules.pop("tank", None)


def test_the_plant_is_simulated_and_diagnosed(folder: Path, printed: Callable[[str], str]) -> None:
    assert printed("tank.py") == "level_2 from 3060 s, 0.10 m\n"
    assert "# level_2 from 3060 s, 0.10 m\n" in (folder / "tank.py").read_text(encoding="utf-8")


def test_an_unknown_outflow_is_estimated(printed: Callable[[str], str]) -> None:
    names, found = printed("unsure.py").splitlines()
    assert names == "level, temperature, outflow, error of inflow"
    value = re.fullmatch(r"outflow (\+\d\.\d)% of its nominal value", found)
    assert value and abs(float(value[1]) - 5.0) < 2.0  # the error of the inflow, 1 %, moves the level as the outflow does


def test_rows_are_watched_and_taken_up_again(printed: Callable[[str], str]) -> None:
    lines = printed("live.py").splitlines()
    found = [("opened", "size"), ("named", "bias"), ("closed", "size"), ("named", "bias")]
    assert lines == [f"{what}: level_2, since 3060 s, {kind} 0.10 m" for what, kind in found]
    assert printed("live.py") == ""  # all rows were in the state


def test_nodes_and_topics_are_those_of_the_tank(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from fusion_sfdia.detectors.registry import plant
    from fusion_sfdia.live.nodes import load_nodes
    from fusion_sfdia.live.topics import load_topics

    monkeypatch.chdir(folder)
    assert load_nodes("nodes.toml", plant("tank.py:make")).write["level_1"]["sigma"] == "ns=2;s=T1.LT1.sigma"
    assert load_topics("topics.toml", plant("tank.py:make")).sources["level_2"].value == "lt2.pv"
