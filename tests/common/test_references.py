"""Objects named by a text: in a module, or in a file that is on no import path."""

from __future__ import annotations

import math
import pickle
import sys
from pathlib import Path

import pytest

from fusion_sfdia.common.references import is_reference, load


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("math:tau", True),
        ("os.path:join", True),
        ("here/my tank.py:make", True),
        ("tank.py:Tank.make", True),
        ("tank.py", False),
        ("chebyshev:paper", True),
        ("adaptive-threshold:paper", False),
        ("a/b:c", False),
        ("math:", False),
    ],
)
def test_what_is_a_reference(text: str, expected: bool) -> None:
    assert is_reference(text) is expected


def test_an_attribute_of_a_module() -> None:
    assert load("math:tau") == math.tau
    assert load("pathlib:Path.exists") is Path.exists


def test_a_file_is_imported_once_and_again_where_it_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "tank.py").write_text("class Tank:\n    size = 1\n")
    monkeypatch.chdir(tmp_path)
    first = load("tank.py:Tank")
    assert first.size == 1 and load(f"{tmp_path}/tank.py:Tank") is first
    assert type(pickle.loads(pickle.dumps(first()))) is first
    (tmp_path / "tank.py").write_text("class Tank:\n    size = 2\n")
    assert load("tank.py:Tank").size == 2


def test_a_file_imports_what_is_beside_it(tmp_path: Path) -> None:
    (tmp_path / "beside_the_tank.py").write_text("SIZE = 3\n")
    (tmp_path / "tank.py").write_text("import beside_the_tank\n\nsize = beside_the_tank.SIZE\n")
    before = [*sys.path]
    assert load(f"{tmp_path}/tank.py:size") == 3 and sys.path == before


def test_files_of_one_name_are_two_modules(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "math.py").write_text(f"tau = {folder!r}\n")
    assert [load(f"{tmp_path}/{folder}/math.py:tau") for folder in ("a", "b")] == ["a", "b"]
    assert load("math:tau") == math.tau


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("math", "'math' names no object; expected module:attribute or path/file.py:attribute"),
        ("no_such.module:x", "there is no module no_such.module; install the package that has it, or name its file"),
        ("math:tao", r"math:tao: math has no attribute 'tao'; did you mean 'tau'\? it has .*sin"),
        ("absent.py:x", r"absent.py cannot be read \(No such file or directory\); expected a Python file"),
        ("broken.py:x", r"broken.py fails while it is imported: SyntaxError: .*; correct it"),
        ("needy.py:x", "needy.py fails while it is imported: ModuleNotFoundError: No module named 'no_such'"),
        ("needy:x", "module needy fails while it is imported: ModuleNotFoundError: No module named 'no_such'; install what"),
    ],
)
def test_an_error_names_what_cannot_be_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reference: str, message: str
) -> None:
    (tmp_path / "broken.py").write_text("x = (\n")
    (tmp_path / "needy.py").write_text("import no_such\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ValueError, match=message):
        load(reference)


def test_an_unknown_attribute_is_answered_by_functions_and_plants_only(tmp_path: Path) -> None:
    (tmp_path / "tank.py").write_text(
        "import math\nfrom toy_plants import tanks\nfrom fusion_sfdia import Signal\n"
        "SIZE = 1\nPLANT = tanks()\nclass Mine:\n    pass\ndef make():\n    return PLANT\n"
    )
    with pytest.raises(ValueError, match=r"no attribute 'mak'; did you mean 'make'\? it has tanks, PLANT, Mine, make$"):
        load(f"{tmp_path}/tank.py:mak")
