"""Text of others, such as titles, tags and file names, where it leaves: shown as it is, and nothing that acts.

A terminal acts on control characters, a spreadsheet on cells that begin like a formula, and a reader is misled by marks that
change the direction of text. `plain` shows such characters by their numbers, `cell` makes a spreadsheet show a text.
"""

from __future__ import annotations

import re
from typing import Any, TextIO

# all controls but tab and line feed, marks of direction, ends of line and paragraph of Unicode, halves of surrogate pairs
ACTING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n", "\uff1d", "\uff0b", "\uff0d", "\uff20")  # also those of full width


def plain(text: str) -> str:
    r"""The text with what a terminal or a page would act on as \u001b, its number: valid in JSON, too."""
    return ACTING.sub(lambda found: f"\\u{ord(found[0]):04x}", text) if ACTING.search(text) else text


def cell(text: str) -> str:
    """A text for a cell of a table: begun with an apostrophe where a spreadsheet would take it for a formula.

    A text that begins with apostrophes and then so gets one more, so that `uncell` returns each text as it was.
    """
    return f"'{text}" if text.lstrip("'").startswith(FORMULA) else text


def uncell(text: str) -> str:
    """The text of a cell that `cell` has written."""
    return text[1:] if text.startswith("'") and text.lstrip("'").startswith(FORMULA) else text


class PlainStream:
    """A stream on which all text is `plain`; everything else is that of the stream."""

    def __init__(self, stream: TextIO) -> None:
        self.acting = stream

    def write(self, text: str) -> int:
        self.acting.write(plain(text))
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.acting, name)


def acting(stream: Any) -> Any:
    """The stream itself of a PlainStream, for what draws on a terminal, such as a bar of progress."""
    return stream.acting if isinstance(stream, PlainStream) else stream
