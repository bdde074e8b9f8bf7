"""A time that stands for all times: a model that reads it fails, so what a model returns for it holds at any time."""

from __future__ import annotations

from typing import Any, NoReturn


class AnyTime:
    """A time that is no number: arithmetic, comparisons and conversions of it raise TypeError."""

    __slots__ = ()
    __hash__ = None  # type: ignore[assignment]

    def _used(self, *_: object) -> NoReturn:
        raise TypeError("the model depends on the time")

    __eq__ = __ne__ = __bool__ = __array__ = _used


ANY_TIME: Any = AnyTime()
