"""What is installed, and that importing it is cheap."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import fusion_sfdia

HEAVY = {"scipy", "matplotlib", "sklearn", "numba", "numpy", "joblib", "filterpy", "rich", "jinja2"}

GROUPS = [getattr(fusion_sfdia, group) for group in fusion_sfdia._GROUPS]
PUBLIC = [fusion_sfdia, *GROUPS]


def python(code: str, cwd: Path, *options: str) -> str:
    """Run code in another process and return what it prints; the checkout is on its path."""
    root = Path(__file__).resolve().parents[2]
    begin = f"import sys; sys.path.insert(0, {str(root)!r}); "
    done = subprocess.run([sys.executable, *options, "-c", begin + code], capture_output=True, text=True, cwd=cwd, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize(
    "code",
    [
        "import fusion_sfdia",
        "from fusion_sfdia.cli.main import parser; parser().format_help()",
        "import fusion_sfdia; fusion_sfdia.__version__; dir(fusion_sfdia)",
        "from fusion_sfdia.detectors import registry; registry.plants(), registry.detectors()",
        "from fusion_sfdia.cli.main import main; main(['list', 'detectors'])",
    ],
)
def test_importing_loads_nothing_heavy(tmp_path: Path, code: str) -> None:
    loaded = python(f"{code}; print(*{{name.split('.')[0] for name in sys.modules}})", tmp_path).splitlines()[-1].split()
    assert not HEAVY & set(loaded)


def test_every_public_name_is_there() -> None:
    for module in PUBLIC:
        assert all(getattr(module, name) is not None for name in module.__all__)
        assert {*dir(module)} == {*module.__all__}, "dir shows what is public, and nothing else"
    assert len(fusion_sfdia.__all__) < 45
    with pytest.raises(AttributeError, match=r"no attribute 'simulat'; public names: .*simulate"):
        fusion_sfdia.simulat  # noqa: B018


def test_a_public_name_is_that_of_its_object() -> None:
    """So that an error, a pickle and the documentation have one name for it."""
    for module in PUBLIC:
        for name in module.__all__:
            assert getattr(getattr(module, name), "__name__", name).rpartition(".")[2] == name


def test_no_two_public_names_differ_by_case_or_stand_twice() -> None:
    for module in PUBLIC:
        assert len({name.replace("_", "").lower() for name in module.__all__}) == len(module.__all__)
    names = [name for module in PUBLIC for name in module.__all__]
    assert len({*names}) == len(names)


def test_a_former_name_warns_and_says_where_it_is() -> None:
    with pytest.warns(DeprecationWarning, match=r"fusion_sfdia.RobustBank is now fusion_sfdia.detectors.RobustBank"):
        assert fusion_sfdia.RobustBank is fusion_sfdia.detectors.RobustBank
    with pytest.warns(DeprecationWarning, match=r"fusion_sfdia.inspect_plant is now fusion_sfdia.inspect"):
        assert fusion_sfdia.inspect_plant is fusion_sfdia.inspect
    with pytest.warns(DeprecationWarning, match=r"fusion_sfdia.registry is now fusion_sfdia.detectors.registry"):
        assert fusion_sfdia.registry is sys.modules["fusion_sfdia.detectors.registry"]
    learning = fusion_sfdia.learning
    with pytest.warns(
        DeprecationWarning, match=r"fusion_sfdia.learning.choose_model is now fusion_sfdia.learning.ModelChoice.of"
    ):
        assert learning.choose_model == learning.ModelChoice.of
    assert "commission" not in learning.__all__
    for module in (fusion_sfdia, learning):
        with pytest.warns(DeprecationWarning, match=r"commission is now fusion_sfdia.learning.Commissioning.of\(...\).plant"):
            former = module.commission
        with pytest.raises(AttributeError, match="'NoneType' object has no attribute 'sensor_names'"):  # as of that method
            former(None)
    with pytest.warns(DeprecationWarning, match=r"fusion_sfdia.commissioned is now fusion_sfdia.learning.Commissioning.of"):
        assert fusion_sfdia.commissioned == learning.Commissioning.of


def test_no_public_name_is_that_of_a_module_of_its_package(root: Path) -> None:
    """Importing the module would put it in the place of the name."""
    for module in GROUPS:
        folder = Path(str(module.__file__)).parent
        if folder != root / "fusion_sfdia":
            assert not {p.stem for p in folder.iterdir()} & {*module.__all__}


def test_the_command_runs_as_a_module(tmp_path: Path) -> None:
    shown = python(
        "import runpy; sys.argv[1:] = ['--version']; runpy.run_module('fusion_sfdia', run_name='__main__')", tmp_path
    )
    assert shown == f"fusion-sfdia {fusion_sfdia.__version__}\n"


def test_every_folder_is_mapped(root: Path) -> None:
    setup = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    assert setup["package-dir"] == {
        "fusion_sfdia": "fusion_sfdia",
        "fusion_sfdia.models": "models",
        "fusion_sfdia.benchmarks": "benchmarks",
    }
    folders = {
        p.parent.relative_to(root)
        for top in ("fusion_sfdia", "models", "benchmarks")
        for p in (root / top).rglob("__init__.py")
    }
    names = {".".join(f.parts) for f in folders}
    assert set(setup["packages"]) == {n if n.startswith("fusion_sfdia") else f"fusion_sfdia.{n}" for n in names}


SUFFIXES = (".py", ".pyi", ".json", ".toml", ".js", ".css", ".j2")


@pytest.mark.slow
def test_the_wheel_from_the_sdist_holds_the_package_and_nothing_else(root: Path, tmp_path: Path) -> None:
    """Built from a copy of what is tracked, where links are files that hold their target, as git writes them on Windows."""
    pytest.importorskip("build")
    listed = subprocess.run(["git", "-C", str(root), "ls-files", "-z"], capture_output=True, text=True, check=False)
    if listed.returncode != 0:
        pytest.skip("needs a git checkout, to tell what is tracked")
    copy = tmp_path / "copy"
    for name in filter(None, listed.stdout.split("\0")):
        source = root / name
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        (copy / name).write_bytes(os.readlink(source).encode() if source.is_symlink() else source.read_bytes())
    built = subprocess.run(
        [sys.executable, "-m", "build", "--outdir", str(tmp_path / "dist"), str(copy)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert built.returncode == 0, built.stderr[-2000:]
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        archive.extractall(tmp_path / "site")
    assert {name.split("/")[0] for name in names} == {"fusion_sfdia", f"fusion_sfdia-{fusion_sfdia.__version__}.dist-info"}
    expected = {"fusion_sfdia/py.typed"}
    folders = {"fusion_sfdia": "fusion_sfdia", "models": "fusion_sfdia/models", "benchmarks": "fusion_sfdia/benchmarks"}
    for folder, package in folders.items():
        files = [p for p in (copy / folder).rglob("*") if p.suffix in SUFFIXES]
        expected |= {f"{package}/{p.relative_to(copy / folder)}" for p in files}
    assert {n for n in names if ".dist-info/" not in n} == expected
    code = f"sys.path[0] = {str(tmp_path / 'site')!r}; "
    code += "import fusion_sfdia.models.two_tanks.plant as m, fusion_sfdia.benchmarks.pipeline.roc as r; "
    code += "print(m.__file__, r.__file__)"
    assert all(path.startswith(str(tmp_path / "site")) for path in python(code, tmp_path).split())
