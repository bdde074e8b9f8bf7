"""An FMU as plants carry it to other processes, and one that is open in this process: its library, its folder, one instance."""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from collections import deque
from collections.abc import Callable
from ctypes import POINTER, c_double, c_uint32, cast
from dataclasses import dataclass, fields
from functools import cached_property
from hashlib import sha256
from multiprocessing.util import Finalize
from pathlib import Path
from threading import RLock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.plant.fmu.interface import MODEL_EXCHANGE, Interface, events, fmpy
from fusion_sfdia.plant.integration import runge_kutta_4

Array = NDArray[Any]
DISCARD = 2  # the status of a call that has no result at these values
UPDATES = 100  # of discrete states before the simulation begins


def _freed(model: Any, snapshots: list[Any], folder: str) -> None:
    """Free an instance, its library and its folder."""
    try:
        if model is not None:
            for snapshot in snapshots:
                model.freeFMUState(snapshot)
            model.freeInstance()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


class Instance:
    """One instance in this process, and what is set in it."""

    def __init__(self, fmu: Fmu) -> None:
        self.of, self.lock = fmu, RLock()
        self.interface = interface = fmu.interface
        self.messages = messages = deque[str](maxlen=3)  # of the logger, which must not hold this instance
        self.initialised: bytes | None = None  # the parameters for which the FMU is, of model exchange
        self.snapshots: list[Any] = []  # of the FMU as it is instantiated, of co-simulation
        library, folder = fmpy(), tempfile.mkdtemp(prefix="fusion-sfdia-fmu-")
        self.failed = library.fmi1.FMICallException
        self.model: Any = None
        here = Path.cwd()  # FMPy leaves it where a library fails to load
        try:
            library.extract(interface.path, folder)
            self.model = library.instantiate_fmu(
                folder,
                library.read_model_description(interface.path, validate=False),
                "ModelExchange" if interface.kind == MODEL_EXCHANGE else "CoSimulation",
                logger=lambda *message: messages.append(message[-1].decode(errors="replace")),
            )
            if interface.kind != MODEL_EXCHANGE:
                self.snapshots.append(self.model.getFMUState())
        except Exception as error:  # FMPy and ctypes raise errors of many kinds
            raise ValueError(
                f"{interface} cannot be started ({error}{self._said()}); expected a library that runs on this machine: try "
                "`fmpy simulate` with it, and install what it needs"
            ) from error
        finally:
            os.chdir(here)
            # runs once, in this process alone, also at the end of a worker process, where weakref.finalize does not
            self.close = Finalize(self, _freed, (self.model, self.snapshots, folder), exitpriority=0)
            if self.model is None:
                self.close()
        version = interface.version
        groups = (fmu.states, fmu.rates, fmu.inputs, fmu.outputs, fmu.parameters, (*fmu.states, *fmu.inputs))
        self.states, self.rates, self.inputs, self.outputs, self.parameters, self.known = (
            Reals(self.model, version, references) for references in groups
        )
        self.computed = Reals(self.model, version, tuple(r for r in fmu.outputs if r not in fmu.states))
        if interface.kind == MODEL_EXCHANGE:
            name = "getDerivatives" if version == 2 else "getContinuousStateDerivatives"
            self.differentiate: Callable[..., None] = getattr(self.model, name)

    def guarded(self, call: Callable[..., Array], *arguments: Any) -> Any:
        """The result of a call; NaN where the FMU discards it. ArithmeticError where it fails."""
        self.messages.clear()
        try:
            return call(*arguments)
        except self.failed as error:
            self.initialised = None  # begin again with a reset
            if error.status == DISCARD:
                return np.nan
            raise ArithmeticError(f"{self.interface} fails: {error}{self._said()}") from error

    # evaluations: of model exchange

    def derivatives(self, t: float, x: Array, u: Array, theta: Array) -> Array:
        """dx/dt (n,)."""
        self._set_point(t, x, u, theta)
        return self._derivatives()

    def advanced(self, t: float, dt: float, substeps: int, x: Array, u: Array, theta: Array) -> Array:
        """The states (n,) dt seconds later, by Runge-Kutta 4."""
        return _integrated(lambda s, p: self.derivatives(s, p, u, theta), t, x, dt, substeps)

    def advanced_tangent(self, t: float, dt: float, substeps: int, x: Array, u: Array, theta: Array) -> Array:
        """Derivatives (n, n + m) of that with respect to x and u: dX/dt = A X + [0 B], from X = [I 0]."""
        n, m = x.size, u.size

        def slope(s: float, both: Array) -> Array:
            found = self.tangents(s, both[:, 0], u, theta)
            found[:, 1 + n :] += found[:, 1 : 1 + n] @ both[:, 1 + n :]
            found[:, 1 : 1 + n] = found[:, 1 : 1 + n] @ both[:, 1 : 1 + n]
            return found

        start = np.concatenate([x[:, None], np.eye(n), np.zeros((n, m))], axis=1)
        return _integrated(slope, t, start, dt, substeps)[:, 1:]

    def readings(self, t: float, x: Array, u: Array, theta: Array) -> Array:
        """The outputs (N,)."""
        self._set_point(t, x, u, theta)
        return self.outputs.read()

    def tangents(self, t: float, x: Array, u: Array, theta: Array) -> Array:
        """dx/dt and its derivatives with respect to x and u, (n, 1 + n + m)."""
        self._set_point(t, x, u, theta)
        return np.concatenate([self._derivatives()[:, None], self.rates.derivatives(self.known)], axis=1)

    def output_tangents(self, t: float, x: Array, u: Array, theta: Array) -> Array:
        """Derivatives (N, n + m) of the outputs with respect to x and u; FMI gives none of outputs that are states."""
        self._set_point(t, x, u, theta)
        outputs, states = self.of.outputs, self.of.states
        found = np.zeros((len(outputs), x.size + u.size))
        for i, reference in enumerate(outputs):
            if reference in states:
                found[i, states.index(reference)] = 1.0
        found[[reference not in states for reference in outputs]] = self.computed.derivatives(self.known)
        return found

    # of co-simulation

    def ahead(self, t: float, dt: float, x: Array, u: Array, theta: Array) -> Array:
        """The states (n,) dt seconds later."""
        self.model.doStep(self._start(theta, t, x, u), dt)
        return self.states.read()

    def outputs_at(self, t: float, x: Array, u: Array, theta: Array) -> Array:
        """The outputs (N,)."""
        self._start(theta, t, x, u)
        return self.outputs.read()

    def twice(self, t: float, dt: float, x: Array, u: Array, theta: Array) -> Array:
        """The states and outputs (n + N,) after two steps in a row."""
        first = self._start(theta, t, x, u)
        self.model.doStep(first, dt)
        self.model.doStep(first + dt, dt)
        return np.concatenate([self.states.read(), self.outputs.read()])

    def initial(self, of: str, theta: Array) -> Array:
        """The values of states, inputs or outputs after initialisation."""
        self._start(theta, self.interface.start_time)
        found: Array = getattr(self, of).read()
        return found

    # calls of FMI

    def _start(self, theta: Array, t: float, x: Array | None = None, u: Array | None = None) -> float:
        """Initialise the FMU at t with these parameters, and states and inputs where they are given; return that time.

        A time before the start of the FMU's default experiment is taken as its start.
        """
        model, version, t = self.model, self.interface.version, max(float(t), self.interface.start_time)
        if self.snapshots:
            model.setFMUState(self.snapshots[0])
        else:
            model.reset()
        for setter, reference, value in self.of.start:
            getattr(model, setter)([reference], [value])
        self.parameters.write(theta)
        if x is not None:
            self.states.write(x)
        if u is not None:
            self.inputs.write(u)
        if version == 2:
            model.setupExperiment(startTime=t, tolerance=self.interface.tolerance)
            model.enterInitializationMode()
        else:
            model.enterInitializationMode(startTime=t, tolerance=self.interface.tolerance)
        model.exitInitializationMode()
        if self.interface.kind == MODEL_EXCHANGE:
            self._settle(model.newDiscreteStates if version == 2 else model.updateDiscreteStates)
            model.enterContinuousTimeMode()
            self.initialised = theta.tobytes()
        return t

    def _settle(self, update: Callable[[], Any]) -> None:
        """Update discrete states until they stay; ValueError for an event in the future."""
        for _ in range(UPDATES):
            again, ended, _, _, timed, at = update()
            if timed:
                raise ValueError(events(self.interface, f"an event at {at:g} s"))
            if ended or not again:
                return

    def _set_point(self, t: float, x: Array, u: Array, theta: Array) -> None:
        """Set time, states, inputs and parameters, of model exchange."""
        first = self.interface.start_time
        if self.initialised != theta.tobytes():
            self._start(theta, first)
        self.model.setTime(max(float(t), first))
        self.states.array[:] = x
        self.model.setContinuousStates(self.states.values, self.states.size)
        self.inputs.write(u)

    def _derivatives(self) -> Array:
        self.differentiate(self.rates.values, self.rates.size)
        return self.rates.array.copy()

    def _said(self) -> str:
        return f"; it reports: {' '.join(' '.join(self.messages).split())}" if self.messages else ""


def _integrated(slope: Callable[[float, Array], Array], t: float, x: Array, dt: float, substeps: int) -> Array:
    part = dt / substeps
    for i in range(substeps):
        x = runge_kutta_4(slope, t + i * part, x, part)
    return x


@dataclass(frozen=True, eq=False)
class Fmu:
    """An FMU with the variables that a plant uses, by value references, and the values that it starts from.

    digest: SHA-256 of the file, which another process must find unchanged. start: (setter of FMPy, reference, value) of each.
    parameters: those that are set for each evaluation.
    """

    interface: Interface
    digest: str
    states: tuple[int, ...]
    rates: tuple[int, ...]
    inputs: tuple[int, ...]
    outputs: tuple[int, ...]
    parameters: tuple[int, ...] = ()
    start: tuple[tuple[str, int, Any], ...] = ()

    @cached_property
    def _opened(self) -> list[Any]:
        return [0, None]  # the process, the instance

    def __getstate__(self) -> dict[str, Any]:
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def instance(self) -> Instance:
        """The instance in this process, opened at first use; ValueError where the file is not what it was."""
        if self._opened[0] != os.getpid():  # a copy of the memory of another process is no instance
            self._require_file()
            self._opened[:] = os.getpid(), Instance(self)
        found: Instance = self._opened[1]
        return found

    def _require_file(self) -> None:
        path = self.interface.path
        if not path.is_file() or digest_of(path) != self.digest:
            raise ValueError(
                f"{self.interface} is not there any more, or another file; expected that of which the plant was made: put it "
                "back, or make the plant again"
            )

    def initial(self, of: str, theta: Array) -> Array:
        """The values of its states, inputs or outputs after initialisation; ValueError where that fails."""
        instance = self.instance()
        try:
            found: Array = instance.guarded(instance.initial, of, theta)
        except ArithmeticError as error:
            raise ValueError(
                f"{error}; expected an FMU that initialises: correct its start values, start_values={{...}}"
            ) from error
        if not np.all(np.isfinite(found)):
            raise ValueError(f"{self.interface} has {of} that are not finite at its start; correct its start values")
        return found

    def each(self, evaluation: str, shape: tuple[int, ...], x: Array, u: Array, theta: Array, *times: float) -> Array:
        """Evaluate an instance for each row of a batch: x (..., n), u (..., m) and theta (..., p) to (..., *shape).

        NaN for rows that are not finite and for those of which the FMU says that they have no result. TypeError for numbers
        that are not real.
        """
        arrays = [_real(a) for a in (x, u, theta)]
        batch = np.broadcast_shapes(*(a.shape[:-1] for a in arrays))
        count = math.prod(batch)
        rows = [np.broadcast_to(a, (*batch, a.shape[-1])).reshape(count, a.shape[-1]) for a in arrays]
        out = np.full((count, *shape), np.nan)
        instance = self.instance()
        finite = np.logical_and.reduce([np.isfinite(a).all(axis=1) for a in rows])
        with instance.lock:
            call: Callable[..., Array] = getattr(instance, evaluation)
            for i in np.flatnonzero(finite):
                out[i] = instance.guarded(call, *times, *(a[i] for a in rows))
        return out.reshape(*batch, *shape)


def digest_of(path: Path) -> str:
    """SHA-256 of a file."""
    return sha256(path.read_bytes()).hexdigest()


def _real(a: Array) -> Array:
    if np.asarray(a).dtype.kind not in "biuf":
        raise TypeError(f"an FMU takes real numbers, not {np.asarray(a).dtype}")
    return np.asarray(a, dtype=float)


class Reals:
    """Variables (k,) of an instance of FMPy by their value references; version: 2 or 3 of FMI."""

    def __init__(self, model: Any, version: int, references: tuple[int, ...]) -> None:
        self.size, self.component = len(references), model.component
        self.references = (c_uint32 * self.size)(*references)
        self.array: Array = np.zeros(self.size)
        self.values = cast(self.array.ctypes.data, POINTER(c_double))
        self.each = [(c_uint32 * 1)(reference) for reference in references]
        self.last = () if version == 2 else (self.size,)  # FMI 3.0 also states the number of values
        self.seed = ((c_double * 1)(1.0), 1)[: version - 1]
        kind = "Real" if version == 2 else "Float64"
        self.getter, self.setter = (getattr(model, f"fmi{version}{verb}{kind}") for verb in ("Get", "Set"))
        self.directional = getattr(model, f"fmi{version}GetDirectionalDerivative")

    def read(self) -> Array:
        """Their values (k,)."""
        if self.size:
            self.getter(self.component, self.references, self.size, self.values, *self.last)
        return self.array.copy()

    def write(self, values: Array) -> None:
        """Set them to values (k,)."""
        if self.size:
            self.array[:] = values
            self.setter(self.component, self.references, self.size, self.values, *self.last)

    def derivatives(self, known: Reals) -> Array:
        """Their derivatives with respect to others (k, m), as the FMU gives them, one direction at a time."""
        found = np.empty((self.size, known.size))
        if self.size:
            for j, by in enumerate(known.each):
                self.directional(self.component, self.references, self.size, by, 1, *self.seed, self.values, *self.last)
                found[:, j] = self.array
        return found
