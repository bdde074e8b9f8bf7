"""A model at other values of its parameters, from plants that are built there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from numpy.typing import NDArray

from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.uncertainty import Parameter, Uncertainty

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Secants:
    """A model at other values of its parameters, from plants at nominal -+ sd of each, which are built at first use.

    With tau_j = (theta_j - nominal_j) / sd_j and f+-_j the model at +-1 of tau_j alone,

        f(theta) = f + sum_j [tau_j (f+_j - f-_j) / 2 + tau_j^2 (f+_j + f-_j - 2 f) / 2]

    exact where the model is quadratic in each parameter and has no products of them. A step costs 2p + 1 of the plant's.
    """

    plant: Plant
    parameters: tuple[Parameter, ...]
    rebuild: Callable[..., Plant]

    def step(self, t_start: float, x: Array, u: Array, dt: float, theta: Array) -> Array:
        return self._at([plant.step(t_start, x, u, dt) for plant in (self.plant, *self.pairs)], theta)

    def output(self, t: float, x: Array, u: Array, theta: Array) -> Array:
        return self._at([plant.output(t, x, u) for plant in (self.plant, *self.pairs)], theta)

    def _at(self, values: list[Array], theta: Array) -> Array:
        f, *others = values
        total: Array = f
        for j, p in enumerate(self.parameters):
            minus, plus, tau = others[2 * j], others[2 * j + 1], (theta[..., j, None] - p.nominal) / p.sd
            total = total + tau * (plus - minus) / 2 + tau**2 * (plus + minus - 2 * f) / 2
        return total

    @cached_property
    def pairs(self) -> tuple[Plant, ...]:
        """The plants below and above the nominal value of each parameter (2p,); ValueError for other states and so on."""
        built = []
        for p in self.parameters:
            for value in (p.nominal - p.sd, p.nominal + p.sd):
                other = self.rebuild(**{p.name: value})
                for what in ("states", "sensors", "inputs"):
                    if [s.name for s in getattr(other, what)] != [s.name for s in getattr(self.plant, what)]:
                        raise ValueError(f"parameter {p.name!r}: the plant rebuilt with the value {value:g} has other {what}")
                built.append(other)
        return tuple(built)


def secants(plant: Plant, parameters: Sequence[Parameter], rebuild: Callable[..., Plant], **stated: Any) -> Uncertainty:
    """Uncertainty of the parameters of a plant that can be built at other values, see `Secants`.

    Parameters
    ----------
    plant : Plant
        At the nominal values.
    parameters : sequence of Parameter
        That are not known exactly.
    rebuild : callable
        rebuild(**{parameter: value}) -> Plant; it takes any number of the parameters, the others keep their values.
    **stated
        `inputs`, `disturbances` and `at_rest`, as of `Uncertainty`.

    Returns
    -------
    Uncertainty
        To be given to the plant.

    Raises
    ------
    ValueError
        Where a rebuilt plant has other states, sensors or inputs.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from fusion_sfdia import Parameter
    >>> from fusion_sfdia.plants import augment, secants, two_tanks
    >>> outlet = Parameter("outlet", nominal=1.0, sd=0.05)
    >>> rig = replace(two_tanks(), uncertainty=secants(two_tanks(), [outlet], two_tanks))
    >>> [state.name for state in augment(rig).states]
    ['level_1', 'level_2', 'outlet']
    """
    at = Secants(plant, tuple(parameters), rebuild)
    return Uncertainty(at.parameters, at.step, at.output, rebuild=rebuild, **stated)
