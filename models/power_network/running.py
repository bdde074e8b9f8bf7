"""A power network that changes while it runs: areas join and leave at a cost that does not grow with the network."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from fusion_sfdia.detectors.stochastic_thresholds.consensus_equations import Terms
from fusion_sfdia.detectors.stochastic_thresholds.network_step import terms_of, update_terms
from fusion_sfdia.models.power_network.diagnosis import network_areas
from fusion_sfdia.models.power_network.model import NetworkModel
from fusion_sfdia.plant.areas import Areas
from fusion_sfdia.plant.network import Network, TopologyChange


class RunningNetwork:
    """A model with its own arrays, which `switch` changes in place, only where the change touches them.

    Elsewhere a change gives a new model and keeps the old one, at the cost of a copy. Here no copy is made: for networks
    whose copies take longer than a step. The model that it is made from does not change.
    areas: the diagnosers' model, without names of their states; the same arrays, so it is always up to date. terms: those of
    its areas in the mode "corrected", for `network_step`; up to date, too.
    """

    def __init__(self, model: NetworkModel) -> None:
        network = Network(model.network.topology, model.network.plugged)
        network.plugged.flags.writeable = True  # a copy that only this object holds
        self._model = replace(model, network=network, area=model.area.copy(), side_slope=model.side_slope.copy())
        self.areas: Areas = network_areas(self._model, named=False)
        self.terms: Terms = terms_of(self.areas.arrays)

    @property
    def model(self) -> NetworkModel:
        """The present model, in the arrays that the next switch changes."""
        return replace(self._model)

    def switch(self, *, plug_in: Iterable[str] = (), unplug: Iterable[str] = ()) -> TopologyChange:
        """Let areas join and leave, all at once, after the step at which they do; return what changed.

        The diagnosers go on with their state: a copy whose tie closes starts from its first reading. ValueError as of
        Network.change, and then nothing has changed.
        """
        now, network = self._model, self._model.network
        change = network.change(plug_in=plug_in, unplug=unplug)
        network.plugged[change.nodes] = change.plugged
        network.closed[change.sides] = change.closed
        now.side_slope[change.sides] = np.where(change.closed, now.parameters.side_slope[change.sides], 0.0)
        now.area[change.touched] = now.rows(change.touched)
        theirs, _ = network.topology.sides(change.touched)
        self.areas.shared_gain[network.topology.opposite[theirs]] = now.area[network.topology.node[theirs], 0, 0]
        update_terms(self.terms, self.areas.arrays, change.touched)
        return change
