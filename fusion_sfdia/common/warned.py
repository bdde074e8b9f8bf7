"""Warnings that point at the line of the user's code from which the package was called."""

from __future__ import annotations

import os
import sys
import warnings
from pathlib import Path

PACKAGE = f"{Path(__file__).parents[1]}{os.sep}"


def warn(text: str, category: type[Warning] = UserWarning) -> None:
    """Warn of `text` at the nearest caller outside the package, or at the outermost one."""
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and frame.f_code.co_filename.startswith(PACKAGE):
        frame, level = frame.f_back, level + 1
    warnings.warn(text, category, stacklevel=level)


def warn_renamed(former: str, now: str) -> None:
    """Warn that a name has another one since this release."""
    warn(f"{former} is now {now}; the former name will be removed in the next release", DeprecationWarning)
