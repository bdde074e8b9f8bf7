"""A network too large for one process, on the workers of a dask cluster: a part of its areas on each.

Each worker keeps its areas and their diagnosers and takes their readings itself. A step is one call of every part; its result,
the alarms and the copies at its borders, is passed to the neighbours with the next call. Workers on processors of one kind give
the bits of one process.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.areas import Areas
from fusion_sfdia.stochastic_thresholds.consensus import MODES, Diagnosers, NetworkReadings
from fusion_sfdia.stochastic_thresholds.network_part import Part, PartLayout, at_borders, part_layouts, routes, share

Array = NDArray[Any]
Source = Callable[[int, tuple[int, int], Array], NetworkReadings]


class PartitionedNetwork:
    """The diagnosers of a network, shared out to workers in parts of equal size.

    client: of `distributed`. areas, state, alpha, lam, mode: as of network_step. source(k, (first, past), sides): what the
    workers read at step k = 0, 1, ...: the NetworkReadings of the areas from first to past and the sides (K,); it is sent to
    the workers once. workers: their addresses, a part each; None for all.
    ValueError for an unknown mode, no worker, or more parts than areas. A lost worker ends it with
    OSError or RuntimeError: continue from the result of `state`.
    """

    def __init__(
        self, client: Any, areas: Areas, state: Diagnosers, source: Source, alpha: float, lam: float, mode: str = "corrected",
        workers: Sequence[str] | None = None,
    ) -> None:  # fmt: skip
        if mode not in MODES:
            raise ValueError(f"mode is {mode!r}; known: {', '.join(MODES)}")
        where = list(client.scheduler_info(n_workers=-1)["workers"]) if workers is None else list(workers)
        if not where:
            raise ValueError("no worker to put a part on; start workers of this cluster or name them")
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
        self._made = [  # as long as these are kept, so are the parts
            client.submit(ReadingPart, given, alpha, lam, mode == "paper", actor=True, workers=[w], pure=False)
            for given, w in zip(sent, where, strict=True)
        ]
        with client.as_current():  # as whose the actors are called
            self._actors = [future.result() for future in self._made]

    def step(self) -> Array:
        """One step of all parts: which areas have a residual beyond alpha standard deviations, (B, N)."""
        found = self._answers("step", [(self._k, self._copies[..., route]) for route in self._routes])
        alarm = np.concatenate([f[0] for f in found], axis=-1)
        for layout, (_, beyond, _) in zip(self._parts, found, strict=True):
            np.logical_or.at(alarm.T, self._reader[layout.sides[layout.near :]], beyond.T)
        self._copies = np.concatenate([f[2] for f in found], axis=-1)
        self._k += 1
        return alarm

    def state(self) -> Diagnosers:
        """The memory of all diagnosers, fetched from the workers."""
        kept = self._answers("kept", [()] * len(self._parts))
        count, n, sides = self._size
        batch = len(kept[0].held)
        whole = Diagnosers(*(np.empty((batch, count, n)) if k % 2 == 0 else np.empty((batch, sides)) for k in range(8)))
        for layout, part in zip(self._parts, kept, strict=True):
            lo, hi = layout.areas
            mine = np.setdiff1d(np.arange(layout.sides.size), layout.border)  # its border is kept by those it reads
            for all_of_it, a in zip(whole, part, strict=True):
                if a.ndim == 3:
                    all_of_it[:, lo:hi] = a
                else:
                    all_of_it[:, layout.sides[mine]] = a[:, mine]
        return whole

    def _answers(self, method: str, arguments: Sequence[tuple[Any, ...]]) -> list[Any]:
        """The results of one call of all parts, which run at the same time."""
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
