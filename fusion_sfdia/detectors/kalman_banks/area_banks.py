"""Robust banks of the areas of a network: each area diagnoses itself, at a cost that grows with the areas alone.

All areas of one degree are one batch of one `RobustBank`, on the plant of an area (see `local_areas`). After each step an area
sends its neighbours its estimate of the shared state with its variance; after the next they use it as an input. A reading
theta_j@i of area j's state by area i is judged by area j, which has a model of it. A sensor that an area leaves out, and a
parameter that it has moved, are thus gone from what its neighbours use, too.

Covariances between areas are neglected. Where z_j is read well, the error of its estimate is that of the present readings, and
nearly independent of the estimates of other areas.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import floats, probability, shown
from fusion_sfdia.common.references import did_you_mean
from fusion_sfdia.detectors.batch_detector import TimeStep
from fusion_sfdia.detectors.detector import Decision
from fusion_sfdia.detectors.kalman_banks.hypotheses import Hypotheses
from fusion_sfdia.detectors.kalman_banks.parameter_walk import Walk
from fusion_sfdia.detectors.kalman_banks.robust_bank import RobustBank
from fusion_sfdia.detectors.kalman_banks.standing import Standing
from fusion_sfdia.detectors.state import State
from fusion_sfdia.filters.estimators import GaussianState, Prior
from fusion_sfdia.plant.local_areas import LocalAreas
from fusion_sfdia.plant.uncertainty import error_of

Array = NDArray[Any]

ERROR_OUTSIDE = 2  # position of the standard deviation of the power from outside among the inputs of an area


@dataclass(frozen=True, eq=False)
class AreaBank(RobustBank):
    """`RobustBank` on M areas of one degree, the last axis of the batch; usual (M, m): their inputs at rest."""

    usual: Array = field(kw_only=True)

    @cached_property
    def _hypotheses(self) -> Hypotheses:
        return Hypotheses(self.plant, self.usual)

    @cached_property
    def _of_runs(self) -> dict[int, AreaBank]:
        """By number of runs the bank on the M areas of all of them, one run after the other."""
        return {}

    def _step_of_axes(self, batch: tuple[int, ...], state: State, t: float, y: Array, u: Array) -> tuple[State, Decision]:
        if (runs := prod(batch[:-1])) not in self._of_runs:
            self._of_runs[runs] = replace(self, usual=np.tile(self.usual, (runs, 1)))
        return RobustBank._step_of_axes(self._of_runs[runs], batch, state, t, y, u)

    @cached_property
    def _by_load(self) -> int:
        """The column of the error of d_i, which acts by -g_i, in the transition of the augmented state."""
        names = [s.name for s in self.model.states]
        return names.index(error_of(self.plant.inputs[1].name))

    def _predict(self, estimate: GaussianState, standing: Standing, walk: Walk, now: TimeStep, u: Array) -> Prior:
        """The prediction with the covariance g g' sigma^2 by errors of the neighbours' estimates."""
        prior = super()._predict(estimate, standing, walk, now, u)
        assert prior.tangent is not None
        (x, p), n = prior.core, len(self.plant.states)
        by_error = prior.tangent[..., :n, self._by_load] * u[..., ERROR_OUTSIDE, None]
        p[..., :n, :n] += by_error[..., :, None] * by_error[..., None, :]
        return prior._replace(core=GaussianState(x, p))


class NetworkDecision(NamedTuple):
    """What the areas of a network decide, S sensors and H hypotheses about the process in the order of `RobustAreas`.

    isolated (..., S); process, process_size, process_sd (..., H), sizes NaN where not accepted; suspect (..., S + H);
    residual, threshold (..., S), in the sensors' units, NaN where not evaluated; alarm (..., N); estimate (..., N, n).
    """

    isolated: Array
    process: Array
    process_size: Array
    process_sd: Array
    suspect: Array
    residual: Array
    threshold: Array
    alarm: Array
    estimate: Array


@dataclass(frozen=True, eq=False)
class RobustAreas:
    """The robust banks of all areas of a network.

    Parameters
    ----------
    areas : LocalAreas
        The models of the areas and the network.
    false_alarm : float, default 1e-3
        Of the whole network in one step, shared by all its sensors, as of `RobustBank` on the whole network.
    process_false_alarm : float, default 1e-5
        Of the whole network in one step, shared by all its hypotheses, likewise.
    settings : mapping of str to any, default {}
        Others of `RobustBank`.

    Raises
    ------
    ValueError
        As `RobustBank` does.

    Examples
    --------
    >>> from fusion_sfdia.detectors import RobustAreas
    >>> from fusion_sfdia.models.power_network.area_plant import local_areas
    >>> from fusion_sfdia.models.power_network.model import network_model
    >>> from fusion_sfdia.models.power_network.parameters import generate_network
    >>> banks = RobustAreas(local_areas(network_model(generate_network(6, seed=0))))
    >>> len(banks.sensors), len(banks.process_hypotheses)
    (38, 68)
    """

    areas: LocalAreas
    false_alarm: float = 1e-3
    process_false_alarm: float = 1e-5
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for what in ("false_alarm", "process_false_alarm"):
            probability(what, getattr(self, what))

    @cached_property
    def banks(self) -> tuple[AreaBank, ...]:
        """The bank of each group of areas."""
        count = len(self.areas.network.topology.names)
        rest = np.zeros(2 * count), np.zeros(count), np.zeros(count)
        found = [AreaBank(g.plant, usual=self.areas.inputs(g, *rest), **self.settings) for g in self.areas.groups]
        each = list(zip(self.areas.groups, found, strict=True))
        sensors = sum(len(g.areas) * len(b.plant.sensors) for g, b in each)
        process = sum(len(g.areas) * len(b.model.states) for g, b in each)
        return tuple(
            replace(
                b,
                false_alarm=self.false_alarm * len(b.plant.sensors) / sensors,
                process_false_alarm=self.process_false_alarm * len(b.model.states) / process,
            )
            for b in found
        )

    @cached_property
    def _places(self) -> tuple[tuple[Array, ...], int]:
        """For each group the positions (M, P) of its hypotheses among the H of the network, area after area, and H."""
        sizes = np.zeros(len(self.areas.network.topology.names), int)
        for g, bank in zip(self.areas.groups, self.banks, strict=True):
            sizes[g.areas] = len(bank.process_hypotheses)
        start = np.cumsum(sizes) - sizes
        places = [
            start[g.areas, None] + np.arange(len(b.process_hypotheses))
            for g, b in zip(self.areas.groups, self.banks, strict=True)
        ]
        return tuple(places), int(np.sum(sizes))

    @cached_property
    def sensors(self) -> tuple[str, ...]:
        """The names of the sensors (S,): those of the areas' states, then those at the sides of the ties."""
        names = {
            int(k): self.areas.named(g, m, s.name)
            for g in self.areas.groups
            for m, row in enumerate(g.sensors)
            for k, s in zip(row, g.plant.sensors, strict=True)
        }
        return tuple(names[k] for k in range(len(names)))

    @cached_property
    def process_hypotheses(self) -> tuple[str, ...]:
        """The names of the hypotheses about the process (H,), area after area."""
        places, count = self._places
        names = [""] * count
        for g, bank, place in zip(self.areas.groups, self.banks, places, strict=True):
            for m, row in enumerate(place):
                for k, h in zip(row, bank.process_hypotheses, strict=True):
                    names[int(k)] = self.areas.named(g, m, h.name)
        return tuple(names)

    def init(self, batch: tuple[int, ...] = (), t: float = 0.0) -> tuple[State, ...]:
        """The state of a batch of runs at a time: that of each group's bank.

        Parameters
        ----------
        batch : tuple of int, default ()
            Shape of the batch.
        t : float, default 0
            Time in s.

        Returns
        -------
        tuple of State
            One for each group of areas.
        """
        return tuple(bank.init((*batch, len(g.areas)), t) for bank, g in zip(self.banks, self.areas.groups, strict=True))

    def step(self, state: tuple[State, ...], t: float, y: Array, u: Array) -> tuple[tuple[State, ...], NetworkDecision]:
        """Diagnose readings under the inputs since the last step.

        Parameters
        ----------
        state : tuple of State
            After the last step, or of `init`.
        t : float
            Time of the readings in s.
        y : array (..., S)
            Readings of the areas' states and then those at the sides of the ties, NaN where missing.
        u : array (..., 2N)
            Inputs that acted since the last step.

        Returns
        -------
        state : tuple of State
            After these readings.
        decision : NetworkDecision
            What the areas decide.

        Raises
        ------
        ValueError
            For values and shapes that do not fit, as of the banks.
        """
        y, u = floats("y", y), floats("u", u)
        groups, n = self.areas.groups, len(self.banks[0].plant.states)
        count = len(self.areas.network.topology.names)
        sensors = n * count + self.areas.slope.size
        batch = state[0].diverged.shape[:-1]
        if y.shape != (*batch, sensors) or u.shape[-1:] != (2 * count,):
            raise ValueError(
                f"y has shape {y.shape}, u {u.shape}; expected {(*batch, sensors)}, readings of the areas' states and then "
                f"those at the sides of the ties, and (..., {2 * count})"
            )
        shared, variance = np.empty((*batch, count)), np.empty((*batch, count))
        for g, s in zip(groups, state, strict=True):
            shared[..., g.areas] = s.memory.estimate.x[..., 0]
            variance[..., g.areas] = s.memory.estimate.P[..., 0, 0]
        after, decisions = [], []
        for bank, g, s in zip(self.banks, groups, state, strict=True):
            now, decision = bank.step(s, t, y[..., g.sensors], self.areas.inputs(g, u, shared, variance))
            after.append(now)
            decisions.append(decision)
        return tuple(after), self._joined(batch, sensors, decisions)

    def readmit(self, state: tuple[State, ...], sensors: str | Iterable[str]) -> tuple[State, ...]:
        """The state in which sensors are used again in all runs: after their repair, or where an isolation was wrong.

        As `BatchDetector.readmit` of the bank of the area that judges each sensor.

        Parameters
        ----------
        state : tuple of State
            After the last step.
        sensors : str or iterable of str
            Their names.

        Returns
        -------
        tuple of State
            From which the run goes on.

        Raises
        ------
        ValueError
            For an unknown sensor.
        """
        names = [sensors] if isinstance(sensors, str) else list(sensors)
        if unknown := [name for name in names if name not in self.sensors]:
            raise ValueError(f"unknown sensor {shown(unknown[0])}; {did_you_mean(unknown[0], self.sensors)}see `sensors`")
        which = np.isin(self.sensors, names)
        return tuple(
            s._replace(memory=bank._readmitted(s.memory, float(s.t), which[g.sensors]))
            for bank, g, s in zip(self.banks, self.areas.groups, state, strict=True)
        )

    def _joined(self, batch: tuple[int, ...], sensors: int, decisions: list[Decision]) -> NetworkDecision:
        places, hypotheses = self._places
        count, n = len(self.areas.network.topology.names), len(self.banks[0].plant.states)
        flags = [np.zeros((*batch, k), bool) for k in (sensors, hypotheses, sensors + hypotheses, count)]
        isolated, process, suspect, alarm = flags
        residual, threshold = (np.full((*batch, sensors), np.nan) for _ in range(2))
        size, sd = (np.full((*batch, hypotheses), np.nan) for _ in range(2))
        estimate = np.empty((*batch, count, n))
        for g, d, place in zip(self.areas.groups, decisions, places, strict=True):
            assert d.suspect is not None
            isolated[..., g.sensors], residual[..., g.sensors], threshold[..., g.sensors] = d.isolated, d.residual, d.threshold
            process[..., place], size[..., place], sd[..., place] = d.process, d.process_size, d.process_sd
            suspect[..., np.concatenate([g.sensors, sensors + place], axis=1)] = d.suspect
            alarm[..., g.areas], estimate[..., g.areas, :] = d.alarm, d.estimate
        return NetworkDecision(isolated, process, size, sd, suspect, residual, threshold, alarm, estimate)
