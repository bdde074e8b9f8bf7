"""Pieces of work on a dask cluster: the bytes of a run on this machine, though a worker is killed on the way."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from toy_scenario import TOY

from fusion_sfdia.benchmarks import parts
from fusion_sfdia.benchmarks.runner import run_scenarios
from fusion_sfdia.benchmarks.scenario import Arrays, Task
from fusion_sfdia.cli import main

distributed = pytest.importorskip("distributed", reason="needs the optional package distributed")


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join([str(Path(__file__).parent), str(Path(__file__).parents[1])]))
        with distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address="127.0.0.1:0"
        ) as running:
            yield running


def killed_once(task: Task) -> Arrays:
    """The toy's work in a process that is killed when it first gets to the last piece."""
    flag = Path(task["trap"])
    if task["detector"] == "b" and flag.exists():
        flag.unlink()
        os.kill(os.getpid(), signal.SIGKILL)
    return TOY.work(task)


def parts_of(out: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in (out / "parts").glob("*.npz")}


def test_a_worker_that_is_killed_costs_nothing(tmp_path: Path, cluster: Any) -> None:
    flag = tmp_path / "trap"
    scenario = replace(TOY, work=killed_once)
    changes = {"figure": "no", "trap": str(flag)}
    here = run_scenarios([scenario], tmp_path / "here", changes=changes, workers=1)
    flag.touch()
    there = run_scenarios([scenario], tmp_path / "there", changes=changes, scheduler=cluster.scheduler_address)
    assert not flag.exists() and not here.failures and not there.failures
    assert (tmp_path / "here" / "metrics.csv").read_bytes() == (tmp_path / "there" / "metrics.csv").read_bytes()
    assert len(parts_of(tmp_path / "here")) == 6 and parts_of(tmp_path / "here") == parts_of(tmp_path / "there")


def test_work_that_fails_on_a_worker_is_told(tmp_path: Path, cluster: Any) -> None:
    (tmp_path / "trap").write_text("fail")
    changes = {"figure": "no", "trap": str(tmp_path / "trap")}
    outcome = run_scenarios([TOY], tmp_path / "out", changes=changes, scheduler=cluster.scheduler_address)
    assert len(outcome.failures) == 3 and all("ArithmeticError" in line for line in outcome.failures)


def test_workers_with_other_code_are_refused(tmp_path: Path, cluster: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parts, "sources_digest", lambda: "other")
    with pytest.raises(ValueError, match=r"worker tcp://.* has other sources than this process; install the same"):
        run_scenarios([TOY], tmp_path, changes={"figure": "no"}, scheduler=cluster.scheduler_address)


def test_what_is_no_cluster_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ValueError, match="workers and a scheduler's address; wanted one of them"):
        run_scenarios([TOY], tmp_path, workers=2, scheduler="tcp://127.0.0.1:1")
    for address, message in (
        ("nowhere:x", "is no address of a dask scheduler"),
        ("tcp://127.0.0.1:1", "no dask scheduler answers"),
    ):
        assert main(["run", "pipeline/units", "--out", str(tmp_path / "o"), "--scheduler", address]) == 2
        told = capsys.readouterr().err
        assert message in told and len(told.splitlines()) == 1
