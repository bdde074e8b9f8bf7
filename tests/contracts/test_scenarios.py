"""Every registered scenario runs at its smallest size to rows and figures, with the same bits in one process and in two."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from smallest_scenarios import SMALLEST, smallest

from fusion_sfdia.evaluation.results import read_rows, write_rows
from fusion_sfdia.experiments.parts import read_part, write_part
from fusion_sfdia.experiments.workers import Piece, work_off
from fusion_sfdia.registry import GROUPS, SCENARIOS, detectors, scenario
from fusion_sfdia.report.plots import style

NAMES = [name for name in SCENARIOS if name != "comparison"]  # has tests of its own
PLANTS = {"pipeline": "gas-pipeline", "engine": "marine-engine", "network": "power-network"}
VARIANTS = {"ekf", "ukf", "enkf", "chebyshev:corrected"}  # in rows, but not in `list detectors`: single filters, a mode
TIMED = ("network/scale",)  # measures time, which no second run repeats

pytestmark = pytest.mark.slow


def test_the_smallest_sizes_are_of_registered_scenarios() -> None:
    assert set(SMALLEST) <= set(NAMES) and {name.partition("/")[0] for name in NAMES} == set(GROUPS) == set(PLANTS)


@pytest.mark.parametrize("name", NAMES)
def test_rows_have_the_vocabulary_of_the_columns(name: str, tmp_path: Path) -> None:
    rows = smallest(name).summary.rows
    assert rows
    keys = [(r.detector, r.fault, r.quantity, r.condition, r.metric) for r in rows]
    assert len(set(keys)) == len(keys)
    for r in rows:
        assert (r.scenario, r.plant) == (name, PLANTS[name.partition("/")[0]])
        assert r.detector in {*detectors(), *VARIANTS} and r.fault and r.quantity, r
        assert re.fullmatch(r"[a-z0-9_]+", r.metric), r
        assert np.isnan(r.low) or r.low <= r.value <= r.high, r
        assert not r.metric.endswith("performance_percent") or np.isnan(r.value) or 0 <= r.value <= 100
    write_rows(tmp_path / "metrics.csv", rows)
    assert len(read_rows(tmp_path / "metrics.csv")) == len(rows)


@pytest.mark.parametrize("name", NAMES)
def test_figures_draw_and_texts_have_their_numbers(name: str) -> None:
    found = smallest(name).summary
    assert found.figures and (found.remarks or found.highlights)
    for figure in found.every_figure:
        with style():
            assert figure.draw().axes
        assert figure.title and figure.caption and figure.alt
    for table in found.tables:
        assert table.rows and {len(row) for row in table.rows} == {len(table.header)}
    assert not [text for text in (*found.highlights, *found.remarks) if re.search(r"\bnan\b", text)]


@pytest.mark.parametrize("name", [name for name in NAMES if name not in TIMED])
def test_tasks_have_the_same_bits_in_one_process_and_in_two(name: str, tmp_path: Path) -> None:
    """The first and the last task alone in processes of their own: their bits do not depend on what ran before them."""
    results = smallest(name).results
    work = scenario(name).work
    ends = {0: results[0], len(results) - 1: results[-1]}
    pieces = [Piece(tmp_path / f"{k}.npz", work, task) for k, (task, _) in ends.items()]
    assert [done.error for done in work_off(pieces, 2)] == [None] * len(pieces)
    for k, (_, arrays) in ends.items():
        write_part(tmp_path / "here.npz", arrays)
        here, there = read_part(tmp_path / "here.npz"), read_part(tmp_path / f"{k}.npz")
        assert here is not None and there is not None and here.keys() == there.keys()
        for key, array in here.items():
            assert array.tobytes() == there[key].tobytes() and array.dtype == there[key].dtype, key
