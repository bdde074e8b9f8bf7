"""Plants and detectors of other packages: discovered by their entry points, listed, checked, and used by name."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from fusion_sfdia import check_detector, check_plant
from fusion_sfdia.cli.main import main
from fusion_sfdia.detectors import registry

TANK = '''
from fusion_sfdia.plants import two_tanks

def tank():
    """A tank of another package.

    With a second paragraph.
    """
    return two_tanks(outlet=1.1)
'''
TEST = '''
from fusion_sfdia import register_detector
from fusion_sfdia.detectors import CentralFilter

@register_detector("their-test", "a test of another package", memory="none", false_alarm=0.01)
class Test(CentralFilter):
    """Not what is shown."""
'''
POINTS = """[fusion_sfdia.plants]
their-tank = their_package.tank:tank
{more}
[fusion_sfdia.detectors]
their-test = their_package.test:Test
"""


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, registrations: None) -> Iterator[object]:
    """Install a package `their-package`, with more plants among its entry points."""
    site = tmp_path / "site"

    def installed(more: str = "") -> None:
        (site / "their_package").mkdir(parents=True)
        for name, text in (("__init__", ""), ("tank", TANK), ("test", TEST), ("broken", "import no_such_package\n")):
            (site / "their_package" / f"{name}.py").write_text(text)
        about = site / "their_package-1.0.dist-info"
        about.mkdir()
        (about / "METADATA").write_text("Metadata-Version: 2.1\nName: their-package\nVersion: 1.0\n")
        (about / "entry_points.txt").write_text(POINTS.format(more=more))
        monkeypatch.syspath_prepend(site)
        monkeypatch.chdir(tmp_path)

    yield installed
    for name in [name for name in sys.modules if name.partition(".")[0] == "their_package"]:
        del sys.modules[name]


def test_they_are_listed_with_their_package(install, capsys: pytest.CaptureFixture[str]) -> None:  # type: ignore[no-untyped-def]
    install()
    assert main(["list", "plants"]) == 0
    *ours, theirs = capsys.readouterr().out.splitlines()
    assert theirs.split() == "their-tank A tank of another package (from their_package)".split()
    assert len(ours) == 4 and not any("(from" in line for line in ours)
    assert main(["list", "detectors", "--json"]) == 0
    theirs = json.loads(capsys.readouterr().out)["detectors"][-1]
    about = {"name": "their-test", "about": "a test of another package", "package": "their_package"}
    assert theirs == about | {"tests": "sensors", "at_once": "", "reference": ""}
    assert registry.detectors()["their-test"].memory == "none"


def test_they_keep_the_contract_and_diagnose(install, capsys: pytest.CaptureFixture[str]) -> None:  # type: ignore[no-untyped-def]
    install()
    check_plant("their-tank")
    check_detector("their-test", "their-tank")
    assert main(["simulate", "--plant", "their-tank", "--steps", "40", "--out", "log.csv"]) == 0
    assert main(["diagnose", "--plant", "their-tank", "--detector", "their-test", "--data", "log.csv"]) == 0
    assert "40 readings" in capsys.readouterr().out


def test_files_diagnose_without_any_package(install, capsys: pytest.CaptureFixture[str]) -> None:  # type: ignore[no-untyped-def]
    install()
    tank = "site/their_package/tank.py:tank"
    assert main(["simulate", "--plant", tank, "--steps", "40", "--out", "log.csv"]) == 0
    by_module = ["--detector", "fusion_sfdia.detectors.kalman_banks.central_filter:CentralFilter"]
    assert main(["diagnose", "--plant", tank, *by_module, "--data", "log.csv"]) == 0
    assert "by fusion_sfdia.detectors.kalman_banks.central_filter:CentralFilter" in capsys.readouterr().out


def test_one_that_fails_to_load_names_its_package_and_breaks_nothing_else(install) -> None:  # type: ignore[no-untyped-def]
    install("broken-tank = their_package.broken:tank")
    assert registry.plant("two-tanks").name == registry.plant("their-tank").name == "two-tanks"
    assert registry.plants()["broken-tank"].about.startswith("cannot be loaded: module their_package.broken fails")
    with pytest.raises(ValueError, match=r"package their-package: module their_package.broken fails while it is imported"):
        registry.plant("broken-tank")


def test_one_of_a_name_that_is_taken_is_refused(install) -> None:  # type: ignore[no-untyped-def]
    install("two-tanks = their_package.tank:tank")
    with pytest.raises(ValueError, match=r"plant 'two-tanks' of their_package.tank:tank: that name is taken by fusion_sfdia"):
        registry.plants()
