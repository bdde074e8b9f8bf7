"""Where runs begin is learnt from first readings that show it, and from no others."""

from __future__ import annotations

import numpy as np
import pytest
from toy_plants import tanks

from fusion_sfdia.diagnosis.simulate import simulate
from fusion_sfdia.learning.commissioning.start import first_error, first_state, with_start
from fusion_sfdia.plant.log import Log

PLANT = tanks()
LEVELS = slice(0, 2)


def log_of(x0: np.ndarray | None = None, runs: int = 4) -> Log:
    """Healthy readings of runs that begin with a state, by default the plant's own."""
    found = simulate(PLANT, 3, seeds=range(runs), truth="model", start="nominal" if x0 is None else x0)
    return Log(found.t, found.y, found.u_of_runs)


def test_a_start_as_stated_is_kept() -> None:
    assert first_state(PLANT, log_of()) is None
    assert first_error(PLANT, log_of()) < 1 + 5 * np.sqrt(2 / 16)  # 4 runs of 4 sensors


def test_another_start_is_found() -> None:
    x0 = PLANT.x0 + np.array([0.3, -0.2])
    log = log_of(x0)
    found = first_state(PLANT, log)
    assert found is not None
    assert found.x0 == pytest.approx(x0, abs=4 * np.max(PLANT.sensor_sigma[LEVELS]))
    assert first_error(with_start(PLANT, found), log) < 2 < first_error(PLANT, log)


@pytest.mark.parametrize("level", [-0.5, 1e3])
def test_a_state_beyond_its_limits_is_no_start(level: float) -> None:
    """As the first rows of a log in which readings do not fit one another would have it."""
    log = log_of()
    log.y[0, :, 0] = level
    assert first_state(PLANT, log) is None and first_error(PLANT, log) > 100
