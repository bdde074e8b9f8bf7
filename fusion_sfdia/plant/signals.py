"""Signals, the variables of a plant, and sensors, the instruments that read them. Everything is SI inside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fusion_sfdia.common.arguments import number
from fusion_sfdia.plant.slow_noise import SlowNoise


@dataclass(frozen=True)
class Signal:
    """A physical variable: its name, unit, nominal value and the limits between which the model holds.

    Parameters
    ----------
    name : str
        Of the variable.
    unit : str, default "1"
        In which all its numbers are.
    nominal : float, default 0
        Its usual value.
    low : float, default -inf
        Value below which the model does not hold.
    high : float, default inf
        Value above which the model does not hold.
    initial_sigma : float, optional
        Of a state: standard deviation of its initial value about the nominal value; None where the plant states its covariances
        itself.
    process_sigma : float, optional
        Of a state: standard deviation of the process noise over one nominal time step of the plant; None as above.
    period : float, optional
        Of a cyclic variable, such as 360 for an angle in degrees: values that differ by it are the same, so that residuals of
        the sensors that measure the variable are wrapped into [-period/2, period/2), and limits that are a period or more apart
        do not apply.
    meaning : str, default ""
        The quantity in words, for the sentences of a diagnosis, as of `Sensor`.
    check : str, default ""
        What to do where it is found different, for the same sentences.

    Raises
    ------
    ValueError
        For a nominal value outside the limits, a negative or infinite sigma, and a period that is not positive and finite.

    Examples
    --------
    >>> from fusion_sfdia import Signal
    >>> level = Signal("level", "m", nominal=1.0, low=0.0, high=2.0, initial_sigma=0.05, process_sigma=1e-3)
    >>> level.unit, level.high
    ('m', 2.0)
    """

    name: str
    unit: str = "1"
    nominal: float = 0.0
    low: float = -np.inf
    high: float = np.inf
    initial_sigma: float | None = None
    process_sigma: float | None = None
    period: float | None = None
    meaning: str = ""
    check: str = ""

    def __post_init__(self) -> None:
        for what in ("nominal", "low", "high"):
            number(f"signal {self.name!r}: {what}", getattr(self, what))
        if not np.isfinite(self.nominal):
            raise ValueError(f"signal {self.name!r}: nominal is {self.nominal}; expected a finite number")
        if not self.low <= self.nominal <= self.high:
            raise ValueError(
                f"signal {self.name!r}: nominal {self.nominal} {self.unit} is outside [{self.low}, {self.high}] {self.unit}: "
                "correct it, or the limits"
            )
        for what, sigma in (("initial_sigma", self.initial_sigma), ("process_sigma", self.process_sigma)):
            if sigma is not None and not 0 <= number(f"signal {self.name!r}: {what}", sigma) < np.inf:
                raise ValueError(f"signal {self.name!r}: {what} is {sigma}; it must be finite and at least 0, or left out")
        _require_period(f"signal {self.name!r}", self.period)


@dataclass(frozen=True)
class Sensor:
    """An instrument that reads one variable, with noise stated as a standard deviation, a bound, or both, in its unit.

    Parameters
    ----------
    name : str
        Of the sensor.
    measures : str
        The name of the variable; "" of a channel of which the model predicts nothing, which stands behind the other sensors.
    unit : str, default "1"
        Of its readings.
    sigma : float, optional
        Standard deviation of the noise, of its white and its slow part together; a missing one is that of a uniform error
        within the bound (bound/sqrt 3).
    bound : float, optional
        Largest |noise|; a missing one is inf.
    owner : str, default ""
        The subsystem or area that reads the sensor.
    quantity : str, default ""
        The kind of variable it measures ("pressure"), by which results are grouped.
    scale : float, default 1
        Its reading over the variable in SI; `Plant.in_units` sets it.
    period : float, optional
        Of cyclic readings, in the sensor's unit; None for that of the variable that it measures, if that has one.
    resolution : float, default 0
        The step of the readings, whose rounding adds a uniform error to the noise; equal readings of a coarse sensor are then
        not taken as frozen.
    noise : SlowNoise, optional
        The part of the noise that is slow, None for white noise. `robust-glr` then needs as much more evidence against the
        sensor, and simulated readings have it; filters take all noise as white.
    meaning : str, default ""
        The quantity in words ("mixed-air temperature"), for the sentences of a diagnosis.
    check : str, default ""
        What to do where the sensor is wrong ("Compare with a thermometer in the duct."), for the same sentences.

    Raises
    ------
    ValueError
        For noise or a period that is not positive and finite, noise that is missing, a negative resolution, and a scale of 0 or
        one that is not finite.

    Examples
    --------
    >>> from fusion_sfdia import Sensor
    >>> gauge = Sensor("gauge", "level", "m", sigma=0.01, resolution=0.05)
    >>> round(gauge.noise_sigma, 4), gauge.noise_bound
    (0.0176, inf)
    """

    name: str
    measures: str
    unit: str = "1"
    sigma: float | None = None
    bound: float | None = None
    owner: str = ""
    quantity: str = ""
    scale: float = 1.0
    period: float | None = None
    resolution: float = 0.0
    noise: SlowNoise | None = None
    meaning: str = ""
    check: str = ""

    def __post_init__(self) -> None:
        if not isinstance(self.noise, SlowNoise | None):
            raise ValueError(
                f"sensor {self.name!r}: noise is {self.noise!r}; expected SlowNoise(share=.., time_constant=..), and the "
                "standard deviation of all its noise as sigma"
            )
        for what, value in (("sigma", self.sigma), ("bound", self.bound)):
            if value is not None and not 0 < number(f"sensor {self.name!r}: {what}", value) < np.inf:
                raise ValueError(f"sensor {self.name!r}: {what} is {value}; it must be positive and finite, or left out")
        if self.sigma is None and self.bound is None:
            raise ValueError(f"sensor {self.name!r} states no noise; give sigma, bound or both")
        if not 0 < abs(number(f"sensor {self.name!r}: scale", self.scale)) < np.inf:
            raise ValueError(f"sensor {self.name!r}: scale is {self.scale}; it must be finite and not 0")
        _require_period(f"sensor {self.name!r}", self.period)
        if not 0 <= number(f"sensor {self.name!r}: resolution", self.resolution) < np.inf:
            raise ValueError(f"sensor {self.name!r}: resolution is {self.resolution}; it must be finite and at least 0")

    @property
    def noise_sigma(self) -> float:
        """Standard deviation of the reading, in the sensor's unit: sqrt(sigma^2 + resolution^2 / 12)."""
        sigma = self.sigma if self.sigma is not None else float(self.bound or 0.0) / np.sqrt(3.0)
        return float(np.hypot(sigma, self.resolution / np.sqrt(12.0))) if self.resolution else sigma

    def own_sigma(self, noise_sigma: float) -> float:
        """The sigma with which the reading, with its rounding, has a stated standard deviation.

        Parameters
        ----------
        noise_sigma : float
            The standard deviation of the reading, in the sensor's unit.

        Returns
        -------
        float
            A hundredth of noise_sigma at least.
        """
        if not self.resolution:
            return noise_sigma
        return float(np.sqrt(max(noise_sigma**2 - self.resolution**2 / 12.0, (0.01 * noise_sigma) ** 2)))

    @property
    def noise_bound(self) -> float:
        """Largest error of the reading, in the sensor's unit; inf where none is stated."""
        return np.inf if self.bound is None else self.bound + self.resolution / 2


def _require_period(whose: str, period: float | None) -> None:
    if period is not None and not 0 < number(f"{whose}: period", period) < np.inf:
        raise ValueError(f"{whose}: period is {period}; it must be positive and finite, such as 360 in degrees, or left out")
