"""The page real-logs.md, of the numbers of real-logs.csv."""

from __future__ import annotations

from collections.abc import Mapping
from textwrap import fill

from comparison import table

Cells = Mapping[tuple[str, str, str, str], float]

PROMISED = 0.01
ALL, MONITOR = "all", "monitor"
SHARES = ("found", "named right", "named wrong", "undecided")
ALONE = "nothing else measures it"
WIDTH = 126
README_SET = "Logan river, fortnights in turn"
README_METHODS = ("limits-ewma", "ridge on others", "pca", MONITOR)
TWICE = 2.0  # of the promised rate: what exceeds it is marked

ABOUT = """# Recorded and simulated logs, without a model

How `Monitor`, which learns from healthy logs without a model, does on recordings of others whose faults somebody has
labelled, and on simulated plants, beside the usual ways to watch readings without a model. `python docs/results/real_logs.py
FOLDER` measures, with the recordings in FOLDER. Settings are fixed from the healthy logs alone, and unfavourable results
stay. After a first look `dynamic-pca` was added, `pca` got the noise as its unit, ten instead of three logs of the simulated
plants count false alarms, longer ones are learnt as well, alarms that name only sensors without a reading count no longer,
and "named right" asks that no sensor without a label is named; `Monitor` was not touched then. The recordings are no fresh
judges of it, though: its rules were made with them in view, one of them on d05 (`causes.SMALL`), one on the Logan river
(`steps.INERT`).

## What follows

{findings}

![Events named right against healthy rows in alarm, for each set and method](real-logs.svg)

Upper left is best. Share of the events in which the right sensor is named against the share of healthy rows in alarm; the
line is the rate that was promised to all.

## How it was measured

- **Same data for all.** Every method learns from the same healthy logs, is promised {promised:g} of the healthy rows in
  alarm, and judges the same later logs. Limits come from blocks of the healthy logs that were left out while the method was
  fitted: for the baselines the order statistic over eight consecutive blocks, for `Monitor` its own limits for blocks. No
  method sees labels.
- **An event** is a stretch of labelled readings of one sensor (or of the process), gaps of 16 rows bridged. It is *found*
  where the method is in alarm in at least a tenth of its rows, ten times what chance gives; *named right* where in so many
  rows its sensor is named, and no sensor without a label; *named wrong* where a sensor without a label is named in more rows
  than that; *undecided* where neither holds and the method is in alarm, or says "outside what was learnt". The rest is
  missed. Two rows after an event belong to it. "Outside" is no alarm, but finds a fault of the process.
- **Doubt**: the standard error of a share is at most 0.05 of 108 events and 0.08 of 36; four faults of the process are few.
- **Delay**: median time to the first alarm of the events that were found.
- **Healthy rows** are those without a label in any sensor, and not within 32 rows after one. An alarm that names only sensors
  without a reading does not count, neither as found nor as false: labels are given to readings. Alarms fewer than 16 rows
  apart are one.
- **CPU**: seconds of one core for learning and for judging, on a shared machine: the order of magnitude.

| method | what it is | its settings |
|---|---|---|
| `monitor` | `Monitor`: leave-one-out residuals of means over 1 to 1024 rows, and a test of operation not learnt | as it is |
| `pca` | the library's principal components of sensors and inputs: T2, Q (SPE), contributions, reconstruction | its own edge |
| `dynamic-pca` | the same on three rows at a time | its own edge |
| `isolation forest` | scikit-learn's, 200 trees, on readings and their changes; names no sensor | as it is |
| `median of others` | each sensor less the median of those that measure alike, if any: Shewhart and EWMA chart | none |
| `ridge on others` | each sensor less its ridge regression on all other columns, the same charts | ridge by the blocks |
| `limits-ewma` | the library's limits of level, change and EWMA of each reading, and a test of repeated readings | as it is |
| `vector autoregression` | one-step prediction residuals of 1 to 3 lags and the inputs, the same charts | both by the blocks |

Columns that lack 70 % of the healthy readings (`pca`, `dynamic-pca`: 30 %) or never move are left out; skewed ones are taken
as logarithms. Baselines with charts name the sensor with the largest ratio to its limit.

## The data

{data}

The recordings are not part of this project. *Chemical plant*: the Tennessee Eastman process (Downs and Vogel 1993) in closed
loop, files of Russell, Chiang and Braatz, from github.com/jkitchin/tennessee-eastman-profbraatz (University of Illinois/NCSA
licence); d00 is learnt, faults of 120 rows are put into the healthy d00_te, and d01, d04, d05 and d11 have a process fault
from row 160 on. *Logan river*: github.com/AmberSJones/pyhydroqc (BSD-3), four sites, January to September 2019; a label is
what the technicians marked, of which the source gives no table: the kinds are named here by what they mark. Readings without
a label are as the technicians corrected them, since slow corrections between calibrations have no label; labelled ones as
read, less the last correction before. *Herbert river*: github.com/EdgarSantos-Fernandez/herbert (GPL-2), level and suspended
solids at seven sites, each reading labelled by an expert; readings called uncertain are taken as missing. *Fortnights in
turn*: every other fortnight is learnt, the others are judged; *later half*: the first half is learnt. *Faults put in* on the
Logan river last 30 h (120 rows). Two tanks and the gas pipeline are simulated with the high-fidelity model and an inflow, or
a demand, that wanders; *more learnt*: four times as long healthy logs.

Sizes of faults that are put in: 1, 2 and 4 units for 120 rows, bias, drift up to that size, freeze and added noise alike. The
unit is the standard deviation of the healthy reading on the chemical plant, its median within a day on the river, twice that
of the sensor's noise on the simulated plants.
"""


def sets_of(cells: Cells) -> list[str]:
    """All sets, as they were measured."""
    return list(dict.fromkeys(key[0] for key in cells))


def methods_in(cells: Cells, of: str) -> list[str]:
    """The methods of a set, as they were measured."""
    return list(dict.fromkeys(key[1] for key in cells if key[0] == of and key[1]))


def with_events(cells: Cells) -> list[str]:
    """The sets that have labelled events."""
    return [of for of in sets_of(cells) if cells[of, "", ALL, "events"]]


def lasting(seconds: float) -> str:
    """A time in the unit that suits it."""
    for unit, size in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds:.3g} s"


def data(cells: Cells) -> str:
    """What each set has."""
    header = ("set", "sensors", "inputs", "a row each", "healthy rows learnt", "rows judged", "of them healthy", "events")
    lines = []
    for of in sets_of(cells):
        fact = {what: cells[of, "", ALL, what] for what in ("sensors", "inputs", "step", "learnt rows", "judged rows")}
        counts = [f"{cells[of, '', ALL, what]:.0f}" for what in ("healthy rows", "events")]
        numbers = [f"{fact[what]:.0f}" for what in ("sensors", "inputs")]
        rows = [f"{fact[what]:.0f}" for what in ("learnt rows", "judged rows")]
        lines.append((of, *numbers, lasting(fact["step"]), *rows, *counts))
    return table(header, lines)


def rate(cells: Cells, of: str, method: str) -> str:
    """The share of healthy rows in alarm, in bold where it is above TWICE the promised one."""
    share = cells[of, method, ALL, "alarm"]
    return f"**{share:.3f}**" if share > TWICE * PROMISED else f"{share:.3f}"


def promised(cells: Cells) -> str:
    """The promised rate against the rate held on later data."""
    every = list(dict.fromkeys(m for of in sets_of(cells) for m in methods_in(cells, of)))
    lines = []
    for of in sets_of(cells):
        there = methods_in(cells, of)
        low, high = (cells.get((of, MONITOR, ALL, f"stated {end}"), float("nan")) for end in ("low", "high"))
        stated = f"{low:.2g} to {high:.2g}" if high == high else "none: a sensor drifted"
        outside = f"{cells[of, MONITOR, ALL, 'outside']:.3f}"
        lines.append((of, stated, outside, *(rate(cells, of, m) if m in there else "" for m in every)))
    return table(("set", "interval that `monitor` states", "`monitor`: outside", *(f"`{m}`" for m in every)), lines)


def of_set(cells: Cells, of: str) -> str:
    """The methods on a set."""
    header = ("method", *SHARES, "delay", "healthy rows in alarm", "false alarms a day", "CPU learn, judge (s)")
    methods = methods_in(cells, of)
    best = {w: max(cells[of, m, ALL, w] for m in methods) for w in ("found", "named right")}
    lines = []
    for m in methods:
        shares = [(w, cells[of, m, ALL, w]) for w in SHARES]
        shown = [f"**{v:.2f}**" if v == best.get(w) and v > 0 else f"{v:.2f}" for w, v in shares]
        delay = cells.get((of, m, ALL, "delay"))
        cpu = ", ".join(f"{cells[of, m, ALL, f'{what} CPU']:.1f}" for what in ("learn", "judge"))
        alarms = f"{cells[of, m, ALL, 'alarms a day']:.2g}"
        lines.append((f"`{m}`", *shown, "" if delay is None else lasting(delay), rate(cells, of, m), alarms, cpu))
    return table(header, lines)


def of_readme(cells: Cells) -> str:
    """What a few methods find on a recorded log, in a small table."""
    metrics = ("found", "named right", "named wrong")
    lines = [
        (
            "`monitor`, ours" if m == MONITOR else m,
            *(f"{cells[README_SET, m, ALL, w]:.2f}" for w in metrics),
            f"{cells[README_SET, m, ALL, 'delay'] / 60:.0f}",
            f"{cells[README_SET, m, ALL, 'alarms a day']:.2f}",
        )
        for m in README_METHODS
    ]
    return table(("method", *metrics, "minutes to the alarm", "false alarms a day"), lines)


def by_kind(cells: Cells, of: str) -> str:
    """Found and named right by kind of event; "" where there is one kind."""
    methods = methods_in(cells, of)
    kinds = [key[2] for key in cells if key[:2] == (of, MONITOR) and key[3] == "found" and key[2] != ALL]
    if len(kinds) < 2:
        return ""
    lines = [
        (
            f"{kind} ({cells[of, MONITOR, kind, 'events']:.0f})",
            *(f"{cells[of, m, kind, 'found']:.2f} / {cells[of, m, kind, 'named right']:.2f}" for m in methods),
        )
        for kind in kinds
    ]
    return "Found / named right, by kind (events):\n\n" + table(("kind", *(f"`{m}`" for m in methods)), lines) + "\n\n"


def listed(names: list[str]) -> str:
    """Names in a sentence."""
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]


def undiagnosable(cells: Cells) -> str:
    """Sensors that `monitor` cannot judge, or cannot tell from the process, and why."""
    lines = []
    for of in with_events(cells):
        own = [key for key in cells if key[:2] == (of, MONITOR) and key[2] != ALL]
        alone = [key[2] for key in own if key[3] == ALONE]
        out = [(key[2], key[3], cells[key]) for key in own if "healthy" in key[3]]
        count = cells[of, "", ALL, "sensors"]
        short = [(name, why.replace(" of its readings in the healthy logs", ""), n) for name, why, n in out]
        left = "; ".join(f"{name} {why}" + (f" ({n:.0f} events)" if n else "") for name, why, n in short)
        lines.append((of, f"{len(alone)} of {count - len(out):.0f}", left or "none"))
    return table(("set", "sensors that no other measures", "sensors left out, why, and events of theirs"), lines)


def sentence(cells: Cells, of: str) -> str:
    """How `monitor` stands on a set beside the best baseline, and the best of those that held the rate."""
    methods = [m for m in methods_in(cells, of) if m != MONITOR]
    what = "found" if not any(cells[of, m, ALL, "named right"] for m in (MONITOR, *methods)) else "named right"

    def shown(m: str) -> str:
        values = (cells[of, m, ALL, one] for one in (what, "named wrong", "alarm"))
        return f"`{m}` {what} {next(values):.2f}, named wrong {next(values):.2f}, in alarm {next(values):.3f}"

    best = max(methods, key=lambda m: cells[of, m, ALL, what])
    held = [m for m in methods if cells[of, m, ALL, "alarm"] <= TWICE * PROMISED]
    gain = cells[of, MONITOR, ALL, what] - cells[of, best, ALL, what]
    verdict = (
        "loses to the best baseline" if gain < 0 else "is before all baselines" if gain > 0 else "equals the best baseline"
    )
    text = f"- **{of[0].upper()}{of[1:]}** ({cells[of, '', ALL, 'events']:.0f} events): `monitor` {verdict}. "
    text += f"{shown(MONITOR)}; {shown(best)}"
    if held and best not in held:
        kept = max(held, key=lambda m: cells[of, m, ALL, what])
        text += f"; best of the baselines that held twice the promised rate: {shown(kept)}"
    if what == "found":
        quiet = [f"`{m}`" for m in methods_in(cells, of) if not cells[of, m, ALL, "named wrong"]]
        text += f". No sensor is named by {listed(quiet)}"
    return text + "."


def findings(cells: Cells) -> str:
    """What the numbers say, in sentences."""
    lines = []
    sets = sets_of(cells)
    held = {m: [of for of in sets if m in methods_in(cells, of)] for m in dict.fromkeys(k[1] for k in cells if k[1])}
    kept = {m: sum(cells[of, m, ALL, "alarm"] <= TWICE * PROMISED for of in of_m) for m, of_m in held.items()}
    counts = listed([f"`{m}` {kept[m]} of {len(held[m])}" for m in held])
    lines.append(f"- **Rates.** Sets on which at most twice the promised rate was held: {counts}.")
    stated = [(of, cells.get((of, MONITOR, ALL, "stated high"), float("nan"))) for of in sets]
    above = [f"{of} ({cells[of, MONITOR, ALL, 'alarm']:.3f})" for of, high in stated if cells[of, MONITOR, ALL, "alarm"] > high]
    if above:
        lines.append(f"- The rate of `monitor` is above the interval that it states itself on: {listed(above)}.")
    lines += [sentence(cells, of) for of in with_events(cells)]
    return "\n".join(fill(line, WIDTH, subsequent_indent="  ", break_on_hyphens=False) for line in lines)


NOTES = {
    "chemical plant": (
        "The 500 healthy rows of d00 are few: order statistics of them do not hold on d00_te, and what most baselines "
        "find there they find at several times the promised rate."
    ),
    "chemical plant, process faults": ("No sensor is at fault: whatever is named is wrong, and undecided is right."),
    "Logan river, fortnights in turn": (
        "Most labels are of readings far off and of stretches withdrawn: limits of each reading by itself see these and "
        "name their sensor. `monitor` looks for one sensor that explains a row: where it is undecided other sensors are "
        "nearly always labelled in the same rows."
    ),
    "Logan river, faults put in": (
        "Rows out of which labelled readings were taken count as healthy here; the set above leaves them out. What "
        "`monitor` alarms in beyond the promise is nearly all in one of them, a fortnight in April in which it names the "
        "dissolved oxygen at Mendon; whether that was healthy is not known."
    ),
    "Logan river, later half": (
        'Summer after winter and spring: `monitor` says "outside what was learnt" in most rows and judges little there, '
        "as it promises. Limits, which promise nothing of the kind, find the gross faults."
    ),
    "Herbert river, fortnights in turn": (
        "Turbid floods, channels that lack a third of their readings, labels that overlap. Events of channels that "
        "`monitor` leaves out, below, count as missed: they are most of them."
    ),
}


def render(cells: Cells) -> str:
    """The page of these numbers."""
    parts = [ABOUT.format(findings=findings(cells), promised=PROMISED, data=data(cells))]
    parts.append(f"\n## Rate promised against rate held on later data\n\n{RATES}\n\n{promised(cells)}\n")
    for of in with_events(cells):
        note = fill(NOTES[of], WIDTH) + "\n\n" if of in NOTES else ""
        parts.append(f"\n## {of[0].upper()}{of[1:]}\n\n{note}{of_set(cells, of)}\n\n{by_kind(cells, of)}".rstrip("\n") + "\n")
    parts.append(f"\n## What cannot be diagnosed\n\n{CANNOT}\n\n{undiagnosable(cells)}\n")
    return "".join(parts)


RATES = f"""Share of healthy rows in alarm where {PROMISED:g} was promised; bold is above twice that."""
CANNOT = """Of a sensor that no other measures (others explain less than half of its slow variance) a move may be that of the
process: `monitor` says "moved: sensor or process", which counts as undecided. A sensor that is left out, mostly
as it misses more than 30 % of its healthy readings, is not judged by it. Of the expert's labels on the Herbert
river 11 524 are of levels that have no reading in the file (constant values, impossible): only that they are
missing can be seen. A slow drift that began before the healthy part, and faults of the process that one sensor
alone measures, look the same to every method here."""
