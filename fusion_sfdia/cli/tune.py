"""The command `tune`: a plant and a detector learnt from healthy logs, in a file for `diagnose --tuned`."""

from __future__ import annotations

import argparse
import json
import sys
from datetime import date
from pathlib import Path
from typing import Any

WHICH = "a name that `list` shows, module:attribute or path/file.py:attribute"


def add_tune(commands: Any) -> None:
    """Add `tune`."""
    one = commands.add_parser(
        "tune",
        help="learn noise, parameters and thresholds from healthy logs",
        epilog="A rate counts samples in alarm: 1/day, 2/hour, 0.5/week, or 1e-3 for one in a thousand.",
        allow_abbrev=False,
    )
    one.add_argument("--plant", default="gas-pipeline", help=f"{WHICH} (default: gas-pipeline)")
    one.add_argument(
        "--healthy", type=Path, action="append", required=True, metavar="LOG.csv", help="a healthy log; repeatable"
    )
    one.add_argument("--false-alarm", default="1/day", metavar="RATE", help="stated rate of false alarms (default: 1/day)")
    one.add_argument("--detector", default="loo-glr", help=f"{WHICH} (default: loo-glr)")
    one.add_argument("--absent-sensors", action="store_true", help="treat sensors without a column as missing throughout")
    one.add_argument("--other-columns", action="store_true", help="ignore columns that are no sensors or inputs")
    one.add_argument(
        "--nominal-inputs", action="store_true", help="assume the plant's usual inputs where the log has no column"
    )
    one.add_argument("--out", type=Path, default=Path("tuned.toml"), metavar="TUNED.toml", help="(default: tuned.toml)")
    one.add_argument("--force", action="store_true", help="replace a file that is there")
    one.add_argument("--json", action="store_true", help="print the figures as JSON")
    one.set_defaults(work=_tune)


def tuned_detector(chosen: argparse.Namespace) -> tuple[str, Any]:
    """Name and detector of `diagnose`: as registered, of --tuned, or tuned on the stretch --healthy of the log."""
    from fusion_sfdia import registry
    from fusion_sfdia.logs.csv_log import read_log
    from fusion_sfdia.tuning.stretch import on_stretch
    from fusion_sfdia.tuning.tuned import Tuned

    plant, name = registry.plant(chosen.plant), chosen.detector or "loo-glr"
    if chosen.tuned and chosen.healthy:
        raise ValueError("--tuned and --healthy both state what is healthy; give one")
    if chosen.tuned:
        tuned = Tuned.read(chosen.tuned)
        if chosen.detector and chosen.detector != tuned.detector_name:
            raise ValueError(
                f"{chosen.tuned} was tuned for {tuned.detector_name}, not {chosen.detector}; leave --detector out, or tune "
                f"again with --detector {chosen.detector}"
            )
        try:
            return tuned.detector_name, tuned.detector(plant)
        except ValueError as error:
            raise ValueError(f"{chosen.tuned}: {error}") from error
    if chosen.healthy:
        options = {what: getattr(chosen, what) for what in ("absent_sensors", "other_columns", "nominal_inputs")}
        return name, on_stretch(plant, read_log(chosen.data, plant, **options), chosen.healthy, name).detector(plant)
    return name, registry.detector(name, plant)


def _tune(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.logs.csv_log import read_log
    from fusion_sfdia.registry import plant
    from fusion_sfdia.tuning.tune import Source, tune
    from fusion_sfdia.tuning.words import as_text

    if chosen.out.is_dir() or (chosen.out.is_file() and not chosen.force):
        raise ValueError(f"{chosen.out} exists; name another file with --out, or replace it with --force")
    model = plant(chosen.plant)
    options = {what: getattr(chosen, what) for what in ("absent_sensors", "other_columns", "nominal_inputs")}
    logs = [read_log(path, model, **options) for path in chosen.healthy]
    print(f"fusion-sfdia: learning from {sum(len(log.t) for log in logs)} samples; this may take minutes", file=sys.stderr)
    tuned = tune(
        model,
        *logs,
        false_alarm=chosen.false_alarm,
        detector=chosen.detector,
        sources=[Source(str(path)) for path in chosen.healthy],
        made=date.today().isoformat(),
    )
    tuned.write(chosen.out)
    print(json.dumps(tuned.quality, indent=2) if chosen.json else f"{as_text(tuned)}\nin {chosen.out}")
    return 0
