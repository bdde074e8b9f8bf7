"""The site: every public name stands once in the reference and in a cell that runs; the guide names commands that exist."""

from __future__ import annotations

import ast
import re
from collections import Counter
from pathlib import Path

import pytest

import fusion_sfdia
from fusion_sfdia.cli.main import parser

CELL = re.compile(r"^```\{code-cell\}\n(.*?)^```$", re.DOTALL | re.MULTILINE)
ENTRY = re.compile(r"^\.\. auto(?:class|function|exception):: fusion_sfdia\.(\w+)$", re.MULTILINE)
NAMES = [name for name in fusion_sfdia.__all__ if not name.startswith("_")]


@pytest.fixture
def reference(root: Path) -> str:
    return "\n".join(path.read_text(encoding="utf-8") for path in sorted((root / "docs" / "reference").glob("*.md")))


def cells_of(text: str) -> list[str]:
    """The code of the cells of a page, without options; those of a shell or of a file are left out."""
    found = (re.sub(r"\A(:.*\n)+\n?", "", cell) for cell in CELL.findall(text))
    return [cell for cell in found if not cell.startswith("%%")]


def test_every_public_name_stands_once_in_the_reference(reference: str) -> None:
    assert Counter(ENTRY.findall(reference)) == Counter(NAMES)


def test_every_public_name_is_used_in_a_cell_of_the_reference(reference: str) -> None:
    """More than imported: a cell that runs has it as a name."""
    used = {node.id for cell in cells_of(reference) for node in ast.walk(ast.parse(cell)) if isinstance(node, ast.Name)}
    assert set(NAMES) <= used, set(NAMES) - used


def test_commands_of_the_site_exist(root: Path) -> None:
    known = next(action.choices for action in parser()._actions if action.dest == "command")
    assert known is not None
    text = "\n".join(path.read_text(encoding="utf-8") for path in (root / "docs").glob("[gier]*/*.md"))
    named = set(re.findall(r"fusion-sfdia ([a-z][\w-]*)", text))
    assert len(named) > 8 and named <= set(known), named - set(known)


def test_a_newcomer_finds_the_install_and_a_chosen_fault_at_once(root: Path) -> None:
    """The landing page states how to install; the first page of the guide has a fault file that is read, and explains NIS."""
    first = (root / "docs" / "guide" / "first-fault.md").read_text(encoding="utf-8")
    assert "pip install ." in (root / "docs" / "index.md").read_text(encoding="utf-8")
    (written,) = re.findall(r"%%writefile (\S+\.toml)", first)
    assert f"--faults {written}" in first and "NIS is the mean square of the prediction errors" in first
