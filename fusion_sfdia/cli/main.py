"""The command line: list what there is, run scenarios, compare detectors, simulate a log, diagnose a log, measure the speed."""

from __future__ import annotations

import argparse
import errno
import io
import json
import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from fusion_sfdia import __version__
from fusion_sfdia.cli.runs import add_compare, add_run
from fusion_sfdia.core.numerals import decimal, integer

KINDS = ("plants", "detectors", "faults", "scenarios")


def parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    top = argparse.ArgumentParser(
        prog="fusion-sfdia",
        description="Sensor-fault detection, isolation and accommodation.",
        epilog="Exit codes: 0 done, 1 some work failed or diverged, 2 input that does not fit, 130 interrupted.",
        allow_abbrev=False,
    )
    top.add_argument("--version", action="version", version=f"fusion-sfdia {__version__}")
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND")

    one = commands.add_parser("list", help="list plants, detectors, faults and scenarios by name", allow_abbrev=False)
    one.add_argument("kind", nargs="?", choices=KINDS, help="only these")
    one.add_argument("--json", action="store_true", help="print JSON")
    one.set_defaults(work=_list)

    add_run(commands, _run)
    add_compare(commands, _run)

    one = commands.add_parser("simulate", help="write a log of simulated readings", allow_abbrev=False)
    one.add_argument("--plant", default="gas-pipeline", help="default: gas-pipeline")
    one.add_argument("--steps", type=integer, default=360, metavar="N", help="readings (default: 360)")
    one.add_argument("--seed", type=integer, default=0, metavar="N", help="of noise and drawn faults (default: 0)")
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
        "--nominal-inputs", action="store_true", help="assume the plant's usual inputs where the log has no column"
    )
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
    one.add_argument("part", nargs="*", help="bank, model, scaling, lorenz, engine (default: all)")
    one.add_argument("--seconds", type=decimal, default=2.0, metavar="S", help="for each thing that is timed (default: 2)")
    one.add_argument("--out", type=Path, metavar="DIR", help="folder for metrics.csv")
    one.add_argument("--force", action="store_true", help="write into a folder that is in use")
    one.add_argument("--json", action="store_true", help="print the rows of metrics.csv as JSON")
    one.set_defaults(work=_bench)
    return top


def main(arguments: Sequence[str] | None = None) -> int:
    """Do what a command line says; return its exit code (see the parser's epilog)."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal without π shows \\u03c0
            stream.reconfigure(errors="backslashreplace")
    chosen = parser().parse_args(arguments)
    with _terminated_as_interrupted():
        return _done(chosen)


@contextmanager
def _terminated_as_interrupted() -> Iterator[None]:
    """SIGTERM as Ctrl-C: both leave nothing half-written and no worker behind. Elsewhere than in the main thread as it is."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _done(chosen: argparse.Namespace) -> int:
    try:
        code: int = chosen.work(chosen)
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # the reader of our output has had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        resumes = "; the same command goes on where it stood" if chosen.command in ("run", "compare") else ""
        print(f"fusion-sfdia: interrupted{resumes}", file=sys.stderr)
        return 130
    except (ValueError, ArithmeticError, OSError, RuntimeError, MemoryError, ModuleNotFoundError) as error:
        from fusion_sfdia.core.files import explained

        print(f"fusion-sfdia: {' '.join(explained(error).split())}", file=sys.stderr)
        full = getattr(error, "errno", 0) in (errno.ENOSPC, errno.EDQUOT)
        at_fault = isinstance(error, ValueError | OverflowError | OSError) and not isinstance(error, ModuleNotFoundError)
        return 2 if at_fault and not full else 1


def _list(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.registry import listing

    found = {kind: entries for kind, entries in listing().items() if chosen.kind in (None, kind)}
    if chosen.json:
        print(json.dumps(found, indent=2))
        return 0
    for kind, entries in found.items():
        if chosen.kind is None:
            print(f"{kind}:")
        width = max((len(e["name"]) for e in entries), default=0)
        use = None
        for entry in entries:
            if use != (use := entry.get("use")):
                print(f" {use}:")
            print(f"  {entry['name']:<{width}}  {entry['about']}".rstrip())
    return 0


def _run(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.evaluation.results import as_json
    from fusion_sfdia.experiments.runner import run_scenarios
    from fusion_sfdia.registry import match_scenarios, scenario

    changes = _settings(chosen.set)
    names = match_scenarios(chosen.scenario)
    out = chosen.out or Path("results") / "-".join(chosen.scenario).replace("/", "-").replace("*", "all")
    outcome = run_scenarios(
        [scenario(name) for name in names],
        out,
        seeds=chosen.seeds,
        full=chosen.full,
        changes=changes,
        workers=chosen.workers,
        scheduler=chosen.scheduler,
        force=chosen.force,
    )
    if chosen.json:
        print(as_json(outcome.rows))
    else:
        for line in outcome.highlights:
            print(line)
        print(f"{len(outcome.rows)} numbers in {out / 'metrics.csv'}; report: {outcome.report}")
    for line in outcome.notes:
        print(f"fusion-sfdia: note: {line}", file=sys.stderr)
    for line in outcome.failures:
        print(f"fusion-sfdia: failed: {' '.join(line.split())}", file=sys.stderr)
    return 1 if outcome.failures else 0


def _settings(texts: Sequence[str]) -> dict[str, str]:
    found: dict[str, str] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not (key and equals):
            raise ValueError(f"--set {text}: expected KEY=VALUE")
        if key in found:
            raise ValueError(f"setting {key} is given twice, as {found[key]!r} and {value!r}; give it once")
        found[key] = value
    return found


def _simulate(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.evaluation.fault_draws import draw_apart
    from fusion_sfdia.evaluation.fault_effects import apply_faults
    from fusion_sfdia.evaluation.faults import load_faults
    from fusion_sfdia.evaluation.logs import write_log
    from fusion_sfdia.evaluation.simulate import simulate
    from fusion_sfdia.registry import fault, plant

    if chosen.out.is_dir():
        raise ValueError(f"{chosen.out} is a folder; name a file with --out")
    if chosen.out.is_file() and not chosen.force:  # a device or a pipe is written to, not replaced
        raise ValueError(f"{chosen.out} exists; name another file with --out, or replace it with --force")
    model, named = plant(chosen.plant), [fault(text) for text in chosen.fault]
    faults = load_faults(chosen.faults, model) if chosen.faults else []
    faults += draw_apart(named, model, chosen.steps, chosen.seed)
    recording = simulate(model, chosen.steps, [chosen.seed], truth=chosen.truth, process_noise=chosen.process_noise)
    readings = apply_faults(model, recording.t, recording.y, faults, chosen.seed, signal=recording.signal)
    write_log(chosen.out, model, recording.t, readings.y[:, 0], recording.u_of_runs[:, 0])
    if chosen.json:
        print(json.dumps([{k: _finite(v) for k, v in asdict(f).items()} for f in faults], indent=2))
        return 0
    count = len(faults)
    say = partial(print, file=sys.stderr if chosen.out == Path("/dev/stdout") else sys.stdout)
    say(f"{chosen.steps} readings of {len(model.sensors)} sensors in {chosen.out}, {count} fault{'s' * (count != 1)}")
    for f in faults:
        size = "" if not f.magnitude else f", magnitude {f.magnitude:.4g}{' of the signal' if f.relative else ''}"
        say(f"  {f.sensor}: {f.kind} from {f.onset:g} s for {f.length:g} s{size}")
    return 0


def _diagnose(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.registry import detector, plant
    from fusion_sfdia.report.log_report import FILES, as_text, diagnose_log

    out = chosen.out or Path("diagnosis") / chosen.data.stem
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", UserWarning)
        found = diagnose_log(
            chosen.data,
            detector(chosen.detector, plant(chosen.plant)),
            out,
            absent_sensors=chosen.absent_sensors,
            other_columns=chosen.other_columns,
            nominal_inputs=chosen.nominal_inputs,
            force=chosen.force,
        )
    for warning in told:
        print(f"fusion-sfdia: warning: {warning.message}", file=sys.stderr)
    code = int(found.decisions.diverged.any())
    if chosen.json:
        print(json.dumps([{k: _finite(v) for k, v in asdict(e).items()} for e in found.events], indent=2))
        return code
    print(f"{as_text(found, chosen.detector)}\n{', '.join(FILES)}: in {out}")
    return code


def _bench(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.benchmarks.speed import bench
    from fusion_sfdia.evaluation.results import as_json

    rows = bench.run(chosen.part, chosen.out, chosen.seconds, force=chosen.force)
    print(as_json(rows) if chosen.json else "\n".join(bench.as_text(row) for row in rows))
    return 0


def _finite(value: Any) -> Any:
    """A JSON value: infinities and NaN are null."""
    return None if isinstance(value, float) and not abs(value) < float("inf") else value
