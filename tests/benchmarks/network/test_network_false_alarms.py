"""network/false-alarms: noise distributions, groups of components, counts of alarms, and claims."""

from __future__ import annotations

import numpy as np
import pytest

from fusion_sfdia.benchmarks.network.false_alarms import counts, one_shock
from fusion_sfdia.benchmarks.network.support.claims import ALPHAS, CONSECUTIVE, SINGLE, Counted, claim_kept
from fusion_sfdia.benchmarks.network.support.residuals import draw_of, groups, owners
from fusion_sfdia.common.random_streams import stream
from fusion_sfdia.models.power_network.model import network_model
from fusion_sfdia.report.results import Row


@pytest.mark.parametrize("law", ["gaussian", "three-point 2"])
def test_noise_distributions_have_mean_0_and_variance_1(law: str) -> None:
    n = 200_000
    x = draw_of(law)(stream(0, "law"), (n,))
    # standard errors: of the mean 1/sqrt(n), of the variance sqrt((kurtosis - 1)/n) with kurtosis 3 and size^2 = 4
    assert abs(x.mean()) < 4 / np.sqrt(n)
    assert abs(x.var() - 1) < 4 * np.sqrt(3 / n)


def test_student_draws_are_scaled_to_variance_1() -> None:
    x = draw_of("student-t")(stream(0, "law"), (200_000,))
    # the fourth moment is infinite, so quantiles instead: 0.9 of t with 3 degrees of freedom is 1.6377 (tables), over sqrt(3)
    above = np.mean(x > 1.6377 / np.sqrt(3))
    assert abs(above - 0.1) < 4 * np.sqrt(0.1 * 0.9 / x.size)


def test_an_unknown_law_is_refused() -> None:
    with pytest.raises(ValueError, match="unknown law 'cauchy'; known: gaussian, student-t, three-point SIZE"):
        draw_of("cauchy")


def test_each_component_is_in_one_group() -> None:
    model = network_model()
    found = groups(model)
    assert np.all(np.sum(list(found.values()), axis=0) == 1)
    assert {k: int(v.sum()) for k, v in found.items()} == {
        "theta, 2 sharers": 4, "theta, 3 sharers": 21, "theta, 4 sharers": 24, "omega": 15, "p_m": 15, "p_v": 15,
    }  # fmt: skip
    assert list(np.bincount(owners(model))) == [4 + k for k in np.diff(model.network.topology.start)]


def test_consecutive_alarms_are_counted_by_component_and_by_area() -> None:
    z = np.zeros((6, 1, 3))  # two components of area 0, one of area 1
    z[1:4, 0, 0] = 3.0
    z[4, 0, 1] = -6.0
    found = counts(z, np.array([[True, True, False], [False, False, True]]), np.array([0, 0, 1]))
    assert found["consecutive"][0, ALPHAS.index(2.0)].tolist() == [4, 2, 1]
    assert found["chances"][0].tolist() == [18, 15, 12]
    assert found["beyond"][0, :, ALPHAS.index(5.0)].tolist() == [1.0, 0.0]
    assert found["confirmed"][0].tolist() == [True, True]
    z[2, 0, 0] = 0.0
    z[2, 0, 1] = 3.0
    assert counts(z, np.ones((1, 3), bool), np.array([0, 0, 1]))["confirmed"][0].tolist() == [False, True]


def test_a_claim_is_kept_broken_or_undecided() -> None:
    def counted(low: float, high: float) -> Row:
        return Row("network/false-alarms", "power-network", "chebyshev", "none", "all", "rate", low, low, high)

    three = Counted(CONSECUTIVE, "chebyshev", "all", "lit", "gaussian", 5.0, q=3)
    assert three.condition == "3 consecutive, alpha 5, lit, gaussian"
    assert three.claim == pytest.approx(5.0**-6) and claim_kept(counted(1e-4, 2e-4), three.claim) == "no"
    single = Counted(SINGLE, "chebyshev", "theta, 4 sharers", "lit", "gaussian", 2.0)
    assert single.claim == 0.25 and claim_kept(counted(0.1, 0.3), single.claim) == "undecided"
    assert claim_kept(counted(0.1, 0.3), 0.3) == "yes"
    assert Counted(SINGLE, "chebyshev", "all", "lit", "gaussian", rule="cantelli", level=0.01).claim == 0.01


def test_one_shock_causes_one_sequence_of_alarms() -> None:
    alpha = 10.0
    found = one_shock(list(range(20)), 20_000)
    for j, q in enumerate((1, 2, 3)):
        p = (1 - 0.3) ** 2 * 0.3 ** (2 * q - 2) / alpha**2  # of a shock
        expected = p * found["chances"][:, j].sum()
        # another one changes the count where it is within 17 steps (0.3^17 is the margin of its size, 1e-9)
        margin = 4 * np.sqrt(expected) + 17 * p * expected
        assert abs(found["consecutive"][:, ALPHAS.index(alpha), j].sum() - expected) < margin
