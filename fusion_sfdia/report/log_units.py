"""A diagnosis in the tags and units of the log that it was read from, for the people who work with these."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.diagnosis.diagnose import Diagnosis
from fusion_sfdia.diagnosis.events import Event, ProcessEvent, UndecidedEvent
from fusion_sfdia.diagnosis.sentences import Words
from fusion_sfdia.logs.columns import Source, split_title
from fusion_sfdia.logs.conversion import conversion
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.uncertainty import error_of

Array = NDArray[Any]


def with_brackets(name: str, unit: str, between: str = " ") -> str:
    """A name with its unit, as beside an axis and in a title; the unit 1 is none."""
    return name if unit == "1" else f"{name}{between}[{unit}]"


class LogUnits:
    """How the sensors of a plant are called and measured in a log, by the columns that feed them.

    A sensor is shown as "flow (FI130.PV)", its tag behind it, in the unit of its column; in a sentence, where its meaning says
    what it reads, by its tag alone. A size, which is a difference, is
    scaled and not shifted: 5 K are 5 degC. Sensors without a column and other hypotheses stay as they are.
    """

    def __init__(self, plant: Plant, columns: Sequence[Source]) -> None:
        self.of, self.names = plant, {s.name: s.name for s in plant.sensors}
        self.tags: dict[str, str] = {}  # of the sensors that have a column
        self.factor, self.offset = np.ones(len(plant.sensors)), np.zeros(len(plant.sensors))  # plant = factor log + offset
        sensors, self._inputs = list(plant.sensors), [(s.name, s.unit, 1.0, 0.0) for s in plant.inputs]
        for c in columns:
            title = split_title(c.title)[0]
            if c.is_input:
                unit = plant.inputs[c.position].unit
                self._inputs[c.position] = (title, c.unit or unit, *conversion(c.unit, unit))
                continue
            s = sensors[c.position]
            self.tags[c.name] = title
            name = self.names[c.name] = c.name if title == c.name else f"{c.name} ({title})"
            self.factor[c.position], self.offset[c.position] = conversion(c.unit, s.unit)
            sigma, bound, period, step = (
                v and v / abs(self.factor[c.position]) for v in (s.sigma, s.bound, s.period, s.resolution)
            )
            sensors[c.position] = replace(
                s, name=name, unit=c.unit or s.unit, sigma=sigma, bound=bound, period=period, resolution=step or 0.0
            )
        self.errors = {error_of(s.name): of for s, of in zip(plant.inputs, self._inputs, strict=True)}
        self.same = bool(np.all(self.factor == 1) and np.all(self.offset == 0))  # then nothing is copied
        self.own, self.units = plant.sensor_names, tuple(s.unit for s in plant.sensors)
        self.plant = replace(plant, sensors=tuple(sensors))  # names, units and noise alone: its output is the plant's

    @property
    def short(self) -> list[str]:
        """Of each sensor its tag, or its name where it has no column."""
        return [self.tags.get(name, name) for name in self.own]

    def titles(self, *, inputs: bool) -> list[str]:
        """Titles of columns as in the log, "FI130.PV [m3/h]", or "TT1" where it has no unit: of the sensors and, where there
        are any, of the inputs.
        """
        units = [s.unit for s in self.plant.sensors]
        known = [*zip(self.short, units, strict=True), *((name, unit) for name, unit, *_ in (self._inputs if inputs else ()))]
        return [with_brackets(name, unit) for name, unit in known]

    def inputs(self, u: Array) -> Array:
        """Inputs (K, m) in the units of the log; of none also (K, 0)."""
        if all((factor, offset) == (1, 0) for *_, factor, offset in self._inputs) or not u.size:
            return u
        factor, offset = np.array([(f, o) for *_, f, o in self._inputs]).T
        return np.asarray((u - offset) / factor)

    def readings(self, y: Array) -> Array:
        """Readings (K, N) in the units of the log."""
        return y if self.same else np.asarray((y - self.offset) / self.factor)

    def diagnosis(self, found: Diagnosis) -> Diagnosis:
        """A diagnosis for people: events, health, readings and errors of inputs in the names and units of the log."""
        after, health = found.after, found.health
        if after is not None and not self.same:
            after = after._replace(error=after.error / self.factor, sd=after.sd / np.abs(self.factor))
        if health is not None:
            excess, shifts = ({self._named(n): value for n, value in of.items()} for of in (health.excess, health.shifts))
            untested = tuple(map(self._named, health.untested))
            health = health._replace(excess=excess, shifts=shifts, untested=untested)
        decisions = replace(found.decisions, reconstruction=self.readings(found.decisions.reconstruction))
        if decisions.process_size is not None and decisions.process_sd is not None:
            factor = np.array([self.errors[h.name][2] if h.name in self.errors else 1.0 for h in found.process_hypotheses])
            sd = decisions.process_sd / np.abs(factor)
            decisions = replace(decisions, process_size=decisions.process_size / factor, process_sd=sd)
        return replace(
            found,
            words=self._words(found.words),
            events=tuple(self._event(e) for e in found.events),
            decisions=decisions,
            after=after,
            health=health,
        )

    def _event(self, e: Event) -> Event:
        e = replace(e, alternatives=tuple(map(self._named, e.alternatives)))
        if isinstance(e, UndecidedEvent):
            suspects = tuple(map(self._named, e.suspects))
            return replace(e, hypothesis=" or ".join(suspects), suspects=suspects)
        if isinstance(e, ProcessEvent) and (of := self.errors.get(e.hypothesis)):
            _, unit, factor, _ = of
            return replace(e, size=e.size / factor, sd=e.sd / abs(factor), unit=unit)
        if e.kind != "sensor" or e.hypothesis not in self.own:
            return e
        i = self.own.index(e.hypothesis)
        ends = sorted((e.low / self.factor[i], e.high / self.factor[i]))
        unit = self.plant.sensors[i].unit
        return replace(
            e, hypothesis=self._named(e.hypothesis), size=e.size / self.factor[i], low=ends[0], high=ends[1], unit=unit
        )

    def _words(self, words: Words) -> Words:
        """The words with tags in place of names, or behind them, and possible sizes in the units of the log."""
        found = {}
        for name, w in words.items():
            shown, factor = self.tags.get(name, w.name), 1.0
            if of := self.errors.get(name):
                shown, _, factor, _ = of
            both = shown if w.meaning or shown == w.name else f"{w.name} ({shown})"
            low, high = sorted((w.low / factor, w.high / factor))
            found[self._named(name)] = w._replace(name=both, low=low, high=high)
        return found

    def _named(self, name: str) -> str:
        return self.names.get(name, name)
