"""How long a diagnosis takes, before anybody waits for it."""

from __future__ import annotations

from dataclasses import replace
from itertools import count

import numpy as np
import pytest
from toy_plants import chain, tanks

from fusion_sfdia.learning.inspection import cost as module
from fusion_sfdia.learning.inspection.cost import Waiting, of_waiting, waiting
from fusion_sfdia.learning.inspection.inspect import inspect
from fusion_sfdia.plant.log import Log
from fusion_sfdia.plant.plant import Plant


def undeclared(plant: Plant) -> Plant:
    """The plant without its Jacobians."""
    return replace(plant, numerics=replace(plant.numerics, step_jacobian=None, output_jacobian=None))


def test_rows_are_those_of_the_log_or_of_a_day_and_the_first_one_does_not_count() -> None:
    ticks = count()
    times = iter((0.0, 50.0, 50.0, 53.0, 53.0, 55.0))
    plant = chain(3)
    log = Log(np.arange(700.0), np.zeros((700, 3)), np.zeros((700, 0)))
    found = waiting(plant, log, lambda: (next(ticks), next(times))[1])
    assert found is not None and (found.row, found.rows, found.of_log) == (2.0, 700, True)
    assert next(ticks) == 6 and found.memory > 8 * 3 * 3
    assert waiting(plant) is None


def test_nobody_waits_for_a_short_log_and_a_stream_that_keeps_up() -> None:
    assert not list(of_waiting(tanks(), Waiting(1e-3, 10_000, 1000, True)))
    assert not list(of_waiting(tanks(), None))


@pytest.mark.parametrize(
    ("plant", "found", "says"),
    [
        (
            tanks(),
            Waiting(0.1, 10_000, 36_000, True),
            "the 36000 rows of this log take up to 60 minutes with robust-glr, at 100 ms",
        ),
        (tanks(), Waiting(0.1, 10_000, 36_000, True), "`loo-chi2` takes less"),
        (tanks(), Waiting(3.0, 10_000, 100, False), f"every {tanks().dt:g} s cannot keep up"),
        (chain(4), Waiting(1.0, 3_000_000, 86400, False), "86400 rows, a day, take some 24 hours"),
        (chain(30), Waiting(1.0, 3_000_000, 86400, False), "86400 rows, a day, take some 12 hours"),
        (
            chain(30),
            Waiting(1.0, 3_000_000, 86400, False),
            "at 500 ms a row while its gains rest, as the model is linear, and 1 s",
        ),
        (chain(30), Waiting(1.0, 3_000_000, 86400, False), "its state takes 3 MB"),
        (
            undeclared(chain(4)),
            Waiting(1.0, 3_000_000, 86400, False),
            "state numerics.step_jacobian and numerics.output_jacobian",
        ),
    ],
)
def test_how_long_it_takes_and_what_makes_it_faster(
    plant: Plant, found: Waiting, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "LARGE", 8)
    monkeypatch.setattr("fusion_sfdia.detectors.kalman_banks.steady_gains.LARGE", 8)
    (finding,) = of_waiting(plant, found)
    assert finding.about == "time" and says in finding.text


def test_a_network_of_many_states_is_to_be_split(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "AREAS", 2)
    (finding,) = of_waiting(tanks(), Waiting(1.0, 3_000_000, 86400, False))
    assert "one for each area" in finding.text


def test_an_inspection_states_how_long_a_diagnosis_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fusion_sfdia.learning.inspection.inspect.waiting", lambda plant, log: Waiting(9.0, 10, 1000, False))
    assert "time" in {f.about for f in inspect(chain(3), simulated=False).findings}
