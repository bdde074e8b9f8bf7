"""network/plug: effects of a switch, and replugged diagnosers."""

from __future__ import annotations

from typing import Any

import numpy as np

from fusion_sfdia.benchmarks.network.plug import MANNERS, changes, replugged, switched
from fusion_sfdia.benchmarks.network.support.plug_figures import JOINS, LEAVES
from fusion_sfdia.models.power_network.diagnosis import network_areas
from fusion_sfdia.models.power_network.model import network_model
from fusion_sfdia.models.power_network.operation import Switch
from fusion_sfdia.models.power_network.simulation import run_network


def quiet(t: float) -> np.ndarray[Any, Any]:
    return np.zeros(15)


def numbered(who: Any) -> list[int]:
    return [int(i) + 1 for i in np.flatnonzero(who)]


def test_a_change_reaches_neighbours_and_the_copies_that_others_hold_of_their_angles() -> None:
    model = network_model(unplugged=("15",))
    for event, near, beyond in ((LEAVES, [3, 4, 5, 13], [2, 6, 12, 14]), (JOINS, [14, 15], [13])):
        found = changes(model, event)
        assert all(numbered(found[what]) == near for what in ("model", "weights", "thresholds"))
        assert numbered(found["copies"]) == beyond


def test_replugged_diagnosers_follow_a_change_exactly() -> None:
    model = network_model()
    quietly = list(run_network(model, 30, [0, 1], loads=quiet, switches=[Switch(20.0, unplug=("4",))]))
    # residuals are those of the noise alone: without its switch the same noise gives the same in an area far from it
    still = list(run_network(model, 30, [0, 1], loads=quiet))
    with_switch, without = (list(replugged(model, m, MANNERS[0])) for m in (quietly, still))
    np.testing.assert_allclose(with_switch[-1].residual[:, 8], without[-1].residual[:, 8], atol=1e-12)
    opened = np.isnan(quietly[-1].shared[0])
    assert opened.sum() == 6 and not with_switch[-1].residual_shared[:, opened].any()


def test_the_printed_rule_keeps_the_stiffness_of_an_open_tie() -> None:
    before, now = (network_areas(network_model(unplugged=away)) for away in ((), ("4",)))
    by_letter = switched(before, now, MANNERS[1])
    assert np.array_equal(by_letter.matrices, before.matrices) and np.array_equal(by_letter.slope, now.slope)
    assert switched(before, now, MANNERS[0]) is now and switched(before, now, MANNERS[2]) is before
