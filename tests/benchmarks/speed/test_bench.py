"""The benchmark: compared calls compute the same, and all rows exist. Speed itself is not tested."""

import json
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from fusion_sfdia.benchmarks.engine.support.campaign import truth
from fusion_sfdia.benchmarks.speed import bank, bench, campaigns, large, logs, model, network, own, scaling, workers
from fusion_sfdia.benchmarks.speed.support import engine_modules, lorenz_96, peers
from fusion_sfdia.benchmarks.speed.support.against_filterpy import compiled_model, numpy_model, step_call
from fusion_sfdia.benchmarks.speed.support.calls import Timed, repeated_step, timed, timed_rows, together
from fusion_sfdia.benchmarks.speed.support.coupled import chained
from fusion_sfdia.benchmarks.speed.support.local_cluster import secure_cluster
from fusion_sfdia.benchmarks.speed.support.processes import timed_process
from fusion_sfdia.cli.main import main
from fusion_sfdia.derivatives.equation import argument_names
from fusion_sfdia.detectors import registry
from fusion_sfdia.filters import ekf, ukf
from fusion_sfdia.filters.gaussian import condition, dense
from fusion_sfdia.logs.csv_log import read_log
from fusion_sfdia.models.gas_pipeline.plant import gas_pipeline
from fusion_sfdia.models.marine_engine.modules import MODULES
from fusion_sfdia.report.results import read_rows
from fusion_sfdia.study.experiments.cluster import connected
from fusion_sfdia.study.experiments.scenario import Arrays, Task
from fusion_sfdia.study.experiments.timing import best_times
from fusion_sfdia.study.experiments.workers import Piece

SHORT = 1e-3  # s


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
@pytest.mark.parametrize("compiled", [True, False], ids=["compiled", "numpy"])
def test_filterpy_on_the_pipeline_gives_the_same_estimates(kind: str, compiled: bool) -> None:
    plant = gas_pipeline(nodes=9)
    u = plant.input_at(0.0)
    y = plant.x0 + 2 * plant.sensor_sigma * np.sin(np.arange(27))
    model = (compiled_model if compiled else numpy_model)(plant, u)
    theirs = step_call(kind, plant, model, y, without=4)
    x, P, Q, R = plant.x0, dense(plant.initial_cov), plant.process_cov, plant.sensor_cov
    if kind == "ekf":
        x, P = ekf.predict(x, P, model.step, model.jacobian(x), Q)
        joint = ekf.joint(x, P, lambda s: s, np.eye(27), R)
    else:
        points = ukf.SigmaPoints()
        x, P, _ = ukf.predict(points, x, P, lambda s: np.array([model.step(p) for p in s]), Q)
        joint = ukf.joint(points, x, P, lambda s: s, R)
    ours = condition(joint, np.where(np.arange(27) == 4, np.nan, y)).x
    # weights of 1e6 magnify the rounding of 8.4 MPa relative to 500 Pa: eps 1e6 (8.4e6 / 500) = 4e-6 sigma, 50 operations of it
    tolerance = 50 * 4e-6 if kind == "ukf" else 1e-9
    np.testing.assert_allclose(theirs() / plant.state_scale, ours / plant.state_scale, rtol=0, atol=tolerance)
    np.testing.assert_array_equal(theirs(), theirs())  # each call repeats the same step
    assert np.abs(ours - plant.x0).max() > 0


@pytest.mark.parametrize("kind", ["kf", "ukf"])
def test_filterpy_on_lorenz_96_gives_the_same_estimates(kind: str) -> None:
    ours, theirs = lorenz_96.pairs(kind, "np.roll")
    theirs()
    # weights of 1e6 magnify rounding of values near 8, over 127 points
    np.testing.assert_allclose(ours(), theirs(), rtol=0, atol=1e6 * 8 * np.finfo(float).eps * 127 if kind == "ukf" else 1e-11)


def test_both_implementations_of_lorenz_96_agree() -> None:
    x = np.random.default_rng(1).standard_normal((3, 63))
    nothing = np.empty(0)
    a, b = (f(0.0, x, nothing, nothing, 8.0) for f in lorenz_96.MODELS.values())
    np.testing.assert_array_equal(a, b)
    i = 5
    assert a[0, i] == pytest.approx((x[0, i + 1] - x[0, i - 2]) * x[0, i - 1] - x[0, i] + 8.0, rel=1e-14)


@pytest.mark.skipif(find_spec("codac") is None, reason="codac is not installed: pip install 'fusion-sfdia[codac]'")
def test_codac_bounds_what_healthy_readings_leave_to_the_engine() -> None:
    modules, sensors = engine_modules.detector().plant.structure.modules, engine_modules.detector().plant.sensors
    run, rng = truth(1.0), np.random.default_rng(0)
    within = run.signal[0] + rng.uniform(-1, 1, (50, 10)) * [s.noise_bound for s in sensors]
    values = {s.measures: v for s, v in zip(sensors, within.T, strict=True)} | {"fuel_setting": run.u[0, 0]}
    for name, call in engine_modules.codac_calls(0.1).items():
        function = modules.equations[MODULES[name].variable]
        found = function(*(values[a] for a in argument_names(function) if a != "c"), modules.parameters)
        hull = call().hull
        assert np.all((hull.lo <= found) & (found <= hull.hi)), name


IN_THIS_PROCESS = ("bank", "model", "scaling", "lorenz", "engine", "stream", "own", "network")


def test_each_part_has_its_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small = lambda nodes=9: gas_pipeline(nodes=nodes)  # noqa: E731
    for part in (bank, model, scaling):
        monkeypatch.setattr(part, "gas_pipeline", small)
    monkeypatch.setattr(scaling, "NODES", (9, 13))
    monkeypatch.setattr(scaling, "BANK_NODES", (13,))
    monkeypatch.setattr(scaling, "SENSORS", (5,))
    monkeypatch.setattr(network, "AREAS", (15, 40))
    monkeypatch.setattr(own, "ROWS", 20)
    monkeypatch.setattr(registry, "plants", lambda: ("two-tanks",))
    rows = bench.run(IN_THIS_PROCESS, tmp_path, seconds=SHORT)
    assert {r.scenario for r in rows} == {f"bench/{part}" for part in IN_THIS_PROCESS}
    assert all(np.isfinite(r.value) and r.value > 0 and r.n > 0 and r.published is None for r in rows)
    keys = [(r.scenario, r.plant, r.detector, r.quantity, r.condition, r.metric) for r in rows]
    assert len(set(keys)) == len(keys)
    assert all(r.low <= r.value <= r.high for r in rows if r.metric == "ratio")
    # each time stands beside its ratio; but a reference's own
    timed = [(r.scenario, r.plant, r.detector, r.quantity) for r in rows if r.metric == "step_time"]
    compared = {(r.scenario, r.plant, r.detector, r.quantity) for r in rows if r.metric == "ratio"}
    assert {(key[0], key[3]) for key in timed if key not in compared} == {
        ("bench/stream", "product of 256"),
        ("bench/own", "step"),
    }
    for kind in ("ekf", "ukf", "enkf"):
        for quantity, where in (("single", ""), ("filterpy", ""), ("filterpy", "compiled model")):
            assert ("bench/bank", "gas-pipeline", f"fusing-{kind}", quantity, where, "speedup") in keys
    in_stream = [r for r in rows if r.scenario == "bench/stream"]
    for detector in ("loo-glr", "robust-glr"):
        time = {r.quantity: r.value for r in in_stream if r.metric == "step_time" and r.detector == "none"}
        ratio = {r.condition: r.value for r in in_stream if r.detector == detector and r.metric == "ratio"}
        taken = [r.value for r in in_stream if r.detector == detector and r.metric == "step_time"]
        assert taken == pytest.approx([ratio["model step"] * (time["step"] + time["Jacobian"])])
        assert taken == pytest.approx([ratio["product of 256"] * time["product of 256"]])
    memory = {r.quantity: r.value for r in rows if r.metric == "peak_memory" and r.detector == "fusing-enkf"}
    # an ensemble of 40 members with 27 states is 8640 bytes: a handful of copies, never a thousand
    assert 8640 < memory["9 nodes"] < 100 * 8640
    assert [r.value for r in read_rows(tmp_path / "metrics.csv")] == [r.value for r in rows]


def test_the_ratio_is_that_of_the_least_times_and_as_wide_as_turns_differ() -> None:
    now = [0.0]

    def lasts(*times: float) -> Callable[[], object]:
        each = iter((0.0, *times, *times))  # the first is not counted
        return lambda: now.__setitem__(0, now[0] + next(each))

    calls = {"a": lasts(6.0, 8.0, 6.0), "b": lasts(2.0, 2.0, 2.0)}
    found = timed(calls, 1.0, "the other", lasts(2.0, 4.0, 2.0), lambda: now[0])
    assert found["a"][:3] == (6.0, 3, 2.0) and found["a"].reference == "the other"
    assert found["a"].spread == pytest.approx(np.std(np.log([3.0, 2.0, 3.0]), ddof=1))
    assert found["a"].ratio == 3.0 and found["b"].ratio == 1.0
    time, ratio = timed_rows("toy", "-", "none", "all", Timed(6.0, 9, 3.0, 0.1, "copy"), 0.5, condition="where")
    assert (time.value, time.condition, time.metric) == (3.0, "where", "step_time")
    assert (ratio.value, ratio.condition, ratio.metric, ratio.n) == (1.0, "where, copy", "ratio", 9)
    assert np.log([ratio.low, ratio.high]) == pytest.approx([-0.196, 0.196])
    both = together([Timed(1.0, 9, 2.0, 0.1, "copy"), Timed(3.0, 5, 2.0, 0.3, "copy")])
    assert both == Timed(4.0, 5, 2.0, 0.3, "copy") and both.ratio == 2.0


def test_other_packages_give_the_same_estimates() -> None:
    """Of those that are installed. Rounding: 63 operations at values near 8 with a condition of 100; JAX's filters add 1e-9."""
    for kind in ("kf", "ukf", "bank"):
        by_hand = peers.numpy_by_hand(kind)
        assert by_hand is not None
        for name, (package, make) in peers.PEERS.items():
            if package is not None and find_spec(package) is None:
                continue
            call = make(kind)
            assert call is not None
            found = call()
            np.testing.assert_array_equal(call(), found)  # each call repeats the same step
            if (name, kind) != ("fusion-sfdia", "bank"):  # its filters are extended, and mixed
                atol = 1e-8 if name == "dynamax" else 63 * 8 * 100 * np.finfo(float).eps
                np.testing.assert_allclose(found, by_hand(), rtol=0, atol=atol, err_msg=f"{name} {kind}")


def test_packages_that_are_not_installed_are_left_out(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(bench.peers, "find_spec", lambda name: name == "filterpy" or None)
    monkeypatch.setattr(bench.peers, "KINDS", ("kf",))
    rows = bench.run(["peers"], seconds=SHORT)
    assert {r.quantity for r in rows} == {"fusion-sfdia", "NumPy by hand", "filterpy"}
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 3 and lines[0] == (
        "bench peers: stonesoup is left out: pip install stonesoup, or 'fusion-sfdia[peers]'"
    )


def test_a_process_is_timed_and_its_memory_is_its_own() -> None:
    small, large = (timed_process(["-c", f"len(bytearray({n}))"]) for n in (1, 80_000_000))
    assert small.seconds > 0 and large.memory - small.memory == pytest.approx(80e6, rel=0.1)
    assert timed_process(["-c", "import os, sys; sys.exit(os.environ['NEW'] != '1')"], {"NEW": "1"}).memory > 0
    with pytest.raises(RuntimeError, match=r"(?s)-c 1/0 ended with 1: .*ZeroDivisionError"):
        timed_process(["-c", "1/0"])


def test_a_long_log_is_a_block_repeated(tmp_path: Path) -> None:
    logs.write(tmp_path / "log.csv", "two-tanks", logs.BLOCK + 10)
    log = read_log(tmp_path / "log.csv", registry.plant("two-tanks"))
    assert len(log.t) == logs.BLOCK + 10 and np.unique(np.diff(log.t)).size == 1
    np.testing.assert_array_equal(log.y[logs.BLOCK :], log.y[:10])


@pytest.mark.slow
def test_pieces_of_campaigns_and_of_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(campaigns, "RUNS", 2)
    monkeypatch.setattr(campaigns, "DURATION", 0.2)
    monkeypatch.setattr(campaigns, "DETECTORS", ())
    (time, _) = bench.run(["campaigns"], seconds=SHORT)
    assert time.quantity == "2 runs of 0.2 s" and time.value > 0
    task = workers.task_of(3)
    assert task["seeds"] == [6, 7] and task["detector"] == "limits"


@pytest.mark.slow
@pytest.mark.skipif(not all(map(find_spec, workers.CLUSTER)), reason="needs distributed and cryptography")
def test_a_cluster_with_certificates_does_pieces_and_refuses_others(tmp_path: Path) -> None:
    """The settings of dask that the documentation names are all that a client of a scheduler with TLS needs."""
    pieces = [Piece(tmp_path / f"{k}.npz", workers.nothing, {"k": k}) for k in range(3)]
    with secure_cluster(1) as address:
        assert address.startswith("tls://127.0.0.1:")
        with connected(address) as do:
            assert workers.seconds_of(pieces, do) > 0 and all(p.path.exists() for p in pieces)
            with pytest.raises(RuntimeError, match="a piece failed: KeyError"):
                workers.seconds_of([Piece(tmp_path / "x.npz", missing_key, {})], do)
        import dask

        ours = {k: None for k in ("distributed.comm.tls.client.cert", "distributed.comm.tls.client.key")}
        with (
            dask.config.set(ours),
            pytest.raises(ValueError, match=r"needs certificates: set DASK\w*CLIENT__CERT"),
            connected(address),
        ):
            pass


def missing_key(task: Task) -> Arrays:
    """A piece that fails."""
    return {"none": task["missing"]}


def test_the_command_prints_what_it_measured(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "model", "--seconds", "0.001", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert {r["scenario"] for r in printed} == {"bench/model"} and all(r["value"] > 0 for r in printed)
    assert main(["bench", "model", "--seconds", "0.001"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(printed) and lines[0].split()[:3] == ["model", "gas-pipeline", "none"]
    assert main(["bench", "bnak"]) == 2 and "unknown part bnak" in capsys.readouterr().err


def test_the_least_time_of_calls_that_take_turns() -> None:
    order: list[str] = []
    times = best_times({"a": lambda: order.append("a"), "b": lambda: order.append("b")}, SHORT)
    assert order[:2] == ["a", "b"]
    assert {name: t.calls for name, t in times.items()} == {name: order.count(name) - 1 for name in "ab"}
    assert all(t.best > 0 and t.calls >= 3 for t in times.values())


def test_bad_input_is_named_before_anything_is_timed(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="unknown part bnak of the benchmark; known: bank, model, scaling, lorenz"):
        bench.run(["bnak"])
    with pytest.raises(ValueError, match="positive time"):
        best_times({}, 0.0)
    with pytest.raises(ValueError, match="seconds is nan; expected a positive time"):
        best_times({}, float("nan"))
    (tmp_path / "metrics.csv").write_text("mine")
    with pytest.raises(
        ValueError, match=r"already used: .*name another folder with --out, or replace what is there with --force"
    ):
        bench.run(["model"], tmp_path, SHORT)
    assert (tmp_path / "metrics.csv").read_text() == "mine"


def test_filters_beside_large_plants_give_the_same_and_gains_rest() -> None:
    plant = chained(4)
    for ours, theirs in zip(large.by_hand(plant)(), large.filterpy(plant)(), strict=True):
        np.testing.assert_allclose(ours, np.reshape(theirs, np.shape(ours)), rtol=1e-13, atol=1e-15)
    for name in large.DETECTORS:
        detector = registry.detector(name, large.at_rest(chained(64)))
        state, _ = repeated_step(detector, settled=large.SETTLED + 1, noise=False)()
        assert state.memory.steady.rests.all()


def test_the_part_on_large_plants_has_all_rows_and_least_times() -> None:
    rows = large.measure(SHORT, (4, 8))
    times = {(r.quantity, r.detector, r.condition): r.value for r in rows if r.metric == "step_time"}
    assert len(times) == 2 * (1 + 2 * len(large.DETECTORS) + 2)
    assert times["8 states", "none", "least, filter"] == pytest.approx(8 * times["4 states", "none", "least, filter"])
    assert times["8 states", "none", "least, at rest"] == pytest.approx(4 * times["4 states", "none", "least, at rest"])
    ratios = {(r.quantity, r.detector, r.condition) for r in rows if r.metric == "ratio"}
    assert ("4 states", "robust-glr", "at rest, filterpy") in ratios
