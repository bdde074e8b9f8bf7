"""A watch whose events are written before its state is saved, so that none is lost when the process is killed."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Any

from fusion_sfdia.common.files import explained
from fusion_sfdia.diagnosis.changes import Change
from fusion_sfdia.diagnosis.sentences import Words, wordings
from fusion_sfdia.diagnosis.watch import Sample, Watch
from fusion_sfdia.live.lines import change_line, sample_line
from fusion_sfdia.live.status import Status


@dataclass
class SavedWatch:
    """A watch with its output and its state file.

    Each row is diagnosed, its lines are written, and then, every `every` rows, the state is saved to `path` (None: never). A
    process that is killed has therefore written all events until the saved time, and perhaps some after it. Given the rows
    after that time again, it writes these once more, with the same ids and bytes: of equal lines one is dropped, and a last
    line without its end is no line.
    """

    watch: Watch
    write: Callable[[str], None]  # a line, at once
    path: Path | None = None
    every: int = 1000
    samples: bool = False
    rows: int = 0
    saved: int = 0  # rows that the state has
    whole: bool = True  # whether all lines of the rows taken are written
    status: Status | None = None
    outlets: list[Callable[[Change, str], object]] = field(default_factory=list)  # called with each change and its line
    takers: list[Callable[[tuple[Sample, ...]], object]] = field(default_factory=list)  # called with the rows diagnosed
    undivided: Callable[[], AbstractContextManager[None]] = nullcontext  # around each row: a signal may end it, not break it

    def __post_init__(self) -> None:
        if self.path is not None:
            _ = self.watch.identity  # while the model works: a save may come when it fails

    def update(self, t: float | datetime, y: Any, u: Any) -> tuple[Sample, ...]:
        """Diagnose a row as `Watch.update`, write its lines, and save where it is time."""
        with self.undivided():
            self.whole = False
            return self._written(self.watch.update(t, y, u))

    def finish(self) -> tuple[Sample, ...]:
        """At the end of the input, the same for the rows that `Watch.finish` diagnoses, and the lines of `Watch.last`."""
        self.whole = False
        found = self._written(self.watch.finish())
        for change in self.watch.last():
            self._changed(change)
        return found

    @cached_property
    def _words(self) -> Words:
        return wordings(self.watch.detector)

    def _changed(self, change: Change) -> None:
        self.write(line := change_line(change, self.watch.clock, self._words))
        for outlet in self.outlets:
            outlet(change, line)

    def _written(self, found: tuple[Sample, ...]) -> tuple[Sample, ...]:
        watch = self.watch
        for sample in found:
            for change in sample.changes:
                self._changed(change)
            if self.samples:
                self.write(sample_line(sample, watch.detector.plant, watch.detector.hypotheses, watch.clock))
        self.rows, self.whole = self.rows + len(found), True
        if self.status is not None:
            self.status.taken(found)
        for taker in self.takers:
            taker(found)
        if self.rows - self.saved >= self.every:
            try:
                self.save()
            except OSError as error:
                watch.refused(f"the state is not saved ({explained(error)}); it is tried again with the next row")
        return found

    def save(self) -> None:
        """Save the state, unless a row was interrupted before its lines were written."""
        if self.path is not None and self.whole and self.rows > self.saved:
            self.watch.save(self.path)
            self.saved = self.rows
