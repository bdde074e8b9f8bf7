"""The command `monitor`: what healthy logs teach, and what it finds in another log, without a model."""

from __future__ import annotations

import argparse
import csv
import json
import sys
from functools import partial
from pathlib import Path
from textwrap import indent
from typing import Any

from fusion_sfdia.cli.options import add_names, printed_warnings

OWN_FILES = ("monitor.txt", "methods.csv")


def add_monitor(commands: Any) -> None:
    """Add `monitor`."""
    one = commands.add_parser("monitor", help="diagnose a log by healthy ones, without a model", allow_abbrev=False)
    one.add_argument(
        "--healthy", type=Path, action="append", required=True, metavar="LOG.csv", help="a log without a fault; repeatable"
    )
    one.add_argument("--data", type=Path, required=True, metavar="LOG.csv", help="the log to diagnose, of the same columns")
    add_names(one, "--inputs", "columns that act on the plant, such as a load or valves", [])
    add_names(one, "--ignore", "columns that are left out", [])
    one.add_argument("--map", type=Path, metavar="MAP.toml", help="how the logs are written, and which columns are used")
    one.add_argument(
        "--false-alarm", default="0.01", metavar="RATE", help="samples in alarm: 1/day, 2/hour or a share (default: 0.01)"
    )
    one.add_argument("--out", type=Path, metavar="DIR", help="folder of the results (default: monitor/ and the log's name)")
    one.add_argument("--force", action="store_true", help="write into a folder that is in use")
    one.add_argument("--json", action="store_true", help="print the events as JSON")
    one.set_defaults(work=_monitor)


def _monitor(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.core.files import locked

    out = chosen.out or Path("monitor") / chosen.data.stem
    with locked(out, force=chosen.force):
        return _diagnose(chosen, out)


def _diagnose(chosen: argparse.Namespace, out: Path) -> int:
    from fusion_sfdia.core.files import all_or_none, atomic_write
    from fusion_sfdia.core.plain_text import cell, plain
    from fusion_sfdia.logs.log_map import PLAIN_MAP, load_map
    from fusion_sfdia.monitoring.logs import load, signals_of
    from fusion_sfdia.monitoring.monitor import learn_monitor
    from fusion_sfdia.report.log_page import About
    from fusion_sfdia.report.log_report import FILES, write_diagnosis

    say = partial(print, file=sys.stderr if chosen.json else sys.stdout, flush=True)
    log_map = load_map(chosen.map) if chosen.map else PLAIN_MAP
    sensors, inputs = signals_of(chosen.healthy[0], chosen.inputs, chosen.ignore, log_map)
    loaded = {path: load(path, sensors, inputs, log_map) for path in (*chosen.healthy, chosen.data)}
    for path, one in loaded.items():
        say(f"{path}:\n{indent(str(one), '  ')}")
    healthy, data = [loaded[path].log for path in chosen.healthy], loaded[chosen.data]
    count = sum(len(h.t) for h in healthy)
    say(f"learning from {count} healthy samples of {len(sensors)} sensors and {len(inputs)} inputs; this may take minutes ...")
    monitor = learn_monitor(sensors, healthy, inputs=inputs, false_alarm=chosen.false_alarm)
    with printed_warnings():
        found = monitor.diagnose(data.log, data.clock)
    header, rows = found.table()
    notes = (f"thresholds, on other healthy logs: {monitor.methods['bank']}", *([found.expected] if found.expected else []))
    about = About(chosen.data.name, "the leave-one-out bank", notes)
    with all_or_none(out) as new:
        write_diagnosis(new, monitor.choice.plant, found.log.y, found.log.u, found.diagnosis, about)
        with atomic_write(new / "methods.csv") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerows([v if not isinstance(v, str) else cell(plain(v)) for v in row] for row in (header, *rows))
        with atomic_write(new / "monitor.txt") as file:
            file.write(plain(f"{monitor}\n\n{found}\n"))
    say(f"{monitor}\n\n{found}\n{', '.join((*OWN_FILES, *FILES))}: in {out}")
    if chosen.json:
        entries = [dict(zip(header, row, strict=True)) for row in rows]
        print(json.dumps([{k: None if v != v else v for k, v in e.items()} for e in entries], indent=2))
    return int(found.diagnosis.decisions.diverged.any() or any(one.misread for one in loaded.values()))
