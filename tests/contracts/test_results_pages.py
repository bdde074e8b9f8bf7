"""The results pages, and the README's table, agree with the committed numbers; links lead somewhere."""

import csv
import importlib
import re
from pathlib import Path
from types import ModuleType

import pytest

from fusion_sfdia.report.results import read_rows
from fusion_sfdia.study import published_numbers as published


@pytest.fixture
def folder(root: Path) -> Path:
    return root / "docs" / "results"


@pytest.fixture
def pages(folder: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(folder))
    return importlib.import_module("pages")


def test_the_comparisons_page_is_that_of_its_numbers(folder: Path, pages: ModuleType) -> None:
    comparison = pages.comparison
    assert comparison.render(comparison.load(folder / "comparison.csv")) == (folder / "comparison.md").read_text(
        encoding="utf-8"
    )
    losses = comparison.losses_of(comparison.load(folder / "comparison.csv"))
    assert (folder / "loss.svg").read_text(encoding="utf-8").endswith(comparison.mark(losses)), "run docs/results/comparison.py"


def test_every_table_of_a_page_is_that_of_its_numbers(root: Path, pages: ModuleType) -> None:
    found, used = pages.tables(), set()
    for path in pages.PAGES:
        text = path.read_text(encoding="utf-8")
        used |= {m[2] for m in pages.MARKED.finditer(text)}
        assert pages.filled(text, found) == text, f"{path.relative_to(root)}: run docs/results/pages.py"
    assert used == set(found)


def test_the_page_of_the_kinds_of_faults_is_that_of_its_numbers(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """At least as many are named rightly as the test of a few of them assumes, see tests/study/test_kind_trials.py."""
    monkeypatch.syspath_prepend(str(folder))
    kinds = importlib.import_module("fault_kinds")
    rows = kinds.load()
    assert kinds.render(rows) == (folder / "fault-kinds.md").read_text(encoding="utf-8")
    assert sum(int(row["count"]) for row in rows) == 4 * 6 * len(kinds.SEEDS)
    lost = [row for row in rows if row["named"] == "not found"]
    assert {(row["detector"], row["fault"]) for row in lost} <= {("robust-glr", "spikes")}  # which come one by one
    found = [row for row in rows if row not in lost]
    right = [int(row["count"]) for row in found if row["fault"] == row["named"]]
    assert sum(right) >= 0.95 * sum(int(row["count"]) for row in found)


def test_the_page_of_recorded_logs_is_that_of_its_numbers(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(folder))
    measured, page = (importlib.import_module(name) for name in ("real_logs", "real_logs_page"))
    cells = measured.load()
    assert page.render(cells) == (folder / "real-logs.md").read_text(encoding="utf-8"), "run docs/results/real_logs.py"
    for of in page.with_events(cells):
        for method in page.methods_in(cells, of):
            assert sum(cells[of, method, page.ALL, what] for what in page.SHARES[1:]) <= 1 + 5e-4  # four digits are kept


def test_no_number_of_the_papers_has_the_place_of_another(folder: Path) -> None:
    with (folder / "papers.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    places = [(row["page"], row["table"], row["row"], row["column"]) for row in rows]
    assert len(set(places)) == len(places) > 90
    assert all(row["value"] for row in rows) and "published" not in rows[0]  # what is published is in published.csv alone
    assert all(bool(row["low"]) == bool(row["high"]) for row in rows)


def test_a_table_that_no_number_makes_is_refused(pages: ModuleType) -> None:
    with pytest.raises(KeyError, match="unheard"):
        pages.filled("<!-- table: unheard -->\n\n| a |\n\n<!-- end -->", pages.tables())


def test_links_of_the_documentation_lead_somewhere(root: Path) -> None:
    for page in (root / "docs").rglob("*.md"):
        text = page.read_text(encoding="utf-8")
        for target, anchor in re.findall(r"\]\(([^)#\s]*)(#[\w-]+)?\)", text):
            if target.startswith("https://"):
                continue
            there = page.parent / target if target else page
            assert there.exists(), f"{page.relative_to(root)}: {target}"
            if anchor:
                titles = re.findall(r"^#+ (.*)$", there.read_text(encoding="utf-8"), re.MULTILINE)
                assert anchor[1:] in {re.sub(r"[^\w -]", "", title).lower().replace(" ", "-") for title in titles}, anchor


def test_the_page_of_published_numbers_is_that_of_its_numbers(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each number stands once, every reason is used, and a value is met only where its interval, not its width, says so."""
    monkeypatch.syspath_prepend(str(folder))
    see = importlib.import_module("published").SEE
    rows = read_rows(folder / published.NUMBERS)
    assert [r.columns for r in published.stated(rows)] == [r.columns for r in rows]  # rounded, each once
    values = published.values_of(rows)
    assert published.render(values, see) == (folder / published.PAGE).read_text(encoding="utf-8"), (
        "run docs/results/published.py"
    )
    assert {f"published-{v.paper}.svg" for v in values} == {p.name for p in folder.glob("published-*.svg")}
    assert len({(v.paper, v.source, v.what) for v in values}) == len(values) > 200
    known = published.reasons()
    given = {published.reason_of(v, known) for v in values if not v.met_by}
    assert {why for _, _, why in known} <= given | {published.UNEXPLAINED}
    for v in values:
        for name in v.met_by:
            own = v.ours[name]
            bound = v.source.endswith(", at most")  # an upper bound, met unless ours is shown to exceed it
            within = own.low <= v.published and (bound or (v.published <= own.high and v.near))
            assert within or own.value == pytest.approx(v.published, rel=5e-3)


def test_every_item_of_the_papers_leads_to_code_and_tests(root: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every equation and published number is an item; what is said to be done has code, and a test or numbers that show it."""
    monkeypatch.syspath_prepend(str(folder))
    items = importlib.import_module("paper_items")
    papers = items.load()
    assert items.render(papers) == items.PAGE.read_text(encoding="utf-8"), "run docs/results/paper_items.py"
    sources = {row.source for row in read_rows(folder / published.NUMBERS)}
    assert {source for paper in papers for one in paper.items for source in one.numbers} == sources
    text: dict[str, str] = {}
    for paper in papers:
        assert set(range(1, paper.equations + 1)) <= items.numbered(paper.items), paper.key
        for one in paper.items:
            assert one.kind in items.KINDS and one.outcome in items.OUTCOMES, one
            assert one.note or one.outcome in items.SAID, one
            assert one.test or one.numbers or one.outcome not in ("as printed", "met", "corrected"), one
            for place in (*one.code, *one.test):
                path, _, name = place.partition(":")
                found = text.setdefault(path, (root / path).read_text(encoding="utf-8"))
                last = re.escape(name.rpartition(".")[2])
                assert re.search(rf"(def|class) {last}\b|^ *([\w, ]+, )?{last}\b.*[=:]", found, re.MULTILINE), one


def test_the_picture_of_the_choices_is_of_the_numbers(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(folder))
    figure = importlib.import_module("choices_figure")
    numbers = figure.numbers(figure.comparison.load(folder / "comparison.csv"))
    assert figure.FILE.read_text(encoding="utf-8").endswith(figure.comparison.mark(numbers)), (
        "run docs/results/choices_figure.py"
    )
