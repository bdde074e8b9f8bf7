"""Sensors that read an input directly are named with the jump by its largest step in the log."""

from __future__ import annotations

import numpy as np

from fusion_sfdia import Sensor, Signal, linear_plant
from fusion_sfdia.learning.inspection.healthy import feedthrough, of_feedthrough
from fusion_sfdia.plant.log import Log

PLANT = linear_plant(
    "pump",
    np.array([[0.9]]),
    np.ones((3, 1)),
    [Sensor(name, name, sigma=0.1) for name in ("level", "flow", "pressure")],
    dt=1.0,
    initial_cov=np.ones(1),
    process_cov=np.ones(1),
    input_matrix=np.ones((1, 2)),
    feedthrough=np.array([[0.0, 0.0], [1.0, 0.0], [0.1, 0.0]]),
    inputs=(Signal("speed"), Signal("power")),
)


def test_the_sensors_that_jump_with_an_input_are_named() -> None:
    u = np.zeros((50, 2))
    u[10:, 0], u[30:, 0], u[20:, 1] = 0.5, 2.5, 100.0
    log = Log(np.arange(50.0), np.zeros((50, 3)), u)
    found = feedthrough(PLANT, log)
    np.testing.assert_allclose(found.jump, [[0.0, 20.0, 2.0], [0.0, 0.0, 0.0]], rtol=1e-12)
    (finding,) = of_feedthrough(PLANT, found)
    assert finding.about == "speed" and "moves flow (20 sigma) at once" in finding.text and '"until the sample"' in finding.text
    assert not list(of_feedthrough(PLANT, feedthrough(PLANT, log._replace(u=u * 0.1))))
    assert not feedthrough(PLANT, log.rows(slice(1))).jump.any()
