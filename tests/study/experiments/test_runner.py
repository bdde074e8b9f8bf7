"""Running scenarios: the same bytes for any number of workers and after an interruption; folders; failures; settings."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure as Drawing
from toy_scenario import TOY, toy

from fusion_sfdia.common.files import all_or_none, locked
from fusion_sfdia.report.content import Figure
from fusion_sfdia.report.results import COLUMNS, Published, Row, as_json, read_rows, write_rows
from fusion_sfdia.study.experiments.parts import part_name, read_part, write_part
from fusion_sfdia.study.experiments.runner import Command, draw_figures, open_output, run_scenarios
from fusion_sfdia.study.experiments.scenario import adjust, seed_blocks

PLAIN = {"figure": "no"}


def files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def manifest(out: Path) -> dict:
    return json.loads((out / "manifest.json").read_text(encoding="utf-8"))


def test_same_bytes_for_any_number_of_workers(tmp_path: Path) -> None:
    for workers in (1, 2):
        outcome = run_scenarios([TOY], tmp_path / str(workers), workers=workers, changes={"size": "150"})
        assert not outcome.failures
    one, two = files(tmp_path / "1"), files(tmp_path / "2")
    assert one.keys() == two.keys()
    assert {
        "metrics.csv",
        "report.html",
        "manifest.json",
        "figures/toy-mean-means.svg",
        "figures/toy-mean-means.png",
        "figures/toy-mean-again.svg",
        "figures/toy-mean-again.png",
    } <= one.keys()
    timed = {"manifest.json", "report.html"}  # these contain the time it took
    assert {k: v for k, v in one.items() if k not in timed} == {k: v for k, v in two.items() if k not in timed}


@pytest.mark.parametrize(("trap", "workers", "error"), [("interrupt", 1, KeyboardInterrupt), ("die", 2, RuntimeError)])
def test_a_run_that_was_broken_off_goes_on(tmp_path: Path, trap: str, workers: int, error: type[BaseException]) -> None:
    flag = tmp_path / "trap"
    changes = {**PLAIN, "trap": str(flag)}
    whole = run_scenarios([TOY], tmp_path / "whole", changes=changes, workers=1)
    flag.write_text(trap)
    out = tmp_path / "broken"
    with pytest.raises(error):
        run_scenarios([TOY], out, changes=changes, workers=workers)
    assert not (out / "metrics.csv").exists()
    assert manifest(out)["finished"] is False
    kept = len(list((out / "parts").glob("*.npz")))
    assert kept < 6
    if workers == 1:
        assert kept == 3  # the three of detector a were done
    flag.unlink()
    again = run_scenarios([TOY], out, changes=changes, workers=workers)
    assert manifest(out)["scenarios"][0]["resumed"] == kept
    assert manifest(out)["finished"] is True
    assert (out / "metrics.csv").read_bytes() == (tmp_path / "whole" / "metrics.csv").read_bytes()
    assert repr(again.rows) == repr(whole.rows)


def test_a_failed_task_is_reported_and_the_others_go_on(tmp_path: Path) -> None:
    flag = tmp_path / "trap"
    flag.write_text("fail")
    changes = {"trap": str(flag)}
    outcome = run_scenarios([TOY], tmp_path / "out", changes=changes, workers=2)
    assert len(outcome.failures) == 3
    assert "ArithmeticError" in outcome.failures[0] and "detector b" in outcome.failures[0]
    assert "seeds [0, 1]" in outcome.failures[0] and "seeds [4, 5]" in outcome.failures[2]  # in the order of the tasks
    rows = {(r.detector, r.metric): r.value for r in outcome.rows}
    assert rows["b", "failed_tasks"] == 3
    assert next(r.quantity for r in outcome.rows if r.metric == "failed_tasks") == "flow, level"  # of tasks with several
    assert ("a", "mean") in rows and ("b", "mean") not in rows
    assert "ArithmeticError" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    flag.unlink()
    mended = run_scenarios([TOY], tmp_path / "out", changes=changes, workers=1)
    assert not mended.failures
    assert manifest(tmp_path / "out")["scenarios"][0]["resumed"] == 3


def test_a_failing_summary_or_figure_leaves_the_other_scenario(tmp_path: Path) -> None:
    def broken(*_: object) -> None:
        raise KeyError("mean")

    outcome = run_scenarios([toy(name="toy/broken", summarise=broken), TOY], tmp_path, changes=PLAIN, workers=1)
    assert [line.split(":")[0] for line in outcome.failures] == ["toy/broken, summary"]
    assert {r.scenario for r in outcome.rows} == {"toy/mean"}


def test_results_that_are_no_arrays_are_a_failure(tmp_path: Path) -> None:
    def work(task: object) -> dict:
        return {"mean": object()}

    outcome = run_scenarios([toy(work=work)], tmp_path, workers=1, seeds=1)
    assert "expected arrays of numbers" in outcome.failures[0]
    assert not list((tmp_path / "parts").glob("*"))


def test_folders(tmp_path: Path) -> None:
    def run(out: Path, seeds: int = 2, force: bool = False) -> None:
        run_scenarios([TOY], out, seeds=seeds, workers=1, changes=PLAIN, force=force)

    empty = tmp_path / "empty"
    empty.mkdir()
    run(empty)
    before = (empty / "metrics.csv").read_bytes()
    run(empty)  # the same command: resumed, nothing changes
    assert manifest(empty)["scenarios"][0]["resumed"] == 2
    assert (empty / "metrics.csv").read_bytes() == before
    with pytest.raises(ValueError, match=r"already used: it holds another run .*--seeds 2.*--force, which reuses .*parts"):
        run(empty, seeds=4)
    assert (empty / "metrics.csv").read_bytes() == before
    run(empty, seeds=4, force=True)
    assert manifest(empty)["scenarios"][0]["resumed"] == 2  # what both need
    assert len(list((empty / "parts").iterdir())) == 4  # those of the other run are gone
    assert (empty / "metrics.csv").read_bytes() != before
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "thesis.tex").write_text("mine")
    with pytest.raises(ValueError, match=r"already used: it holds files that are not a run of fusion-sfdia.*--force"):
        run(mine)
    assert files(mine) == {"thesis.tex": b"mine"}
    run(mine, force=True)
    assert (mine / "thesis.tex").read_text() == "mine"
    with pytest.raises(ValueError, match="is a file; name a folder"):
        run(mine / "thesis.tex")
    with pytest.raises((ValueError, OSError), match="thesis"):
        run(mine / "thesis.tex" / "deeper")


def flipped(content: bytes, bit: int) -> bytes:
    return content[: bit // 8] + bytes([content[bit // 8] ^ 1 << bit % 8]) + content[bit // 8 + 1 :]


def test_a_flipped_bit_in_any_byte_and_every_cut_of_a_part_are_noticed(tmp_path: Path) -> None:
    """One bit of each byte, each of the eight in turn: a checksum of 32 bits covers all of them alike."""
    path = tmp_path / "x.npz"
    write_part(path, {"a": np.arange(3.0), "name": np.array("π")})
    content = path.read_bytes()
    damaged = [content[:length] for length in range(len(content))]
    damaged += [flipped(content, 8 * k + k % 8) for k in range(len(content))]
    for found in damaged:
        path.write_bytes(found)
        assert read_part(path) is None
    path.write_bytes(content)
    assert read_part(path) is not None


def test_a_damaged_part_is_computed_again_and_reported(tmp_path: Path) -> None:
    first = run_scenarios([TOY], tmp_path, seeds=2, workers=1, changes=PLAIN)
    assert first.notes == []
    numbers = (tmp_path / "metrics.csv").read_bytes()
    part = sorted((tmp_path / "parts").iterdir())[0]
    content = part.read_bytes()
    part.write_bytes(flipped(content, 4 * len(content)))
    again = run_scenarios([TOY], tmp_path, seeds=2, workers=1, changes=PLAIN)
    assert again.notes == [f"{part} is damaged or cut and was computed again"] and not again.failures
    assert part.read_bytes() == content and (tmp_path / "metrics.csv").read_bytes() == numbers
    assert manifest(tmp_path)["scenarios"][0]["resumed"] == 1


def test_a_folder_is_of_one_run_at_a_time(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with locked(out):
        with pytest.raises(ValueError, match=r"out is in use: another run writes into it; wait until .* --out"):
            run_scenarios([TOY], out, seeds=2, workers=1, changes=PLAIN)
        assert [p.name for p in out.iterdir()] == [".lock"]
    assert not out.exists()
    run_scenarios([TOY], out, seeds=2, workers=1, changes=PLAIN)
    assert not (out / ".lock").exists()


def test_the_lock_of_a_killed_process_blocks_no_other(tmp_path: Path, root: Path) -> None:
    code = "import os, pathlib\nfrom fusion_sfdia.common.files import locked\n"
    code += f"with locked(pathlib.Path({str(tmp_path)!r})):\n    os._exit(9)"
    environment = {**os.environ, "PYTHONPATH": str(root)}
    assert subprocess.run([sys.executable, "-c", code], env=environment, check=False).returncode == 9
    assert (tmp_path / ".lock").exists()
    run_scenarios([TOY], tmp_path, seeds=2, workers=1, changes=PLAIN)
    assert not (tmp_path / ".lock").exists() and (tmp_path / "metrics.csv").exists()


def test_files_move_into_a_folder_all_or_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "new" / "out"
    with pytest.raises(ArithmeticError), all_or_none(out) as new:
        (new / "a").write_text("half of it")
        raise ArithmeticError
    assert not list(tmp_path.iterdir())
    with all_or_none(out) as new:
        (new / "figures").mkdir()
        for name in ("a", "b", "figures/c"):
            (new / name).write_text("first")
    (out / "mine").write_text("mine")
    before = files(out)
    assert before == {"a": b"first", "b": b"first", "figures/c": b"first", "mine": b"mine"}
    replace_file, count = os.replace, 0

    def full_at_the_third(source: Path, target: Path) -> None:
        nonlocal count
        count += 1
        if count == 3:
            raise OSError(errno.ENOSPC, "No space left on device", str(target))
        replace_file(source, target)

    monkeypatch.setattr("fusion_sfdia.common.files.os.replace", full_at_the_third)
    with pytest.raises(OSError, match="No space left"), all_or_none(out) as new:
        for name in ("a", "aa", "b"):
            (new / name).write_text("second")
    assert files(out) == before


def test_a_run_that_fails_leaves_the_results_of_the_one_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_scenarios([TOY], tmp_path, seeds=2, workers=1, changes=PLAIN)
    before = {name: content for name, content in files(tmp_path).items() if name != "manifest.json"}

    def full(path: Path, *_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    with monkeypatch.context() as patch:
        patch.setattr("fusion_sfdia.study.experiments.runner.write_report", full)
        with pytest.raises(OSError) as caught:
            run_scenarios([TOY], tmp_path, seeds=4, workers=1, changes=PLAIN, force=True)
    assert caught.value.filename == str(tmp_path / "report.html")
    assert {name: content for name, content in files(tmp_path).items() if name in before} == before
    run_scenarios([TOY], tmp_path, seeds=4, workers=1, changes=PLAIN)
    assert files(tmp_path)["metrics.csv"] != before["metrics.csv"]


def test_a_forged_manifest_removes_nothing_of_others(tmp_path: Path) -> None:
    (tmp_path / "keep.csv").write_text("mine")
    out = tmp_path / "out"
    out.mkdir()
    listed = {"program": "fusion-sfdia", "command": "other", "files": ["../keep.csv", "figures/../../keep.csv", "/etc/x", 3]}
    (out / "manifest.json").write_text(json.dumps(listed))
    open_output(out, Command(("toy/mean",)), force=True)
    assert (tmp_path / "keep.csv").read_text() == "mine"


def test_an_unwritable_folder_is_a_clear_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("fusion_sfdia.common.files.os.open", refuse)
    with pytest.raises(ValueError, match=r"cannot write into .*Permission denied.*--out"):
        run_scenarios([TOY], tmp_path / "out", workers=1)


def test_parts(tmp_path: Path) -> None:
    path = tmp_path / "parts" / "x.npz"
    arrays = {"a": np.arange(3.0), "flags": np.array([True, False])}
    write_part(path, arrays)
    found = read_part(path)
    assert found is not None
    assert found.keys() == arrays.keys()
    assert all(np.array_equal(found[k], v) and found[k].dtype == v.dtype for k, v in arrays.items())
    first = path.read_bytes()
    write_part(path, arrays)
    assert path.read_bytes() == first  # no time in it
    path.write_bytes(first[: len(first) // 2])
    assert read_part(path) is None
    path.write_bytes(first[:60] + bytes(40) + first[100:])
    assert read_part(path) is None
    assert read_part(tmp_path / "absent.npz") is None

    def one(task: object) -> dict:
        return {}

    def other(task: object) -> dict:
        return {}

    names = {part_name(work, {"a": 1, "seeds": s}) for work in (one, other) for s in ([0], [1])}
    assert len(names) == 4
    with pytest.raises(ValueError, match="not made of JSON values"):
        part_name(one, {"seeds": range(3)})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"workers": 0}, "0 workers; expected at least 1"),
        ({"seeds": 0}, "0 seeds; expected at least 1"),
        ({"seeds": 3, "full": True}, "3 seeds and full"),
        ({"changes": {"sise": "3"}}, r"no setting 'sise' in toy/mean; known: figure, levels, rate, size, trap"),
        ({"changes": {"size": "many"}}, "setting size is 'many'; expected a whole number from 1 to 1000000, such as 40"),
        ({"changes": {"size": "1.5"}}, "expected a whole number"),
        ({"changes": {"size": "-1"}}, "size is '-1'; expected a whole number from 1"),
        ({"changes": {"size": "1_0"}}, "expected a whole number"),
        ({"changes": {"size": "１２"}}, "expected a whole number"),
        ({"changes": {"size": "99999999999999999999"}}, "expected a whole number"),
        ({"changes": {"size": "9" * 5000}}, r"size is '9+\.\.\.; expected"),
        ({"changes": {"levels": ","}}, "setting levels is empty; expected at least one value, such as high"),
        ({"changes": {"levels": "low,high,low"}}, "expected each value once, 'low' occurs twice"),
        ({"changes": {"trap": "a\0b"}}, "expected at most 1000 printable characters"),
        ({"changes": {"rate": "nan"}}, "setting rate is 'nan'; expected a number from 1e-06 to 1000000, such as 0.5"),
        ({"changes": {"figure": "perhaps"}}, "expected true or false"),
    ],
)
def test_bad_arguments(tmp_path: Path, arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        run_scenarios([TOY], tmp_path / "out", **arguments)
    assert not (tmp_path / "out").exists()


def test_scenarios_that_cannot_be(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no scenario to run"):
        run_scenarios([], tmp_path)
    with pytest.raises(ValueError, match="same task twice"):
        run_scenarios([toy(tasks=lambda settings, seeds: [{}, {}])], tmp_path)
    with pytest.raises(ValueError, match="lower-case letters"):
        toy(name="../toy")
    with pytest.raises(ValueError, match="1 <= seeds <= full"):
        toy(seeds=51)


def test_settings_have_the_type_of_their_defaults() -> None:
    changed = adjust(TOY, {"size": "7", "rate": "2", "figure": "no", "levels": "low, high", "trap": "a=b"})
    assert changed == {"size": 7, "rate": 2.0, "figure": False, "levels": ("low", "high"), "trap": "a=b"}
    assert type(changed["rate"]) is float
    assert adjust(replace(TOY, settings={"sizes": (1, 2)}), {"sizes": "3"}) == {"sizes": (3,)}


def test_seed_blocks() -> None:
    assert seed_blocks(5, 2) == [[0, 1], [2, 3], [4]]
    assert seed_blocks(2, 10, first=7) == [[7, 8]]


def test_rows_come_back_to_the_bit(tmp_path: Path) -> None:
    third = 1 / 3
    rows = [
        Row("s", "p", "d", "none", 'a, "quoted"\nline', "auc", third, third - 1e-17, np.nextafter(third, 1), 50),
        Row("s", "p", "d", "f", "all", "rmse", float("inf"), published=0.1, source="Author 1999, Table I, p. 1"),
        Row("s", "p", "d", "f", "all", "rmse", float("nan"), condition="noise 5 %, finer grid"),
    ]
    write_rows(tmp_path / "metrics.csv", rows)
    text = (tmp_path / "metrics.csv").read_text(encoding="utf-8")
    assert text.startswith(",".join(COLUMNS) + "\n")
    assert "0.3333333333333333," in text and "float64" not in text
    assert repr(read_rows(tmp_path / "metrics.csv")) == repr([replace(rows[0], high=float(rows[0].high)), *rows[1:]])
    objects = json.loads(as_json(rows))
    assert [r["value"] for r in objects] == [third, "inf", None]
    assert [r["condition"] for r in objects] == ["", "", "noise 5 %, finer grid"]
    assert objects[1]["source"] == "Author 1999, Table I, p. 1"
    (tmp_path / "metrics.csv").write_text(text.replace("50", "many"), encoding="utf-8")
    with pytest.raises(ValueError, match="row 2"):
        read_rows(tmp_path / "metrics.csv")
    (tmp_path / "metrics.csv").write_text("a,b\n", encoding="utf-8")
    with pytest.raises(ValueError, match="no metrics file"):
        read_rows(tmp_path / "metrics.csv")
    (tmp_path / "metrics.csv").write_text(text.replace(",condition", "", 1), encoding="utf-8")
    with pytest.raises(ValueError, match=r"metrics\.csv was written by an earlier version: it has no column condition"):
        read_rows(tmp_path / "metrics.csv")


def test_published_numbers_have_a_source() -> None:
    with pytest.raises(ValueError, match="no source"):
        Published(0.1, " ")
    with pytest.raises(ValueError, match="both or neither"):
        Row("s", "p", "d", "f", "q", "auc", 0.5, published=0.5)
    assert Row("s", "p", "d", "f", "q", "auc", 0.5, 0.4, 0.6, 9, 0.45, "x").agrees is True
    assert Row("s", "p", "d", "f", "q", "auc", 0.5, 0.4, 0.6, 9, 0.65, "x").agrees is False
    assert Row("s", "p", "d", "f", "q", "auc", 0.5, published=0.45, source="x").agrees is None


def test_scenarios_with_the_same_work_share_equal_pieces(tmp_path: Path) -> None:
    """The second asks for one size the first has too: each piece is done once and both read it."""
    both = [TOY, toy(name="toy/again")]
    shared = run_scenarios(both, tmp_path / "both", seeds=3, workers=1, changes=PLAIN)
    assert len(list((tmp_path / "both" / "parts").iterdir())) == 4
    values = [(r.detector, r.value) for r in shared.rows if r.metric == "mean"]
    assert len(values) == 4 and values[:2] == values[2:]
    trap = tmp_path / "trap"
    trap.write_text("raise")
    outcome = run_scenarios(both, tmp_path / "failed", seeds=2, workers=1, changes={**PLAIN, "trap": str(trap)})
    assert [line.split(",")[0] for line in outcome.failures] == ["toy/mean", "toy/again"]  # both are reported


def test_full_takes_the_settings_of_the_whole_paper(tmp_path: Path) -> None:
    one = toy(full={"size": 3})
    assert adjust(one, {}, full=True)["size"] == 3 and adjust(one, {})["size"] == TOY.settings["size"]
    assert adjust(one, {"size": "5"}, full=True)["size"] == 5
    run_scenarios([one], tmp_path, full=True, workers=1)
    assert manifest(tmp_path)["scenarios"][0]["settings"]["size"] == 3


def plain() -> Drawing:
    return Drawing(figsize=(1, 1))


def broken() -> Drawing:
    raise ZeroDivisionError("no runs")


@pytest.mark.parametrize("workers", [1, 2])
def test_one_that_fails_leaves_the_others(tmp_path: Path, workers: int) -> None:
    figures = [Figure(name, name, "", draw, "") for name, draw in (("a", plain), ("b", broken), ("c", plain))]
    shown, errors = draw_figures(tmp_path, "toy/mean", figures, workers)
    assert errors == {"b": "ZeroDivisionError: no runs"}
    assert list(shown) == ["toy-mean-a", "toy-mean-c"]
    assert all(one.svg == (tmp_path / f"{slug}.svg").read_text(encoding="utf-8") for slug, one in shown.items())
    assert sorted(p.suffix for p in tmp_path.iterdir()) == [".png", ".png", ".svg", ".svg"]


def test_without_figures_nothing_is_written(tmp_path: Path) -> None:
    assert draw_figures(tmp_path / "none", "toy/mean", [], 2) == ({}, {}) and not (tmp_path / "none").exists()
