"""Plants and detectors by name, by reference and as objects; what is registered, and what is refused."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_plants import chain

from fusion_sfdia import Plant
from fusion_sfdia.common.references import load
from fusion_sfdia.detectors import CentralFilter, LeaveOneOutBank, registry
from fusion_sfdia.detectors.detector import Claims
from fusion_sfdia.plants import two_tanks

pytestmark = pytest.mark.usefixtures("registrations")

TANK = """
from fusion_sfdia.plants import two_tanks

PLANT = two_tanks()

def make():
    return two_tanks(outlet=1.1)

def of_size(size):
    return size

def number():
    return 3
"""


@pytest.fixture
def tank(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "tank.py").write_text(TANK)
    monkeypatch.chdir(tmp_path)


def test_our_own_plants_are_the_folders_of_models_and_every_reference_leads_somewhere(root: Path) -> None:
    folders = sorted(f.parent.name.replace("_", "-") for f in (root / "models").glob("*/__init__.py"))
    assert list(registry.plants()) == folders
    assert all(entry.package == "fusion_sfdia" and callable(load(entry.source)) for entry in registry.plants().values())
    assert all(entry.package == "fusion_sfdia" and callable(load(entry.source)) for entry in registry.detectors().values())
    assert all(entry.about and entry.memory for entry in registry.detectors().values())


def test_a_call_and_a_decorator_register() -> None:
    @registry.register_plant("chain", "a chain")
    def some_chain() -> Plant:
        return chain(3)

    registry.register_plant("lazy-chain", "another", "toy_plants:chain", cases=["a case"])
    assert registry.plant("chain").x0.size == 3 and registry.plant("lazy-chain").x0.size == 12
    assert registry.plants()["lazy-chain"].cases == ["a case"] and registry.plants()["chain"].cases is None
    assert registry.find_plant(some_chain) is registry.plants()["chain"]
    assert list(registry.plants())[-2:] == ["chain", "lazy-chain"]  # after our own

    @registry.register_detector("mine", "mine", memory="none", false_alarm=0.01)
    class Mine(CentralFilter):
        pass

    registry.register_detector(
        "mine:lazy", "mine, too", "fusion_sfdia.detectors.kalman_banks.central_filter:CentralFilter", false_alarm=0.02
    )
    plant = chain(3)
    assert registry.detector("mine", plant) == Mine(plant, false_alarm=0.01)
    built: Any = registry.detector("mine:lazy", plant)
    assert built.false_alarm == 0.02 and registry.detectors()["mine"].memory == "none"
    assert list(registry.detectors())[-2:] == ["mine:lazy", "mine"]  # the code of the first is our own


def test_a_comparison_of_all_leaves_out_slow_references_and_what_commissions_the_plant() -> None:
    named = {name for name, entry in registry.detectors().items() if entry.reference}
    assert named == {"filterpy-ekf", "filterpy-ukf"}
    assert registry.detectors().keys() - registry.compared_detectors().keys() == {"frozen-model", *named}

    @registry.register_detector("slow", "a slow one", reference=True)
    class Slow(CentralFilter):
        pass

    assert registry.detectors()["slow"].reference and "slow" not in registry.compared_detectors()


def test_a_name_is_registered_again_by_its_own_source_alone() -> None:
    registry.register_plant("chain", "before", "toy_plants:chain")
    registry.register_plant("chain", "after", "toy_plants:chain")
    assert registry.plants()["chain"].about == "after"
    with pytest.raises(ValueError, match="plant 'chain' of toy_plants:tanks: that name is taken by toy_plants:chain; register"):
        registry.register_plant("chain", "tanks", "toy_plants:tanks")
    with pytest.raises(
        ValueError, match=r"detector 'loo-glr' of .*CentralFilter: that name is taken by fusion_sfdia.detectors.kalman_banks"
    ):
        registry.register_detector("loo-glr", "another", CentralFilter)
    with pytest.raises(ValueError, match="plant 'Two Tanks': expected small letters, digits and hyphens, such as two-tanks"):
        registry.register_plant("Two Tanks", "tanks", "toy_plants:tanks")


@pytest.mark.usefixtures("tank")
def test_plants_by_reference_and_as_objects() -> None:
    by_file = registry.find_plant("tank.py:make")
    assert by_file.name == "tank.py:make" and registry.plant("tank.py:make").x0[0] == two_tanks(outlet=1.1).x0[0]
    assert registry.plant("tank.py:PLANT").name == registry.plant("toy_plants:tanks").name == "two-tanks"
    plant = chain(3)
    assert registry.find_plant(plant).name == "chain" and registry.plant(plant) is plant
    assert registry.find_plant(two_tanks).name == "two_tanks" and registry.plant(partial(chain, 4)).x0.size == 4
    assert registry.find_plant(by_file) is by_file


def test_detectors_by_reference_and_as_objects() -> None:
    plant = two_tanks()
    reference = "fusion_sfdia.detectors.kalman_banks.central_filter:CentralFilter"
    assert registry.find_detector(reference).name == reference
    assert isinstance(registry.detector(reference, plant), CentralFilter)
    assert registry.find_detector(CentralFilter).name == "CentralFilter"
    assert registry.find_detector(CentralFilter).about.startswith(CentralFilter.__doc__.partition("\n")[0].rstrip("."))  # type: ignore[union-attr]
    assert registry.detector(partial(LeaveOneOutBank, window=5), plant) == LeaveOneOutBank(plant, window=5)
    assert registry.find_detector(partial(LeaveOneOutBank, window=5)).name == "LeaveOneOutBank"


@pytest.mark.usefixtures("tank")
@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("two-tank", "unknown plant 'two-tank'; did you mean 'two-tanks'"),
        (
            "tank.py:of_size",
            "plant tank.py:of_size cannot be called with 0 arguments .*'size'.*; expected a Plant, or a function",
        ),
        ("tank.py:number", "plant tank.py:number: its function returned int; expected a Plant"),
        ("tank.py:TANK", "has no attribute 'TANK'; it has two_tanks, PLANT, make, of_size, number"),
        ("tank.py", "plant 'tank.py' is a file; name the plant in it, tank.py:NAME"),
        ("other.py:make", "other.py cannot be read"),
        (7, "plant int is of type int; expected a Plant, or a function without arguments that returns one"),
    ],
)
def test_what_is_no_plant_is_refused(what: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        registry.plant(what)


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("kf-chi", "unknown detector 'kf-chi'; did you mean 'kf-chi2'"),
        ("chebyshev:papr", "there is no module chebyshev; .*; or did you mean the detector 'chebyshev:paper'"),
        (
            "math:tau",
            "detector math:tau is of type float; expected a class or function that takes a Plant and returns a Detector",
        ),
        ("toy_plants:tanks", "detector toy_plants:tanks cannot be called with 1 argument"),
        ("builtins:repr", "detector builtins:repr: built str; expected a Detector, with plant, hypotheses, init and step"),
        (CentralFilter(two_tanks()), "detector CentralFilter is of type CentralFilter; expected a class or function"),
    ],
)
def test_what_is_no_detector_is_refused(what: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        registry.detector(what, two_tanks())


def test_what_a_detector_claims_may_be_a_field_or_an_attribute() -> None:
    @dataclass(frozen=True)
    class Stated(Claims):
        false_alarm: float

    class Set(Claims):
        def __init__(self) -> None:
            self.most_faults = 1

    assert Stated(0.1).claimed_rate == 0.1 and Stated(0.1).most_faults == np.inf
    assert Set().most_faults == 1 and np.isnan(Set().claimed_rate)
    with pytest.raises(TypeError, match="missing 1 required positional argument: 'false_alarm'"):
        Stated()  # type: ignore[call-arg]
