"""The site: every public name stands once in the reference and in a cell that runs; the guide names commands that exist."""

from __future__ import annotations

import ast
import importlib
import re
from collections import Counter
from pathlib import Path
from types import ModuleType

import pytest

import fusion_sfdia
from fusion_sfdia.cli.main import parser

CELL = re.compile(r"^```\{code-cell\}\n(.*?)^```$", re.DOTALL | re.MULTILINE)
ENTRY = re.compile(r"^\.\. auto(?:class|function|exception):: fusion_sfdia\.(?:\w+\.)?(\w+)$", re.MULTILINE)
GROUPS = [getattr(fusion_sfdia, group) for group in fusion_sfdia._GROUPS]
NAMES = [name for name in fusion_sfdia.__all__ if name not in ("__version__", *fusion_sfdia._GROUPS)]
NAMES += [name for group in GROUPS for name in group.__all__]


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


@pytest.fixture
def links(root: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(root / "docs"))
    return importlib.import_module("links")


@pytest.mark.parametrize(
    ("link", "wrong"),
    [
        ("other.html#here", ""),
        ("#top", ""),
        ("picture%201.png", ""),
        ("https://semver.org", ""),
        ("mailto:a@b.example", ""),
        ("gone.html", "no file"),
        ("other.html#gone", "no anchor of other.html"),
        ("#gone", "no anchor of page.html"),
        ("http://semver.org", "out of the site"),
        ("https://semver.org.example", "out of the site"),
        ("//semver.org", "out of the site"),
        ("https://[semver.org", "no address"),
    ],
)
def test_a_link_of_the_site_leads_somewhere(links: ModuleType, tmp_path: Path, link: str, wrong: str) -> None:
    page = tmp_path / "page.html"
    page.write_text(f'<h1 id="top">A page</h1><p class="x"><a class="y" href="{link}">a link</a></p>', encoding="utf-8")
    (tmp_path / "other.html").write_text('<section id="here"></section>', encoding="utf-8")
    (tmp_path / "picture 1.png").touch()
    found = links.wrong_links([page])
    assert len(found) == bool(wrong) and all(wrong in sentence for sentence in found)


def test_addresses_outside_are_of_known_hosts(root: Path, links: ModuleType) -> None:
    """What is written in pages, notebooks and docstrings; `make docs` asks the same of what becomes of them."""
    texts = [*(root / "docs").glob("**/*.md"), *(root / "notebooks").glob("*.ipynb"), *root.glob("*.md")]
    written = [
        a for path in texts for a in re.findall(r"\]\((\w+://[^)\s]+)\)|<(https?://[^>\s]+)>", path.read_text(encoding="utf-8"))
    ]
    addresses = ["".join(pair) for pair in written]
    assert addresses and not [a for a in addresses if links.wrong_link(root / "x.html", a)]


def test_a_newcomer_finds_the_install_and_a_chosen_fault_at_once(root: Path) -> None:
    """The landing page states how to install; the first page of the guide has a fault file that is read, and explains NIS."""
    first = (root / "docs" / "guide" / "first-fault.md").read_text(encoding="utf-8")
    assert "pip install ." in (root / "docs" / "index.md").read_text(encoding="utf-8")
    (written,) = re.findall(r"%%writefile (\S+\.toml)", first)
    assert f"--faults {written}" in first and "NIS is the mean square of the prediction errors" in first
