"""bench peers: other packages on Lorenz-96 with 63 states, and a bank of 63 linear filters on it, in the same run.

step_time of a prediction and an update by each package (quantity), for each kind of filter (detector); the reference of the
ratios is NumPy by hand. A package that is not installed is left out, with a line on standard error:
`pip install 'fusion-sfdia[peers]'` has them all.
"""

from __future__ import annotations

import sys
from importlib.metadata import version
from importlib.util import find_spec

from fusion_sfdia.benchmarks.speed.support.calls import Call, time_row, timed, timed_rows
from fusion_sfdia.benchmarks.speed.support.peers import KINDS, PEERS
from fusion_sfdia.report.results import Row

HAND = "NumPy by hand"


def measure(seconds: float) -> list[Row]:
    """All kinds of filters by all packages that are installed."""
    found: dict[str, str] = {}
    for name, (package, _) in PEERS.items():
        if package is None or find_spec(package):
            found[name] = "" if package is None else version(package)
        else:
            print(f"bench peers: {name} is left out: pip install {package}, or 'fusion-sfdia[peers]'", file=sys.stderr)
    rows: list[Row] = []
    for kind in KINDS:
        calls: dict[str, Call] = {}
        for name in found:
            if (call := PEERS[name][1](kind)) is not None:
                calls[name] = call
        hand = calls.pop(HAND)
        times = timed(calls, seconds, HAND, hand)
        for name, time in times.items():
            rows += timed_rows("peers", "lorenz-96", kind, name, time, condition=found[name])
        base = next(iter(times.values()))
        rows.append(time_row("peers", "lorenz-96", kind, HAND, "step_time", base.base, base.calls))
    return rows
