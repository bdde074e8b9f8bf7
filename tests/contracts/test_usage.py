"""The examples of docs/usage.md, an own plant and an own detector, run as they stand."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

FILE = re.compile(r"^`(\w+\.py)`[^\n]*:\n\n```python\n(.*?)```", re.DOTALL | re.MULTILINE)


@pytest.fixture
def page(root: Path) -> str:
    return (root / "docs" / "usage.md").read_text(encoding="utf-8")


@pytest.fixture
def folder(page: str, tmp_path: Path) -> Path:
    """A folder with the files of the page."""
    files = FILE.findall(page)
    assert [name for name, _ in files] == ["tank.py", "unsure.py", "live.py", "mine.py", "study.py"]
    for name, text in files:
        (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path


def output_of(root: Path, folder: Path, *arguments: str) -> str:
    """What Python with these arguments prints; it runs in the folder."""
    environment = os.environ | {"PYTHONPATH": str(root)}
    run = subprocess.run([sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return run.stdout


def test_the_plant_is_simulated_and_diagnosed(root: Path, folder: Path, page: str) -> None:
    assert output_of(root, folder, "tank.py") == "level_2 from 3060 s, 0.10 m\n"
    assert "# level_2 from 3060 s, 0.10 m\n" in page


def test_an_unknown_outflow_is_estimated(root: Path, folder: Path) -> None:
    names, found = output_of(root, folder, "unsure.py").splitlines()
    assert names == "level, temperature, outflow, error of inflow"
    value = re.fullmatch(r"outflow (\+\d\.\d)% of its nominal value", found)
    assert value and abs(float(value[1]) - 5.0) < 2.0  # the error of the inflow, 1 %, moves the level as the outflow does


def test_the_commands_for_the_plant_run(root: Path, folder: Path, page: str) -> None:
    section = page.partition("## Your own plant\n")[2].partition("\n## ")[0]
    commands = re.findall(r"^fusion-sfdia (.*--plant tank\.py:make.*)$", section, re.MULTILINE)
    assert [command.split()[0] for command in commands] == ["simulate", "diagnose"]
    for command in commands:
        printed = output_of(root, folder, "-m", "fusion_sfdia", *shlex.split(command))
    assert "360 readings" in printed
    option = re.findall(r"`(--detector mine\.py:MyDetector)`", page)
    own = output_of(root, folder, "-m", "fusion_sfdia", *shlex.split(commands[1]), *option[0].split(), "--out", "own")
    assert "mine.py:MyDetector" in own


def test_rows_are_watched_and_taken_up_again(root: Path, folder: Path) -> None:
    lines = output_of(root, folder, "live.py").splitlines()
    assert lines == [f"{what}: level_2, since 3060 s, 0.10 m" for what in ("opened", "closed")]
    assert output_of(root, folder, "live.py") == ""  # all rows were in the state


def test_the_nodes_of_the_page_are_those_of_the_tank(page: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from fusion_sfdia.live.nodes import load_nodes
    from fusion_sfdia.registry import plant

    monkeypatch.chdir(folder)
    (folder / "nodes.toml").write_text(re.findall(r"```toml\n(period.*?)```", page, re.DOTALL)[0], encoding="utf-8")
    assert load_nodes("nodes.toml", plant("tank.py:make")).write["level_1"]["sigma"] == "ns=2;s=T1.LT1.sigma"


@pytest.mark.slow
def test_the_detector_is_checked_and_compared(root: Path, folder: Path) -> None:
    printed = output_of(root, folder, "study.py")
    assert "my-limits" in printed and "loo-glr" in printed
    assert (folder / "comparison.html").is_file()
