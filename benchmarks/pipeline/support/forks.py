"""Runs that have the same readings until a fault begins: followed together until then, each on its own from then on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, cast

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.detector import Decision, Detector, chosen, stack
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.detectors.kalman_banks.excluding_bank import ExcludingBank
from fusion_sfdia.detectors.kalman_banks.fusing_bank import FusingBank
from fusion_sfdia.detectors.kalman_banks.multiple_model import MultipleModel
from fusion_sfdia.detectors.state import chosen_runs
from fusion_sfdia.filters.estimators import Core, Ensemble, Estimator, GaussianState, Prior, Reading
from fusion_sfdia.filters.gaussian import Joint
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.study.trials import Faulted

Array = NDArray[Any]
OF_ESTIMATORS = (CentralFilter, ExcludingBank, FusingBank, MultipleModel)


def decisions(detector: Detector, cases: Sequence[Faulted], seed: int = 0) -> Iterator[Decision]:
    """The Decision of each case over all times, without covariances: the numbers that `decide` has for each alone.

    cases: other faults in the same recording. A run of several cases is stepped once as long as its readings are the
    recording's. Random numbers of an ensemble are those of the run of the recording, in all cases.
    """
    recording = cases[0].recording
    y, u, healthy = np.stack([case.y for case in cases], axis=1), recording.u_of_runs, recording.y[:, None]
    count, runs = y.shape[1:3]
    differs = ((y != healthy) & ~(np.isnan(y) & np.isnan(healthy))).any(axis=-1)
    own = np.logical_or.accumulate(differs, axis=0)  # (K, cases, runs)
    followed = np.where(own, runs + np.arange(count * runs).reshape(count, runs), np.arange(runs))
    under_way = np.arange(runs)
    state, stepping = detector.init((runs,), float(recording.t[0]) - detector.plant.dt, seed), detector
    found: list[Decision] = []
    places: list[Array] = []
    for k, t in enumerate(recording.t):
        now, first, place = np.unique(followed[k], return_index=True, return_inverse=True)
        if not np.array_equal(now, under_way):
            before = np.where(np.isin(now, under_way), now, now % runs)
            state = chosen_runs(state, np.searchsorted(under_way, before))
            under_way, stepping = now, _of_runs(detector, runs, now % runs)
        state, decision = stepping.step(state, float(t), y[k].reshape(count * runs, -1)[first], u[k, now % runs])
        found.append(replace(decision, covariance=None))
        places.append(place.reshape(count, runs))
    for c in range(count):
        yield stack([chosen(decision, place[c]) for decision, place in zip(found, places, strict=True)])


def _of_runs(detector: Detector, count: int, runs: Array) -> Detector:
    """The detector for some of `count` runs, of which one may occur more than once; only an ensemble tells them apart."""
    if not isinstance(detector, OF_ESTIMATORS) or not isinstance(detector.estimator, Ensemble):
        return detector
    settings = cast(Any, detector)
    estimator: Estimator = _EnsembleOfRuns(detector.estimator, count, tuple(runs.tolist()))
    changed: Detector = replace(settings, estimator=estimator)
    return changed


@dataclass(frozen=True)
class _EnsembleOfRuns:
    """An ensemble filter whose k-th run draws the numbers of run runs[k] of a batch of `count`."""

    ensemble: Ensemble
    count: int
    runs: tuple[int, ...]
    is_random: ClassVar[bool] = True

    @property
    def consistent(self) -> bool:
        return self.ensemble.consistent

    def start(self, plant: Plant, batch: tuple[int, ...], rng: np.random.Generator) -> Core:
        return self.ensemble.start(plant, batch, rng)

    def predict(self, plant: Plant, core: Core, t_start: float, u: Array, dt: float, rng: np.random.Generator) -> Prior:
        return self.ensemble.predict(plant, core, t_start, u, dt, cast(Any, _Draws(rng, self.count, self.runs)))

    def joint(self, plant: Plant, prior: Prior, t: float, u: Array) -> Joint:
        return self.ensemble.joint(plant, prior, t, u)

    def update(self, plant: Plant, prior: Prior, t: float, y: Array, u: Array) -> GaussianState:
        return self.ensemble.update(plant, prior, t, y, u)

    def assimilate(self, plant: Plant, prior: Prior, reading: Reading, x: Array, p: Array, rng: np.random.Generator) -> Core:
        return self.ensemble.assimilate(plant, prior, reading, x, p, cast(Any, _Draws(rng, self.count, self.runs)))


@dataclass(frozen=True)
class _Draws:
    """Of a generator, what a filter asks of it."""

    rng: np.random.Generator
    count: int
    runs: tuple[int, ...]

    def standard_normal(self, shape: tuple[int, ...]) -> Array:
        return self.rng.standard_normal((self.count, *shape[1:]))[list(self.runs)]
