"""Errors that callers tell apart, and warnings that point at the line of the user's code from which the package was called."""

import os
import sys
import warnings
from pathlib import Path

PACKAGE = f"{Path(__file__).parents[1]}{os.sep}"


class NotApplicableError(ValueError):
    """A detector on a plant that lacks what its method needs: scalar equations, noise bounds, enough sensors.

    Examples
    --------
    >>> from fusion_sfdia import NotApplicableError, Sensor, detector, linear_plant
    >>> plant = linear_plant("tank", [[0.97]], [[1.0]], [Sensor("gauge", "x0", sigma=0.01)], dt=60.0, x0=[0.0],
    ...                      initial_cov=[1e-4], process_cov=[1e-6])
    >>> try:
    ...     detector("adaptive-threshold", plant)
    ... except NotApplicableError as error:
    ...     print("not applicable")
    <Diagnoser adaptive-threshold on tank>
    """


class MissingPackageError(NotApplicableError, ModuleNotFoundError):
    """Something that needs a package which is not installed; the message names the extra to install.

    Examples
    --------
    >>> from fusion_sfdia import MissingPackageError, NotApplicableError
    >>> issubclass(MissingPackageError, NotApplicableError)
    True
    """


def warn(text: str, category: type[Warning] = UserWarning) -> None:
    """Warn of `text` at the nearest caller outside the package, or at the outermost one."""
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and frame.f_code.co_filename.startswith(PACKAGE):
        frame, level = frame.f_back, level + 1
    warnings.warn(text, category, stacklevel=level)


def warn_renamed(former: str, now: str) -> None:
    """Warn that a name has another one since this release."""
    warn(f"{former} is now {now}; the former name will be removed in the next release", DeprecationWarning)
