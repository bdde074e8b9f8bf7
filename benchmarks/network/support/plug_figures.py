"""The figures, tables and sentences of network/plug."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure as Drawing
from numpy.typing import NDArray

from fusion_sfdia.models.power_network.model import PROCESS_VARIANCE
from fusion_sfdia.report.content import Figure, ResultTable
from fusion_sfdia.report.plots import COLOURS, DASHES, legend_above, panels
from fusion_sfdia.report.results import Row
from fusion_sfdia.report.scenario_sentences import span

Array = NDArray[Any]

LEAVES, JOINS = "area 4 unplugged", "area 15 plugged in"
MANNERS = ("replugged", "sec. VI-A literally", "not updated")
PHASES = {"before": (10, 44), "without area 4": (44, 71), "with area 15": (71, 96)}  # samples
NUMBERS = ("model", "weights", "thresholds", "copies")
PLACES = {"area 4": ("4",), "areas 3, 5, 13": ("3", "5", "13"), "areas 14, 15": ("14", "15")}
CHANGED_IN = {"area 4": "without area 4", "areas 3, 5, 13": "without area 4", "areas 14, 15": "with area 15"}  # phase by place


class Changed(NamedTuple):
    """The key of a row: areas of which some numbers change at an event."""

    event: str
    what: str
    noise: str
    areas: tuple[str, ...]

    @property
    def who(self) -> str:
        """The areas as text."""
        return f"areas {', '.join(self.areas)}"


class FirstAlarm(NamedTuple):
    """The key of a row: alarms in a place and phase, with the diagnosers in one of MANNERS."""

    place: str
    phase: str
    manner: str
    noise: str
    metric: str = "false_alarm_probability"


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
        "Numbers that change when an area is unplugged or plugged in",
        "Blue: some bit changes. Model, weights and thresholds of an area's own states change only in the area and its "
        "neighbours. But the new consensus is sent to all areas that share their angles, so that the copies that their "
        "neighbours hold change, too: in areas that have no tie to the area that is switched.",
        draw,
        "Grid of the areas by kind of number, coloured where a bit changes, for one area unplugged and one plugged in",
    )


def alarm_figure(curves: Mapping[tuple[str, str], Array], names: tuple[str, ...], finding: str) -> Figure:
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
        "Share of the runs and areas with an alarm, mean of three steps. Dotted: area 4 is unplugged, area 15 plugged in. "
        f"{finding} Where the diagnosers are not updated, missing readings widen the thresholds, which hides part of the "
        "error.",
        draw,
        "Alarm rates over time of three groups of areas for three manners of updating the diagnosers after a change",
    )


SHOWN = 10  # s from which alarms are drawn


def tables(changed: Mapping[Changed, Row], alarms: Mapping[FirstAlarm, Row]) -> list[ResultTable]:
    """Which areas change; alarms by phase."""
    local = [
        (k.event, k.what, k.noise, k.who, f"{r.value:g}", "" if r.published is None else f"{r.published:g}")
        for k, r in changed.items()
    ]
    lines = []
    for noise in PROCESS_VARIANCE:
        for manner in MANNERS:
            for place in (*PLACES, "other areas"):
                found = [_one(alarms, place, phase, manner, noise) for phase in PHASES]
                if all(r is not None for r in found):
                    lines.append((noise, manner, place, *(f"{r.value:.3f} ({r.low:.3f} to {r.high:.3f})" for r in found if r)))
    return [
        ResultTable(
            "Areas of which a number changes",
            ("event", "what", "process noise", "which", "areas", "published"),
            tuple(local),
        ),
        ResultTable(
            "Share of healthy areas in alarm per step at alpha = 2, with 95 % intervals over runs",
            ("process noise", "diagnosers", "areas", *PHASES),
            tuple(lines),
        ),
    ]


def remarks(changed: Mapping[Changed, Row], alarms: Mapping[FirstAlarm, Row]) -> list[str]:
    """The effect of replugging, the first for the top of the report."""
    after = {}
    for manner in MANNERS:
        found = [_one(alarms, place, phase, manner, n) for n in PROCESS_VARIANCE for place, phase in CHANGED_IN.items()]
        after[manner] = span(r.value for r in found if r is not None)
    before = [_one(alarms, place, "before", MANNERS[0], n) for n in PROCESS_VARIANCE for place in PLACES]
    own, anything = (
        "; ".join(f"{k.event}: {k.who}" for k in list(changed)[: len(changed) // 2] if k.what == what)
        for what in ("own numbers", "any number")
    )
    return [
        f"Replugged, {after[MANNERS[0]]} of the areas at a change have an alarm in a step after it, "
        f"{span(r.value for r in before if r)} before it; by sec. VI-A literally {after[MANNERS[1]]}, not updated "
        f"{after[MANNERS[2]]}.",
        "Sec. VI-A sets the angle and the weights of an unplugged area to 0. sum_j P_ij in A_ii still contains its tie, so "
        "that the model of its neighbours contains a stiffness that is no longer present.",
        f"Areas of which models, weights and thresholds of the own states change: {own}, as B18 states. 'The FDI units of all "
        "other subsystems are unaffected' does not hold for shared angles: with the copies that areas hold of their "
        f"neighbours' angles, {anything}. They need no new model, but a new consensus, which they receive.",
    ]


def _one(alarms: Mapping[FirstAlarm, Row], place: str, phase: str, manner: str, noise: str) -> Row | None:
    return alarms.get(FirstAlarm(place, phase, manner, noise))
