"""Imports flow one way, nothing is imported twice under two names, and the files say nothing of the machine they came from."""

from __future__ import annotations

import ast
import re
import subprocess
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import pytest
from kernels import NOT_NUMERICAL

# The rooms of fusion_sfdia from the foundation up: each imports from those before it and from itself alone, wherever an import
# stands, also in a function or for types.
ROOMS = (
    "common",
    "derivatives",
    "plant",
    "logs",
    "filters",
    "detectors",
    "diagnosis",
    "report",
    "learning",
    "study",
    "models",
    "benchmarks",
    "live",
    "cli",
)
FAMILIES = ("kalman_banks", "adaptive_thresholds", "stochastic_thresholds", "data_driven", "structural_residuals")
ROOT = Path(__file__).resolve().parents[2]
MODULES = {
    ".".join(path.relative_to(start).with_suffix("").parts): path
    for start, folder in ((ROOT / "fusion_sfdia", "."), (ROOT, "models"), (ROOT, "benchmarks"))
    for path in sorted((start / folder).rglob("*.py"))
    if path.stem not in ("__init__", "__main__") and path.parent != ROOT / "fusion_sfdia"  # there stand the public names
}


@cache
def imports(path: Path, *, top_level: bool = False) -> frozenset[str]:
    """Full names of what a file imports; top_level: only what is imported when the file is."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found: set[str] = set()
    for node in tree.body if top_level else ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name} imports relatively: a module has one name"
            found |= {f"{node.module}.{alias.name}" for alias in node.names} | {str(node.module)}
    return frozenset(found)


def used_modules(name: str) -> set[str]:
    """The modules of the project that a module imports anywhere."""
    return {used.removeprefix("fusion_sfdia.") for used in imports(MODULES[name])} & {*MODULES} - {name}


@pytest.mark.parametrize("name", MODULES)
def test_a_room_imports_only_those_below(name: str) -> None:
    room, family = (*name.split("."), "")[:2]
    assert room in ROOMS, f"{name} stands in no known room; put it into one of {', '.join(ROOMS)}"
    above = ROOMS[ROOMS.index(room) + 1 :]
    assert not (up := [used for used in used_modules(name) if used.split(".")[0] in above]), f"{name} imports {up}, from above"
    if family in FAMILIES:
        others = {used.split(".")[1] for used in used_modules(name)} & {*FAMILIES} - {family}
        assert not others, f"{name} imports of other families, {others}"


@pytest.mark.parametrize("name", MODULES)
def test_a_module_has_one_name(name: str) -> None:
    tops = {used.split(".")[0] for used in imports(MODULES[name])}
    assert not tops & {"models", "benchmarks"}, f"{name}: import fusion_sfdia.models, fusion_sfdia.benchmarks"


def test_numerics_do_not_draw() -> None:
    for name, path in MODULES.items():
        if name.partition(".")[0] not in ("report", "study", "benchmarks", "cli"):
            drawing = {n for n in imports(path) if n.split(".")[0] in ("matplotlib", "rich", "jinja2")}
            assert not drawing, f"{name} imports {drawing}"


def test_a_builder_imports_its_family_when_it_is_called() -> None:
    families = {f"fusion_sfdia.detectors.{family}" for family in FAMILIES}

    def of(names: Iterable[str]) -> set[str]:
        return {".".join(name.split(".")[:3]) for name in names} & families

    builders = MODULES["learning.builders"]
    assert of(imports(builders)) == families
    assert not of(imports(builders, top_level=True))


def test_no_modules_import_each_other() -> None:
    graph = {name: used_modules(name) for name in MODULES}
    done: set[str] = set()
    while len(done) < len(graph):
        ready = {name for name, needs in graph.items() if name not in done and needs <= done}
        assert ready, f"these import each other, or are imported by such: {sorted(set(graph) - done)}"
        done |= ready


def tracked() -> list[Path]:
    listed = subprocess.run(["git", "-C", str(ROOT), "ls-files", "-z"], capture_output=True, text=True, check=False)
    if listed.returncode != 0:
        pytest.skip("needs a git checkout, to tell what is tracked")
    return [ROOT / name for name in listed.stdout.split("\0") if name]


def test_names_of_files_are_plain() -> None:
    for path in tracked():
        name = str(path.relative_to(ROOT))
        assert re.fullmatch(r"[A-Za-z0-9._/-]+", name), name


def test_no_path_of_a_machine_is_written_down() -> None:
    folders = "|".join(("home", "root", "tmp", "work", "Users", "mnt", "opt"))
    pattern = re.compile(rf"(?<![\w./~$)}}-])/(?:{folders})/\w")
    for path in tracked():
        if not path.is_file() or path.suffix in (".png", ".svg"):
            continue
        text = path.read_text(encoding="utf-8")
        assert not (found := pattern.search(text)), f"{path.name}: {found and text[found.start() : found.end() + 30]}"


def test_files_left_out_of_the_runs_with_other_kernels_are_there(root: Path) -> None:
    assert set(NOT_NUMERICAL) <= {path.name for path in (root / "tests").rglob("*")}
