"""Writes real-logs.csv, real-logs.md and real-logs.svg: python docs/results/real_logs.py [FOLDER]

FOLDER holds recordings of others, tep_braatz, herbert and logan_river, which are no part of this project. Without it the
page is written again from real-logs.csv. About ten minutes on one core.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from time import process_time

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

NUMBERS, PAGE, FIGURE = (HERE / f"real-logs.{kind}" for kind in ("csv", "md", "svg"))
COLUMNS = ("set", "method", "kind", "metric", "value")
PROMISED = 0.01  # share of healthy rows in alarm
ALL = "all"
WITNESS = 0.5  # share of its slow variance that others explain, below which a sensor and the process cannot be told apart

Cells = dict[tuple[str, str, str, str], float]


def measured(folder: Path) -> Iterator[tuple[str, str, str, str, float]]:
    """The rows of real-logs.csv."""
    from real_logs_data import sets
    from real_logs_methods import methods_of
    from real_logs_scores import MISSED, OUTCOMES, events_of, outcome, rates

    for recorded in sets(folder):
        events = events_of(recorded)
        facts = {
            "sensors": len(recorded.sensors),
            "inputs": len(recorded.inputs),
            "step": recorded.dt,
            "learnt rows": sum(len(log.t) for log in recorded.healthy),
            "judged rows": sum(len(one.log.t) for one in recorded.judged),
            "healthy rows": sum(int(np.sum(one.healthy)) for one in recorded.judged),
            "events": len(events),
        }
        for what, value in facts.items():
            yield recorded.name, "", ALL, what, value
        for method, learn in methods_of(recorded).items():
            times = [process_time()]
            judge = learn(recorded, PROMISED)
            times.append(process_time())
            found = judge([one.log for one in recorded.judged])
            times.append(process_time())
            false = rates(recorded.judged, found)
            days = false.rows * recorded.dt / 86400
            values = {"alarm": false.alarm, "outside": false.outside, "alarms a day": false.events / days}
            values |= {"learn CPU": times[1] - times[0], "judge CPU": times[2] - times[1]}
            for what, value in values.items():
                yield recorded.name, method, ALL, what, value
            made = [outcome(e, recorded.judged[e.log], found[e.log]) for e in events]
            for kind in (ALL, *dict.fromkeys(e.kind for e in events)):
                of = [one for one in made if kind in (ALL, one.event.kind)]
                if not of:
                    continue
                yield recorded.name, method, kind, "events", len(of)
                yield recorded.name, method, kind, "found", float(np.mean([one.found for one in of]))
                for what in OUTCOMES:
                    if what != MISSED:
                        yield recorded.name, method, kind, what, float(np.mean([one.outcome == what for one in of]))
                if delays := [one.delay for one in of if one.found]:
                    yield recorded.name, method, kind, "delay", float(np.median(delays)) * recorded.dt
            if method == "monitor":
                learnt = judge.learnt  # type: ignore[attr-defined]
                limits, channels = learnt.learnt.limits, learnt.channels
                yield recorded.name, method, ALL, "stated low", limits.rate[1]
                yield recorded.name, method, ALL, "stated high", np.nan if limits.trend.any() else limits.rate[2]
                for i, explained in enumerate(limits.explained):
                    if explained < WITNESS:
                        yield recorded.name, method, channels.names[i], "nothing else measures it", explained
                sensors = [s.name for s in recorded.sensors]
                for name, why in channels.left_out.items():
                    if name in sensors:
                        yield recorded.name, method, name, why, sum(e.sensor == sensors.index(name) for e in events)


def write(rows: Iterator[tuple[str, str, str, str, float]]) -> None:
    """Write real-logs.csv, a line at a time."""
    with NUMBERS.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(COLUMNS)
        for *names, value in rows:
            table.writerow([*names, f"{value:.4g}"])
            file.flush()
            if names[3] == "judge CPU":
                print(*names[:2], f"{value:.1f} s", flush=True)


def load() -> Cells:
    """The numbers of real-logs.csv by set, method, kind and metric."""
    with NUMBERS.open(encoding="utf-8", newline="") as file:
        return {(r["set"], r["method"], r["kind"], r["metric"]): float(r["value"]) for r in csv.DictReader(file)}


def main(arguments: Sequence[str]) -> None:
    """Measure, where a folder is given, and write the page and its figure."""
    if arguments:
        write(measured(Path(arguments[0])))
    from real_logs_figure import svg
    from real_logs_page import render

    PAGE.write_text(render(load()), encoding="utf-8")
    FIGURE.write_text(svg(load()), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
