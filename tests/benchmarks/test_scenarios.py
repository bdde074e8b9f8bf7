"""Every registered scenario runs at its smallest size to rows and figures, with the same bits in another process."""

from __future__ import annotations

import re
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
from smallest_scenarios import RECORDED, SMALLEST, smallest

from fusion_sfdia.detectors.registry import detectors
from fusion_sfdia.report.content import Summary
from fusion_sfdia.report.plots import style
from fusion_sfdia.report.results import read_rows, write_rows
from fusion_sfdia.study.experiments.scenario import Arrays, Task
from fusion_sfdia.study.experiments.workers import timed
from fusion_sfdia.study.scenarios import GROUPS, SCENARIOS, scenario

NAMES = [name for name in SCENARIOS if name not in ("comparison", "robustness", "acceptance")]  # they have tests of their own
PLANTS = {
    "pipeline": "gas-pipeline", "engine": "marine-engine", "network": "power-network", "chemical": "tennessee-eastman",
}  # fmt: skip
VARIANTS = {
    "ekf",
    "ukf",
    "enkf",
    "chebyshev:corrected",
    "robust-glr:areas",
}  # in rows, but not in `list detectors`: filters, modes
TIMED = ("network/scale",)  # measures time, which no second run repeats
LONG = (  # ten seconds or more each
    "chemical/monitored", "chemical/recorded", "engine/minimum-fault", "engine/process", "engine/three-faults",
    "engine/virtual-sensors", "pipeline/accommodation", "pipeline/accuracy", "pipeline/isolation",
)  # fmt: skip

pytestmark = pytest.mark.slow


def test_the_smallest_sizes_are_of_registered_scenarios() -> None:
    assert set(SMALLEST) <= set(NAMES) and {name.partition("/")[0] for name in NAMES} == set(GROUPS) == set(PLANTS)


@pytest.fixture(scope="module")
def other() -> Iterator[ProcessPoolExecutor]:
    """Another process, begun afresh and not forked."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
        yield process


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.long] if n in LONG else []) for n in NAMES])
def test_a_scenario_runs_to_its_rows_and_figures_with_the_same_bits_in_another_process(
    name: str, other: ProcessPoolExecutor, tmp_path: Path
) -> None:
    """One test a scenario, so that each runs once, however the tests are shared out."""
    if name.startswith("chemical/") and not RECORDED.is_dir():
        pytest.skip("needs the published data sets in ../shared/fixtures, next to the checkout")
    results, summary = smallest(name)
    check_rows(name, summary, tmp_path)
    check_figures(summary)
    if name not in TIMED:
        check_bits(name, results, other)


def check_rows(name: str, summary: Summary, folder: Path) -> None:
    """Each row once, in the vocabulary of its columns, with its value within its interval."""
    rows = summary.rows
    keys = [(r.detector, r.fault, r.quantity, r.condition, r.metric) for r in rows]
    assert rows and len(set(keys)) == len(keys)
    for r in rows:
        assert (r.scenario, r.plant) == (name, PLANTS[name.partition("/")[0]])
        assert r.detector in {*detectors(), *VARIANTS} and r.fault and r.quantity, r
        assert re.fullmatch(r"[a-z0-9_]+", r.metric), r
        assert np.isnan(r.low) or r.low <= r.value <= r.high, r
        assert not r.metric.endswith("performance_percent") or np.isnan(r.value) or 0 <= r.value <= 100
    write_rows(folder / "metrics.csv", rows)
    assert len(read_rows(folder / "metrics.csv")) == len(rows)


def check_figures(summary: Summary) -> None:
    """Figures draw and have an alternative text, tables are rectangular, sentences have their numbers."""
    assert summary.every_figure and (summary.remarks or summary.highlights)
    for figure in summary.every_figure:
        with style():
            assert figure.draw().axes
        assert figure.title and figure.caption and figure.alt
    for table in summary.tables:
        assert table.rows and {len(row) for row in table.rows} == {len(table.header)}
    assert not [text for text in (*summary.highlights, *summary.remarks) if re.search(r"\bnan\b", text)]


def check_bits(name: str, results: list[tuple[Task, Arrays]], other: ProcessPoolExecutor) -> None:
    """The last task, which ran here after all others, alone in another process: its bits do not depend on what ran before it.

    The first ran here alone; that the bits are those of another process is seen by the last.
    """
    task, here = results[-1]
    there, _, error = other.submit(timed, scenario(name).work, task).result()
    assert error is None and here.keys() == there.keys()
    for key, array in here.items():
        assert array.tobytes() == there[key].tobytes() and array.dtype == there[key].dtype, key
