"""The nomenclature page: each symbol's place is a definition of the file behind its link, each test a file of tests."""

import ast
import re
from pathlib import Path

import pytest

LINK = re.compile(r"\[(`?)([\w.]+)`?\]\(\.\./([\w/]+\.py)\)")


def page_of(root: Path) -> str:
    return (root / "docs" / "nomenclature.md").read_text(encoding="utf-8")


def defines(tree: ast.AST, name: str) -> bool:
    """Whether a module defines a function, class, constant, field or method by its dotted name."""
    first, _, rest = name.partition(".")
    for node in getattr(tree, "body", []):
        named = [getattr(node, "name", None), *(getattr(t, "id", None) for t in getattr(node, "targets", []))]
        if isinstance(node, ast.AnnAssign):
            named.append(getattr(node.target, "id", None))
        if first in named:
            return not rest or defines(node, rest)
    return False


def test_each_place_defines_what_the_page_names(root: Path) -> None:
    places = [(name, path) for code, name, path in LINK.findall(page_of(root)) if code]
    assert len(places) > 60
    lost = [f"{path}::{name}" for name, path in places if not (root / path).is_file() or not defined_in(root / path, name)]
    assert not lost, f"docs/nomenclature.md names what is not there: {', '.join(lost)}"


def defined_in(path: Path, name: str) -> bool:
    return defines(ast.parse(path.read_text(encoding="utf-8")), name)


def test_each_row_has_a_place_and_a_file_of_tests(root: Path) -> None:
    rows = [line for line in page_of(root).splitlines() if line.startswith("| ") and not line.startswith("| symbol")]
    assert len(rows) > 50
    for row in rows:
        found = LINK.findall(row)
        tests = [path for code, _, path in found if not code]
        assert len(tests) < len(found), f"no place: {row}"
        assert tests and all((root / path).is_file() and path.startswith("tests/") for path in tests), f"no test: {row}"


@pytest.mark.parametrize(
    ("name", "found"),
    [("f", True), ("A.m", True), ("A.field", True), ("B", True), ("C", True), ("A.n", False), ("g", False), ("m", False)],
)
def test_what_counts_as_a_definition(name: str, found: bool) -> None:
    source = "def f(): ...\nB = 1\nC: int = 2\nclass A:\n    field: int = 0\n    def m(self): ...\n"
    assert defines(ast.parse(source), name) == found
