"""What a user states of the physics behind the columns of a log, by their names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from fusion_sfdia.common.arguments import shown
from fusion_sfdia.plant.signals import Signal


@dataclass(frozen=True)
class StatedPhysics:
    """Sensors that measure one quantity, and inputs that drive readings.

    Parameters
    ----------
    same : sequence of str, or of such, default ()
        A group of sensors that measure one quantity, up to an offset and a gain, or several groups.
    drives : mapping of str to str or sequence of str, default {}
        Of each input the sensors that move with it.

    Raises
    ------
    ValueError
        For other forms, groups of fewer than two, and a sensor in two groups.

    Examples
    --------
    >>> from fusion_sfdia.logs import StatedPhysics
    >>> StatedPhysics(same=["T1", "T2"], drives={"pump": "flow"})
    StatedPhysics(same=(('T1', 'T2'),), drives={'pump': ('flow',)})
    """

    same: Sequence[Sequence[str]] = ()
    drives: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        same: Any = self.same
        if isinstance(same, str) or not isinstance(same, Sequence):
            raise ValueError(f'same is {shown(same)}; expected names of sensors or groups of them, as in [["T1", "T2"]]')
        if not isinstance(self.drives, Mapping):
            raise ValueError(f'drives is {shown(self.drives)}; expected what each input drives, as in {{"pump": ["flow"]}}')
        groups = [same] if same and all(isinstance(s, str) for s in same) else same
        object.__setattr__(self, "same", tuple(_names("same", group) for group in groups))
        object.__setattr__(self, "drives", {str(u): _names(f"drives {u}", d) for u, d in self.drives.items()})
        taken: dict[str, Sequence[str]] = {}
        for group in self.same:
            if len(group) < 2:
                raise ValueError(f"same: {', '.join(group) or 'nothing'} is no group; expected two sensors or more")
            for name in group:
                if name in taken:
                    raise ValueError(
                        f"same: {name!r} stands twice, in {', '.join(taken[name])} and in {', '.join(group)}; join the groups "
                        "where all measure one quantity, else leave it out of one"
                    )
                taken[name] = group

    def beside(self, other: StatedPhysics) -> StatedPhysics:
        """What both state.

        Parameters
        ----------
        other : StatedPhysics
            What is stated elsewhere.

        Returns
        -------
        StatedPhysics
            With the groups and the inputs of both; of an input that both state, the sensors of both.
        """
        drives = {u: (*self.drives.get(u, ()), *other.drives.get(u, ())) for u in (*self.drives, *other.drives)}
        return StatedPhysics((*self.same, *other.same), drives)

    def require(self, sensors: Sequence[Signal], inputs: Sequence[Signal]) -> None:
        """Require that each name is that of a sensor, or of an input.

        Parameters
        ----------
        sensors, inputs : sequence of Signal
            Of the logs.

        Raises
        ------
        ValueError
            Which names what is neither, and what is known.
        """
        known, acting = [s.name for s in sensors], [s.name for s in inputs]
        for what, names in (*(("same", g) for g in self.same), *((f"drives {u}", d) for u, d in self.drives.items())):
            for name in names:
                if name not in known:
                    role = "an input" if name in acting else "no column"
                    raise ValueError(f"{what}: {name!r} is {role} of the logs; expected a sensor, one of {', '.join(known)}")
        for name in self.drives:
            if name not in acting:
                role = "a sensor of the logs; state it as an input" if name in known else "no column of the logs"
                raise ValueError(f"drives: {name!r} is {role}; expected an input, one of {', '.join(acting) or 'none'}")

    def __str__(self) -> str:
        """In words, a line each."""
        lines = [f"{', '.join(group)}: stated to measure one quantity" for group in self.same]
        return "\n".join([*lines, *(f"{', '.join(d)}: stated to move with {u}" for u, d in self.drives.items())])


def _names(what: str, given: Any) -> tuple[str, ...]:
    names = (given,) if isinstance(given, str) else given
    if not isinstance(names, Sequence) or not all(isinstance(n, str) for n in names):
        raise ValueError(f"{what}: {shown(given)}; expected names of sensors")
    return tuple(names)
