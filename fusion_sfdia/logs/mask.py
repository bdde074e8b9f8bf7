"""Rows in which a plant is not in operation, by comparisons such as "feed < 5"."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import shown, some
from fusion_sfdia.logs.columns import Sources
from fusion_sfdia.logs.log_map import MASK, LogMap
from fusion_sfdia.logs.time_order import LogRows

Array = NDArray[Any]

COMPARISONS = {"<=": operator.le, ">=": operator.ge, "==": operator.eq, "!=": operator.ne, "<": operator.lt, ">": operator.gt}


def mask_titles(where: str, titles: Sequence[str], sources: Sources, log_map: LogMap) -> list[str]:
    """The columns that the mask compares and that feed nothing; ValueError for a comparison that cannot be read."""
    by_name = {c.name: c.title for c in sources.columns}
    also = []
    for text in log_map.mask:
        match = MASK.fullmatch(text.strip())
        assert match is not None  # LogMap has seen to it
        if match[1] not in by_name and match[1] not in titles:
            raise ValueError(
                f"{where}: mask {shown(text)} compares {shown(match[1])}, which is no column, sensor or input of the log; "
                f"columns: {some(titles)}"
            )
        if match[1] not in by_name and match[1] not in by_name.values():
            also.append(match[1])
    return list(dict.fromkeys(also))


def masked_rows(where: str, rows: LogRows, sources: Sources, log_map: LogMap) -> Array:
    """The rows (K,) in which a comparison of the mask holds, in the units of the log; a missing value compares as before it."""
    masked = np.zeros(rows.t.shape, dtype=bool)
    if not log_map.mask:
        return masked
    import pandas

    by_name = {c.name: c.title for c in sources.columns}
    for text in log_map.mask:
        match = MASK.fullmatch(text.strip())
        assert match is not None
        values = pandas.Series(rows.values[by_name.get(match[1], match[1])]).ffill().to_numpy()
        masked |= COMPARISONS[match[2]](values, float(match[3])) & np.isfinite(values)
    if masked.all() and masked.size:
        raise ValueError(f"{where}: mask {', '.join(log_map.mask)} holds in every row; it compares in the units of the log")
    return masked
