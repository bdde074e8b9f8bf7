"""Damaged files: one bad row costs itself and is counted, and no number is read that the log does not hold."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
from damaged_logs import DT, clean, damaged, misread
from realistic_logs import vessel

from fusion_sfdia.logs.log_map import PLAIN_MAP, UNTIL_THE_SAMPLE, LogMap
from fusion_sfdia.logs.reading import load_log
from fusion_sfdia.plant.signals import Signal

WHOLE = vessel()
# in the numbers of the file
PLANT = replace(WHOLE, inputs=(Signal("feed", "m3/s", 7.2),))
MAP = LogMap(duplicates="last", inputs=UNTIL_THE_SAMPLE)


def check(seeds: range, folder: Path) -> Counter[str]:
    kinds: Counter[str] = Counter()
    values = {}
    for seed in seeds:
        data, form = damaged(seed)
        path = folder / "log.csv"
        path.write_bytes(data)
        if form not in values:
            values[form] = clean(form)[1]
        try:
            found = load_log(path, PLANT, PLAIN_MAP if seed % 3 == 0 else MAP)
        except ValueError as error:
            kinds["refused"] += 1
            assert str(path) in str(error), f"seed {seed}: {error}"
            continue
        wrong = misread(found, values[form])
        assert not wrong, f"seed {seed}: {wrong}"
        lost = round((found.log.t[-1] - found.log.t[0]) / DT) + 1 - len(found.log.t)
        assert not lost or found.remarks, f"seed {seed}: {lost} rows lost without a finding"
        kinds["read"] += 1
    return kinds


def test_damaged_logs(tmp_path: Path) -> None:
    kinds = check(range(200), tmp_path)
    assert kinds["read"] > 150, kinds


@pytest.mark.slow
def test_two_thousand_damaged_logs(tmp_path: Path) -> None:
    kinds = check(range(1000, 3000), tmp_path)
    assert kinds["read"] > 1800, kinds
