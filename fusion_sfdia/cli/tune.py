"""The command `tune`: a plant and a detector learnt from healthy logs, in a file for `diagnose --tuned`."""

from __future__ import annotations

import argparse
import json
import sys
import warnings
from contextlib import nullcontext
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fusion_sfdia.cli.options import (
    add_columns,
    add_detector,
    add_names,
    add_plant,
    columns,
    loaded,
    named_detector,
    printed_warnings,
    warn,
    warn_of,
)
from fusion_sfdia.detectors.registry import COMMISSIONED, DEFAULT_DETECTOR

if TYPE_CHECKING:
    from fusion_sfdia.detectors.registry import NamedDetector
    from fusion_sfdia.plant.plant import Plant


def add_tune(commands: Any) -> None:
    """Add `tune`."""
    one = commands.add_parser(
        "tune",
        help="learn noise, parameters and thresholds from healthy logs",
        epilog="A rate counts samples in alarm: 1/day, 2/hour, 0.5/week, or 1e-3 for one in a thousand.",
        allow_abbrev=False,
    )
    add_plant(one)
    one.add_argument(
        "--healthy", type=Path, action="append", required=True, metavar="LOG", help="a healthy log, CSV or Parquet; repeatable"
    )
    one.add_argument("--map", type=Path, metavar="MAP.toml", help="how the logs are written, and which column is which sensor")
    one.add_argument("--false-alarm", default="1/day", metavar="RATE", help="stated rate of false alarms (default: 1/day)")
    add_detector(one, COMMISSIONED)
    add_columns(one)
    add_names(
        one, "--further", "columns of which the model predicts nothing, to be learnt by a monitor beside it; all: every other "
        "column of numbers",
    )  # fmt: skip
    one.add_argument("--out", type=Path, default=Path("tuned.toml"), metavar="TUNED.toml", help="(default: tuned.toml)")
    one.add_argument("--strict", action="store_true", help="refuse a log with readings that are not healthy")
    one.add_argument("--force", action="store_true", help="replace a file that is there")
    one.add_argument("--json", action="store_true", help="print the figures as JSON")
    one.set_defaults(work=_tune)


def tuned_plant(plant: Plant, file: Path, *, logged: bool = False) -> Plant:
    """The plant with what a tuned file has learnt; logged: also with its further channels, as logs have them. ValueError, which
    names the file, where it is of another plant.
    """
    from fusion_sfdia.learning.tuning.tuned import Tuned

    found = Tuned.read(file)
    try:
        with printed_warnings():
            return found.logged_plant(plant) if logged else found.plant(plant)
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from error


def chosen_plant(chosen: argparse.Namespace, *, logged: bool = False) -> Plant:
    """The plant of --plant, with what the file of --tuned has learnt where one is given, see `tuned_plant`."""
    from fusion_sfdia.detectors.registry import plant

    made = plant(chosen.plant)
    return made if chosen.tuned is None else tuned_plant(made, chosen.tuned, logged=logged)


def tuned_entry(plant: str, detector: str | None, file: Path) -> NamedDetector:
    """The detector of a tuned file under its name; what there is to warn of, `tuned_plant` says."""
    from fusion_sfdia.detectors import registry

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        name, built = bound_detector(plant, detector, file, simulated=True)
    return registry.NamedDetector(name, f"as tuned in {file}", lambda of: built)


def bound_detector(plant: str, detector: str | None, tuned: Path | None, *, simulated: bool = False) -> tuple[str, Any]:
    """Name and object of a detector on a plant: of a tuned file, or as registered (the default where none is named).

    simulated: for simulated readings, which have no further channels: the detector of the model alone.
    """
    from fusion_sfdia.detectors import registry

    if tuned is None:
        name = detector or DEFAULT_DETECTOR
        return name, registry.detector(name, registry.plant(plant))
    from fusion_sfdia.learning.tuning.tuned import Tuned

    found = Tuned.read(tuned)
    try:
        with printed_warnings():
            entry = found.entry(detector)
            build = found.model_detector if simulated else found.detector
            return entry.name, build(registry.plant(plant), entry)
    except ValueError as error:
        raise ValueError(f"{tuned}: {error}") from error


def diagnosing_detector(chosen: argparse.Namespace) -> tuple[str, Any, Any]:
    """Name and object of the detector of `diagnose`; tuned on the stretch --healthy of the log, also that log, else None."""
    if chosen.healthy is None:
        return *bound_detector(chosen.plant, chosen.detector, chosen.tuned), None
    from fusion_sfdia.detectors import registry
    from fusion_sfdia.learning.tuning.tune import on_stretch
    from fusion_sfdia.logs.check import check_log, without_suspects

    if chosen.tuned:
        raise ValueError("--tuned and --healthy both state what is healthy; give one")
    plant, name = registry.plant(chosen.plant), named_detector(chosen)
    whole = check_log(chosen.data, plant, chosen.map, **columns(chosen))
    tuned = on_stretch(plant, without_suspects(plant, whole).log, chosen.healthy, name, whole.clock)
    for remark in tuned.quality["remarks"]:
        warn(f"--healthy {chosen.healthy}: {remark}")
    return name, tuned.detector(plant), whole


def _tune(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.common.files import locked_file

    with locked_file(chosen.out):
        return _tuned(chosen)


def _tuned(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.detectors.registry import find_detector, plant
    from fusion_sfdia.learning.model_and_monitor import with_further
    from fusion_sfdia.learning.monitor.unmodelled_logs import further_signals
    from fusion_sfdia.learning.tuning.tune import HealthySource, tune
    from fusion_sfdia.learning.tuning.words import as_text
    from fusion_sfdia.report.progress import progress, working

    if chosen.out.is_dir() or (chosen.out.is_file() and not chosen.force):
        raise ValueError(f"{chosen.out} exists; name another file with --out, or replace it with --force")
    model = plant(chosen.plant)
    further = further_signals(chosen.healthy[0], model, chosen.further, chosen.map) if chosen.further else ()
    whole = with_further(model, further)
    logs = [loaded(chosen, path, whole) for path in chosen.healthy]
    for path, one in zip(chosen.healthy, logs, strict=True):
        warn_of(path, one.brief)
    count = sum(len(one.log.t) for one in logs)
    print(f"fusion-sfdia: learning from {count} samples; this may take minutes", file=sys.stderr)
    detector = named_detector(chosen)
    with nullcontext() if find_detector(detector).commissions else working("learning"):  # of those no steps are known
        tuned = tune(
            model,
            *(one.log for one in logs),
            further=further,
            false_alarm=chosen.false_alarm,
            detector=detector,
            each=progress,
            strict=chosen.strict,
            sources=[HealthySource(str(path), one.clock) for path, one in zip(chosen.healthy, logs, strict=True)],
            made=date.today().isoformat(),
        )
    tuned.write(chosen.out)
    print(json.dumps(tuned.quality, indent=2) if chosen.json else f"{as_text(tuned)}\nin {chosen.out}")
    return 0
