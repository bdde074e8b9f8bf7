"""Checks of a plant's fields and functions: their types, and batches as leading axes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fusion_sfdia.core.arguments import shown
from fusion_sfdia.core.plant_groups import Numerics, Structure, Truth
from fusion_sfdia.core.signals import Sensor, Signal

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
    for what, group in (("numerics", Numerics), ("truth", Truth), ("structure", Structure)):
        if not isinstance(value := getattr(plant, what), group):
            raise ValueError(f"plant {plant.name!r}: {what} is {shown(value)}; expected a {group.__name__} object")


def require_shapes(plant: Plant) -> None:
    """Raise ValueError unless step and output take a batch of states; a step that fails at x0 is left to the runs."""
    n, count = len(plant.states), len(plant.sensors)
    x, u = np.broadcast_to(plant.x0, (2, 1, n)).copy(), plant.input_at(0.0)[None]
    for what, expected, arguments in (("step", (2, 1, n), (x, u, plant.dt)), ("output", (2, 1, count), (x, u))):
        try:
            with np.errstate(all="ignore"):
                found = np.shape(getattr(plant, what)(0.0, *arguments))
        except ArithmeticError:
            continue
        except (IndexError, TypeError, ValueError) as error:
            raise ValueError(
                f"{what} of plant {plant.name!r} fails for states {x.shape} and inputs {u.shape}: {error}; write it for "
                "batches, which are leading axes: x[..., 0]"
            ) from error
        if found != expected:
            raise ValueError(
                f"{what} of plant {plant.name!r} gives shape {found} for states {x.shape}; expected {expected}: one number "
                f"for each {'state' if what == 'step' else 'sensor'}, with a batch as leading axes (x[..., 0])"
            )
