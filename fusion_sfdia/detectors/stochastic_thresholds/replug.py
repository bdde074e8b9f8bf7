"""A network that changes between two steps: the detector on the changed plant, with the memory that is still valid.

Boem et al. 2018, sec. VI. Call `replug` after the step at which areas join or leave, before the next step: the last transition
was that of the old network. Models, weights and thresholds change for the states of those areas and of their neighbours, in all
copies; all other numbers keep their bits.

    a tie that opens    its two copies are reset and not used; their sensors are not isolated any more
    a tie that closes   its two copies start from their first reading, as in `initial_state`, and are tested from the next on
    an area alone       continues with its own readings
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.exclusion import Exclusion
from fusion_sfdia.detectors.state import State
from fusion_sfdia.detectors.stochastic_thresholds.area_diagnosers import AreaDiagnosers
from fusion_sfdia.detectors.stochastic_thresholds.chebyshev import Chebyshev, ChebyshevMemory
from fusion_sfdia.detectors.stochastic_thresholds.consensus import Diagnosers
from fusion_sfdia.detectors.stochastic_thresholds.consensus_equations import UNKNOWN
from fusion_sfdia.plant.areas import Areas
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]


def replug(detector: Chebyshev, state: State, plant: Plant) -> tuple[Chebyshev, State]:
    """Return the detector on the changed plant and its state; the given objects do not change, even where this raises.

    Parameters
    ----------
    detector : Chebyshev
        On the plant before the change.
    state : State
        After the step at which the network changes.
    plant : Plant
        After the change.

    Returns
    -------
    detector : Chebyshev
        On the changed plant.
    state : State
        From which it goes on.

    Raises
    ------
    ValueError
        Where the plant has other states or sensors (an unplugged area keeps them, without readings), where its areas differ in
        more than the network, and for a state of another detector.

    Examples
    --------
    >>> from fusion_sfdia.detectors import Chebyshev, replug
    >>> from fusion_sfdia.plants import power_network
    >>> whole = Chebyshev(power_network(loads=()))
    >>> without_4, state = replug(whole, whole.init(), power_network(loads=(), unplugged=["4"]))
    >>> len(without_4.hypotheses) == len(whole.hypotheses)
    True
    """
    now = detector.plant
    if plant.sensor_names != now.sensor_names or [s.name for s in plant.states] != [s.name for s in now.states]:
        raise ValueError(
            f"plant {plant.name!r} has other states or sensors than {now.name!r}; declare all areas and ties once, and plug "
            "them in and out"
        )
    detector._batch_of(state)
    after = replace(detector, plant=plant)
    if now.structure.areas is None or plant.structure.areas is None:
        if now.structure.areas is not plant.structure.areas:
            raise ValueError(
                f"one of the plants {now.name!r} and {plant.name!r} states no areas; give both with areas, or none"
            )
        return after, state
    opened = opened_sides(now.structure.areas, plant.structure.areas)
    assert isinstance(after.diagnoser, AreaDiagnosers)
    gone = after.diagnoser.at_sides(opened)
    memory: ChebyshevMemory = state.memory
    kept = ChebyshevMemory(
        residual=np.where(gone, np.nan, memory.residual),
        deviation=np.where(gone, np.inf, memory.deviation),
        exceeded=np.where(gone, 0.0, memory.exceeded),
        exclusion=Exclusion(*(np.where(gone, np.zeros((), a.dtype), a) for a in memory.exclusion)),
        diagnoser=reset_sides(memory.diagnoser, opened),
    )
    return after, state._replace(memory=kept)


def opened_sides(before: Areas, after: Areas) -> Array:
    """Return (2E,) bool: the sides whose tie is closed before and open after; ValueError for areas of another topology."""
    old, new = before.network.topology, after.network.topology
    if old is not new and (old.names != new.names or not np.array_equal(old.links, new.links)):
        raise ValueError("the new areas have other names or ties than the old ones; declare all of them once")
    opened: Array = before.network.closed & ~after.network.closed
    return opened


def reset_sides(now: Diagnosers, sides: Array) -> Diagnosers:
    """Return the diagnosers without information at the chosen sides (2E,); held values stay, with unknown error."""
    return now._replace(
        error_bound_shared=np.where(sides, UNKNOWN, now.error_bound_shared),
        residual_shared=np.where(sides, 0.0, now.residual_shared),
        deviation_shared=np.where(sides, 0.0, now.deviation_shared),
    )
