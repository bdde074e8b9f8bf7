"""The cases of engine/process and their figures."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure as Drawing

from fusion_sfdia.benchmarks.engine.support.campaign import DRIVES, Array, logic
from fusion_sfdia.benchmarks.engine.support.campaign_figures import share_matrix
from fusion_sfdia.benchmarks.engine.support.trials import NAMES
from fusion_sfdia.models.marine_engine.faults import PROCESS_FAULTS
from fusion_sfdia.models.marine_engine.plant import SENSORS
from fusion_sfdia.report.content import Figure
from fusion_sfdia.report.plots import panels

ATTACKS = {  # kind: what the measurement reads from the onset on; sizes are our choice
    "offset": "too high by some thresholds of its own module",
    "scaling": "too high by a factor, with the same error at full load",
    "sign": "the negative value",
    "replay": "the readings of the seconds before",
}
ALL = "all sensors"  # replayed at once


def severity_text(severity: float) -> str:
    """The condition of a process fault's rows."""
    return f"severity {severity:.0%}"


def process_cases(severities: list[float]) -> list[tuple[str, float]]:
    """Kind and severity of the process faults."""
    return [(kind, severity) for kind in PROCESS_FAULTS for severity in severities]


def attack_cases() -> list[tuple[str, str]]:
    """Kind and sensor of the attacks."""
    return [*((kind, sensor) for kind in ATTACKS for sensor in SENSORS), ("replay", ALL)]


def process_figure(severities: list[float], first: Array) -> Figure:
    """Modules and sensors by process fault, from first firings (cases, B, N)."""

    def draw() -> Drawing:
        figure, axes = panels(["fired", "isolated"], width=8.5, height=3.0)
        fired, cases = np.isfinite(first), [f"{kind} {severity:.0%}" for kind, severity in process_cases(severities)]
        share_matrix(axes[0], fired.mean(axis=1), cases, NAMES, ylabel="process fault")
        share_matrix(axes[1], logic().isolated(fired).mean(axis=1), cases, tuple(SENSORS))
        return figure

    return Figure(
        "process",
        "Process faults: modules that fire and isolated sensors",
        "Share of runs in which a module has fired (left) and a sensor, all of them healthy, is isolated (right) at the end. "
        "Dark: all runs.",
        draw,
        "Matrices of process fault against modules that fired and against isolated sensors",
    )


def attack_figure(drive: str, first: Array) -> Figure:
    """Detection and isolation by attack, from first firings (cases, B, N)."""
    fired = np.isfinite(first[: len(ATTACKS) * len(SENSORS)]).reshape(len(ATTACKS), len(SENSORS), -1, len(NAMES))
    isolated = logic().isolated(fired)
    right = np.stack([isolated[:, i, :, i] for i in range(len(SENSORS))], axis=1)

    def draw() -> Drawing:
        figure, axes = panels(["detected", "attacked sensor isolated", "exact isolation"], columns=3, width=10.0, height=2.2)
        alone = right & (isolated.sum(axis=-1) == 1)
        for panel, values in zip(axes, (fired.any(axis=-1), right, alone), strict=True):
            share_matrix(panel, values.mean(axis=-1), tuple(ATTACKS), tuple(SENSORS))
        return figure

    return Figure(
        f"attacks-{drive}",
        f"Attacks on one measurement: {DRIVES[drive]}",
        "Share of runs in which any module has fired, the attacked sensor is isolated, and no other is, at the end. Dark: all "
        "runs.",
        draw,
        "Matrices of the kind of attack against the attacked sensor: detected, isolated, exactly isolated",
    )


def noticed(severities: list[float], first: Array) -> list[str]:
    """For each process fault that is detected in most runs, a sentence with the modules that fire and the isolated sensors."""
    sentences = []
    for (kind, severity), fired in zip(process_cases(severities), np.isfinite(first), strict=True):
        modules = [name for name, share in zip(NAMES, fired.mean(axis=0), strict=True) if share > 0.5]
        isolated = [name for name, share in zip(SENSORS, logic().isolated(fired).mean(axis=0), strict=True) if share > 0.5]
        if modules:
            sentences.append(
                f"{kind} of {severity:.0%} is detected by {', '.join(modules)} in most runs; "
                f"isolated: {', '.join(isolated) or 'no sensor'}."
            )
    return sentences
