"""Logs and maps with mistakes in them, drawn from a seed: what is read of them is true, or refused in one line."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import numpy as np
from realistic_logs import HEADER, LOG, PLAIN, Logged, comma, iso, local

from fusion_sfdia.logs.loaded_log import LoadedLog
from fusion_sfdia.logs.reading import load_log
from fusion_sfdia.plant.plant import Plant

ROWS = 12
TOLERANT = 'duplicates = "last"\norder = "sort"\nhold = true\nbad = ["Bad", "I/O Timeout", "#N/A", "--", "x", "12 kg"]\n'
JUNK = (
    "x", "Bad", "I/O Timeout", "#N/A", "--", "1_0", "0x10", "１２", "1e999", "inf", "-Infinity", "1,2,3", "1.2.3", "12 kg",
    "1e", "\ufeff", "\x00", "true", "None", '"', "'", ";", "=1+1", "1;2", "9" * 400, "½", "2024-07-01", "nan(1)", "é" * 50,
    "\\", "%s", "{0}",
)  # fmt: skip
TIMES = (
    "", "yesterday", "2024-02-30 10:00:00", "2024-13-01", "25:00:00", "1e400", "nan", "-", "99999-01-01",
    "2024-07-01T10:00:00+99:00", "NaT", "0",
)  # fmt: skip
VALUES = (
    "1", "-1", "true", "[]", "{}", "1.5", "nan", "inf", '""', '"x"', '"\\t"', '"\\n"', '";"', '","', '"refuse"',
    '"utf-16"', '"utf-7"', '"idna"', '"rot13"', '"Mars/Olympus"', '"UTC"', '"../etc"', '"%Q"', '"%d"', '"%%"', '"s"',
    "[1, 2]", '["a", "b", "c"]', "1979-05-27", '"TT101"', '"feed"', '"degC"', '"furlong"', '"kg"', '"m3/h/h"', '"1"',
    '"()"', '"m^"', "0", "0.0", "[[]]", '"feed < "', '"x < 1"', '"a" = 1',
)  # fmt: skip
KEYS = (
    "time", "format", "tz", "separator", "decimal", "thousands", "encoding", "preamble", "unit_row", "footer", "bad",
    "quality", "good", "duplicates", "order", "inputs", "hold", "mask", "tag", "value", "tme", "columns", "units",
    "sensor",
)  # fmt: skip


def base(rng: random.Random) -> tuple[list[list[str]], str, str]:
    """A right log of a few rows, its separator and its map."""
    if rng.random() < 0.5:
        head = LOG + 'tz = "Europe/Amsterdam"\nformat = "%d-%m-%Y %H:%M:%S"\ndecimal = ","\nseparator = ";"\n'
        return [list(HEADER), *Logged().rows(local, comma)[:ROWS]], ";", head + PLAIN
    return [list(HEADER), *Logged().rows(iso)[:ROWS]], ",", LOG + PLAIN


def spoil_cells(rng: random.Random, rows: list[list[str]]) -> None:
    """One mistake in the table. None makes another number of a number, or moves it to another
    column: such mistakes cannot be seen."""
    if len(rows) < 2:
        return
    k, i = rng.randrange(1, len(rows)), rng.randrange(len(HEADER))
    i = min(i, len(rows[k]) - 1)
    kind = rng.choice([0, 0, 1, 1, 2, 2, 3, 3, *range(4, 11)])
    if kind == 0:
        rows[k][i] = rng.choice(TIMES if i == 0 else JUNK)
    elif kind == 1:
        rows[k][i] = ""
    elif kind == 2:
        rows.insert(k, list(rows[k]))
    elif kind == 3:
        other = rng.randrange(1, len(rows))
        rows[k], rows[other] = rows[other], rows[k]
    elif kind == 4 and len(rows[k]) == len(HEADER):
        rows[k].insert(rng.randrange(len(rows[k]) + 1), rng.choice(["", *JUNK]))
    elif kind == 5 and len(rows[k]) == len(HEADER):
        del rows[k][i]
    elif kind == 6:
        rows[0][min(i, len(rows[0]) - 1)] = rng.choice([*JUNK, *HEADER, "", "TT101", "time"])
    elif kind == 7:
        for row in rows:
            row[:] = [*row[:i], *row[i + 1 :]]
    elif kind == 8:
        rows[k] = [rng.choice(JUNK)]
    elif kind == 9:
        del rows[rng.randrange(len(rows)) :]
    else:
        at = rng.randrange(len(rows[k][i]) + 1)
        rows[k][i] = rows[k][i][:at] + rng.choice("x\"';|\x00%#$\u00a0\u202f_\t") + rows[k][i][at:]
    rows[:] = [row for row in rows if row] or [[""]]


def spoil_map(rng: random.Random, text: str) -> str:
    """One mistake in the map, or a setting that does not fit the log."""
    kind = rng.randrange(5)
    lines = text.split("\n")
    k = rng.randrange(len(lines))
    if kind == 0:
        key = rng.choice(KEYS)
        rest = [line for line in lines if not line.startswith(f"{key} =")]
        return "\n".join([rest[0], f"{key} = {rng.choice(VALUES)}", *rest[1:]])
    if kind == 1:
        del lines[k]
        return "\n".join(lines)
    if kind == 2:
        at = rng.randrange(len(text) + 1)
        return text[:at] + rng.choice('"[]{}=#\n\x00é,') + text[at:]
    if kind == 3:  # of a unit only to one that is none: another right unit would be another log
        return text.replace(
            rng.choice(["degC", '"bar"', '"mm"', "m3/h"]), rng.choice(['"furlong/"', '"kg"', '"%"', "7", '"rad"'])
        )
    return text.replace(
        rng.choice(["TT101", "sensor", "input", "feed", "P1.TT-101.PV", "unit"]), rng.choice(["x", "", "LT101", "sensor"]), 1
    )


def malformed(seed: int, folder: Path) -> tuple[Path, Path]:
    """The files of a log and its map, with one to three mistakes."""
    rng = random.Random(seed)
    rows, separator, text = base(rng)
    if rng.random() < 0.6:
        text = text.replace("[log]\n", f"[log]\n{TOLERANT}", 1)
    for _ in range(rng.choice([1, 1, 2, 3])):
        if rng.random() < 0.7:
            spoil_cells(rng, rows)
        else:
            text = spoil_map(rng, text)
    data = "".join(separator.join(row) + "\n" for row in rows).encode()
    if rng.random() < 0.05:
        at = rng.randrange(len(data) + 1)
        data = data[:at] + rng.choice([b"\xff\xfe", b"\x80", b"\x00\x00", b"\r", b"PK\x03\x04"]) + data[at:]
    log, log_map = folder / "log.csv", folder / "map.toml"
    log.write_bytes(data)
    log_map.write_text(text, encoding="utf-8")
    return log, log_map


def misread(plant: Plant, found: LoadedLog) -> str:
    """What of a log that was read is not in the recording: "" where all is true. A missing reading is."""
    whole = Logged()
    _, y, u = whole.expected(at_the_sample=False)
    starts = {start for start in (whole.start.replace(tzinfo=None), whole.start)}
    first = 0.0
    if found.clock.start is not None:  # rows before may be left out
        start = found.clock.start
        gaps = [(start - s).total_seconds() for s in starts if (s.tzinfo is None) == (start.tzinfo is None)]
        first = min((gap % 3600 for gap in gaps), default=0.0)  # another zone is whole hours away
    at = np.round((found.log.t + first) / 60.0).astype(int)
    if np.any(np.abs(found.log.t + first - 60.0 * at) > 1e-6) or np.any((at < 0) | (at >= ROWS)):
        return f"times {found.log.t}"
    wrong = np.isfinite(found.log.y) & ~np.isclose(found.log.y, y[at], rtol=1e-14)
    if wrong.any():
        return f"readings {found.log.y[wrong]}"
    before = u[:ROWS]  # an input may be that of its row, of the one before, or held from an earlier one
    known = np.any(np.isclose(found.log.u[:, None], before[None], rtol=1e-14), axis=(1, 2))
    return "" if known.all() else f"inputs {found.log.u[~known]}"


def verdict(plant: Plant, log: Path, log_map: Path) -> tuple[str, str]:
    """("refused", the error), ("read", "") or ("misread", what)."""
    try:
        found = load_log(log, plant, log_map)
    except ValueError as error:
        return "refused", str(error)
    wrong: Any = misread(plant, found)
    return ("misread", wrong) if wrong else ("read", "")
