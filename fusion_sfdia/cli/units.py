"""`monitor --units`: a log of each of many units of one kind, learnt and diagnosed each, and what differs among them."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from fusion_sfdia.cli.options import drives_of

SUFFIXES = (".csv", ".parquet")
TABLE, PAGE, REPORTS = "units.csv", "units.html", "units"


def diagnose_units(chosen: argparse.Namespace) -> int:
    """Learn and diagnose the logs of --units, and write a table and a page."""
    from fusion_sfdia.common.files import all_or_none, locked
    from fusion_sfdia.learning.monitor.monitor import FALSE_ALARM
    from fusion_sfdia.logs.loaded_log import counted
    from fusion_sfdia.logs.physics import StatedPhysics
    from fusion_sfdia.report.units_page import COLUMNS, write_units

    beside = {"--healthy": chosen.healthy, "--monitor": chosen.monitor, "--data": chosen.data, "--save": chosen.save}
    if given := [name for name, value in beside.items() if value]:
        raise ValueError(
            f"{', '.join(given)} and --units: each unit is learnt from its own log; state its healthy part by --learn"
        )
    if chosen.tables != "csv":
        raise ValueError(f"--tables and --units: {TABLE} and {PAGE} are all that is written; leave --tables out")
    if chosen.fail_on:
        raise ValueError(f"--fail-on and --units: {TABLE} has the state of each unit; leave --fail-on out")
    paths = _paths(chosen.units)
    say = partial(print, file=sys.stderr if chosen.json else sys.stdout, flush=True)
    settings = {
        "inputs": chosen.inputs, "ignore": chosen.ignore, "log_map": chosen.map, "learn": chosen.learn,
        "false_alarm": chosen.false_alarm or FALSE_ALARM, "physics": StatedPhysics(chosen.same, drives_of(chosen.drives)),
    }  # fmt: skip
    out = chosen.out or Path("monitor") / "units"
    with locked(out, force=chosen.force), tempfile.TemporaryDirectory() as folder, _at_work(chosen) as work_off:
        rows, different, pages = _diagnosed(paths, settings, Path(folder), work_off)
        former = [f"{REPORTS}/{path.name}" for path in (out / REPORTS).glob("*.html")]
        with all_or_none(out, instead_of=former) as new:
            if pages:
                (new / REPORTS).mkdir()
            for unit, page in pages.items():
                (new / REPORTS / f"{unit}.html").write_bytes(page)
            write_units(new / TABLE, new / PAGE, rows, different, {unit: f"{REPORTS}/{unit}.html" for unit in pages})
    found = [COLUMNS, *(row.cells for row in rows)]
    widths = [max(len(line[i]) for line in found) for i in range(len(COLUMNS))]
    say("\n".join("  ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)).rstrip() for line in found))
    say("\n".join(map(str, different)) if different else "no unit differs from the others by more than chance gives")
    reports = f", {REPORTS}/ with {counted(len(pages), 'report')}" if pages else ""
    say(f"{TABLE}, {PAGE}{reports}: in {out}")
    if chosen.json:
        print(json.dumps({"units": [row._asdict() for row in rows], "different": [d._asdict() for d in different]}, indent=2))
    return int(any(row.error for row in rows))


def _paths(given: str) -> list[Path]:
    """The logs of a folder or a pattern, by name; ValueError for none, or for two of one name."""
    from glob import glob

    at = Path(given)
    found = sorted(p for p in at.iterdir() if p.suffix in SUFFIXES) if at.is_dir() else sorted(map(Path, glob(given)))
    if not found:
        raise ValueError(
            f"--units {given}: no log; expected a folder of .csv or .parquet files, or a pattern such as 'logs/*.csv'"
        )
    names = [p.stem for p in found]
    if twice := [name for name in dict.fromkeys(names) if names.count(name) > 1]:
        raise ValueError(f"--units {given}: several logs are called {', '.join(twice)}; a unit is named by its file")
    return found


@contextmanager
def _at_work(chosen: argparse.Namespace) -> Iterator[Any]:
    """A function that does pieces of work, in processes or on a dask cluster."""
    from fusion_sfdia.study.experiments.cluster import connected
    from fusion_sfdia.study.experiments.provenance import cores
    from fusion_sfdia.study.experiments.workers import work_off

    with connected(chosen.scheduler) if chosen.scheduler else nullcontext() as on_cluster:
        yield on_cluster or partial(work_off, workers=chosen.workers or cores())


def _diagnosed(
    paths: list[Path], settings: Mapping[str, Any], folder: Path, work_off: Any
) -> tuple[list[Any], list[Any], dict[str, bytes]]:
    """A row of each unit, the units that differ, and the reports of units with findings."""
    from fusion_sfdia.learning.monitor.compared_units import differing
    from fusion_sfdia.plant.signals import Signal
    from fusion_sfdia.report.progress import progress
    from fusion_sfdia.report.units_page import UnitRow
    from fusion_sfdia.study.experiments.parts import read_part
    from fusion_sfdia.study.experiments.workers import Piece

    parts = {folder / f"{k}.npz": path for k, path in enumerate(paths)}
    pieces = [Piece(part, _unit, {**settings, "log": path.absolute()}) for part, path in parts.items()]
    done = {one.path: one for one in progress(work_off(pieces), "units", len(pieces))}
    rows: list[UnitRow] = []
    pages: dict[str, bytes] = {}
    means: dict[tuple[tuple[str, str], ...], dict[str, Any]] = {}
    for part, path in parts.items():
        if error := done[part].error:
            rows.append(UnitRow(path.stem, str(path), error=error))
            continue
        arrays = read_part(part)
        assert arrays is not None
        about = json.loads(str(arrays["about"]))
        rows.append(UnitRow(path.stem, str(path), about["state"], about["verdict"], about["healthy"], tuple(about["found"])))
        if arrays["page"].size:
            pages[path.stem] = arrays["page"].tobytes()
        means.setdefault(tuple((str(n), str(u)) for n, u in about["sensors"]), {})[path.stem] = arrays["means"]
    found = []
    for of_kind, of_units in means.items():  # units of the same columns
        found += differing([Signal(name, unit) for name, unit in of_kind], of_units)
    return rows, found, pages


def _unit(task: Mapping[str, Any]) -> dict[str, Any]:
    """Learn and diagnose one unit, in a process of its own."""
    import numpy as np

    from fusion_sfdia.common.clock import within
    from fusion_sfdia.diagnosis.events import EVEN
    from fusion_sfdia.learning.monitor.channels import pieces_of
    from fusion_sfdia.learning.monitor.compared_units import means_of
    from fusion_sfdia.learning.monitor.held_out import JOINED
    from fusion_sfdia.learning.monitor.monitor import Monitor
    from fusion_sfdia.learning.monitor.unmodelled_logs import load, signals_of
    from fusion_sfdia.logs.loaded_log import counted
    from fusion_sfdia.logs.log_map import PLAIN_MAP, load_map

    log_map = PLAIN_MAP if task["log_map"] is None else load_map(task["log_map"])
    sensors, inputs = signals_of(task["log"], task["inputs"], task["ignore"], log_map)
    read = load(task["log"], sensors, inputs, log_map)
    t = read.log.t
    inside = within(t, task["learn"], read.clock, "--learn") if task["learn"] else np.arange(t.size) < t.size / 2
    healthy = read.log.rows(inside)
    physics = log_map.physics.beside(task["physics"])
    monitor = Monitor.of_logs(
        sensors, [healthy], inputs=inputs, false_alarm=task["false_alarm"], clocks=[read.clock],
        same=physics.same, drives=physics.drives,
    )  # fmt: skip
    found = monitor.diagnose(read)
    state, verdict = str(found.state), found.verdict
    brief = [
        e for e in found.events if e.confidence < EVEN or (e.kind == "undecided" and e.end - e.start < JOINED * monitor.dt)
    ]
    if found.events and len(brief) == len(found.events):
        state, verdict = "healthy", f"no fault; {counted(len(brief), 'brief alarm')}, as the stated rate gives"
    about = {
        "state": state, "verdict": verdict,
        "healthy": f"{read.clock.at(float(healthy.t[0]))} to {read.clock.at(float(healthy.t[-1]))}",
        "found": [found.sentence(e) for e in found.findings], "sensors": [[s.name, s.unit] for s in sensors],
    }  # fmt: skip
    means = [means_of(piece.v) for piece in pieces_of(healthy, monitor.dt)]
    with tempfile.TemporaryDirectory() as folder:
        found = replace(found, source=Path(task["log"]).name)
        page = found.report(Path(folder) / "unit.html").read_bytes() if found.events else b""
    return {
        "about": np.array(json.dumps(about)), "means": np.concatenate(means), "page": np.frombuffer(page, np.uint8),
    }  # fmt: skip
