"""Mix-ups of units: the usual factors, gauge and absolute pressures, Celsius and kelvin, and the one that explains values."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.logs.conversion import conversion
from fusion_sfdia.plant.signals import Signal

Array = NDArray[Any]

OFF, FITS, BETTER, WITHIN = 0.15, 0.1, 5.0, 2.0
FACTORS = {10.0: "", 100.0: "percent for a fraction?", 1e3: "", 1e5: "", 1e6: "", 60.0: "per minute?", 3600.0: "per hour?"}
FACTORS |= {3.6: "", 180.0 / np.pi: "degrees for radians?", 30.0 / np.pi: "rpm for rad/s?", 14.5038: "psi for bar?"}
UNITS = ("degC", "degF", "barg", "psig", "bar", "psi", "kPa", "lb/h", "inch", "ft")  # tried where they convert to the plant's
UNSTATED = (("degF", "degC"), ("degC", "degF"), ("K", "degC"), ("degC", "K"))  # tried where no unit is known: (as, not as)
PRESSURE_FACTORS = (1.0, 10.0, 0.1, 100.0, 0.01, 1e3, 1e-3, 1e5, 1e-5, 1e6, 1e-6, 14.5038, 1 / 14.5038)


class MixUp(NamedTuple):
    """A mix-up of units: the reading as it should be, factor * reading + offset, and what it looks like, in words.

    zero: the reading from which deviations count: of a gauge pressure, the atmosphere. usual: whether units of the quantity
    differ so; factors of times and angles, of a pressure, count where nothing else explains it.
    """

    factor: float
    offset: float
    text: str
    zero: float = 0.0
    usual: bool = True

    def __call__(self, y: Any) -> Any:
        return self.factor * y + self.offset


def mix_up(y: Array, expected: Array | float, unit: str, noise: float = 0.0) -> MixUp | None:
    """Return the mix-up of units that explains values y (K,) where others are expected, in that unit; None where none does.
    unit: "" where it is not known.

    With |e| the median of what is expected, and the error the median of the differences from it: where the error is above
    OFF |e|, the mix-up with the smallest explains y if that is within FITS |e| + noise, the standard deviation of a reading,
    and BETTER times smaller. Of a gauge pressure |e| is above the
    atmosphere, and to be more than OFF of the absolute one.
    """
    e = float(np.median(np.abs(expected)))

    def error(mixed: MixUp) -> float:
        return float(np.median(np.abs(mixed(y) - expected)))

    if not (as_it_is := error(MixUp(1.0, 0.0, ""))) > OFF * e or not np.isfinite(as_it_is):
        return None
    mix_ups = [(m, float(np.median(np.abs(expected - m.zero)))) for m in _mix_ups(unit)]
    explaining = [m for m, above in mix_ups if above > OFF * e and error(m) <= FITS * above + noise]
    best = min(explaining, key=lambda m: (not m.usual, error(m)), default=None)
    return best if best is not None and error(best) <= as_it_is / BETTER else None


def input_mix_up(u: Array, signal: Signal) -> MixUp | None:
    """Return the mix-up of units that may explain values u (K,) of an input far from its nominal value; None where none does.

    Nine tenths of the values other than 0 have to be within a factor WITHIN of the nominal value with it, their median within
    the limits, and their median without it not. None for a nominal value of 0.
    """
    u = u[u != 0]
    if not u.size or not signal.nominal:
        return None

    def off(mixed: MixUp, values: Array) -> float:
        ratio = mixed(values) / signal.nominal
        return float(np.max(np.abs(np.log(ratio)))) if np.all(ratio > 0) else np.inf

    u, usual = np.quantile(u, (0.05, 0.95)), np.median(u, keepdims=True)
    if off(MixUp(1.0, 0.0, ""), usual) <= np.log(WITHIN):
        return None
    best = min(_mix_ups(signal.unit), key=lambda m: (off(m, usual) > np.log(WITHIN), not m.usual, off(m, usual)))
    return best if off(best, u) <= np.log(WITHIN) and signal.low <= float(best(usual)[0]) <= signal.high else None


def _mix_ups(unit: str) -> list[MixUp]:
    found, gauge = [], _gauge_mix_ups(unit) if unit else []
    for factor, hint in FACTORS.items():
        about = f" ({hint})" if hint else ""
        usual = not gauge or factor in PRESSURE_FACTORS
        found.append(MixUp(1 / factor, 0.0, f"looks {factor:.6g} times too large{about}", usual=usual))
        found.append(MixUp(factor, 0.0, f"looks {factor:.6g} times too small", usual=usual))
    found.append(MixUp(-1.0, 0.0, "looks of the wrong sign"))
    for other, own in [(other, unit) for other in UNITS] if unit else UNSTATED:
        try:
            factor, offset = conversion(other, own)
        except ValueError:
            continue
        if (factor, offset) != (1.0, 0.0):
            found.append(MixUp(factor, offset, f"looks as if in {other}, not {own}"))
        if offset and unit:
            found.append(MixUp(1 / factor, -offset / factor, f"looks as if converted from {other} twice"))
    return [*found, *gauge]


def _gauge_mix_ups(unit: str) -> list[MixUp]:
    """Gauge and absolute pressure taken for each other, or the factor of a gauge pressure, which acts above the atmosphere."""
    try:
        absolute, gauge = conversion("Pa", unit).offset, conversion("Pa(g)", unit).offset
    except ValueError:
        return []
    found = []
    for is_gauge, taken_as_gauge in ((True, False), (False, True), (True, True)):
        kind, taken = (("an absolute", "a gauge")[g] for g in (is_gauge, taken_as_gauge))
        zero, taken_zero = ((absolute, gauge)[g] for g in (is_gauge, taken_as_gauge))
        for factor in PRESSURE_FACTORS:
            if factor == 1.0 and zero == taken_zero:
                continue
            text = f"looks as {kind} pressure, bar({'g' if is_gauge else 'a'}), taken for {taken} one"
            if is_gauge == taken_as_gauge:
                text = "looks as a gauge pressure"
            if factor != 1.0:
                text += f", {factor:.6g} times too small" if factor > 1 else f", {1 / factor:.6g} times too large"
            found.append(MixUp(factor, zero - factor * taken_zero, text, zero))
    return found
