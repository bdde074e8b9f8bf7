"""The files of docs/examples that the site shows, an own plant among them, run as they stand; `make docs` runs its pages."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.fixture
def folder(root: Path, tmp_path: Path) -> Path:
    """A folder with the files."""
    return Path(shutil.copytree(root / "docs" / "examples", tmp_path / "examples"))


def output_of(root: Path, folder: Path, *arguments: str) -> str:
    """What Python with these arguments prints; it runs in the folder."""
    environment = os.environ | {"PYTHONPATH": str(root)}
    run = subprocess.run([sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return run.stdout


def test_the_plant_is_simulated_and_diagnosed(root: Path, folder: Path) -> None:
    assert output_of(root, folder, "tank.py") == "level_2 from 3060 s, 0.10 m\n"
    assert "# level_2 from 3060 s, 0.10 m\n" in (folder / "tank.py").read_text(encoding="utf-8")


def test_an_unknown_outflow_is_estimated(root: Path, folder: Path) -> None:
    names, found = output_of(root, folder, "unsure.py").splitlines()
    assert names == "level, temperature, outflow, error of inflow"
    value = re.fullmatch(r"outflow (\+\d\.\d)% of its nominal value", found)
    assert value and abs(float(value[1]) - 5.0) < 2.0  # the error of the inflow, 1 %, moves the level as the outflow does


def test_rows_are_watched_and_taken_up_again(root: Path, folder: Path) -> None:
    lines = output_of(root, folder, "live.py").splitlines()
    found = [("opened", "size"), ("named", "bias"), ("closed", "size"), ("named", "bias")]
    assert lines == [f"{what}: level_2, since 3060 s, {kind} 0.10 m" for what, kind in found]
    assert output_of(root, folder, "live.py") == ""  # all rows were in the state


def test_nodes_and_topics_are_those_of_the_tank(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from fusion_sfdia.live.nodes import load_nodes
    from fusion_sfdia.live.topics import load_topics
    from fusion_sfdia.registry import plant

    monkeypatch.chdir(folder)
    assert load_nodes("nodes.toml", plant("tank.py:make")).write["level_1"]["sigma"] == "ns=2;s=T1.LT1.sigma"
    assert load_topics("topics.toml", plant("tank.py:make")).sources["level_2"].value == "lt2.pv"
