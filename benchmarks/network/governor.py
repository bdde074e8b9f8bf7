"""network/governor: area 4's governor becomes slow, the area is unplugged, area 15 is plugged in (Boem 2018, Figs. 3 and 4)."""

from __future__ import annotations

from functools import partial

import numpy as np

from fusion_sfdia.benchmarks.network.support.figures import both_bounds, times_figure, unplugged_operation
from fusion_sfdia.benchmarks.network.support.rows import detector_name, row, spread, time_rows
from fusion_sfdia.benchmarks.network.support.trials import (
    ALARM_RULES,
    BOUND,
    CONTROLLERS,
    SHOWN,
    Arrays,
    WatchedRuns,
    join_runs,
    require_settings,
    trial,
)
from fusion_sfdia.common.run_statistics import mean_over_runs, share
from fusion_sfdia.detectors.stochastic_thresholds.consensus import MODES
from fusion_sfdia.models.power_network.model import PROCESS_VARIANCE, network_model
from fusion_sfdia.models.power_network.operation import Switch
from fusion_sfdia.models.power_network.published import DETERMINISTIC_MISSES, GOVERNOR, PLUGGED_IN
from fusion_sfdia.report.content import ResultTable, Summary
from fusion_sfdia.report.results import Row
from fusion_sfdia.report.scenario_sentences import pick, span
from fusion_sfdia.study.experiments.scenario import Scenario, Settings, Task, seed_blocks

NAME, FAULT, AREA = "network/governor", "governor", GOVERNOR.fault.area
CHUNK = 25  # runs in one task
NEXT_TO_IT = ("3", "5", "13")


def governor_tasks(settings: Settings, seeds: int) -> list[Task]:
    """Each process noise with each mode of the thresholds, with the same noise."""
    require_settings(settings, noises=PROCESS_VARIANCE, modes=MODES, controller=CONTROLLERS)
    if settings["duration"] <= PLUGGED_IN:
        raise ValueError(
            f"duration is {settings['duration']:g} s; expected more than {PLUGGED_IN:g} s, when area 15 is plugged in"
        )
    common = {k: settings[k] for k in ("duration", "controller")}
    return [
        common | {"noise": noise, "mode": mode, "seeds": block}
        for noise in settings["noises"]
        for mode in settings["modes"]
        for block in seed_blocks(seeds, CHUNK)
    ]


def governor_work(task: Task) -> Arrays:
    """Runs without unplugging, arrays as of `trial`, and again with area 4 unplugged at the step after its detection: the
    same with the prefix "unplugged_". A run is the same until then, so runs that are unplugged at the same time go together.
    """
    model = network_model(unplugged=["15"], noise=task["noise"])
    watch = WatchedRuns(AREA, GOVERNOR.fault.onset, task["mode"])
    seeds, steps = list(task["seeds"]), round(task["duration"] / model.dt)
    joins = Switch(PLUGGED_IN, plug_in=("15",))
    common = {"loads": GOVERNOR.loads, "faults": [GOVERNOR.fault], "controller": task["controller"]}
    alone = trial(model, watch, steps, seeds, switches=[joins], **common)
    found: Arrays = {}
    detected = alone["detected"][:, 1]
    for time in np.unique(detected):
        rows = np.flatnonzero(detected == time)
        leaves = [Switch(time + model.dt, unplug=(AREA,))] if np.isfinite(time) else []
        part = trial(model, watch, steps, [seeds[r] for r in rows], switches=[joins, *leaves], **common)
        for name, value in part.items():
            if name in (*SHOWN, "bounds"):
                if rows[0] == 0:
                    found[f"unplugged_{name}"] = value
            else:
                of_all = found.setdefault(f"unplugged_{name}", np.zeros((len(seeds), *value.shape[1:]), value.dtype))
                of_all[rows] = value
    return alone | found


def governor_summary(settings: Settings, results: list[tuple[Task, Arrays]]) -> Summary:
    """Times of detection compared with the published one, detection by deterministic bounds, and the effect of unplugging."""
    cells: dict[tuple[str, str], Arrays] = join_runs(results, lambda task: (task["noise"], task["mode"]))
    onset = GOVERNOR.fault.onset
    rows: list[Row] = []
    for (noise, mode), found in cells.items():
        of_area = partial(row, NAME, detector_name(mode), FAULT, f"area {AREA}")
        at = partial(of_area, condition=noise)
        confirmed = found["detected"][:, 1]
        rows += time_rows(at, "detection", confirmed, onset, GOVERNOR.delay(GOVERNOR.detected), GOVERNOR.at(GOVERNOR.detected))
        rows.append(at("missed_detection_rate", share(np.isinf(confirmed))))
        single = partial(of_area, condition=f"{noise}, single alarms")
        rows += time_rows(single, "detection", found["detected"][:, 0], onset)
        for kind, text in enumerate(ALARM_RULES):
            any_alarm = share(found["false_alarms"][:, kind] > 0)
            where = f"{noise}, {text}"
            rows.append(row(NAME, detector_name(mode), "none", "all areas", "false_alarm_share", any_alarm, condition=where))
        other = share(found["unplugged_other_alarms"][:, 1] > 0)
        where = f"{noise}, after unplugging and plugging in"
        rows.append(row(NAME, detector_name(mode), FAULT, "other areas", "false_alarm_share", other, condition=where))
        bound = partial(of_area, condition=f"{noise}, deterministic bound")
        rows += [
            bound("missed_detection_rate", share(~np.isfinite(found["deterministic"])), DETERMINISTIC_MISSES),
            bound("missed_detection_rate_before_the_diagnosers", share(found["deterministic"] >= confirmed)),
        ]
        adjacent = [network_model().network.topology.index(a) for a in NEXT_TO_IT]
        near = partial(row, NAME, detector_name(mode), FAULT, f"areas {', '.join(NEXT_TO_IT)}", condition=noise)
        for metric, key in (("angle_rms", "unplugged_angle"), ("angle_rms_unaccommodated", "angle")):
            level = np.sqrt(np.mean(found[key][:, adjacent] ** 2, axis=-1))
            rows.append(near(metric, mean_over_runs(level, np.ones(level.size))))
    trace = next(iter(cells.values()))
    figures = [
        unplugged_operation(trace), both_bounds(trace),
        times_figure(
            "times", "When the slow governor is detected",
            {
                f"{n}, {m}": [("single alarm", f["detected"][:, 0]), ("detection", f["detected"][:, 1]),
                              ("deterministic bound", f["deterministic"])]
                for (n, m), f in cells.items()
            },
            {"detection": GOVERNOR.detected}, settings["duration"],
        ),
    ]  # fmt: skip
    table = ResultTable(
        "Detection of the slow governor, median [5 %-95 %] of the runs, s",
        ("process noise", "thresholds", "single alarm", ALARM_RULES[1], "deterministic bound", "published"),
        tuple(
            (n, m, spread(f["detected"][:, 0]), spread(f["detected"][:, 1]), spread(f["deterministic"]), GOVERNOR.detected)
            for (n, m), f in cells.items()
        ),
    )
    return Summary(rows, figures, [table], _highlights(cells), _remarks(settings, rows, cells))


def _highlights(cells: dict[tuple[str, str], Arrays]) -> list[str]:
    return [
        f"{n} process noise, thresholds {m}: detected at {spread(f['detected'][:, 1])} s (published {GOVERNOR.detected:g} s); "
        f"the deterministic bound detects the fault in {np.mean(np.isfinite(f['deterministic'])):.0%} of the runs"
        for (n, m), f in cells.items()
    ]


def _remarks(settings: Settings, rows: list[Row], cells: dict[tuple[str, str], Arrays]) -> list[str]:
    remarks = []
    for (noise, mode), f in cells.items():
        det, alone = f["deterministic"], f["detected"][:, 1]
        counts = ", ".join(f"{np.mean(det <= t):.0%} by {t:g} s" for t in (43.0, 50.0, PLUGGED_IN, settings["duration"]))
        remarks.append(
            f"{noise}, {mode}: {np.mean(alone <= GOVERNOR.detected):.0%} of the runs have a detection by {GOVERNOR.detected:g} "
            f"s, the time of the published run; the deterministic bound detects it in {counts}, before the diagnosers in "
            f"{np.mean(det < alone):.0%}. Runs with {ALARM_RULES[1]} false alarms in some area before the fault: "
            f"{np.mean(f['false_alarms'][:, 1] > 0):.0%}; with a single false alarm: "
            f"{np.mean(f['false_alarms'][:, 0] > 0):.0%}."
        )
    near = [(r.metric, r.value) for r in pick(rows, metric=("angle_rms", "angle_rms_unaccommodated"))]
    remarks.append(
        f"Root mean square of the angles of areas {', '.join(NEXT_TO_IT)} from 70 s on: "
        f"{span(v for m, v in near if m == 'angle_rms')} rad with area {AREA} unplugged, "
        f"{span(v for m, v in near if m != 'angle_rms')} rad with it."
    )
    remarks.append(
        f"In the paper the reference of area {AREA} falls after the fault and its speed deviation diverges. In 100 runs with "
        "each noise, and in 8 with predictive control, the reference rose, the speed dipped at the load step of 40 s and "
        "returned, and the angle stayed off: unexplained, as slopes and loads are not published."
    )
    remarks.append(
        f"The paper prints no formula for its deterministic thresholds, which miss the fault in its run. Here they are the "
        f"limit of the residuals' recursion over time, with {BOUND} as bound of all noise and all disturbances."
    )
    remarks.append(
        "Not reproducible: the seed of the published run, the slopes of the tie lines (Fig. 2, not in the text; "
        "recalled or chosen here), most load steps, and the controller (generation control or local predictive control here). "
        "The process noise has two interpretations; both are shown. The paper unplugs area 4 at once; here it is unplugged a "
        "step after its detection, because its readings are available only then."
    )
    return remarks


SCENARIO = Scenario(
    name=NAME,
    title="A slow governor in a power network: detection, unplugging, plugging in",
    about="At 35 s the time constant of the governor of area 4 changes from 0.1 to 1000 s. Three consecutive alarms detect it, "
    "area 4 is unplugged, and at 70 s area 15 is plugged in (Boem 2018, sec. VIII-A, Figs. 3 and 4). Thresholds are corrected "
    "and as printed; the deterministic bound 0.0427 is shown as well.",
    settings={"noises": tuple(PROCESS_VARIANCE), "modes": MODES, "controller": "generation", "duration": 100.0},
    seeds=20,
    full_seeds=100,
    tasks=governor_tasks,
    work=governor_work,
    summarise=governor_summary,
    papers=("boem2018",),
)
