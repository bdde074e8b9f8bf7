"""Units of one kind are compared: one that differs is named, and chance seldom names one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fusion_sfdia.learning.monitor.compared_units import CHANCE, differing, means_of
from fusion_sfdia.plant.signals import Signal

Array = NDArray[Any]

SENSORS = [Signal(f"s{i}", "K") for i in range(6)]
C = np.random.default_rng(0).standard_normal((6, 2))


def unit(seed: int, bias: float = 0.0, slope: float = 0.0) -> Array:
    """Means of six readings of two factors, with an operating point and offsets of its own; s2 off, s4 of another law."""
    rng = np.random.default_rng(seed)
    f, e = np.zeros((900, 2)), rng.standard_normal((900, 2))
    for k in range(1, 900):
        f[k] = 0.97 * f[k - 1] + 0.25 * e[k]
    f += rng.normal(0, 1, 2)
    y = f @ C.T + 0.3 * rng.standard_normal((900, 6)) + 0.3 * rng.standard_normal(6)
    y[:, 2] += bias
    y[:, 4] += slope * f[:, 0]
    return means_of(y)


def test_units_that_are_alike_are_seldom_said_to_differ() -> None:
    tries = 60
    said = sum(bool(differing(SENSORS, {f"u{k}": unit(100 * r + k) for k in range(8)})) for r in range(tries))
    assert said <= CHANCE * tries + 3 * np.sqrt(CHANCE * tries)


@pytest.mark.parametrize(("fault", "sensors", "words"), [
    ({"bias": 4.0}, {"s2"}, "s2 reads 4"), ({"slope": 1.5}, {f"s{i}" for i in range(6)}, "times as much about"),
])  # fmt: skip
def test_a_unit_with_an_offset_or_another_law_is_named_and_a_second_one_does_not_hide_it(
    fault: dict[str, float], sensors: set[str], words: str
) -> None:
    units = {f"u{k}": unit(k) for k in range(24)} | {"u3": unit(3, **fault)}
    (found,) = differing(SENSORS, units)
    assert found.unit == "u3" and found.sensor in sensors and found.excess > 1
    assert str(found).startswith("u3: ") and (words[:8] in str(found) or words in str(found))
    again = {d.unit for d in differing(SENSORS, units | {"u9": unit(9, **fault)})}
    assert again == {"u3", "u9"}


def test_few_units_and_short_ones_are_not_compared() -> None:
    units = {f"u{k}": unit(k, bias=30.0 * (k == 1)) for k in range(5)}
    assert [d.unit for d in differing(SENSORS, units)] == ["u1"]
    assert not differing(SENSORS, {k: units[k] for k in ("u0", "u1", "u2", "u3")})
    assert not differing(SENSORS, units | {"u0": units["u0"][:3]})
