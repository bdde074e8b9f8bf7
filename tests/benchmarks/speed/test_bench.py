"""The benchmark: compared calls compute the same, and all rows exist. Speed itself is not tested."""

import json
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from fusion_sfdia import registry
from fusion_sfdia.benchmarks.engine.support.campaign import truth
from fusion_sfdia.benchmarks.speed import bank, bench, model, scaling
from fusion_sfdia.benchmarks.speed.support import engine_modules, lorenz_96
from fusion_sfdia.benchmarks.speed.support.against_filterpy import compiled_model, numpy_model, step_call
from fusion_sfdia.cli.main import main
from fusion_sfdia.core.equation import argument_names
from fusion_sfdia.evaluation.results import read_rows
from fusion_sfdia.experiments.timing import best_times
from fusion_sfdia.filters import ekf, ukf
from fusion_sfdia.filters.gaussian import condition, dense
from fusion_sfdia.models.gas_pipeline.plant import gas_pipeline
from fusion_sfdia.models.marine_engine.modules import MODULES

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


def test_each_part_has_its_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small = lambda nodes=9: gas_pipeline(nodes=nodes)  # noqa: E731
    for part in (bank, model, scaling):
        monkeypatch.setattr(part, "gas_pipeline", small)
    monkeypatch.setattr(scaling, "NODES", (9, 13))
    monkeypatch.setattr(scaling, "BANK_NODES", (13,))
    monkeypatch.setattr(registry, "plants", lambda: ("two-tanks",))
    rows = bench.run([], tmp_path, seconds=SHORT)
    assert {r.scenario for r in rows} == {f"bench/{part}" for part in bench.PARTS}
    assert all(np.isfinite(r.value) and r.value > 0 and r.n > 0 and r.published is None for r in rows)
    keys = [(r.scenario, r.detector, r.quantity, r.condition, r.metric) for r in rows]
    assert len(set(keys)) == len(keys)
    for kind in ("ekf", "ukf", "enkf"):
        for quantity, where in (("single", ""), ("filterpy", ""), ("filterpy", "compiled model")):
            assert ("bench/bank", f"fusing-{kind}", quantity, where, "speedup") in keys
    for detector in ("loo-glr", "robust-glr"):
        time = {
            r.quantity: r.value
            for r in rows
            if r.scenario == "bench/stream" and r.metric == "step_time" and r.detector == "none"
        }
        ratio = {r.condition: r.value for r in rows if r.detector == detector and r.metric == "ratio"}
        taken = [r.value for r in rows if r.detector == detector and r.quantity == "one stream" and r.metric == "step_time"]
        assert taken == pytest.approx([ratio["model step"] * (time["step"] + time["Jacobian"])])
        assert taken == pytest.approx([ratio["product of 256"] * time["product of 256"]])
    memory = {r.quantity: r.value for r in rows if r.metric == "peak_memory" and r.detector == "fusing-enkf"}
    # an ensemble of 40 members with 27 states is 8640 bytes: a handful of copies, never a thousand
    assert 8640 < memory["9 nodes"] < 100 * 8640
    assert [r.value for r in read_rows(tmp_path / "metrics.csv")] == [r.value for r in rows]


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
    with pytest.raises(ValueError, match=r"already used; name another folder with --out, or write into it with --force"):
        bench.run(["model"], tmp_path, SHORT)
    assert (tmp_path / "metrics.csv").read_text() == "mine"
