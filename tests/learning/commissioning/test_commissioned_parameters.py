"""Parameters from a log: the Kalman filter of the augmented plant, and what a log says nothing of."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from rounding import rounding
from toy_plants import chain, readings

from fusion_sfdia.detectors.kalman_banks.hypotheses import Hypotheses
from fusion_sfdia.learning.commissioning.parameters import estimated, moved
from fusion_sfdia.learning.innovations import filtered
from fusion_sfdia.plant.augment import augment
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.uncertainty import Parameter, Uncertainty

PUSH = np.array([1.0, 0.0, 0.5, 0.0])


def _step(plant: Plant, t_start: float, x: np.ndarray, u: np.ndarray, dt: float, theta: np.ndarray) -> np.ndarray:
    return plant.step(t_start, x, u, dt) + theta[..., :1] * PUSH + 0.0 * theta[..., 1:2] * PUSH


def pushed() -> Plant:
    """The chain with a constant push of unknown size, and a parameter that acts on nothing."""
    plant = chain(4)
    declared = (Parameter("push", sd=0.3), Parameter("nothing", sd=2.0))
    return replace(plant, uncertainty=Uncertainty(declared, partial(_step, plant)))


def log_of(push: float, runs: int = 1) -> Log:
    plant = chain(4)
    t, _, y, u = readings(replace(plant, step=lambda t, x, u, dt: plant.step(t, x, u, dt) + push * PUSH), 80, runs, seed=3)
    return Log(t, y, u)


def test_the_posterior_of_a_linear_plant_is_that_of_the_kalman_filter() -> None:
    plant, log = pushed(), log_of(0.4)
    found = estimated(plant, log, np.ones(80, bool), np.zeros(80, int))
    last = list(filtered(augment(plant), log))[-1]
    tolerance = rounding(1e4, 80 * 6**2)
    np.testing.assert_allclose(found.value, last.x[0, 4:], rtol=tolerance, atol=tolerance)


def test_several_runs_shrink_the_deviation_and_find_the_truth() -> None:
    plant = pushed()
    one = estimated(plant, log_of(0.4), np.ones(80, bool), np.zeros(80, int))
    many = estimated(plant, log_of(0.4, 9), np.ones(80, bool), np.zeros(80, int))
    assert abs(many.value[0] - 0.4) < 4 * np.sqrt(many.cov[0, 0])
    # nine runs and the prior: 1 / var = 9 information + 1 / prior
    information = 1 / one.cov[0, 0] - 1 / 0.3**2
    np.testing.assert_allclose(1 / many.cov[0, 0], 9 * information + 1 / 0.3**2, rtol=1e-6)


def test_what_the_log_says_nothing_of_keeps_its_prior() -> None:
    found = estimated(pushed(), log_of(0.4), np.ones(80, bool), np.zeros(80, int))
    assert (found.value[1], found.sd[1]) == (0.0, 2.0)


def test_a_later_change_is_judged_by_what_was_declared() -> None:
    plant = pushed()
    once = moved(plant, estimated(plant, log_of(0.4), np.ones(80, bool), np.zeros(80, int)))
    twice = moved(once, estimated(once, log_of(0.4), np.ones(80, bool), np.zeros(80, int)))
    assert once.uncertainty.sd[0] < 0.1 and twice.uncertainty.sd[0] < once.uncertainty.sd[0]
    for there in (once, twice):
        assert there.uncertainty.changes == {"push": 0.3, "nothing": 2.0}
        np.testing.assert_array_equal(
            Hypotheses(there).recent_sizes[len(plant.sensors) :][:2], Hypotheses(plant).recent_sizes[len(plant.sensors) :][:2]
        )


def test_runs_that_disagree_keep_the_deviation_large() -> None:
    plant = pushed()
    logs = [log_of(v) for v in (-0.2, 0.0, 0.2, 0.4)]
    log = Log(logs[0].t, np.concatenate([v.y for v in logs], axis=1), np.concatenate([v.u for v in logs], axis=1))
    found = estimated(plant, log, np.ones(80, bool), np.zeros(80, int))
    assert found.sd[0] > 0.1 > 3 * np.sqrt(found.cov[0, 0])
