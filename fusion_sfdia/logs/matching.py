"""Which tag of a log is which sensor or input of a plant, by names, units and usual values."""

from __future__ import annotations

import re
from collections.abc import Sequence
from difflib import SequenceMatcher
from typing import Any, NamedTuple, Protocol

import numpy as np
import scipy  # whose optimize is imported at its first use
from numpy.typing import NDArray

from fusion_sfdia.logs.conversion import conversion
from fusion_sfdia.logs.log_map import Column
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

LIKELY = 0.75  # score from which a tag is taken for a sensor or an input
CLOSE = 0.3  # difference of scores within which another fits as well
WITHIN = 0.25  # of the nominal value: a usual reading
UNITS = (
    "mm", "cm", "m", "degC", "degF", "K", "mbar", "bar", "barg", "kPa", "MPa", "psi", "l/min", "l/s", "m3/h", "kg/h", "t/h",
    "kW", "MW", "rpm", "%",
)  # fmt: skip
# what the first letter of an instrument's tag measures (ISA 5.1), in units of it
LETTERS = {
    "T": ("K",), "P": ("Pa",), "L": ("m", "1"), "F": ("m3/s", "kg/s"), "S": ("rad/s", "1/s"), "J": ("W",), "I": ("A",),
    "E": ("V",), "D": ("kg/m3",), "W": ("kg", "N"),
}  # fmt: skip
TAG = re.compile(r"(?:^|[^A-Za-z])([A-Z])[A-Z]{0,3}[-_. ]?\d{2,}")


class Tagged(Protocol):
    """A tag: name, unit ("" where it states none), and readings."""

    @property
    def title(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def unit(self) -> str: ...
    @property
    def values(self) -> Array: ...


class Target(NamedTuple):
    """A sensor or an input of the plant, with the value that is usual."""

    name: str
    is_input: bool
    unit: str
    usual: float


class Match(NamedTuple):
    """What a tag is, None where nothing fits, and a note: unsure, with what fits as well."""

    column: Column | None
    note: str


def matched(tags: Sequence[Tagged], plant: Plant) -> list[Match]:
    """Return what each tag is: together as likely as can be, each sensor and input at most once."""
    u = plant.input_at(0.0)
    readings = np.asarray(plant.output(0.0, plant.x0, u), dtype=float)
    targets = [Target(s.name, False, s.unit, float(readings[i])) for i, s in enumerate(plant.sensors)]
    targets += [Target(s.name, True, s.unit, float(u[i])) for i, s in enumerate(plant.inputs)]
    scored = [[_score(tag, target) for target in targets] for tag in tags]
    scores = np.array([[score for score, _ in row] for row in scored]).reshape(len(tags), len(targets))
    chosen = dict(zip(*(k.tolist() for k in scipy.optimize.linear_sum_assignment(-scores)), strict=True))
    return [_match(tag, targets, scored[k], chosen.get(k)) for k, tag in enumerate(tags)]


def _match(
    tag: Tagged, targets: Sequence[Target], scored: Sequence[tuple[float, tuple[str, ...]]], chosen: int | None
) -> Match:
    order = sorted(range(len(targets)), key=lambda i: -scored[i][0])
    if chosen is None or scored[chosen][0] < LIKELY:
        near = [targets[i].name for i in order[:3] if scored[i][0] > 0]
        return Match(None, f"unsure: not taken for any; nearest: {', '.join(near)}" if near else "nothing of the plant fits")
    target, (score, units) = targets[chosen], scored[chosen]
    others = [targets[i].name for i in order if i != chosen and scored[i][0] > score - CLOSE][:4]
    notes = [f"by name, unit and value also {', '.join(others)}"] if others and tag.name != target.name else []
    if units:
        notes.append(f"no unit in the log; its values fit {' or '.join(units)}")
    unit = tag.unit or (units[0] if units else "")
    column = Column(input=target.name, unit=unit) if target.is_input else Column(target.name, unit=unit)
    return Match(column, f"unsure: {'; '.join(notes)}" if notes else "")


def _score(tag: Tagged, target: Target) -> tuple[float, tuple[str, ...]]:
    """How well a tag fits a sensor or input, and the units, likeliest first, in which its values do where it states none."""
    if tag.name == target.name:
        name = 3.0
    else:
        one, other = (re.sub(r"\W|_", "", text).casefold() for text in (tag.name, target.name))
        name = SequenceMatcher(None, one, other, autojunk=False).ratio()
        name = max(name, 0.8) if len(other) > 2 and other in one else name if name > 0.4 else 0.0
    score = name
    if (match := TAG.search(tag.name)) and match[1] in LETTERS:
        score += 0.5 if any(_converts(unit, target.unit) for unit in LETTERS[match[1]]) else -0.5
    numbers = [re.findall(r"\d+", text)[-1:] for text in (tag.name, target.name)]
    if all(numbers):
        score += 0.15 if numbers[0][0].endswith(numbers[1][0]) else -0.1
    usual = float(np.nanmedian(tag.values))
    if tag.unit:
        if not _converts(tag.unit, target.unit):
            return score - 1.0, ()
        return score + 0.3 + (0.4 if _fits(conversion(tag.unit, target.unit)(usual), target) else 0.0), ()
    if _fits(usual, target):
        return score + 0.4, ()
    fitting = [u for u in UNITS if _converts(u, target.unit) and _fits(conversion(u, target.unit)(usual), target)]
    fitting.sort(key=lambda u: abs(conversion(u, target.unit)(usual) - target.usual))
    return score + (0.3 if fitting else -0.2), tuple(fitting[:3])


def _fits(value: float, target: Target) -> bool:
    return abs(value - target.usual) <= WITHIN * abs(target.usual)


def _converts(unit: str, target: str) -> bool:
    try:
        conversion(unit, target)
    except ValueError:
        return False
    return True
