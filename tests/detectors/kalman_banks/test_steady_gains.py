"""Gains that stand still: the same numbers as of ordinary steps, refreshed by whatever they depend on, from any saved state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rounding import rounding
from scipy.linalg import solve_discrete_are
from toy_plants import chain, readings, tanks

from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.detector import Decision, run
from fusion_sfdia.detectors.exclusion import Exclusion
from fusion_sfdia.detectors.kalman_banks import robust_bank, steady_gains, window_step
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.detectors.kalman_banks.robust_bank import RobustBank
from fusion_sfdia.detectors.kalman_banks.steady_gains import SteadyGains
from fusion_sfdia.detectors.state import State, leaves
from fusion_sfdia.detectors.storage import load_state, save_state
from fusion_sfdia.filters.estimators import Unscented
from fusion_sfdia.plant.linear import linear_plant
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor
from fusion_sfdia.plant.uncertainty import Disturbance, Uncertainty

Array = NDArray[Any]

WINDOW = 6


@pytest.fixture(autouse=True)
def _double(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gains of small plants rest, too, with windows in double precision, so that only what P may differ makes a difference."""
    monkeypatch.setattr(window_step, "NUMBERS", np.float64)
    monkeypatch.setattr(steady_gains, "LARGE", 0)


def random_plant(seed: int) -> Plant:
    """A linear plant of up to 7 states with stable modes, fast and slow, and up to 9 sensors, some of which read the same."""
    rng = np.random.default_rng(seed)
    n, N = int(rng.integers(2, 8)), int(rng.integers(3, 10))
    basis, _ = np.linalg.qr(rng.standard_normal((n, n)))
    H = rng.standard_normal((N, n)) * (rng.random((N, n)) < 0.6)
    H[0] = 1.0
    H[-1] = H[0]
    return linear_plant(
        f"random {seed}",
        basis @ np.diag(rng.uniform(0.3, 0.97, n)) @ basis.T,
        H,
        [Sensor(f"y{i}", "x0", sigma=float(s)) for i, s in enumerate(10.0 ** rng.uniform(-1, 1, N))],
        dt=0.1,
        x0=np.zeros(n),
        initial_cov=np.ones(n),
        process_cov=10.0 ** rng.uniform(-3, 0, n),
    )


def stays_ordinary(monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on all steps are ordinary ones."""
    monkeypatch.setattr(SteadyGains, "judged", lambda self, now, p, dt, at_rest, anew: anew())


def data(plant: Plant, steps: int, runs: int) -> tuple[Array, Array, Array]:
    """Readings with a gap, one that is missing for long, and a fault, each in a run of its own."""
    t, _, y, u = readings(plant, steps, runs, seed=5)
    y = y.copy()
    y[steps // 2, 0] = np.nan
    y[steps // 2 :, 1, 0] = np.nan
    y[steps // 2 :, 2, 1] += 12.0 * plant.sensor_sigma[1]
    return t, y, u


def count_ordinary(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """A number for each ordinary step from now on."""
    seen: list[int] = []
    judged = SteadyGains.judged

    def counted(self: Any, now: Any, p: Any, dt: Any, at_rest: Any, anew: Any) -> Any:
        def noted() -> Any:
            seen.append(1)
            return anew()

        return judged(self, now, p, dt, at_rest, noted)

    monkeypatch.setattr(SteadyGains, "judged", counted)
    return seen


def count_rests(monkeypatch: pytest.MonkeyPatch) -> list[Array]:
    """Which runs of a batch rest, of each step from now on in which any may."""
    seen: list[Array] = []
    judged = SteadyGains.judged

    def counted(self: Any, now: Any, p: Any, dt: Any, at_rest: Any, anew: Any) -> Any:
        def noted(gains: Any) -> Any:
            found = at_rest(gains)
            seen.append(found[0])
            return found

        return judged(self, now, p, dt, noted, anew)

    monkeypatch.setattr(SteadyGains, "judged", counted)
    return seen


def same_decisions(found: Decision, expected: Decision, allowed: float) -> None:
    """Verdicts alike; estimates, in standard deviations, and scores to what is allowed."""
    for name in ("isolated", "process", "suspect"):
        if getattr(expected, name) is not None:
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    assert found.covariance is not None and expected.covariance is not None
    sd = np.sqrt(np.einsum("...ii->...i", expected.covariance))
    off = np.abs(found.covariance - expected.covariance) / sd[..., None] / sd[..., None, :]
    assert off.max() <= 2 * steady_gains.SAME
    assert np.max(np.abs(found.estimate - expected.estimate) / sd) <= allowed
    known = np.isfinite(expected.threshold)
    np.testing.assert_array_equal(np.isfinite(found.threshold), known)
    score, limit = (np.abs(d.residual[known]) / d.threshold[known] for d in (found, expected))
    np.testing.assert_allclose(score, limit, rtol=0, atol=allowed)


PLANTS = [
    *(pytest.param(p, id=p.name) for p in (chain(12), chain(3, sensors=5), *map(random_plant, range(3)))),
    *(pytest.param(p, id=p.name, marks=pytest.mark.long) for p in map(random_plant, range(3, 20))),
]


@pytest.mark.parametrize("plant", PLANTS)
def test_steps_at_rest_give_what_ordinary_steps_give(plant: Plant, monkeypatch: pytest.MonkeyPatch) -> None:
    """P differs by SAME at most of its standard deviations, and so does the prediction, in units of its own."""
    steps, runs, N = 250, 3, len(plant.sensors)
    t, y, u = data(plant, steps, runs)
    bank = LeaveOneOutBank(plant, window=WINDOW)
    with monkeypatch.context() as patch:
        rests = count_rests(patch)
        _, found = run(bank, bank.init((runs,)), t, y, u, covariance=True)
    assert np.sum(rests) > 30
    stays_ordinary(monkeypatch)
    _, expected = run(bank, bank.init((runs,)), t, y, u, covariance=True)
    assert expected.isolated.any() or plant.name.startswith("random")
    same_decisions(found, expected, 2 * steady_gains.SAME * 12.0 * np.sqrt(N) * WINDOW)  # whitened sums, the fault's too


def disturbed() -> Plant:
    """A linear plant with an unknown disturbance: an augmented state, which may jump or drift."""
    off = Disturbance("off", np.array([0.3, 0.0, 0.0]), np.zeros(6), sd=2.0, time_constant=10.0)
    return replace(chain(3, sensors=6), uncertainty=Uncertainty(disturbances=(off,)))


@pytest.mark.parametrize("plant", [chain(5, sensors=9), disturbed()], ids=["chain", "disturbance"])
def test_competing_hypotheses_have_at_rest_what_they_have_in_ordinary_steps(
    plant: Plant, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Biases, ramps, errors of equations, jumps and drifts, with a gap, a missing sensor and a fault after the gains rest."""
    steps, runs, N = 300, 3, len(plant.sensors)
    t, y, u = data(plant, steps, runs)
    bank = RobustBank(plant, memory=32, window=8)
    monkeypatch.setattr(robust_bank, "is_larger", lambda noise: np.zeros(noise.size.shape, bool))
    with monkeypatch.context() as patch:
        rests = count_rests(patch)
        _, found = run(bank, bank.init((runs,)), t, y, u, covariance=True)
    assert np.sum(rests) > 100
    stays_ordinary(monkeypatch)
    _, expected = run(bank, bank.init((runs,)), t, y, u, covariance=True)
    assert expected.isolated.any()
    same_decisions(found, expected, 2 * steady_gains.SAME * 12.0 * np.sqrt(N) * 32)


def rested(bank: LeaveOneOutBank, steps: int = 200, runs: int | None = None) -> tuple[State, float, Array, Array]:
    """A state at rest after healthy readings, with the time, readings and inputs of the next step."""
    t, _, y, u = readings(bank.plant, steps + 1, runs or 1, seed=6)
    of = 0 if runs is None else slice(None)
    state, _ = run(bank, bank.init(() if runs is None else (runs,)), t[:-1], y[:-1, of], u[:-1, of])
    assert np.all(state.memory.steady.rests)
    return state, float(t[-1]), y[-1, of], u[-1, of]


def equal(a: Any, b: Any) -> bool:
    """Whether two states or decisions have the same bits."""
    return all(np.array_equal(v, w, equal_nan=True) for v, w in zip(leaves(a), leaves(b), strict=True))


def with_transition(plant: Plant, change: float) -> Plant:
    """A chain whose first state moves otherwise."""
    F = np.array(plant.step_jacobian_at(0.0, plant.x0, np.zeros(0), plant.dt))
    F[0, 0] += change
    of = plant
    return linear_plant(
        of.name, F, of.output_jacobian_at(0.0, of.x0, np.zeros(0)), of.sensors, dt=of.dt, x0=of.x0,
        initial_cov=of.initial_cov, process_cov=of.process_cov,
    )  # fmt: skip


def with_readout(plant: Plant) -> Plant:
    """A chain whose first sensor reads more."""
    H = np.array(plant.output_jacobian_at(0.0, plant.x0, np.zeros(0)))
    H[0, 0] = 1.1
    of = plant
    return linear_plant(
        of.name, of.step_jacobian_at(0.0, of.x0, np.zeros(0), of.dt), H, of.sensors, dt=of.dt, x0=of.x0,
        initial_cov=of.initial_cov, process_cov=of.process_cov,
    )  # fmt: skip


def louder(plant: Plant) -> Plant:
    sensors = (replace(plant.sensors[0], sigma=2.0), *plant.sensors[1:])
    return replace(plant, sensors=sensors)


def any_dt(plant: Plant) -> Plant:
    return replace(plant, numerics=replace(plant.numerics, fixed_dt=False))


def excluding(state: State) -> State:
    """The state in which the first sensor is left out."""
    out = np.array(state.memory.exclusion.out)
    out[..., 0] = True
    changed: Exclusion = state.memory.exclusion._replace(out=out)
    return state._replace(memory=state.memory._replace(exclusion=changed))


def missing(y: Array) -> Array:
    return np.where(np.arange(y.shape[-1]) == 2, np.nan, y)


Change = Callable[[Any], Any]
CHANGES: dict[str, tuple[str, Change]] = {
    "Jacobian": ("plant", lambda p: with_transition(p, -1e-4)),
    "readout": ("plant", with_readout),
    "reading noise": ("plant", louder),
    "process noise": ("plant", lambda p: replace(p, process_cov=1.5 * p.process_cov)),
    "missing reading": ("y", missing),
    "exclusion": ("state", excluding),
    "dt": ("t", lambda t: t + 0.5),
}


@pytest.mark.parametrize("what", CHANGES)
def test_any_change_of_what_gains_are_made_from_refreshes_them(what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The next step is then an ordinary one, to the bit; without a change it is none."""
    bank = LeaveOneOutBank(any_dt(chain(5)), window=WINDOW)
    state, t, y, u = rested(bank)
    ordinary = count_ordinary(monkeypatch)
    bank.step(state, t, y, u)
    assert not ordinary
    given: dict[str, Any] = {"plant": bank.plant, "state": state, "t": t, "y": y}
    where, change = CHANGES[what]
    given[where] = change(given[where])
    changed = replace(bank, plant=given["plant"])
    after, found = changed.step(given["state"], given["t"], given["y"], u)
    assert len(ordinary) == 1 and after.memory.steady.since == 0
    stays_ordinary(monkeypatch)
    again, expected = changed.step(given["state"], given["t"], given["y"], u)
    assert equal(after, again)
    np.testing.assert_array_equal(found.residual, expected.residual)


def test_an_alarm_at_rest_is_that_of_an_ordinary_step(monkeypatch: pytest.MonkeyPatch) -> None:
    bank = LeaveOneOutBank(chain(5), window=WINDOW)
    state, t, y, u = rested(bank)
    y = y + np.array([0.0, 15.0, 0.0, 0.0, 0.0])
    after, found = bank.step(state, t, y, u)
    assert found.isolated.tolist() == [False, True, False, False, False]
    stays_ordinary(monkeypatch)
    assert equal(after, bank.step(state, t, y, u)[0])


@pytest.mark.parametrize("estimator", [None, Unscented()], ids=["extended", "unscented"])
def test_a_run_of_a_batch_has_what_it_has_alone(estimator: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """While others rest or not; to the rounding of the plant's own products, which differs with the number of runs."""
    runs, steps = 3, 220
    plant = chain(6, sensors=9)
    t, y, u = data(plant, steps, runs)
    bank = LeaveOneOutBank(plant, window=WINDOW, **({} if estimator is None else {"estimator": estimator}))
    rests = count_rests(monkeypatch)
    together, found = run(bank, bank.init((runs,)), t, y, u)
    assert any(r.any() and not r.all() for r in rests) and any(r.all() for r in rests)
    allowed = rounding(100.0, 100 * steps)
    for r in range(runs):
        alone, own = run(bank, bank.init(), t, y[:, r], u[:, r])
        np.testing.assert_array_equal(found.isolated[:, r], own.isolated)
        for field in ("estimate", "residual", "threshold", "nis"):
            np.testing.assert_allclose(getattr(found, field)[:, r], getattr(own, field), rtol=0, atol=allowed)
        assert together.memory.steady.rests[r] == alone.memory.steady.rests


@pytest.mark.parametrize("saved", [20, 60, 99])
def test_a_saved_state_goes_on_with_the_same_bits(saved: int, tmp_path: Path) -> None:
    """From before the gains stand still, and from rest; they stand from about the 50th sample on."""
    plant = chain(5)
    t, _, y, u = readings(plant, 150, 1, seed=7)
    bank = LeaveOneOutBank(plant, window=WINDOW)
    state = bank.init()
    decisions: list[Decision] = []
    resumed: State | None = None
    for k in range(len(t)):
        if k == saved:
            save_state(tmp_path / "state.npz", bank, state)
            resumed = load_state(tmp_path / "state.npz", bank)
        state, decision = bank.step(state, float(t[k]), y[k, 0], u[k, 0])
        if resumed is not None:
            resumed, again = bank.step(resumed, float(t[k]), y[k, 0], u[k, 0])
            decisions.append(again)
            assert np.array_equal(again.residual, decision.residual) and np.array_equal(again.estimate, decision.estimate)
    assert resumed is not None and equal(state, resumed) and state.memory.steady.rests


def test_a_slow_mode_does_not_stand_still_before_it_has_converged() -> None:
    """A fast mode hides a slow one at first: P at rest is nevertheless that of the algebraic Riccati equation."""
    F, q = np.diag([0.5, 0.99]), np.array([1.0, 1e-4])
    plant = linear_plant(
        "slow", F, np.array([[1.0, 0.0], [0.3, 1.0], [0.0, 1.0]]), [Sensor(f"y{i}", "x0", sigma=1.0) for i in range(3)],
        dt=1.0, x0=np.zeros(2), initial_cov=np.ones(2), process_cov=q,
    )  # fmt: skip
    bank = LeaveOneOutBank(plant, window=WINDOW)
    t, _, y, u = readings(plant, 1500, 1, seed=8)
    state = bank.init()
    for k in range(len(t)):
        state, _ = bank.step(state, float(t[k]), y[k, 0], u[k, 0])
        if state.memory.steady.rests:
            break
    assert 100 < k < len(t) - 1
    H = plant.output_jacobian_at(0.0, plant.x0, u[0, 0])
    prior = solve_discrete_are(F.T, H.T, np.diag(q), np.eye(3))
    P = prior - prior @ H.T @ np.linalg.solve(H @ prior @ H.T + np.eye(3), H @ prior)
    sd = np.sqrt(np.diag(P))
    assert np.max(np.abs(state.memory.estimate.P - P) / sd[:, None] / sd) <= steady_gains.SAME


@pytest.mark.parametrize("steps", [(0,), (0, 1), tuple(range(15)), (0, 1, 3, 7, 15), (0, 2, 5, 12, 30, 100)], ids=str)
def test_sums_over_powers_of_the_transition_are_those_of_their_definition(steps: tuple[int, ...]) -> None:
    """s_j = sum_(i < j) v A^i and t_j = s_1 + .. + s_j."""
    rng = np.random.default_rng(9)
    n = 4
    A, v = 0.4 * rng.standard_normal((n, n)), rng.standard_normal((2, n))
    powers = np.array([np.linalg.matrix_power(A, 2**m) for m in range(max(steps).bit_length())]).reshape(-1, n, n)
    s, t = np.moveaxis(steady_gains.sums(v, powers, np.array(steps), True), 1, 0)
    np.testing.assert_array_equal(steady_gains.sums(v, powers, np.array(steps), False)[:, 0], s)
    of = np.cumsum([v @ np.linalg.matrix_power(A, i) for i in range(100)], axis=0)
    for at, j in enumerate(steps):
        expected = of[j - 1] if j else np.zeros((2, n))
        size = np.abs(of).max() * (j + 1)
        np.testing.assert_allclose(s[at], expected, rtol=0, atol=rounding(size, 200 * n))
        np.testing.assert_allclose(t[at], of[:j].sum(axis=0), rtol=0, atol=rounding(size, 200 * n))


def test_small_and_nonlinear_plants_keep_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """All their steps are ordinary: their Jacobians change with each estimate, or a step takes no longer than its calls."""
    assert LeaveOneOutBank(tanks()).init().memory.steady == ()
    linear: Any = registry.detector("loo-glr", registry.plant("power-network"))
    monkeypatch.setattr(steady_gains, "LARGE", 128)
    assert linear.init().memory.steady and LeaveOneOutBank(chain(12)).init().memory.steady == ()


def test_a_model_that_depends_on_its_step_rests_where_times_are_seconds_since_1970(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their differences are 0.1 s to 2e-7 s, and the Jacobian of each is another in its last digits."""
    plant, rate = any_dt(chain(4)), np.array([1.0, 0.3, 2.0, 0.7])

    def step(t: float, x: Array, u: Array, dt: float) -> Array:
        return x * np.exp(-rate * dt)

    numerics = replace(plant.numerics, step_jacobian=lambda t, x, u, dt: np.diag(np.exp(-rate * dt)))
    plant = replace(plant, step=step, numerics=numerics, dt=0.1)
    bank = LeaveOneOutBank(plant, window=WINDOW)
    start, steps = 1.7e9, 120
    rests = count_rests(monkeypatch)
    _, found = run(
        bank, bank.init((), start), start + 0.1 * np.arange(1, steps + 1), np.zeros((steps, 4)), np.zeros((steps, 0))
    )
    assert np.sum(rests) > 30
    assert not found.alarm.any()
