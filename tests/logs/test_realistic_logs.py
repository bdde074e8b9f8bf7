"""Forty logs as they are exported: the same readings from all that state them, and a clear line for the others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from realistic_logs import Case, realistic_logs, vessel

from fusion_sfdia.logs.check import check_log, without_suspects

PLANT = vessel()


@pytest.fixture(scope="module")
def cases(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Case]:
    return realistic_logs(tmp_path_factory.mktemp("realistic"))


def outcome(case: Case, folder: Path) -> str:
    """ "read" where the readings are right; the words of what was suspected or refused; "misread"."""
    path = None
    if case.map is not None:
        path = folder / "map.toml"
        path.write_text(case.map, encoding="utf-8")
    try:
        found = check_log(case.source, PLANT, path, **case.options)
    except ValueError as error:
        return str(error)
    assert case.expected is not None
    for mine, expected, tolerance in zip(found.log, case.expected, (1e-6, 0.0, 0.0), strict=True):  # times to a microsecond
        # factors of units and offsets round, a few eps of the largest value
        if mine.shape != expected.shape or not np.allclose(mine, expected, rtol=1e-14, atol=tolerance, equal_nan=True):
            return "misread"
    return next((f.text for f in found.findings if f.kind == "unit suspected"), "read")


def test_forty_realistic_logs(cases: dict[str, Case], tmp_path: Path) -> None:
    found = {name: outcome(case, tmp_path) for name, case in cases.items()}
    for name, case in cases.items():
        assert (found[name] == "read") if case.outcome == "read" else (case.outcome in found[name]), f"{name}: {found[name]}"
    assert len(found) == 40
    assert sum(text == "read" for text in found.values()) == 37


def test_a_sensor_of_a_suspected_unit_is_no_fault(cases: dict[str, Case]) -> None:
    found = check_log(cases["unit not stated"].source, PLANT)
    assert found.suspects == ("PT101",)
    kept = without_suspects(PLANT, found).log.y
    assert np.isnan(kept[:, 1]).all() and np.array_equal(kept[:, [0, 2]], found.log.y[:, [0, 2]])


def test_wall_clock_over_a_change_of_clocks(cases: dict[str, Case], tmp_path: Path) -> None:
    (tmp_path / "map.toml").write_text(cases["clocks go back"].map or "")
    found = check_log(cases["clocks go back"].source, PLANT, tmp_path / "map.toml")
    at = [found.clock.at(60.0 * k) for k in (0, 149, 150)]
    assert at == ["2024-10-27 00:30:00+02:00", "2024-10-27 02:59:00+02:00", "2024-10-27 02:00:00+01:00"]
