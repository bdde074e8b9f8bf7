"""How lines and points of detectors look: a family has a colour, its members differ by dashes and markers; many are grey."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from fusion_sfdia.report.plots import COLOURS, DASHES, MARKERS

FAMILIES = (
    "fusing", "loo", "kf", "adaptive", "virtual", "chebyshev", "limits", "pca", "structural", "uio", "multiple", "one", "mhe",
    "robust", "frozen",
)  # fmt: skip
# one each; on white the lightest of COLOURS is hardly seen
FAMILY_COLOURS = (*COLOURS[:-1], "#D4B000", "#808080", "#8B4513", "#6A3D9A", "#808000", "#B03060", "#004D40", "#5F9EA0")
LINES: tuple[Any, ...] = (*DASHES, (0, (6, 2, 1, 2, 1, 2)), (0, (2, 4)))  # one for each member of a family
MOST_NAMED, NAMED = 9, 6  # detectors that lines can show by name; where they are more, those that are named
OTHERS, GREY = "other detectors", "0.82"


def prominent(values: Mapping[str, float]) -> list[str]:
    """The detectors that a figure of lines names: all, or of many the best of each of the best families."""
    if len(values) <= MOST_NAMED:
        return list(values)
    best: dict[str, str] = {}
    for detector in sorted(values, key=lambda d: -np.nan_to_num(values[d])):
        best.setdefault(_family(detector), detector)
    return list(best.values())[:NAMED]


def quieted(look: Mapping[str, dict[str, Any]], named: Collection[str]) -> dict[str, dict[str, Any]]:
    """The looks of detectors with those that are not named in grey, behind the others."""
    grey = {"color": GREY, "linestyle": "-", "marker": "", "zorder": 1}
    return {d: one if d in named else grey for d, one in look.items()}


def looks(detectors: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Colour, dashes and marker of each detector."""
    found: dict[str, dict[str, Any]] = {}
    members: dict[str, int] = {}
    families = [*FAMILIES, *sorted({_family(d) for d in detectors} - set(FAMILIES))]
    for d in detectors:
        family = _family(d)
        i = members[family] = members.get(family, -1) + 1
        place = families.index(family)
        found[d] = {
            "color": FAMILY_COLOURS[place % len(FAMILY_COLOURS)],
            "linestyle": LINES[i % len(LINES)],
            "marker": MARKERS[(place + i) % len(MARKERS)],
        }
    return found


def _family(detector: str) -> str:
    return detector.partition(":")[0].removeprefix("dynamic-").partition("-")[0]
