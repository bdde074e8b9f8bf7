"""What counts as slower, on synthetic timings: how often it alarms falsely, and what it finds; and the file of runs."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from fusion_sfdia.benchmarks.speed import history, slower
from fusion_sfdia.benchmarks.speed.slower import FALSE_ALARM, Ratio, compared, confirmed
from fusion_sfdia.benchmarks.speed.support.calls import Timed, timed_rows
from fusion_sfdia.cli.main import main
from fusion_sfdia.report.results import Row

ROWS = 50
KEYS = [(f"row {i}",) for i in range(ROWS)]
WITHIN = 0.01


def runs_of(rng: np.random.Generator, count: int, noise: float, heavy: bool = False) -> list[dict[tuple[str, ...], Ratio]]:
    """Runs of ROWS ratios with a noise of their logarithms between half and twice of `noise`; heavy: Student's, 5 dof."""
    sd = noise * np.geomspace(0.5, 2.0, ROWS)
    draws = rng.standard_t(5, (count, ROWS)) * math.sqrt(3 / 5) if heavy else rng.standard_normal((count, ROWS))
    levels = np.geomspace(0.01, 100, ROWS)
    return [{k: Ratio(float(v), WITHIN) for k, v in zip(KEYS, levels * np.exp(sd * d), strict=True)} for d in draws]


TRIALS = 200


def alarms(noise: float, history: int, heavy: bool = False) -> tuple[int, int]:
    """Comparisons of TRIALS in which a row is slower, and in which one is in two runs."""
    rng = np.random.default_rng(1)
    once = twice = 0
    for _ in range(TRIALS):
        *before, now, again = runs_of(rng, history + 2, noise, heavy)
        changes = compared(before, now)
        once += any(c.slower for c in changes)
        twice += any(c.slower for c in confirmed(changes, compared(before, again)))
    return once, twice


def most(share: float) -> float:
    """The mean and three standard errors of a count."""
    return TRIALS * share + 3 * math.sqrt(TRIALS * share)


@pytest.mark.parametrize("history", [1, 3, 20])
def test_runs_that_differ_by_noise_alone_are_not_slower(history: int) -> None:
    """FALSE_ALARM of the comparisons; rows differ fourfold in noise, which the rule learns from a long history only.

    Tails that are heavier than assumed alarm in some ten percent of the comparisons, and hardly ever twice.
    """
    once, twice = alarms(0.025 if history == 1 else 0.04, history)
    assert once <= most(FALSE_ALARM * (2 if history == 3 else 1)) and twice == 0
    once, twice = alarms(0.025 if history == 1 else 0.04, history, heavy=True)
    assert once <= most(0.12) and twice <= most(0.001)


def test_a_slowdown_beyond_the_noise_is_found() -> None:
    """One row of 50, measured twice, 30 % slower with a noise of 3 %, or 15 % with one of 1 %: at least 95 % of them.

    In both cases the limit is about half of it: 4 standard deviations; the noise is learnt from 20 differences.
    """
    rng, trials = np.random.default_rng(2), 50
    middle = KEYS[ROWS // 2]
    for increase, noise in ((1.3, 0.03), (1.15, 0.01)):
        found = []
        for _ in range(trials):
            *before, now, again = runs_of(rng, 22, noise)
            for run in (now, again):
                run[middle] = Ratio(run[middle].value * increase, WITHIN)
            found += [c.key for c in confirmed(compared(before, now), compared(before, again)) if c.slower]
        assert {*found} == {middle} and len(found) >= 0.95 * trials - 3 * math.sqrt(trials * 0.95 * 0.05)


def test_a_lasting_change_becomes_the_base() -> None:
    """After three slower runs the slower level is usual; a faster one is never reported, and going back is."""
    rng = np.random.default_rng(3)
    runs = runs_of(rng, 24, 0.02)
    for run in runs[10:]:
        run[KEYS[0]] = Ratio(run[KEYS[0]].value / 2, WITHIN)
    assert not any(c.slower for c in compared(runs[:10], runs[10]))
    assert not any(c.slower for c in compared(runs[:23], runs[23]))
    back = {**runs[23], KEYS[0]: Ratio(runs[23][KEYS[0]].value * 2, WITHIN)}
    assert [c.key for c in compared(runs[:23], back) if c.slower] == [KEYS[0]]


def test_a_disturbed_run_is_judged_by_its_own_spread() -> None:
    rng = np.random.default_rng(4)
    *before, now = runs_of(rng, 21, 0.01)
    assert compared(before, {KEYS[0]: Ratio(now[KEYS[0]].value * 1.5, WITHIN)})[0].slower
    assert not compared(before, {KEYS[0]: Ratio(now[KEYS[0]].value * 1.5, 0.5)})[0].slower
    assert not compared(before, {("new",): Ratio(1.0, WITHIN)})


def rows_of(*ratios: float) -> list[Row]:
    return [
        row
        for i, ratio in enumerate(ratios)
        for row in timed_rows("toy", "-", "none", f"row {i}", Timed(1e-3 * ratio, 10, 1e-3, 0.02, "reference"))
    ]


def test_a_run_keeps_its_ratios_and_spreads(tmp_path: Path) -> None:
    run = history.entry(rows_of(3.0, 0.5), 2.0)
    history.append(tmp_path / "new" / "runs.jsonl", run)
    history.append(tmp_path / "new" / "runs.jsonl", run)
    kept = history.read(tmp_path / "new" / "runs.jsonl")
    assert kept == [run, run]
    found = history.ratios(kept[0])
    assert [r.value for r in found.values()] == [3.0, 0.5]
    assert [r.spread for r in found.values()] == pytest.approx([0.02, 0.02])
    assert next(iter(found)) == ("bench/toy", "-", "none", "row 0", "reference")
    assert {*run["machine"]} == {"processor", "cores", "linear algebra"} and run["version"] and run["date"].endswith("+00:00")


def test_a_history_is_added_to_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "runs.jsonl"
    history.append(path, history.entry(rows_of(1.0), 2.0))
    before = path.read_bytes()
    with pytest.raises(ValueError, match="JSON compliant"):
        history.append(path, {**history.entry(rows_of(1.0), 2.0), "seconds": math.nan})
    assert path.read_bytes() == before and [p.name for p in tmp_path.iterdir()] == ["runs.jsonl"]
    path.write_bytes(before + b'{"rows": [')
    with pytest.raises(ValueError, match=r"runs\.jsonl, line 2 is no run of bench \(JSONDecodeError"):
        history.append(path, history.entry(rows_of(1.0), 2.0))
    with pytest.raises(ValueError, match=r"line 1 is no run of bench \(KeyError: 'rows'\); remove it"):
        path.write_text('{"machine": {}}\n')
        history.read(path)


def test_runs_of_other_machines_do_not_count(tmp_path: Path) -> None:
    path = tmp_path / "runs.jsonl"
    run = history.entry(rows_of(1.0), 2.0)
    other = {**run, "machine": {**run["machine"], "cores": 1000}}
    assert history.alike([other, run], path) == [run]
    with pytest.raises(ValueError, match=r"runs\.jsonl has no run on a machine like this one .*but: .*1000"):
        history.alike([other], path)


def test_the_command_compares_with_earlier_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from fusion_sfdia.benchmarks.speed import bench

    path = tmp_path / "runs.jsonl"
    usual = [1.0] * 7
    measured = [rows_of(r, *usual) for r in (1.0, 1.01, 1.0, 2.0, 1.9, 2.0, 1.0)]
    turns = iter(measured)
    monkeypatch.setattr(bench, "run", lambda *_, **__: next(turns))
    command = ["bench", "model", "--history", str(path)]
    assert main(command) == 0
    for _ in range(2):
        assert main([*command, "--against", str(path)]) == 0
    assert "0 of 8 ratios slower, against 2 runs" in capsys.readouterr().out
    assert main(["bench", "model", "--json", "--against", str(path)]) == 1
    out = capsys.readouterr()
    assert len(json.loads(out.out)) == 16
    assert "slower: bench/toy - none row 0 reference: 1 -> 1.9 (+90%; noise" in out.err and "1 of 8 ratios slower" in out.err
    assert main(["bench", "model", "--against", str(path)]) == 0  # the second time it is as fast as before
    assert "0 of 8 ratios slower" in capsys.readouterr().out
    assert len(history.read(path)) == 3  # without --history nothing is added
    turns = iter([rows_of()])
    assert main(["bench", "model", "--against", str(path)]) == 2
    assert "none of the rows of this run; measure the same parts" in capsys.readouterr().err
    assert main(["bench", "model", "--against", str(tmp_path / "none")]) == 2
    (tmp_path / "bad").write_text("x")
    assert main(["bench", "model", "--history", str(tmp_path / "bad")]) == 2  # before anything is measured


def test_the_noise_before_there_is_a_history() -> None:
    (change,) = compared([{KEYS[0]: Ratio(1.0, WITHIN)}], {KEYS[0]: Ratio(1.1, WITHIN)})
    assert change.noise == slower.PRIOR_NOISE and change.runs == 1 and not change.slower
