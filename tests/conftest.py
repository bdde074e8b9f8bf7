"""What several test files share."""

from __future__ import annotations

from pathlib import Path

import pytest

from fusion_sfdia import registry

ROOT = Path(__file__).resolve().parent.parent


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
def registrations(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a test registers is forgotten after it."""
    for kind, known in (("_PLANTS", registry.plants()), ("_DETECTORS", registry.detectors())):
        monkeypatch.setattr(registry, kind, known)
