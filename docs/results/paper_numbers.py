"""The table of docs/paper/paper.md: what the package reaches and misses, each number with the file that it is from."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import comparison  # noqa: E402  (beside this file)
import robustness  # noqa: E402

from fusion_sfdia.report.results import read_rows  # noqa: E402
from fusion_sfdia.study.published_numbers import NUMBERS, counts, values_of  # noqa: E402

SPEED = HERE / "speed.csv"


def table() -> str:
    """The table in Markdown."""
    lines = [*of_papers(), *of_wrong_models(), *of_speed()]
    return comparison.table(("what", "value", "from `docs/results/`"), lines)


def of_papers() -> list[tuple[str, str, str]]:
    """Of the published numbers how many are met and missed."""
    found = counts(values_of(read_rows(HERE / NUMBERS)))
    return [
        ("published numbers of the five papers that scenarios measure", f"{found.numbers}", NUMBERS),
        ("of these met as the paper is read by default", f"{found.by_default}", NUMBERS),
        ("of these met by some reading of the paper", f"{found.by_some}", NUMBERS),
        ("of these missed, with a stated reason", f"{found.explained}", NUMBERS),
        ("of these missed, unexplained", f"{found.unexplained}", NUMBERS),
    ]


def of_wrong_models() -> list[tuple[str, str, str]]:
    """What the default detector makes of wrong readings, starts and models, and of process faults."""
    rows, name = robustness.read_rows(robustness.NUMBERS), f"`{robustness.DEFAULT}`"
    plants = list(dict.fromkeys(row.plant for row in rows if row.detector == robustness.DEFAULT))
    cases = [(row, p) for p in plants for row in robustness.false_isolation(rows, p, robustness.DEFAULT)]
    worst, where = max(cases, key=lambda one: one[0].value)
    _, _, bias, process, sure = robustness.summary(rows, robustness.DEFAULT, plants)
    return [
        (
            f"{name}, live: errors of readings, start and model on {len(plants)} plants, without a fault",
            f"{len(cases)}",
            robustness.NUMBERS.name,
        ),
        (
            "of these with a healthy sensor isolated in at most 2 % of the rows",
            f"{sum(row.value <= 0.02 for row, _ in cases)}",
            robustness.NUMBERS.name,
        ),
        (f"of these the worst: {where}, {worst.condition}", f"{worst.value:.0%} of the rows", robustness.NUMBERS.name),
        *(
            (f"{name}, {what}, worst to best plant", f"{min(of):.0%} to {max(of):.0%}", robustness.NUMBERS.name)
            for what, of in (
                ("rows with a bias of 10 sigma and a right verdict", bias),
                ("rows with a process fault and a right verdict", process),
                ("events with a confidence of at least 0.9 that are right", sure),
            )
        ),
    ]


def of_speed() -> list[tuple[str, str, str]]:
    """What a step of the bank on the gas pipeline costs."""
    speed = {(r.scenario, r.plant, r.detector, r.quantity, r.condition, r.metric): r.value for r in robustness.read_rows(SPEED)}
    bank = ("bench/bank", "gas-pipeline", "fusing-ekf")
    return [
        (
            "a step of the bank of 63 extended filters, one thread",
            f"{1e3 * speed[*bank, 'bank', '', 'step_time']:.2g} ms",
            SPEED.name,
        ),
        (
            "time of filterpy for the same, its model as fast as ours, over it",
            f"{speed[*bank, 'filterpy', 'compiled model', 'speedup']:.2g}",
            SPEED.name,
        ),
    ]
