"""Assertions on arrays, Decisions and states, with messages of what was expected and found."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import shown
from fusion_sfdia.detectors.detector import Decision, Detector, run
from fusion_sfdia.detectors.state import State, leaves, names

Array = NDArray[Any]


def require(holds: Any, expected: str, found: object) -> None:
    """Raise AssertionError with what was expected and found unless the condition holds."""
    if not holds:
        raise AssertionError(f"expected: {expected}; found {shown(found)}")


def require_refused(what: str, function: Callable[..., Any], *arguments: Any) -> None:
    """Raise AssertionError unless the call raises ValueError."""
    try:
        function(*arguments)
    except ValueError:
        return
    raise AssertionError(f"expected: ValueError for {what}; nothing was raised")


def require_numbers(d: Decision, what: str) -> None:
    """Raise AssertionError where a run has diverged or has no numbers."""
    require(not d.diverged.any(), f"{what} do not make it diverge", d.diverged)
    require(np.all(np.isfinite(d.estimate)), f"the estimate is finite with {what}", d.estimate)
    require(np.all(np.isfinite(d.reconstruction)), f"every reading is replaced with {what}", d.reconstruction)


def require_same(a: Decision, b: Decision, what: str) -> None:
    """Raise AssertionError unless two Decisions have the same bits."""
    for f in fields(Decision):
        assert_array_equal(getattr(a, f.name), getattr(b, f.name), f"{what}: {f.name}")


def require_same_state(a: State, b: State, what: str) -> None:
    """Raise AssertionError unless two states have the same bits and types."""
    require(names(a) == names(b), f"{what}: {names(b)}", names(a))
    for one, other in zip(leaves(a), leaves(b), strict=True):
        assert_array_equal(one, other, what)
        require(np.asarray(one).dtype == np.asarray(other).dtype, f"{what}: {other.dtype}", one.dtype)


def require_same_end(one: Detector, a: State, two: Detector, b: State, data: tuple[Array, Array, Array], what: str) -> None:
    """Raise AssertionError unless two detectors continue with the same bits from their states."""
    end, expected = run(one, a, *data, covariance=True)
    other_end, found = run(two, b, *data, covariance=True)
    require_same(found, expected, what)
    require_same_state(other_end, end, f"{what}: its state")


def scaled(detector: Any, scale: float) -> Detector:
    """A detector with a threshold_scale; AssertionError where it has no such setting."""
    settings = [f.name for f in fields(detector)] if is_dataclass(detector) else []
    require("threshold_scale" in settings, "a setting threshold_scale (1.0), which multiplies all thresholds", settings)
    found: Detector = replace(detector, threshold_scale=scale * (detector.threshold_scale or 1.0))
    return found


def pickled(thing: Any, what: str) -> Any:
    """A copy of an object by way of a pickle; AssertionError where it cannot be pickled."""
    try:
        return pickle.loads(pickle.dumps(thing))
    except (AttributeError, TypeError, pickle.PicklingError) as error:
        raise AssertionError(
            f"{what} cannot be pickled ({error}); use functions of a module, methods or partials, no closures or lambdas"
        ) from error
