"""Detector: residuals of structural analysis with limits from healthy data, and consistency-based diagnosis.

The equations fall into minimal overdetermined sets (see structure); of a selection of them (see `selected`) one residual each
is computed (see sequences). One that exceeds its limit is a conflict: not all sensors that it reads are healthy. A diagnosis is
a set of sensors that meets every conflict (Reiter 1987; de Kleer and Williams 1987).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import floats, probability, shown, whole
from fusion_sfdia.common.errors import NotApplicableError
from fusion_sfdia.common.order_statistics import order_statistic
from fusion_sfdia.detectors.batch_detector import IsolatingDetector, TimeStep
from fusion_sfdia.detectors.detector import Decision, check_reading
from fusion_sfdia.detectors.structural_residuals.sequences import Sequences
from fusion_sfdia.detectors.structural_residuals.structure import Residual, computable, modules_of
from fusion_sfdia.logs.log_forms import as_log
from fusion_sfdia.plant.plant import Plant

Array = NDArray[Any]

CONTRADICTION = 1e6  # standard deviations: the residual of readings at which the equations have no value
FORGETTING = 1 - 1e-9  # a step must shrink an error by more than rounding; an integrator keeps it


class StructuralMemory(NamedTuple):
    """x: (..., R, S) the states that each residual integrates, SI. In sensor units (..., N): last, the last readings, NaN where
    missing; held, the last that there were; trusted, the last reconstruction. The two latter are nominal at first.
    """

    x: Array
    last: Array
    held: Array
    trusted: Array


@dataclass(frozen=True, eq=False)
class StructuralResiduals(IsolatingDetector):
    """Residuals of a plant that states its scalar equations, each with a limit, in standard deviations of its target's noise.

    A residual is computed when none of its readings is missing, and is CONTRADICTION where its equations have no value at them;
    its states are integrated with the last readings in place of missing ones. The residual reported for a sensor has the
    largest ratio to its limit among those that read it, in deviations of its own noise.

    Parameters
    ----------
    residuals : tuple of Residual (R,)
        Those that are computed.
    limits : array (R,)
        In standard deviations, see `fit`.
    max_faults : int, default 3
        Sensors of a diagnosis at most.

    Notes
    -----
    isolated: the smallest diagnosis of the residuals beyond their limits, of at most max_faults sensors, if it is unique;
    else none. A residual within its limit exonerates no sensor: how much of a fault it shows depends on the
    equations and on time. reconstruction: of isolated and missing readings the value computed without them, or else the last
    trusted, at first nominal. fault_size: reading less reconstruction. No state is estimated: estimate is the plant's x0.

    Examples
    --------
    >>> from fusion_sfdia import simulate
    >>> from fusion_sfdia.detectors import StructuralResiduals
    >>> from fusion_sfdia.plants import two_tanks
    >>> plant = two_tanks()
    >>> detector = StructuralResiduals.fit(plant, simulate(plant, 200, seeds=range(4), process_noise=True), false_alarm=0.01)
    >>> detector.limits.shape == (len(detector.residuals),)
    True
    """

    residuals: tuple[Residual, ...]
    limits: Array
    max_faults: int = 3

    def __post_init__(self) -> None:
        super().__post_init__()
        measured = {s.measures for s in self.plant.sensors} & set(modules_of(self.plant).equations)
        if not self.residuals or not all(isinstance(r, Residual) for r in self.residuals):
            raise ValueError(f"residuals is {shown(self.residuals)}; expected some; use selected(plant)")
        if unread := sorted({v for r in self.residuals for v in (*r.read, r.target)} - measured):
            raise ValueError(f"residuals read {', '.join(unread)}, which plant {self.plant.name!r} does not measure")
        object.__setattr__(self, "limits", floats("limits", self.limits))
        if self.limits.shape != (len(self.residuals),) or not np.all(self.limits > 0):
            raise ValueError(
                f"limits has shape {self.limits.shape}; expected {len(self.residuals)} positive numbers, one a residual; use "
                "StructuralResiduals.fit"
            )
        whole("max_faults", self.max_faults, least=1)

    @classmethod
    def fit(cls, plant: Plant, healthy: Any, false_alarm: float = 1e-3, **settings: Any) -> Self:
        """The selected residuals with limits from healthy readings, at a rate of false alarms per step over all residuals.

        A limit is the residual's unit times a common factor. Of every other sample in time: the unit is the order statistic
        that the residual exceeds with its share of the rate. Of the rest: the factor is the order statistic of the largest
        residual in these units. Samples with a missing reading are left out.

        Parameters
        ----------
        plant : Plant
            Which states its scalar equations.
        healthy : Recording, Log, frame or tuple
            Readings plant.dt apart, in any form that `as_log` takes.
        false_alarm : float, default 1e-3
            The rate.
        **settings
            Of the detector, by name.

        Returns
        -------
        Self
            The fitted detector.

        Raises
        ------
        NotApplicableError
            For a plant that does not state its scalar equations or has no residual.
        MissingPackageError
            Without faultdiagnosistoolbox.
        ValueError
            For data that do not fit or are too few.
        """
        probability("false_alarm", false_alarm)
        if not (residuals := selected(plant)):
            raise NotApplicableError(f"plant {plant.name!r} has no residual that its own equations can compute; add sensors")
        t, y, u = as_log(plant, healthy)
        if not np.allclose(np.diff(t), plant.dt, rtol=1e-6, atol=8 * np.spacing(np.max(np.abs(t)))):
            raise ValueError(
                f"the healthy readings are not {plant.dt:g} s apart, the step of plant {plant.name!r}; resample them"
            )
        watcher = cls(plant, residuals, np.ones(len(residuals)), **settings)
        size = np.abs(watcher.trace(y, u)).reshape(len(y), -1, len(residuals))
        units, rest = (part[np.all(np.isfinite(part), axis=-1)] for part in (size[::2], size[1::2]))
        if len(rest) * false_alarm < 1 or not len(units):
            raise ValueError(
                f"{len(rest)} complete healthy samples cannot set limits that one in {1 / false_alarm:.0f} exceeds; give twice "
                "that many (every other one is used for that), or choose a higher false-alarm rate"
            )
        unit = order_statistic(units, false_alarm / len(residuals))
        if not np.all(unit > 0):
            raise ValueError("residuals of the healthy readings are 0; record them with their noise")
        limits = unit * order_statistic(np.max(rest / unit, axis=-1), false_alarm)
        return replace(watcher, limits=limits, fitted_rate=false_alarm)

    def trace(self, y: Array, u: Array) -> Array:
        """Return the residuals of readings, plant.dt apart.

        Parameters
        ----------
        y : array (K, ..., N)
            Readings.
        u : array (K, ..., m)
            Inputs that acted until then.

        Returns
        -------
        array (K, ..., R)
            In standard deviations.
        """
        y, u = floats("y", y), floats("u", u)
        if y.ndim < 2 or not y.size or u.shape[:1] != y.shape[:1]:
            raise ValueError(f"y has shape {y.shape}, u {u.shape}; expected (K, ..., sensors) and (K, ..., inputs)")
        batch = y.shape[1:-1]
        memory, found = self._start((int(np.prod(batch)),), 0), []
        for reading, applied in zip(y, u, strict=True):
            checked = check_reading(self.plant, reading, applied, batch)
            now, acting = (a.reshape(-1, a.shape[-1]) for a in checked)
            memory, residual, _ = self._follow(memory, self.plant.dt, now, acting)
            found.append(residual.reshape(*batch, -1))
        return np.stack(found)

    @cached_property
    def _sequences(self) -> Sequences:
        return Sequences(modules_of(self.plant), self.residuals)

    @cached_property
    def _reads(self) -> Array:
        return reads(self.plant, self.residuals)

    @cached_property
    def _target(self) -> Array:
        """The sensor of each residual (R,)."""
        names = [s.measures for s in self.plant.sensors]
        return np.array([names.index(r.target) for r in self.residuals])

    @cached_property
    def _nominal(self) -> Array:
        """Nominal readings (N,)."""
        return np.array([modules_of(self.plant).nominal[s.measures] for s in self.plant.sensors]) * self.plant.sensor_scale

    @cached_property
    def _candidates(self) -> list[tuple[Array, Array]]:
        """Sets of sensors by size (C, N), and which residuals they leave unexplained (C, R)."""
        n, found = len(self.plant.sensors), []
        for size in range(1, min(self.max_faults, n) + 1):
            chosen = np.array([[i in members for i in range(n)] for members in combinations(range(n), size)])
            found.append((chosen, np.all(~(chosen[:, None] & self._reads), axis=-1)))
        return found

    def _by_variable(self, y: Array) -> Array:
        """Readings (B, N) in SI by variable (E, B), NaN of those without a sensor."""
        variables = tuple(modules_of(self.plant).equations)
        found = np.full((len(variables), len(y)), np.nan)
        found[[variables.index(s.measures) for s in self.plant.sensors]] = (y / self.plant.sensor_scale).T
        return found

    def _start(self, batch: tuple[int, ...], seed: int) -> StructuralMemory:
        modules, n = modules_of(self.plant), self._nominal
        x = np.tile([modules.nominal[v] for v in modules.states], (len(self.residuals), 1))
        start = StructuralMemory(x, np.full_like(n, np.nan), n, n)
        return StructuralMemory(*(np.broadcast_to(a, (*batch, *a.shape)).copy() for a in start))

    def _follow(self, memory: StructuralMemory, dt: float, y: Array, u: Array) -> tuple[StructuralMemory, Array, Array]:
        """The memory after readings y (B, N) under u (B, m), the residuals and the computed values of their targets (B, R)."""
        x, before, held, trusted = memory
        now = np.where(np.isfinite(y), y, held)
        si, acting = self._by_variable(now), np.ascontiguousarray(u.T)
        states = np.ascontiguousarray(np.moveaxis(x, 0, -1))
        states = self._sequences.advance(states, self._by_variable(before), self._by_variable(held), si, acting, dt)
        computed = (
            self._sequences.predicted(states, si, acting).T
            * np.broadcast_to(self.plant.sensor_scale, y.shape[-1])[self._target]
        )
        missing = (np.isnan(y)[:, None] & self._reads).any(axis=-1)
        residual = (now[:, self._target] - computed) / self.plant.sensor_sigma[self._target]
        residual = np.where(missing, np.nan, np.where(np.isfinite(residual), residual, CONTRADICTION))
        return StructuralMemory(np.moveaxis(states, -1, 0).copy(), y.copy(), now, trusted), residual, computed

    def _judge(self, memory: StructuralMemory, now: TimeStep, y: Array, u: Array) -> tuple[StructuralMemory, Decision]:
        followed, residual, computed = self._follow(memory, now.dt, y, u)
        limits = self.limits * self.threshold_scale
        ratio = np.where(np.isfinite(residual), np.abs(residual) / limits, -1.0)
        isolated = self._diagnosed(ratio > 1)
        shown = np.argmax(np.where(self._reads, ratio[..., None], -2.0), axis=1)
        sigma, read = self.plant.sensor_sigma, self._reads.any(axis=0)
        reconstruction = self._accommodated(y, followed.trusted, isolated | np.isnan(y), computed)
        decision = Decision(
            estimate=np.broadcast_to(self.plant.x0, (len(y), self.plant.x0.size)).copy(),
            reconstruction=reconstruction,
            residual=np.where(read, np.take_along_axis(residual, shown, axis=1) * sigma, np.nan),
            threshold=np.where(read, limits[shown] * sigma, np.inf),
            isolated=isolated,
            fault_size=np.where(isolated, y - reconstruction, np.nan),
            diverged=np.zeros(len(y), bool),
            guarded=np.zeros(len(y), bool),
            nis=np.full(len(y), np.nan),
        )
        return followed._replace(trusted=reconstruction), decision

    def _diagnosed(self, fired: Array) -> Array:
        """The smallest diagnosis (B, N) of residuals that fire (B, R), empty where it is not unique or too large."""
        found = np.zeros((len(fired), self._reads.shape[1]), bool)
        rows = np.flatnonzero(fired.any(axis=1))
        for chosen, unexplained in self._candidates:
            if not rows.size:
                break
            diagnoses = np.all(~(fired[rows][:, None] & unexplained), axis=-1)
            count = diagnoses.sum(axis=1)
            found[rows[count == 1]] = chosen[np.argmax(diagnoses[count == 1], axis=1)]
            rows = rows[count == 0]
        return found

    def _accommodated(self, y: Array, trusted: Array, lost: Array, computed: Array) -> Array:
        """Readings (B, N), the lost ones from the first residual that computes them without lost ones, or the last good."""
        reconstruction = np.where(lost, trusted, y)
        for k in reversed([k for k, r in enumerate(self.residuals) if not r.target_is_read]):
            i, others = self._target[k], self._reads[k].copy()
            others[i] = False
            known = ~(lost & others).any(axis=-1) & np.isfinite(computed[:, k])
            reconstruction[:, i] = np.where(lost[:, i] & known, computed[:, k], reconstruction[:, i])
        return reconstruction


def usable(plant: Plant) -> tuple[Residual, ...]:
    """Return the computable residuals whose states forget their errors, the simplest first; raises as `structural_model`.

    Stability is that of a step of plant.dt at the nominal values. A target that is a state without it, as where a level
    integrates measured flows, gets the feedback of its observer. A residual that would integrate the noise of other
    sensors without bound is not used.
    """
    found = computable(plant)
    forget = _forget(plant, found)
    found = tuple(r if ok else replace(r, feedback=r.target in r.integrated) for r, ok in zip(found, forget, strict=True))
    return tuple(r for r, ok in zip(found, _forget(plant, found), strict=True) if ok)


def _forget(plant: Plant, residuals: tuple[Residual, ...]) -> Array:
    if not residuals:
        return np.zeros(0, bool)
    u = np.array([s.nominal for s in plant.inputs])
    return Sequences(modules_of(plant), residuals).forgetting(u, plant.dt) < FORGETTING


def reads(plant: Plant, residuals: Sequence[Residual]) -> Array:
    """Return the fault signature matrix (R, N): which residuals read which sensors."""
    found = [[s.measures in r.read for s in plant.sensors] for r in residuals]
    return np.array(found, bool).reshape(len(residuals), len(plant.sensors))


def isolable(signatures: Array) -> Array:
    """Return whether fault i is isolable from fault j (N, N): a residual (R, N) reads sensor i and not j. On the diagonal:
    whether fault i is detectable.
    """
    others = ~signatures[:, None, :] | np.eye(signatures.shape[1], dtype=bool)
    return np.asarray((signatures[:, :, None] & others).any(axis=0))


def selected(plant: Plant) -> tuple[Residual, ...]:
    """Return, for each pair of sensors, the simplest usable residual that reads the one and not the other; raises as `usable`.

    The simplest has the fewest sensors, then the first of the two as its target, then the fewest equations. Together they
    isolate what all usable ones do. Few sensors rather than few residuals, as a minimal hitting set would have
    (`TestSelection` of the toolbox): each sensor that is read adds its noise and hides part of the other sensors'
    faults. The fault of a target enters the residual in full, that of another sensor as far as the equations transmit it.
    """
    residuals = usable(plant)
    signatures = reads(plant, residuals)
    chosen = set()
    for i, sensor in enumerate(plant.sensors):
        simplest = sorted(
            np.flatnonzero(signatures[:, i]), key=lambda k: (len(residuals[k].read), residuals[k].target != sensor.measures)
        )
        for j in range(len(plant.sensors)):
            chosen.update([k for k in simplest if j == i or not signatures[k, j]][:1])
    return tuple(residuals[k] for k in sorted(chosen))
