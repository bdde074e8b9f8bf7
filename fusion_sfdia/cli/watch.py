"""The command `watch`: diagnoses rows as they arrive, from standard input or an OPC UA server."""

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path
from typing import Any

from fusion_sfdia.core.numerals import decimal, integer

WHICH = "a name that `list` shows, module:attribute or path/file.py:attribute"

LONGEST_LINE = 1_000_000  # bytes; more is no row


def add_watch(commands: Any) -> None:
    """Add `watch`."""
    one = commands.add_parser(
        "watch",
        help="diagnose rows as they arrive",
        epilog="Rows come from standard input, as CSV with a header or as JSON lines; events go to standard output, a JSON line "
        "each. Rows that are late, malformed or out of order are skipped and reported. A killed watch goes on from --state when "
        "the rows since the saved time are given again, or all rows; events that it had written come again as the same lines.",
        allow_abbrev=False,
    )
    one.add_argument("--plant", default="gas-pipeline", help=f"{WHICH} (default: gas-pipeline)")
    one.add_argument("--detector", default="loo-glr", help=f"{WHICH} (default: loo-glr)")
    one.add_argument("--state", type=Path, metavar="FILE", help="where the state is saved, and taken up if the file is there")
    one.add_argument("--save-every", type=integer, default=1000, metavar="N", help="rows between two saves (default: 1000)")
    one.add_argument("--samples", action="store_true", help="also a line for each row: verdict and validated readings")
    one.add_argument(
        "--hold", type=decimal, default=0.0, metavar="S", help="seconds for which a missing input keeps its value (default: 0)"
    )
    one.add_argument(
        "--longest-gap",
        type=decimal,
        metavar="S",
        help="pause after which the detector starts anew (default: 1000 steps of the plant)",
    )
    one.add_argument("--absent-sensors", action="store_true", help="treat sensors without a column as missing throughout")
    one.add_argument("--other-columns", action="store_true", help="ignore columns that are no sensors or inputs")
    one.add_argument("--nominal-inputs", action="store_true", help="assume the plant's usual inputs where they are missing")
    one.set_defaults(work=_watch)


def _watch(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.live.remarks import Remarks
    from fusion_sfdia.live.rows import TextRows
    from fusion_sfdia.live.saving import SavedWatch
    from fusion_sfdia.live.watch import Watch
    from fusion_sfdia.registry import detector, plant

    if chosen.state is not None and not chosen.state.absolute().parent.is_dir():
        raise ValueError(f"--state {chosen.state}: there is no folder {chosen.state.parent}; make it, or name another file")
    if chosen.save_every < 1:
        raise ValueError(f"--save-every is {chosen.save_every}; expected at least 1 row")
    model, refused = plant(chosen.plant), Remarks(_say)
    settings = {name: getattr(chosen, name) for name in ("hold", "longest_gap", "nominal_inputs")} | {"refused": refused}
    bound = detector(chosen.detector, model)
    if chosen.state is not None and chosen.state.exists():
        watch = Watch.load(chosen.state, bound, **settings)
        _say(f"{chosen.state}: goes on after {watch.clock.at(watch.t or 0.0)}")
    else:
        watch = Watch(bound, **settings)
    rows = TextRows(
        model,
        absent_sensors=chosen.absent_sensors,
        other_columns=chosen.other_columns,
        nominal_inputs=chosen.nominal_inputs,
    )
    saved = SavedWatch(watch, _write, chosen.state, chosen.save_every, chosen.samples)
    try:
        for number, line in enumerate(iter(partial(sys.stdin.buffer.readline, LONGEST_LINE), b""), start=1):
            try:
                row = rows.row(line.decode(errors="replace"))
            except ValueError as error:
                if rows.columns is None:
                    raise
                refused(f"line {number}: {error}; it is not taken")
                continue
            if row is not None:
                saved.take(*row)
    finally:
        saved.save()
        if refused.count:
            _say(f"{refused.count} remarks on rows that were not taken")
    return 0


def _write(line: str) -> None:
    print(line, flush=True)


def _say(line: str) -> None:
    print(f"fusion-sfdia: {line}", file=sys.stderr, flush=True)
