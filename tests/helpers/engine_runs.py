"""Healthy runs of the marine engine, and decisions of a detector on its first samples."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from fusion_sfdia.detectors.adaptive_thresholds.adaptive_threshold import AdaptiveThreshold
from fusion_sfdia.detectors.detector import Decision, run
from fusion_sfdia.diagnosis.simulate import Recording, simulate
from fusion_sfdia.models.marine_engine.plant import marine_engine

ENGINE = marine_engine()


DETECTOR = AdaptiveThreshold(ENGINE)


BOUND = np.array([s.noise_bound for s in ENGINE.sensors])


@cache
def healthy(steps: int, runs: int) -> Recording:
    return simulate(ENGINE, steps, range(runs), truth="model")


def judge(detector: AdaptiveThreshold, y: np.ndarray, recording: Recording) -> Decision:
    u = np.broadcast_to(recording.u[:, None], (*y.shape[:2], recording.u.shape[-1]))
    return run(detector, detector.init((y.shape[1],)), recording.t, y, u)[1]


def recording_of(recording: Recording, steps: int) -> Recording:
    return replace(recording, t=recording.t[:steps], u=recording.u[:steps])
