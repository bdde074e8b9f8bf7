"""The checks of plants and detectors detect broken contracts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pytest
from process_bank import OUTLET, ProcessBank
from toy_plants import Array, chain, changed, tanks

from fusion_sfdia import Plant, check_detector, check_plant
from fusion_sfdia.detectors import BatchDetector, CentralFilter, Decision, State, TimeStep
from fusion_sfdia.detectors.detector import ProcessHypothesis
from fusion_sfdia.detectors.state import leaves
from fusion_sfdia.plant.uncertainty import Parameter, Uncertainty

CHAIN = chain(3)
LOW_STATES = tuple(replace(state, low=-0.5, high=0.5) for state in CHAIN.states)


def mixed(t: float, x: Array, u: Array, dt: float) -> Array:
    """Moves each state by the mean of all runs."""
    return 0.9 * x + 0.1 * x.mean(axis=tuple(range(x.ndim - 1)), keepdims=True)


def writing(t: float, x: Array, u: Array, dt: float) -> Array:
    x[..., 0] += 1.0
    return 0.9 * x


def wrong_jacobian(t: float, x: Array, u: Array, dt: float) -> Array:
    return np.broadcast_to(-0.95 * np.eye(3) - 0.03 * np.eye(3, k=1), (*x.shape[:-1], 3, 3))


def shifted(t: float, x: Array, u: Array, dt: float, theta: Array) -> Array:
    """The step of CHAIN at theta = 1."""
    return np.asarray(CHAIN.step(t, x, u, dt) + theta - 1.0)


def wrong_at_other(t: float, x: Array, u: Array, dt: float, theta: Array) -> Array:
    return np.broadcast_to(np.ones((3, 4)), (*x.shape[:-1], 3, 4))


@pytest.mark.parametrize(
    ("plant", "message"),
    [
        (changed(CHAIN, step=mixed), "step of plant 'chain': states .* give other numbers"),
        (changed(CHAIN, step=writing), "step of plant 'chain'"),
        (changed(CHAIN, step_jacobian=wrong_jacobian), "step_jacobian of plant 'chain' is not the derivative of step"),
        (changed(CHAIN, output=lambda t, x, u: x), "plant 'chain' cannot be pickled .* no closures or lambdas"),
        (replace(CHAIN, x0=np.ones(3), states=LOW_STATES), "x0 of plant 'chain' is outside"),
        (replace(CHAIN, uncertainty=Uncertainty((Parameter("a"),), shifted)), "at the nominal parameters is not the plant's"),
        (
            replace(CHAIN, uncertainty=Uncertainty((Parameter("a", nominal=1.0),), shifted, step_jacobian=wrong_at_other)),
            "step_jacobian of plant 'chain augmented' is not the derivative of step",
        ),
    ],
)  # fmt: skip
def test_a_plant_that_breaks_the_contract_fails(plant: Plant, message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        check_plant(plant)


def test_a_plant_that_keeps_it_passes() -> None:
    check_plant(CHAIN)
    check_plant("two-tanks")


@dataclass(frozen=True)
class Broken(CentralFilter):
    """A filter that breaks the contract in one way."""

    way: str = ""

    def step(self, state: State, t: float, y: Array, u: Array) -> tuple[State, Decision]:
        given = state
        if self.way == "takes anything":
            y = np.where(np.isinf(y), np.nan, y)
            y = y if y.shape == (*state.diverged.shape, 3) else np.resize(y, (*state.diverged.shape, 3))
        state, decision = super().step(state, t, y, u)
        changes: dict[str, Any] = {
            "lists": {"isolated": decision.isolated.astype(float)},
            "nameless": {"fault_size": np.zeros_like(decision.fault_size)},
            "silent": {"absurd": np.zeros_like(decision.absurd)},
            "random": {"residual": decision.residual + np.random.default_rng().standard_normal(decision.residual.shape)},
        }.get(self.way, {})
        if self.way == "overwrites":
            leaves(given.memory)[0][...] = 7.0
        return state, replace(decision, **changes)


@pytest.mark.parametrize(
    ("way", "message"),
    [
        ("lists", "isolated is of its type"),
        ("nameless", "a fault has a size where it is isolated"),
        ("silent", "absurd readings are reported"),
        ("random", "a second run with the same seed: residual"),
        ("overwrites", "step writes into the state that it is given"),
        ("takes anything", "expected: ValueError for readings"),
    ],
)
def test_a_detector_that_breaks_the_contract_fails(way: str, message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        check_detector(partial(Broken, way=way), CHAIN)


class Unlike(NamedTuple):
    x: Array


@dataclass(frozen=True)
class Fixed(BatchDetector):
    """Fixed limits about x0, with a mistake in its thresholds or its memory."""

    way: str = ""

    def _start(self, batch: tuple[int, ...], seed: int) -> Any:
        if self.way == "list":
            return [np.zeros(batch)]
        if self.way == "number":
            return Unlike(0.0)  # type: ignore[arg-type]  # the mistake
        return Unlike(np.zeros(3 if self.way == "no batch" else (*batch, 3)))

    def _judge(self, memory: Any, now: TimeStep, y: Array, u: Array) -> tuple[Any, Decision]:
        runs, scale = y.shape[:-1], 1.0 if self.way == "constant" else self.threshold_scale
        none = np.zeros(runs, bool)
        return memory, Decision(
            estimate=np.zeros((*runs, 3)), reconstruction=np.nan_to_num(y), residual=y,
            threshold=np.full(y.shape, 50.0 * scale), isolated=np.zeros(y.shape, bool), fault_size=np.full(y.shape, np.nan),
            diverged=none, guarded=none, nis=np.full(runs, np.nan),
        )  # fmt: skip


@pytest.mark.parametrize(
    ("way", "message"),
    [
        ("constant", "the thresholds do not scale with threshold_scale: 50 at 1, 50 at 2; multiply all thresholds by"),
        ("list", "expected: the memory of a detector is a NamedTuple of arrays of numbers; found <class 'list'>"),
        ("number", "a NamedTuple of arrays of numbers, .*found memory.x = 0.0"),
        ("no batch", r"_start gives for a batch \(2,\) has x with the batch as its first axes; found \(3,\)"),
    ],
)
def test_a_mistake_is_stated_with_its_cure(way: str, message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        check_detector(partial(Fixed, way=way), CHAIN)


def test_fixed_limits_without_a_mistake_pass() -> None:
    check_detector(Fixed, CHAIN)


@dataclass(frozen=True)
class BrokenVerdicts(ProcessBank):
    """A bank that tests the process, too, and breaks the contract in one way."""

    way: str = ""

    @property
    def process_hypotheses(self) -> tuple[ProcessHypothesis, ...]:
        first, second = super().process_hypotheses
        if self.way == "one name":
            return first, second._replace(name=self.plant.sensor_names[0])
        return first, second._replace(kind="leak") if self.way == "kind" else second

    def step(self, state: State, t: float, y: Array, u: Array) -> tuple[State, Decision]:
        state, decision = super().step(state, t, y, u)
        process, probability = decision.process, decision.probability
        assert process is not None and probability is not None
        changes: dict[str, Any] = {
            "silent": {"process": None},
            "one sensor": {"suspect": decision.isolated},
            "sized": {"process_size": np.zeros(process.shape)},
            "no spread": {"process_sd": np.full(process.shape, np.nan)},
            "negative": {"process_sd": np.where(process, -1.0, np.nan)},
            "percent": {"probability": 100 * probability},
            "too likely": {"probability": np.ones_like(probability)},
        }.get(self.way, {})
        return state, replace(decision, **changes)


@pytest.mark.parametrize(
    ("way", "message"),
    [
        ("one name", "names of all hypotheses differ"),
        ("kind", "a ProcessHypothesis of a kind of"),
        ("silent", r"process has the shape \(2,\)"),
        ("one sensor", r"suspect has the shape \(6,\)"),
        ("sized", "process_size is NaN just where nothing is accepted"),
        ("no spread", "process_sd is NaN just where nothing is accepted"),
        ("negative", "standard deviations are finite and not negative"),
        ("percent", "probabilities are from 0 to 1"),
        ("too likely", "probabilities of hypotheses add up to at most 1"),
    ],
)
def test_verdicts_on_the_process_that_break_the_contract_fail(way: str, message: str) -> None:
    with pytest.raises(AssertionError, match=message):
        check_detector(partial(BrokenVerdicts, way=way))


def test_a_detector_that_tests_the_process_passes() -> None:
    check_detector(partial(ProcessBank, doubt=(2, 9), between=(0, 5)))
    assert OUTLET in ProcessBank(tanks()).process_hypotheses


def test_a_detector_that_keeps_it_passes() -> None:
    check_detector("loo-chi2", CHAIN)
    check_detector(Broken, CHAIN)
    check_detector(CentralFilter)
