"""What tuning has found, as a readable file, and the plant and the detector that follow from it."""

from __future__ import annotations

import hashlib
import json
import re
import sys
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import number, shown, some
from fusion_sfdia.common.errors import warn
from fusion_sfdia.common.files import all_or_none, atomic_write
from fusion_sfdia.common.rate import Rate
from fusion_sfdia.common.references import name_of
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.batch_detector import BatchDetector
from fusion_sfdia.detectors.detector import Detector
from fusion_sfdia.detectors.saved_detectors import load_detector, save_detector, settings_classes
from fusion_sfdia.learning.commissioning.commission import Commissioning
from fusion_sfdia.learning.commissioning.disturbances import FoundDisturbance, moves, with_disturbance
from fusion_sfdia.learning.commissioning.noise_likelihood import Noise, state_groups, with_noise
from fusion_sfdia.learning.commissioning.parameters import ParameterEstimate, declared, free, moved
from fusion_sfdia.learning.commissioning.start import Start, seen_to_fit, with_start
from fusion_sfdia.learning.model_and_monitor import ModelAndMonitor, with_further
from fusion_sfdia.learning.monitor.monitor import Monitor
from fusion_sfdia.plant.augment import fixed
from fusion_sfdia.plant.plant import Plant
from fusion_sfdia.plant.signals import Sensor, Signal
from fusion_sfdia.plant.slow_noise import SlowNoise
from fusion_sfdia.plant.uncertainty import error_of

Array = NDArray[Any]

COMMENTS = {
    "": "A plant and a detector tuned on healthy readings by `fusion-sfdia tune`; for `diagnose --tuned`.\n"
    "SI units, standard deviations, seconds. Thresholds hold for these values: tune again rather than edit.",
    "plant": "For this plant only: the digest is of the names and units of its states, inputs, sensors and parameters.\n"
    "response: two numbers by which a change of its equations is noticed.",
    "detector": "name: of the detectors of this package; any other is given with --detector, as this file imports no code.\n"
    "threshold_scale is a factor on all thresholds, which healthy readings exceed at the stated rate.",
    "sensors": "Noise of each sensor, and what the plant states; resolution: the step of its readings;\n"
    "slow_share: of its variance, with slow_time_constant (s); delay of a bias of so many sigma (s, see quality).",
    "process_noise": "Factor on the standard deviation that the plant states, of all states of a unit.",
    "parameters": "Estimates with standard deviation, and what the plant states.",
    "commissioned": "Values at which the model is frozen, and what the plant states.",
    "disturbance": "A direction of mismatch (state: units of the states; reading: of the sensors): its mean is an offset.\n"
    "moves: what it moves most, in words.",
    "start": "Where runs begin: a state, and the variance of first states about it.",
    "further": "Channels that a monitor judges beside the model, which predicts nothing of them.",
    "quality": "How well this holds, on halves of the log from which it was not learnt.",
}
SAME = 1e-8  # of the terms of a sum: far above rounding, far below what a changed parameter moves


@dataclass(frozen=True, eq=False)
class Tuned:
    """A tuned plant and detector; `tune` makes it.

    Attributes
    ----------
    document : dict
        The tables of the file.
    fitted : Detector, Path or None
        Where it learns from data: the detector, or the file that `save_detector` wrote; None where class, plant and scale
        suffice.
    build : NamedDetector or None
        What `tune` has built the detector with; None of one that was read, as a file names a detector but imports no code.
    monitor : Monitor or None
        Of the sensors and of further channels of the log, which judges them beside the detector; None without any.

    Examples
    --------
    See `tune`.
    """

    document: dict[str, Any]
    fitted: Any = None
    build: registry.NamedDetector | None = None
    monitor: Monitor | None = None

    @property
    def further(self) -> tuple[Signal, ...]:
        """The further channels."""
        return tuple(Signal(name, str(row.get("unit", "1"))) for name, row in self.document.get("further", {}).items())

    @property
    def rate(self) -> Rate:
        """The stated rate of false alarms."""
        return Rate.of(str(self.document["detector"]["false_alarm"]))

    @property
    def threshold_scale(self) -> float:
        """Factor on the thresholds of the detector as it is registered."""
        return number("threshold_scale", self.document["detector"]["threshold_scale"])

    @property
    def detector_name(self) -> str:
        """The detector for which the thresholds hold: a registered name, or how another one was named when it was tuned."""
        return str(self.document["detector"]["name"])

    @property
    def quality(self) -> dict[str, Any]:
        """Figures of quality."""
        return dict(self.document["quality"])

    def plant(self, plant: Plant) -> Plant:
        """The plant with what was learnt.

        Parameters
        ----------
        plant : Plant
            As its maker gives it.

        Returns
        -------
        Plant
            With the noise, parameters and disturbances of the file.

        Raises
        ------
        ValueError
            Where the file is of another plant.

        Warns
        -----
        UserWarning
            Where the model of the plant has changed.
        """
        require_same_plant(self.document, plant)
        warn_of_change(self.document["plant"], plant)
        return learnt_plant(self.document, plant)

    def detector(self, plant: Plant, detector: str | Callable[[Plant], Detector] | registry.NamedDetector | None = None) -> Any:
        """The tuned detector on the plant as `plant` gives it.

        Parameters
        ----------
        plant : Plant
            As its maker gives it.
        detector : str, callable or NamedDetector, optional
            The one that was tuned, given as in `registry.find_detector`; needed where it is none of this package.

        Returns
        -------
        Detector
            With the tuned thresholds; where there are further channels, on the plant with these as sensors behind its own.

        Raises
        ------
        ValueError
            As of `plant`, and where the detector is another than the one that was tuned, or has other settings now.
        """
        found = self.model_detector(plant, detector)
        return found if self.monitor is None else ModelAndMonitor(found, self.monitor.live)

    def model_detector(
        self, plant: Plant, detector: str | Callable[[Plant], Detector] | registry.NamedDetector | None = None
    ) -> Any:
        """The tuned detector of the model and its sensors alone, without the further channels.

        Parameters
        ----------
        plant : Plant
            As of `detector`.
        detector : str, callable or NamedDetector, optional
            As of `detector`.

        Returns
        -------
        Detector
            With the tuned thresholds.

        Raises
        ------
        ValueError
            As of `detector`.
        """
        entry = self.entry(detector)
        acting = acting_plant(self.plant(plant), entry)
        if isinstance(self.fitted, Path):
            return load_detector(self.fitted, acting, classes_beside(entry))
        if self.fitted is not None:
            return self.fitted
        built: Any = registry.detector(entry, acting)
        if (expected := self.document["detector"].get("digest")) not in (None, settings_digest(built)):
            raise ValueError(
                f"it was tuned for {self.detector_name} with the digest {shown(expected)}, {entry.name} is now a "
                f"{type(built).__name__} with other settings, of the digest {settings_digest(built)!r}; tune again with it"
            )
        return scaled(built, self.threshold_scale, number("per_sample", self.document["detector"]["per_sample"]))

    def logged_plant(self, plant: Plant) -> Plant:
        """The plant as `plant` gives it, with the further channels as sensors behind its own.

        Parameters
        ----------
        plant : Plant
            As its maker gives it.

        Returns
        -------
        Plant
            Of which logs are read.

        Raises
        ------
        ValueError
            As of `plant`.
        """
        return with_further(self.plant(plant), self.further)

    def entry(self, given: str | Callable[[Plant], Detector] | registry.NamedDetector | None = None) -> registry.NamedDetector:
        """The detector to build: the given one, or else that of the file's name where it is one of this package.

        Parameters
        ----------
        given : str, callable or NamedDetector, optional
            As `detector` of the method of that name.

        Returns
        -------
        NamedDetector
            To be built.

        Raises
        ------
        ValueError
            Where the given one is another, and where none is given and the file's is none of this package.
        """
        name = self.detector_name
        if given is None:
            known = self.build or registry.registered_detector(name)
            if known is None:
                raise ValueError(
                    f"it was tuned for the detector {shown(name)}, which is none of this package, and a settings file imports "
                    "no code: state where that detector is, with --detector (in Python as the argument detector)"
                )
            return known
        label = given.name if isinstance(given, registry.NamedDetector) else name_of(given)
        names = {
            (registry.registered_detector(n) and n) or n.rpartition(":")[2] for n in (name, label)
        }  # the file may have moved
        if len(names) > 1:
            raise ValueError(f"it was tuned for {name}, not {label}; leave --detector out, or tune again with it")
        return registry.find_detector(given)

    def write(self, path: str | Path) -> None:
        """Write the file, and beside it a detector that learns from data (.npz) and the monitor of further channels (.sfdia).

        Parameters
        ----------
        path : str or Path
            The file.
        """
        path = Path(path)
        if self.fitted is None:
            write_document(path, self.document, COMMENTS)
            return
        beside, monitor = path.with_suffix(".npz").name, path.with_suffix(".sfdia").name
        names = {"fitted": beside} | ({} if self.monitor is None else {"monitor": monitor})
        document = self.document | {"detector": self.document["detector"] | names}
        with all_or_none(path.parent) as new:
            if self.monitor is not None:
                self.monitor.save(new / monitor)
            if isinstance(self.fitted, Path):
                (new / beside).write_bytes(self.fitted.read_bytes())
            else:
                save_detector(new / beside, self.fitted)
            write_document(new / path.name, document, COMMENTS)

    @classmethod
    def read(cls, path: str | Path) -> Tuned:
        """Read a file that `write` wrote.

        Parameters
        ----------
        path : str or Path
            The file.

        Returns
        -------
        Tuned
            As it was written.

        Raises
        ------
        ValueError
            Which names the file, where it is none.
        """
        path = Path(path)
        document = read_document(path)
        for table, keys in NEEDED.items():
            if not isinstance(found := document.get(table), dict) or (lacking := [k for k in keys if k not in found]):
                what = f"[{table}]" if not isinstance(found, dict) else f"{lacking[0]} in [{table}]"
                raise ValueError(f"{path} has no {what}; expected a file that `fusion-sfdia tune` wrote")
        for table, form in FORMS.items():
            found = document.get(table, form())
            rows = list(found.values()) if isinstance(found, dict) else found
            if not isinstance(found, form) or not all(isinstance(row, dict) for row in rows):
                raise ValueError(f"{path}: [{table}] is not as `fusion-sfdia tune` writes it; restore the file, or tune again")
        fitted, kept = (_beside(path, document["detector"], *what) for what in (("fitted", ".npz"), ("monitor", ".sfdia")))
        tuned = cls(document, fitted, monitor=None if kept is None else Monitor.load(kept))
        try:
            if not 0 < tuned.threshold_scale < np.inf:
                raise ValueError(f"threshold_scale is {tuned.threshold_scale}; expected a positive number")
            tuned.rate.per_sample(number("dt", document["plant"]["dt"]))
            _require_channels(tuned)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error
        return tuned


def _beside(path: Path, of: Mapping[str, Any], what: str, suffix: str) -> Path | None:
    """The file that a tuned file names beside itself, None where it names none."""
    name = of.get(what)
    if name is not None and not (isinstance(name, str) and re.fullmatch(rf"[^/\\:]+\{suffix}", name)):
        raise ValueError(f"{path}: {what} is {shown(name)}; expected the name of an {suffix} file in the same folder")
    return None if name is None else path.parent / name


def _require_channels(tuned: Tuned) -> None:
    """Raise ValueError where the monitor is not of the sensors, further channels and inputs that the file names."""
    further = [s.name for s in tuned.further]
    if tuned.monitor is None:
        if further:
            raise ValueError(f"it has the further channels {some(further)} and names no monitor of them; tune again")
        return
    channels, expected = tuned.monitor.channels, [*tuned.document["sensors"], *further]
    for what, found, needed in (
        ("sensors", channels.sensors, expected),
        ("inputs", channels.inputs, tuned.document["plant"].get("inputs")),
    ):
        if (names := [s.name for s in found]) != needed:
            raise ValueError(f"its monitor is of the {what} {some(names)}, the file of {some(needed)}; tune again")


NEEDED = {
    "plant": ("name", "dt", "digest"),
    "detector": ("name", "threshold_scale", "false_alarm", "per_sample"),
    "sensors": (),
    "quality": (),
}
FORMS: dict[str, Any] = {"sensors": dict, "further": dict, "parameters": dict, "disturbance": list}  # tables of tables
LARGEST = 1e100  # of what is squared


def scaled(detector: Any, scale: float, rate: float) -> Any:
    """The detector with its thresholds times a scale that was fitted for that rate per sample."""
    fitted = {"fitted_rate": rate} if isinstance(detector, BatchDetector) else {}
    return replace(detector, threshold_scale=scale * detector.threshold_scale, **fitted)


def settings_digest(detector: Any) -> str:
    """A digest of the class of a detector and of its settings, numbers to 6 digits, arrays by their shape alone: what follows
    from the plant may differ in its last bits between machines.
    """
    return hashlib.sha256(_described(detector).encode()).hexdigest()[:16]


def _described(value: Any) -> str:
    if is_dataclass(value) and not isinstance(value, type | Plant):
        settings = (f"{f.name}={_described(getattr(value, f.name))}" for f in fields(value) if f.init)
        return f"{type(value).__qualname__}({', '.join(settings)})"
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}"
    if isinstance(value, tuple | list):
        return f"({', '.join(map(_described, value))})"
    if isinstance(value, float | np.floating):
        return f"{float(value):.6g}"
    if value is None or isinstance(value, bool | int | str):
        return repr(value)
    return type(value).__qualname__


def classes_beside(entry: registry.NamedDetector) -> list[type]:
    """The classes of the module that builds a detector, which a saved detector of it may have among its settings."""
    module = getattr(entry.build, "__module__", None) or entry.source.partition(":")[0]
    return settings_classes(sys.modules[module]) if module in sys.modules else []


def acting_plant(plant: Plant, entry: registry.NamedDetector) -> Plant:
    """The plant on which a detector acts: one that runs a filter on it estimates learnt disturbances along.

    A detector that tests the process does so by itself.
    """
    if entry.tests_process or entry.learns or not plant.uncertainty.disturbances:
        return plant
    return plant if registry.detector(entry, plant).filter_model is None else fixed(plant)


def plant_table(plant: Plant) -> dict[str, Any]:
    """Name, step, sizes and digest of the names and units of a plant."""
    known = plant.uncertainty
    named: list[Any] = [*plant.states, *plant.inputs, *plant.sensors, *known.parameters]
    text = "\n".join([plant.name, repr(plant.dt), *(f"{v.name} [{v.unit}]" for v in named), *sorted(known.inputs)])
    return {
        "name": plant.name,
        "dt": plant.dt,
        "states": len(plant.states),
        "inputs": [s.name for s in plant.inputs],
        "digest": hashlib.sha256(text.encode()).hexdigest()[:16],
        "response": response(plant),
    }


def require_same_plant(document: dict[str, Any], plant: Plant) -> None:
    """Raise ValueError, with what differs, where a file was tuned for another plant."""
    own, found = plant_table(plant), document["plant"]
    reasons = [
        f"{what} {shown(found.get(what))}, this one {shown(own[what])}"
        for what in ("name", "dt", "states", "inputs")
        if found.get(what) != own[what]
    ]
    if tuple(document["sensors"]) != plant.sensor_names:
        others = [*(set(document["sensors"]) ^ set(plant.sensor_names))] or ["their order"]
        reasons.append(
            f"{len(document['sensors'])} sensors, this one {len(plant.sensors)}, other are {', '.join(sorted(others)[:4])}"
        )
    if not reasons and found["digest"] != own["digest"]:
        reasons.append("other names or units of states, sensors or parameters")
    for sensor in plant.sensors:
        if not reasons and document["sensors"][sensor.name].get("stated") != sensor.noise_sigma:
            stated = shown(document["sensors"][sensor.name].get("stated"))
            reasons.append(f"sensor {sensor.name!r} with a stated sigma of {stated}, this one {sensor.noise_sigma!r}")
    if reasons:
        raise ValueError(
            f"it was tuned for another plant than {plant.name!r}: that one has {'; '.join(reasons)}; tune again on healthy "
            "readings of this plant"
        )


def learnt_tables(plant: Plant, found: Commissioning) -> dict[str, Any]:
    """The tables of what was learnt, from the plant before."""
    tables: dict[str, Any] = {}
    tables["sensors"] = {
        s.name: {"sigma": float(sigma), "stated": s.noise_sigma, "unit": s.unit}
        | ({"resolution": now.resolution} if now.resolution != s.resolution else {})
        | ({} if (slow := now.noise) is None else {"slow_share": slow.share, "slow_time_constant": slow.time_constant})
        for s, now, sigma in zip(plant.sensors, found.plant.sensors, found.plant.sensor_sigma, strict=True)
    }
    if found.noise is not None:
        tables["process_noise"] = {
            unit: float(np.sqrt(f)) for unit, f in zip(found.noise.groups, found.noise.process, strict=True)
        }
    if (known := found.parameters) is not None:
        rows = zip(known.names, known.value, known.sd, known.prior, known.prior_sd, strict=True)
        units = {p.name: p.unit for p in plant.uncertainty.parameters} | {error_of(s.name): s.unit for s in plant.inputs}
        tables["parameters"] = {
            name: {"value": float(v), "sd": float(sd), "stated": float(p), "stated_sd": float(psd), "unit": units[name]}
            for name, v, sd, p, psd in rows
        }
    if found.disturbances:
        tables["disturbance"] = [
            {
                "moves": moves(plant, d),
                "mean": d.mean,
                "sd": d.sd,
                "time_constant": d.time_constant,
                "state": d.state.tolist(),
                "reading": d.reading.tolist(),
            }
            for d in found.disturbances
        ]
    if found.start is not None:
        tables["start"] = {"x0": found.start.x0.tolist(), "variance": found.start.spread.tolist()}
    return tables


def learnt_plant(document: dict[str, Any], plant: Plant) -> Plant:
    """The plant with what the tables of a document hold; ValueError for values that do not fit it."""
    try:
        if rows := document.get("parameters"):
            names = tuple(declared(plant)[0][i] for i in free(plant))
            values, sds = (np.array([number(f"{what} of {n}", rows[n][what]) for n in names]) for what in ("value", "sd"))
            plant = moved(plant, ParameterEstimate(names, values, sds, values, sds, np.empty((0, 0)), sds))
        for d in document.get("disturbance", []):
            none = np.empty((0, 0))
            state, reading = (np.array(d[what], dtype=float) for what in ("state", "reading"))
            mean, sd, lasting = (number(f"{what} of a disturbance", d[what]) for what in ("mean", "sd", "time_constant"))
            plant = with_disturbance(plant, FoundDisturbance(state, reading, none, none, mean, sd, lasting, 1.0))
        groups, table = state_groups(plant), document.get("process_noise", {})
        process = np.array([_positive(f"process noise in {unit}", table.get(unit, 1.0)) for unit in groups]) ** 2
        sigma = np.array([_positive(f"sigma of {n}", document["sensors"][n]["sigma"]) for n in plant.sensor_names])
        plant = replace(plant, sensors=tuple(_as_learnt(s, document["sensors"][s.name]) for s in plant.sensors))
        plant = with_noise(plant, Noise(groups, process, process, (sigma / plant.sensor_sigma) ** 2, sigma))
        if start := document.get("start"):
            plant = with_start(plant, Start(*(np.array(start[what], dtype=float) for what in ("x0", "variance"))))
    except KeyError as error:
        raise ValueError(f"the tuned values have no {error}; tune again, or restore the file") from error
    return seen_to_fit(plant)


def _as_learnt(sensor: Sensor, row: dict[str, Any]) -> Sensor:
    """A sensor with the resolution and the slow noise in its row."""
    slow, given = None, [row.get(key) for key in ("slow_share", "slow_time_constant")]
    if given != [None, None]:
        slow = SlowNoise(*(number(what, v) for what, v in zip(("slow_share", "slow_time_constant"), given, strict=True)))
    return replace(sensor, resolution=row.get("resolution", sensor.resolution), noise=slow)


def _positive(what: str, value: Any) -> float:
    """A deviation or a factor on one; ValueError unless it is positive and can be squared."""
    if not 0 < (found := number(what, value)) < LARGEST:
        raise ValueError(f"{what} is {found}; expected a positive number, as `fusion-sfdia tune` writes it")
    return found


def write_document(path: Path, document: Mapping[str, Any], comments: Mapping[str, str]) -> None:
    """Write tables [name] and [[name]], each below its comment; "" is that of the whole."""
    lines = [f"# {line}" for line in comments.get("", "").splitlines()]
    for name, content in document.items():
        tables = content if isinstance(content, list) else [content]
        for table in tables:
            title = f"[[{_key(name)}]]" if isinstance(content, list) else f"[{_key(name)}]"
            lines += ["", *(f"# {line}" for line in comments.get(name, "").splitlines()), title]
            lines += [f"{_key(key)} = {_value(value)}" for key, value in table.items()]
    with atomic_write(path) as file:
        file.write("\n".join(lines) + "\n")


def read_document(path: Path) -> dict[str, Any]:
    """Read a TOML file; ValueError, which names it, where it is none."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ValueError(f"{path} is not a TOML file ({error}); expected what `fusion-sfdia tune` writes") from error


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _text(name)


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(value: Any) -> str:
    match value:
        case bool():
            return str(value).lower()
        case str():
            return _text(value)
        case int() | float():
            return repr(value)  # also inf and nan
        case Mapping():
            return f"{{ {', '.join(f'{_key(k)} = {_value(v)}' for k, v in value.items())} }}"
        case list() | tuple():
            return f"[{', '.join(map(_value, value))}]"
    raise ValueError(f"a TOML file cannot hold {value!r}")


class ModelChangedWarning(UserWarning):
    """The equations of a plant are not those for which a file was tuned."""


def response(plant: Plant) -> list[float]:
    """The next state and the readings one standard deviation beside the first state, where a balance at rest does not hide
    a parameter: each as a weighted sum over its standard deviations. [] where the plant cannot be evaluated there.
    """
    return [float(np.sum(terms)) for terms in _terms(plant)]


def warn_of_change(found: dict[str, Any], plant: Plant) -> None:
    """Warn where the response of a plant is not the one in the [plant] table of a tuned file, which older files lack."""
    kept = found.get("response", [])
    if not isinstance(kept, list):
        raise ValueError(f"response is {shown(kept)}; expected a list of numbers, as `fusion-sfdia tune` writes it")
    kept = [number("response", value) for value in kept]
    pairs = zip(kept, _terms(plant) if kept else [], strict=False)
    if any(not abs(value - np.sum(terms)) <= SAME * np.sum(np.abs(terms)) for value, terms in pairs):
        warn(
            f"the model of plant {plant.name!r} has changed since it was tuned: what was learnt and the thresholds may not "
            "hold; tune again",
            ModelChangedWarning,
        )


def _terms(plant: Plant) -> list[Array]:
    """The terms of both sums; weights that no symmetry of a plant makes cancel."""
    cov = np.asarray(plant.initial_cov)
    sd = np.sqrt(cov if cov.ndim == 1 else np.diagonal(cov))
    try:
        x, u = plant.guard((plant.x0 + sd)[None])[0], plant.input_at(0.0)[None]
        with np.errstate(all="ignore"):
            ahead = np.asarray(plant.step(0.0, x, u, plant.dt))[0] / np.where(sd > 0, sd, 1.0)
            readings = np.asarray(plant.output(plant.dt, x, u))[0] / plant.sensor_sigma
    except (ArithmeticError, ValueError):
        return []
    found = [values * np.cos(np.arange(values.size)) for values in (ahead, readings)]
    return found if all(np.isfinite(terms).all() for terms in found) else []
