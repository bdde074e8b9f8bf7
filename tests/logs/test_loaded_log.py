"""What a reader of results reads about a log: all that is grave, and missing values in a few lines."""

from __future__ import annotations

import numpy as np

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.logs.loaded_log import Finding, LoadedLog
from fusion_sfdia.plant.log import Log


def test_missing_values_are_told_in_a_few_lines_and_suspects_all() -> None:
    bad = [Finding("bad", f"T{k}", 3, f"T{k}: 3 values marked as bad") for k in range(5)]
    suspects = [Finding("unit suspected", f"T{k}", 9, f"T{k} looks 1000 times too large") for k in range(4)]
    log = LoadedLog(Log(*[np.empty((0,))] * 3), Clock(), (*bad, *suspects, Finding("rows", "", 9, "9 rows")))
    more = "and 3 more such remarks, which check-log lists"
    assert log.brief == (bad[0].text, bad[1].text, more, *(f.text for f in suspects))
    assert log.remarks == tuple(f.text for f in (*bad, *suspects))
