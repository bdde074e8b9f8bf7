"""Compiling is announced, and a second process takes its part."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numba
import pytest
from numba.core import event

from fusion_sfdia.cli import compiling
from fusion_sfdia.cli.compiling import announced, compile_detector, postponed
from fusion_sfdia.cli.main import detector_of, parser

COMPILED = """
from fusion_sfdia.detectors import registry
from fusion_sfdia.cli.compiling import compile_detector
from fusion_sfdia.plant.linear import linear_plant
from fusion_sfdia.filters import factors, small, sparse, sums
from fusion_sfdia.detectors.kalman_banks import bank_kernels, quiet, window_kernels

def found():
    modules = bank_kernels, window_kernels, quiet, factors, small, sparse, sums
    return {f: f.signatures for m in modules for f in vars(m).values() if hasattr(f, "py_func")}

compile_detector("robust-glr")
before = found()
plant = registry.plant("power-network")
detector = registry.detector("robust-glr", plant)
state = detector.init((), 0.0)
for k in range(2):
    state, _ = detector.step(state, (k + 1) * plant.dt, plant.output(0.0, plant.x0, plant.input_at(0.0)), plant.input_at(0.0))
assert found() == before and sum(map(bool, before.values())) > 4, found()
"""


def test_a_module_of_which_something_is_compiled_is_announced_once(capsys: pytest.CaptureFixture[str]) -> None:
    one, two, other = (numba.njit(lambda x: x + 1), numba.njit(lambda x: x + 2), numba.njit(lambda x: x + 3))
    other.py_func.__module__ = "fusion_sfdia.plant.other"
    with announced():
        assert (one(1), two(1), other(1)) == (2, 3, 4)
    lines = "fusion-sfdia: compiling, once: {}\n"
    assert capsys.readouterr().err == lines.format(__name__) + lines.format("plant.other")
    assert gc.isenabled()
    with announced():
        one(2)
    numba.njit(lambda x: x + 3)(1)  # outside
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("detector", "folder", "cores", "started"), [("a", "x", 2, 1), (None, "x", 2, 0), ("a", None, 2, 0), ("a", "x", 1, 0)]
)
def test_a_second_process_compiles_the_detector_where_both_have_a_cache_and_a_core(
    detector: str | None, folder: str | None, cores: int, started: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[Any] = []
    monkeypatch.setattr(compiling, "start", calls.append)
    monkeypatch.setattr(compiling, "cores", lambda: cores)
    monkeypatch.setattr(compiling, "nothing_compiled", lambda: False)
    compiled = SimpleNamespace(py_func=compile_detector, stats=SimpleNamespace(cache_path=folder))
    with announced(detector):
        for _ in range(2):
            with event.trigger_event("numba:compile", data={"dispatcher": compiled}):
                pass
    assert calls == ["a"] * started


def test_where_nothing_is_compiled_yet_the_second_process_begins_at_once(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    begun: list[str] = []
    monkeypatch.setattr(compiling, "start", begun.append)
    monkeypatch.setattr(compiling, "cores", lambda: 2)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kept"))
    with announced("a"):
        assert begun == ["a"]
    (tmp_path / "kept" / "module").mkdir(parents=True)
    (tmp_path / "kept" / "module" / "one.nbi").touch()
    with announced("a"), announced():
        pass
    assert begun == ["a"]


def test_the_second_process_is_told_the_detector_and_sees_no_modules_of_the_present_folder(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[Any] = []
    monkeypatch.setattr(subprocess, "Popen", lambda arguments, **options: calls.append((arguments, options)))
    compiling.start("it's")
    (program, safe, _, code), options = calls[0]
    assert (program, safe) == (sys.executable, "-P") and 'compile_detector("it\'s")' in code
    assert options["start_new_session"] and "" not in options["env"]["PYTHONPATH"].split(os.pathsep)


def test_what_is_postponed_runs_as_python_and_is_listed_once_in_the_order_of_the_calls() -> None:
    one, two = numba.njit(lambda x: x + 1), numba.njit(lambda x: x + 2)
    with postponed() as wanted:
        assert (two(1), one(1), two(3), two(1.0)) == (3, 2, 5, 3.0)
        assert all(0 <= seconds < 1 for seconds in wanted.values())
        assert not one.signatures and not two.signatures
    assert list(wanted) == [(two, (numba.int64,)), (one, (numba.int64,)), (two, (numba.float64,))]
    for function, signature in reversed(wanted):
        function.compile(signature)
    assert (len(two.signatures), len(one.signatures)) == (2, 1)


def test_what_the_second_process_compiles_is_what_a_large_plant_calls() -> None:
    subprocess.run([sys.executable, "-c", COMPILED], check=True)


def test_a_detector_that_does_not_apply_to_the_stand_in_is_left_to_the_command() -> None:
    subprocess.run([sys.executable, "-c", "from fusion_sfdia.cli import compiling as c; c.compile_detector('uio')"], check=True)


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        (["diagnose", "--plant", "p", "--data", "d"], "robust-glr"),
        (["diagnose", "--plant", "p", "--data", "d", "--detector", "limits"], "limits"),
        (["diagnose", "--plant", "p", "--data", "d", "--detector", "own.py:make"], None),
        (["diagnose", "--plant", "p", "--data", "d", "--tuned", "tuned.toml"], None),
        (["list", "plants"], None),
    ],
)
def test_the_registered_detector_that_a_command_runs(arguments: list[str], name: str | None) -> None:
    assert detector_of(parser().parse_args(arguments)) == name
