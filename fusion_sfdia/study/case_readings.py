"""Readings of a plant under another truth, under other inputs, or with a part of its inputs lost."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.diagnosis.simulate import Recording, simulate
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.study.cases import in_operation

Array = NDArray[Any]


def case_readings(
    of: Plant,
    steps: int,
    seeds: Sequence[int],
    *,
    truth: Plant | None = None,
    inputs: Callable[[float], Array] | None = None,
    lost: tuple[float, tuple[float, ...]] | None = None,
) -> Recording:
    """Readings from the high-fidelity model of a truth (None: of the plant) under inputs (None: those of its operation).

    lost: from a time (s) on the acting inputs are the known ones times these factors.
    """
    model = in_operation(of if truth is None else truth, inputs)
    if lost is not None and model.truth.feedback is not None:
        raise ValueError(f"plant {model.name!r} has controllers, which would act on what is lost; give its fault a truth")
    finest, to_states = (model, None) if model.truth.finer is None else model.truth.finer()
    finest = replace(finest, sensors=of.sensors)  # whose noise may be a share of what they usually read
    run = partial(
        simulate, of, steps, seeds, truth=finest, to_states=to_states, process_noise=of.truth.disturbed or model.truth.disturbed
    )
    if lost is None:
        return run()
    t = np.arange(steps) * of.dt
    known = np.array([model.input_at(float(s)) for s in t])
    acting = np.where((t >= lost[0] - 1e-6 * of.dt)[:, None], known * np.asarray(lost[1]), known)
    return replace(run(inputs=acting), u=known)
