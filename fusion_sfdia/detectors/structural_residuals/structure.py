"""The structure of a plant's scalar equations, its minimal overdetermined sets, and which of them can be computed.

A set of equations is minimal structurally overdetermined (MSO) when it has one equation more than unknowns and no part of it
is overdetermined (Krysander, Aslund and Nyberg 2008). The Fault Diagnosis Toolbox of Frisk, Krysander and Jung (2017) finds
them all. A residual generator computes the unknowns from all equations but one and checks that one.

Here an equation is used in its stated direction only: a state is the integral of its derivative, an algebraic variable is
computed by its equation, and any variable may be read by its sensor. The one variable with both an equation and a sensor in
the set is the target: its reading is compared with its computed value. Sets that need an inverted equation, simultaneous
equations or a derivative are not computable. A target that its own equation uses is read there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from fusion_sfdia.common.errors import MissingPackageError, NotApplicableError
from fusion_sfdia.derivatives.equation import argument_names
from fusion_sfdia.detectors.detector import require_no_cycles
from fusion_sfdia.plant.modules import Modules
from fusion_sfdia.plant.plant import Plant


@dataclass(frozen=True)
class Residual:
    """The reading of a variable less its computed value.

    integrated: the states that are integrals of their equations. computed: algebraic variables in the order of computation.
    read: the variables whose sensors are read, the target among them. feedback: whether the target, a state, is corrected by
    its readings with the gain of its observer.
    """

    target: str
    integrated: tuple[str, ...]
    computed: tuple[str, ...]
    read: tuple[str, ...]
    feedback: bool = False

    @property
    def target_is_read(self) -> bool:
        """Whether the reading of the target enters its own computed value."""
        return self.feedback or self.target not in (*self.integrated, *self.computed)


def modules_of(plant: Plant) -> Modules:
    """Return a plant's scalar equations; NotApplicableError where it has none, or its sensors do not read their variables."""
    if plant.structure.modules is None:
        raise NotApplicableError(
            f"plant {plant.name!r} does not state its scalar equations, without which it has no structure to analyse; give "
            "Plant(structure=Structure(modules=Modules(...))), both of fusion_sfdia.plants, or take another detector"
        )
    require_no_cycles(plant, "structural residuals")
    measured = [s.measures for s in plant.sensors]
    if unknown := [s.name for s in plant.sensors if s.measures not in plant.structure.modules.equations]:
        raise NotApplicableError(
            f"sensors {', '.join(unknown)} read variables without an equation; expected one for each in Modules"
        )
    if several := sorted({v for v in measured if measured.count(v) > 1}):
        raise NotApplicableError(f"several sensors read {', '.join(several)}; build the plant with one of them")
    return plant.structure.modules


def arguments(modules: Modules) -> dict[str, tuple[str, ...]]:
    """The variables and inputs that each equation takes."""
    return {v: tuple(a for a in argument_names(f) if a != "c") for v, f in modules.equations.items()}


def structural_model(plant: Plant) -> Any:
    """Return the DiagnosisModel of a plant: its equations, the derivatives of its states, and its sensors with a fault each.

    NotApplicableError as `modules_of`, MissingPackageError without faultdiagnosistoolbox.
    """
    modules = modules_of(plant)
    try:
        import faultdiagnosistoolbox as toolbox  # slow to import
    except ModuleNotFoundError as error:
        raise MissingPackageError(
            "structural residuals need faultdiagnosistoolbox; pip install 'fusion-sfdia[structural]'"
        ) from error
    states = modules.states
    equations = [
        [f"rate of {v}", v, *taken] if v in states else [v, *(a for a in taken if a != v)]
        for v, taken in arguments(modules).items()
    ]
    sensors = [[s.measures, f"reading of {s.measures}", f"fault of {s.measures}"] for s in plant.sensors]
    return toolbox.DiagnosisModel(
        {
            "type": "VarStruc",
            "x": [*modules.equations, *(f"rate of {v}" for v in states)],
            "f": [s[2] for s in sensors],
            "z": [*(s[1] for s in sensors), *modules.inputs],
            "rels": [*equations, *sensors, *(toolbox.DiffConstraint(f"rate of {v}", v) for v in states)],
        },
        name=plant.name,
    )


def computable(plant: Plant) -> tuple[Residual, ...]:
    """Return the residual of each MSO set that can be computed, those with the fewest sensors and then equations first.

    Raises as `structural_model`.
    """
    found = (residual_of(plant, mso) for mso in structural_model(plant).MSO())
    return tuple(sorted((r for r in found if r is not None), key=_size))


def _size(r: Residual) -> tuple[int, int, tuple[str, ...], str]:
    return len(r.read), len(r.integrated) + len(r.computed), r.read, r.target


def residual_of(plant: Plant, mso: Any) -> Residual | None:
    """Return the residual of an MSO set, numbers of equations of `structural_model`, or None where it cannot be computed."""
    modules = modules_of(plant)
    variables, count = tuple(modules.equations), len(modules.equations)
    numbers = {int(k) for k in np.asarray(mso)}
    used = [v for k, v in enumerate(variables) if k in numbers]
    read = tuple(s.measures for k, s in enumerate(plant.sensors, count) if k in numbers)
    both = [v for v in used if v in read]
    if len(both) != 1:
        return None  # a variable has neither: another equation would have to be inverted for it
    (target,) = both
    integrated = tuple(v for v in used if v in modules.states)
    algebraic = [v for v in used if v not in modules.states]
    given = {*integrated, *modules.inputs, *read}
    for reads_target in (False, True) if target in algebraic else (False,):
        known = given if reads_target or target in integrated else given - {target}
        order = tuple(in_order(modules, [v for v in algebraic if v != target or not reads_target], known))
        if len(order) == len(algebraic) - reads_target:
            return Residual(target, integrated, order, read)
    return None


def in_order(modules: Modules, expected: list[str], known: set[str]) -> Iterator[str]:
    """Yield the algebraic variables that can be computed one after the other from the known ones."""
    taken, known = arguments(modules), set(known)
    left = list(expected)
    while ready := [v for v in left if known.issuperset(taken[v])]:
        yield from ready
        known.update(ready)
        left = [v for v in left if v not in ready]
