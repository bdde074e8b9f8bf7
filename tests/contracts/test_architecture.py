"""Imports flow one way, nothing is imported twice under two names, and the files say nothing of the machine they came from."""

from __future__ import annotations

import ast
import re
import subprocess
from functools import cache
from pathlib import Path

import pytest
from kernels import NOT_NUMERICAL

SCHOOLS = (
    "kalman_banks",
    "adaptive_thresholds",
    "stochastic_thresholds",
    "data_driven",
    "structural_residuals",
    "frozen_model",
)
# the folders of fusion_sfdia and its modules, and what each imports besides its own: no school imports another
FOLDERS: dict[str, set[str]] = {
    "core": {"logs"},  # for pandas frames, once one is given
    "logs": {"core"},
    "intervals": set(),
    "filters": {"core"},
    "commissioning": {"core", "filters"},
    "frozen_model": {"core", "filters", "commissioning", "kalman_banks"},
    "kalman_banks": {"core", "filters"},
    "adaptive_thresholds": {"core", "intervals"},
    "stochastic_thresholds": {"core", "filters"},
    "data_driven": {"core"},
    "structural_residuals": {"core"},
    "evaluation": {"core", "filters", "logs"},
    "identification": {"core", "filters"},
    "monitoring": {"core", "evaluation", "identification", "kalman_banks", "data_driven"},
    "learning": {"core", "evaluation", "logs", "live"},
    "fmu": {"core", "logs"},  # of the last its reader of units
    "registry": {"core", "detectors", "fmu", "models"},  # of the last three only names, until one is used
    "detectors": {"registry"},
    "models": {"core", "evaluation", "registry"},
    "builders": {"core", "filters", "evaluation", "detectors", *SCHOOLS},
    "named": {"core", "evaluation", "logs", "registry", "builders", "detectors"},
    "tuning": {"core", "commissioning", "frozen_model", "registry"},
    "checks": {"core", "evaluation", "registry"},
    "report": {"core", "evaluation", "logs"},
    "live": {"core", "filters", "evaluation", "logs"},
    "inspection": {"core", "evaluation", "registry", "checks", "identification", "kalman_banks"},
    "experiments": {"core", "evaluation", "report", "models", "benchmarks"},  # of the last two their files alone
}
FOLDERS["scenarios"] = {"core", "registry", "experiments"}
FOLDERS["comparison"] = {*FOLDERS} - {"intervals", *SCHOOLS}
FOLDERS["study"] = {"core", "evaluation", "experiments", "registry", "report", "comparison"}
FOLDERS["benchmarks"] = {*FOLDERS}
FOLDERS["cli"] = {*FOLDERS}
ROOT = Path(__file__).resolve().parents[2]
MODULES = {
    ".".join(path.relative_to(start).with_suffix("").parts): path
    for start, folder in ((ROOT / "fusion_sfdia", "."), (ROOT, "models"), (ROOT, "benchmarks"))
    for path in sorted((start / folder).rglob("*.py"))
    if path.stem not in ("__init__", "__main__")
}


@cache
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


def own(names: set[str]) -> set[str]:
    """Folders and modules directly below the package among imported names."""
    return {name.split(".")[1] for name in names if name.startswith("fusion_sfdia.")}


@pytest.mark.parametrize("name", MODULES)
def test_imports_run_downward(name: str) -> None:
    folder = name.partition(".")[0]
    assert folder in FOLDERS, f"{name} stands in no known folder; put it into one of {', '.join(FOLDERS)}"
    used = own(imports(MODULES[name])) - {"__version__"}
    assert used <= {folder, *FOLDERS[folder]}, f"{name} imports {used - {folder, *FOLDERS[folder]}}, which it must not know"


def test_experiments_import_no_plant_and_no_scenario() -> None:
    for name, path in MODULES.items():
        if name.startswith("experiments."):
            assert not {n for n in imports(path) if re.match(r"fusion_sfdia\.(models|benchmarks)\.", n)}, name


@pytest.mark.parametrize("name", MODULES)
def test_a_module_has_one_name(name: str) -> None:
    tops = {used.split(".")[0] for used in imports(MODULES[name])}
    assert not tops & {"models", "benchmarks"}, f"{name}: import fusion_sfdia.models, fusion_sfdia.benchmarks"


def test_numerics_do_not_draw() -> None:
    for name, path in MODULES.items():
        if name.partition(".")[0] not in ("report", "experiments", "comparison", "benchmarks", "cli"):
            drawing = {n for n in imports(path) if n.split(".")[0] in ("matplotlib", "rich", "jinja2")}
            assert not drawing, f"{name} imports {drawing}"


def test_a_builder_imports_its_school_when_it_is_called() -> None:
    assert own(imports(MODULES["builders"])) >= {*SCHOOLS}
    assert not own(imports(MODULES["builders"], top_level=True)) & {*SCHOOLS}


def test_there_are_no_cycles() -> None:
    graph = {
        name: {used.removeprefix("fusion_sfdia.") for used in imports(path, top_level=True)} & {*MODULES} - {name}
        for name, path in MODULES.items()
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
        if not path.is_file() or path.suffix in (".png", ".svg"):
            continue
        text = path.read_text(encoding="utf-8")
        assert not (found := pattern.search(text)), f"{path.name}: {found and text[found.start() : found.end() + 30]}"


def test_files_left_out_of_the_runs_with_other_kernels_are_there(root: Path) -> None:
    assert set(NOT_NUMERICAL) <= {path.name for path in (root / "tests").rglob("*")}
