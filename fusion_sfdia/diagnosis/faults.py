"""Sensor faults: what they are, and files that list them.

A fault of a sensor is active at the samples onset <= t < onset + length. Kinds and their equations, y the healthy
reading and s the seconds since onset: see FAULT_KINDS. `fault_effects` puts them into readings, `fault_draws` draws them.
"""

from __future__ import annotations

import tomllib
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from fusion_sfdia.plant.plant import Plant

FAULT_KINDS = {
    "bias": "y + b",
    "drift": "y + b min((s + dt) / rise, 1): rises over `rise` seconds, then holds b until the fault ends",
    "scale": "b y",
    "noise": "y + b e, e standard normal",
    "spikes": "y + b or y - b, at each sample with `probability`, else y",
    "freeze": "the last reading before the onset; its mean is not detectable until the signal has moved by several sigma",
    "dropout": "missing (NaN), at each sample with `probability`",
    "replay": "the readings of the `period` seconds before the onset, repeated: an attack that hides changes of the plant",
}
WITHOUT_MAGNITUDE = ("freeze", "dropout", "replay")


@dataclass(frozen=True)
class Fault:
    """A fault of one sensor from `onset` for `length` seconds (inf: to the end).

    Parameters
    ----------
    sensor : str
        Its name.
    kind : str
        "bias", "drift", "scale", "noise", "spikes", "freeze", "dropout" or "replay", see FAULT_KINDS.
    onset : float
        Time of its begin in s.
    length : float, default inf
        Its duration in s.
    magnitude : float, default 0
        b, in the sensor's unit (a factor for scale).
    relative : bool, default False
        b is magnitude times the absolute value of the noise-free signal at the first faulty sample, so that its sign is the
        error's; where readings stand for the signal and that one is missing, of the last known reading before it, or else of
        the first known one after it.
    rise : float, optional
        Seconds in which a drift reaches b; None: its whole length.
    probability : float, default 1
        Of spikes and dropouts at each sample.
    period : float, optional
        Seconds of readings that a replay repeats, or as many as there are; None: its whole length.

    Raises
    ------
    ValueError
        For an unknown kind, numbers that do not fit it, and a magnitude that is missing or has no effect.

    Notes
    -----
    Shaheen 2024, sec. IV-B: a bias of M samples has length = M dt; a drift that reaches b in M samples and holds it for
    K has rise = M dt, length = (M + K) dt. Its printed ranges (0 <= k - m <= M) are M + 1 samples and overlap, with a
    drift of b (M + 1)/M at k - m = M; M is called the number of samples, so 0 <= k - m < M stands here.

    Examples
    --------
    >>> from fusion_sfdia import Fault
    >>> Fault("l1", "drift", onset=600.0, length=900.0, magnitude=0.05, rise=300.0).rise
    300.0
    """

    sensor: str
    kind: str
    onset: float
    length: float = np.inf
    magnitude: float = 0.0
    relative: bool = False
    rise: float | None = None
    probability: float = 1.0
    period: float | None = None

    def __post_init__(self) -> None:
        who = f"{self.kind} of sensor {self.sensor!r}"
        if not isinstance(self.kind, str) or self.kind not in FAULT_KINDS:
            raise ValueError(f"sensor {self.sensor!r}: unknown fault kind {self.kind!r}; known: {', '.join(FAULT_KINDS)}")
        for what in (
            "onset",
            "length",
            "magnitude",
            "probability",
            *(w for w in ("rise", "period") if getattr(self, w) is not None),
        ):
            if isinstance(value := getattr(self, what), bool) or not isinstance(value, int | float | np.integer | np.floating):
                raise ValueError(f"{who}: {what} is {value!r}; expected a number")
            try:
                object.__setattr__(self, what, float(value))
            except OverflowError as error:
                raise ValueError(f"{who}: {what} is too large; expected a number below 1e308") from error
            if what in ("onset", "magnitude") and not np.isfinite(getattr(self, what)):
                raise ValueError(f"{who}: {what} is {value}; expected a finite number")
        if not isinstance(self.relative, bool):
            raise ValueError(f"{who}: relative is {self.relative!r}; expected true or false")
        if not self.length > 0:
            raise ValueError(f"{who}: length is {self.length}; expected a positive number of seconds")
        if self.kind in WITHOUT_MAGNITUDE and (self.magnitude != 0 or self.relative):
            raise ValueError(f"{who}: a {self.kind} has no magnitude; leave magnitude and relative out")
        if self.kind not in WITHOUT_MAGNITUDE and self.magnitude == 0 and self.kind != "scale":
            raise ValueError(f"{who}: magnitude is 0, which is no fault; give another one")
        if self.kind == "scale" and self.relative:
            raise ValueError(f"{who}: a scale is a factor already; leave relative out")
        if self.kind in ("noise", "spikes") and self.magnitude < 0:
            raise ValueError(f"{who}: magnitude is {self.magnitude}; expected a positive size")
        if self.rise is not None and (self.kind != "drift" or not 0 < self.rise < np.inf):
            raise ValueError(f"{who}: rise is {self.rise}; it belongs to a drift and is a positive number of seconds")
        if self.kind == "drift" and self.rise is None and np.isinf(self.length):
            raise ValueError(f"{who}: neither rise nor length is given; expected the seconds in which it reaches its magnitude")
        if self.period is not None and (self.kind != "replay" or not 0 < self.period < np.inf):
            raise ValueError(f"{who}: period is {self.period}; it belongs to a replay and is a positive number of seconds")
        if self.kind == "replay" and self.period is None and np.isinf(self.length):
            raise ValueError(f"{who}: neither period nor length is given; expected the seconds of readings that it repeats")
        if not 0 < self.probability <= 1 or (self.probability != 1 and self.kind not in ("spikes", "dropout")):
            raise ValueError(f"{who}: probability is {self.probability}; expected in (0, 1], and only for spikes and dropouts")


def load_faults(path: str | Path, plant: Plant) -> list[Fault]:
    r"""Read the [[fault]] tables of a TOML file; their keys are the fields of Fault.

    Parameters
    ----------
    path : str or Path
        The file.
    plant : Plant
        Which has the sensors.

    Returns
    -------
    list of Fault
        In the order of the file.

    Raises
    ------
    ValueError
        Naming the file and the entry where it is no TOML, is empty, or has unknown keys, sensors or kinds.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from fusion_sfdia.faults import load_faults
    >>> from fusion_sfdia.plants import two_tanks
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder, "faults.toml")
    ...     size = path.write_text('[[fault]]\nsensor = "l1"\nkind = "bias"\nonset = 300.0\nmagnitude = 0.05\n')
    ...     faults = load_faults(path, two_tanks())
    >>> faults[0].sensor, faults[0].magnitude
    ('l1', 0.05)
    """
    expected = ', e.g. [[fault]] with sensor = "' + plant.sensor_names[0] + '", kind = "bias", onset = 60.0, magnitude = 0.1'
    try:
        document = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is not a TOML file ({error}); write [[fault]] tables{expected}") from error
    unknown = sorted(set(document) - {"fault"})
    entries = document.get("fault", [])
    if unknown or not isinstance(entries, list) or not entries or not all(isinstance(e, dict) for e in entries):
        what = f"unknown entries {', '.join(unknown)}" if unknown else "no [[fault]] tables"
        raise ValueError(f"{path} holds {what}; write [[fault]] tables{expected}")
    return [_entry(f"{path}, fault {number}", entry, plant) for number, entry in enumerate(entries, start=1)]


def _entry(where: str, entry: dict[str, Any], plant: Plant) -> Fault:
    known = [f.name for f in fields(Fault)]
    missing = [f.name for f in fields(Fault) if f.default is MISSING and f.name not in entry]
    unknown = sorted(set(entry) - set(known))
    if unknown or missing:
        what = f"unknown key {', '.join(unknown)}" if unknown else f"no {', '.join(missing)}"
        raise ValueError(f"{where}: {what}; the keys are {', '.join(known)}")
    try:
        plant.sensor_index(entry["sensor"])
        return Fault(**entry)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error
