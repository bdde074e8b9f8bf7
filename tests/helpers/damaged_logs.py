"""Logs as a logger or a transfer leaves them: cut off, with NUL bytes, lines twice or joined, other separators; from a seed."""

from __future__ import annotations

import random
from datetime import timedelta

import numpy as np
from realistic_logs import DT, SUMMER, UNITS, Logged, iso

from fusion_sfdia.logs.loaded_log import LoadedLog

ROWS = 60
FORMS = ("seconds", "stamps", "digits", "wholes")


def clean(form: str) -> tuple[list[str], np.ndarray]:
    """Header and rows of a log, and its numbers (K, 4) as written."""
    rows = Logged().rows(iso)[:ROWS]
    values = np.array([row[1:] for row in rows], dtype=float)
    if form == "digits":
        values += np.random.default_rng(3).standard_normal(values.shape) / 1024
    if form == "wholes":
        values = np.round(values * [10, 1000, 1, 1000])
    texts = [[f"{v:.0f}" if form == "wholes" else repr(float(v)) for v in row] for row in values]
    if form in ("seconds", "stamps"):
        texts = [[f"{v:.4f}" for v in row] for row in values]
    times = [f"{DT * k:.1f}" if form in ("seconds", "digits") else iso(SUMMER + timedelta(seconds=DT * k)) for k in range(ROWS)]
    titles = [UNITS[0], *(title.partition(" ")[0] for title in UNITS[1:])]
    return [",".join(titles), *(",".join([t, *row]) for t, row in zip(times, texts, strict=True))], values


def damaged(seed: int) -> tuple[bytes, str]:
    """The bytes of a log with one to three kinds of damage, and its form."""
    rng = random.Random(seed)
    form = FORMS[seed % len(FORMS)]
    lines, _ = clean(form)
    end = rng.choice(["\n", "\n", "\r\n", "\r"])
    cut = False
    for _ in range(rng.choice([1, 1, 2, 3])):
        k = rng.randrange(1, len(lines) - 1)
        kind = rng.randrange(9)
        if kind == 0:
            cut = True
        elif kind == 1:
            lines.insert(k, lines[k])
        elif kind == 2:
            lines[k : k + 2] = [lines[k] + lines[k + 1]]
        elif kind == 3:
            at = rng.choice([i for i, c in enumerate(lines[k]) if c == ","] or [0])
            lines[k] = lines[k][:at] + rng.choice(";\t| ") + lines[k][at + 1 :]
        elif kind == 4:
            lines[k] = lines[k].replace(",", rng.choice(";\t|"))
        elif kind == 5:
            at, long = rng.randrange(max(len(lines[k]), 1)), rng.randrange(1, 20)
            lines[k] = lines[k][:at] + "\0" * long + lines[k][at + long :]
        elif kind == 6:
            lines[k] = lines[k][: rng.randrange(1, max(len(lines[k]), 2))]
        elif kind == 7:
            lines.insert(k, rng.choice([lines[0], "# restarted", "Logger restarted", '"', "", ",,,,"]))
        else:
            cells = lines[k].split(",")
            cells.insert(rng.randrange(len(cells) + 1), "") if rng.random() < 0.5 else cells.pop(rng.randrange(len(cells)))
            lines[k] = ",".join(cells)
    data = (end.join(lines) + end).encode()
    if cut:
        data = data[: rng.randrange(len(lines[0]) + 40, len(data))]
        data += b"\0" * rng.choice([0, 0, 1, 512])
    return data, form


def misread(found: LoadedLog, values: np.ndarray) -> str:
    """What was read and is in no row of the clean log: "" where all is true."""
    at = found.log.t / DT
    if found.clock.start is not None:
        at = at + (found.clock.start.replace(tzinfo=None) - SUMMER.replace(tzinfo=None)).total_seconds() / DT
    k = np.round(at).astype(int)
    if np.any(np.abs(at - k) > 1e-6) or np.any((k < 0) | (k >= len(values))):
        return f"times {found.log.t}"
    read = np.column_stack([found.log.y, found.log.u])
    # a number may lack the last of its sixteen digits
    wrong = np.isfinite(read) & ~np.isclose(read, values[k], rtol=1e-8, atol=0)
    return f"rows {k[wrong.any(axis=1)]}: {read[wrong]}, not {values[k][wrong]}" if wrong.any() else ""
