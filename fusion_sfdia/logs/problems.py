"""The problems of a log, collected while it is read, so that one run states all of them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

MOST = 30  # lines of an error

EXAMPLE = re.compile(r"\([^()]*\)|\d")  # in a cure: of one column alone
PLACE = re.compile(r"(?:, row (\d+))?(?:, column (.+?))?: (.*)", re.DOTALL)


class CountedError(ValueError):
    """An error on rows or cells; count: how many have it."""

    def __init__(self, message: str, count: int) -> None:
        super().__init__(message)
        self.count = count


@dataclass(frozen=True)
class Problem:
    """One problem: its kind, the file, the row (0: none) and the column ("": none) where it stands, what came, and the cure.

    count: how many rows or cells have it.
    """

    kind: str
    where: str
    row: int
    column: str
    count: int
    text: str
    cure: str

    @classmethod
    def of(cls, kind: str, where: str, error: ValueError, column: str = "") -> Problem:
        """The problem that an error states, as in "log.csv, row 3, column level: 'x'; expected a finite number"."""
        message, row = str(error), 0
        if not message.startswith(where) or not (place := PLACE.fullmatch(message[len(where) :])):
            where, column = "", ""
        else:
            own = f", column {column}: "
            before, known, after = message[len(where) :].partition(own) if column else ("", "", "")
            if known and (match := re.fullmatch(r"(?:, row (\d+))?", before)):  # a title may hold a colon
                row, message = int(match[1] or 0), after
            else:
                row, column, message = int(place[1] or 0), place[2] or "", place[3]
        text, _, cure = message.partition("; ")
        return cls(kind, where, row, column, error.count if isinstance(error, CountedError) else 1, text, cure)

    @property
    def message(self) -> str:
        """What came and the cure, without the place."""
        return f"{self.text}; {self.cure}" if self.cure else self.text

    def at(self, where: str) -> str:
        """The problem with its place behind `where`, the file or nothing."""
        places = [where, f"row {self.row}" * bool(self.row), f"column {self.column}" * bool(self.column)]
        place = ", ".join(p for p in places if p)
        return f"{place}: {self.message}" if place else self.message

    def __str__(self) -> str:
        return self.at(self.where)


class LogError(ValueError):
    """A log that cannot be read as it is: its `problems`. As text a line each; of the same one in several columns one line."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        super().__init__(tuple(problems))
        self.problems = tuple(problems)

    def __str__(self) -> str:
        lines = [" ".join(line.split()) for line in _lines(self.problems)]
        if len(self.problems) == 1:
            return " ".join(str(self.problems[0]).split())
        if len(lines) > MOST:
            lines[MOST - 1 :] = [f"and {len(lines) - MOST + 1} more problems"]
        where = next((p.where for p in self.problems if p.where), "the log")
        return "\n  ".join([f"{where}: {len(self.problems)} problems", *lines])


class Problems:
    """Collects the problems of a log from the errors on its parts, each of which is read on its own."""

    def __init__(self, where: str) -> None:
        self.where = where
        self.problems: list[Problem] = []

    @contextmanager
    def collecting(self, kind: str, column: str = "") -> Iterator[None]:
        """Take a ValueError of the block as a problem of this kind, of this column, and go on behind the block."""
        try:
            yield
        except ValueError as error:
            self.take(kind, error, column)

    def take(self, kind: str, error: ValueError, column: str = "") -> None:
        """Add what an error states; of a LogError its problems, whatever their kind."""
        if isinstance(error, LogError):
            self.problems += error.problems
        else:
            self.problems.append(Problem.of(kind, self.where, error, column))

    def add(self, kind: str, message: str, *, row: int = 0, column: str = "", count: int = 1) -> None:
        """Add a problem whose message is "what came; expected, and the cure"."""
        text, _, cure = message.partition("; ")
        self.problems.append(Problem(kind, self.where, row, column, count, text, cure))

    def amend(self, kind: str, cure: str) -> None:
        """Add to the cure of the first problem of this kind, if there is one."""
        k = next((k for k, p in enumerate(self.problems) if p.kind == kind), None)
        if k is not None:
            self.problems[k] = replace(self.problems[k], cure=f"{self.problems[k].cure}{cure}")

    def of(self, *kinds: str) -> list[Problem]:
        """The problems of these kinds."""
        return [p for p in self.problems if p.kind in kinds]

    def require_none(self) -> None:
        """Raise LogError if there are any problems."""
        if self.problems:
            raise LogError(tuple(dict.fromkeys(self.problems)))


def _lines(problems: Sequence[Problem]) -> list[str]:
    """A line for each problem; of several columns with the same cure, but for its numbers, one line, which shows the first."""
    groups: dict[tuple[str, str], list[Problem]] = {}
    for p in problems:
        cure = EXAMPLE.sub("", p.cure.rpartition("; ")[2])
        groups.setdefault((p.kind, cure if p.column and p.cure else str(p)), []).append(p)
    lines = []
    for group in groups.values():
        columns = list(dict.fromkeys(p.column for p in group))
        if len(columns) == 1:
            lines += [p.at("") for p in group]
            continue
        names = ", ".join(columns[:8]) + (f" and {len(columns) - 8} more" if len(columns) > 8 else "")
        lines.append(f"{len(columns)} columns ({names}), first {group[0].at('')}")
    return lines
