"""What a notebook shows of an object: a title, a line and a short table, in which every text is escaped."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

from fusion_sfdia.common.plain_text import plain

MOST = 10  # rows


def as_html(title: str, line: str = "", header: Sequence[str] = (), rows: Sequence[Iterable[Any]] = ()) -> str:
    """A title, a line where there is one, and the first `MOST` rows of a table with a header; more are counted."""
    parts = [f"<p><b>{_text(title)}</b></p>"]
    parts += [f"<p>{_text(line)}</p>"] if line else []
    if rows:
        body = "".join(_row("td", row) for row in rows[:MOST])
        parts.append(f"<table><thead>{_row('th', header)}</thead><tbody>{body}</tbody></table>")
    parts += [f"<p>and {len(rows) - MOST} more</p>"] if len(rows) > MOST else []
    return "".join(parts)


def _row(tag: str, cells: Iterable[Any]) -> str:
    return f"<tr>{''.join(f'<{tag}>{_text(cell)}</{tag}>' for cell in cells)}</tr>"


def _text(value: Any) -> str:
    return escape(plain(f"{value:.4g}" if isinstance(value, float) else str(value)))
