"""One faulty run as every detector sees it: readings, residual over threshold, alarm and reconstruction over the same time.

The run of the first seed after settling: a window of healthy readings, one in which the middle sensor of the plant's list has a
bias, and one in which it is healthy again. Sensor and size are the same in every comparison, so none is chosen by its result.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure as Drawing
from matplotlib.patches import Patch
from numpy.typing import NDArray

from fusion_sfdia.core.detector import Detector, State
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.evaluation.simulate import Recording
from fusion_sfdia.experiments.scenario import Arrays

Array = NDArray[Any]

SIGMAS = 10.0  # of the sensor's noise
PREFIX = "example_"
NOTHING, ALARM, RIGHT, WRONG = range(4)  # no alarm; an alarm; only the faulty sensor isolated; a healthy sensor isolated
VERDICTS = ("no alarm", "alarm, no sensor isolated", "only the faulty sensor isolated", "a healthy sensor isolated")
COLOURS = ("#F2F2F2", "#E69F00", "#0072B2", "#A02020")
LEAST_SCORE = 1e-2  # shown


def example(detector: Detector, recording: Recording, state: State, first: int, window: int) -> Arrays:
    """What a detector makes of the example; state: of one run (1, ...) before the sample `first`.

    Arrays (L,) of at most three windows, fewer where the recording ends: t in s from the first sample, the faulty sensor's
    reading y, its noise-free value signal, reconstruction, active (whether it is faulty), score (largest residual over
    threshold of all sensors; NaN where the estimator has diverged) and verdict (see VERDICTS); sensor: its index ().
    """
    plant, last = detector.plant, min(first + 3 * window, recording.t.size)
    sensor, t = len(plant.sensors) // 2, recording.t[first:last]
    active = np.arange(t.size) // window == 1
    y, u = recording.y[first:last, :1].copy(), recording.u_of_runs[first:last, :1]
    y[active, 0, sensor] += SIGMAS * plant.sensor_sigma[sensor]
    found: dict[str, list[Any]] = {"reconstruction": [], "score": [], "verdict": []}
    for k, at in enumerate(t):
        state, decision = detector.step(state, float(at), y[k], u[k])
        isolated = decision.isolated[0, : len(plant.sensors)]
        faulty = active[k] & (np.arange(isolated.size) == sensor)
        right = active[k] and bool(np.array_equal(isolated, faulty))
        wrong = bool(np.any(isolated & ~faulty))
        found["reconstruction"].append(decision.measured[0, sensor])
        found["score"].append(decision.score[0])
        found["verdict"].append(RIGHT if right else WRONG if wrong else ALARM if decision.alarm[0] else NOTHING)
    kept = {"t": t - t[0], "y": y[:, 0, sensor], "signal": recording.signal[first:last, 0, sensor], "active": active}
    arrays = {k: np.asarray(v, np.float32) for k, v in (kept | found).items()}
    return {f"{PREFIX}{k}": v for k, v in (arrays | {"sensor": np.array(sensor)}).items()}


def draw_example(
    plant: Plant, examples: Mapping[str, Mapping[str, Array]], looks: Mapping[str, Mapping[str, Any]], named: Collection[str]
) -> Drawing:
    """Four panels over one time axis. examples: by detector, the arrays of `example`; named: drawn in the colour of looks."""
    some = next(iter(examples.values()))
    t, sensor = some[f"{PREFIX}t"], plant.sensors[int(some[f"{PREFIX}sensor"])]
    figure = Drawing(figsize=(11.5, 6.6 + 0.21 * len(examples)), layout="constrained")
    heights = (1.5, 1.5, 1.7, 0.4 + 0.16 * len(examples))
    readings, restored, scores, verdicts = figure.subplots(4, 1, sharex=True, gridspec_kw={"height_ratios": heights})
    unit = f"{sensor.name} ({sensor.unit})"

    readings.plot(t, some[f"{PREFIX}y"], color="black", linewidth=1.0, label="reading")
    readings.plot(t, some[f"{PREFIX}signal"], color="0.55", linestyle="--", label="without noise and fault")
    titled(readings, f"Readings of {sensor.name}, with a bias of {SIGMAS:g} sigma in the grey time", unit)
    restored.plot(t, some[f"{PREFIX}signal"], color="0.55", linestyle="--", label="without noise and fault")
    titled(restored, "What each detector puts in its place", unit)
    titled(scores, "Largest residual over its threshold: an alarm above 1", "residual / threshold")
    for name, one in sorted(examples.items(), key=lambda item: item[0] in named):  # the named on top
        look = {k: v for k, v in looks[name].items() if k in ("color", "linestyle")} if name in named else {"color": "0.82"}
        label = name if name in named else None
        restored.plot(t, one[f"{PREFIX}reconstruction"], linewidth=1.3, label=label, **look)
        scores.plot(t, np.maximum(one[f"{PREFIX}score"], LEAST_SCORE), linewidth=1.3, label=label, **look)
    if set(examples) - set(named):
        scores.plot([], [], color="0.82", label="other detectors")
    scores.axhline(1.0, color="black", linewidth=1.0)
    scores.set_yscale("log")
    for axis in (readings, restored, scores):
        acting = t[some[f"{PREFIX}active"] > 0]
        if acting.size:
            axis.axvspan(acting[0], acting[-1], color="0.93", zorder=0)
    limit_to(restored, [some[f"{PREFIX}y"], some[f"{PREFIX}signal"]])
    for axis in (readings, scores):
        axis.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))

    names = list(examples)
    rows = np.array([examples[name][f"{PREFIX}verdict"] for name in names])
    step = t[1] - t[0] if t.size > 1 else 1.0
    sides = (float(t[0] - step / 2), float(t[-1] + step / 2), len(names) - 0.5, -0.5)
    colours, levels = ListedColormap(COLOURS), BoundaryNorm(np.arange(len(COLOURS) + 1) - 0.5, len(COLOURS))
    verdicts.imshow(rows, cmap=colours, norm=levels, extent=sides, aspect="auto", interpolation="nearest")
    verdicts.set_yticks(np.arange(len(names)), names, fontsize=7)
    verdicts.grid(visible=False)
    verdicts.tick_params(axis="y", length=0)
    titled(verdicts, "Alarm and isolation", "")
    verdicts.set_xlabel("time (s)")
    shown = [Patch(facecolor=colour, edgecolor="0.6", label=label) for colour, label in zip(COLOURS, VERDICTS, strict=True)]
    verdicts.legend(handles=shown, fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def titled(axis: Axes, title: str, label: str) -> None:
    """A panel's title and the label of its vertical axis."""
    axis.set_title(title, fontsize=10, loc="left")
    axis.set_ylabel(label)


def limit_to(axis: Axes, values: list[Array]) -> None:
    """The vertical range of some values, with a margin: what leaves it is cut off."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    margin = 0.25 * max(high - low, abs(high) * matplotlib.rcParams["axes.ymargin"] * 1e-3)
    axis.set_ylim(low - margin, high + margin)
