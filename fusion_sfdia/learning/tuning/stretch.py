"""Tuning on a stretch of the log that is then diagnosed."""

from __future__ import annotations

from typing import Any

from fusion_sfdia.common.clock import Clock, within
from fusion_sfdia.common.rate import Rate
from fusion_sfdia.learning.tuning.tune import HealthySource, tune
from fusion_sfdia.learning.tuning.tuned import Tuned
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant

FALSE_ALARM = Rate(1e-3)  # that of registered detectors


def on_stretch(plant: Plant, log: Log, between: str, detector: Any, clock: Clock = Clock()) -> Tuned:  # noqa: B008
    """Tune on the readings between two times of a log of one run, FROM..TO, see `within`; ValueError as `tune` raises it."""
    inside = within(log.t, between, clock)
    part = Log(*(a[inside] for a in log))
    return tune(
        plant, part, false_alarm=FALSE_ALARM, detector=detector, sources=[HealthySource(f"the stretch {between}", clock)]
    )
