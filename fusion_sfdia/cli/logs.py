"""The commands on logs of readings: `simulate` writes one, `check-log` checks one, `diagnose` isolates the faults in one."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from fusion_sfdia.cli.options import (
    OR_TUNED,
    add_columns,
    add_detector,
    add_ending,
    add_kept_monitor,
    add_plant,
    add_tables,
    add_tuned,
    columns,
    exit_code,
    kept_monitor,
    printed_warnings,
)
from fusion_sfdia.common.numerals import for_json, integer
from fusion_sfdia.detectors.registry import COMMISSIONED


def add_simulate(commands: Any) -> None:
    """Add `simulate`."""
    one = commands.add_parser("simulate", help="write a log of simulated readings", allow_abbrev=False)
    add_plant(one)
    add_tuned(one, "plant")
    one.add_argument("--steps", type=integer, default=360, metavar="N", help="readings (default: 360)")
    one.add_argument("--seed", type=integer, default=0, metavar="N", help="of noise and drawn faults (default: 0)")
    one.add_argument(
        "--truth",
        choices=("finer", "model"),
        default="finer",
        help="readings from the plant's high-fidelity model (default), or from the model that detectors use",
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


def add_diagnose(commands: Any) -> None:
    """Add `diagnose`."""
    one = commands.add_parser("diagnose", help="diagnose the faults in a log", allow_abbrev=False)
    _add_log(one)
    add_detector(one, f"{OR_TUNED}; {COMMISSIONED} with --healthy")
    add_tuned(one)
    add_kept_monitor(one)
    one.add_argument(
        "--healthy",
        metavar="FROM..TO",
        help="a stretch of the log in which all is in order, to tune on first: seconds, as 0..3600, or time stamps of the log, "
        "as 2026-03-01T06:00..2026-03-01T14:20",
    )
    one.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder of the results (default: diagnosis/ and the log's name)",
    )
    one.add_argument("--force", action="store_true", help="replace the diagnosis that is in the folder")
    add_tables(one)
    add_ending(one)
    one.add_argument("--json", action="store_true", help="print the diagnosis as JSON, see diagnosis.schema.json")
    one.set_defaults(work=_diagnose)


def add_check_log(commands: Any) -> None:
    """Add `check-log`."""
    one = commands.add_parser("check-log", help="state how a log is read, and what looks wrong in it", allow_abbrev=False)
    _add_log(one)
    add_tuned(one, "plant")
    one.add_argument("--json", action="store_true", help="print the findings as JSON")
    one.set_defaults(work=_check_log)


def _add_log(one: Any) -> None:
    """The options on a log and its plant."""
    one.add_argument(
        "--data", type=Path, required=True, metavar="LOG", help="the log, CSV or Parquet: a column a sensor, empty for missing"
    )
    one.add_argument("--map", type=Path, metavar="MAP.toml", help="how the log is written, and which column is which sensor")
    add_plant(one)
    add_columns(one)


def _check_log(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.cli.tune import chosen_plant
    from fusion_sfdia.logs.check import check_log
    from fusion_sfdia.logs.problems import LogError

    try:
        found = check_log(chosen.data, chosen_plant(chosen, logged=True), chosen.map, **columns(chosen))
    except LogError as error:
        if chosen.json:
            print(json.dumps([asdict(p) for p in error.problems], indent=2))
        raise
    print(json.dumps([asdict(f) for f in found.findings], indent=2) if chosen.json else found)
    return int(found.misread)


def _simulate(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.cli.tune import chosen_plant
    from fusion_sfdia.diagnosis.fault_draws import draw_apart
    from fusion_sfdia.diagnosis.fault_effects import apply_faults, magnitude_of
    from fusion_sfdia.diagnosis.faults import load_faults
    from fusion_sfdia.diagnosis.simulate import simulate
    from fusion_sfdia.logs.csv_log import write_log

    if chosen.out.is_dir():
        raise ValueError(f"{chosen.out} is a folder; name a file with --out")
    if chosen.out.is_file() and not chosen.force:  # a device or a pipe is written to directly
        raise ValueError(f"{chosen.out} exists; name another file with --out, or replace it with --force")
    model = chosen_plant(chosen)
    named = [_fault(text, model) for text in chosen.fault]
    faults = load_faults(chosen.faults, model) if chosen.faults else []
    faults += draw_apart(named, model, chosen.steps, chosen.seed)
    recording = simulate(model, chosen.steps, [chosen.seed], truth=chosen.truth, process_noise=chosen.process_noise)
    readings = apply_faults(model, recording.t, recording.y, faults, chosen.seed, signal=recording.signal)
    write_log(chosen.out, model, recording.t, readings.y[:, 0], recording.u_of_runs[:, 0])
    if chosen.json:
        print(json.dumps(for_json([asdict(f) for f in faults]), indent=2))
        return 0
    count = len(faults)
    say = partial(print, file=sys.stderr if chosen.out == Path("/dev/stdout") else sys.stdout)
    say(f"{chosen.steps} readings of {len(model.sensors)} sensors in {chosen.out}, {count} fault{'s' * (count != 1)}")
    for f in faults:
        size = magnitude_of(model, f, recording.t, recording.signal[:, 0]) if f.magnitude else 0.0
        say(f"  {f.sensor}: {f.kind} from {f.onset:g} s for {f.length:g} s{_size(f, size, model)}")
    return 0


def _size(fault: Any, size: float, plant: Any) -> str:
    """The size of a fault in words: in the sensor's unit and over its noise; of one relative to the signal its share, too."""
    if not size:
        return ""
    if fault.kind == "scale":
        return f", factor {size:.4g}"
    sensor = plant.sensors[plant.sensor_index(fault.sensor)]
    zero = " above absolute zero" if sensor.unit == "K" else ""
    share = (
        f" ({fault.magnitude:.4g} of the signal, {abs(size / fault.magnitude):.4g} {sensor.unit}{zero})"
        if fault.relative
        else ""
    )
    return f", magnitude {size:.4g} {sensor.unit}{share}, {abs(size) / sensor.noise_sigma:.3g} sigma"


def _fault(text: str, plant: Any) -> tuple[str, str | None]:
    """Return the preset and the quantity (None: any) of "weak-bias:pressure"; ValueError for an unknown preset, and with the
    text of a file for a kind.
    """
    from fusion_sfdia.detectors.registry import require_known
    from fusion_sfdia.diagnosis.fault_draws import PRESETS
    from fusion_sfdia.diagnosis.faults import FAULT_KINDS

    name, colon, quantity = text.partition(":")
    if name in FAULT_KINDS:
        raise ValueError(
            f"fault {text!r} is a kind, to be listed in a file (--faults), such as {_listed(name, quantity, plant)}; "
            f"to be drawn: {', '.join(PRESETS)}"
        )
    if colon and not quantity:
        raise ValueError(f"fault {text!r} has no quantity after its colon; expected NAME or NAME:QUANTITY")
    return require_known("fault", name, PRESETS), quantity or None


def _listed(kind: str, sensor: str, plant: Any) -> str:
    """A file with a fault of this kind, in one line: of the sensor, if it is one, of ten of its sigma or a factor of 1.1."""
    from fusion_sfdia.diagnosis.faults import WITHOUT_MAGNITUDE

    name = sensor if sensor in plant.sensor_names else plant.sensor_names[0]
    size = 1.1 if kind == "scale" else 10 * plant.sensors[plant.sensor_index(name)].noise_sigma
    entry = f'sensor = "{name}", kind = "{kind}", onset = {60 * plant.dt!r}, length = {60 * plant.dt!r}'
    return f"fault = [{{{entry}{'' if kind in WITHOUT_MAGNITUDE else f', magnitude = {size:.4g}'}}}]"


def _diagnose(chosen: argparse.Namespace) -> int:
    if chosen.monitor is not None:
        return _by_monitor(chosen)
    from fusion_sfdia.cli.tune import diagnosing_detector
    from fusion_sfdia.common.files import locked
    from fusion_sfdia.detectors.registry import detector
    from fusion_sfdia.logs.check import check_log
    from fusion_sfdia.report.document import as_json
    from fusion_sfdia.report.log_page import About
    from fusion_sfdia.report.log_report import as_text, diagnose_log, files
    from fusion_sfdia.report.log_units import LogUnits

    out = chosen.out or Path("diagnosis") / chosen.data.stem
    with locked(out, force=chosen.force), printed_warnings():
        name, built, read = diagnosing_detector(chosen)
        read = read or check_log(chosen.data, built.plant, chosen.map, **columns(chosen))
        anew = partial(detector, name) if chosen.tuned is None and chosen.healthy is None else None
        suffix = f".{chosen.tables}"
        found = diagnose_log(chosen.data, built, out, read=read, held=True, detector_name=name, build=anew, suffix=suffix)
    code = exit_code(chosen, found, read)
    shown_in = LogUnits(built.plant, read.columns)
    if chosen.json:
        print(as_json(found, shown_in, read, About(chosen.data.name, name)))
        return code
    print(f"{as_text(shown_in.diagnosis(found), name)}\n{', '.join(files(suffix))}: in {out}")
    if found.health and found.health.suspect and chosen.tuned is None and chosen.healthy is None:
        print(_untuned(chosen))
    return code


def _untuned(chosen: argparse.Namespace) -> str:
    """What to do where a model is suspect that was not tuned."""
    given = "".join(f" --{o} {getattr(chosen, o)}" for o in ("plant", "detector", "map") if getattr(chosen, o) is not None)
    return (
        f"the model was not tuned to the real plant: `fusion-sfdia tune{given} --healthy HEALTHY.csv` does so, on a log "
        "without a fault, then diagnose with --tuned tuned.toml"
    )


def _by_monitor(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.cli.monitor import monitored

    monitor = kept_monitor(chosen)
    say = partial(print, file=sys.stderr if chosen.json else sys.stdout, flush=True)
    return monitored(chosen, chosen.out or Path("diagnosis") / chosen.data.stem, lambda: monitor, say)
