"""Columns whose unit looks wrong."""

from __future__ import annotations

from fusion_sfdia.core.log import Log
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.logs.findings import Finding


def suspected_units(plant: Plant, log: Log) -> list[Finding]:
    """Findings on sensors whose readings fit another unit."""
    return []
