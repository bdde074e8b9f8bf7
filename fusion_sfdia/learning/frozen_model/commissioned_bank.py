"""Detector: the frozen model with the adaptive bank beside it, on a plant where that bank keeps its rate.

The bank (`robust_bank`) begins at the unknowns of commissioning and sees abrupt and small faults, and which of two
causes with the same lasting pattern has just begun; but its unknowns follow slow changes, and what they have followed it takes
for a fault of a sensor when the change ends. So what it says counts

- while the frozen model shows nothing: for `TRUSTED` rows, but not soon after an event, and then only while a window shows that
  cause at all;
- while the frozen model shows suspects or the process: of a cause that explains an event with an abrupt onset, where the bank
  has named it at most `ONSET` rows after the event began: the onset is evidence that lasting patterns do not use;
- never against a sensor that the frozen model names, and never outside the healthy log.

What no longer counts, and the end of an event, begin the bank anew, at the unknowns of commissioning and with states as
uncertain as at a start. The numbers were chosen on simulated tanks, an engine and a cascade of tanks with a wrong law.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.steps import Each, in_silence
from fusion_sfdia.detectors.batch_detector import TimeStep
from fusion_sfdia.detectors.detector import Decision, ProcessHypothesis
from fusion_sfdia.detectors.health import decision_of_runs, of_runs
from fusion_sfdia.detectors.kalman_banks.robust_bank import RobustBank
from fusion_sfdia.detectors.kalman_banks.robust_memory import RobustMemory
from fusion_sfdia.filters.estimators import GaussianState
from fusion_sfdia.filters.gaussian import dense
from fusion_sfdia.learning.commissioning.commission import as_runs
from fusion_sfdia.learning.commissioning.parameters import at, declared
from fusion_sfdia.learning.commissioning.start import seen_to_fit
from fusion_sfdia.learning.frozen_model.commissioned_model import stretches
from fusion_sfdia.learning.frozen_model.frozen_bank import (
    FADES,
    FALSE_ALARM,
    NO_SINGLE_CAUSE,
    OUTSIDE,
    FrozenBank,
    FrozenMemory,
    Witness,
)
from fusion_sfdia.learning.frozen_model.frozen_filter import unknowns
from fusion_sfdia.plant.log import Log

Array = NDArray[Any]

TRUSTED = 20  # rows for which the bank is believed where the frozen model shows nothing
ONSET = 30  # rows after an event began, in which the bank tells what has just begun
RATE = 0.002  # share of healthy rows in which the bank may isolate a sensor or name the process, to be used at all


class BothMemory(NamedTuple):
    """Of the frozen model and of the bank, and for how many rows the bank has held each of its causes (..., N + P)."""

    frozen: FrozenMemory
    bank: RobustMemory
    held: Array


@dataclass(frozen=True)
class CommissionedBank(FrozenBank):
    """The frozen model of a healthy log, and the adaptive bank that begins there.

    fitted_scale: the scale of the frozen model's thresholds at which the bank has its own ones.
    """

    fitted_scale: float = field(default=1.0, kw_only=True)

    @cached_property
    def process_hypotheses(self) -> tuple[ProcessHypothesis, ...]:
        """The unknowns of the plant, what else the bank tests, and the frozen model's two without a size."""
        known = unknowns(self.plant)
        names = {h.name for h in known}
        return (*known, *(h for h in self._bank.process_hypotheses if h.name not in names), NO_SINGLE_CAUSE, OUTSIDE)

    @cached_property
    def _bank(self) -> RobustBank:
        there = seen_to_fit(at(self.plant, self.frozen.values, declared(self.plant)[2]))
        rate = FALSE_ALARM if self.fitted_rate is None else min(self.fitted_rate, FALSE_ALARM)
        return RobustBank(there, threshold_scale=self.threshold_scale / self.fitted_scale, false_alarm=rate)

    @cached_property
    def _places(self) -> tuple[Array, Array, Array]:
        """The place of each hypothesis of the bank among all (P,), among the causes of the frozen model (P,), -1 for none, and
        of those of the frozen model among all.
        """
        names = [h.name for h in self.process_hypotheses]
        count, own = len(self.plant.sensors), len(unknowns(self.plant))
        place = np.array([names.index(h.name) for h in self._bank.process_hypotheses])
        cause = np.where(place < own, count + place, -1)
        return place, np.concatenate([np.arange(count), cause]), np.array([*range(own), len(names) - 2, len(names) - 1])

    def _start(self, batch: tuple[int, ...], seed: int) -> Any:
        causes = len(self.plant.sensors) + len(self._bank.process_hypotheses)
        return BothMemory(super()._start(batch, seed), self._bank._start(batch, seed), np.zeros((*batch, causes)))

    def _judge(self, memory: BothMemory, now: TimeStep, y: Array, u: Array) -> tuple[BothMemory, Decision]:
        frozen, channel, seen = self._witnessed(memory.frozen, now, y, u)
        bank, other = self._bank._judge(memory.bank, now, y, u)
        assert other.process is not None and channel.process is not None
        said = np.concatenate([other.isolated, other.process], axis=-1)
        held = np.where(said, memory.held + 1, 0.0)
        starting = now.k <= self.frozen.settle
        counts = said & self._counts(seen, channel, held, starting)
        ends = (frozen.calm == FADES) & (memory.frozen.age > 0)
        overruled = np.asarray((said & ~counts).any(axis=-1) & ~seen.alarm)
        lost = other.diverged  # then from the estimate of the frozen model
        anew = np.asarray((overruled & (not starting)) | ends | lost)
        if anew.any():
            n = len(self.plant.states)
            own, others = ((z[..., :n], P[..., :n, :n]) for z, P in (bank.estimate, frozen.tracked.core))
            x, P = of_runs(lost, others, own)
            begun = self._begun(x, P + dense(self.plant.initial_cov), now.seed)
            noise, pairs = of_runs(lost, (begun.noise, begun.pairs), (bank.noise, bank.pairs))
            bank = of_runs(anew, begun._replace(noise=noise, pairs=pairs), bank)
            held = np.where(anew[..., None], 0.0, held)
        return BothMemory(frozen, bank, held), self._together(channel, other, counts)

    def _readmitted(self, memory: BothMemory, t: float, which: Array) -> BothMemory:
        return memory._replace(bank=self._bank._readmitted(memory.bank, t, which))

    def isolated_alone(self, log: Log, each: Each = in_silence) -> tuple[float, Array]:
        """The share of the rows of healthy runs y (K, B, N) in which the bank by itself isolates a sensor or names the process,
        and which sensors it isolates (K, B, N).

        It begins where the frozen model has forgotten its start, as uncertain as at any start, in stretches side by side.
        """
        parts, frozen = stretches(self.plant, log, self.frozen.settle), self._filter
        settle, first = self.frozen.settle, dense(self.plant.initial_cov)
        tracked, bank, hits = frozen.start((parts.y.shape[1],)), None, 0
        before = float(parts.t[0]) - self.plant.dt
        runs, sensors = log.y.shape[1:]
        isolated = np.zeros((len(parts.t), runs, parts.y.shape[1] // runs, sensors), bool)  # by run and stretch
        for k in each(range(len(parts.t)), "trying the adaptive bank"):
            t, y, u = float(parts.t[k]), parts.y[k], parts.u[k]
            if k < settle:
                tracked, _ = frozen.step(tracked, before, t - before, y, u)
            else:
                bank = self._begun(tracked.core.x[..., : len(first)], first, 0) if bank is None else bank
                with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # as in a step
                    bank, found = self._bank._judge(bank, TimeStep(before, t, t - before, 0, k - settle + 1), y, u)
                assert found.process is not None
                hits += int(np.sum(found.isolated.any(axis=-1) | found.process.any(axis=-1)))
                isolated[k] = found.isolated[..., :sensors].reshape(isolated.shape[1:])
            before = t
        whole, long = np.zeros(log.y.shape, bool), len(parts.t) - settle
        for m in range(isolated.shape[2]):
            whole[settle + m * long : settle + (m + 1) * long] = isolated[settle:, :, m]
        return float(hits / max(long * parts.y.shape[1], 1)), whole

    def _counts(self, seen: Witness, channel: Decision, held: Array, starting: bool) -> Array:
        """Which of the bank's causes count (..., N + P) that it has held for so many rows."""
        if starting:
            return np.ones(held.shape, bool)
        _, cause, _ = self._places
        explains, shown = (a[..., cause] & (cause >= 0) for a in (seen.explains, seen.shown))
        named = np.asarray(channel.isolated.any(axis=-1))[..., None]
        at_onset = seen.abrupt[..., None] & (seen.age[..., None] - held <= ONSET)
        event = (seen.age > 0)[..., None]
        while_silent = np.where(event, at_onset & (seen.calm <= TRUSTED)[..., None], held <= TRUSTED) | shown
        return np.asarray(np.where(seen.alarm[..., None], at_onset & explains, while_silent) & ~named)

    def _begun(self, x: Array, P: Array, seed: int) -> RobustMemory:
        """The bank at the unknowns of commissioning, with the states x (..., n) and their covariance P (..., n, n)."""
        n, begun = len(self.plant.states), self._bank._start(x.shape[:-1], seed)
        z, cov = (np.array(a) for a in begun.estimate)
        cov[..., :n, n:] = cov[..., n:, :n] = 0.0  # what a plant at rest has
        z[..., :n], cov[..., :n, :n] = x, P
        return begun._replace(estimate=GaussianState(z, cov))

    def _together(self, channel: Decision, bank: Decision, counts: Array) -> Decision:
        """The bank's decision in the runs where something of it counts, else the frozen model's."""
        count, (place, _, own) = len(self.plant.sensors), self._places
        channel, use = self._spread(channel, own), np.asarray(counts.any(axis=-1))
        if not use.any():
            return channel
        bank = self._spread(bank, place)
        assert bank.process is not None and bank.process_size is not None and bank.process_sd is not None
        isolated, process = bank.isolated & counts[..., :count], bank.process.copy()
        process[..., place] &= counts[..., count:]
        counted = replace(
            bank,
            isolated=isolated,
            fault_size=np.where(isolated, bank.fault_size, np.nan),
            process=process,
            process_size=np.where(process, bank.process_size, np.nan),
            process_sd=np.where(process, bank.process_sd, np.nan),
            suspect=np.zeros_like(bank.suspect),
        )
        return decision_of_runs(use, counted, channel)

    def _spread(self, decision: Decision, at: Array) -> Decision:
        """A decision about some of the process hypotheses, which have these places, as one about all."""
        count, total = len(self.plant.sensors), len(self.process_hypotheses)

        def spread(a: Array | None, empty: Any, first: int = 0) -> Array:
            assert a is not None
            found = np.full((*a.shape[:-1], first + total), empty, a.dtype)
            found[..., :first], found[..., first + at] = a[..., :first], a[..., first:]
            return found

        return replace(
            decision,
            process=spread(decision.process, False),
            process_size=spread(decision.process_size, np.nan),
            process_sd=spread(decision.process_sd, np.nan),
            suspect=spread(decision.suspect, False, count),
            probability=spread(decision.probability, 0.0, count),
        )


def with_bank(frozen: FrozenBank, healthy: Any, each: Each = in_silence) -> tuple[FrozenBank, float, Array]:
    """The detector with the adaptive bank beside it, where the bank keeps its rate on healthy readings, else as it is; the
    share of their rows in which the bank by itself isolates a sensor or names the process; and the sensors that it isolates
    there (K, B, N).

    healthy: a Recording, a Log, a pandas frame or (t, y, u), see `as_log`.
    """
    both = CommissionedBank(
        frozen.plant,
        frozen=frozen.frozen,
        threshold_scale=frozen.threshold_scale,
        fitted_rate=frozen.fitted_rate,
        fitted_scale=frozen.threshold_scale,
    )
    share, isolated = both.isolated_alone(as_runs(frozen.plant, (healthy,)), each)
    return (both if share <= RATE else frozen), share, isolated
