"""Run scenarios on all cores: finished pieces are kept, so an interrupted run can be resumed, with the same bits.

The bits of metrics.csv do not depend on the number of workers: see `workers`. Another processor rounds otherwise.
"""

from __future__ import annotations

import json
import platform
import re
import shlex
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from threadpoolctl import threadpool_limits

import fusion_sfdia
from fusion_sfdia.common.files import LOCK, TEMPORARY, all_or_none, atomic_write, locked, remove_leftovers, require_free
from fusion_sfdia.common.plain_text import acting
from fusion_sfdia.report.content import Figure, Summary
from fusion_sfdia.report.figure_files import write_figure
from fusion_sfdia.report.on_screen import on_screen
from fusion_sfdia.report.page import Section, ShownFigure, write_report
from fusion_sfdia.report.results import Row, write_rows
from fusion_sfdia.study.experiments.cluster import connected
from fusion_sfdia.study.experiments.parts import PART_NAME, part_name, read_part
from fusion_sfdia.study.experiments.provenance import cores, git_commit, sources_digest, versions
from fusion_sfdia.study.experiments.scenario import Scenario, Settings, Task, adjust
from fusion_sfdia.study.experiments.workers import Done, Piece, in_processes, work_off

WorkOff = Callable[[Sequence[Piece]], Iterator[Done]]
MANIFEST = "manifest.json"
OWN_FILE = re.compile(r"metrics\.csv|report\.html|figures/[a-z0-9-]+\.(svg|png)")


@dataclass(frozen=True)
class RunOutcome:
    """Rows of metrics.csv, the scenarios' highlights, a line for each failure, the report's path, lines of damaged parts."""

    rows: list[Row]
    highlights: list[str]
    failures: list[str]
    report: Path
    notes: list[str] = field(default_factory=list)


@dataclass
class _Plan:
    """A scenario with its settings, its size and its tasks by the names of their parts; its errors and its time."""

    scenario: Scenario
    settings: Settings
    seeds: int
    parts: dict[str, Task]
    resumed: int = 0
    seconds: float = 0.0
    errors: dict[str, str] = field(default_factory=dict)


def run_scenarios(
    scenarios: Sequence[Scenario],
    out: str | Path,
    *,
    seeds: int | None = None,
    full: bool = False,
    changes: Mapping[str, str] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    force: bool = False,
) -> RunOutcome:
    """Run scenarios and write metrics.csv, figures, report.html and manifest.json into the folder `out`.

    seeds: runs of each scenario (None: its default, or with full the paper's size). changes: settings as text, each known
    to at least one of the scenarios. workers: processes, None for one a core. scheduler: address of a dask
    cluster that does the work instead, whose errors are those of `connected`. force: see open_output. Raises ValueError for
    arguments that do not fit; a piece of work that fails is reported in the outcome and does not stop the others.
    """
    if workers is not None and workers < 1:
        raise ValueError(f"{workers} workers; expected at least 1")
    if workers is not None and scheduler is not None:
        raise ValueError("workers and a scheduler's address; expected one of them: the cluster has workers of its own")
    out, changes = Path(out), dict(changes or {})
    plans = _plans(scenarios, seeds, full, changes)
    command = Command(tuple(s.name for s in scenarios), seeds, full, tuple(sorted(changes.items())))
    begun = time.time()
    workers = workers or cores()
    local = partial(work_off, workers=workers)
    working: AbstractContextManager[WorkOff] = nullcontext(local) if scheduler is None else connected(scheduler)
    with locked(out):
        with working as work_off_pieces:  # a cluster that is not there is reported before the folder's files are touched
            open_output(out, command, force=force)
            earlier = own_files(read_manifest(out) or {})
            notes = _work_off(plans, out, work_off_pieces)
        with all_or_none(out) as new:
            sections = [_summarise(plan, out / "parts", new / "figures", workers) for plan in plans]
            rows = [row for section in sections for row in section.summary.rows]
            files = [f"figures/{name}.{kind}" for s in sections for name in s.figures for kind in ("svg", "png")]
            files += ["metrics.csv", "report.html"]
            manifest = _manifest(plans, command, begun, scheduler or workers, files)
            write_rows(new / "metrics.csv", rows)
            write_report(new / "report.html", command.text, sections, manifest)
        remove(out, set(earlier) - set(files))
        remove_other_parts(out, {part for plan in plans for part in plan.parts})
        write_manifest(out, manifest)
    highlights = [line for section in sections for line in section.summary.highlights]
    return RunOutcome(rows, highlights, [line for s in sections for line in s.failures], out / "report.html", notes)


def _manifest(plans: list[_Plan], command: Command, begun: float, workers: int | str, files: list[str]) -> dict[str, Any]:
    return {
        "command": command.text,
        "finished": True,
        "version": fusion_sfdia.__version__,
        "sources": sources_digest(),
        "git_commit": git_commit(),
        "libraries": versions(),
        "platform": platform.platform(),
        "workers": workers,
        "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(begun)),
        "seconds": round(time.time() - begun, 3),
        "scenarios": [
            {
                "name": plan.scenario.name,
                "settings": dict(plan.settings),
                "seeds": plan.seeds,
                "tasks": len(plan.parts),
                "resumed": plan.resumed,
                "failed": {_label(plan.parts.get(part, {})): error for part, error in plan.errors.items()},
                "seconds": round(plan.seconds, 3),
            }
            for plan in plans
        ],
        "files": files,
    }


def _plans(scenarios: Sequence[Scenario], seeds: int | None, full: bool, changes: Mapping[str, str]) -> list[_Plan]:
    if not scenarios:
        raise ValueError("no scenario to run; name at least one")
    if seeds is not None and (full or seeds < 1):
        raise ValueError(f"{seeds} seeds{' and full' if full else ''}; expected at least 1 seed, or the paper's size with full")
    for key in changes:
        if not any(key in s.settings for s in scenarios):
            known = sorted({k for s in scenarios for k in s.settings})
            names = ", ".join(s.name for s in scenarios)
            raise ValueError(f"no setting {key!r} in {names}; known: {', '.join(known) or 'none'}")
    plans = []
    for scenario in scenarios:
        settings = adjust(scenario, {k: v for k, v in changes.items() if k in scenario.settings}, full=full)
        size = seeds or (scenario.full_seeds if full else scenario.seeds)
        tasks = scenario.tasks(settings, size)
        parts = {part_name(scenario.work, task): task for task in tasks}
        if len(parts) < len(tasks):
            raise ValueError(f"scenario {scenario.name} gives the same task twice; tasks must differ")
        plans.append(_Plan(scenario, settings, size, parts))
    return plans


def _work_off(plans: list[_Plan], out: Path, work_off: WorkOff) -> list[str]:
    """Do the missing parts, once for all scenarios that share them; the time counts for the first of them.

    Returns a line for each damaged part, which is computed again.
    """
    asking: dict[str, list[_Plan]] = {}
    for plan in plans:
        for part in plan.parts:
            asking.setdefault(part, []).append(plan)
    pieces, notes = [], []
    for part, those in asking.items():
        path = out / "parts" / part
        if read_part(path) is not None:
            for plan in those:
                plan.resumed += 1
        else:
            if path.exists():
                notes.append(f"{path} is damaged or cut and was computed again")
            pieces.append(Piece(path, those[0].scenario.work, those[0].parts[part]))
    with _progress(len(asking), len(asking) - len(pieces)) as bar:
        for done in work_off(pieces):
            those = asking[done.path.name]
            those[0].seconds += done.seconds
            if done.error is not None:
                for plan in those:
                    plan.errors[done.path.name] = done.error
            bar.advance(bar.task_ids[0])
    return notes


def _summarise(plan: _Plan, kept: Path, folder: Path, workers: int) -> Section:
    """Turn a scenario's parts, which are `kept`, into rows and figures in a folder; failures become rows too."""
    results = []
    for part, task in plan.parts.items():
        arrays = None if part in plan.errors else read_part(kept / part)
        if arrays is None:
            plan.errors.setdefault(part, "the part cannot be read back")
        else:
            results.append((task, arrays))
    name = plan.scenario.name
    errors = {part: plan.errors[part] for part in plan.parts if part in plan.errors}  # in the order of the tasks
    failures = [f"{name}, {_label(plan.parts[part])}: {error}" for part, error in errors.items()]
    summary = Summary(())
    try:
        with threadpool_limits(1):
            summary = plan.scenario.summarise(plan.settings, results)
    except Exception as problem:
        failures.append(f"{name}, summary: {type(problem).__name__}: {problem}")
    rows = list(summary.rows)
    figures, undrawn = draw_figures(folder, name, summary.every_figure, workers)
    failures += [f"{name}, figure {figure}: {error}" for figure, error in undrawn.items()]
    failed = Counter(
        tuple(_column(task.get(k) or usual) for k, usual in _USUAL) for task in map(plan.parts.__getitem__, errors)
    )
    for (plant, detector, fault, quantity), count in failed.items():
        rows.append(Row(name, plant, detector, fault, quantity, "failed_tasks", float(count), n=count))
    of = plan.scenario
    whole = replace(summary, rows=rows)
    return Section(name, of.title, of.about, plan.settings, plan.seeds, of.full_seeds, whole, figures, failures)


_USUAL = (("plant", ""), ("detector", ""), ("fault", "none"), ("quantity", "all"))  # columns, where a task does not name them


def _column(value: Any) -> str:
    return ", ".join(value) if isinstance(value, list) else str(value)


def _label(task: Task) -> str:
    """A task in a few words: without its `sources`, the digests of objects that are not of this package."""
    named = {k: v for k, v in task.items() if k != "sources"}
    shown = {k: f"{v[0]}..{v[-1]}" if isinstance(v, list) and len(v) > 3 else v for k, v in named.items()}
    return ", ".join(f"{k} {_named(v)}" for k, v in shown.items()) or "the only task"


def _named(value: Any) -> str:
    return " and ".join(value) if isinstance(value, list) and all(isinstance(v, str) for v in value) else str(value)


@contextmanager
def _progress(total: int, done: int) -> Iterator[Progress]:
    """A progress bar on a terminal, nothing elsewhere."""
    console = Console(file=acting(sys.stderr))
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        bar.add_task("running", total=total, completed=done)
        yield bar


class _Asked(NamedTuple):
    """A figure, and the files folder/slug.svg and folder/slug.png to be written."""

    folder: Path
    slug: str
    figure: Figure


class _Drawn(NamedTuple):
    """A figure, or the error that ended it."""

    slug: str
    shown: ShownFigure
    error: str | None


def draw_figures(
    folder: Path, scenario: str, figures: Sequence[Figure], workers: int
) -> tuple[dict[str, ShownFigure], dict[str, str]]:
    """Write the figures into a folder; those drawn by the names of their files, and errors by the names of their figures.

    Files have the same bytes for any number of workers. RuntimeError where a process is killed.
    """
    slugs = {figure.name: f"{scenario.replace('/', '-')}-{figure.name}" for figure in figures}
    asked = [_Asked(folder, slugs[figure.name], figure) for figure in figures]
    drawn = {found.slug: found for found in in_processes(_draw, asked, workers)}
    shown = {slug: drawn[slug].shown for slug in slugs.values() if drawn[slug].error is None}
    return shown, {name: error for name, slug in slugs.items() if (error := drawn[slug].error) is not None}


def _draw(asked: _Asked) -> _Drawn:
    """A figure, where it is drawn; an error is reported, not raised."""
    plots: list[str] = []
    try:
        svg = write_figure(asked.folder, asked.slug, asked.figure.draw, laid_out=lambda figure: plots.append(on_screen(figure)))
        return _Drawn(asked.slug, ShownFigure(svg, plots[0]), None)
    except Exception as problem:
        return _Drawn(asked.slug, ShownFigure("", ""), f"{type(problem).__name__}: {problem}")


@dataclass(frozen=True)
class Command:
    """A run as defined by its command. Runs of one command may share a folder: the second reuses parts of the first."""

    scenarios: tuple[str, ...]
    seeds: int | None = None
    full: bool = False
    changes: tuple[tuple[str, str], ...] = ()

    @property
    def text(self) -> str:
        """The command line, without the folder and the number of workers."""
        options = ["--full"] if self.full else [] if self.seeds is None else ["--seeds", str(self.seeds)]
        for key, value in self.changes:
            options += ["--set", f"{key}={value}"]
        return shlex.join(["fusion-sfdia", "run", *self.scenarios, *options])


def open_output(out: Path, command: Command, *, force: bool = False) -> None:
    """Make the folder ready for a run, or raise ValueError where it is in use for something else.

    Free to use: an absent or empty folder, and one of an earlier or interrupted run of the same command. force: also one
    of another run, whose files stay until this one has its own, finished parts that both runs need for good, and one of
    anything else, whose files stay unless they have our names.
    """
    require_free(out, force=True)
    found = [p.name for p in out.iterdir() if not p.name.startswith((LOCK, TEMPORARY))] if out.exists() else []
    earlier = read_manifest(out)
    same = earlier is not None and earlier.get("command") == command.text
    if found and not same and not force:
        what, cure = "files that are not a run of fusion-sfdia", "write into it with --force"
        if earlier is not None:
            what = f"another run ({earlier.get('command')})"
            cure = "replace that run with --force, which reuses its finished parts that this run needs"
        raise ValueError(f"{out} is already used: it holds {what}; name another folder with --out, or {cure}")
    kept = earlier if same and earlier else {"files": own_files(earlier or {})}
    try:
        write_manifest(out, {**kept, "command": command.text, "finished": False})
        (out / "parts").mkdir(exist_ok=True)
    except OSError as error:
        raise ValueError(f"cannot write into {out} ({error.strerror}); name another folder with --out") from error


def read_manifest(out: Path) -> dict[str, Any] | None:
    """Return the manifest of a folder; None where it holds none of this package."""
    try:
        manifest = json.loads((out / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return manifest if isinstance(manifest, dict) and manifest.get("program") == "fusion-sfdia" else None


def write_manifest(out: Path, manifest: dict[str, Any]) -> None:
    """Write the manifest, whole or not at all."""
    with atomic_write(out / MANIFEST) as file:
        json.dump({"program": "fusion-sfdia", **manifest}, file, indent=2, ensure_ascii=False)
        file.write("\n")


def own_files(manifest: dict[str, Any]) -> list[str]:
    """Return the files that a manifest lists, only those with names that a run writes."""
    return [name for name in manifest.get("files", ()) if isinstance(name, str) and OWN_FILE.fullmatch(name)]


def remove(out: Path, names: Iterable[str]) -> None:
    """Remove files of a run."""
    for name in names:
        (out / name).unlink(missing_ok=True)


def remove_other_parts(out: Path, keep: set[str]) -> None:
    """Remove parts that do not belong to the run, and unfinished ones of killed processes."""
    remove_leftovers(out / "parts")
    for path in (out / "parts").glob("*"):
        if path.name not in keep and PART_NAME.fullmatch(path.name):
            path.unlink(missing_ok=True)
