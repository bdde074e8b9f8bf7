"""Numbers in logs, settings and options: as people write and spreadsheets export them, not all that Python accepts.

float and int also take 1_0, which is a typing error or a name in a table of data, and the digits of other scripts.
"""


def decimal(text: str) -> float:
    """Return the number that a text states; ValueError unless it is written with the digits 0 to 9, or is infinity or NaN."""
    return float(_plain(text))


def integer(text: str) -> int:
    """Return the whole number that a text states; ValueError as for `decimal`."""
    return int(_plain(text))


def _plain(text: str) -> str:
    if not text.isascii() or "_" in text:
        raise ValueError("expected only digits from 0 to 9")
    return text
