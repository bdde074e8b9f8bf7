"""Options that several commands have, and the warnings that they print."""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fusion_sfdia.detectors.registry import COMMISSIONED, DEFAULT_DETECTOR

if TYPE_CHECKING:
    from fusion_sfdia.diagnosis.diagnose import Diagnosis
    from fusion_sfdia.logs.loaded_log import LoadedLog
    from fusion_sfdia.plant.plant import Plant

WHICH = "a name that `list` shows, module:attribute or path/file.py:attribute"
OR_TUNED = f"{DEFAULT_DETECTOR}, or that of --tuned where `list` shows it"
PLANT = "gas-pipeline"
FAIL_ON, FOUND = ("fault", "process", "suspect"), 3  # the last is the exit code
OF_COLUMNS = ("absent_sensors", "other_columns", "nominal_inputs")


def add_plant(one: Any) -> None:
    """Add --plant."""
    one.add_argument("--plant", default=PLANT, help=f"{WHICH}, or a model.fmu (default: {PLANT})")


def add_detector(one: Any, otherwise: str = DEFAULT_DETECTOR) -> None:
    """Add --detector; None where it is not given. otherwise: which one is used then."""
    one.add_argument("--detector", help=f"{WHICH} (default: {otherwise})")


def named_detector(chosen: argparse.Namespace) -> str:
    """The detector of a command: as named, or the default, which is another one where a healthy log is learnt from."""
    learns = chosen.command == "tune" or getattr(chosen, "healthy", None)
    return str(chosen.detector or (COMMISSIONED if learns else DEFAULT_DETECTOR))


def add_tuned(one: Any, what: str = "plant and detector") -> None:
    """Add --tuned."""
    one.add_argument("--tuned", type=Path, metavar="TUNED.toml", help=f"the {what} that `tune` has tuned")


def add_kept_monitor(one: Any) -> None:
    """Add --monitor, in place of a plant and a detector."""
    one.add_argument("--monitor", type=Path, metavar="FILE", help="judge by what `monitor --save` has kept, without a model")


def kept_monitor(chosen: argparse.Namespace) -> Any:
    """The monitor of --monitor; ValueError where a plant or a detector is stated beside it."""
    from fusion_sfdia.learning.monitor.monitor import Monitor

    stated = {"--detector": chosen.detector, "--tuned": chosen.tuned, "--healthy": getattr(chosen, "healthy", None)}
    stated |= {f"--{name.replace('_', '-')}": getattr(chosen, name) for name in OF_COLUMNS if name != "absent_sensors"}
    stated["--plant"] = chosen.plant != PLANT
    if given := [name for name, value in stated.items() if value]:
        raise ValueError(
            f"{', '.join(given)} and --monitor: a monitor has no model, and knows its columns; leave one of them out"
        )
    return Monitor.load(chosen.monitor)


def add_columns(one: Any, inputs: str = "where the log has no column") -> None:
    """Add what may be lacking in a log, or too much; see `columns`. inputs: where the plant's usual ones are assumed."""
    add_absent_sensors(one)
    one.add_argument("--other-columns", action="store_true", help="ignore columns that are no sensors or inputs")
    one.add_argument("--nominal-inputs", action="store_true", help=f"assume the plant's usual inputs {inputs}")


def add_absent_sensors(one: Any) -> None:
    """Add --absent-sensors."""
    one.add_argument("--absent-sensors", action="store_true", help="treat sensors without a column as missing throughout")


def columns(chosen: argparse.Namespace) -> dict[str, bool]:
    """What `add_columns` has added, as arguments of `load_log`."""
    return {what: getattr(chosen, what) for what in OF_COLUMNS}


def loaded(chosen: argparse.Namespace, path: Path, plant: Plant) -> LoadedLog:
    """A log as --map and the options of `add_columns` state it is read; readings in a unit that looks wrong are missing."""
    from fusion_sfdia.logs.check import check_log, without_suspects

    return without_suspects(plant, check_log(path, plant, chosen.map, **columns(chosen)))


def add_ending(one: Any) -> None:
    """Add how a diagnosis ends: its exit code, and whether it says so."""
    one.add_argument(
        "--fail-on",
        choices=FAIL_ON,
        help="exit with 3 where a sensor is named (fault), or that or the process (process), or where anything but healthy is "
        "concluded, or the model is suspect (suspect)",
    )
    one.add_argument("--quiet", action="store_true", help="print errors alone, and with --json the document")


def add_tables(one: Any) -> None:
    """Add the kind of file of the tables with a row a sample."""
    one.add_argument(
        "--tables",
        choices=("csv", "xlsx", "parquet"),
        default="csv",
        help="kind of file of the reconstructed readings and the scores (default: csv)",
    )


def exit_code(chosen: argparse.Namespace, found: Diagnosis, read: LoadedLog) -> int:
    """The exit code of a diagnosis: 1 where the log could not be judged or was misread, 3 where what --fail-on names was found,
    whatever else is undecided, else 0.
    """
    from fusion_sfdia.detectors.verdicts import Verdict
    from fusion_sfdia.diagnosis.events import EVEN

    state, likely = found.state, {e.kind for e in found.events if not e.confidence < EVEN}
    holds = {
        None: False,
        "fault": "sensor" in likely,
        "process": bool(likely & {"sensor", "other", "process"}),
        "suspect": state is not Verdict.HEALTHY or bool(found.health and found.health.suspect),
    }
    failed = read.misread or state is Verdict.BLIND or bool(found.decisions.diverged.any())
    return 1 if failed else FOUND * holds[chosen.fail_on]


def add_names(one: Any, option: str, what: str, default: list[str] | None = None) -> None:
    """Add an option of names separated by commas, which may be given several times."""
    one.add_argument(option, type=names, action="extend", default=default, metavar="NAME,...", help=what)


def names(text: str) -> list[str]:
    """The names in a text, separated by commas."""
    return [name.strip() for name in text.split(",") if name.strip()]


def drives_of(given: list[str]) -> dict[str, list[str]]:
    """What each input drives, of the texts of --drives; ValueError for others."""
    found: dict[str, list[str]] = {}
    for text in given:
        driver, _, driven = (part.strip() for part in text.partition("="))
        if not driver or not names(driven):
            raise ValueError(f"--drives {text}; expected an input and what it drives, as in pump=flow,pressure")
        found.setdefault(driver, []).extend(names(driven))
    return found


def warn(text: object) -> None:
    """Print a warning."""
    print(f"fusion-sfdia: warning: {text}", file=sys.stderr)


def warn_of(path: Path, remarks: tuple[str, ...]) -> None:
    """Print what reading a log has found."""
    for remark in remarks:
        warn(f"{path}: {remark}")


@contextmanager
def printed_warnings() -> Iterator[None]:
    """Print the warnings for users that are issued meanwhile, unless it fails."""
    with warnings.catch_warnings(record=True) as issued:
        warnings.simplefilter("always", UserWarning)
        yield
    for warning in issued:
        warn(warning.message)


class OnceParser(argparse.ArgumentParser):
    """A parser that refuses an option with a value which is given twice, of which the first would be lost."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.register("action", None, _Once)


class _Once(argparse.Action):
    """Stores a value, as argparse does by default, for the first time in a namespace only."""

    seen: argparse.Namespace | None = None

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option_string: str | None = None
    ) -> None:
        if option_string and self.seen is namespace:
            raise argparse.ArgumentError(self, "it is given twice; expected once")
        self.seen = namespace
        setattr(namespace, self.dest, values)
