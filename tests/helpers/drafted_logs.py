"""One recording of two levels and two temperatures, as different loggers write it: for drafts of maps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal

Array = np.ndarray
STEPS, DT = 200, 60.0
TAGS = ("U7.LT-101.PV", "U7.LT-102.PV", "U7.TT-201.PV", "U7.TT-202.PV", "U7.FC-301.PV")
UNITS = ("mm", "mm", "degC", "degC", "m3/h")
START = datetime(2025, 2, 3, 6, 0)


def step(t_start: float, x: Array, u: Array, dt: float) -> Array:
    """Level and temperature stay as they are; the inflow moves the level."""
    level = x[..., :1] + dt * (u[..., :1] - 2e-3)
    return np.concatenate([level, x[..., 1:]], axis=-1)


def output(t: float, x: Array, u: Array) -> Array:
    return x[..., [0, 0, 1, 1]]


def vat() -> Plant:
    """Two gauges of a level, two of a temperature, and an inflow."""
    states = (
        Signal("level", "m", 2.0, 0.0, 9.0, 0.1, 5e-3),
        Signal("temperature", "K", 320.0, 250.0, 500.0, 1.0, 0.2),
    )
    sensors = tuple(
        Sensor(f"{what}_{k}", what, unit, sigma=sigma, quantity=what)
        for what, unit, sigma in (("level", "m", 0.01), ("temperature", "K", 0.3))
        for k in (1, 2)
    )
    return Plant("vat", states, sensors, step, output, DT, inputs=(Signal("inflow", "m3/s", 2e-3, 0.0, 0.1),))


def readings() -> Array:
    """Values (STEPS, 5) in UNITS."""
    rng, k = np.random.default_rng(41), np.arange(STEPS)
    level, temperature = 2000.0 + 60.0 * np.sin(k / 70.0), 46.85 + 2.0 * np.sin(k / 90.0)
    truth = np.column_stack([level, level, temperature, temperature, np.full(STEPS, 7.2)])
    noise = rng.standard_normal((STEPS, 5)) * [10.0, 10.0, 0.3, 0.3, 0.0]
    return np.round(truth + noise, 2)


def comma(value: float) -> str:
    return repr(value).replace(".", ",")


def body(time: Callable[[datetime], Any], number: Callable[[float], Any] = repr) -> list[list[Any]]:
    values = readings()
    return [[time(START + timedelta(seconds=DT * k)), *(number(float(v)) for v in values[k])] for k in range(STEPS)]


def iso(stamp: datetime) -> str:
    return stamp.isoformat(" ")


def text(rows: Sequence[Sequence[Any]], separator: str = ",") -> str:
    return "".join(separator.join(map(str, row)) + "\n" for row in rows)


def drafted_logs(folder: Path) -> dict[str, Path]:
    """The logs by kind, written into the folder."""
    head = ["Timestamp", *TAGS]
    with_units = [f"{tag} [{unit}]" for tag, unit in zip(TAGS, UNITS, strict=True)]
    dirty = body(iso)
    dirty[20][2], dirty[21][2], dirty[40][1] = "Bad", "I/O Timeout", ""
    dirty[60], dirty[61] = dirty[61], dirty[60]
    dirty.insert(90, dirty[90])
    days = body(lambda s: s.strftime("%d-%m-%Y %H:%M:%S"))
    tagged = [[row[0], tag, value, "Good"] for row in body(iso) for tag, value in zip(TAGS, row[1:], strict=True)]
    worst = body(lambda s: s.strftime("%d/%m/%Y %H:%M"), comma)
    worst[20][2], worst[21][2], worst[40][1] = "Bad", "I/O Timeout", ""
    worst[60], worst[61] = worst[61], worst[60]
    worst.insert(90, worst[90])
    texts = {
        "comma.csv": text([head, *body(iso)]),
        "semicolon.csv": text([["Zeit", *TAGS], *body(lambda s: s.strftime("%d.%m.%Y %H:%M:%S"), comma)], ";"),
        "tab.txt": text([head, *body(lambda s: s.isoformat())], "\t"),
        "day_first.csv": text([["Date", *TAGS], *body(lambda s: s.strftime("%d/%m/%Y %H:%M"))]),
        "month_first.csv": text([head, *body(lambda s: s.strftime("%m/%d/%Y %I:%M:%S %p"))]),
        "two_columns.csv": text([["Date", "Time", *TAGS], *[[*row[0].split(), *row[1:]] for row in days]]),
        "long.csv": text([["Timestamp", "Tag", "Value", "Quality"], *tagged]),
        "unit_row.csv": text([head, ["", *UNITS], *body(iso)]),
        "preamble.csv": text([["Export of the night shift"], ["Unit: 7"], [], ["Timestamp", *with_units], *body(iso), ["End"]]),
        "epoch.csv": text([["ts", *TAGS], *body(lambda s: int(s.replace(tzinfo=UTC).timestamp() * 1000))]),
        "seconds.csv": text([["t [s]", *TAGS], *body(lambda s: (s - START).total_seconds())]),
        "dirty.csv": text([head, *dirty]),
        "everything.csv": text([["Werk Süd"], ["Anlage", "7"], ["Zeit", *with_units], *worst], ";"),
    }
    found = {}
    for name, content in texts.items():
        found[name] = folder / name
        found[name].write_bytes(content.encode("cp1252" if name in ("semicolon.csv", "everything.csv") else "utf-8"))
    return found
