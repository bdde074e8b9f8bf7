"""Detectors that need an optional package, as parameters of tests that skip where it is missing."""

from __future__ import annotations

from importlib.util import find_spec

import pytest

STRUCTURAL = pytest.param(
    "structural-residuals",
    marks=pytest.mark.skipif(
        find_spec("faultdiagnosistoolbox") is None, reason="structural residuals need faultdiagnosistoolbox"
    ),
)
