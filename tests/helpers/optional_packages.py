"""The registered detectors as parameters of tests; one whose optional package is missing skips, slow references are `long`."""

from __future__ import annotations

from importlib.util import find_spec

import pytest

from fusion_sfdia.detectors import registry

NAME = "structural-residuals"

needs_toolbox = pytest.mark.skipif(
    find_spec("faultdiagnosistoolbox") is None, reason="structural residuals need faultdiagnosistoolbox"
)
STRUCTURAL = pytest.param(NAME, marks=needs_toolbox)
REGISTERED = [
    STRUCTURAL if name == NAME else pytest.param(name, marks=pytest.mark.long) if entry.reference else name
    for name, entry in registry.detectors().items()
]
