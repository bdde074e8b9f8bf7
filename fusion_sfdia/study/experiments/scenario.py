"""A scenario: an experiment as data, the independent pieces of its Monte Carlo, and how they become numbers and figures."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from numpy.typing import NDArray

from fusion_sfdia.common.arguments import shown
from fusion_sfdia.common.numerals import decimal, integer
from fusion_sfdia.report.content import NAME, Summary, require_name

Array = NDArray[Any]
Arrays = dict[str, Array]
Setting = bool | int | float | str | tuple[Any, ...]
Settings = Mapping[str, Any]  # of Setting
Task = Mapping[str, Any]

USUAL = (1e-6, 1e6)  # least and largest number of a setting, unless its scenario states other bounds
LONGEST = 1000  # characters of a setting that is a text, such as a path
YES, NO = ("true", "yes", "on", "1"), ("false", "no", "off", "0")


@dataclass(frozen=True)
class Scenario:
    """An experiment on simulated or recorded data.

    settings: names and defaults, which `--set name=value` overrides; a value has the type of its default, a tuple the
    type of its first entry. seeds: runs by default; full_seeds: the size of the paper, with `--full`.
    bounds: the least and largest value of a setting, where they are not USUAL, or at least 1 for a whole number.
    optional: the settings that may be an empty tuple. papers: keys of the papers whose numbers it has beside its own.
    full: what `--full` sets in addition to the size: settings of the whole paper, unless `--set` names them.
    tasks(settings, seeds): the independent pieces of work, each a mapping of JSON values that decides all its bits.
    work(task): one piece, in a process of its own: arrays only, and on one machine the same bits for the same task. Scenarios
    with the same work share the pieces whose tasks are equal.
    summarise(settings, results): from the (task, arrays) that succeeded, in the order of tasks.
    """

    name: str
    title: str
    about: str
    settings: Settings
    seeds: int
    full_seeds: int
    tasks: Callable[[Settings, int], list[Task]]
    work: Callable[[Task], Arrays]
    summarise: Callable[[Settings, list[tuple[Task, Arrays]]], Summary]
    full: Settings = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    optional: tuple[str, ...] = ()
    papers: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        require_name("scenario", self.name, f"{NAME}(/{NAME})*")
        if not 1 <= self.seeds <= self.full_seeds:
            raise ValueError(
                f"scenario {self.name}: {self.seeds} seeds, {self.full_seeds} in full; expected 1 <= seeds <= full"
            )


def adjust(scenario: Scenario, changes: Mapping[str, str], *, full: bool = False) -> dict[str, Setting]:
    """Return the scenario's settings, or those of the whole paper, with some changed, given as text.

    Raises ValueError for unknown names, wrong types, numbers out of bounds, and tuples that are empty or repeat a value.
    """
    unknown = [k for k in changes if k not in scenario.settings]
    if unknown:
        known = ", ".join(f"{k}={setting_text(v)}" for k, v in scenario.settings.items()) or "none"
        raise ValueError(f"scenario {scenario.name} has no setting {', '.join(unknown)}; its settings: {known}")
    usual = {**scenario.settings, **(scenario.full if full else {})}
    return {k: _changed(scenario, k, changes[k], v) if k in changes else v for k, v in usual.items()}


def _changed(scenario: Scenario, key: str, text: str, default: Setting) -> Setting:
    """A setting from its text, of the type of its default and within its bounds."""
    low, high = scenario.bounds.get(key, USUAL)
    if not isinstance(default, tuple):
        return _typed(key, text, default, low, high)
    like = default[0] if default else ""
    found = tuple(_typed(key, part.strip(), like, low, high) for part in text.split(",") if part.strip())
    if not (found or key in scenario.optional):
        raise ValueError(f"setting {key} is empty; expected at least one value, such as {setting_text(like)}")
    if twice := [v for v in found if found.count(v) > 1]:
        raise ValueError(f"setting {key} is {shown(text)}; expected each value once, {shown(twice[0])} occurs twice")
    return found


def _typed(key: str, text: str, default: Setting, low: float, high: float) -> Setting:
    if isinstance(default, bool):
        if text.lower() not in YES + NO:
            raise ValueError(f"setting {key} is {shown(text)}; expected true or false")
        return text.lower() in YES
    if isinstance(default, str):
        if not (text.isprintable() and len(text) <= LONGEST):
            raise ValueError(f"setting {key} is {shown(text)}; expected at most {LONGEST} printable characters")
        return text
    assert isinstance(default, int | float)
    read, kind = (integer, "a whole number") if isinstance(default, int) else (decimal, "a number")
    low = math.ceil(low) if isinstance(default, int) else low
    try:
        if low <= (value := read(text)) <= high:
            return value
    except ValueError:
        pass  # it is no number at all
    raise ValueError(
        f"setting {key} is {shown(text)}; expected {kind} from {low:.10g} to {high:.10g}, such as {setting_text(default)}"
    )


def setting_text(value: Setting) -> str:
    """A setting as the text that `adjust` reads."""
    if isinstance(value, tuple | list):
        return ",".join(map(setting_text, value))
    return str(value).lower() if isinstance(value, bool) else str(value)


def seed_blocks(seeds: int, size: int, first: int = 0) -> list[list[int]]:
    """Return the seeds first .. first + seeds - 1 in blocks of at most `size`, each the work of one task."""
    everyone = list(range(first, first + seeds))
    return [everyone[i : i + size] for i in range(0, seeds, size)]
