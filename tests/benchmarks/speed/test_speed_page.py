"""The page of speed is that of its numbers, and its exponents and references are right."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

import pytest

from fusion_sfdia.benchmarks.speed.support.calls import Timed, time_row, timed_rows
from fusion_sfdia.report.results import write_rows


@pytest.fixture
def speed(root: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(root / "docs" / "results"))
    return importlib.import_module("speed")


def test_the_page_of_speed_is_that_of_its_numbers(speed: ModuleType) -> None:
    rows = speed.load([speed.NUMBERS])
    assert speed.render(rows) == speed.PAGE.read_text(encoding="utf-8")
    assert speed.FIGURE.name in speed.PAGE.read_text(encoding="utf-8") and speed.FIGURE.stat().st_size < 100_000


def test_of_several_runs_the_first_counts(speed: ModuleType, tmp_path: Path) -> None:
    for k, value in enumerate((1.23456, 2.0)):
        write_rows(tmp_path / f"{k}.csv", [time_row("toy", "-", "none", "all", "step_time", value, 3)])
    (row,) = speed.load([tmp_path / "0.csv", tmp_path / "1.csv"])
    assert row.value == 1.23


def test_the_exponent_of_a_power(speed: ModuleType) -> None:
    assert speed.exponents([(n, 3e-6 * n**2) for n in (5, 50, 500)]) == "2.00; 2.00 from 50 to 500"
    assert speed.exponents([(1, 1.0), (10, 1.0), (100, 100.0)]) == "1.00; 2.00 from 10 to 100"


def test_a_time_stands_beside_the_ratios_of_its_condition(speed: ModuleType) -> None:
    rows = [
        *timed_rows("stream", "p", "d", "all", Timed(2e-3, 3, 1e-3, 0.0, "copy")),
        *timed_rows("stream", "p", "d", "all", Timed(2e-3, 3, 5e-4, 0.0, "step"))[1:],
        *timed_rows("stream", "p", "d", "all", Timed(3e-6, 3, 1e-6, 0.0, "copy"), condition="x, y"),
    ]
    assert speed.times(rows).splitlines()[2:] == [
        "| stream | p | d | all | 2 ms | 2 [2, 2] copy; 4 [4, 4] step |",
        "| stream | p | d | all, x, y | 3 us | 3 [3, 3] copy |",
    ]


def test_units_of_a_time(speed: ModuleType) -> None:
    assert [speed.seconds(v) for v in (12.0, 1.0, 0.5, 2.5e-4, 3e-9, 4e-10)] == [
        "12 s",
        "1 s",
        "500 ms",
        "250 us",
        "3 ns",
        "0.4 ns",
    ]
