"""comparison: every detector on every plant under one protocol, at one rate of false alarms.

What is compared: `subjects`. What is done: `protocol`, with the cases that stand beside each plant. How: `run`, with
`recordings`, `calibration`, `branches` and `records`. The numbers: `cell`, `metric_rows`, `ranking`. The report: `summary`,
with `conclusions`, `result_tables`, `figures`, `chapters`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Set
from contextlib import nullcontext
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from fusion_sfdia.common.arguments import shown, whole
from fusion_sfdia.common.errors import MissingPackageError
from fusion_sfdia.common.files import atomic_write
from fusion_sfdia.common.html import as_html
from fusion_sfdia.detectors import registry
from fusion_sfdia.detectors.registry import require_known
from fusion_sfdia.report.content import Summary
from fusion_sfdia.report.results import Row
from fusion_sfdia.study.cases import ComparisonCases
from fusion_sfdia.study.comparison import run, summary
from fusion_sfdia.study.comparison.metric_rows import SCENARIO as NAME
from fusion_sfdia.study.comparison.protocol import COSTS, KINDS, SETTINGS
from fusion_sfdia.study.comparison.subjects import (
    DetectorLike,
    PlantLike,
    Subjects,
    compared_detector,
    compared_plant,
)
from fusion_sfdia.study.experiments.runner import run_scenarios
from fusion_sfdia.study.experiments.scenario import Arrays, Scenario, Setting, Settings, Task, seed_blocks, setting_text

CHUNK = 25  # seeds in one task, which is set up once
LEAST_COST = 1e-6  # but for 0
LEAST_CALIBRATION_ERROR = 1e-3  # of a rate of false alarms that is set: less takes a million samples and more


@dataclass(frozen=True)
class Comparison:
    """The tasks of a comparison, their work and its summary, for the scenario of that name."""

    subjects: Subjects = field(default_factory=Subjects)

    def tasks(self, settings: Settings, seeds: int) -> list[Task]:
        """One detector on one plant and CHUNK seeds a task: what it needs to be set up is done once.

        A task holds digests of the sources of its plant and detector, so that a changed one never takes up old parts.
        ValueError for unknown names; numbers have the scenario's bounds.
        """
        for name in settings["faults"]:
            require_known("fault", name, KINDS)
        if 0 < (error := settings["calibration_error"]) < LEAST_CALIBRATION_ERROR:
            raise ValueError(
                f"calibration_error is {error:g}; expected at least {LEAST_CALIBRATION_ERROR:g}, or 0: by the number of seeds"
            )
        for name in COSTS:
            if 0 < settings[name] < LEAST_COST:
                raise ValueError(f"{name} is {settings[name]:g}; expected 0, or at least {LEAST_COST:g}")
        plants = [self.subjects.plant(name) for name in settings["plants"]]
        detectors = [self.subjects.detector(name) for name in settings["detectors"]]
        apart = ("plants", "detectors", *COSTS)  # costs weigh what the work found
        common = {k: list(v) if isinstance(v, tuple) else v for k, v in settings.items() if k not in apart}
        return [
            {"plant": plant.name, "detector": detector.name, "sources": f"{plant.digest}-{detector.digest}"}
            | common
            | {"seeds": block, "all_seeds": seeds}
            for plant in plants
            for block in seed_blocks(seeds, CHUNK)
            for detector in detectors  # one after the other: a process keeps what it has simulated for them
        ]

    def work(self, task: Task) -> Arrays:
        """See `run.work`."""
        return run.work(task, self.subjects.plant(task["plant"]), self.subjects.detector(task["detector"]))

    def summarise(self, settings: Settings, results: list[tuple[Task, Arrays]]) -> Summary:
        """See `summary.summarise`."""
        return summary.summarise(self.subjects, settings, results)


def scenario_of(subjects: Subjects) -> Scenario:
    """The scenario `comparison` with plants and detectors beside those of the registry."""
    comparison = Comparison(subjects)
    return Scenario(
        name=NAME,
        title="Comparison: every detector on every plant at one rate of false alarms",
        about="All detectors are given the same readings and faults. Their thresholds are scaled to one rate of false alarms; "
        "then they are compared by detection, isolation, accommodation and false isolation, with and without model mismatch.",
        settings=SETTINGS,
        seeds=8,
        full_seeds=100,
        tasks=comparison.tasks,
        work=comparison.work,
        summarise=comparison.summarise,
        full={"calibration_error": 0.1},
        bounds={
            **dict.fromkeys(COSTS, (0.0, 1e6)),
            "wrong_model_share": (0, 1),
            "settle": (0, 1e6),
            "window": (2, 1e6),
            "false_alarm": (1e-6, 0.5),
            "calibration_error": (0, 0.99),
        },
        optional=("lengths",),
    )


SCENARIO = scenario_of(Subjects())


@dataclass(frozen=True)
class ComparisonResult:
    """What a comparison found: its rows as in metrics.csv, findings in sentences, a line for each piece of work that failed.

    Attributes
    ----------
    rows : list of Row
        As in metrics.csv.
    highlights : list of str
        Findings in sentences.
    failures : list of str
        A line for each piece of work that failed.
    notes : list of str
        Lines of damaged parts, and of plants that have the name of a registered one but not its cases.
    folder : Path or None
        Where metrics.csv, figures and report.html are; None where they were not kept.
    page : str
        The report.

    Examples
    --------
    See `compare`.
    """

    rows: list[Row]
    highlights: list[str]
    failures: list[str]
    notes: list[str]
    folder: Path | None
    page: str = field(repr=False)

    @property
    def ranks(self) -> dict[str, dict[str, dict[str, int]]]:
        """Ranks by plant ("all plants" for all of several), criterion and detector; shared where none differs beyond chance."""
        found: dict[str, dict[str, dict[str, int]]] = {}
        for row in self.rows:
            if row.metric == "rank":
                found.setdefault(row.plant, {}).setdefault(row.quantity, {})[row.detector] = int(row.value)
        return found

    def _repr_html_(self) -> str:
        ranks = [
            (plant, criterion, ", ".join(sorted(of, key=lambda name: of[name])))
            for plant, by_criterion in self.ranks.items()
            for criterion, of in by_criterion.items()
        ]
        failed = f"{len(self.failures)} pieces of work failed" if self.failures else ""
        return as_html("Comparison of detectors", failed, ("plant", "criterion", "detectors, the best first"), ranks)

    def frame(self) -> Any:
        """The rows as a pandas DataFrame, a column for each of metrics.csv.

        Returns
        -------
        pandas.DataFrame
            A row for each of `rows`.

        Raises
        ------
        MissingPackageError
            Without pandas.
        """
        try:
            pandas: Any = import_module("pandas")
        except ModuleNotFoundError as error:
            raise MissingPackageError("a frame needs pandas, which is not installed; install it, or use rows") from error
        return pandas.DataFrame([row.columns for row in self.rows])

    def report(self, path: str | Path) -> Path:
        """Write the report as one HTML file and return its path.

        Parameters
        ----------
        path : str or Path
            The file.

        Returns
        -------
        Path
            Of the file.
        """
        path = Path(path)
        with atomic_write(path) as file:
            file.write(self.page)
        return path


def compare(
    plants: PlantLike | Iterable[PlantLike] | None = None,
    detectors: DetectorLike | Iterable[DetectorLike] | None = None,
    *,
    faults: str | Iterable[str] | None = None,
    seeds: int | None = None,
    full: bool = False,
    cases: Mapping[str, ComparisonCases] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    out: str | Path | None = None,
    force: bool = False,
    **settings: Setting,
) -> ComparisonResult:
    """Compare detectors on plants under one protocol, at one rate of false alarms.

    The numbers are the same bits as those of the command `fusion-sfdia compare` with the same names. A piece of work that fails
    is in `failures`, and a detector that is not applicable to a plant is left out there.

    Parameters
    ----------
    plants : str, Plant, callable or iterable of them, optional
        Names, references "file.py:attribute" or "module:attribute", Plants, or functions without arguments that return one;
        None for all that are registered. A Plant, and that of a function, is compared under its own name; one that equals the
        registered plant of its name has the cases of that one.
    detectors : str, class, callable or iterable of them, optional
        Names, references, or classes and functions that take a Plant and return a Detector; None for all. A detector is a
        frozen dataclass with a field threshold_scale, a factor of all its thresholds.
    faults : str or iterable of str, optional
        Kinds of sensor faults, see `protocol.KINDS`.
    seeds : int, optional
        Runs of each condition.
    full : bool, default False
        The size of the whole comparison, hours.
    cases : mapping of str to ComparisonCases, optional
        By a plant's name its mismatch cases and process faults, in place of those with which it is registered; one without any
        is compared without.
    workers : int, optional
        Processes, None for one a core; objects are pickled to send them there.
    scheduler : str, optional
        Address of a dask cluster instead.
    out : str or Path, optional
        Folder of the results, which takes up an interrupted comparison; None to keep none.
    force : bool, default False
        Write into a folder that is in use.
    **settings
        Those of `protocol.SETTINGS`.

    Returns
    -------
    ComparisonResult
        Its rows, findings and failures.

    Raises
    ------
    ValueError
        For what does not fit, also for two of one name.

    Notes
    -----
    An interrupted comparison is taken up only for what is unchanged: the sources of a plant and detector, and the values that
    the built plant holds, also those read from a file. What a module reads on import and its functions use as global variables,
    and files that a detector reads, are not seen: name another folder after a change of those.

    Examples
    --------
    >>> from fusion_sfdia import compare
    >>> result = compare("two-tanks", ["limits", "kf-chi2"], faults="bias", seeds=2, workers=1, magnitudes=(30.0,), window=10,
    ...                  mismatch_cases=False, process_faults=False, calibration_error=0.5)
    >>> sorted({row.detector for row in result.rows}), result.failures
    (['kf-chi2', 'limits'], [])
    """
    if seeds is not None:
        seeds = whole("seeds", seeds, 1)
    by_name = dict(cases or {})
    of_plants = _each(plants, registry.plants())
    found = [compared_plant(what) for what in of_plants]
    found = [
        compared_plant(what, by_name.pop(p.name)) if p.name in by_name else p for what, p in zip(of_plants, found, strict=True)
    ]
    for name in by_name:
        require_known("plant", name, [p.name for p in found])
    of_detectors = [compared_detector(what) for what in _each(detectors, registry.compared_detectors())]
    subjects = Subjects(_named("plant", found), _named("detector", of_detectors))
    given: dict[str, Setting] = dict(settings)
    for kind, names in (("plants", tuple(subjects.plants)), ("detectors", tuple(subjects.detectors))):
        if names != SETTINGS[kind]:  # else the command of the folder has them as its defaults
            given[kind] = names
    if faults is not None:
        given["faults"] = _fault_names(faults)
    changes = {name: setting_text(value) for name, value in given.items()}
    with nullcontext(str(out)) if out is not None else TemporaryDirectory(prefix="fusion-sfdia-") as folder:
        try:
            outcome = run_scenarios(
                [scenario_of(subjects)], folder, seeds=seeds, full=full, changes=changes, workers=workers, scheduler=scheduler,
                force=force,
            )  # fmt: skip
        except ValueError as error:
            raise ValueError(_of_both(str(error))) from error
        page = outcome.report.read_text(encoding="utf-8")
    kept = None if out is None else Path(out)
    notes = [*(p.note for p in found if p.note), *outcome.notes]
    return ComparisonResult(outcome.rows, outcome.highlights, outcome.failures, notes, kept, page)


def _fault_names(faults: Any) -> str | tuple[str, ...]:
    """The kinds of faults as a setting; ValueError for anything but a name, or a list of names."""
    if isinstance(faults, str):
        return faults
    cure = f"such as ['bias', 'drift'], of: {', '.join(KINDS)}"
    if not isinstance(faults, Iterable) or isinstance(faults, Mapping | Set):
        raise ValueError(f"faults is {shown(faults)}; expected a list of kinds of faults, {cure}")
    names = tuple(faults)
    for name in names:
        if not isinstance(name, str):
            raise ValueError(
                f"faults has {shown(name)} in it; expected names of kinds of faults, {cure}. Sensors, onsets and sizes are set "
                "by the protocol: give sizes as magnitudes=(...) in sigma"
            )
    return names


def _of_both(text: str) -> str:
    """An error of a run with the names of arguments in Python beside the options of the command line."""
    return text.replace("with --out", "with out= (--out)").replace("with --force", "with force=True (--force)")


def _each(given: Any, known: Iterable[str]) -> list[Any]:
    """What is given, one or several; None for all that are known."""
    if given is None:
        return list(known)
    several = isinstance(given, Iterable) and not isinstance(given, str | tuple)
    return list(given) if several or type(given) is tuple else [given]


def _named(kind: str, found: list[Any]) -> dict[str, Any]:
    """Subjects by name; ValueError where two have one name, or one has a comma in it."""
    names = [one.name for one in found]
    if twice := [name for name in dict.fromkeys(names) if names.count(name) > 1]:
        raise ValueError(f"{kind}s named {', '.join(twice)} are given twice; give each a name of its own, and each once")
    if commas := [name for name in names if "," in name]:
        raise ValueError(f"{kind} {commas[0]!r} has a comma in its name; expected a name without one")
    return dict(zip(names, found, strict=True))
