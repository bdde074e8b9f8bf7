"""Documents as TOML: what is written is read again to the last bit."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_plants import Array, tanks

from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.kalman_banks.central_filter import CentralFilter
from fusion_sfdia.learning.tuning.tuned import (
    ModelChangedWarning,
    acting_plant,
    read_document,
    response,
    warn_of_change,
    write_document,
)
from fusion_sfdia.models.two_tanks.plant import two_tanks
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal
from fusion_sfdia.plant.uncertainty import Disturbance, Uncertainty


def test_a_document_is_read_as_it_was_written(tmp_path: Path) -> None:
    numbers = [*np.random.default_rng(0).standard_normal(50).tolist(), 1e-310, 1e300, math.inf, -0.0]
    document = {
        "plain": {"a": 1, "b": 0.1 + 0.2, "c": True, "d": [1.0, 2.0], "e": numbers},
        'odd "name" \\ é': {"a b": {"x": 1.5, "unit": "m3/s"}, "\x7f\t\n": "line\nbreak \x01 \x7f ü"},
        "many": [{"v": 1.0}, {"v": 2.0, "inner": {}}],
        "nothing": {},
    }
    path = tmp_path / "x.toml"
    write_document(path, document, {"": "of the whole\nin two lines", "plain": "a comment"})
    assert read_document(path) == document
    assert path.read_text().startswith("# of the whole\n# in two lines\n\n# a comment\n[plain]\n")


def test_what_a_file_cannot_hold_leaves_none(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="cannot hold None"):
        write_document(tmp_path / "x.toml", {"a": {"b": None}}, {})
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_no_toml_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.toml"
    for content in (b"a = = 1", b"\xff\xfe", b"[a]\n[a]"):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"x\.toml is not a TOML file"):
            read_document(path)


def level(t: float, x: Array, u: Array, dt: float, *, area: float) -> Array:
    return np.asarray(x + dt * (u - 1e-3 * np.sqrt(x)) / area)


def reading(t: float, x: Array, u: Array, *, gain: float = 1.0) -> Array:
    return gain * x


def tank(area: float = 4.0, **settings: Any) -> Plant:
    """A tank that begins at rest, where its area shows in nothing."""
    state = Signal("level", "m", nominal=1.0, low=0.1, initial_sigma=0.02, process_sigma=1e-3)
    return replace(
        Plant(
            "tank", (state,), (Sensor("l", "level", "m", sigma=0.01),), partial(level, area=area), reading, 60.0,
            inputs=(Signal("inflow", "m^3/s", nominal=1e-3),),
        ),
        **settings,
    )  # fmt: skip


@pytest.mark.parametrize("changed", [tank(8.0), tank(4.004), tank(output=partial(reading, gain=1.001))])
def test_a_changed_equation_is_warned_of(changed: Plant) -> None:
    with pytest.warns(ModelChangedWarning, match="plant 'tank' has changed since it was tuned.*tune again"):
        warn_of_change({"response": response(tank())}, changed)


@pytest.mark.parametrize("kept", [{}, {"response": []}, {"response": [v * (1 + 1e-12) for v in response(tank())]}])
def test_the_same_equations_and_older_files_are_accepted(kept: dict[str, Any]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_change(kept, tank())
        warn_of_change({"response": response(tanks())}, tanks())


def test_what_tune_does_not_write_is_refused() -> None:
    for wrong in (1.0, ["x"]):
        with pytest.raises(ValueError, match="response is"):
            warn_of_change({"response": wrong}, tank())


def fails(*given: Any) -> Array:
    raise ArithmeticError("no solution")


def test_a_plant_that_cannot_be_evaluated_beside_its_start_is_not_watched() -> None:
    assert response(replace(tank(), step=partial(level, area=0.0))) == []
    ready = tank()
    object.__setattr__(ready, "step", fails)
    assert response(ready) == []


@pytest.mark.parametrize("name", ["kf-chi2", "loo-chi2"])
def test_a_filter_estimates_learnt_disturbances_by_what_it_claims(name: str, registrations: None) -> None:
    leak = Disturbance("leak", state=np.array([-0.01, 0.0]), reading=np.zeros(4), sd=0.2, time_constant=3600.0)
    plant = replace(two_tanks(), uncertainty=Uncertainty(disturbances=(leak,)))
    states = len(plant.states)
    assert len(acting_plant(plant, registry.find_detector(name)).states) == states + 1
    assert acting_plant(plant, registry.find_detector("chebyshev")) is plant

    class Own(CentralFilter):
        filter_model = None  # type: ignore[assignment]

    registry.register_detector("own", "a detector of another package that keeps its estimate fixed", Own)
    assert acting_plant(plant, registry.find_detector("own")) is plant
