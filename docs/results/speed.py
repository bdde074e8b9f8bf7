"""Writes speed.csv, speed.md and its figures: python docs/results/speed.py METRICS...

METRICS: metrics.csv of runs of `fusion-sfdia bench` on one machine; of a row in several of them the first counts. Without
METRICS the page is written again from speed.csv.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from itertools import pairwise
from math import log
from pathlib import Path
from textwrap import fill

import numpy as np

from fusion_sfdia.benchmarks.speed.growth import ABOVE, CASES
from fusion_sfdia.report.results import Row, read_rows, rounded, write_rows

HERE = Path(__file__).parent
NUMBERS, PAGE = HERE / "speed.csv", HERE / "speed.md"
FIGURE, FIGURE_LARGE = HERE / "speed-scaling.svg", HERE / "speed-large.svg"
DIGITS = 3
HOUR = 3600.0
CORES = 1000
SEEDS, PIECES = 25, 4 * 29  # of a comparison: one piece for each plant and detector, of up to so many seeds
PIECE = 15.0  # seconds of such a piece: a comparison of 24 seeds took 1551 s of processor time, in 108 of them
WORKERS = "2 dask workers"
WIDTH = 128  # of a line

ABOUT = """# Speed

`fusion-sfdia bench`, on one thread. Each time is the least of many calls, of `campaigns` of a few and of `logs` of two, the
first diagnosis of one; they take turns with a reference: a ratio to it carries over to other machines better than a time
does. In brackets 95 % intervals of the ratio from the spread between turns, of one run; that of the first diagnosis is from
the spread of the later ones. The numbers are of one machine, idle. What to wait for, and what bounds it: [limits of
speed](speed-limits.md).
"""
HISTORY = """## What has become slower

```sh
fusion-sfdia bench --history speed.jsonl                          # adds a line: machine, code, all ratios
fusion-sfdia bench --history speed.jsonl --against speed.jsonl    # and compares with the earlier ones; exit code 1
```

A ratio is slower where it exceeds the median of its last five runs by more than its noise. The noise is learnt from the
differences of successive runs of the same machine, moderated by that of all rows, and is at least the spread within the run;
before there are three runs it is taken as 5 %. The limit is Student's quantile for one false alarm in 100 comparisons of all
rows, if all had the same noise. What looks slower is measured again, and reported if it is slower both times. Synthetic timings
of 50 rows that differ fourfold in noise: a slowdown of 30 % at a noise of 3 % is reported in 99 % of 200 runs, one of 15 % at a
noise of 1 % in all. Of 200 runs without any, after 20 others, 6 look slower once and none twice; with heavier tails than
assumed (Student's with 5 degrees of freedom) 20 once and one twice.
"""
GROWTH = """## Growth, counted

`fusion-sfdia bench growth` counts what a step does, which no load changes: instructions of Python; operations, which are
multiply-adds, elements of new arrays, and instructions in compiled loops; and the largest memory. The exponent p of size^p is
measured between sizes n, 2n and 4n. The exit code is 1 where one is more than {above} above the highest power in its algebra,
and a test fails. At these sizes lower powers still have a large part, so that an exponent below is no error.
"""
CLUSTER = """## Beyond one machine

The comparison runs on a dask cluster as it does here, with the same bytes: `fusion-sfdia compare --scheduler tls://host:8786`.
Whoever reaches a scheduler at a plain tcp:// address can run code on its workers and on your machine, because tasks and answers
are pickles. With TLS only who has a certificate of your authority is let in:

```sh
dask scheduler --tls-ca-file ca.pem --tls-cert scheduler.pem --tls-key scheduler.key --protocol tls
dask worker tls://host:8786 --tls-ca-file ca.pem --tls-cert worker.pem --tls-key worker.key --nthreads 1
export DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION=True
export DASK_DISTRIBUTED__COMM__TLS__CA_FILE=ca.pem
export DASK_DISTRIBUTED__COMM__TLS__CLIENT__CERT=client.pem DASK_DISTRIBUTED__COMM__TLS__CLIENT__KEY=client.key
fusion-sfdia compare --scheduler tls://host:8786 --out comparison
```

`network/scale` and `bench workers` start clusters of this machine only, with TLS and a certificate made for each.
"""


def load(paths: Sequence[Path]) -> list[Row]:
    """The rows of all runs, sorted as they were measured."""
    first: dict[tuple[str, ...], Row] = {}
    for path in paths:
        for row in read_rows(path):
            first.setdefault(
                (row.scenario, row.plant, row.detector, row.quantity, row.condition, row.metric), rounded(row, DIGITS)
            )
    return list(first.values())


def of(rows: Sequence[Row], part: str, metric: str) -> list[Row]:
    """The rows of a part with that metric."""
    return [r for r in rows if r.scenario == f"bench/{part}" and r.metric == metric]


def table(header: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    return "\n".join("| " + " | ".join(line) + " |" for line in (header, ["---"] * len(header), *lines)) + "\n"


def seconds(value: float) -> str:
    """A time in a fitting unit."""
    factor, unit = next((f, u) for f, u in ((1.0, "s"), (1e3, "ms"), (1e6, "us"), (1e9, "ns")) if value * f >= 1 or u == "ns")
    return f"{value * factor:.{DIGITS}g} {unit}"


def times(rows: Sequence[Row]) -> str:
    """All times with their ratios, a line for each thing that is timed."""
    lines = []
    for part in ("stream", "own", "bank", "model", "engine", "lorenz", "network", "campaigns", "logs", "start"):
        ratios = of(rows, part, "ratio")
        for row in of(rows, part, "step_time"):
            same = [
                r
                for r in ratios
                if (r.plant, r.detector, r.quantity) == (row.plant, row.detector, row.quantity)
                and row.condition == r.condition.rpartition(", ")[0]
            ]
            shown = "; ".join(f"{r.value:.{DIGITS}g} [{r.low:.{DIGITS}g}, {r.high:.{DIGITS}g}] {last(r)}" for r in same)
            what = ", ".join(filter(None, (row.quantity, row.condition)))
            lines.append((part, row.plant, row.detector, what, seconds(row.value), shown))
    return table(("part", "plant", "detector", "what", "time", "ratio to its reference"), lines)


def memory(rows: Sequence[Row]) -> str:
    """The largest memory of what was measured."""
    found = [r for part in ("scaling", "network", "logs") for r in of(rows, part, "peak_memory")]
    lines = [
        (
            r.scenario.removeprefix("bench/"),
            r.plant,
            r.detector,
            ", ".join(filter(None, (r.quantity, r.condition))),
            megabytes(r),
        )
        for r in found
    ]
    return table(("part", "plant", "detector", "what", "MB"), lines)


def megabytes(row: Row) -> str:
    """A number of bytes in MB."""
    return f"{row.value / 1e6:.{DIGITS}g}"


def last(row: Row) -> str:
    """The reference of a ratio row."""
    return row.condition.rpartition(", ")[2]


def peers(rows: Sequence[Row]) -> str:
    """Other packages: time of a prediction and an update, and its ratio to NumPy by hand."""
    found = of(rows, "peers", "step_time")
    kinds = list(dict.fromkeys(r.detector for r in found))
    names = list(dict.fromkeys((r.quantity, r.condition) for r in found))
    ratio = {(r.detector, r.quantity): r for r in of(rows, "peers", "ratio")}
    lines = []
    for name, version in sorted(names, key=lambda n: (n[0] != "fusion-sfdia", n[0] != "NumPy by hand")):
        cells = []
        for kind in kinds:
            time = next((r.value for r in found if (r.quantity, r.detector) == (name, kind)), None)
            by = ratio.get((kind, name))
            cells.append("" if time is None else seconds(time) + (f" ({by.value:.{DIGITS}g})" if by else ""))
        lines.append((f"{name} {version}".strip(), *cells))
    return table(("package", *kinds), lines)


def sized(rows: Sequence[Row], unit: str) -> dict[str, list[tuple[float, float]]]:
    """Size and time by detector, of the rows whose quantity is a number of `unit`."""
    found: dict[str, list[tuple[float, float]]] = {}
    for part in ("scaling", "network"):
        for r in of(rows, part, "step_time"):
            number, _, what = r.quantity.partition(" ")
            if what == unit and not r.condition and r.detector != "fusing-ekf":
                found.setdefault(r.detector, []).append((float(number), r.value))
    return found


def exponents(points: Sequence[tuple[float, float]]) -> str:
    """The exponent of a least-squares line on logarithms, and that of the largest step."""
    size, time = np.log(np.array(points)).T
    whole = float(np.polyfit(size, time, 1)[0])
    (a, s), (b, t) = list(pairwise(points))[-1]
    return f"{whole:.2f}; {log(t / s) / log(b / a):.2f} from {a:g} to {b:g}"


AXES = ("sensors", "nodes", "areas")


def scaling(rows: Sequence[Row]) -> str:
    """Fitted exponents of all curves."""
    lines = []
    for unit in AXES:
        for detector, points in sized(rows, unit).items():
            cells = ", ".join(f"{n:g}: {seconds(t)}" for n, t in points)
            lines.append((unit, detector, cells, exponents(points)))
    return table(("size", "detector", "time of a step", "exponent"), lines)


def draw(rows: Sequence[Row], path: Path) -> None:
    """Times on log-log plots, and the speedup by workers."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"svg.hashsalt": "speed", "svg.fonttype": "none", "font.size": 9}):
        figure = Figure(figsize=(9.6, 2.6), layout="constrained")
        panels = figure.subplots(1, 4)
        for axes, unit in zip(panels, AXES, strict=False):
            for marker, (detector, points) in zip("os^", sized(rows, unit).items(), strict=False):
                axes.loglog(*zip(*points, strict=True), marker=marker, label=detector)
            axes.set(xlabel=unit, ylabel="time of a step (s)" if unit == AXES[0] else "")
            axes.legend(fontsize=7)
        speedup = {r.condition: r.value for r in of(rows, "workers", "speedup")}
        for marker, kind in zip("os", ("processes", "dask workers"), strict=True):
            panels[-1].loglog((1, 2), [speedup[f"{n} {kind}"] for n in (1, 2)], marker=marker, label=kind)
        panels[-1].loglog((1, 2), (1, 2), ":", color="gray", label="ideal")
        panels[-1].set(
            xlabel="workers", ylabel="speed over 1 process", xticks=(1, 2), xticklabels=("1", "2"), yticks=(1, 2),
            yticklabels=("1", "2"),
        )  # fmt: skip
        panels[-1].minorticks_off()
        panels[-1].legend(fontsize=7)
        figure.savefig(path, metadata={"Date": None})


CURVES = {  # of large plants: detector and condition, with line and colour
    ("loo-glr", "every step"): ("o-", "C0"),
    ("loo-glr", "at rest"): ("o--", "C0"),
    ("robust-glr", "every step"): ("s-", "C1"),
    ("robust-glr", "at rest"): ("s--", "C1"),
    ("none", "Cholesky"): ("^-", "C2"),
    ("none", "least, filter"): (":", "gray"),
    ("none", "least, at rest"): ("-.", "gray"),
}


def large(rows: Sequence[Row]) -> dict[tuple[str, str], list[tuple[float, float, float]]]:
    """States, time, and time over that of filterpy's filter, of each curve of large plants."""
    by_hand = {r.quantity: r.value for r in of(rows, "large", "step_time") if r.condition == "Cholesky"}
    filterpy = {r.quantity: by_hand[r.quantity] / r.value for r in of(rows, "large", "ratio") if r.detector == "none"}
    found: dict[tuple[str, str], list[tuple[float, float, float]]] = {}
    for r in of(rows, "large", "step_time"):
        point = float(r.quantity.partition(" ")[0]), r.value, r.value / filterpy[r.quantity]
        found.setdefault((r.detector, r.condition), []).append(point)
    return found


def named(curve: tuple[str, str]) -> str:
    """What a curve is called."""
    return ", ".join(part for part in curve if part != "none")


def large_table(rows: Sequence[Row]) -> str:
    """A line for each size, with time and, in brackets, the ratio to filterpy."""
    curves = large(rows)
    shown = [curves[curve] for curve in CURVES]
    lines = []
    for points in zip(*shown, strict=True):
        states, time, ratio = points[0]
        lines.append((f"{states:g}", seconds(time / ratio), *(f"{seconds(t)} ({r:.2g})" for _, t, r in points)))
    last = [[(n, t / r) for n, t, r in shown[0]], *([(n, t) for n, t, _ in points] for points in shown)]
    exponent = [exponents(points[-3:]).split(";")[0] for points in last]
    lines.append((f"exponent from {shown[0][-3][0]:g} on", *exponent))
    return table(("states, sensors", "filterpy", *map(named, CURVES)), lines)


def draw_large(rows: Sequence[Row], path: Path) -> None:
    """Times of a step over the number of states, relative to filterpy's filter."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"svg.hashsalt": "speed", "svg.fonttype": "none", "font.size": 9}):
        figure = Figure(figsize=(6.4, 3.4), layout="constrained")
        axes = figure.subplots()
        curves = large(rows)
        for curve, (line, colour) in CURVES.items():
            states, _, ratio = zip(*curves[curve], strict=True)
            axes.loglog(states, ratio, line, color=colour, label=named(curve))
        axes.axhline(1.0, color="black", linewidth=0.8)
        axes.set(xlabel="states, and as many sensors", ylabel="time of a step / filterpy's filter")
        axes.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))
        figure.savefig(path, metadata={"Date": None})


def workers(rows: Sequence[Row]) -> str:
    """Pieces on processes and workers, and what a piece costs beside its work."""
    time = {(r.quantity, r.condition): r.value for r in of(rows, "workers", "step_time")}
    sent = {r.quantity.rpartition(" ")[2]: r.value for r in of(rows, "workers", "sent_bytes")}
    many = next(q for q, _ in time if q.endswith("pieces") and q[0].isdigit())
    speedup = {r.condition: r.value for r in of(rows, "workers", "speedup")}
    lines = [(c, seconds(v), f"{speedup[c]:.{DIGITS}g}") for (q, c), v in time.items() if q == many]
    piece = time[many, "1 processes"] / float(many.split()[0])
    empty, moved = time["an empty piece", WORKERS], (sent["sent"] + sent["answered"]) / 1e3
    text = (
        f"The {many} were done once in each way, on two idle cores. An empty piece costs {seconds(empty)}, and one of "
        f"two seeds moves {moved:.{DIGITS}g} kB."
    )
    shown = table(("workers", many, "speed over one process"), lines).rstrip()
    return "\n\n".join((shown, fill(text, WIDTH), hour(piece, empty, moved)))


def hour(piece: float, empty: float, moved: float) -> str:
    """What an hour of CORES cores does: seconds of a measured piece, of an empty one, and kB that a piece moves."""
    long = 10 * CORES * empty  # seconds of a piece
    done = CORES * HOUR / long
    text = (
        f"An hour of {CORES} cores, estimated from these: the scheduler spends {seconds(empty)} on a piece. So it keeps "
        f"{min(CORES, piece / empty):.0f} workers busy with pieces as small as these ({seconds(piece)}), and {CORES} with "
        f"pieces of more than {seconds(CORES * empty)}. With pieces ten times as long, {seconds(long)}, the hour does "
        f"{done:.3g} of them, moves {done * moved / 1e3:.2g} MB or more, and the scheduler is busy for a tenth of it. "
        f"A comparison of all plants with up to {SEEDS} seeds has {PIECES} pieces, a detector on a plant each, and with "
        f"{SEEDS} seeds a piece takes some {PIECE:.0f} s: no more than {PIECES} workers have work, with {10 * SEEDS} seeds "
        f"{10 * PIECES}. Of pieces of {PIECE:.0f} s the hour does {CORES * HOUR / PIECE:.3g}, the scheduler is busy for "
        f"{100 * CORES * empty / PIECE:.0f} % of it. "
        "More than two workers have not been measured."
    )
    return fill(text, WIDTH) + "\n"


def counted(rows: Sequence[Row]) -> str:
    """Exponents of counted work, with the expected ones."""
    found = {(r.detector, r.quantity, r.condition): r.value for r in of(rows, "growth", "growth")}
    lines = [
        (c.detector, c.quantity, *(f"{found[c.detector, c.quantity, w]:.2f} ({p:g})" for w, p in c.expected._asdict().items()))
        for c in CASES
        if (c.detector, c.quantity, "python") in found
    ]
    return table(("detector", "grows with", "Python (expected)", "operations", "memory"), lines)


MEMORY = """## Memory

Of `scaling` what NumPy allocates in a step, of `network` all arrays that a step reads or writes, of `logs` the largest resident
memory of the process.
"""
PEERS = """## Other packages

A prediction and an update of Lorenz-96 with 63 states, all read, in the same run; in brackets the time over that of NumPy by
hand. `bank`: 63 linear filters, each without one sensor; that of this package has extended filters, mixes them and diagnoses.
Each package is as fast as its users can make it (`benchmarks/speed/support/peers.py`): models that take many states at once for
Stone Soup and dynamax, compiled and warm for JAX, double precision. filterpy and pykalman call the model state by state. All
`kf`, `ukf` and linear banks give the same estimates, dynamax to 1e-9, which it adds to its matrices, the others to rounding.
"""
SCALING = """## Scaling

![Time of a step against sensors, nodes and areas, and speed by workers](speed-scaling.svg)

*Straight lines on logarithmic axes are powers. Sensors: one stream of as many states, each coupled with each. Nodes: predict
and update of an ensemble on the pipeline, where finer grids need shorter substeps. Areas: all diagnosers of a network on one
core.*

The exponent of a line through all points, and of the last two, where constant costs count least; the highest power in the
algebra of sensors is 3, that of areas 1:
"""
LARGE = """## Large plants

![Time of a step of plants of 10 to 1000 states over that of filterpy's filter](speed-large.svg)

*A chain of linear states, each read by a sensor, on one thread. 1: a prediction and an update by filterpy's Kalman filter in
the same run. Cholesky: the same in NumPy and SciPy, with a factorisation. Grey: what the operations of that filter, and the
matrices that a step at rest reads, take at least at the measured rates of products and of copies.*

`fusion-sfdia bench large`. Every step: gains change with each row, as after a start, an alarm or a reading that is missing. At
rest: the model is linear and does not change, the same sensors have been read for some rows, and none is far off; then gains
are kept. In brackets the ratio to filterpy's filter, of one run, in turns:
"""


def render(rows: Sequence[Row]) -> str:
    """The page."""
    parts: list[tuple[str, Callable[[Sequence[Row]], str]]] = [
        (ABOUT, times),
        (MEMORY, memory),
        (PEERS, peers),
        (SCALING, scaling),
        (LARGE, large_table),
        (CLUSTER, workers),
        (GROWTH.format(above=ABOVE), counted),
        (HISTORY, lambda _: ""),
    ]
    return "\n".join(f"{text}\n{body(rows)}" for text, body in parts).rstrip() + "\n"


if __name__ == "__main__":
    if sys.argv[1:]:
        write_rows(NUMBERS, load([Path(p) for p in sys.argv[1:]]))
    draw(load([NUMBERS]), FIGURE)
    draw_large(load([NUMBERS]), FIGURE_LARGE)
    PAGE.write_text(render(load([NUMBERS])), encoding="utf-8")
