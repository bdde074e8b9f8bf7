"""Networks that change between two steps: changed numbers, unchanged bits, restarted copies, and rejected changes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from toy_plants import chain, changed

from fusion_sfdia.detectors.detector import Decision, run
from fusion_sfdia.detectors.state import State, leaves
from fusion_sfdia.detectors.stochastic_thresholds.chebyshev import Chebyshev
from fusion_sfdia.detectors.stochastic_thresholds.replug import replug
from fusion_sfdia.detectors.storage import load_state, save_state
from fusion_sfdia.models.power_network.model import network_model
from fusion_sfdia.models.power_network.operation import Switch
from fusion_sfdia.models.power_network.plant import power_network
from fusion_sfdia.models.power_network.simulation import run_network
from fusion_sfdia.plant.plant import Array, Plant, Structure, Truth

RUNS, STEPS, AT = 10, 40, 20


@cache
def plant(*unplugged: str) -> Plant:
    return power_network(loads=(), unplugged=unplugged)


@cache
def closed_loop(before: tuple[str, ...], switch: Switch) -> tuple[Array, Array, Array]:
    """t (K,), y (K, B, N), u (K, B, m) of a network that switches after the readings of time AT."""
    model = network_model(unplugged=before)
    moments = list(run_network(model, STEPS, range(RUNS), loads=lambda t: np.zeros(15), switches=[switch]))[1:]
    return np.array([m.t for m in moments]), np.stack([m.y for m in moments]), np.stack([m.u for m in moments])


def until(detector: Chebyshev, data: tuple[Array, Array, Array]) -> State:
    t, y, u = data
    return run(detector, detector.init((RUNS,)), t[:AT], y[:AT], u[:AT])[0]


def after(detector: Chebyshev, state: State, data: tuple[Array, Array, Array]) -> tuple[State, Decision]:
    t, y, u = data
    return run(detector, state, t[AT:], y[AT:], u[AT:])


UNPLUG = ((), Switch(AT, unplug=("4",)), ("4",), {"3", "4", "5", "13"})
PLUG_IN = (("15",), Switch(AT, plug_in=("15",)), (), {"14", "15"})


@pytest.mark.parametrize(("before", "switch", "unplugged", "touched"), [UNPLUG, PLUG_IN], ids=["4 leaves", "15 joins"])
@pytest.mark.parametrize("mode", ["corrected", "paper"])
def test_only_the_neighbours_change(
    before: tuple[str, ...], switch: Switch, unplugged: tuple[str, ...], touched: set[str], mode: str
) -> None:
    data, detector = closed_loop(before, switch), Chebyshev(plant(*before), mode=mode, alpha=8.0)
    state = until(detector, data)
    kept = [a.copy() for a in leaves(state)]
    changed, moved = replug(detector, state, plant(*unplugged))
    for a, b in zip(leaves(state), kept, strict=True):
        np.testing.assert_array_equal(a, b)
    t, y, u = (a[AT] for a in data)
    (_, old), (_, new) = detector.step(state, float(t), y, u), changed.step(moved, float(t), y, u)
    theirs = np.array([s.measures.split("_")[-1] in touched for s in detector.plant.sensors])  # their states, wherever shared
    for name in ("residual", "threshold"):
        a, b = getattr(old, name), getattr(new, name)
        np.testing.assert_array_equal(a[:, ~theirs], b[:, ~theirs], err_msg=name)
        own = np.array([s.owner.split()[-1] in touched and s.name.startswith("omega") for s in detector.plant.sensors])
        assert np.all(a[:, own] != b[:, own]), name


@pytest.mark.parametrize(("before", "switch", "unplugged", "touched"), [UNPLUG, PLUG_IN], ids=["4 leaves", "15 joins"])
def test_a_replugged_detector_continues_without_alarms(
    before: tuple[str, ...], switch: Switch, unplugged: tuple[str, ...], touched: set[str]
) -> None:
    data, detector = closed_loop(before, switch), Chebyshev(plant(*before), alpha=8.0)
    changed, state = replug(detector, until(detector, data), plant(*unplugged))
    _, d = after(changed, state, data)
    assert not d.alarm.any() and not d.diverged.any()
    open_now = np.isnan(data[1][-1, 0])
    assert np.all(np.isinf(d.threshold[:, :, open_now])) and np.all(np.isfinite(d.threshold[:, :, ~open_now]))
    assert np.all(np.isfinite(d.estimate)) and np.all(np.isfinite(d.reconstruction))
    # the memory of the old network fades as 0.3^k, and then there is no difference to a detector that was always so
    fresh = Chebyshev(plant(*unplugged), alpha=8.0)
    _, always = after(fresh, until(fresh, (data[0], np.where(open_now, np.nan, data[1]), data[2])), data)
    np.testing.assert_allclose(d.residual[-1][:, ~open_now], always.residual[-1][:, ~open_now], atol=1.0 * 0.3**19)
    _, blind = after(detector, until(detector, data), data)
    seen = np.array([s.owner.split()[-1] in touched - {"4", "15"} for s in detector.plant.sensors]) & ~open_now
    assert np.mean(blind.residual[..., seen] ** 2) > np.mean(d.residual[..., seen] ** 2), "without replug the model is wrong"


def test_a_copy_that_joins_starts_from_its_first_reading() -> None:
    before, switch, unplugged, _ = PLUG_IN
    t, y, u = closed_loop(before, switch)
    y = y.copy()
    joins = [plant().sensor_index(n) for n in ("theta_15@14", "theta_14@15")]
    y[AT - 1, :, joins] += 0.5  # far off: its estimate until now has no part in it
    y[AT:, :, joins] += 0.5
    detector = Chebyshev(plant(*before), lam=0.3, alpha=8.0, accommodate=False)
    changed, state = replug(detector, until(detector, (t, y, u)), plant(*unplugged))
    _, d = after(changed, state, (t, y, u))
    assert np.all(np.isfinite(d.threshold[0][:, joins])) and np.all(np.abs(d.residual[0][:, joins]) < 0.5)


def test_an_isolated_sensor_is_reset_with_its_tie() -> None:
    t, y, u = closed_loop((), UNPLUG[1])
    y, i = y.copy(), plant().sensor_index("theta_4@3")
    y[10:AT, :, i] += 0.3
    detector = Chebyshev(plant(), lam=0.0, alpha=8.0)
    state = until(detector, (t, y, u))
    changed, moved = replug(detector, state, plant("4"))
    assert np.all(state.memory.exclusion.out[:, i]) and not np.any(moved.memory.exclusion.out[:, i])
    assert not after(changed, moved, (t, y, u))[1].alarm.any()


def test_unplugging_and_replugging_changes_only_the_ties_that_were_open() -> None:
    data, detector = closed_loop((), UNPLUG[1]), Chebyshev(plant(), alpha=8.0)
    state = until(detector, data)
    again, restored = replug(*replug(detector, state, plant("4")), plant())
    ties = np.array(["4" in (s.measures.split("_")[1], s.owner.split()[1]) and "@" in s.name for s in plant().sensors])
    assert again.diagnoser.areas.matrices.tobytes() == detector.diagnoser.areas.matrices.tobytes()
    np.testing.assert_array_equal(restored.memory.residual[:, ~ties], state.memory.residual[:, ~ties])
    for a, b in zip(restored.memory.diagnoser, state.memory.diagnoser, strict=True):
        if a.ndim == 3:
            np.testing.assert_array_equal(a, b)


def test_a_state_is_saved_and_loaded_across_a_change(tmp_path: Path) -> None:
    before, switch, unplugged, _ = PLUG_IN
    data, detector = closed_loop(before, switch), Chebyshev(plant(*before), alpha=8.0)
    save_state(tmp_path / "before.npz", detector, until(detector, data))
    changed, state = replug(detector, load_state(tmp_path / "before.npz", detector), plant(*unplugged))
    save_state(tmp_path / "after.npz", changed, state)
    rebuilt = Chebyshev(power_network(loads=()), alpha=8.0)
    _, resumed = after(rebuilt, load_state(tmp_path / "after.npz", rebuilt), data)
    _, went_on = after(changed, state, data)
    with pytest.raises(ValueError, match="another detector, other settings or another plant"):
        load_state(tmp_path / "before.npz", rebuilt)
    np.testing.assert_array_equal(resumed.residual, went_on.residual)
    np.testing.assert_array_equal(resumed.threshold, went_on.threshold)


def test_a_change_that_fails_leaves_all_as_it_was() -> None:
    data, detector = closed_loop((), UNPLUG[1]), Chebyshev(plant(), alpha=8.0)
    state = until(detector, data)
    kept = [a.copy() for a in leaves(state)]
    smaller = power_network(10, loads=())
    count = len(plant().sensors)
    idle = {"step": lambda t, x, u, dt: x, "output": lambda t, x, u: np.repeat(x[..., :1], count, axis=-1), "truth": Truth()}
    other = power_network(15 + 1, loads=())
    for wrong, message in (
        (smaller, "has other states or sensors than"),
        (other, "has other states or sensors than"),
        (replace(plant(), structure=Structure()), "states no areas"),
        (replace(plant(), inputs=plant().inputs[:-1], **idle), "30 inputs, references then loads"),
    ):
        with pytest.raises(ValueError, match=message):
            replug(detector, state, wrong)
    with pytest.raises(ValueError, match="this is no state of Chebyshev"):
        replug(detector, state._replace(memory=state.memory[:-1]), plant("4"))
    for a, b in zip(leaves(state), kept, strict=True):
        np.testing.assert_array_equal(a, b)
    assert np.all(np.isfinite(after(detector, state, data)[1].estimate))


def test_a_single_diagnoser_continues_with_another_model() -> None:
    slow = chain(4)
    numerics = replace(slow.numerics, step_jacobian=lambda t, x, u, dt: 0.5 * np.eye(4))
    fast = replace(slow, step=lambda t, x, u, dt: 0.5 * x, numerics=numerics)
    detector = Chebyshev(slow)
    state, _ = detector.step(detector.init(), 1.0, np.ones(4), np.zeros(0))
    changed, moved = replug(detector, state, fast)
    _, d = changed.step(moved, 2.0, np.zeros(4), np.zeros(0))
    _, other = detector.step(state, 2.0, np.zeros(4), np.zeros(0))
    assert np.all(np.abs(d.residual) < np.abs(other.residual))


def test_an_area_that_reads_only_its_angle_leaves_and_returns() -> None:
    """Its estimates begin anew: no false alarm beyond Chebyshev's rate, and thresholds as without the change 20 steps later."""
    gone = ("omega_4", "p_m_4", "p_v_4")
    keep = [i for i, s in enumerate(plant().sensors) if s.name not in gone]
    whole, without = (
        changed(p, sensors=tuple(p.sensors[i] for i in keep), output=partial(_kept, p, keep), output_jacobian=None)
        for p in (plant(), plant("4"))
    )
    model = network_model()
    switches = [Switch(20.0, unplug=("4",)), Switch(40.0, plug_in=("4",))]
    moments = list(run_network(model, 70, range(RUNS), loads=lambda t: np.zeros(15), switches=switches))[1:]
    t, y, u = np.array([m.t for m in moments]), np.stack([m.y for m in moments])[..., keep], np.stack([m.u for m in moments])
    detector = Chebyshev(whole, alpha=5.0, accommodate=False)
    state, first = run(detector, detector.init((RUNS,)), t[:20], y[:20], u[:20])
    alone, state = replug(detector, state, without)
    state, _ = run(alone, state, t[20:40], y[20:40], u[20:40])
    back, state = replug(alone, state, whole)
    _, last = run(back, state, t[40:], y[40:], u[40:])
    beyond = np.abs(last.residual) > last.threshold
    assert np.mean(beyond[np.isfinite(last.residual)]) < 1 / 25
    np.testing.assert_allclose(last.threshold[-1], first.threshold[-1], rtol=1e-3)


def _kept(plant: Plant, keep: list[int], t: float, x: Array, u: Array) -> Array:
    return plant.output(t, x, u)[..., keep]
