"""Pieces of work on a dask cluster: the bytes of a run on this machine, although a worker is killed meanwhile."""

from __future__ import annotations

import json
import logging
import os
import signal
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from toy_scenario import TOY

from fusion_sfdia.cli.main import main
from fusion_sfdia.study.comparison.compare import CHUNK
from fusion_sfdia.study.experiments import cluster as on_cluster
from fusion_sfdia.study.experiments import parts, provenance
from fusion_sfdia.study.experiments.cluster import connected
from fusion_sfdia.study.experiments.runner import run_scenarios
from fusion_sfdia.study.experiments.scenario import Arrays, Task
from fusion_sfdia.study.experiments.workers import Piece

distributed = pytest.importorskip("distributed", reason="needs the optional package distributed")

LOCAL = {"host": "127.0.0.1", "protocol": "tcp", "dashboard_address": "127.0.0.1:0"}


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(
            "PYTHONPATH",
            os.pathsep.join(
                map(str, (Path(__file__).parent, Path(__file__).parents[2] / "helpers", Path(__file__).parents[3]))
            ),
        )
        with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, **LOCAL) as running:
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


def test_work_that_fails_on_a_worker_is_reported(tmp_path: Path, cluster: Any) -> None:
    (tmp_path / "trap").write_text("fail")
    changes = {"figure": "no", "trap": str(tmp_path / "trap")}
    outcome = run_scenarios([TOY], tmp_path / "out", changes=changes, scheduler=cluster.scheduler_address)
    assert len(outcome.failures) == 3 and all("ArithmeticError" in line for line in outcome.failures)


@pytest.mark.long
@pytest.mark.usefixtures("undrawn")
def test_a_comparison_that_loses_a_worker_is_that_of_one_machine(
    tmp_path: Path, cluster: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Four pieces; when the first comes back, one of the two processes is killed. Parts hold times too, which differ."""
    quick = "calibration_error=0.3 lengths=2 false_alarm=0.02 mismatch_cases=no process_faults=no magnitudes=10 settle=20"
    command = [
        "compare",
        "--plants",
        "two-tanks",
        "--detectors",
        "limits,kf-chi2",
        "--faults",
        "bias",
        "--seeds",
        str(CHUNK + 1),
    ]
    command += [word for setting in quick.split() for word in ("--set", setting)]
    assert main([*command, "--workers", "1", "--out", str(tmp_path / "here")]) == 0
    to_kill = [next(iter(cluster.workers.values())).process.pid]

    def kill_then_write(path: Path, arrays: Arrays) -> None:
        if to_kill:
            os.kill(to_kill.pop(), signal.SIGKILL)
        parts.write_part(path, arrays)

    monkeypatch.setattr(on_cluster, "write_part", kill_then_write)
    assert main([*command, "--scheduler", cluster.scheduler_address, "--out", str(tmp_path / "there")]) == 0
    assert not to_kill and "failed" not in capsys.readouterr().err
    assert (tmp_path / "here" / "metrics.csv").read_bytes() == (tmp_path / "there" / "metrics.csv").read_bytes()
    assert len(parts_of(tmp_path / "here")) == 4 and parts_of(tmp_path / "here").keys() == parts_of(tmp_path / "there").keys()
    found = json.loads((tmp_path / "there" / "manifest.json").read_text(encoding="utf-8"))
    assert found["workers"] == cluster.scheduler_address


def test_a_scheduler_that_goes_away_is_reported_once_and_the_run_goes_on_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    changes = {"figure": "no"}
    whole = run_scenarios([TOY], tmp_path / "whole", changes=changes, workers=1)
    passing = distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=False, **LOCAL)

    def write_then_close(path: Path, arrays: Arrays) -> None:
        parts.write_part(path, arrays)
        passing.close()

    monkeypatch.setattr(on_cluster, "write_part", write_then_close)
    with pytest.raises(RuntimeError, match=r"scheduler disappeared.*finished pieces are kept.*repeat the same command"):
        run_scenarios([TOY], tmp_path / "out", changes=changes, scheduler=passing.scheduler_address)
    assert not [record for record in caplog.records if record.levelno >= logging.ERROR]  # no traceback of the connection
    kept = len(parts_of(tmp_path / "out"))
    assert 1 <= kept
    again = run_scenarios([TOY], tmp_path / "out", changes=changes, workers=1)
    resumed = json.loads((tmp_path / "out" / "manifest.json").read_text(encoding="utf-8"))["scenarios"][0]["resumed"]
    assert resumed == kept and repr(again.rows) == repr(whole.rows)


def other_sources() -> str:
    return "other"


def test_workers_with_other_code_are_refused(tmp_path: Path, cluster: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parts, "sources_digest", other_sources)
    with pytest.raises(ValueError, match=r"worker tcp://.* has other sources than this process; install the same"):
        run_scenarios([TOY], tmp_path / "out", changes={"figure": "no"}, scheduler=cluster.scheduler_address)
    assert not (tmp_path / "out").exists()


def test_a_worker_with_other_code_that_joins_later_is_refused(tmp_path: Path, cluster: Any) -> None:
    piece = Piece(tmp_path / "part.npz", TOY.work, TOY.tasks(TOY.settings, 1)[0])
    address = cluster.scheduler_address
    with connected(address) as work_off, distributed.Client(address, set_as_default=False) as other:
        other.run(setattr, parts, "sources_digest", other_sources)
        try:
            with pytest.raises(
                ValueError, match="a worker cannot do the work: it has other sources than this process; install"
            ):
                list(work_off([piece]))
        finally:
            other.run(setattr, parts, "sources_digest", provenance.sources_digest)
        assert not piece.path.exists()
        assert [done.error for done in work_off([piece])] == [None] and piece.path.exists()


def test_errors_of_a_cluster_are_reported(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(on_cluster, "PATIENCE", 0.2)
    with pytest.raises(ValueError, match="workers and a scheduler's address; expected one of them"):
        run_scenarios([TOY], tmp_path, workers=2, scheduler="tcp://127.0.0.1:1")
    with distributed.LocalCluster(n_workers=0, processes=False, **LOCAL) as empty:
        for address, message in (
            ("nowhere:x", "'nowhere:x' is no address of a dask scheduler"),
            ("nowhere", "is no address of a dask scheduler (missing port"),
            ("", "is no address of a dask scheduler"),
            ("tls://localhost:1", "tls://localhost:1 needs certificates: set DASK_DISTRIBUTED__COMM__TLS__CA_FILE and DASK"),
            ("tcp://127.0.0.1:1", "no dask scheduler answers at tcp://127.0.0.1:1; start it"),
            (
                empty.scheduler_address,
                f"at {empty.scheduler_address} has no worker after 0.2 s; start at least one: dask worker",
            ),
        ):
            assert main(["run", "pipeline/units", "--out", str(tmp_path / "o"), "--scheduler", address]) == 2
            reported = capfd.readouterr().err
            assert message in reported and len(reported.splitlines()) == 1
            assert not (tmp_path / "o").exists()
