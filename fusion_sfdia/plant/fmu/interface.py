"""What modelDescription.xml of a Functional Mock-up Unit states; what cannot become a plant is refused."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, ZipFile

import numpy as np

from fusion_sfdia.common.errors import MissingPackageError
from fusion_sfdia.common.references import did_you_mean

MODEL_EXCHANGE, CO_SIMULATION = "model exchange", "co-simulation"
ELEMENTS = {MODEL_EXCHANGE: "ModelExchange", CO_SIMULATION: "CoSimulation"}
BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


@dataclass(frozen=True)
class Variable:
    """A scalar variable: its name, value reference, unit as pint reads it, and what is stated of it.

    start: None where the FMU calculates it. scale: its nominal value, None where not stated: of FMI the size that is usual for
    the variable, not its operating point. rate: the value reference of its derivative, of a state. kind: type as FMPy names
    it. given: whether it may be set before the simulation begins. continuous: a real number that changes in continuous time.
    """

    name: str
    reference: int
    unit: str
    kind: str
    causality: str
    start: float | str | None
    low: float
    high: float
    scale: float | None
    quantity: str
    continuous: bool
    given: bool
    rate: int | None = None


@dataclass(frozen=True)
class Interface:
    """One of the interfaces of an FMU: what from_fmu needs of its description.

    version: 2 or 3. directional, get_and_set, any_step: its capabilities to give directional derivatives, to get and set its
    state, and to step by any time (co-simulation). step, start_time, tolerance: of its default experiment; None, 0, 1e-6.
    """

    path: Path
    name: str
    version: int
    kind: str
    tool: str
    variables: dict[str, Variable]
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    directional: bool
    get_and_set: bool
    any_step: bool
    step: float | None
    start_time: float
    tolerance: float

    def __str__(self) -> str:
        return f"{self.path}: FMI {self.version}.0 {self.kind} {self.name!r}{f' of {self.tool}' if self.tool else ''}"

    def of(self, what: str, names: Iterable[str]) -> list[Variable]:
        """The variables of these names; ValueError for an unknown one."""
        if isinstance(names, str):
            raise ValueError(f"{what}s is {names!r}; expected a list of names: [{names!r}]")
        found = []
        for name in names:
            if name not in self.variables:
                likely = {"input": self.inputs, "state": self.states}.get(what, self.outputs)
                raise ValueError(
                    f"{self} has no variable {name!r}; {did_you_mean(name, self.variables)}expected for {what} one of its "
                    f"variables, such as {', '.join(likely[:8]) or 'none'}"
                )
            found.append(self.variables[name])
        return found

    def continuous(self, what: str, names: Iterable[str]) -> list[Variable]:
        """The same; ValueError for one that is not real and continuous."""
        found = self.of(what, names)
        if wrong := [v for v in found if not v.continuous]:
            raise ValueError(
                f"{self}: the {what} {wrong[0].name!r} is a discrete variable or one of type {wrong[0].kind}; expected scalar "
                f"real numbers that change continuously: leave it out and name the others, {what}s=..."
            )
        return found


def fmpy() -> Any:
    """FMPy; MissingPackageError without it."""
    try:
        import fmpy
        import fmpy.fmi1
        import fmpy.simulation
    except ImportError as error:
        raise MissingPackageError(
            "an FMU needs FMPy, which is not installed; install it: pip install 'fusion-sfdia[fmu]'"
        ) from error
    return fmpy


def read_interface(path: str | Path, kind: str | None = None) -> Interface:
    """Read the description of an FMU.

    kind: "model exchange" or "co-simulation", by default the first that it has. MissingPackageError without FMPy; ValueError
    for a file that is no FMU of FMI 2.0 or 3.0, has no library for this platform or not this interface, and for model exchange
    with events, which a plant does not have.
    """
    library, path = fmpy(), Path(path)
    version, element_flags = _opened(path)
    try:
        found = library.read_model_description(path, validate=False)
    except Exception as error:  # FMPy and lxml raise errors of many kinds
        raise ValueError(
            f"{path}: modelDescription.xml cannot be read ({_line(error)}); expected that of FMI {version}.0: "
            "`fmpy validate` lists its mistakes"
        ) from error
    offered = {MODEL_EXCHANGE: found.modelExchange, CO_SIMULATION: found.coSimulation}
    if kind not in (None, *offered):
        raise ValueError(f"kind is {kind!r}; expected {MODEL_EXCHANGE!r} or {CO_SIMULATION!r}")
    kinds = [k for k, interface in offered.items() if interface is not None and kind in (None, k)]
    if not kinds:
        has = ", ".join(k for k, interface in offered.items() if interface is not None) or "scheduled execution alone"
        raise ValueError(
            f"{path}: FMU {found.modelName!r} has {has}; expected {kind or ' or '.join(offered)}: export it as that"
        )
    chosen = offered[kinds[0]]
    experiment = found.defaultExperiment
    interface = Interface(
        path,
        found.modelName,
        version,
        kinds[0],
        found.generationTool or "",
        _variables(found),
        tuple(u.variable.derivative.name for u in found.derivatives if u.variable.derivative is not None),
        tuple(v.name for v in found.modelVariables if v.causality == "input"),
        tuple(dict.fromkeys(u.variable.name for u in found.outputs)),
        chosen.providesDirectionalDerivative or "providesDirectionalDerivatives" in element_flags[kinds[0]],
        chosen.canGetAndSetFMUstate,
        getattr(chosen, "canHandleVariableCommunicationStepSize", True),
        _number(getattr(experiment, "stepSize", None)),
        _number(getattr(experiment, "startTime", None)) or 0.0,
        _number(getattr(experiment, "tolerance", None)) or 1e-6,
    )
    _require_runnable(library, interface)
    if interface.kind == MODEL_EXCHANGE and found.numberOfEventIndicators:
        raise ValueError(events(interface, f"{found.numberOfEventIndicators} event indicators", offered[CO_SIMULATION]))
    return interface


def events(interface: Interface, which: str, other: object = None) -> str:
    """The error for model exchange with events."""
    cure = f"pass kind={CO_SIMULATION!r}" if other is not None else "export it without events (noEvent, smooth)"
    return (
        f"{interface} has {which}; expected none: a plant is x' = f(t, x, u) without switching. Its filters would step over "
        f"events; {cure}"
    )


def _opened(path: Path) -> tuple[int, dict[str, set[str]]]:
    """The major version of FMI, and the capabilities that each interface states as true.

    FMPy 0.3 does not read providesDirectionalDerivatives of FMI 3.0.
    """
    from xml.etree import ElementTree

    expected = "expected a Functional Mock-up Unit (.fmu) of FMI 2.0 or 3.0"
    try:
        with ZipFile(path) as archive:
            root = ElementTree.fromstring(archive.read("modelDescription.xml"))
    except OSError as error:
        raise ValueError(f"{path} cannot be read ({error.strerror or error}); {expected}") from error
    except BadZipFile as error:
        raise ValueError(f"{path} is no zip archive; {expected}") from error
    except KeyError as error:
        raise ValueError(f"{path} has no modelDescription.xml; {expected}") from error
    except ElementTree.ParseError as error:
        raise ValueError(f"{path}: modelDescription.xml is no XML ({error}); {expected}") from error
    stated = str(root.get("fmiVersion"))
    if not re.match(r"2\.0|3\.", stated):
        raise ValueError(f"{path} is of FMI {stated}; {expected}: export it again")
    flags = {
        kind: {name for element in root.findall(tag) for name, value in element.attrib.items() if value in ("true", "1")}
        for kind, tag in ELEMENTS.items()
    }
    return int(stated[0]), flags


def _require_runnable(library: Any, interface: Interface) -> None:
    """Raise ValueError unless the FMU has a library for this platform."""
    has, here = library.supported_platforms(interface.path), library.platform
    if here not in has:
        binaries = ", ".join(p for p in has if p != "c-code") or "none"
        cure = "compile its sources with `fmpy compile`" if "c-code" in has else f"export it for {here}"
        raise ValueError(f"{interface} has libraries for these platforms: {binaries}; expected one for {here}: {cure}")


def _variables(found: Any) -> dict[str, Variable]:
    units = {u.name: u for u in found.unitDefinitions}
    rates = {u.variable.derivative.name: u.variable.valueReference for u in found.derivatives if u.variable.derivative}
    return {v.name: _variable(v, units, rates.get(v.name)) for v in found.modelVariables}


def _variable(v: Any, units: dict[str, Any], rate: int | None) -> Variable:
    def stated(what: str) -> Any:
        value = getattr(v, what, None)
        return getattr(v.declaredType, what, None) if value is None else value

    real = v.type in ("Real", "Float64") and not v.shape
    low, high, scale = (_number(stated(what)) for what in ("min", "max", "nominal"))
    name = stated("unit") or ""
    return Variable(
        v.name,
        v.valueReference,
        unit_text(name, units.get(name)) if real else "1",
        f"{v.type}{list(v.shape) if v.shape else ''}",
        v.causality,
        _number(v.start) if real else v.start,
        -np.inf if low is None else low,
        np.inf if high is None else high,
        None if not scale else abs(scale),
        stated("quantity") or "",
        real and v.variability == "continuous",
        v.causality == "input" or (v.initial in ("exact", "approx") and v.variability != "constant"),
        rate,
    )


def unit_text(name: str, unit: Any = None) -> str:
    """A unit of FMI as it is written, W/(m2.K). One that is unknown is written in base units where the FMU defines it by these
    alone (without factor or offset); otherwise it stays as it is.
    """
    if not name:
        return "1"
    from fusion_sfdia.common.unit_texts import is_unknown

    base = getattr(unit, "baseUnit", None)
    if not is_unknown(name) or base is None or base.factor != 1.0 or base.offset != 0.0:
        return name
    return "*".join(f"{u}^{getattr(base, u)}" for u in BASE_UNITS if getattr(base, u)) or "1"


def _number(text: Any) -> float | None:
    """A number of the description; None where there is none, also for an array."""
    try:
        return None if text is None else float(text)
    except ValueError:
        return None


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__
