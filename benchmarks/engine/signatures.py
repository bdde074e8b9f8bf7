"""engine/signatures: fault signature matrices derived from the model's equations, compared with the printed ones.

Kougiatsos 2024 (K24), Tables I to IV, and Kougiatsos 2022 (K22), Tables 1 to 3.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure as Drawing

from fusion_sfdia.benchmarks.engine.support.trials import Results, engine, row
from fusion_sfdia.common.run_statistics import Estimate
from fusion_sfdia.derivatives.equation import argument_names
from fusion_sfdia.detectors.adaptive_thresholds.adaptive_threshold import AdaptiveThreshold
from fusion_sfdia.detectors.adaptive_thresholds.signatures import (
    SignatureMatrix,
    global_signatures,
    local_signatures,
    sensors_read,
)
from fusion_sfdia.models.marine_engine.modules import MODULES
from fusion_sfdia.models.marine_engine.plant import SENSORS
from fusion_sfdia.models.marine_engine.published import SIGNATURES, PrintedTable, signatures
from fusion_sfdia.report.content import Figure, ResultTable, Summary
from fusion_sfdia.report.plots import panels
from fusion_sfdia.report.results import Published, Row
from fusion_sfdia.study.experiments.scenario import Arrays, Scenario, Settings, Task

NAME, DETECTOR = "engine/signatures", "adaptive-threshold"
SYMBOLS = ("0", "1", "*")
FAULTS = {f"f{sensor[5]}({sensor[2]})": sensor for sensor in SENSORS}  # as the papers name them: f3(2) of S(2){3}
ROWS = {f"E{name[1:]}": name for name in MODULES}
CERTAIN_STATE = {
    name: module.sensors[:1] for name, module in MODULES.items() if module.variable in ("fuel", "p_receiver", "p_charge")
}
CERTAIN_SUBSET = {name: MODULES[name].sensors for name in CERTAIN_STATE}  # K22: a 1 for every local sensor of an observer
WHY = {  # of entries that differ
    ("E(2,1)", "f3(2)"): "the heat release depends on the speed and so on the torque (K22 (6)); K24 (30) leaves z3(2) out",
    ("E(2,2)", "f3(2)"): "the heat release depends on the speed and so on the torque (K22 (6)); K24 (30) leaves z3(2) out",
    ("E(3,3)", "f1(4)"): "the turbine's efficiency depends on x(4), (43); the printed table has no such entry",
}


def derived(paper: str) -> tuple[SignatureMatrix, SignatureMatrix]:
    """Local and global matrices from the argument names of the equations, with the 1 of the observers as in that paper."""
    plant = engine(0.05, "K24")
    assert plant.structure.modules is not None
    sensor = {s.measures: s.name for s in plant.sensors}
    named = {name: (m.variable, *argument_names(plant.structure.modules.equations[m.variable])) for name, m in MODULES.items()}
    reads = sensors_read(named, sensor, known=(*plant.structure.modules.inputs, "c"))
    local = local_signatures(reads, CERTAIN_STATE if paper == "K24" else CERTAIN_SUBSET, plant.sensor_names)
    agents = AdaptiveThreshold(plant).logic.agents
    assert agents is not None
    return local, global_signatures(local, agents)


def ours(table: PrintedTable) -> dict[str, dict[str, str]]:
    """Our entries of a printed table, all ten sensors."""
    local, overall = derived(table.paper)
    by_agent = {f"E({i})": entries for i, entries in enumerate(overall.entries.values(), 1)}
    by_module = {row: local.entries[name] for row, name in ROWS.items()}
    return {
        line: {fault: (by_agent | by_module)[line][sensor] for fault, sensor in FAULTS.items()} for line in signatures(table)
    }


def signature_tasks(settings: Settings, seeds: int) -> list[Task]:
    """One task per table."""
    return [{"table": list(table)} for table in SIGNATURES]


def signature_work(task: Task) -> Arrays:
    """ours, printed (R, 10): places in SYMBOLS of the entries, 0 where no column is printed."""
    table = PrintedTable(*task["table"])
    printed, found = signatures(table), ours(table)
    both = ([[SYMBOLS.index(of[line].get(f, "0")) for f in FAULTS] for line in printed] for of in (found, printed))
    return {name: np.array(entries, np.int8) for name, entries in zip(("ours", "printed"), both, strict=True)}


def signature_summary(settings: Settings, results: Results) -> Summary:
    """Numbers of equal and differing entries, and the tables with our entries first."""
    rows: list[Row] = []
    tables, differing = [], {}
    found = [(PrintedTable(*task["table"]), arrays) for task, arrays in results]
    for table, arrays in found:
        same = arrays["ours"] == arrays["printed"]
        at = partial(row, NAME, DETECTOR, "none", table.name)
        for metric, count, expected in (("entries_equal", same.sum(), same.size), ("entries_differing", (~same).sum(), 0)):
            rows.append(at(metric, Estimate(float(count), np.nan, np.nan, same.size), Published(float(expected), table.source)))
        lines = list(signatures(table))
        for i, j in np.argwhere(~same):
            place = lines[i], list(FAULTS)[j]
            differing[table.name, *place] = SYMBOLS[arrays["ours"][i, j]], SYMBOLS[arrays["printed"][i, j]]
        tables.append(_table(table, arrays))
    entries = [f"{t}, {line}, {fault}: {a} for {b}" for (t, line, fault), (a, b) in differing.items()]
    reasons = dict.fromkeys(f"{line}, {fault}: {WHY[line, fault]}" for _, line, fault in differing if (line, fault) in WHY)
    total, equal = (
        sum(r.n for r in rows if r.metric == "entries_equal"),
        sum(r.value for r in rows if r.metric == "entries_equal"),
    )
    remarks = [
        f"Of {total} entries {equal:.0f} are as printed. Differences (derived instead of printed): "
        f"{'; '.join(entries) or 'none'}.",
        *(f"{reason}." for reason in reasons),
        "The printed tables have columns for some sensors; the others count as 0. A 1 means that a fault must show. K24 has a "
        "1 where an observer corrects with its own sensor, K22 for all local sensors of an observer. The equations define "
        "which sensors are read, not which of these conventions applies.",
    ]
    figure = Figure(
        "matrix",
        "Fault signature matrices",
        "Local and global matrices of K24 as derived; a printed entry that differs is in brackets, on orange.",
        partial(draw, [(table, arrays) for table, arrays in found if table.paper == "K24"]),
        "Matrix of ten modules and four agents by ten sensor faults with entries 0, 1 or *",
    )
    highlights = [
        f"{equal:.0f} of {total} entries of seven printed signature matrices follow from the arguments of the equations"
    ]
    return Summary(rows, [figure], tables, highlights, remarks)


def _table(table: PrintedTable, arrays: Arrays) -> ResultTable:
    """As printed, and the columns that are not printed but have an entry here."""
    printed, faults = signatures(table), list(FAULTS)
    extra = [f for j, f in enumerate(faults) if f not in next(iter(printed.values())) and arrays["ours"][:, j].any()]
    columns = [*next(iter(printed.values())), *extra]
    return ResultTable(
        f"{table.name}: derived entries, with the printed entry in brackets where it differs",
        ("", *columns),
        tuple((line, *(_entry(arrays, i, faults.index(f)) for f in columns)) for i, line in enumerate(printed)),
        f"not printed: {', '.join(extra)}" if extra else "",
    )


def _entry(arrays: Arrays, i: int, j: int) -> str:
    a, b = SYMBOLS[arrays["ours"][i, j]], SYMBOLS[arrays["printed"][i, j]]
    return a if a == b else f"{a} ({b})"


def draw(found: list[tuple[PrintedTable, Arrays]]) -> Drawing:
    """One panel: rows of all tables, columns of all sensors."""
    figure, (axis,) = panels([""], columns=1, width=9.0, height=5.0)
    lines = [line for table, _ in found for line in signatures(table)]
    entries = np.concatenate([a["ours"] for _, a in found])
    same = np.concatenate([a["ours"] == a["printed"] for _, a in found])
    shade = np.where(same, np.array([1.0, 0.35, 0.75])[entries], np.nan)
    axis.imshow(shade, cmap=colormaps["gray"].with_extremes(bad="#E69F00"), vmin=0, vmax=1, aspect="auto")
    k = 0
    for _, arrays in found:
        for i in range(len(arrays["ours"])):
            for j in range(len(FAULTS)):
                axis.text(j, k, _entry(arrays, i, j), ha="center", va="center", color="white" if shade[k, j] < 0.5 else "black")
            k += 1
        axis.axhline(k - 0.5, color="black", linewidth=1)
    axis.set_xticks(range(len(FAULTS)), list(FAULTS))
    axis.set_yticks(range(len(lines)), lines)
    axis.grid(visible=False)
    axis.set_xlabel("fault")
    return figure


SCENARIO = Scenario(
    name=NAME,
    title="Fault signature matrices of the marine engine",
    about="Which module reads which sensor, derived from the argument names of the model's equations, compared with the "
    "matrices in Kougiatsos 2024 (Tables I to IV) and Kougiatsos 2022 (Tables 1 to 3). 1: a fault must show; *: it may; 0: it "
    "cannot.",
    settings={},
    seeds=1,
    full_seeds=1,
    tasks=signature_tasks,
    work=signature_work,
    summarise=signature_summary,
    papers=("kougiatsos2024", "kougiatsos2022"),
)
