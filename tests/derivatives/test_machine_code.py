"""Where compiled code is kept, and when it is compiled anew."""

from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path
from threading import Timer
from typing import Any

import numpy as np
import pytest
from numba.core.caching import FunctionCache

from fusion_sfdia.common import files
from fusion_sfdia.common.files import compiled_code_folder
from fusion_sfdia.derivatives import machine_code
from fusion_sfdia.derivatives.equation import compiled
from fusion_sfdia.derivatives.machine_code import text_hash

LOOP = """
from fusion_sfdia.derivatives.equation import compiled
from laws.parts import SCALE, slowed


@compiled
def advanced(x):
    return SCALE * slowed(x)
"""
PARTS = """
from fusion_sfdia.derivatives.equation import equation

SCALE = 2.0


@equation
def slowed(x):
    return 0.5 * x
"""


@pytest.fixture
def laws(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Write a package of two files below a folder, with changes, and import its compiled loop."""
    monkeypatch.setattr("numba.core.config.CACHE_DIR", "")  # what NUMBA_CACHE_DIR names comes first
    monkeypatch.setattr(machine_code, "compiled_code_folder", lambda: tmp_path / "user cache")

    def loop(folder: str, *changes: tuple[str, str]) -> Any:
        package = tmp_path / folder / "laws"
        package.mkdir(parents=True, exist_ok=True)
        parts = PARTS
        for old, new in changes:
            parts = parts.replace(old, new)
        for name, text in (("__init__", ""), ("loops", LOOP), ("parts", parts)):
            (package / f"{name}.py").write_text(text)
        for name in [n for n in sys.modules if n.split(".")[0] == "laws"]:
            monkeypatch.delitem(sys.modules, name)
        monkeypatch.setattr(sys, "path", [str(tmp_path / folder), *sys.path])
        monkeypatch.setattr(sys, "dont_write_bytecode", True)
        importlib.invalidate_caches()
        text_hash.cache_clear()
        return importlib.import_module("laws.loops").advanced

    yield loop
    for name in [n for n in sys.modules if n.split(".")[0] == "laws"]:
        del sys.modules[name]


def test_another_installation_of_the_same_text_finds_what_is_compiled(laws: Any, tmp_path: Path) -> None:
    first = laws("one")
    assert first(3.0) == 3.0 and not first.stats.cache_hits
    second = laws("another")
    assert second(3.0) == 3.0 and sum(second.stats.cache_hits.values()) == 1
    assert Path(second.stats.cache_path).is_relative_to(tmp_path / "user cache")
    assert not list((tmp_path / "one").rglob("*.nbi")) and not list(tmp_path.rglob("*.lock"))


@pytest.mark.parametrize(("change", "found"), [(("0.5 * x", "0.25 * x"), 1.5), (("SCALE = 2.0", "SCALE = 4.0"), 6.0)])
def test_an_edit_of_another_file_is_noticed(change: tuple[str, str], found: float, laws: Any) -> None:
    before = laws("one")
    assert before(3.0) == 3.0
    after = laws("one", change)
    assert after(3.0) == found and not after.stats.cache_hits
    assert laws("one", change)(3.0) == found


def test_a_function_that_was_typed_in_is_compiled(laws: Any) -> None:
    typed: dict[str, Any] = {"__name__": "typed"}
    exec("def doubled(x):\n    return 2.0 * x", typed)
    assert compiled(typed["doubled"])(1.5) == 3.0


def test_a_checkout_keeps_it_beside_its_modules_and_an_installed_package_in_the_users_cache(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    assert compiled_code_folder() is None
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(files, "__file__", str(tmp_path / "site-packages" / "fusion_sfdia" / "common" / "files.py"))
    folder = compiled_code_folder()
    assert folder is not None and folder.parts[-2:] == ("fusion_sfdia", "compiled")


def test_where_the_users_cache_cannot_be_written_to_it_stands_beside_the_modules(
    laws: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "a file").touch()
    monkeypatch.setattr(machine_code, "compiled_code_folder", lambda: tmp_path / "a file" / "below")
    loop = laws("one")
    assert loop(3.0) == 3.0 and Path(loop.stats.cache_path) == tmp_path / "one" / "laws" / "__pycache__"


def test_code_is_compiled_where_no_folder_can_be_written_to(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fusion_sfdia.derivatives.machine_code._Kept._locator_classes", [])
    assert compiled(lambda x: x + 1.0)(1.0) == 2.0


def test_machine_code_of_modules_that_are_gone_is_compiled_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(*_: object) -> None:
        raise ModuleNotFoundError("No module named 'fusion_sfdia.of_before'")

    monkeypatch.setattr(FunctionCache, "load_overload", gone)
    assert compiled(_summed)(np.arange(4.0)) == 6.0


def test_what_one_process_compiles_another_waits_for(tmp_path: Path) -> None:
    path = str(tmp_path / "one.nbi.lock")
    first = machine_code._locked(path)
    assert first is not None
    timer = Timer(0.05, os.close, (first,))
    timer.start()
    second = machine_code._locked(path)
    timer.join()
    assert second is not None
    os.close(second)


def test_a_lock_that_is_held_for_too_long_is_no_reason_to_wait_on(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(machine_code, "LONGEST_WAIT", 0.02)
    first = machine_code._locked(str(tmp_path / "lock"))
    assert first is not None and machine_code._locked(str(tmp_path / "lock")) is None
    os.close(first)


def _summed(a: np.ndarray) -> float:
    total = 0.0
    for k in range(a.size):
        total += a[k]
    return total
