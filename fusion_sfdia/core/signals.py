"""Signals, the variables of a plant, and sensors, the instruments that read them. Everything is SI inside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fusion_sfdia.core.arguments import number


@dataclass(frozen=True)
class Signal:
    """A physical variable: its name, unit, nominal value and the limits between which the model holds."""

    name: str
    unit: str = "1"
    nominal: float = 0.0
    low: float = -np.inf
    high: float = np.inf

    def __post_init__(self) -> None:
        for what in ("nominal", "low", "high"):
            number(f"signal {self.name!r}: {what}", getattr(self, what))
        if not (self.low <= self.nominal <= self.high and np.isfinite(self.nominal)):
            raise ValueError(
                f"signal {self.name!r}: nominal {self.nominal} is not finite and within [{self.low}, {self.high}]; "
                "correct it or the limits"
            )


@dataclass(frozen=True)
class Sensor:
    """An instrument that reads one variable, with noise stated as a standard deviation, a bound, or both.

    What is not stated follows: sigma of a uniform error within the bound (bound/sqrt 3); no bound (inf) for a sigma.
    `owner` is the block that reads the sensor, `quantity` the kind of thing it measures ("pressure"), by which results
    are grouped.
    """

    name: str
    measures: str
    unit: str = "1"
    sigma: float | None = None
    bound: float | None = None
    owner: str = ""
    quantity: str = ""

    def __post_init__(self) -> None:
        for what, value in (("sigma", self.sigma), ("bound", self.bound)):
            if value is not None and not 0 < number(f"sensor {self.name!r}: {what}", value) < np.inf:
                raise ValueError(f"sensor {self.name!r}: {what} is {value}; it must be positive and finite, or left out")
        if self.sigma is None and self.bound is None:
            raise ValueError(f"sensor {self.name!r} states no noise; give sigma, bound or both")

    @property
    def noise_sigma(self) -> float:
        """Standard deviation of the reading, in the sensor's unit."""
        return self.sigma if self.sigma is not None else float(self.bound or 0.0) / np.sqrt(3.0)

    @property
    def noise_bound(self) -> float:
        """Largest error of the reading, in the sensor's unit; inf where none is stated."""
        return np.inf if self.bound is None else self.bound
