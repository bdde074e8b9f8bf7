"""Random sensor faults from ranges, and the ranges of Shaheen 2024 by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fusion_sfdia.common.random_streams import stream
from fusion_sfdia.diagnosis.faults import FAULT_KINDS, WITHOUT_MAGNITUDE, Fault
from fusion_sfdia.plant.plant import Plant

SETTLE = 30  # samples before the first fault of `draw_apart`: a filter no longer depends on its start
LONGEST = 40  # samples of the longest fault of PRESETS
UNITS = ("absolute", "relative", "sigmas")


@dataclass(frozen=True)
class FaultRange:
    """Faults of one kind with a magnitude uniform in [low, high] and a length of uniform whole samples low..high.

    Parameters
    ----------
    kind : str
        As in Fault.
    magnitude : tuple of (float, float), default (0, 0)
        low and high.
    unit : str, default "absolute"
        Of the magnitude: "absolute" (the sensor's unit, a factor for scale), "relative" (times the absolute value of the
        signal) or "sigmas" (of the sensor's noise).
    length : tuple of (int, int), default (10, 20)
        low and high in samples.
    hold : tuple of (int, int), optional
        A drift rises over `length` samples and then holds for `hold` samples, drawn independently; None for no hold.
    signed : bool, default True
        A random sign.
    probability : float, default 1
        As in Fault.
    description : str, default ""
        In words.

    Raises
    ------
    ValueError
        For an unknown kind or unit, and for ranges that do not fit the kind.

    Examples
    --------
    >>> from fusion_sfdia.faults import FaultRange
    >>> FaultRange("bias", (3.0, 10.0), unit="sigmas").length
    (10, 20)
    """

    kind: str
    magnitude: tuple[float, float] = (0.0, 0.0)
    unit: str = "absolute"
    length: tuple[int, int] = (10, 20)
    hold: tuple[int, int] | None = None
    signed: bool = True
    probability: float = 1.0
    description: str = ""

    def __post_init__(self) -> None:
        if self.kind not in FAULT_KINDS:
            raise ValueError(f"unknown fault kind {self.kind!r}; known: {', '.join(FAULT_KINDS)}")
        if self.unit not in UNITS:
            raise ValueError(f"range of {self.kind}: unit is {self.unit!r}; known: {', '.join(UNITS)}")
        low, high = self.magnitude
        if self.kind not in WITHOUT_MAGNITUDE and not (0 < low <= high < np.inf):
            raise ValueError(f"range of {self.kind}: magnitude is {self.magnitude}; expected 0 < low <= high")
        if self.hold is not None and self.kind != "drift":
            raise ValueError(f"range of {self.kind}: hold is {self.hold}; only a drift holds")
        for what, samples in (("length", self.length), ("hold", self.hold or (0, 0))):
            if not (what == "hold" or samples[0] >= 1) or not 0 <= samples[0] <= samples[1]:
                raise ValueError(f"range of {self.kind}: {what} is {samples}; expected whole samples, low <= high")


def _published(strength: str, kind: str, low: float, high: float) -> FaultRange:
    what = f"{strength} {kind}: {low:.0%} to {high:.0%} of the signal, either sign"
    how = "10-20 samples" if kind == "bias" else "rising over 10-20 samples, held for 10-20"
    return FaultRange(
        kind, (low, high), "relative", hold=None if kind == "bias" else (10, 20), description=f"{what}, {how} (Shaheen 2024)"
    )


# Shaheen 2024, sec. V-B: b uniform in 60-90 % (strong) or 20-40 % (weak) "of the data amplitude", random sign, M and K
# uniform in 10-20 samples. Amplitude is read as the value of the signal: with the swing, temperature faults would be of the
# order of the noise. M and K are drawn independently as that section states; sec. IV-B's M > K contradicts it.
PRESETS = {
    f"{strength}-{kind}": _published(strength, kind, low, high)
    for strength, low, high in (("strong", 0.6, 0.9), ("weak", 0.2, 0.4))
    for kind in ("bias", "drift")
}


def draw_faults(
    ranges: str | FaultRange | Sequence[str | FaultRange],
    plant: Plant,
    rng: np.random.Generator | int,
    *,
    window: tuple[float, float],
    count: int | tuple[int, int] = 1,
    quantity: str | None = None,
    repeat: bool = False,
) -> list[Fault]:
    """Return random faults: each of a range picked at random, on a random sensor, from a random sampling time.

    Parameters
    ----------
    ranges : str, FaultRange or sequence of them
        Preset names or FaultRanges.
    plant : Plant
        Whose sensors fail.
    rng : Generator or int
        The randomness, or its seed.
    window : tuple of (float, float)
        The onset is uniform over the multiples of dt in [low, high] s.
    count : int or tuple of (int, int), default 1
        How many, or low..high.
    quantity : str, optional
        Only sensors of it (as in plant.quantities).
    repeat : bool, default False
        Whether a sensor may have several.

    Returns
    -------
    list of Fault
        To be put into readings by `apply_faults`.

    Raises
    ------
    ValueError
        For unknown names, too few sensors, a window without a sampling time.

    Examples
    --------
    >>> from fusion_sfdia.faults import FaultRange, draw_faults
    >>> from fusion_sfdia.plants import two_tanks
    >>> drawn = draw_faults(FaultRange("drift", (5, 10), unit="sigmas"), two_tanks(), 7, window=(200.0, 400.0))
    >>> drawn[0].kind, 200.0 <= drawn[0].onset <= 400.0
    ('drift', True)
    """
    rng = np.random.default_rng(rng)
    choices = [ranges] if isinstance(ranges, str | FaultRange) else list(ranges)
    unknown = [r for r in choices if isinstance(r, str) and r not in PRESETS]
    if unknown or not choices:
        raise ValueError(f"unknown faults {', '.join(map(str, unknown)) or '(none given)'}; presets: {', '.join(PRESETS)}")
    if quantity is not None and quantity not in plant.quantities:
        known = ", ".join(plant.quantities)
        raise ValueError(f"unknown quantity {quantity!r} of plant {plant.name!r}; known: {known}")
    sensors = np.arange(len(plant.sensors)) if quantity is None else plant.quantities[quantity]
    first, last = int(np.ceil(window[0] / plant.dt - 1e-9)), int(np.floor(window[1] / plant.dt + 1e-9))
    if first > last:
        raise ValueError(f"no multiple of dt = {plant.dt:g} s is within the window {window}; widen it")
    low, high = (count, count) if isinstance(count, int) else count
    if not 1 <= low <= high:
        raise ValueError(f"count is {count}; expected at least 1, and low <= high")
    number = int(rng.integers(low, high, endpoint=True))
    if number > sensors.size and not repeat:
        raise ValueError(f"{number} faults on {sensors.size} sensors; lower count, or allow several on one with repeat=True")
    drawn = []
    for i in rng.choice(sensors, number, replace=repeat):
        choice = choices[int(rng.integers(len(choices)))]
        onset = int(rng.integers(first, last, endpoint=True)) * plant.dt
        drawn.append(_realise(PRESETS[choice] if isinstance(choice, str) else choice, plant, int(i), onset, rng))
    return drawn


def draw_apart(named: Sequence[tuple[str, str | None]], plant: Plant, steps: int, seed: int) -> list[Fault]:
    """Return one fault for each (preset, quantity or None), each on another sensor, in a log of so many readings from dt on.

    The first can begin at reading SETTLE + 1, the last early enough to end within the log where it is long enough.
    Raises ValueError as `draw_faults` does, for a log of fewer readings, and for more faults than sensors.
    """
    if named and steps <= SETTLE:
        raise ValueError(
            f"{steps} readings have no room for drawn faults, which begin at reading {SETTLE + 1}; ask for at least "
            f"{SETTLE + LONGEST}, or place the faults in a file (--faults)"
        )
    window = ((SETTLE + 1) * plant.dt, max(SETTLE + 1, steps - LONGEST) * plant.dt)
    faults: list[Fault] = []
    for number, (name, quantity) in enumerate(named):
        rng = stream(seed, "faults", number)
        taken = {f.sensor for f in faults}
        among = plant.sensor_names if quantity is None else [plant.sensor_names[i] for i in plant.quantities.get(quantity, ())]
        if among and taken >= set(among):
            raise ValueError(f"all {len(among)} sensors of {quantity or plant.name} are faulty already; draw fewer faults")
        while (fault := draw_faults(name, plant, rng, window=window, quantity=quantity)[0]).sensor in taken:
            pass
        faults.append(fault)
    return faults


def _realise(of: FaultRange, plant: Plant, sensor: int, onset: float, rng: np.random.Generator) -> Fault:
    size = float(rng.uniform(*of.magnitude)) * (float(plant.sensor_sigma[sensor]) if of.unit == "sigmas" else 1.0)
    sign = float(rng.choice([-1.0, 1.0]))
    rising = int(rng.integers(*of.length, endpoint=True))
    held = 0 if of.hold is None else int(rng.integers(*of.hold, endpoint=True))
    signed = of.signed and of.kind in ("bias", "drift")
    return Fault(
        sensor=plant.sensor_names[sensor],
        kind=of.kind,
        onset=onset,
        length=(rising + held) * plant.dt,
        magnitude=0.0 if of.kind in WITHOUT_MAGNITUDE else sign * size if signed else size,
        relative=of.unit == "relative" and of.kind not in WITHOUT_MAGNITUDE,
        rise=rising * plant.dt if of.kind == "drift" else None,
        probability=of.probability,
    )
