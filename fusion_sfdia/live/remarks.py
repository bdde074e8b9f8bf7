"""Lines about rows that were not taken: few, however many there are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

FIRST = 10


@dataclass
class Remarks:
    """Says the first FIRST remarks, then each whose number is 100, 1000, ..., with the number."""

    say: Callable[[str], None]
    count: int = 0

    def __call__(self, remark: str) -> None:
        self.count += 1
        if self.count <= FIRST:
            self.say(remark)
        elif str(self.count).strip("0") == "1":
            self.say(f"{remark} (the {self.count}th such line; others are not shown)")
