"""The README's library example runs unchanged and isolates its fault."""

import re
from pathlib import Path

import pytest

from fusion_sfdia import registry


def test_the_library_example_runs(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (root / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) == 1 and len(blocks[0].strip().splitlines()) <= 12
    exec(compile(blocks[0], "README.md", "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1 and lines[0].startswith("p_3 600.0") and lines[0].endswith("Pa")


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
