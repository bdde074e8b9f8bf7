"""Process faults and disturbances of the marine engine, as changes of its parameters; magnitudes and shapes are our choice.

K24 names process faults as future work. An engine with such a fault is another truth for the same detector:

    simulate(plant, 3000, seeds, truth=marine_engine(process_faults=[EngineFault("turbine-fouling", 0.1, onset=10.0)]))
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from fusion_sfdia.models.marine_engine.equations import EngineParameters
from fusion_sfdia.models.marine_engine.equilibrium import engine_variables, equilibrium

PROCESS_FAULTS = {  # kind: effect of a severity s
    "turbine-fouling": "the turbine's effective area is (1 - s) times as large",
    "compressor-fouling": "the turbocharger's efficiency is (1 - s) times as large",
    "injector-loss": "a cylinder gets (1 - s) times the fuel that is set",
    "intercooler-fouling": "the intercooler leaves the air warmer by s times what the air is above T_c at full load",
    "heavy-propeller": "the load of the propeller law is (1 + s) times as large: hull fouling, weather, pitch",
}


@dataclass(frozen=True)
class EngineFault:
    """A process fault of the marine engine, for `marine_engine(process_faults=[...])`: all sensors are in order.

    It acts from `onset` on and grows linearly over `rise` to `severity`. Kinds and shapes are our choice: K24 names process
    faults as future work.

    Parameters
    ----------
    kind : str
        With s the severity: "turbine-fouling" (its area is (1 - s) times as large), "compressor-fouling" (the turbocharger's
        efficiency, likewise), "injector-loss" (the cylinder gets (1 - s) times the fuel that is set), "intercooler-fouling" (it
        leaves the air warmer by s times what the air is above the cooler's temperature at full load) or "heavy-propeller" (the
        load is (1 + s) times as large).
    severity : float
        A share in (0, 1).
    onset : float, default 0
        In s.
    rise : float, default 0
        In s.

    Raises
    ------
    ValueError
        For another kind, a severity outside (0, 1), or times that are not finite.

    Examples
    --------
    >>> from fusion_sfdia.faults import EngineFault
    >>> EngineFault("turbine-fouling", 0.1, onset=10.0, rise=20.0).severity_at(20.0)
    0.05
    """

    kind: str
    severity: float
    onset: float = 0.0
    rise: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in PROCESS_FAULTS:
            raise ValueError(f"unknown process fault {self.kind!r}; known: {', '.join(PROCESS_FAULTS)}")
        if not 0 < self.severity < 1:
            raise ValueError(f"{self.kind}: severity is {self.severity}; expected above 0 and below 1")
        if not np.isfinite(self.onset) or not (self.rise >= 0 and np.isfinite(self.rise)):
            raise ValueError(f"{self.kind}: onset {self.onset} s and rise {self.rise} s; expected finite, rise at least 0")

    def severity_at(self, t: float) -> float:
        """Severity at a time.

        Parameters
        ----------
        t : float
            Time in s.

        Returns
        -------
        float
            0 until the onset, `severity` from the end of the rise on.
        """
        if t < self.onset:
            return 0.0
        return self.severity * (min((t - self.onset) / self.rise, 1.0) if self.rise > 0 else 1.0)


def parameter_schedule(
    c: EngineParameters, faults: Sequence[EngineFault], slip: str = "law"
) -> Callable[[float], EngineParameters]:
    """Return the engine's parameters as a function of time (s); c are those of the healthy engine."""
    if not faults:
        return partial(_always, c)
    heat = float(engine_variables(equilibrium(1.0, c, slip), c, slip)["T_compressor"]) - c.T_cooler  # K
    return partial(_faulty, c, tuple(faults), heat)


def _always(c: EngineParameters, t: float) -> EngineParameters:
    return c


def _faulty(c: EngineParameters, faults: Sequence[EngineFault], heat: float, t: float) -> EngineParameters:
    now = c
    for fault in faults:
        s = fault.severity_at(t)
        match fault.kind:
            case "turbine-fouling":
                now = now._replace(turbine_area=now.turbine_area * (1 - s))
            case "compressor-fouling":
                now = now._replace(turbocharger_efficiency=now.turbocharger_efficiency * (1 - s))
            case "injector-loss":
                now = now._replace(full_injection=now.full_injection * (1 - s))
            case "intercooler-fouling":
                now = now._replace(T_cooler=now.T_cooler + s * heat)
            case "heavy-propeller":
                now = now._replace(load=now.load * (1 + s))
    return now
