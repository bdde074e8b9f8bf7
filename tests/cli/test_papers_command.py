"""`papers` runs the scenarios that have numbers of a paper beside their own."""

from __future__ import annotations

from pathlib import Path

import pytest

from fusion_sfdia.cli.main import main
from fusion_sfdia.cli.papers import PAPERS
from fusion_sfdia.report.results import read_rows
from fusion_sfdia.study.scenarios import SCENARIOS, scenario


def test_every_paper_has_scenarios_and_every_scenario_known_papers() -> None:
    found = {paper for name in SCENARIOS for paper in scenario(name).papers}
    assert found == set(PAPERS)


@pytest.mark.slow
def test_the_numbers_of_a_paper_are_beside_ours(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    command = ["papers", "--paper", "kougiatsos2022", "--seeds", "1", "--set", "detectors=adaptive-threshold", "--workers", "1"]
    assert main([*command, "--out", str(out)]) == 0
    rows = read_rows(out / "published.csv")
    assert {r.scenario for r in rows} == {"engine/signatures", "engine/two-faults"}
    assert all(r.published is not None for r in rows)
    assert {r.quantity: r.published for r in rows}["M(3,1)"] == 10.0
    assert f"{len(rows)} rows with a published number" in capsys.readouterr().out
