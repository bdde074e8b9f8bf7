"""The command `monitor`: what healthy logs teach, and what it finds in another log, without a model."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from textwrap import indent
from typing import Any

from fusion_sfdia.cli.options import (
    add_absent_sensors,
    add_ending,
    add_names,
    add_tables,
    drives_of,
    exit_code,
    names,
    printed_warnings,
)
from fusion_sfdia.common.numerals import integer


def add_monitor(commands: Any) -> None:
    """Add `monitor`."""
    one = commands.add_parser("monitor", help="diagnose a log by healthy ones, without a model", allow_abbrev=False)
    one.add_argument("--healthy", type=Path, action="append", metavar="LOG.csv", help="a log without a fault; repeatable")
    one.add_argument("--monitor", type=Path, metavar="FILE", help="what --save has written, in place of --healthy")
    one.add_argument(
        "--update",
        type=Path,
        action="append",
        metavar="LOG.csv",
        help="with --monitor, a later log without a fault, which is learnt as well; repeatable",
    )
    one.add_argument("--save", type=Path, metavar="FILE", help="keep what was learnt, such as in plant.sfdia")
    one.add_argument("--data", type=Path, metavar="LOG.csv", help="the log to diagnose, of the same columns")
    add_names(one, "--inputs", "columns that act on the plant, such as a load or valves", [])
    add_names(one, "--ignore", "columns that are left out", [])
    one.add_argument(
        "--same", type=names, action="append", default=[], metavar="NAME,...",
        help="sensors that measure one quantity, up to an offset and a gain; repeatable",
    )  # fmt: skip
    one.add_argument(
        "--drives", action="append", default=[], metavar="INPUT=NAME,...", help="sensors that move with an input; repeatable"
    )
    add_absent_sensors(one)
    one.add_argument("--map", type=Path, metavar="MAP.toml", help="how the logs are written, and which columns are used")
    one.add_argument(
        "--false-alarm", metavar="RATE", help="alarms in a time, 1/day, 2/week, or the share of rows in alarm (default: 0.01)"
    )
    one.add_argument(
        "--units",
        metavar="LOGS",
        help="a folder or a pattern such as 'logs/*.csv', a log a unit of one kind: each is learnt and "
        "diagnosed, and they are compared",
    )
    one.add_argument("--learn", metavar="FROM..TO", help="with --units, the healthy part of each log (default: its first half)")
    one.add_argument("--workers", type=integer, metavar="N", help="with --units, processes (default: one a core)")
    one.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="with --units, work on a running dask cluster that sees the same files, such as tcp://host:8786; on a trusted "
        "network only, else tls://",
    )
    one.add_argument("--out", type=Path, metavar="DIR", help="folder of the results (default: monitor/ and the log's name)")
    one.add_argument("--force", action="store_true", help="replace the diagnosis that is in the folder")
    add_tables(one)
    add_ending(one)
    one.add_argument("--json", action="store_true", help="print the diagnosis as JSON, see diagnosis.schema.json")
    one.set_defaults(work=_monitor)


def _monitor(chosen: argparse.Namespace) -> int:
    if chosen.units:
        from fusion_sfdia.cli.units import diagnose_units

        return diagnose_units(chosen)
    if given := [f"--{name}" for name in ("learn", "workers", "scheduler") if getattr(chosen, name)]:
        raise ValueError(
            f"{', '.join(given)} without --units: the logs of units are learnt in parts and side by side; leave it out"
        )
    if bool(chosen.healthy) == bool(chosen.monitor):
        raise ValueError("state healthy logs with --healthy, or what was learnt from them before with --monitor")
    learning = (chosen.inputs, chosen.ignore, chosen.same, chosen.drives, chosen.false_alarm, chosen.save and not chosen.update)
    if chosen.monitor and any(learning):
        raise ValueError(
            "--inputs, --ignore, --same, --drives, --false-alarm and --save are for learning; leave them out beside --monitor"
        )
    if chosen.update and not (chosen.monitor and chosen.save):
        raise ValueError(
            "--update takes later logs into what --monitor has; state both, and where to keep the new one with --save"
        )
    if not (chosen.data or chosen.save):
        raise ValueError("state the log to diagnose with --data, or where to keep what is learnt with --save")
    say = partial(print, file=sys.stderr if chosen.json else sys.stdout, flush=True)
    if chosen.data is None:
        _learnt(chosen, say)
        return 0
    return monitored(chosen, chosen.out or Path("monitor") / chosen.data.stem, partial(_learnt, chosen, say), say)


def _learnt(chosen: argparse.Namespace, say: Any) -> Any:
    """The monitor: read, or learnt and, where that is asked for, saved."""
    from fusion_sfdia.learning.monitor.monitor import FALSE_ALARM, Monitor
    from fusion_sfdia.report.progress import progress

    if chosen.monitor and not chosen.update:
        return Monitor.load(chosen.monitor)
    if chosen.update:
        monitor = Monitor.load(chosen.monitor).update(chosen.update, log_map=chosen.map, each=progress)
    else:
        monitor = Monitor.fit(
            chosen.healthy, inputs=chosen.inputs, ignore=chosen.ignore, log_map=chosen.map, each=progress,
            same=chosen.same, drives=drives_of(chosen.drives),
            false_alarm=chosen.false_alarm or FALSE_ALARM, say=lambda path, log: say(f"{path}:\n{indent(str(log), '  ')}"),
        )  # fmt: skip
    if chosen.save:
        monitor.save(chosen.save)
        say(f"{chosen.save}: what was learnt")
    say(str(monitor))
    return monitor


def monitored(chosen: argparse.Namespace, out: Path, learnt: Any, say: Any) -> int:
    """Diagnose the log `chosen.data` into a folder, with the monitor that `learnt` gives."""
    from fusion_sfdia.common.files import all_or_none, atomic_write, locked
    from fusion_sfdia.common.plain_text import plain
    from fusion_sfdia.report.document import as_json
    from fusion_sfdia.report.log_page import About
    from fusion_sfdia.report.log_report import OF_BEFORE, OWN_FILE, as_text, files, require_apart, write_diagnosis
    from fusion_sfdia.report.log_units import LogUnits
    from fusion_sfdia.report.progress import progress
    from fusion_sfdia.report.sample_tables import require_tables

    suffix = f".{chosen.tables}"
    require_apart(chosen.data, out)
    require_tables(suffix)
    with locked(out, force=chosen.force):
        monitor = learnt()
        data = monitor.read(chosen.data, chosen.map, absent_sensors=chosen.absent_sensors)
        say(f"{chosen.data}:\n{indent(str(data), '  ')}")
        with printed_warnings():
            found = monitor.diagnose(data, each=progress)
        of_log = LogUnits(found.plant, data.columns)
        about = About(chosen.data.name, found.detector, found.misread, found.basis)
        with all_or_none(out, instead_of=OF_BEFORE) as new:
            write_diagnosis(new, found.plant, found.log.y, found.log.u, found, about, of_log, suffix)
            with atomic_write(new / OWN_FILE) as file:
                file.write(plain(f"{monitor}\n\n{found}\n"))
    known = [*str(monitor).splitlines(), *str(data).splitlines()]  # was said when it was learnt, and read
    news = replace(of_log.diagnosis(found), of_log=tuple(line for line in found.of_log if line not in known))
    say(f"{as_text(news, about.detector)}\n{', '.join((OWN_FILE, *files(suffix)))}: in {out}")
    if chosen.json:
        print(as_json(found, of_log, data, about))
    return exit_code(chosen, found, data)
