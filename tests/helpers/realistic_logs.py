"""Forty logs as historians, loggers and spreadsheets export them, all made of one recording whose values are known."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np

from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal

Array = np.ndarray
STEPS, DT = 240, 60.0
AUTUMN, SPRING, SUMMER = (datetime(2024, *day, tzinfo=UTC) for day in ((10, 26, 22, 30), (3, 31, 0, 0), (7, 1, 10, 0)))
AMSTERDAM = ZoneInfo("Europe/Amsterdam")
TAGS = {"TT101": "P1.TT-101.PV", "PT101": "P1.PT-101.PV", "LT101": "P1.LT-101.PV", "feed": "P1.FC-001.PV"}
PLAIN = """
[columns]
"P1.TT-101.PV" = { sensor = "TT101", unit = "degC" }
"P1.PT-101.PV" = { sensor = "PT101", unit = "bar" }
"P1.LT-101.PV" = { sensor = "LT101", unit = "mm" }
"P1.FC-001.PV" = { input = "feed", unit = "m3/h" }
"""


def step(t_start: float, x: Array, u: Array, dt: float) -> Array:
    """Temperature, pressure and level return to their usual values; the feed moves the level."""
    usual = np.array([350.0, 4e5, 1.2])
    return usual + (x - usual) * np.exp(-dt / 600.0) + np.array([0.0, 0.0, 1.0]) * (u[..., :1] - 2e-3)


def output(t: float, x: Array, u: Array) -> Array:
    """The sensors read the states."""
    return x


def vessel() -> Plant:
    """A vessel with a temperature, a pressure, a level and a feed."""
    states = (
        Signal("temperature", "K", 350.0, 273.0, 500.0, 1.0, 0.1),
        Signal("pressure", "Pa", 4e5, 1e4, 2e6, 1e3, 1e2),
        Signal("level", "m", 1.2, 0.0, 3.0, 0.01, 1e-3),
    )
    sensors = (
        Sensor("TT101", "temperature", "K", sigma=0.3),
        Sensor("PT101", "pressure", "Pa", sigma=1e3),
        Sensor("LT101", "level", "m", sigma=5e-3),
    )
    return Plant("vessel", states, sensors, step, output, DT, inputs=(Signal("feed", "m3/s", 2e-3, 5e-4, 4e-3),))


@dataclass
class Logged:
    """The recording as an instrument engineer sees it: degC, bar, mm, m3/h, a row a minute from `start`."""

    start: datetime = SUMMER
    columns: dict[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        rng = np.random.default_rng(14)
        noise = rng.standard_normal((STEPS, 4))
        self.columns = {
            "TT101": np.round(76.85 + 0.3 * noise[:, 0], 2),
            "PT101": np.round(4.0 + 0.01 * noise[:, 1], 4),
            "LT101": np.round(1200.0 + 5.0 * noise[:, 2], 1),
            "feed": np.round(7.2 + 0.2 * noise[:, 3], 3),
        }

    @property
    def stamps(self) -> list[datetime]:
        return [self.start + timedelta(seconds=DT * k) for k in range(STEPS)]

    def rows(self, time: Callable[[datetime], Any], number: Callable[[float], Any] = repr) -> list[list[Any]]:
        values = [[number(float(v)) for v in column] for column in self.columns.values()]
        return [[time(stamp), *row] for stamp, row in zip(self.stamps, zip(*values, strict=True), strict=True)]

    def expected(self, *, at_the_sample: bool = True) -> tuple[Array, Array, Array]:
        """t, y, u in the units of the plant."""
        c = self.columns
        y = np.column_stack([c["TT101"] + 273.15, c["PT101"] * 1e5, c["LT101"] / 1e3])
        u = c["feed"][:, None] / 3600.0
        return DT * np.arange(STEPS), y, np.concatenate([u[:1], u[:-1]]) if at_the_sample else u


@dataclass
class Case:
    """A log: the file or frame, its map, and the readings that it holds; `outcome` other than "read" is part of an error or
    a finding.
    """

    source: Any
    map: str | None = None
    expected: tuple[Array, Array, Array] | None = None
    outcome: str = "read"
    options: dict[str, bool] = field(default_factory=dict)


HEADER = ["Timestamp", *TAGS.values()]
UNITS = ["time", "TT101 [degC]", "PT101 [bar]", "LT101 [mm]", "feed [m3/h]"]
LOG = '[log]\ntime = "Timestamp"\n'


def csv(path: Path, rows: Sequence[Sequence[Any]], separator: str = ",", *, encoding: str = "utf-8", end: str = "\n") -> Path:
    path.write_bytes("".join(separator.join(map(str, row)) + end for row in rows).encode(encoding))
    return path


def iso(stamp: datetime) -> str:
    return stamp.strftime("%Y-%m-%d %H:%M:%S")


def local(stamp: datetime, form: str = "%d-%m-%Y %H:%M:%S") -> str:
    return stamp.astimezone(AMSTERDAM).strftime(form)


def comma(value: float) -> str:
    return repr(value).replace(".", ",")


def without(expected: tuple[Array, Array, Array], cells: Sequence[tuple[int, int]]) -> tuple[Array, Array, Array]:
    t, y, u = expected
    y = y.copy()
    for k, i in cells:
        y[k, i] = np.nan
    return t, y, u


def realistic_logs(folder: Path) -> dict[str, Case]:
    """The forty logs by name, their files written into the folder."""
    import pandas

    log, cases = Logged(), {}
    e = log.expected()

    def file(name: str) -> Path:
        return folder / f"{name.replace(' ', '_').replace(',', '')}.csv"

    def add(name: str, rows: Sequence[Sequence[Any]], map_text: str | None, expected: Any = e, **more: Any) -> None:
        outcome, options = more.pop("outcome", "read"), more.pop("options", {})
        cases[name] = Case(csv(file(name), rows, **more), map_text, expected, outcome, options)

    # without a map: inputs acted until their row
    until = log.expected(at_the_sample=False)
    add("seconds", [UNITS, *log.rows(lambda s: (s - SUMMER).total_seconds())], None, until)
    add("ISO stamps", [UNITS, *log.rows(iso)], None, until)
    add("ISO with milliseconds and Z", [UNITS, *log.rows(lambda s: s.strftime("%Y-%m-%dT%H:%M:%S.000Z"))], None, until)
    add("seconds since 1970", [UNITS, *log.rows(lambda s: int(s.timestamp()))], None, until)
    add("milliseconds since 1970", [UNITS, *log.rows(lambda s: int(s.timestamp() * 1e3))], None, until)
    add(
        "hours since the start",
        [["time [h]", *UNITS[1:]], *log.rows(lambda s: (s - SUMMER).total_seconds() / 3600)],
        None,
        until,
    )
    add(
        "BOM, CRLF and quotes",
        [[f'"{c}"' for c in row] for row in [UNITS, *log.rows(iso)]],
        None,
        until,
        encoding="utf-8-sig",
        end="\r\n",
    )
    # historians
    european = LOG + 'tz = "Europe/Amsterdam"\nformat = "%d-%m-%Y %H:%M:%S"\ndecimal = ","\nseparator = ";"\n'
    add("semicolons and decimal commas", [HEADER, *log.rows(local, comma)], european + PLAIN, separator=";")
    preamble = [["Historian export"], ["Plant: P1"], ["From 01-07-2024 to 02-07-2024"], [""], ["Interpolated"]]
    add("preamble", [*preamble, HEADER, *log.rows(local, comma)], european + "preamble = 5\n" + PLAIN, separator=";")
    add("footer", [HEADER, *log.rows(iso), [""], ["(240 rows affected)"]], LOG + "footer = 1\n" + PLAIN)
    add("separator at the end of lines", [[*row, ""] for row in [HEADER, *log.rows(iso)]], LOG + PLAIN)
    add(
        "UTF-16 with tabs",
        [HEADER, *log.rows(iso)],
        LOG + 'encoding = "utf-16"\nseparator = "\\t"\n' + PLAIN,
        separator="\t",
        encoding="utf-16",
    )
    no_units = (
        PLAIN.replace(', unit = "degC"', "")
        .replace(', unit = "bar"', "")
        .replace(', unit = "mm"', "")
        .replace(', unit = "m3/h"', "")
    )
    add("row of units", [HEADER, ["", "degC", "bar", "mm", "m3/h"], *log.rows(iso)], LOG + "unit_row = true\n" + no_units)
    add(
        "row of units in cp1252",
        [HEADER, ["", "°C", "bar", "mm", "m³/h"], *log.rows(iso)],
        LOG + 'unit_row = true\nencoding = "cp1252"\n' + no_units,
        encoding="cp1252",
    )
    for name, start in (("clocks go back", AUTUMN), ("clocks go forward", SPRING)):
        add(name, [HEADER, *Logged(start).rows(local, comma)], european + PLAIN, separator=";")
    add("offsets that change", [HEADER, *Logged(AUTUMN).rows(lambda s: s.astimezone(AMSTERDAM).isoformat())], LOG + PLAIN)
    add(
        "newest first", [HEADER, *Logged(AUTUMN).rows(local, comma)[::-1]], european + 'order = "sort"\n' + PLAIN, separator=";"
    )
    late = log.rows(iso)
    late[50], late[53] = late[53], late[50]
    add("late rows", [HEADER, *late], LOG + 'order = "sort"\n' + PLAIN)
    add(
        "date and time apart",
        [["Date", "Time", *HEADER[1:]], *([*r[0].split(" "), *r[1:]] for r in log.rows(iso))],
        '[log]\ntime = ["Date", "Time"]\n' + PLAIN,
    )
    add(
        "AM and PM",
        [HEADER, *log.rows(lambda s: s.strftime("%m/%d/%Y %I:%M:%S %p"))],
        LOG + 'format = "%m/%d/%Y %I:%M:%S %p"\n' + PLAIN,
    )
    add(
        "days of Excel",
        [HEADER, *log.rows(lambda s: (s - datetime(1899, 12, 30, tzinfo=UTC)) / timedelta(days=1))],
        LOG + 'format = "excel"\n' + PLAIN,
    )
    # numbers
    add("thousands in quotes", [HEADER, *log.rows(iso, lambda v: f'"{v:,}"')], LOG + 'thousands = ","\n' + PLAIN)
    german = str.maketrans(",.", ".,")
    add(
        "German thousands",
        [HEADER, *log.rows(local, lambda v: f"{v:,}".translate(german))],
        european + 'thousands = "."\n' + PLAIN,
        separator=";",
    )
    french = str.maketrans({",": "\u202f", ".": ","})
    add(
        "French thousands",
        [HEADER, *log.rows(local, lambda v: f"{v:,}".translate(french))],
        european + 'thousands = " "\n' + PLAIN,
        separator=";",
    )
    gauge = PLAIN.replace('"bar"', '"bar(g)"').replace('"degC"', '"degF"')
    for_gauge = Logged()
    for_gauge.columns["PT101"] = log.columns["PT101"] - 1.01325
    for_gauge.columns["TT101"] = log.columns["TT101"] * 1.8 + 32
    add("gauge pressure and Fahrenheit", [HEADER, *for_gauge.rows(iso)], LOG + gauge)
    tenths = [[*r[:3], round(r[3] * 10), r[4]] for r in log.rows(iso, float)]
    add("whole numbers of tenths", [HEADER, *tenths], LOG + PLAIN.replace('unit = "mm"', 'unit = "mm", scale = 0.1'))
    # what is missing
    bad = log.rows(iso)
    bad[3][1], bad[7][2], bad[8][2], bad[9][3] = "Bad", "I/O Timeout", "No Data", ""
    missing = without(e, [(3, 0), (7, 1), (8, 1), (9, 2)])
    add("bad texts", [HEADER, *bad], LOG + 'bad = ["Bad", "I/O Timeout", "No Data"]\n' + PLAIN, missing)
    nines = log.rows(iso)
    nines[3][1], nines[7][2] = "-9999", "-9999.0"
    add("number for missing", [HEADER, *nines], LOG + "bad = -9999\n" + PLAIN, without(e, [(3, 0), (7, 1)]))
    titles = [*HEADER, *(f"{t}.Q" for t in HEADER[1:])]
    for name, good, poor, rule in (("OPC DA", 192, 24, "opc-da"), ("OPC UA", 0, 2150891520, "opc-ua")):
        codes = [[*r, good, good, poor if k == 5 else good, good] for k, r in enumerate(log.rows(iso))]
        add(
            f"quality of {name}",
            [titles, *codes],
            LOG + f'quality = "{{column}}.Q"\ngood = "{rule}"\n' + PLAIN,
            without(e, [(5, 2)]),
        )
    again = log.rows(iso)
    add("duplicates", [HEADER, *again[:100], again[99], *again[100:]], LOG + 'duplicates = "last"\n' + PLAIN)
    held = log.rows(iso)
    known = e[2].copy()
    for k in (10, 11):
        held[k][4] = ""
        known[k + 1] = known[10]
    add("input held", [HEADER, *held], LOG + "hold = 300\n" + PLAIN, (e[0], e[1], known))
    stopped = log.rows(iso)
    for k in range(100, 110):
        stopped[k][4] = "0.0"
    run = np.r_[0:101, 111:STEPS]
    add(
        "shut-down",
        [HEADER, *stopped],
        LOG + 'mask = "feed < 5"\n' + PLAIN,
        without((e[0][run], e[1][run], e[2][run]), [(100, i) for i in range(3)]),
    )
    # long formats, Parquet and frames
    long = [
        [r[0], tag, v] for r in log.rows(lambda s: int(s.timestamp()) * 10**9) for tag, v in zip(HEADER[1:], r[1:], strict=True)
    ]
    tag = 'tag = "Tag"\nvalue = "Value"\n'
    add("long, nanoseconds since 1970", [["Timestamp", "Tag", "Value"], *long], LOG + tag + PLAIN)
    rows = Logged(AUTUMN).rows(local, comma)
    by_tag = [
        [r[0], t, r[i], "Bad" if (k, i) == (5, 2) else "Good"] for i, t in enumerate(HEADER) if i for k, r in enumerate(rows)
    ]
    add(
        "long, tag after tag, with quality",
        [["Timestamp", "Tag", "Value", "Quality"], *by_tag],
        european + tag + 'quality = "Quality"\n' + PLAIN,
        without(e, [(5, 1)]),
        separator=";",
    )
    stamps = pandas.DatetimeIndex(log.stamps, name="Timestamp")
    frame = pandas.DataFrame({TAGS[n]: v for n, v in log.columns.items()}, index=stamps)[[*HEADER[:0:-1]]]
    frame.tz_convert("Europe/Amsterdam").to_parquet(folder / "log.parquet")
    cases["Parquet"] = Case(folder / "log.parquet", LOG + PLAIN, e)
    # what a map cannot mend: refused, or reported
    once = [r for r, s in zip(Logged(AUTUMN).rows(local, comma), Logged(AUTUMN).stamps, strict=True) if s.hour == 0]
    add(
        "the hour that is twice, once",
        [HEADER, *once],
        european + PLAIN,
        None,
        separator=";",
        outcome="occurs twice, and the order of the rows does not tell",
    )
    add(
        "decimal commas between commas",
        [HEADER, *log.rows(local, comma)],
        european.replace(";", ",") + PLAIN,
        None,
        outcome="row 2: 9 cells under a header of 5",
    )
    in_bar = [UNITS[0], UNITS[1], "PT101", *UNITS[3:]]
    kept = until[1].copy()
    kept[:, 1] /= 1e5
    add("unit not stated", [in_bar, *log.rows(iso)], None, (until[0], kept, until[2]), outcome="PT101 looks")
    return cases
