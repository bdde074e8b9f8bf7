"""The command line: list what there is, run scenarios, simulate a log, diagnose a log, measure the speed."""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fusion_sfdia import __version__

if TYPE_CHECKING:
    from fusion_sfdia.faults import Fault
    from fusion_sfdia.plant import Plant

KINDS = ("plants", "detectors", "faults", "scenarios")
SETTLE = 30  # samples before the first drawn fault: a filter has forgotten how it began


def parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    top = argparse.ArgumentParser(
        prog="fusion-sfdia", description="Sensor-fault detection, isolation and accommodation.", allow_abbrev=False
    )
    top.add_argument("--version", action="version", version=f"fusion-sfdia {__version__}")
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND")

    one = commands.add_parser("list", help="list plants, detectors, faults and scenarios by name", allow_abbrev=False)
    one.add_argument("kind", nargs="?", choices=KINDS, help="only these")
    one.add_argument("--json", action="store_true", help="print JSON")
    one.set_defaults(work=_list)

    one = commands.add_parser("run", help="run scenarios and write a report", allow_abbrev=False)
    one.add_argument("scenario", nargs="+", help="a name, or a glob such as 'pipeline/*'")
    size = one.add_mutually_exclusive_group()
    size.add_argument("--seeds", type=int, metavar="N", help="runs of each scenario")
    size.add_argument("--full", action="store_true", help="as many runs as the paper")
    one.add_argument("--workers", type=int, metavar="N", help="processes (default: one a core)")
    one.add_argument(
        "--out", type=Path, metavar="DIR", help="folder of the results (default: results/ and the scenario's name)"
    )
    one.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="change a setting of the scenarios")
    one.add_argument("--force", action="store_true", help="write into a folder that is in use for something else")
    one.add_argument("--json", action="store_true", help="print the rows of metrics.csv as JSON")
    one.set_defaults(work=_run)

    one = commands.add_parser("simulate", help="write a log of simulated readings", allow_abbrev=False)
    one.add_argument("--plant", default="gas-pipeline", help="default: gas-pipeline")
    one.add_argument("--steps", type=int, default=360, metavar="N", help="readings (default: 360)")
    one.add_argument("--seed", type=int, default=0, metavar="N", help="of noise and drawn faults (default: 0)")
    one.add_argument(
        "--truth",
        choices=("finer", "model"),
        default="finer",
        help="readings from the plant's finer twin (default), or from the model that detectors use",
    )
    one.add_argument("--process-noise", action="store_true", help="disturb the truth by the plant's process noise")
    one.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="NAME[:QUANTITY]",
        help="draw a fault such as weak-bias:pressure; repeatable",
    )
    one.add_argument("--faults", type=Path, metavar="FILE.toml", help="faults as [[fault]] tables")
    one.add_argument("--out", type=Path, required=True, metavar="LOG.csv", help="the log to write")
    one.add_argument("--force", action="store_true", help="replace a log that is there")
    one.add_argument("--json", action="store_true", help="print the faults as JSON")
    one.set_defaults(work=_simulate)

    one = commands.add_parser("diagnose", help="find the faults in a log", allow_abbrev=False)
    one.add_argument(
        "--data", type=Path, required=True, metavar="LOG.csv", help="the log: a column a sensor, empty for missing"
    )
    one.add_argument("--plant", default="gas-pipeline", help="default: gas-pipeline")
    one.add_argument("--detector", default="loo-glr", help="default: loo-glr")
    one.add_argument("--absent-sensors", action="store_true", help="take sensors without a column as missing throughout")
    one.add_argument("--other-columns", action="store_true", help="ignore columns that are no sensors or inputs")
    one.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder of the results (default: diagnosis/ and the log's name)",
    )
    one.add_argument("--force", action="store_true", help="write into a folder that is in use")
    one.add_argument("--json", action="store_true", help="print the events as JSON")
    one.set_defaults(work=_diagnose)

    one = commands.add_parser("bench", help="measure the speed on this machine, on one thread", allow_abbrev=False)
    one.add_argument("part", nargs="*", help="bank, model, scaling, lorenz (default: all)")
    one.add_argument("--seconds", type=float, default=2.0, metavar="S", help="for each thing that is timed (default: 2)")
    one.add_argument("--out", type=Path, metavar="DIR", help="folder for metrics.csv")
    one.add_argument("--json", action="store_true", help="print the rows of metrics.csv as JSON")
    one.set_defaults(work=_bench)
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    """Do what a command line says; return its exit code: 0 done, 1 some work failed, 2 it cannot be done, 130 interrupted."""
    chosen = parser().parse_args(arguments)
    terminated = signal.signal(signal.SIGTERM, signal.default_int_handler)  # both leave nothing half-written, no worker behind
    try:
        code: int = chosen.work(chosen)
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # the reader of our output has had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        resumes = "; the same command goes on where it stood" if chosen.command == "run" else ""
        print(f"fusion-sfdia: interrupted{resumes}", file=sys.stderr)
        return 130
    except (ValueError, ArithmeticError, OSError, RuntimeError) as error:
        text = str(error)
        if isinstance(error, OSError) and error.filename:
            text = f"{error.filename}: {error.strerror}; name a file that is there, or a folder that can be written to"
        print(f"fusion-sfdia: {' '.join(text.split())}", file=sys.stderr)
        return 1 if isinstance(error, RuntimeError) else 2
    finally:
        signal.signal(signal.SIGTERM, terminated)


def _list(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.benchmarks.registry import listing

    found = {kind: entries for kind, entries in listing().items() if chosen.kind in (None, kind)}
    if chosen.json:
        print(json.dumps(found, indent=2, ensure_ascii=False))
        return 0
    for kind, entries in found.items():
        if chosen.kind is None:
            print(f"{kind}:")
        width = max((len(e["name"]) for e in entries), default=0)
        for entry in entries:
            print(f"  {entry['name']:<{width}}  {entry['about']}".rstrip())
    return 0


def _run(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.benchmarks.registry import match_scenarios, scenario
    from fusion_sfdia.benchmarks.results import as_json
    from fusion_sfdia.benchmarks.runner import run_scenarios

    names = match_scenarios(chosen.scenario)
    changes = dict(_setting(text) for text in chosen.set)
    out = chosen.out or Path("results") / "-".join(chosen.scenario).replace("/", "-").replace("*", "all")
    outcome = run_scenarios(
        [scenario(name) for name in names],
        out,
        seeds=chosen.seeds,
        full=chosen.full,
        changes=changes,
        workers=chosen.workers,
        force=chosen.force,
    )
    if chosen.json:
        print(as_json(outcome.rows))
    else:
        for line in outcome.highlights:
            print(line)
        print(f"{len(outcome.rows)} numbers in {out / 'metrics.csv'}; report: {outcome.report}")
    for line in outcome.failures:
        print(f"fusion-sfdia: failed: {' '.join(line.split())}", file=sys.stderr)
    return 1 if outcome.failures else 0


def _setting(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not (key and equals):
        raise ValueError(f"--set {text}: wanted KEY=VALUE")
    return key, value


def _simulate(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.benchmarks.registry import plant
    from fusion_sfdia.faults import apply, load_faults
    from fusion_sfdia.logs import write_log
    from fusion_sfdia.simulate import simulate

    if chosen.out.exists() and not chosen.force:
        raise ValueError(f"{chosen.out} exists; name another file with --out, or replace it with --force")
    model = plant(chosen.plant)
    faults = [*(load_faults(chosen.faults, model) if chosen.faults else ()), *_drawn(chosen, model)]
    recording = simulate(model, chosen.steps, [chosen.seed], truth=chosen.truth, process_noise=chosen.process_noise)
    readings = apply(model, recording.t, recording.y, faults, chosen.seed, signal=recording.signal)
    write_log(chosen.out, model, recording.t, readings.y[:, 0], recording.u)
    if chosen.json:
        print(json.dumps([{k: _finite(v) for k, v in asdict(f).items()} for f in faults], indent=2))
        return 0
    count = len(faults)
    print(f"{chosen.steps} readings of {len(model.sensors)} sensors in {chosen.out}, {count} fault{'s' * (count != 1)}")
    for f in faults:
        size = "" if not f.magnitude else f", magnitude {f.magnitude:.4g}{' of the signal' if f.relative else ''}"
        print(f"  {f.sensor}: {f.kind} from {f.onset:g} s for {f.length:g} s{size}")
    return 0


def _drawn(chosen: argparse.Namespace, model: Plant) -> list[Fault]:
    """Faults drawn by name, each on another sensor."""
    from fusion_sfdia.benchmarks.registry import require_known
    from fusion_sfdia.fault_draws import PRESETS, draw
    from fusion_sfdia.random_streams import stream

    window = (min(SETTLE + 1, chosen.steps) * model.dt, max(SETTLE + 1, chosen.steps - 40) * model.dt)
    faults: list[Fault] = []
    for number, text in enumerate(chosen.fault):
        name, _, quantity = text.partition(":")
        require_known("fault", name, PRESETS)
        rng = stream(chosen.seed, "faults", number)
        taken = {f.sensor for f in faults}
        while (fault := draw(name, model, rng, window=window, quantity=quantity or None)[0]).sensor in taken:
            if taken >= set(model.sensor_names):
                raise ValueError(f"{len(chosen.fault)} faults on {len(model.sensors)} sensors; draw fewer")
        faults.append(fault)
    return faults


def _diagnose(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.benchmarks.diagnosis import FILES, require_free, write_diagnosis
    from fusion_sfdia.benchmarks.registry import detector, plant
    from fusion_sfdia.diagnose import diagnose
    from fusion_sfdia.logs import read_log

    model = plant(chosen.plant)
    log = read_log(chosen.data, model, absent_sensors=chosen.absent_sensors, other_columns=chosen.other_columns)
    out = chosen.out or Path("diagnosis") / chosen.data.stem
    with_detector = detector(chosen.detector, model)
    require_free(out, force=chosen.force)
    found = diagnose(with_detector, *log)
    write_diagnosis(out, model, log.y, log.u, found)
    if chosen.json:
        print(json.dumps([{k: _finite(v) for k, v in asdict(e).items()} for e in found.events], indent=2))
        return 0
    count = len(found.events)
    print(f"{len(log.t)} readings, {count} event{'s' * (count != 1)} by {chosen.detector}")
    for e in found.events:
        end = "end of the log" if e.open else f"{e.end:g} s"
        print(f"  {e.hypothesis}: {e.start:g} s to {end}, size {e.size:.4g} {e.unit}")
    print(f"{', '.join(FILES)}: in {out}")
    return 0


def _bench(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.benchmarks import bench
    from fusion_sfdia.benchmarks.results import as_json

    rows = bench.run(chosen.part, chosen.out, chosen.seconds)
    print(as_json(rows) if chosen.json else "\n".join(bench.as_text(row) for row in rows))
    return 0


def _finite(value: Any) -> Any:
    """A JSON value: infinities and NaN are null."""
    return None if isinstance(value, float) and not abs(value) < float("inf") else value
