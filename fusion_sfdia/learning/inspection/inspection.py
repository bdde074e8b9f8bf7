"""What an inspection of a plant found, as data, as a page of text, and as JSON."""

from __future__ import annotations

from dataclasses import dataclass
from textwrap import wrap
from typing import Any

import numpy as np

from fusion_sfdia.detectors.kalman_banks.identifiability import IdentifiabilityResult
from fusion_sfdia.learning.inspection.detectability import BIAS_WITHIN, CASES, DRIFT_WITHIN, GROWTH, Promise, Tried
from fusion_sfdia.learning.inspection.healthy import OnHealthy
from fusion_sfdia.learning.inspection.observability import Observability
from fusion_sfdia.learning.inspection.plant_findings import MISTAKE, REMARK, PlantFinding
from fusion_sfdia.learning.inspection.stepping import Stepping
from fusion_sfdia.learning.inspection.structure import Structural
from fusion_sfdia.plant.plant import Plant

WIDTH = 110


@dataclass(frozen=True, repr=False)
class Inspection:
    """What `inspect` found: findings, the mistakes first, and what they rest on; None where it was not examined.

    Attributes
    ----------
    plant : Plant
        The plant examined.
    findings : tuple of PlantFinding
        The mistakes first.
    derivatives : tuple of (str, str)
        How the Jacobians of step and output are found.
    step : Stepping or None
        The step of the plant.
    readings : Observability or None
        What the readings show of the states.
    theory : IdentifiabilityResult or None
        Which faults can be distinguished.
    promise : Promise or None
        From what size faults are found, by theory.
    detectors : tuple of Tried
        What detectors find in simulated runs.
    structure : Structural or None
        Redundancy by the scalar equations.
    healthy : OnHealthy or None
        What the readings of the real plant show.

    Examples
    --------
    See `inspect`.
    """

    plant: Plant
    findings: tuple[PlantFinding, ...]
    derivatives: tuple[str, str] = ("", "")
    step: Stepping | None = None
    readings: Observability | None = None
    theory: IdentifiabilityResult | None = None
    promise: Promise | None = None
    detectors: tuple[Tried, ...] = ()
    structure: Structural | None = None
    healthy: OnHealthy | None = None

    @property
    def mistakes(self) -> tuple[PlantFinding, ...]:
        """What has to be corrected before any diagnosis."""
        return tuple(f for f in self.findings if f.kind == MISTAKE)

    @property
    def remarks(self) -> tuple[PlantFinding, ...]:
        """What to know about the diagnosis of this plant."""
        return tuple(f for f in self.findings if f.kind == REMARK)

    @property
    def kept_out(self) -> tuple[str, ...]:
        """Sensors that detectors which exclude sensors may never use again on their own."""
        return () if self.readings is None else self.readings.redundancy.indispensable

    @property
    def verdict(self) -> str:
        """One line for the whole plant."""
        count = len(self.mistakes)
        if count:
            return f"{self.plant.name}: NOT READY, {count} mistake{'s' * (count != 1)} to correct"
        more = len(self.remarks)
        return f"{self.plant.name}: ready for diagnosis" + (f", {more} remark{'s' * (more != 1)}" if more else "")

    def __str__(self) -> str:
        return as_text(self)

    def __repr__(self) -> str:
        return f"<Inspection of {self.verdict}>"


def as_text(found: Inspection) -> str:
    """The verdict, mistakes and remarks, the model, and which faults are found."""
    plant = found.plant
    kinds = (("sensor", plant.sensors), ("state", plant.states), ("input", plant.inputs))
    counts = ", ".join(f"{len(of)} {kind}{'s' * (len(of) != 1)}" for kind, of in kinds)
    lines = [found.verdict, f"{counts}, a reading every {plant.dt:g} s"]
    for title, findings in (("Mistakes: correct them first", found.mistakes), ("Remarks", found.remarks)):
        if findings:
            lines += ["", title]
            for finding in findings:
                lines += wrap(str(finding), WIDTH, initial_indent="  - ", subsequent_indent="    ")
    if not found.mistakes:
        lines += ["", "Model", *(f"  {what:<16}{text}" for what, text in _model(found))]
    if found.theory is not None or found.detectors:
        lines += ["", "Which sensor faults are found, and how", *_faults(found)]
    return "\n".join(lines)


def _model(found: Inspection) -> list[tuple[str, str]]:
    step, output = found.derivatives
    lines = [("derivatives", step if step == output else f"of the step: {step}; of the readings: {output}")]
    if found.step is not None and np.any(np.isfinite(found.step.rates)):
        decay = np.sort(1 / np.maximum(np.abs(found.step.rates.real), 1e-300))
        slowest = f"{decay[-1]:.3g} s" if decay[-1] < 1e12 else "none (an integrator)"
        holds = "any length that was tried" if np.isinf(found.step.holds) else f"{found.step.holds:g} s"
        lines.append(("time constants", f"fastest {decay[0]:.3g} s, slowest {slowest}; the step holds up to {holds}"))
    if found.readings is not None:
        r = found.readings
        lines.append(
            (
                "states",
                f"{r.rank} of {r.states} determined by {r.samples} readings of all sensors (condition {r.condition:.2g})",
            )
        )
        lines.append(
            ("at once", f"{r.redundancy.faults} of {len(found.plant.sensors)} sensors may fail: {r.redundancy.reason}")
        )
        if r.learning.faults < r.redundancy.faults:
            lines.append(("", f"{r.learning.faults} while the declared unknowns are to be learnt, too: {r.learning.reason}"))
        limits = ", ".join(f"{t.detector} {t.most_faults}" for t in found.detectors if t.most_faults)
        lines += [("isolated", f"at once, at most: {limits}")] if limits else []
        lines.append(("readmission", f"never on their own: {', '.join(found.kept_out) or 'none'}"))
    if (pattern := found.structure) is not None:
        seen = pattern.left_out and f"not analysed: {pattern.left_out}"
        groups = "; ".join(" and ".join(g) for g in pattern.groups)
        lost = ", ".join(pattern.undetectable)
        isolable = "every fault is told from every other" if not (groups or lost) else f"not told apart: {groups or 'none'}"
        lines.append(("equations", seen or isolable + (f"; not detectable: {lost}" if lost else "")))
    if found.healthy is not None:
        h = found.healthy
        lines.append(
            ("healthy log", f"{h.samples} readings, normalised innovation squared {h.white.nis:.2f} (1 expected), "
             f"{len(h.events)} events of {h.detector}")
        )  # fmt: skip
    return lines


def _faults(found: Inspection) -> list[str]:
    plant, theory, tried = found.plant, found.theory, [t for t in found.detectors if not t.left_out]
    lines = []
    if theory is not None:
        lines.append(f"  theory: smallest size, in sigma of the sensor, that {theory.samples} readings show and tell apart")
    if found.promise is not None:
        lines.append(
            "  promised: size in sigma from which robust-glr isolates the sensor alone in 9 of 10 runs, a bias within "
            f"{BIAS_WITHIN}"
        )
        lines.append(f"  readings, a drift over {GROWTH} readings within {DRIFT_WITHIN}")
    if tried:
        lines.append(
            "  detectors: smallest simulated size in sigma / samples until its sensor alone was isolated; - for not found,"
        )
        lines.append("  with what was named instead")
    shown = {t.sensor for of in tried for t in of.trials}
    names = [n for n in plant.sensor_names if n in shown] if shown else list(plant.sensor_names)
    if len(names) < len(plant.sensors):
        lines.append(f"  simulated for {len(names)} of {len(plant.sensors)} sensors; name others to have them tried")
    for kind in dict.fromkeys(kind for kind, _ in CASES):
        of_theory = {} if theory is None else _theory(found, kind)
        of_promise = _promise(found, kind)
        columns = (["theory"] if of_theory else []) + (["promised"] if of_promise else []) + [t.detector for t in tried]
        if not columns:
            continue
        rows = [[kind, "sigma", *columns]]
        for name in names:
            i = plant.sensor_index(name)
            own = [of[name] for of in (of_theory, of_promise) if of]
            rows.append([name, _noise(plant, i), *own, *(_cell(t, name, kind) for t in tried)])
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines += ["", *("  " + "  ".join(f"{c:<{w}}" for c, w in zip(row, widths, strict=True)).rstrip() for row in rows)]
    left = [f"  {t.detector}: {t.left_out}" for t in found.detectors if t.left_out]
    return (
        lines
        + ([""] if left else [])
        + [part for text in left for part in wrap(text, WIDTH, initial_indent="  ", subsequent_indent="    ")]
    )


def _noise(plant: Plant, i: int) -> str:
    """The noise that a sensor states, in words."""
    slow = plant.sensors[i].noise
    part = f", {100 * slow.share:.0f} % slow ({slow.time_constant:.3g} s)" if slow is not None and slow.share else ""
    return f"{plant.sensor_sigma[i]:.3g} {plant.sensors[i].unit}{part}"


def _theory(found: Inspection, kind: str) -> dict[str, str]:
    theory = found.theory
    assert theory is not None
    if kind == "freeze":
        return {}
    between = np.abs(theory.between) - np.eye(len(theory.sensors))
    rival = np.maximum(np.max(between, axis=-1, initial=0.0), theory.overlap)
    with np.errstate(divide="ignore"):
        apart = theory.bias / np.sqrt(np.maximum(1 - rival**2, 0.0))
    size = apart if kind == "bias" else theory.drift
    return {name: f"{s:.2g}" if np.isfinite(s) else "none" for name, s in zip(theory.sensors, size, strict=True)}


def _promise(found: Inspection, kind: str) -> dict[str, str]:
    if found.promise is None or kind == "freeze":
        return {}
    size = found.promise.bias if kind == "bias" else found.promise.drift
    return {name: f"{s:.2g}" if np.isfinite(s) else "none" for name, s in zip(found.plant.sensor_names, size, strict=True)}


def _cell(of: Tried, sensor: str, kind: str) -> str:
    if (best := of.best(sensor, kind)) is not None:
        return f"{best.delay:.0f}" if np.isnan(best.size) else f"{best.size:g} / {best.delay:.0f}"
    instead = [t.instead for t in of.trials if (t.sensor, t.kind) == (sensor, kind) and t.instead]
    return f"- ({instead[-1]})" if instead else "-"


def as_json(found: Inspection) -> dict[str, Any]:
    """The whole inspection in lists, texts and numbers; null for what is not finite."""
    theory = found.theory
    return {
        "plant": found.plant.name,
        "verdict": found.verdict,
        "ready": not found.mistakes,
        "findings": _plain(found.findings),
        "derivatives": {"step": found.derivatives[0], "output": found.derivatives[1]},
        "step": _plain(found.step),
        "readings": _plain(found.readings),
        "never_readmitted_on_their_own": list(found.kept_out),
        "structure": _plain(found.structure),
        "theory": None if theory is None else {
            "samples": theory.samples,
            **{
                name: {"bias": _plain(theory.bias[i]), "drift": _plain(theory.drift[i]), "looks_like": theory.rival[i],
                       "told_apart": _plain(theory.told_apart[i]), "rho": _plain(theory.overlap[i])}
                for i, name in enumerate(theory.sensors)
            },
        },
        "promised": None if found.promise is None else {
            name: {"bias": _plain(found.promise.bias[i]), "drift": _plain(found.promise.drift[i])}
            for i, name in enumerate(found.plant.sensor_names)
        },
        "detectors": _plain(found.detectors),
        "healthy": _plain(found.healthy),
    }  # fmt: skip


def _plain(value: Any) -> Any:
    if hasattr(value, "_asdict"):
        return {name: _plain(part) for name, part in value._asdict().items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, tuple | list):
        return [_plain(part) for part in value]
    if isinstance(value, complex):
        return [_plain(value.real), _plain(value.imag)]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value
