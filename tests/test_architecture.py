"""Imports flow one way, nothing is imported twice under two names, and the files say nothing of the machine they came from."""

from __future__ import annotations

import ast
import re
import subprocess
from pathlib import Path

import pytest
from kernels import NOT_NUMERICAL

# the folders of fusion_sfdia, and those from which the modules of each import beside their own: no school knows another
FOLDERS: dict[str, set[str]] = {
    "core": set(),
    "intervals": set(),
    "filters": {"core"},
    "kalman_banks": {"core", "filters"},
    "adaptive_thresholds": {"core", "intervals"},
    "stochastic_thresholds": {"core", "filters"},
    "data_driven": {"core"},
    "structural_residuals": {"core"},
    "evaluation": {"core"},
}
COMMAND_LINE = {"cli", "cli_runs"}
ROOT = Path(__file__).resolve().parent.parent
MODULES = {
    package: {
        ".".join(p.relative_to(ROOT / top).with_suffix("").parts): p
        for folder in folders
        for p in sorted((ROOT / top / folder).glob("*.py"))
        if p.stem not in ("__init__", "__main__")
    }
    for package, top, folders in (
        ("fusion_sfdia", "fusion_sfdia", (".", *FOLDERS)),
        ("models", "models", (".",)),
        ("benchmarks", "benchmarks", (".",)),
    )
}


def imports(path: Path, *, top_level: bool = False) -> set[str]:
    """Full names of what a file imports; top_level: only what is imported when the file is."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for_types = {
        id(node)
        for block in ast.walk(tree)
        if isinstance(block, ast.If) and getattr(block.test, "id", "") == "TYPE_CHECKING"
        for node in ast.walk(block)
    }
    found: set[str] = set()
    for node in tree.body if top_level else ast.walk(tree):
        if id(node) in for_types:
            continue
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name} imports relatively: a module has one name"
            found |= {f"{node.module}.{alias.name}" for alias in node.names} | {str(node.module)}
    return found


def own(names: set[str], prefix: str = "fusion_sfdia") -> set[str]:
    """Modules directly below a package among imported names."""
    return {name.split(".")[prefix.count(".") + 1] for name in names if name.startswith(prefix + ".")}


@pytest.mark.parametrize("name", MODULES["fusion_sfdia"])
def test_the_library_imports_downward(name: str) -> None:
    folder, dot, _ = name.partition(".")
    if not dot:
        assert name in COMMAND_LINE, f"{name} stands in no folder; put it into one of {', '.join(FOLDERS)}"
        allowed = {*FOLDERS, *COMMAND_LINE, "benchmarks", "__version__"}
    else:
        allowed = {folder, *FOLDERS[folder], "__version__"}
    used = own(imports(MODULES["fusion_sfdia"][name]))
    assert used <= allowed, f"{name} imports {used - allowed}, of which it should not know"


@pytest.mark.parametrize("name", MODULES["models"])
def test_plants_import_the_interface_alone(name: str) -> None:
    assert own(imports(MODULES["models"][name])) <= {"core", "models"}


@pytest.mark.parametrize("name", MODULES["benchmarks"])
def test_benchmarks_do_not_import_the_command_line(name: str) -> None:
    assert "cli" not in own(imports(MODULES["benchmarks"][name]))


def test_the_runner_knows_no_scenario_and_no_detector() -> None:
    general = {
        "cluster",
        "results",
        "scenario",
        "parts",
        "provenance",
        "output",
        "plots",
        "report",
        "runner",
        "workers",
        "registry",
    }
    for name in general - {"registry"}:
        path = MODULES["benchmarks"][name]
        assert own(imports(path), "fusion_sfdia.benchmarks") <= general, name
        assert own(imports(path)) <= {"benchmarks", "models", "core"}, name


@pytest.mark.parametrize("package", MODULES)
def test_a_module_has_one_name(package: str) -> None:
    for path in MODULES[package].values():
        tops = {name.split(".")[0] for name in imports(path)}
        assert not tops & {"models", "benchmarks"}, f"{path.name}: import fusion_sfdia.{package}"


def test_numerics_do_not_draw() -> None:
    for package in ("fusion_sfdia", "models"):
        for path in MODULES[package].values():
            assert not {n for n in imports(path) if n.split(".")[0] in ("matplotlib", "rich", "jinja2")}, path.name


def test_there_are_no_cycles() -> None:
    modules = MODULES["fusion_sfdia"]
    graph = {
        name: {m for m in modules if f"fusion_sfdia.{m}" in imports(path, top_level=True)} - {name}
        for name, path in modules.items()
    }
    done: set[str] = set()
    while len(done) < len(graph):
        ready = {name for name, needs in graph.items() if name not in done and needs <= done | {name}}
        assert ready, f"these import each other: {sorted(set(graph) - done)}"
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
        if path.is_symlink() or not path.is_file() or path.suffix in (".png", ".svg"):
            continue
        text = path.read_text(encoding="utf-8")
        assert not (found := pattern.search(text)), f"{path.name}: {found and text[found.start() : found.end() + 30]}"


def test_files_left_out_of_the_runs_with_other_kernels_are_there(root: Path) -> None:
    assert {name for name in NOT_NUMERICAL if not (root / "tests" / name).is_file()} == set()
