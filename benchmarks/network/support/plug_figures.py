"""The figures, tables and sentences of network/plug."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure as Drawing
from numpy.typing import NDArray

from fusion_sfdia.evaluation.results import Row
from fusion_sfdia.models.power_network.model import PROCESS_VARIANCE
from fusion_sfdia.report.content import Figure, Table
from fusion_sfdia.report.findings import pick, span
from fusion_sfdia.report.plots import COLOURS, DASHES, legend_above, panels

Array = NDArray[Any]

LEAVES, JOINS = "area 4 leaves", "area 15 joins"
MANNERS = ("replugged", "sec. VI-A to the letter", "not told")
PHASES = {"before": (10, 44), "without area 4": (44, 71), "with area 15": (71, 96)}  # samples
NUMBERS = ("model", "weights", "thresholds", "copies")
PLACES = {"area 4": ("4",), "areas 3, 5, 13": ("3", "5", "13"), "areas 14, 15": ("14", "15")}


def locality_figure(local: Mapping[str, Mapping[str, Array]], names: tuple[str, ...]) -> Figure:
    """Which numbers of which areas change."""

    def draw() -> Drawing:
        figure, axes = panels([LEAVES, JOINS], columns=1, width=9.6, height=1.7)
        for panel, event in zip(axes, (LEAVES, JOINS), strict=True):
            changed = np.array([np.any([of[f"{event} {n}"] for of in local.values()], axis=0) for n in NUMBERS])
            panel.imshow(changed, cmap=ListedColormap(["#eeeeee", COLOURS[0]]), vmin=0, vmax=1, aspect="auto")
            panel.set_xticks(np.arange(len(names)), names)
            panel.set_yticks(np.arange(len(NUMBERS)), [*NUMBERS[:-1], "copies of neighbours'\nangles"], fontsize=8)
            panel.set_xticks(np.arange(len(names) + 1) - 0.5, minor=True)
            panel.set_yticks(np.arange(len(NUMBERS) + 1) - 0.5, minor=True)
            panel.grid(visible=False)
            panel.grid(which="minor", color="white", linewidth=2)
            panel.tick_params(which="both", length=0)
            panel.set_xlabel("area")
        return figure

    return Figure(
        "locality",
        "What changes when an area leaves or joins, bit for bit",
        "Blue: some bit changes. Model, weights and thresholds of an area's own states change in the area and its neighbours "
        "alone. But these tell their new consensus to all who share their angles, and so the copies that their neighbours hold "
        "change too: the diagnosers of areas that have nothing to do with the change.",
        draw,
        "Grid of the areas by kind of number, coloured where a bit changes, for one area that leaves and one that joins",
    )


def alarm_figure(curves: Mapping[tuple[str, str], Array], names: tuple[str, ...], told: str) -> Figure:
    """Share of areas in alarm over time."""

    def draw() -> Drawing:
        noises = [n for n in PROCESS_VARIANCE if (n, MANNERS[0]) in curves]
        titles = [f"{place}, process noise '{n}'" for place in PLACES for n in noises]
        figure, axes = panels(titles, height=2.1, width=9.0, columns=len(noises))
        for panel, (place, noise) in zip(axes, [(p, n) for p in PLACES for n in noises], strict=True):
            who = np.isin(names, PLACES[place])
            for i, manner in enumerate(MANNERS):
                rate = curves[noise, manner][..., who].mean(axis=(1, 2))
                t = np.arange(rate.size)
                smooth = np.convolve(rate, np.full(3, 1 / 3), "same")[SHOWN:-1]
                panel.plot(t[SHOWN:-1], smooth, color=COLOURS[i], linestyle=DASHES[i], linewidth=1.1, label=manner)
            for start in (PHASES["without area 4"][0] - 1, PHASES["with area 15"][0] - 1):
                panel.axvline(start, color="black", linewidth=0.8, linestyle=":")
            panel.set(xlabel="time (s)", ylabel="share in alarm", ylim=(-0.02, 1.02), xlim=(SHOWN, 95))
        legend_above(figure)
        return figure

    return Figure(
        "alarms",
        "Alarms of healthy areas around the changes",
        f"Share of the runs and areas that alarm, mean of three steps. Dotted: area 4 leaves, area 15 joins. {told} Where "
        "nobody is told, missing readings widen the thresholds, which hides part of the error.",
        draw,
        "Alarm rates over time of three groups of areas for three manners of telling the diagnosers of a change",
    )


SHOWN = 10  # s from which alarms are drawn


def tables(rows: Sequence[Row]) -> list[Table]:
    """What changes; alarms by phase."""
    changed = pick(rows, metric="changed_areas")
    local = [(r.quantity, f"{r.value:g}", "" if r.published is None else f"{r.published:g}") for r in changed]
    lines = []
    for noise in PROCESS_VARIANCE:
        for manner in MANNERS:
            for place in (*PLACES, "other areas"):
                found = [_alarm(rows, place, phase, manner, noise) for phase in PHASES]
                if all(r is not None for r in found):
                    lines.append((noise, manner, place, *(f"{r.value:.3f} ({r.low:.3f} to {r.high:.3f})" for r in found if r)))
    return [
        Table("Areas of which a number changes", ("what", "areas", "published"), tuple(local)),
        Table(
            "Share of healthy areas in alarm per step at alpha = 2, with 95 % intervals over runs",
            ("process noise", "diagnosers", "areas", *PHASES),
            tuple(lines),
        ),
    ]


def remarks(rows: Sequence[Row]) -> list[str]:
    """What replugging does, the first for the top of the report."""
    told = {}
    for manner in MANNERS:
        found = [_alarm(rows, p, ph, manner, n) for n in PROCESS_VARIANCE for p in PLACES for ph in PHASES if _near(p, ph)]
        told[manner] = span(r.value for r in found if r is not None)
    before = [_alarm(rows, p, "before", MANNERS[0], n) for n in PROCESS_VARIANCE for p in PLACES]
    anything = [r for r in pick(rows, metric="changed_areas") if "any number" in r.quantity]
    own = [r for r in pick(rows, metric="changed_areas") if "own numbers" in r.quantity]
    return [
        f"Replugged, {told[MANNERS[0]]} of the areas at a change alarm in a step after it, "
        f"{span(r.value for r in before if r)} before; by sec. VI-A to the letter {told[MANNERS[1]]}, not told "
        f"{told[MANNERS[2]]}.",
        "Sec. VI-A sets the angle of an unplugged area to 0 and its weights too. sum_j P_ij in A_ii still holds its tie, so "
        "that its neighbours reckon with a spring that is not there.",
        "Models, weights and thresholds of the own states change of "
        + "; ".join(r.quantity.split(", own numbers of ")[0] + ": " + _who(r) for r in own[:2])
        + ", as B18 has it. 'The FDI units of all other subsystems are unaffected' does not hold of shared angles: counting "
        "the copies that areas hold of their neighbours' angles, "
        + "; ".join(r.quantity.split(", any number of ")[0] + ": " + _who(r) for r in anything[:2])
        + ". They need no new model, but another consensus, which they are told.",
    ]


def _near(place: str, phase: str) -> bool:
    return phase == ("with area 15" if place == "areas 14, 15" else "without area 4")


def _who(r: Row) -> str:
    return r.quantity.split(" of ")[1].rsplit(",", 1)[0]


def _alarm(rows: Sequence[Row], place: str, phase: str, manner: str, noise: str) -> Row | None:
    quantity = f"{place}, {phase}, {manner}, {noise}"
    return next(iter(pick(rows, metric="false_alarm_probability", quantity=quantity)), None)
