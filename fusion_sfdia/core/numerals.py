"""Numbers in logs, settings and options: what a person writes and a spreadsheet exports, not all that Python reads.

float and int also take 1_0, which is a typing error or a name in a table of data, and the digits of other scripts.
"""


def decimal(text: str) -> float:
    """Return the number that a text stands for; ValueError for anything but one in the digits 0 to 9, infinity or NaN."""
    return float(_plain(text))


def integer(text: str) -> int:
    """Return the whole number that a text stands for; ValueError as of `decimal`."""
    return int(_plain(text))


def _plain(text: str) -> str:
    if not text.isascii() or "_" in text:
        raise ValueError("expected digits from 0 to 9 alone")
    return text
