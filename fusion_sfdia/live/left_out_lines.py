"""Lines about what was not taken: few, however many there are, and none hidden by those of another kind."""

from __future__ import annotations

import re
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

FIRST = 10
VALUES = re.compile(r"'(?:[^'\\]|\\.)*'|\"(?:[^\"\\]|\\.)*\"|[+-]?\d[\d.:+-]*")  # what differs between lines of one kind
MOST_KINDS = 1000


@dataclass
class Remarks:
    """Passes on the first FIRST remarks of each kind, then the 100th, the 1000th and so on, with their number.

    Remarks are of one kind where they differ only in numbers, times and what is quoted.
    """

    say: Callable[[str], None]
    kinds: Counter[str] = field(default_factory=Counter)
    lock: threading.Lock = field(default_factory=threading.Lock, repr=False)  # of the counts: any thread may remark

    @property
    def count(self) -> int:
        """How many remarks there were."""
        return self.kinds.total()

    def __call__(self, remark: str) -> None:
        kind = VALUES.sub("#", remark)[:200]
        with self.lock:
            if kind not in self.kinds and len(self.kinds) >= MOST_KINDS:
                kind = ""
            self.kinds[kind] += 1
            count = self.kinds[kind]
        if count <= FIRST:
            self.say(remark)
        elif str(count).strip("0") == "1":
            self.say(f"{remark} (the {count}th such line; others are not shown)")
