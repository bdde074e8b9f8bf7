"""The README's library example runs unchanged and isolates its fault, which limits do not find."""

import re
import runpy
import tomllib
from pathlib import Path

import pytest

from fusion_sfdia import Fault
from fusion_sfdia.detectors import registry


@pytest.fixture
def example(root: Path) -> str:
    """The Python of the README."""
    blocks = re.findall(r"```python\n(.*?)```", (root / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) == 1 and len(blocks[0].strip().splitlines()) <= 12
    return str(blocks[0])


def test_the_library_example_prints_what_it_shows(example: str, capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(example, "README.md", "exec"), {})
    assert capsys.readouterr().out == example.rpartition("# ")[2]


def test_limits_find_nothing_in_the_library_example(example: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert example.count('"robust-glr"') == 1
    exec(compile(example.replace("robust-glr", "limits"), "README.md", "exec"), {})
    assert capsys.readouterr().out == ""


def test_the_log_and_the_picture_of_the_readme_are_those_of_its_example(root: Path, example: str) -> None:
    (stated,) = tomllib.loads((root / "docs" / "examples" / "small-bias.toml").read_text(encoding="utf-8"))["fault"]
    fault = Fault(**stated)
    names: dict[str, object] = {}
    exec(compile(example.partition("for event")[0], "README.md", "exec"), names)
    drawn = runpy.run_path(str(root / "docs" / "figures" / "diagnosis_example.py"))
    assert names["fault"] == drawn["FAULT"] == fault


def test_the_readme_takes_a_minute(root: Path) -> None:
    text = (root / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 100
    assert f" {sum(not entry.reference for entry in registry.detectors().values())} detectors " in text


def test_what_the_readme_names_is_there(root: Path) -> None:
    text = (root / "README.md").read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        assert target.startswith("https://") or (root / target).exists(), target
    for target in re.findall(r"`make (\w+)`", text):
        assert re.search(rf"^{target}:", (root / "Makefile").read_text(encoding="utf-8"), re.MULTILINE), target
