"""The results pages show what the numbers beside them say, and the README shows what the pages show."""

import importlib.util
import re
from pathlib import Path

import pytest


def test_the_comparisons_page_is_that_of_its_numbers(root: Path) -> None:
    folder = root / "docs" / "results"
    spec = importlib.util.spec_from_file_location("comparison_page", folder / "comparison.py")
    assert spec is not None and spec.loader is not None
    page = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(page)
    assert page.render(page.load(folder / "comparison.csv")) == (folder / "comparison.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("title", ["Area under the ROC, bias of 3 sigma", "Exact isolation, faults of 10 sigma"])
def test_the_readmes_tables_are_those_of_the_page(root: Path, title: str) -> None:
    page = (root / "docs" / "results" / "comparison.md").read_text(encoding="utf-8")
    readme = (root / "README.md").read_text(encoding="utf-8")
    shown = re.search(rf"^\| {re.escape(title.lower())} \|.*\n\|.*\n((?:\|.*\n)+)", readme, re.MULTILINE)
    assert shown is not None, title
    section = page.split(f"## {title}\n")[1].split("\n## ")[0]
    for line in shown[1].splitlines():
        assert line in section, line
