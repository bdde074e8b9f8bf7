"""The same log gives the same verdict at every entrance: command line, file, what was read, frame, arrays and row by row."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from fusion_sfdia import diagnose, load_log, simulate
from fusion_sfdia.cli.main import main
from fusion_sfdia.common.clock import Clock
from fusion_sfdia.detectors import registry
from fusion_sfdia.diagnosis.diagnose import Diagnosis
from fusion_sfdia.diagnosis.events import Event
from fusion_sfdia.diagnosis.prepared import prepared
from fusion_sfdia.diagnosis.watch import Watch
from fusion_sfdia.logs import check_log
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.report.log_report import as_text

Array = NDArray[Any]

PLANT = registry.plant("two-tanks")
ROWS, HALF = 120, 60
SIGMA = PLANT.sensor_sigma
L1, L2, Q12, Q2 = range(4)
TITLES = ["time", *PLANT.sensor_names, "inflow"]
START = datetime(2024, 3, 31, 0, 55, tzinfo=UTC)  # five minutes before clocks change


@dataclass
class Written:
    """A log as it is written: cells of a table by title, and how it is read."""

    table: dict[str, list[str]]
    log_map: str = ""
    options: dict[str, bool] = field(default_factory=dict)
    named: str | None = None  # the sensor that is isolated; "" for none, None where that is not stated


def readings(edit: Callable[[Array], None] | None = None, *, inflow: Array | None = None, seed: int = 5) -> Log:
    """A log of the tanks with its readings y (K, 4) changed in place; inflow: in place of the usual one."""
    r = simulate(PLANT, ROWS, seeds=[seed], truth="model", process_noise=True, inputs=inflow)
    y = r.y[:, 0].copy()
    if edit is not None:
        edit(y)
    return Log(r.t, y, r.u_of_runs[:, 0])


def written(log: Log, named: str | None = None, log_map: str = "", **options: bool) -> Written:
    t, y, u = log
    columns = [t, *y.T, u[:, 0]]
    cells = [["" if np.isnan(v) else repr(float(v)) for v in column] for column in columns]
    return Written(dict(zip(TITLES, cells, strict=True)), log_map, options, named)


def stamped(of: Written, stamp: Callable[[datetime], str], log_map: str | None = None) -> Written:
    times = [stamp(START + timedelta(seconds=float(s))) for s in of.table["time"]]
    return Written(of.table | {"time": times}, of.log_map if log_map is None else log_map, of.options, of.named)


def rows_of(of: Written, rows: Iterable[int], log_map: str = "") -> Written:
    at = list(rows)
    return Written({n: [c[k] for k in at] for n, c in of.table.items()}, log_map, of.options, of.named)


def bias(i: int, size: float = 12.0, first: int = HALF, last: int = ROWS) -> Callable[[Array], None]:
    def edit(y: Array) -> None:
        y[first:last, i] += size * SIGMA[i]

    return edit


def freeze(i: int, first: int = HALF, last: int = ROWS) -> Callable[[Array], None]:
    def edit(y: Array) -> None:
        y[first:last, i] = y[first, i]

    return edit


def missing(i: Any, first: int = HALF, last: int = ROWS) -> Callable[[Array], None]:
    def edit(y: Array) -> None:
        y[first:last, i] = np.nan

    return edit


def drift(i: int, rate: float) -> Callable[[Array], None]:
    def edit(y: Array) -> None:
        y[HALF:, i] += rate * SIGMA[i] * np.arange(1, ROWS - HALF + 1)

    return edit


def factor(i: int, by: float) -> Callable[[Array], None]:
    def edit(y: Array) -> None:
        y[:, i] *= by

    return edit


def swapped(y: Array) -> None:
    y[:, [L1, L2]] = y[:, [L2, L1]]


def coarse(i: int, steps: float) -> Callable[[Array], None]:
    def edit(y: Array) -> None:
        y[:, i] = np.round(y[:, i] / (steps * SIGMA[i])) * steps * SIGMA[i]

    return edit


def slow(i: int, rows: int, fault: Callable[[Array], None] | None = None) -> Callable[[Array], None]:
    def edit(y: Array) -> None:
        if fault is not None:
            fault(y)
        y[:, i] = y[np.arange(ROWS) // rows * rows, i]

    return edit


def sparse(y: Array) -> None:
    y[np.arange(ROWS) % 10 > 0, L1] = np.nan


def scattered(y: Array) -> None:
    y[np.random.default_rng(3).random(y.shape) < 0.1] = np.nan


def noisy(y: Array) -> None:
    y[HALF:, L2] += 10 * SIGMA[L2] * np.random.default_rng(1).standard_normal(ROWS - HALF)


def spikes(y: Array) -> None:
    y[[40, 70, 100], Q2] += 30 * SIGMA[Q2]


def both(*edits: Callable[[Array], None]) -> Callable[[Array], None]:
    def edit(y: Array) -> None:
        for one in edits:
            one(y)

    return edit


def delayed(rows: int) -> Written:
    """A log with an inflow that varies, so that the levels move, in which l1 is late."""
    usual = PLANT.input_at(0.0)[0]
    inflow = usual * (1 + 0.5 * np.sin(2 * np.pi * np.arange(ROWS) / 24))[:, None]

    def edit(y: Array) -> None:
        y[rows:, L1] = y[:-rows, L1].copy()

    return written(readings(edit, inflow=inflow))


def absent() -> Written:
    log = written(readings(), "", absent_sensors=True)
    del log.table["l2"]
    return log


def with_status() -> Written:
    log = written(readings(bias(L1)), "l1", other_columns=True)
    log.table["status"] = ["OK"] * 100 + ["ALARM"] * 20
    return log


def flagged() -> Written:
    log = written(readings(), "", '[log]\nbad = ["Bad"]\n')
    log.table["l1"][30:36] = ["Bad"] * 6
    return log


def with_units() -> Written:
    log = written(readings(bias(L1)), "l1")
    log.table = {("l1 [cm]" if n == "l1" else n): c for n, c in log.table.items()}
    log.table["l1 [cm]"] = [repr(100 * float(c)) for c in log.table["l1 [cm]"]]
    return log


def process_fault() -> Written:
    """The inflow is a tenth more than the log states."""
    usual = PLANT.input_at(0.0)
    inflow = np.where(np.arange(ROWS) < HALF, usual[0], 1.1 * usual[0])[:, None]
    log = readings(inflow=inflow)
    return written(log._replace(u=np.broadcast_to(usual, log.u.shape)))


def berlin(when: datetime) -> str:
    return when.astimezone(ZoneInfo("Europe/Berlin")).strftime("%Y-%m-%d %H:%M:%S")


def healthy() -> Written:
    return written(readings(), "")


def biased() -> Written:
    return written(readings(bias(L1)), "l1")


def later() -> Written:
    log = biased()
    log.table["time"] = [repr(float(s) + 3 * 86400) for s in log.table["time"]]
    return log


TWICE = [*range(50), 50, *range(50, ROWS)]
LATE_ROW = [*range(50), 51, 50, *range(52, ROWS)]
LOGS: dict[str, Callable[[], Written]] = {
    "healthy": healthy,
    "healthy, seed 6": lambda: written(readings(seed=6)),
    "bias": biased,
    "bias of a flow": lambda: written(readings(bias(Q12)), "q12"),
    "bias that ends": lambda: written(readings(bias(L2, first=40, last=80)), "l2"),
    "bias throughout": lambda: written(readings(bias(L1, first=0)), "l1"),
    "drift": lambda: written(readings(drift(L1, 0.5)), "l1"),
    "drift down": lambda: written(readings(drift(Q2, -0.5)), "q2"),
    "freeze": lambda: written(readings(freeze(L1)), "l1"),
    "freeze that ends": lambda: written(readings(freeze(Q2, 30, 80)), "q2"),
    "constant": lambda: written(readings(freeze(L1, 0)), "l1"),
    "dropout": lambda: written(readings(missing(L2, 40, 90)), "l2"),
    "dropout to the end": lambda: written(readings(missing(Q2)), "q2"),
    "empty": lambda: written(readings(missing(L2, 0)), "l2"),
    "absent": absent,
    "a block without readings": lambda: written(readings(missing(slice(None), 50, 56)), ""),
    "scattered gaps": lambda: written(readings(scattered), ""),
    "noise": lambda: written(readings(noisy), "l2"),
    "spikes": lambda: written(readings(spikes), "q2"),
    "two faults": lambda: written(readings(both(bias(L1), freeze(Q2, 30, 90)))),
    "one fault after another": lambda: written(readings(both(bias(L1, first=20, last=50), bias(Q12, first=80)))),
    "process": process_fault,
    "unit: cm": lambda: written(readings(factor(L1, 100.0)), ""),
    "unit: mm": lambda: written(readings(factor(L2, 1000.0)), ""),
    "unit and bias": lambda: written(readings(both(factor(L1, 100.0), bias(Q2))), "q2"),
    "swapped": lambda: written(readings(swapped)),
    "coarse": lambda: written(readings(coarse(L1, 3.0)), ""),
    "coarse with a bias": lambda: written(readings(both(bias(L1, 30.0), coarse(L1, 3.0))), "l1"),
    "slow": lambda: written(readings(slow(L1, 5)), ""),
    "slow with a bias": lambda: written(readings(slow(L1, 5, bias(L1))), "l1"),
    "slow, empty between": lambda: written(readings(sparse), ""),
    "late": lambda: delayed(3),
    "gap": lambda: rows_of(biased(), [*range(30), *range(50, ROWS)]),
    "two gaps": lambda: rows_of(healthy(), [*range(20), *range(30, 90), *range(100, ROWS)]),
    "duplicates, first": lambda: rows_of(biased(), TWICE, '[log]\nduplicates = "first"\n'),
    "duplicates, last": lambda: rows_of(biased(), TWICE, '[log]\nduplicates = "last"\n'),
    "order": lambda: rows_of(biased(), LATE_ROW, '[log]\norder = "sort"\n'),
    "stamps": lambda: stamped(biased(), datetime.isoformat),
    "clock change": lambda: stamped(biased(), berlin, '[log]\ntz = "Europe/Berlin"\n'),
    "offset start": later,
    "flags": flagged,
    "titles with units": with_units,
    "status": with_status,
    "every second row": lambda: rows_of(biased(), range(0, ROWS, 2)),
}
QUICK = ("unit and bias", "absent", "constant", "coarse", "late", "clock change")


def same(one: Diagnosis, other: Diagnosis) -> None:
    """The same verdict, remarks, events and decisions, to the bit: it is the same computation."""
    assert (one.verdict, one.state, one.remarks) == (other.verdict, other.state, other.remarks)
    assert [repr(e) for e in one.events] == [repr(e) for e in other.events]
    np.testing.assert_array_equal(one.decisions.isolated, other.decisions.isolated)
    np.testing.assert_array_equal(one.decisions.residual, other.decisions.residual)


NO_TABLE = ("sep.csv", "again.csv")  # which only a file can be


def agree(path: Path, plant: str, detector: str, log_map: Path | None, options: dict[str, bool]) -> Diagnosis:
    """Every entrance but the command line gives the diagnosis that is returned; a watch what it promises."""
    made = registry.plant(plant)
    read = load_log(path, made, log_map, **options)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        found = diagnose(detector, read, plant=made)
        same(diagnose(detector, check_log(path, made, log_map, **options), plant=made), found)
        if not options:
            same(diagnose(detector, path, plant=made, log_map=log_map), found)
            if path.suffix == ".csv" and path.name not in NO_TABLE:
                same(diagnose(detector, framed(path), plant=made, log_map=log_map), found)
        if not read.absent:
            of_arrays = diagnose(detector, *read.log, plant=made)
            assert [repr(e) for e in of_arrays.events] == [repr(e) for e in found.events]
            np.testing.assert_array_equal(of_arrays.decisions.isolated, found.decisions.isolated)
            if read.clock == Clock():
                same(of_arrays, found)
    row_by_row(made, path, detector, found, check_log(path, made, log_map, **options))
    return found


def framed(path: Path) -> Any:
    """The cells of a file as a frame, numbers where all of a column are, to the bit."""
    with path.open(encoding="utf-8") as file:
        titles, *rows = csv.reader(file)
    frame = {}
    for title, cells in zip(titles, zip(*rows, strict=True), strict=True):
        try:
            frame[title] = [float(c or "nan") for c in cells]
        except ValueError:
            frame[title] = list(cells)
    return pd.DataFrame(frame)


def row_by_row(plant: Plant, path: Path, detector: str, found: Diagnosis, checked: Any) -> None:
    """A watch that knows what is known of the sensors isolates the same samples, and names the same events."""
    judged = prepared(registry.detector(detector, plant), checked, lambda p: registry.detector(detector, p))
    said: list[str] = []
    watch = Watch(judged.detector, unread=judged.unread, refused=said.append)
    samples = [s for row in zip(*checked.log, strict=True) for s in watch.update(*row)] + [*watch.finish()]
    changes = [c for s in samples for c in s.changes] + watch.last()
    if late := [text.partition(" is late by")[0] for text in found.of_log if " is late by" in text]:
        assert [line.partition(" is late by")[0] for line in said if " is late by" in line] == late
        return
    np.testing.assert_array_equal([s.decision.isolated for s in samples], found.decisions.isolated)
    named = {c.id: c.event for c in changes if c.event is not None and c.event.kind == "sensor"}
    of_log = [e for e in found.events if e.kind == "sensor"]
    assert sorted(map(essentials, named.values())) == sorted(map(essentials, of_log))
    sizes = {essentials(e): e.size for e in named.values()}
    for e in of_log:
        if not e.open:
            assert sizes[essentials(e)] == pytest.approx(e.size, rel=1e-6, nan_ok=True)


def essentials(event: Event) -> tuple[str, str, float, float]:
    """What a watch has last said of an event; of one that lasts it repeats neither the present end nor the size."""
    return event.hypothesis, event.fault, event.start, np.inf if event.open else event.end


def on_disk(folder: Path, log: Written) -> tuple[Path, Path | None]:
    path, log_map = folder / "log.csv", folder / "map.toml"
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([list(log.table), *zip(*log.table.values(), strict=True)])
    log_map.write_text(log.log_map, encoding="utf-8")
    return path, log_map if log.log_map else None


@pytest.mark.parametrize("name", [pytest.param(n, marks=[] if n in QUICK else [pytest.mark.long]) for n in LOGS])
def test_every_entrance_gives_the_same_verdict(name: str, tmp_path: Path) -> None:
    log = LOGS[name]()
    path, log_map = on_disk(tmp_path, log)
    found = agree(path, "two-tanks", "loo-glr", log_map, log.options)
    if log.named is not None:
        assert {e.hypothesis for e in found.events} == ({log.named} if log.named else set())
    assert found.suspects == tuple(
        n for n in ("l1", "l2") if name.startswith("unit") and n == {"unit: mm": "l2"}.get(name, "l1")
    )


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("name", [pytest.param(n, marks=[] if n in QUICK[:2] else [pytest.mark.long]) for n in LOGS])
def test_the_command_line_gives_it_too(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = LOGS[name]()
    path, log_map = on_disk(tmp_path, log)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        found = diagnose("robust-glr", load_log(path, PLANT, log_map, **log.options), plant=PLANT)
    flags = [f"--{option.replace('_', '-')}" for option in log.options]
    flags += ["--map", str(log_map)] if log_map else []
    command = [
        "diagnose",
        "--plant",
        "two-tanks",
        "--detector",
        "robust-glr",
        "--data",
        str(path),
        "--out",
        str(tmp_path / "out"),
    ]
    assert main([*command, *flags]) == int(bool(found.suspects))
    if name != "titles with units":  # which people see in their own units
        assert capsys.readouterr().out.startswith(as_text(found, "robust-glr"))
    with (tmp_path / "out/events.csv").open(encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    expected, events = found.table()
    assert header == list(expected)
    assert [[row[0], row[1], float(row[2]), float(row[3])] for row in rows] == [list(e[:4]) for e in events]
    sizes = [float(row[4]) for row in rows]
    np.testing.assert_array_equal(sizes, [e[4] for e in events])


# of the cases: file, plant in the case's folder ("" for the heated tank), map, options
OTHERS = {"other_columns": True}
SHARED_CASES: list[tuple[str, str, str, dict[str, bool]]] = [
    ("01-toa5/log.dat", "", "map.toml", OTHERS),
    ("02-lvm-ragged/log.lvm", "", "map.toml", OTHERS),
    ("04-header-again/log.csv", "", "", {}),
    ("06-grafana-units/units.csv", "", "map.toml", {}),
    ("06-grafana-units/sep.csv", "", "map.toml", {}),
    ("07-array-names/bare.csv", "rod.py:make", "", {}),
    ("07-array-names/units.csv", "rod.py:make", "", {}),
    ("11-cf-units/log.csv", "", "", {}),
    ("13-slow-sensor/empty.csv", "", "", {}),
    ("13-slow-sensor/repeated.csv", "", "", {}),
    ("13-slow-sensor/repeated20.csv", "", "", {}),
    ("15-compass/log.csv", "car.py:make", "", {}),
    ("16-clock-back-no-zone/log.csv", "", "map3.toml", {}),
    ("17-time-a-column/own_titles.csv", "", "map2.toml", OTHERS),
    ("17-time-a-column/long.csv", "", "map3.toml", {}),
]


@pytest.fixture(scope="session")
def built(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Builds the files of a shared case in a folder of its own, with a command line that does nothing."""
    cases = root.parent / "shared" / "cases"
    if not cases.is_dir():
        pytest.skip("needs the shared cases in ../shared/cases, next to the checkout")
    home = tmp_path_factory.mktemp("cases")
    for name, line in (("python", f'exec "{sys.executable}" "$@"'), ("fusion-sfdia", "exit 0")):
        path = home / ".venv" / "bin" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"#!/bin/sh\n{line}\n", encoding="utf-8")
        path.chmod(0o755)
    (home / "docs").symlink_to(root / "docs")
    folders: dict[str, Path] = {}

    def build(case: str) -> Path:
        if case not in folders:
            (folder := home / case).mkdir()
            given = os.environ | {"ROOT": str(home), "TMPDIR": str(folder)}
            subprocess.run(["bash", str(cases / case / "run.sh")], env=given, cwd=folder, capture_output=True, check=False)
            (folders[case],) = folder.glob("tmp.*")
        return folders[case]

    return build


@pytest.mark.long
@pytest.mark.parametrize("file, plant, log_map, options", SHARED_CASES, ids=[case[0] for case in SHARED_CASES])
def test_the_shared_cases(
    file: str, plant: str, log_map: str, options: dict[str, bool], built: Callable[[str], Path], root: Path
) -> None:
    """All of them are of healthy recordings, so that no entrance may find an event."""
    case, _, name = file.partition("/")
    folder = built(case)
    if case == "04-header-again":
        name = (folder / name).rename(folder / "again.csv").name
    made = f"{folder / plant}" if plant else f"{root / 'docs/examples/tank.py'}:make"
    found = agree(folder / name, made, "loo-glr", folder / log_map if log_map else None, options)
    assert found.events == ()
