"""A network too large for one process, on the workers of a dask cluster: one part of its areas on each worker.

Each worker keeps its areas and their diagnosers and obtains their readings. A step is one call of every part. It returns the
alarms and the copies at the borders, which the neighbours receive with the next call. Workers on processors of the same kind
give the same bits as one process.

A part computes the states of its areas with all their copies, including copies that areas in other parts read: it receives
these readings, too, and sends the results for these copies to the other parts. Each step of a part needs one message from each
neighbouring part, with four numbers for every copy at the border. The results have the same bits as the whole network in one
process on a processor of the same kind.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.stochastic_thresholds import consensus_equations
from fusion_sfdia.detectors.stochastic_thresholds.consensus import Diagnosers, NetworkReadings, require_mode
from fusion_sfdia.detectors.stochastic_thresholds.network_step import terms_of
from fusion_sfdia.plant.areas import AreaArrays, Areas

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


class PartLayout(NamedTuple):
    """The network of a part, constant over time. All indices are local, except those in `areas` and `sides`.

    arrays: of M areas and their sides, then of the K copies read in other parts; reader is M + k for that of copy k, which
    is in another part. border: local sides whose neighbour is in another part, which sends their values. near: index of the
    first copy read in another part. areas: first and past last area in the network. sides: indices in the network of the local
    sides.
    """

    arrays: AreaArrays
    border: Array
    near: int
    areas: tuple[int, int]
    sides: Array


def part_layouts(areas: Areas, parts: int) -> list[PartLayout]:
    """Return the network in `parts` blocks of equal size; ValueError for less than one part or more parts than areas."""
    count = areas.size[0]
    if not 1 <= parts <= count:
        raise ValueError(f"{count} areas cannot be shared by {parts} parts; expected 1 to {count}")
    at = areas.network.topology
    bounds = np.linspace(0, count, parts + 1).astype(np.int64)
    whole = areas.arrays
    found = []
    for lo, hi in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True):
        first, past = int(at.start[lo]), int(at.start[hi])
        other = at.opposite[first:past]
        elsewhere = (other < first) | (other >= past)
        sides = np.concatenate([np.arange(first, past), other[elsewhere]])
        copy = np.cumsum(elsewhere) - 1
        opposite = np.where(elsewhere, past - first + copy, other - first)
        reader = np.where(elsewhere, hi - lo + copy, at.neighbour[first:past] - lo)
        of_areas = {k: getattr(whole, k)[lo:hi].copy() for k in ("matrices", "process_variance", "noise")}
        of_sides = {k: getattr(whole, k)[sides] for k in ("slope", "closed", "shared_noise", "received")}
        near = {"start": at.start[lo : hi + 1] - first, "opposite": opposite, "reader": reader}
        arrays = AreaArrays(**of_areas, **of_sides, **near)
        found.append(PartLayout(arrays, np.flatnonzero(elsewhere), past - first, (lo, hi), sides))
    return found


def routes(parts: Sequence[PartLayout]) -> list[Array]:
    """Return for each part the indices of its received values among the copies of all parts that are read in other parts."""
    sent = np.concatenate([p.sides[p.near :] for p in parts])
    order = np.argsort(sent)
    return [order[np.searchsorted(sent, p.sides[p.border], sorter=order)] for p in parts]


def share(layout: PartLayout, state: Diagnosers) -> Diagnosers:
    """Return the diagnosers of a layout from those of the whole network."""
    lo, hi = layout.areas
    return Diagnosers(*((a[:, layout.sides] if a.ndim == 2 else a[:, lo:hi]).copy(order="C") for a in state))


def at_borders(parts: Sequence[PartLayout], state: Diagnosers) -> Array:
    """Return (4, B, K): held, error_bound, residual, deviation of the copies read in other parts, part after part."""
    return np.concatenate([np.stack([a[:, p.sides[p.near :]] for a in state.shared]) for p in parts], axis=-1)


class Part:
    """The diagnosers of a layout for a batch of B runs, from their state; two sets of arrays are used alternately."""

    def __init__(self, layout: PartLayout, state: Diagnosers, alpha: float, lam: float, printed: bool) -> None:
        self.layout, self.alpha, self.lam, self.printed = layout, alpha, lam, printed
        self._now, self._before = state, Diagnosers(*map(np.zeros_like, state))
        self._terms = terms_of(layout.arrays, "paper" if printed else "corrected")

    def step(self, received: Array, given: NetworkReadings) -> tuple[Array, Array, Array]:
        """Return alarms of its areas (B, M), alarms of the copies read in other parts (B, K), and the results for these (4, B,
        K).

        received (4, B, border): held, error_bound, residual, deviation, from other parts after the previous step. given: of its
        M areas; shared readings at its sides, then of the copies read in other parts.
        """
        b, state = self.layout, self._now
        for a, new in zip(state.shared, received, strict=True):
            a[:, b.border] = new
        after = self._before
        count = len(b.arrays.matrices)
        alarm = np.zeros((len(state.held), count + b.border.size), bool)
        consensus_equations.step_areas(
            state, given.reference, given.load, self.lam, self.printed, b.arrays, self._terms, self.alpha, given.own,
            given.shared, after, alarm,
        )  # fmt: skip
        self._now, self._before = after, state
        copies = np.stack([a[:, b.near :] for a in after.shared])
        return alarm[:, :count], alarm[:, count:], copies

    def kept(self) -> Diagnosers:
        """Return its memory; complete at the border sides only after the next `received`."""
        return self._now
