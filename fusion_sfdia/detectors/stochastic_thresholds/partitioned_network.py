"""A network too large for one process, on the workers of a dask cluster: one part of its areas on each worker.

Each worker keeps its areas and their diagnosers and obtains their readings. A step is one call of every part. It returns the
alarms and the copies at the borders, which the neighbours receive with the next call. Workers on processors of the same kind
give the same bits as one process.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.stochastic_thresholds.consensus import Diagnosers, NetworkReadings, require_mode
from fusion_sfdia.detectors.stochastic_thresholds.network_part import Part, PartLayout, at_borders, part_layouts, routes, share
from fusion_sfdia.plant.areas import Areas

Array = NDArray[Any]
Source = Callable[[int, tuple[int, int], Array], NetworkReadings]


class PartitionedNetwork:
    """The diagnosers of a network, distributed over workers in parts of equal size.

    client: of `distributed`. areas, state, alpha, lam, mode: as of network_step. source(k, (first, past), sides): returns the
    NetworkReadings of step k = 0, 1, ... for the areas from first to past and the sides (K,); it is sent to the workers once.
    workers: addresses, one for each part; None for all workers. Raises ValueError for an unknown mode, no worker, or more parts
    than areas. A lost worker raises OSError or RuntimeError: continue from the result of `state`.
    """

    def __init__(
        self, client: Any, areas: Areas, state: Diagnosers, source: Source, alpha: float, lam: float, mode: str = "corrected",
        workers: Sequence[str] | None = None,
    ) -> None:  # fmt: skip
        require_mode(areas, mode)
        where = list(client.scheduler_info(n_workers=-1)["workers"]) if workers is None else list(workers)
        if not where:
            raise ValueError("there is no worker for a part; start workers of this cluster or give their addresses")
        self._parts = part_layouts(areas, len(where))
        self._routes = routes(self._parts)
        self._size = areas.size
        self._reader = areas.network.topology.node
        self._k, self._client = 0, client
        self._copies = at_borders(self._parts, state)
        sent = [
            client.scatter((layout, share(layout, state), source), workers=[w], direct=True, hash=False)
            for layout, w in zip(self._parts, where, strict=True)
        ]
        self._made = [  # references that keep the parts alive
            client.submit(ReadingPart, given, alpha, lam, mode == "paper", actor=True, workers=[w], pure=False)
            for given, w in zip(sent, where, strict=True)
        ]
        with client.as_current():  # actors are called through this client
            self._actors = [future.result() for future in self._made]

    def step(self) -> Array:
        """Do one step of all parts; return which areas have a residual beyond alpha standard deviations (B, N)."""
        found = self._answers("step", [(self._k, self._copies[..., route]) for route in self._routes])
        alarm = np.concatenate([f[0] for f in found], axis=-1)
        for layout, (_, beyond, _) in zip(self._parts, found, strict=True):
            np.logical_or.at(alarm.T, self._reader[layout.sides[layout.near :]], beyond.T)
        self._copies = np.concatenate([f[2] for f in found], axis=-1)
        self._k += 1
        return alarm

    def state(self) -> Diagnosers:
        """Return the memory of all diagnosers, fetched from the workers."""
        kept = self._answers("kept", [()] * len(self._parts))
        count, n, sides = self._size
        batch = len(kept[0].held)
        covariance = np.empty((batch, count, *kept[0].covariance.shape[2:]))
        values = [np.empty((batch, sides) if k % 2 else (batch, count, n)) for k in range(8)]
        whole = Diagnosers._make([*values, covariance])
        for layout, part in zip(self._parts, kept, strict=True):
            lo, hi = layout.areas
            mine = np.setdiff1d(
                np.arange(layout.sides.size), layout.border
            )  # the parts of the neighbours keep its border sides
            for all_of_it, a in zip(whole, part, strict=True):
                if a.ndim == 2:
                    all_of_it[:, layout.sides[mine]] = a[:, mine]
                else:
                    all_of_it[:, lo:hi] = a
        return whole

    def _answers(self, method: str, arguments: Sequence[tuple[Any, ...]]) -> list[Any]:
        """The results of one call of all parts, which run concurrently."""
        with self._client.as_current():
            waiting = [getattr(actor, method)(*given) for actor, given in zip(self._actors, arguments, strict=True)]
            return [answer.result() for answer in waiting]


class ReadingPart:
    """A part on its worker, with the source of its readings."""

    def __init__(self, given: tuple[PartLayout, Diagnosers, Source], alpha: float, lam: float, printed: bool) -> None:
        layout, state, self._source = given
        self._part = Part(layout, state, alpha, lam, printed)

    def step(self, k: int, received: Array) -> tuple[Array, Array, Array]:
        """As of Part.step, with the readings of step k."""
        layout = self._part.layout
        return self._part.step(received, self._source(k, layout.areas, layout.sides))

    def kept(self) -> Diagnosers:
        return self._part.kept()
