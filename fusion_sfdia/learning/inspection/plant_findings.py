"""Findings about a plant, each with its cure, and those of the checks of its model."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

from fusion_sfdia.derivatives.analytic import KINK, Use
from fusion_sfdia.learning.checks.plants import PLANT_CHECKS
from fusion_sfdia.plant.plant import Plant

MISTAKE, REMARK = "mistake", "remark"
DERIVATIVE = {
    "wrong": "the complex step is wrong there, so that Jacobians are differences, slower and less exact",
    "refused": "it takes no complex numbers, so that Jacobians are differences, slower and less exact",
    "kink": "its slope jumps",
}


class PlantFinding(NamedTuple):
    """kind: "mistake", to be corrected before any diagnosis, or "remark". about: the subject. text: what, and the cure."""

    kind: str
    about: str
    text: str

    def __str__(self) -> str:
        return f"{self.about}: {self.text}"


def mistakes(plant: Plant) -> Iterator[PlantFinding]:
    """What `check_plant` finds, all of it."""
    for check in PLANT_CHECKS:
        try:
            check(plant)
        except (AssertionError, ValueError, ArithmeticError, IndexError, TypeError) as error:
            yield PlantFinding(MISTAKE, check.__name__.replace("_", " "), _reason(error))


def _reason(error: Exception) -> str:
    """The text of an error without the arrays that numpy adds."""
    text = re.sub(r"^\s*(Not equal to tolerance[^\n]*|Arrays are not (almost )?equal)\n", "", str(error).lstrip())
    return " ".join(re.split(r"\n\s*(?:Mismatched elements|\(shapes|x and y|nan location|inf location)", text)[0].split())


def not_analytic(plant: Plant) -> Iterator[PlantFinding]:
    """The functions in step and output that are not analytic, by their effect on Jacobians."""
    given = plant.numerics.step_jacobian, plant.numerics.output_jacobian
    for what, uses, jacobian in zip(("step", "output"), plant.non_analytic, given, strict=True):
        for effect, meaning in DERIVATIVE.items():
            if jacobian is None and (chosen := [use for use in uses if use.effect == effect]):
                comparing = [use for use in chosen if use.name in ("where", "maximum", "minimum", "clip")]
                named = comparing if effect == KINK and comparing else chosen
                yield PlantFinding(REMARK, what, f"{', '.join(map(str, named))}: {meaning}; {'; '.join(_cures(named))}")


def _cures(uses: list[Use]) -> list[str]:
    return list(dict.fromkeys(use.cure for use in uses))
