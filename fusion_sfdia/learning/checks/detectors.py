"""Checks that every detector passes. Tests of another package call them for its own detectors:

def test_my_detector() -> None:
    check_detector(MyDetector)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import shown
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.batch_detector import BatchDetector
from fusion_sfdia.detectors.detector import Decision, Detector, ProcessHypothesis, run
from fusion_sfdia.detectors.state import State, leaves, mapped, names
from fusion_sfdia.detectors.storage import load_state, save_state
from fusion_sfdia.diagnosis.changes import OF_PROCESS
from fusion_sfdia.learning.checks.readings import (
    Healthy,
    a_silent_sensor_is_used_again,
    absurd_values_are_replaced,
    healthy_readings,
    missing_readings_are_no_evidence,
    what_does_not_fit_is_refused,
)
from fusion_sfdia.learning.checks.require import (
    pickled,
    require,
    require_refused,
    require_same,
    require_same_end,
    require_same_state,
    scaled,
)
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

FLAGS = {"isolated", "diverged", "guarded", "capped", "absurd", "absurd_input", "process", "suspect"}
KINDS = ("parameter", "input", "state", "disturbance", "unnamed", "together", "outside", "since start", "recorder", "still")


def check_detector(detector: Any, plant: Any = "two-tanks") -> None:
    """Run DETECTOR_CHECKS on a detector and a plant; `compare` relies on them.

    How often it alarms and what it isolates is not checked: `compare` measures that.

    Parameters
    ----------
    detector : str, class or callable
        As in `registry.find_detector`.
    plant : Plant or str, default "two-tanks"
        As in `registry.find_plant`.

    Raises
    ------
    AssertionError, ValueError
        With the reason.
    NotApplicableError
        For a plant that lacks what the method needs.

    Examples
    --------
    >>> from fusion_sfdia import check_detector
    >>> check_detector("kf-chi2")  # silent where the contract is kept
    """
    of = registry.plant(plant)
    built = registry.detector(detector, of)
    healthy = healthy_readings(of)
    for check in DETECTOR_CHECKS:
        check(built, healthy)


def shapes_and_types(detector: Detector, healthy: Healthy) -> None:
    """The state is a tuple of arrays; a Decision has the shapes of its docstring, of a batch and of a single run."""
    plant, hypotheses = detector.plant, detector.hypotheses
    n, count = len(plant.states), len(plant.sensors)
    require(hypotheses[:count] == plant.sensor_names, "its hypotheses begin with the plant's sensors", hypotheses)
    require(len(set(hypotheses)) == len(hypotheses), "its hypotheses differ", hypotheses)
    more = len(detector.process_hypotheses)
    shapes = {
        **dict.fromkeys(OF_PROCESS, (more,)), "suspect": (len(hypotheses) + more,), "probability": (len(hypotheses) + more,),
        "estimate": (n,), "residual": (count,), "threshold": (count,), "isolated": (len(hypotheses),),
        "fault_size": (len(hypotheses),), "absurd": (count,), "absurd_input": (len(plant.inputs),),
        "diverged": (), "guarded": (), "nis": (), "capped": (),
    }  # fmt: skip
    t, y, u = healthy(3, 2)
    _require_state(detector, (2,), detector.init((2,)))  # first: the memory of one run is taken from a batch of one
    for batch in ((), (2,)):
        state = detector.init(batch)
        _require_state(detector, batch, state)
        for k in range(3):
            state, d = detector.step(state, float(t[k]), y[k] if batch else y[k, 0], u[k] if batch else u[k, 0])
        for f in fields(Decision):
            expected = (n, n) if f.name == "covariance" else shapes.get(f.name, (count,))
            if getattr(d, f.name) is None and (f.name in ("covariance", "shown_by") or (f.name in OF_PROCESS and not more)):
                continue
            value = np.asarray(getattr(d, f.name))
            require(value.shape == (*batch, *expected), f"{f.name} has the shape {(*batch, *expected)}", value.shape)
            kind = bool if f.name in FLAGS else int if f.name == "shown_by" else float
            require(value.dtype == kind, f"{f.name} is of its type", value.dtype)
        require(np.all(d.threshold > 0), "thresholds are positive", d.threshold)
        require(np.all(np.isfinite(d.estimate)), "the estimate is finite", d.estimate)
        assert_array_equal(np.isnan(d.fault_size), ~d.isolated, "a fault has a size where it is isolated, and NaN elsewhere")


def _require_state(detector: Detector, batch: tuple[int, ...], state: Any) -> None:
    """Raise AssertionError unless init(batch) gave a State whose memory is a tuple of arrays (*batch, ...)."""
    require(isinstance(state, State), "init gives a State", type(state))
    memory = "the memory of a detector is a NamedTuple of arrays of numbers"
    require(isinstance(state.memory, tuple), memory, type(state.memory))
    for name, a in zip(names(state), leaves(state), strict=True):
        if not isinstance(a, np.ndarray) or a.dtype == object:
            raise AssertionError(f"expected: {memory}, and so is its State; found {name} = {shown(a)}")
    require(state.diverged.shape == batch, f"diverged has the shape {batch} after init({batch})", state.diverged.shape)
    for name, a, one in zip(names(state.memory), leaves(state.memory), leaves(detector.init((1,)).memory), strict=True):
        require(
            one.shape[:1] == (1,) and a.shape == (*batch, *one.shape[1:]),
            f"the memory that _start gives for a batch {batch} has {name} with the batch as its first axes",
            a.shape,
        )


def claims_are_of_their_kind(detector: Detector, healthy: Healthy) -> None:
    """What it states of itself, see `Claims`: rates, how many sensors it isolates at once and why no more, a run at once."""
    count = len(detector.plant.sensors)
    require(detector.most_faults >= 1, "most_faults is at least one sensor", detector.most_faults)
    require(isinstance(detector.why_no_more(), str), "why_no_more says so in words", detector.why_no_more())
    require(
        detector.filter_model is None or isinstance(detector.filter_model, Plant), "filter_model is a Plant or None", "else"
    )
    for name, rate in (("false_alarm", detector.false_alarm), ("fitted_rate", detector.fitted_rate)):
        require(rate is None or 0 < rate < 1, f"{name} is a rate per step, or None", rate)
    rate = detector.claimed_rate
    require(np.isnan(rate) or 0 <= rate < 1, "claimed_rate is a rate per step, NaN where nothing is claimed", rate)
    quiet = detector.watching()
    require(isinstance(quiet, Detector) and quiet.plant is detector.plant, "watching gives a detector of the plant", quiet)
    t, y, u = healthy(10, 1)
    _, stepped = run(detector, detector.init(), t, y[:, 0], u[:, 0])
    require(np.all(np.sum(stepped.isolated[:, :count], axis=-1) <= detector.most_faults), "most_faults holds", stepped.isolated)
    if (at_once := detector.steps(detector.init(), t, y[:, 0], u[:, 0])) is not None:
        require_same(replace(at_once[1], covariance=None), replace(stepped, covariance=None), "steps, a run at once")


def the_same_seed_gives_the_same_bits(detector: Detector, healthy: Healthy) -> None:
    """Two runs from one state agree to the bit, and leave the given state unchanged."""
    t, y, u = healthy(8, 2)
    first = detector.init((2,), seed=11)
    before = mapped(np.array, first)
    end, decisions = run(detector, first, t, y, u)
    require_same_state(first, before, "step writes into the state that it is given")
    again, repeated = run(detector, detector.init((2,), seed=11), t, y, u)
    require_same(decisions, repeated, "a second run with the same seed")
    require_same_state(end, again, "the state after a second run with the same seed")


def a_single_run_is_a_batch_of_one(detector: Detector, healthy: Healthy) -> None:
    """Step by step, as a run, and as a batch of one run: the same bits, with a faulty and a missing reading."""
    t, y, u = healthy(10, 1)
    y = y.copy()
    y[6:, 0, 0] += 30 * detector.plant.sensor_sigma[0]
    y[8, 0, 1 % y.shape[-1]] = np.nan
    batch, batch_of_one = run(detector, detector.init((1,)), t, y, u, covariance=True)
    _, whole = run(detector, detector.init(), t, y[:, 0], u[:, 0], covariance=True)
    state = detector.init()
    for k in range(len(t)):
        state, d = detector.step(state, float(t[k]), y[k, 0], u[k, 0])
        for f in fields(Decision):
            if (value := getattr(d, f.name)) is not None:
                assert_array_equal(getattr(whole, f.name)[k], value, f"{f.name}: step and run differ")
                assert_array_equal(getattr(batch_of_one, f.name)[k, 0], value, f"{f.name}: single run and batch of one differ")
    for alone, one in zip(leaves(state), leaves(batch), strict=True):
        assert_array_equal(np.ravel(alone), np.ravel(one), "the states of a single run and of a batch of one differ")


def an_input_may_be_shared_by_the_batch(detector: Detector, healthy: Healthy) -> None:
    """One row of inputs for all runs gives the bits of the same row for each."""
    t, y, u = healthy(5, 3)
    _, shared = run(detector, detector.init((3,)), t, y, u[:, 0])
    _, each = run(detector, detector.init((3,)), t, y, np.repeat(u[:, :1], 3, axis=1))
    require_same(shared, each, "an input that is shared by the batch")


def thresholds_scale(detector: Detector, healthy: Healthy) -> None:
    """A setting threshold_scale multiplies all thresholds and is positive."""
    t, y, u = healthy(5, 2)
    twice = scaled(detector, 2.0)
    _, a = run(detector, detector.init((2,)), t, y, u)
    _, b = run(twice, twice.init((2,)), t, y, u)
    quiet = ~np.any(a.alarm, axis=0)  # a sensor left out after an alarm changes the following numbers
    one, two = a.threshold[:, quiet], b.threshold[:, quiet]
    # some roundings; a detector that reports the larger of two residuals may report the other at a tie
    wrong = ~np.isclose(two, 2 * one, rtol=1e-12, atol=0.0, equal_nan=True)
    if wrong.any():
        raise AssertionError(
            f"the thresholds do not scale with threshold_scale: {one[wrong][0]:g} at 1, {two[wrong][0]:g} at 2; multiply all "
            "thresholds by threshold_scale"
        )
    require_refused("threshold_scale of 0", scaled, detector, 0.0)


def a_state_knows_no_threshold_until_the_first_alarm(detector: Detector, healthy: Healthy) -> None:
    """The states of runs without an alarm do not depend on the thresholds, so that these may be set after a run."""
    runs = 6
    t, y, u = healthy(30, runs)

    def end(scale: float) -> tuple[list[Array], Array]:
        other = scaled(detector, scale)
        state, decisions = run(other, other.init((runs,)), t, y, u)
        return leaves((state.diverged, state.memory)), np.asarray(decisions.alarm.any(axis=0))

    beyond_reach, alarmed = end(1e6)
    require(not alarmed.any(), "no run alarms at a threshold_scale of 1e6", alarmed)
    for scale in (1e7, 1.0):
        state, alarmed = end(scale)
        for one, other in zip(state, beyond_reach, strict=True):
            assert_array_equal(one[~alarmed], other[~alarmed], f"a state at threshold_scale {scale:g} without an alarm")


def a_saved_state_continues_with_the_same_bits(detector: Detector, healthy: Healthy) -> None:
    """save_state and load_state in the middle of a run, with a sensor left out, of a batch and of a single run."""
    t, y, u = healthy(14, 2)
    y = y.copy()
    second = 1 % y.shape[-1]
    y[6:, 0, second] += 30 * detector.plant.sensor_sigma[second]  # saved with a sensor left out
    y[7, :, 0] = np.nan
    for batch in ((), (2,)):
        ys, us = (y, u) if batch else (y[:, 0], u[:, 0])
        middle, _ = run(detector, detector.init(batch, seed=5), t[:8], ys[:8], us[:8])
        with TemporaryDirectory() as folder:
            save_state(Path(folder) / "state.npz", detector, middle)
            loaded = load_state(Path(folder) / "state.npz", detector)
        require_same_state(loaded, middle, "a state that is loaded")
        require_same_end(detector, middle, detector, loaded, (t[8:], ys[8:], us[8:]), "a loaded state")


def a_pickled_detector_continues_with_the_same_bits(detector: Detector, healthy: Healthy) -> None:
    """A used detector can be pickled for pools of processes, with everything that it has cached."""
    t, y, u = healthy(8, 2)
    middle, _ = run(detector, detector.init((2,), seed=5), t[:4], y[:4], u[:4])
    copy, state = pickled((detector, middle), type(detector).__name__)
    require_same_end(detector, middle, copy, state, (t[4:], y[4:], u[4:]), "a pickled detector")


def a_sensor_is_used_again_on_request(detector: Detector, healthy: Healthy) -> None:
    """A BatchDetector goes on from the state that `readmit` gives, once or twice for the same sensor, without a change of the
    state given; it refuses an unknown sensor.
    """
    if not isinstance(detector, BatchDetector):
        return
    readmit = detector.readmit
    t, y, u = healthy(14, 2)
    y, name = y.copy(), detector.plant.sensor_names[-1]
    y[6:10, :, -1] += 30 * detector.plant.sensor_sigma[-1]
    state, _ = run(detector, detector.init((2,)), t[:10], y[:10], u[:10])
    before = mapped(np.array, state)
    again = readmit(state, name)
    require_same_state(state, before, "readmit writes into the state that it is given")
    require_same_state(readmit(again, [name]), again, "a sensor that is readmitted twice")
    end, decisions = run(detector, again, t[10:], y[10:], u[10:])
    require(np.all(np.isfinite(decisions.estimate)), "the estimate is finite after a readmission", decisions.estimate)
    require(int(end.steps) == len(t), "the steps go on after a readmission", end.steps)
    require_refused("an unknown sensor to readmit", readmit, state, "no such sensor")


def process_verdicts_have_numbers(detector: Detector, healthy: Healthy) -> None:
    """Of a detector with process_hypotheses: they are named apart from each other and from what it isolates; an accepted one
    has a size and a standard deviation unless its kind has none, another none; probabilities of exclusive hypotheses.
    """
    tested = detector.process_hypotheses
    names_of_all = [*detector.hypotheses, *(h.name for h in tested)]
    require(len(set(names_of_all)) == len(names_of_all), "names of all hypotheses differ", names_of_all)
    for h in tested:
        require(isinstance(h, ProcessHypothesis) and h.kind in KINDS, f"a ProcessHypothesis of a kind of {KINDS}", h)
    if not tested:
        return
    t, y, u = healthy(30, 2)
    y = y.copy()
    y[10:, 0, 0] += 30 * detector.plant.sensor_sigma[0]
    y[10:, 1] += 30 * detector.plant.sensor_sigma  # no single sensor explains it
    _, d = run(detector, detector.init((2,)), t, y, u)
    sized = np.asarray(d.process) & np.array([h.has_size for h in tested])
    for what in ("process_size", "process_sd"):
        assert_array_equal(np.isnan(getattr(d, what)), ~sized, f"{what} is NaN just where nothing is accepted")
    sd = np.asarray(d.process_sd)[sized]
    require(np.all((sd >= 0) & np.isfinite(sd)), "standard deviations are finite and not negative", sd)
    probability = np.asarray(d.probability)[~d.diverged]
    require(np.all((probability >= 0) & (probability <= 1)), "probabilities are from 0 to 1", probability)
    total, rounding = np.sum(probability, axis=-1), probability.shape[-1] * np.finfo(float).eps
    require(np.all(total <= 1 + rounding), "probabilities of hypotheses add up to at most 1", np.max(total))
    require(not np.any(np.asarray(d.process)[d.diverged]), "nothing is accepted once the estimate has diverged", d.process)
    require(not np.any(np.asarray(d.suspect)[d.diverged]), "nothing is suspected once the estimate has diverged", d.suspect)


DETECTOR_CHECKS: tuple[Callable[[Detector, Healthy], None], ...] = (
    shapes_and_types,
    claims_are_of_their_kind,
    process_verdicts_have_numbers,
    the_same_seed_gives_the_same_bits,
    a_single_run_is_a_batch_of_one,
    an_input_may_be_shared_by_the_batch,
    thresholds_scale,
    a_state_knows_no_threshold_until_the_first_alarm,
    missing_readings_are_no_evidence,
    absurd_values_are_replaced,
    a_silent_sensor_is_used_again,
    a_saved_state_continues_with_the_same_bits,
    a_pickled_detector_continues_with_the_same_bits,
    what_does_not_fit_is_refused,
    a_sensor_is_used_again_on_request,
)
