"""bench start: step_time of what every command waits for, in processes of their own: `import` and `--help`.

The reference of the ratios is a Python that imports NumPy (quantity `import numpy`).
"""

from __future__ import annotations

from functools import partial

from fusion_sfdia.benchmarks.speed.support.calls import Call, time_row, timed, timed_rows
from fusion_sfdia.benchmarks.speed.support.processes import command, timed_process
from fusion_sfdia.report.results import Row

NUMPY = "import numpy"


def measure(seconds: float) -> list[Row]:
    """A Python that imports the package, or the diagnosis too, and the page of the command line's options."""
    calls: dict[str, Call] = {
        "import": partial(timed_process, ["-c", "import fusion_sfdia"]),
        "import of diagnose": partial(timed_process, ["-c", "from fusion_sfdia import diagnose"]),
        "--help": partial(timed_process, command("--help")),
    }
    times = timed(calls, seconds, NUMPY, partial(timed_process, ["-c", NUMPY]))
    rows = [row for quantity, time in times.items() for row in timed_rows("start", "-", "none", quantity, time)]
    base = times["import"]
    return [*rows, time_row("start", "-", "none", NUMPY, "step_time", base.base, base.calls)]
