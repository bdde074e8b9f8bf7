"""The notebooks run from top to bottom and give the committed outputs."""

import re
from decimal import Decimal
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from nbformat import NotebookNode

NOTEBOOKS = sorted((Path(__file__).resolve().parents[2] / "notebooks").glob("*.ipynb"))
MOST_BYTES = 400_000  # a code host shows it at once, and a new version does not weigh on the repository
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
LINK = re.compile(r"\]\(([^)#:]+)[^):]*\)")  # not to an address on the web
MACHINE_PATH = re.compile(r"(?<![\w.:/])/(?:home|root|tmp|usr|opt|var|mnt|srv|work|Users|private)/|\b[A-Z]:\\\\")

each = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def code(notebook: NotebookNode) -> list[NotebookNode]:
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def pictures(cell: NotebookNode) -> list[NotebookNode]:
    return [o for o in cell.outputs if "image/png" in o.get("data", {})]


def printed(cell: NotebookNode) -> str:
    """The text output of a cell, without pictures; that of a cell tagged `varies` (times on this machine) is not compared."""
    if "varies" in cell.metadata.get("tags", []):
        return ""
    texts = [o for o in cell.outputs if o not in pictures(cell)]
    return "".join(o.text if o.output_type == "stream" else o.get("data", {}).get("text/plain", "") for o in texts)


def same(a: str, b: str) -> bool:
    """Whether two texts agree, figures after the point up to one in the last place: another processor adds up
    in another order, and a sum near the edge of two roundings may round to either.
    """
    if " ".join(NUMBER.sub("#", a).split()) != " ".join(NUMBER.sub("#", b).split()):
        return False
    for one, other in zip(map(Decimal, NUMBER.findall(a)), map(Decimal, NUMBER.findall(b)), strict=True):
        last = Decimal(1).scaleb(max(int(x.as_tuple().exponent) for x in (one, other)))
        if abs(one - other) > (last if last < 1 else 0):
            return False
    return True


def test_what_counts_as_the_same() -> None:
    assert same("area 0.97 [0.96, 9.9e-03]\n", "area  0.98 [0.96, 1.0e-02]")
    assert not same("area 0.97", "area 0.99")
    assert not same("3 runs", "4 runs")
    assert not same("3 runs", "3 runs, 1 diverged")


def test_there_are_notebooks() -> None:
    assert NOTEBOOKS


@each
def test_a_committed_notebook_is_small_and_portable(path: Path) -> None:
    assert path.stat().st_size < MOST_BYTES
    assert not MACHINE_PATH.findall(path.read_text(encoding="utf-8"))
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert notebook.metadata.kernelspec.name == "python3"
    cells = code(notebook)
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))  # as run, from top to bottom
    assert not [o for cell in cells for o in cell.outputs if o.output_type == "error" or o.get("name") == "stderr"]
    assert any(pictures(cell) for cell in cells)


@each
def test_its_links_lead_to_files(path: Path) -> None:
    cells = nbformat.read(path, as_version=4).cells
    links = [link for cell in cells if cell.cell_type == "markdown" for link in LINK.findall(cell.source)]
    assert not [link for link in links if not (path.parent / link).is_file()]


@pytest.mark.long
@each
def test_a_fresh_kernel_gives_the_committed_outputs(path: Path) -> None:
    committed = nbformat.read(path, as_version=4)
    fresh = nbformat.from_dict(committed)
    place = {"metadata": {"path": str(path.parent)}}
    NotebookClient(fresh, timeout=600, kernel_name="python3", resources=place).execute()
    for before, now in zip(code(committed), code(fresh), strict=True):
        assert not [o for o in now.outputs if o.get("name") == "stderr"], now.outputs
        assert len(pictures(before)) == len(pictures(now)), before.source
        assert same(printed(before), printed(now)), f"committed:\n{printed(before)}\nnow:\n{printed(now)}\nrun `make notebooks`"
