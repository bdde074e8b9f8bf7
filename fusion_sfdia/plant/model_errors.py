"""What a model did wrong, in words: the function and line that raised an error, or what it gave in place of numbers."""

from __future__ import annotations

import traceback
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.derivatives.differentiable import Differentiable
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

PACKAGE = Path(__file__).resolve().parents[1]
MODELS = (PACKAGE / "models", PACKAGE.parent / "models")
LIBRARIES = ("site-packages", "dist-packages")
RAISED = (Exception, SystemExit, GeneratorExit)  # what a model may raise; KeyboardInterrupt is of the user


class ModelError(ValueError):
    """A model that raises an error, or gives anything but numbers of the expected shape."""


def require_model(plant: Plant, t_start: float, t: float, x: Array, u: Array) -> None:
    """Raise ModelError unless step and output give real numbers of the expected shapes for a state x (n,), or fail at once.

    NaN and infinities pass: detectors flag them as diverged. `Differentiable` ones have compiled code of one type.
    """
    for what, arguments, count in (
        ("step", (t_start, x, u, t - t_start), len(plant.states)),
        ("output", (t, x, u), len(plant.sensors)),
    ):
        function = getattr(plant, what)
        if isinstance(function, Differentiable):
            continue
        given = function(*arguments)
        try:
            found = np.asarray(given)
        except ValueError:
            found = np.empty(0, object)
        if found.dtype.kind not in "fiu" or found.shape != (count,):
            came = f"{type(given).__name__} of shape {found.shape}" if found.dtype.kind in "fiu" else _kind(given, found)
            raise ModelError(f"its {what} gives {came} for one state; expected {count} real numbers, shape ({count},)")


def _kind(given: Any, found: Array) -> str:
    """What a value is that is no array of real numbers."""
    return "None" if given is None else type(given).__name__ if found.dtype == object else f"values of type {found.dtype}"


def described(error: BaseException) -> str:
    """What a model did wrong: "`flow` (tank.py, line 12) raised KeyError: 'p'"."""
    if isinstance(error, ModelError):
        return str(error)
    text = " ".join(str(error).split())
    raised = f"{type(error).__name__}{f': {text[:200]}' if text else ''}"
    frames = [f for f in traceback.extract_tb(error.__traceback__) if _of_a_model(f.filename)]
    if not frames:
        return f"it gave what no detector can use ({raised})"
    return f"its function `{frames[-1].name}` ({Path(frames[-1].filename).name}, line {frames[-1].lineno}) raised {raised}"


def failed(plant: Plant, when: str, error: BaseException) -> Exception:
    """A ModelError that names plant, time, function and error; an error itself that is for the caller and of no model."""
    of_a_model = any(_of_a_model(f.filename) for f in traceback.extract_tb(error.__traceback__)[1:])
    if isinstance(error, ValueError | ArithmeticError) and not of_a_model:
        return error
    return ModelError(f"the model of plant {plant.name!r} failed {when}: {described(error)}; correct it, then diagnose again")


def _of_a_model(file: str) -> bool:
    path = Path(file)
    if any(path.is_relative_to(folder) for folder in MODELS):
        return True
    return not (path.is_relative_to(PACKAGE) or any(part in LIBRARIES for part in path.parts) or file.startswith("<frozen"))
