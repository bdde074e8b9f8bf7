"""`papers` runs the scenarios that have numbers of a paper beside their own."""

from __future__ import annotations

from pathlib import Path

import pytest

from fusion_sfdia.cli.main import main
from fusion_sfdia.cli.papers import PAPERS, RULE
from fusion_sfdia.report.results import read_rows
from fusion_sfdia.study import published_numbers
from fusion_sfdia.study.experiments.runner import RunOutcome
from fusion_sfdia.study.scenarios import SCENARIOS, scenario


def test_every_paper_has_scenarios_and_every_scenario_known_papers() -> None:
    found = {paper for name in SCENARIOS for paper in scenario(name).papers}
    assert found == set(PAPERS)
    assert (PAPERS, RULE) == (tuple(published_numbers.PAPERS), published_numbers.RULE)


def test_the_page_of_a_run_is_that_of_the_documentation(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, root: Path
) -> None:
    """Given the numbers of the documentation, the command writes its page but for the sentence of links, and its figures."""
    docs = root / "docs" / "results"
    rows = read_rows(docs / published_numbers.NUMBERS)
    monkeypatch.setattr(
        "fusion_sfdia.study.experiments.runner.run_scenarios", lambda *_, **__: RunOutcome(rows, [], [], Path("report.html"))
    )
    assert main(["papers", "--out", str(tmp_path / "all")]) == 0
    made, known = ((folder / published_numbers.PAGE).read_text(encoding="utf-8") for folder in (tmp_path / "all", docs))
    (own, of_docs), (rest, docs_rest) = zip(*(page.split("\n\n|", 1) for page in (made, known)), strict=True)
    assert rest == docs_rest and of_docs.startswith(own.rstrip()) and "](" not in own
    written, committed = ((folder / published_numbers.NUMBERS).read_bytes() for folder in (tmp_path / "all", docs))
    assert written == committed
    found = published_numbers.counts(published_numbers.values_of(rows))
    shown = capsys.readouterr().out.splitlines()[-1]
    assert f"by default {found.by_default}, by some reading {found.by_some}; " in shown and shown.endswith("published.md")
    assert f"with a reason {found.explained}, unexplained {found.unexplained}:" in shown

    assert main(["papers", "--paper", "virtual2022", "--out", str(tmp_path / "one")]) == 0
    assert sorted(p.name for p in (tmp_path / "one").iterdir()) == [
        "published-virtual2022.svg",
        "published.csv",
        "published.md",
    ]


@pytest.mark.slow
def test_the_numbers_of_a_paper_are_beside_ours(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    command = ["papers", "--paper", "kougiatsos2022", "--seeds", "1", "--set", "detectors=adaptive-threshold", "--workers", "1"]
    assert main([*command, "--out", str(out)]) == 0
    rows = read_rows(out / "published.csv")
    assert {r.scenario for r in rows} == {"engine/signatures", "engine/two-faults"}
    assert all(r.published is not None for r in rows)
    assert {r.quantity: r.published for r in rows}["M(3,1)"] == 10.0
    assert f"{len(published_numbers.values_of(rows))} published numbers: met as read" in capsys.readouterr().out
    page = (out / "published.md").read_text(encoding="utf-8")
    assert (
        "From `engine/two-faults`, n 1." in page and "![Ours over" in page and (out / "published-kougiatsos2022.svg").exists()
    )
