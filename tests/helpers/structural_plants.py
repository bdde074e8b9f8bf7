"""The plants with scalar equations for structural residuals; each is built once."""

from __future__ import annotations

from functools import cache

import pytest

from fusion_sfdia.detectors import registry
from fusion_sfdia.plant.plant import Plant

pytest.importorskip("faultdiagnosistoolbox", reason="structural residuals need faultdiagnosistoolbox")
PLANTS = ("two-tanks", "marine-engine")


@cache
def plant_of(name: str) -> Plant:
    return registry.plant(name)
