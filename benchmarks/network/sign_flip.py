"""network/sign-flip: the sign of area 5's input is flipped, isolated and compensated (Boem 2018, Figs. 5 to 7)."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.benchmarks.network.support.figures import area_residuals, reconfigured_operation, times_figure
from fusion_sfdia.benchmarks.network.support.rows import detector_name, row, spread, time_rows
from fusion_sfdia.benchmarks.network.support.trials import (
    ALARM_RULES,
    ALPHA,
    CONFIRMATIONS,
    CONTROLLERS,
    LATE,
    PATIENCE,
    Arrays,
    WatchedRuns,
    join_runs,
    require_settings,
    trial,
)
from fusion_sfdia.common.run_statistics import mean_over_runs, share
from fusion_sfdia.detectors.stochastic_thresholds.consensus import MODES
from fusion_sfdia.detectors.stochastic_thresholds.fault_hypotheses import exclusion_alpha
from fusion_sfdia.models.power_network.model import PROCESS_VARIANCE, network_model
from fusion_sfdia.models.power_network.published import ATTACKS, SIGN_FLIP
from fusion_sfdia.report.content import ResultTable, Summary
from fusion_sfdia.report.results import Row
from fusion_sfdia.report.scenario_sentences import pick, span
from fusion_sfdia.study.experiments.scenario import Scenario, Settings, Task, seed_blocks

Array = NDArray[Any]

NAME, FAULT, AREA = "network/sign-flip", "sign-flip", SIGN_FLIP.fault.area
CHUNK = 25  # runs in one task
TRUE = [fault.value if fault else None for _, fault in ATTACKS].index(SIGN_FLIP.fault.value)
GUARANTEE = 0.05  # largest probability of excluding the true fault within PATIENCE steps, in the cases that guarantee one
CASES = {  # what excludes a hypothesis: confirmations and alpha
    "three consecutive": (CONFIRMATIONS, ALPHA),
    "one": (1, ALPHA),
    "guaranteed for Gaussian noise": (CONFIRMATIONS, exclusion_alpha("gaussian", GUARANTEE, 4, PATIENCE, CONFIRMATIONS)),
    "guaranteed for any noise": (CONFIRMATIONS, exclusion_alpha("chebyshev", GUARANTEE, 4, PATIENCE, CONFIRMATIONS)),
}
GUARANTEED = tuple(CASES)[2:]
USUAL = next(iter(CASES))


def flip_tasks(settings: Settings, seeds: int) -> list[Task]:
    """Each process noise with each mode and each exclusion rule, with the same noise."""
    require_settings(settings, noises=PROCESS_VARIANCE, modes=MODES, cases=CASES, controller=CONTROLLERS)
    common = {k: settings[k] for k in ("duration", "controller")}
    return [
        common | {"noise": noise, "mode": mode, "case": case, "seeds": block}
        for noise in settings["noises"]
        for mode in settings["modes"]
        for case in settings["cases"]
        for block in seed_blocks(seeds, CHUNK)
    ]


def flip_work(task: Task) -> Arrays:
    """Runs reconfigured once the fault is isolated, arrays as of `trial`; without reconfiguration with the prefix "alone_"."""
    model = network_model(noise=task["noise"])
    exclusions, alpha = CASES[task["case"]]
    watch = WatchedRuns(AREA, SIGN_FLIP.fault.onset, task["mode"], ATTACKS, alpha, exclusions, reconfigure=True)
    steps = round(task["duration"] / model.dt)

    def run(chosen: WatchedRuns) -> Arrays:
        return trial(
            model, chosen, steps, task["seeds"], loads=SIGN_FLIP.loads, faults=[SIGN_FLIP.fault], controller=task["controller"]
        )

    left_alone = run(replace(watch, reconfigure=False)) if task["case"] == USUAL else {}
    kept = ("reached", "speeds", "angle")
    return run(watch) | {f"alone_{name}": left_alone[name] for name in kept if name in left_alone}


def flip_summary(settings: Settings, results: list[tuple[Task, Arrays]]) -> Summary:
    """Times of detection, isolation and reconfiguration compared with the published ones; exclusions of the true fault."""
    cells: dict[tuple[str, str, str], Arrays] = join_runs(results, lambda task: (task["noise"], task["mode"], task["case"]))
    rows: list[Row] = []
    for (noise, mode, case), found in cells.items():
        rows += _rows(noise, mode, case, found)
    usual = {f"{n}, {m}": f for (n, m, c), f in cells.items() if c == settings["cases"][0]}
    figures = [
        times_figure(
            "times", "When the sign flip is detected and isolated",
            {
                cell: [("detection", f["detected"][:, 1]), ("isolation and reconfiguration", _right(f))]
                for cell, f in usual.items()
            },
            {"detection": SIGN_FLIP.detected, "isolation and reconfiguration": SIGN_FLIP.isolated or np.nan},
            settings["duration"],
        ),
    ]  # fmt: skip
    trace = next(iter(cells.values()))
    figures = [area_residuals(trace), *reconfigured_operation(trace), *figures]
    table = ResultTable(
        "Sign flip of area 5, median [5 %-95 %] of the runs, s",
        ("process noise", "thresholds", "excluded by", "detected", "isolated", "first answer correct", "true fault excluded"),
        tuple(
            (
                n, m, c, spread(f["detected"][:, 1]), spread(_right(f)),
                f"{np.mean(f['first_answer'] == TRUE):.0%}", f"{np.mean(np.isfinite(f['excluded'][:, TRUE])):.0%}",
            )
            for (n, m, c), f in cells.items()
        ),
        f"Published: detected {SIGN_FLIP.detected:g} s, isolated {SIGN_FLIP.isolated:g} s, reconfigured "
        f"{SIGN_FLIP.reconfigured:g} s, in one run.",
    )  # fmt: skip
    return Summary(rows, figures, [table], _highlights(cells), _remarks(rows, cells))


def _percent(shares: list[Array]) -> str:
    return f"{span(100 * float(np.mean(s)) for s in shares)} %"


def _right(found: Arrays) -> Array:
    """(B,): time at which the first answer isolated the true fault, inf where it did not."""
    right: Array = np.where(found["first_answer"] == TRUE, found["answered"], np.inf)
    return right


def _rows(noise: str, mode: str, case: str, found: Arrays) -> list[Row]:
    onset, detector = SIGN_FLIP.fault.onset, detector_name(mode)
    at = partial(row, NAME, detector, FAULT, f"area {AREA}", condition=noise if case == USUAL else f"{noise}, {case}")
    stated = SIGN_FLIP if case == USUAL else SIGN_FLIP._replace(isolated=None, reconfigured=None)
    rows: list[Row] = []
    if case == USUAL:
        detected = found["detected"][:, 1]
        rows += time_rows(at, "detection", detected, onset, stated.delay(stated.detected), stated.at(stated.detected))
        rows.append(at("missed_detection_rate", share(np.isinf(detected))))
        for kind, text in enumerate(ALARM_RULES):
            any_alarm = share(found["false_alarms"][:, kind] > 0)
            where = f"{noise}, {text}"
            rows.append(row(NAME, detector, "none", "all areas", "false_alarm_share", any_alarm, condition=where))
        for metric, key in (("angle_rms", "angle"), ("angle_rms_unaccommodated", "alone_angle")):
            level = found[key][:, int(AREA) - 1]
            rows.append(at(metric, mean_over_runs(level, np.ones(level.size))))
        # the reference is inverted from the very step that begins at the isolation
        rows += time_rows(
            at, "reconfiguration", _right(found), onset, stated.delay(stated.reconfigured), stated.at(stated.reconfigured)
        )
    rows += time_rows(at, "isolation", _right(found), onset, stated.delay(stated.isolated), stated.at(stated.isolated))
    return [
        *rows,
        at("exact_isolation", share(found["first_answer"] == TRUE)),
        at("exact_isolation_at_end", share(found["answer"] == TRUE)),
        at("true_fault_excluded", share(np.isfinite(found["excluded"][:, TRUE]))),
    ]


def _highlights(cells: dict[tuple[str, str, str], Arrays]) -> list[str]:
    return [
        f"{n} process noise, thresholds {m}: detected at {spread(f['detected'][:, 1])} s (published {SIGN_FLIP.detected:g}), "
        f"isolated at {spread(_right(f))} s (published {SIGN_FLIP.isolated:g}), the first answer is correct in "
        f"{np.mean(f['first_answer'] == TRUE):.0%} of the runs"
        for (n, m, c), f in cells.items()
        if c == USUAL
    ]


def _remarks(rows: list[Row], cells: dict[tuple[str, str, str], Arrays]) -> list[str]:
    remarks = []
    for mode in dict.fromkeys(m for _, m, _ in cells):
        for case in dict.fromkeys(c for _, _, c in cells):
            chosen = [f for (_, m, c), f in cells.items() if (m, c) == (mode, case)]
            confirmations, alpha = CASES[case]
            gone = [np.isfinite(f["excluded"][:, TRUE]) for f in chosen]
            early = [g & (f["excluded"][:, TRUE] <= f["answered"]) for f, g in zip(chosen, gone, strict=True)]
            limit = f"at most {GUARANTEE:.0%}" if case in GUARANTEED and mode == "corrected" else "nothing"
            remarks.append(
                f"{mode}, {case} (alpha {alpha:.3g}, {confirmations} consecutive): the true fault is excluded in "
                f"{_percent(gone)} of the runs within {PATIENCE} s, in {_percent(early)} by the first answer; guaranteed: "
                f"{limit}. The first answer is correct in {_percent([f['first_answer'] == TRUE for f in chosen])}, the last "
                f"in {_percent([f['answer'] == TRUE for f in chosen])}."
            )
    after = [
        float(np.median((_right(f) - f["detected"][:, 1])[np.isfinite(_right(f))]))
        for (_, _, c), f in cells.items()
        if c == USUAL
    ]
    near: dict[str, list[float]] = {r.metric: [] for r in rows}
    for r in pick(rows, metric=("angle_rms", "angle_rms_unaccommodated")):
        near[r.metric].append(r.value)
    remarks += [
        f"Root mean square of the angle of area {AREA} from {LATE:g} s on: {span(near.get('angle_rms', []))} rad reconfigured, "
        f"{span(near.get('angle_rms_unaccommodated', []))} rad without reconfiguration.",
        "The paper isolates at 61 s, 13 s after its detection. With three consecutive exclusions from the detection on it "
        f"takes {span(after)} s here (median). The paper does not state which confirmations it used. Its reconfiguration at "
        "67 s is scripted; here the command is inverted with the first reference after the isolation.",
        'The paper states "detected at 62 s" once, which contradicts its own isolation at 61 s; 48 s is used here.',
    ]
    return remarks


SCENARIO = Scenario(
    name=NAME,
    title="A flipped sign of an input in a power network: detection, isolation, reconfiguration",
    about="From 45 s on the reference of area 5 reaches it with the sign flipped. After three consecutive alarms its diagnoser "
    "tests the hypotheses -u, 2u and 10u. When only -u is left, the command is inverted (Boem 2018, sec. VIII-B, Figs. 5 to "
    "7).",
    settings={
        "noises": tuple(PROCESS_VARIANCE), "modes": MODES, "cases": tuple(CASES), "controller": "generation", "duration": 100.0,
    },
    seeds=20,
    full_seeds=100,
    tasks=flip_tasks,
    work=flip_work,
    summarise=flip_summary,
    bounds={"duration": (SIGN_FLIP.fault.onset + 1, 1e6)},
    papers=("boem2018",),
)  # fmt: skip
