"""Checks of a plant's fields and functions: their types, and batches as leading axes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fusion_sfdia.core.arguments import shown
from fusion_sfdia.core.differentiable import Differentiable
from fusion_sfdia.core.plant_groups import Numerics, Structure, Truth
from fusion_sfdia.core.signals import Sensor, Signal
from fusion_sfdia.core.uncertainty import Uncertainty, error_of

if TYPE_CHECKING:
    from fusion_sfdia.core.plant import Plant


def require_kinds(plant: Plant) -> None:
    """Raise ValueError unless signals, sensors, functions and groups are of these types."""
    for what, kind in (("states", Signal), ("inputs", Signal), ("sensors", Sensor)):
        members = getattr(plant, what)
        if not isinstance(members, tuple | list) or not all(isinstance(m, kind) for m in members):
            raise ValueError(f"plant {plant.name!r}: {what} is {shown(members)}; expected a tuple of {kind.__name__} objects")
    for what in ("step", "output"):
        if not callable(function := getattr(plant, what)):
            raise ValueError(f"plant {plant.name!r}: {what} is {shown(function)}; expected a function")
    for what, group in (("numerics", Numerics), ("truth", Truth), ("structure", Structure), ("uncertainty", Uncertainty)):
        if not isinstance(value := getattr(plant, what), group):
            raise ValueError(f"plant {plant.name!r}: {what} is {shown(value)}; expected a {group.__name__} object")


def require_considered(plant: Plant) -> None:
    """Raise ValueError for a considered state that neither the plant nor its uncertainty has."""
    known = plant.uncertainty
    states = [s.name for s in plant.states]
    added = [
        *(v.name for v in known.parameters),
        *(error_of(name) for name in known.inputs),
        *(v.name for v in known.disturbances),
    ]
    if strange := [name for name in known.considered if name not in (*states, *added)]:
        raise ValueError(
            f"plant {plant.name!r} has no states {', '.join(strange)} to consider; states: {', '.join([*states, *added])}"
        )


def require_shapes(plant: Plant) -> None:
    """Raise ValueError unless step and output take a batch of states; a step that fails at x0 is left to the runs.

    So is a `Differentiable` one: it would be compiled here by itself, where filters need what gives its Jacobian, too.
    The batch (b, 1) has b other than n: indexing states along the first axis, x[0], then never gives the expected shape.
    """
    n, count = len(plant.states), len(plant.sensors)
    batch = (3 if n == 2 else 2, 1)
    x, u = np.broadcast_to(plant.x0, (*batch, n)).copy(), plant.input_at(0.0)[None]
    for what, expected, arguments in (("step", (*batch, n), (x, u, plant.dt)), ("output", (*batch, count), (x, u))):
        if isinstance(getattr(plant, what), Differentiable):
            continue
        try:
            with np.errstate(all="ignore"):
                found = np.shape(getattr(plant, what)(0.0, *arguments))
        except ArithmeticError:
            continue
        except (IndexError, TypeError, ValueError) as error:
            if not plant.inputs and isinstance(error, IndexError) and "with size 0" in str(error):  # only u has an axis of 0
                raise ValueError(
                    f"{what} of plant {plant.name!r} uses an input, and the plant declares none; pass inputs=(Signal(...), "
                    "...), a Signal for each input"
                ) from error
            raise ValueError(
                f"{what} of plant {plant.name!r} fails for states {x.shape} and inputs {u.shape}: {error}; {_cure(error)}"
            ) from error
        if found != expected:
            raise ValueError(
                f"{what} of plant {plant.name!r} gives shape {found} for states {x.shape}; expected {expected}: one number "
                f"for each {'state' if what == 'step' else 'sensor'}, with a batch as leading axes (x[..., 0])"
                f"{_axis(found, expected)}"
            )


def _cure(error: Exception) -> str:
    """What to write in place of what fails on a batch."""
    text = str(error)
    if "truth value of an array" in text:
        return (
            "`if`, `min` and `max` of Python take one number; write np.where, np.minimum and np.maximum, which take batches of "
            "states"
        )
    if "can be converted to Python scalars" in text or "must be real number" in text or "unsupported format" in text:
        return "functions of `math` and float() take one number; write those of numpy, np.sqrt, which take batches of states"
    if "could not be broadcast" in text:
        return (
            "write it for batches, which are leading axes: x[..., 0], not x[0], and join states along the last axis, "
            "np.stack([...], axis=-1)"
        )
    return "write it for batches, which are leading axes: x[..., 0]"


def _axis(found: tuple[int, ...], expected: tuple[int, ...]) -> str:
    """What to write where the numbers are stacked along another axis than the last."""
    return "; stack them along the last axis, np.stack([...], axis=-1)" if found == (expected[-1], *expected[:-1]) else ""
