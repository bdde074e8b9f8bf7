"""What several test files share."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable, Generator
from pathlib import Path

import pytest
from markupsafe import Markup

from fusion_sfdia.detectors import registry

ROOT = Path(__file__).resolve().parent.parent
FIRST = {  # what each of two processes compiles before it collects: plants, and the detector that runs on them
    "gw0": {"two-tanks": "robust-glr", "power-network": "kf-chi2"},
    "gw1": {"marine-engine": "kf-chi2", "gas-pipeline": "kf-chi2"},
}

ALLOCATED = 20_000  # objects after which garbage is collected


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Half of what both processes need is compiled by either, and kept for the other, which would compile it at the same time.

    Meanwhile no garbage is collected, and afterwards more rarely than usual: most objects are of what was imported, compiled
    and collected, which stays.
    """
    gc.disable()
    try:
        for plant, detector in FIRST.get(os.environ.get("PYTEST_XDIST_WORKER", ""), {}).items():
            run_once(plant, detector)
        return (yield)
    finally:
        gc.set_threshold(ALLOCATED)
        gc.enable()


def run_once(plant: str, detector: str) -> None:
    """Two steps of a plant and of a detector on it."""
    from fusion_sfdia.detectors.detector import run
    from fusion_sfdia.diagnosis.simulate import simulate

    found = registry.detector(detector, of := registry.plant(plant))
    recording = simulate(of, 2, [0, 1])
    run(found, found.init((2,)), recording.t, recording.y, recording.u_of_runs)


@pytest.fixture(scope="session")
def root() -> Path:
    """The checkout."""
    return ROOT


@pytest.fixture(scope="session")
def shared_fixtures() -> Path:
    """Published data sets next to the checkout (see their SOURCES.md); the test is skipped where they are absent."""
    folder = ROOT.parent / "shared" / "fixtures"
    if not folder.is_dir():
        pytest.skip("needs the published data sets in ../shared/fixtures, next to the checkout")
    return folder


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures of this process are empty: for tests of other things, which take most of their time to draw."""
    from matplotlib.figure import Figure

    from fusion_sfdia.report import log_page, log_report
    from fusion_sfdia.study.experiments import runner

    def nothing(*_: object, laid_out: Callable[[Figure], object] = lambda figure: None) -> str:
        laid_out(Figure())
        return "<svg></svg>"

    for module in (runner, log_report):
        monkeypatch.setattr(module, "write_figure", nothing)
    empty = log_page.Drawn("", Markup("<svg></svg>"), "", "")
    monkeypatch.setattr(log_page, "_drawn", lambda *_: empty)


@pytest.fixture
def registrations(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a test registers is forgotten after it."""
    for kind, known in (("_PLANTS", registry.plants()), ("_DETECTORS", registry.detectors())):
        monkeypatch.setattr(registry, kind, known)
