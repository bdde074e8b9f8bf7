"""Plants and detectors by name: those of this package, those that callers register, those of other packages.

A plant or detector is registered in its own file with `register_plant` or `register_detector`, as a call or a decorator.
Another package names its own as entry points, in its pyproject.toml, each under its name:

    [project.entry-points."fusion_sfdia.plants"]
    my-tank = "my_package.tank:my_tank"  # a function that returns a Plant

    [project.entry-points."fusion_sfdia.detectors"]
    my-test = "my_package.test:MyTest"  # a class or function that takes a Plant and returns a Detector

Its description is the first line of its docstring, unless its file registers it with another. A text such as
"my_package.tank:my_tank" can be registered, too; its module is imported when the plant or detector is built, so that listing
names stays fast.

Wherever a name is expected, a text "module:attribute" or "path/file.py:attribute" or an object is accepted as well; for a
plant also the path of a Functional Mock-up Unit, model.fmu, with model.toml beside it (see `plant.fmu.settings`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from difflib import get_close_matches
from functools import partial
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from pkgutil import iter_modules
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, overload

from fusion_sfdia.common.references import did_you_mean, first_line, is_reference, load, name_of, require_call, source_of

if TYPE_CHECKING:
    from fusion_sfdia.detectors.detector import Detector
    from fusion_sfdia.plant.plant import Plant
import re
from importlib.metadata import EntryPoint

from fusion_sfdia.common.references import call

OURS = "fusion_sfdia"
M = TypeVar("M")
NAME = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*(:[a-z0-9]+(-[a-z0-9]+)*)?")
EXAMPLES = {"plant": "two-tanks", "detector": "kf-chi2 or chebyshev:paper"}


class NamedPlant(NamedTuple):
    """A registered plant: its description, and the function that makes it.

    make: returns the Plant with its usual settings. cases: its mismatch cases, process faults, faults of papers and published
    numbers for the comparison, an object or, lazily, the "module:attribute" of one; None for none. source: "module:name" of
    what makes it.
    """

    name: str
    about: str
    make: Callable[[], Plant]
    cases: Any = None
    source: str = ""

    @property
    def package(self) -> str:
        """The package it comes from."""
        return package_of(self.source)


class NamedDetector(NamedTuple):
    """A registered detector: its description, the function that builds it for a plant, and the memory of its test statistic.

    build: takes a Plant and returns the Detector. memory: "none" (present readings only), "state estimate only", or the time
    over which evidence of a fault accumulates; "" where it is not stated. source: "module:name" of what builds it. learns:
    whether build also takes `healthy` (readings, None for simulated ones) and `false_alarm` (a rate), as `learning.fit` does.
    tests_process: whether it also tells faults of the process or errors of the model from those of sensors. most_faults: how
    many sensors it isolates at once at most on any plant; None where only the plant limits it. commissions: whether it
    commissions the plant by itself from the log of the real one. reference: whether it only repeats another detector by other
    code, slowly, to check it. Comparisons include one that commissions, or a reference, only where it is named.
    """

    name: str
    about: str
    build: Callable[..., Detector]
    memory: str = ""
    source: str = ""
    learns: bool = False
    tests_process: bool = False
    most_faults: int | None = None
    commissions: bool = False
    reference: bool = False

    @property
    def package(self) -> str:
        """The package it comes from."""
        return package_of(self.source)


DEFAULT_DETECTOR = "robust-glr"  # where none is named
COMMISSIONED = "frozen-model"  # where there is a healthy log to commission on, and none is named

_PLANTS: dict[str, NamedPlant] = {}
_DETECTORS: dict[str, NamedDetector] = {}


@overload
def register_plant(name: str, about: str, *, cases: Any = None) -> Callable[[M], M]: ...
@overload
def register_plant(name: str, about: str, make: M, *, cases: Any = None) -> M: ...
def register_plant(name: str, about: str, make: Any = None, *, cases: Any = None) -> Any:
    """Register a plant: as a call with `make`, or as a decorator of a function.

    Parameters
    ----------
    name : str
        Of the form "two-tanks".
    about : str
        A description in a line.
    make : callable or str, optional
        make() returns the Plant with its usual settings. It may be given as a text "module:attribute", which is imported when
        the plant is made. Without it a decorator is returned.
    cases : ComparisonCases or str, optional
        Mismatch cases, process faults, faults of papers and published numbers for the comparison, or lazily the
        "module:attribute" of them; None for none.

    Returns
    -------
    callable or str
        `make` itself.

    Raises
    ------
    ValueError
        For a name of another form, and for one that is registered already from another source.

    Examples
    --------
    >>> from fusion_sfdia import detector, register_plant
    >>> from fusion_sfdia.plants import two_tanks
    >>> @register_plant("tanks-of-my-rig", "two tanks with narrow outlets")
    ... def narrow():
    ...     return two_tanks(outlet=0.8)
    >>> detector("robust-glr", "tanks-of-my-rig").plant.name
    'two-tanks'
    """
    if make is None:
        return partial(register_plant, name, about, cases=cases)
    enter(_PLANTS, "plant", NamedPlant(name, about, deferred(make), cases, source_of(make)))
    return make


@overload
def register_detector(
    name: str,
    about: str,
    *,
    memory: str = "",
    learns: bool = False,
    tests_process: bool = False,
    most_faults: int | None = None,
    commissions: bool = False,
    reference: bool = False,
    **settings: Any,
) -> Callable[[M], M]: ...
@overload
def register_detector(
    name: str,
    about: str,
    build: M,
    *,
    memory: str = "",
    learns: bool = False,
    tests_process: bool = False,
    most_faults: int | None = None,
    commissions: bool = False,
    reference: bool = False,
    **settings: Any,
) -> M: ...
def register_detector(
    name: str,
    about: str,
    build: Any = None,
    *,
    memory: str = "",
    learns: bool = False,
    tests_process: bool = False,
    most_faults: int | None = None,
    commissions: bool = False,
    reference: bool = False,
    **settings: Any,
) -> Any:
    """Register a detector: as a call with `build`, or as a decorator of a class or function.

    Parameters
    ----------
    name : str
        Of the form "kf-chi2" or "chebyshev:paper".
    about : str
        A description in a line.
    build : callable, class or str, optional
        build(plant, **settings) returns the detector with its usual settings: its class, a function, or lazily the
        "module:attribute" of one. Without it a decorator is returned.
    memory : str, default ""
        "none" (present readings only), "state estimate only", or the time over which evidence of a fault accumulates; "" where
        it is not stated.
    learns : bool, default False
        Whether build also takes `healthy` (readings, None for simulated ones) and `false_alarm` (a rate), as `learning.fit`
        does.
    tests_process : bool, default False
        Whether it also distinguishes faults of the process or errors of the model from those of sensors.
    most_faults : int, optional
        How many sensors it isolates at once at most on any plant; None where only the plant limits it.
    commissions : bool, default False
        Whether it commissions the plant by itself from the log of the real one. Comparisons include one that does, or a
        reference, only where it is named.
    reference : bool, default False
        Whether it only repeats another detector by other code, slowly, to check it.
    **settings
        Settings with which build is called.

    Returns
    -------
    callable or class
        `build` itself.

    Raises
    ------
    ValueError
        For a name of another form, and for one that is registered already from another source.

    Examples
    --------
    >>> from fusion_sfdia import detector, register_detector
    >>> from fusion_sfdia.detectors import CentralFilter
    >>> _ = register_detector("strict-filter", "one filter with few false alarms", CentralFilter, false_alarm=1e-6)
    >>> detector("strict-filter", "two-tanks").detector.false_alarm
    1e-06
    """
    if build is None:
        given: dict[str, Any] = {"memory": memory, "learns": learns, "tests_process": tests_process}
        given |= {"most_faults": most_faults, "commissions": commissions, "reference": reference}
        return partial(register_detector, name, about, **given, **settings)
    made = partial(deferred(build), **settings) if settings else deferred(build)
    kinds = learns, tests_process, most_faults, commissions, reference
    enter(_DETECTORS, "detector", NamedDetector(name, about, made, memory, source_of(build), *kinds))
    return build


def plants() -> dict[str, NamedPlant]:
    """All registered plants by name, those of this package first.

    A plant of another package that fails to load is included with the reason; its `make` raises ValueError.
    """
    found: dict[str, NamedPlant] = _with_entry_points("plant", _own_plants(), NamedPlant)
    return dict(sorted(found.items(), key=lambda item: (item[1].package != OURS, item[0])))


def detectors() -> dict[str, NamedDetector]:
    """All registered detectors by name, those of this package first; `build` of one that fails to load raises ValueError."""
    found: dict[str, NamedDetector] = _with_entry_points("detector", _own_detectors(), NamedDetector)
    return dict(sorted(found.items(), key=lambda item: item[1].package != OURS))


def compared_detectors() -> dict[str, NamedDetector]:
    """Those that a comparison of all detectors includes."""
    return {name: entry for name, entry in detectors().items() if not (entry.commissions or entry.reference)}


def find_plant(what: str | Plant | Callable[[], Plant] | NamedPlant) -> NamedPlant:
    """Return the plant of a registered name, a reference, an FMU, a Plant, or a function without arguments that returns one.

    The name of one that is not registered is the reference, or that of the object. ValueError for an unknown name, a reference
    without an object, and anything that is no plant.
    """
    from fusion_sfdia.plant.plant import Plant

    if isinstance(what, str) and what.endswith(".fmu"):
        return NamedPlant(what, "a Functional Mock-up Unit", partial(_of_fmu, str(Path(what).resolve())))
    found = _meant("plant", what, _own_plants, plants)
    if isinstance(found, NamedPlant):
        return found
    if isinstance(found, Plant):
        return NamedPlant(what if isinstance(what, str) else found.name, "", partial(identity, found))
    require_call(f"plant {name_of(what)}", found, "a Plant, or a function without arguments that returns one", 0)
    registered = (entry for entry in _PLANTS.values() if entry.make is found)
    return next(registered, NamedPlant(name_of(what), first_line(found), found, source=source_of(found)))


def _of_fmu(path: str) -> Plant:
    from fusion_sfdia.plant.fmu.settings import fmu_plant

    return fmu_plant(path)


def find_detector(what: str | Callable[[Plant], Detector] | NamedDetector) -> NamedDetector:
    """Return the detector of a registered name, a reference, or the class or function that builds it.

    The name of one that is not registered is the reference, or that of the object. ValueError for an unknown name, a reference
    without an object, and anything that builds no detector.
    """
    found = _meant("detector", what, _own_detectors, detectors)
    if isinstance(found, NamedDetector):
        return found
    require_call(f"detector {name_of(what)}", found, "a class or function that takes a Plant and returns a Detector", 1)
    registered = (entry for entry in _DETECTORS.values() if entry.build is found)
    return next(registered, NamedDetector(name_of(what), first_line(found), found, source=source_of(found)))


def registered_detector(name: str) -> NamedDetector | None:
    """The detector of this package of that name, or one that code which has run already has registered; None for any other.

    For names that a file states: nothing is imported that the file names, entry points of other packages neither.
    """
    return _own_detectors().get(name)


def plant(what: str | Plant | Callable[[], Plant] | NamedPlant) -> Plant:
    """Return a plant with its usual settings, given as in `find_plant`; ValueError as there, and if no Plant is made."""
    from fusion_sfdia.plant.plant import Plant

    entry = find_plant(what)
    made = entry.make()
    if not isinstance(made, Plant):
        raise ValueError(f"plant {entry.name}: its function returned {type(made).__name__}; expected a Plant")
    return made


def detector(what: str | Callable[[Plant], Detector] | NamedDetector, of: Plant) -> Detector:
    """Return a detector with its usual settings on a plant, given as in `find_detector`.

    ValueError as there, and if no Detector is built; NotApplicableError where the plant lacks what its method needs.
    """
    from fusion_sfdia.detectors.detector import OWN_CLASS, Detector

    entry = find_detector(what)
    built = entry.build(of)
    if not isinstance(built, Detector):
        raise ValueError(
            f"detector {entry.name}: built {type(built).__name__}; expected a Detector, with plant, hypotheses, init and step; "
            f"{OWN_CLASS}, which has the rest"
        )
    return built


def require_known(what: str, name: str, known: Iterable[str]) -> str:
    """Return the name; ValueError with the nearest known one where it is unknown."""
    names = list(known)
    if name not in names:
        raise ValueError(f"unknown {what} {name!r}; {did_you_mean(name, names)}known: {', '.join(names) or 'none'}")
    return name


def _own_plants() -> dict[str, NamedPlant]:
    """The registered plants, after each folder of fusion_sfdia.models has registered its own."""
    from fusion_sfdia import models

    for folder in iter_modules(models.__path__):
        import_module(f"{models.__name__}.{folder.name}")
    return _PLANTS


def _own_detectors() -> dict[str, NamedDetector]:
    import_module("fusion_sfdia.detectors.named")
    return _DETECTORS


def _with_entry_points(kind: str, known: dict[str, Any], entry: Callable[..., Any]) -> dict[str, Any]:
    for point in entry_points(group=f"fusion_sfdia.{kind}s"):
        register_entry_point(point, known, kind, entry)
    return known


def _meant(kind: str, what: Any, own: Callable[[], dict[str, Any]], every: Callable[[], dict[str, Any]]) -> Any:
    """The registered entry of a name, or else the object of a reference; anything but a text unchanged.

    Entry points of other packages are read only for names that are not among `own`.
    """
    if not isinstance(what, str):
        return what
    if what in (registered := own()):
        return registered[what]
    text, known = what, every()
    if text.endswith(".py"):
        raise ValueError(f"{kind} {text!r} is a file; name the {kind} in it, {text}:NAME")
    if text in known or not is_reference(text):
        return known[require_known(kind, text, known)]
    try:
        return load(text)
    except ValueError as error:
        near = get_close_matches(text, known, n=1)
        raise ValueError(f"{error}; or did you mean the {kind} {near[0]!r}?" if near else str(error)) from error


def enter(known: dict[str, Any], kind: str, entry: Any) -> None:
    """Register a NamedPlant or NamedDetector; ValueError for a name of another form, or one registered from another source."""
    if not NAME.fullmatch(entry.name):
        raise ValueError(f"{kind} {entry.name!r}: expected small letters, digits and hyphens, such as {EXAMPLES[kind]}")
    taken = known.get(entry.name)
    if taken is not None and taken.source != entry.source:
        raise ValueError(
            f"{kind} {entry.name!r} of {entry.source}: that name is taken by {taken.source}; register it under another"
        )
    known[entry.name] = entry


def register_entry_point(point: EntryPoint, known: dict[str, Any], kind: str, entry: Callable[..., Any]) -> None:
    """Register the object of an entry point, unless its package registers it itself, before or while it is loaded."""

    def registered() -> bool:
        return point.name in known and known[point.name].package == package_of(point.value)

    if registered():
        return
    package = point.dist.name if point.dist else package_of(point.value)
    try:
        about = first_line(load(point.value))
    except ValueError as error:
        about = f"cannot be loaded: {error}"
    if not registered():
        enter(known, kind, entry(point.name, about, partial(call, point.value, f"package {package}: "), source=point.value))


def deferred(thing: Any) -> Any:
    """The function that makes a plant or builds a detector; one given as a text is imported when it is called."""
    return partial(call, thing, "") if isinstance(thing, str) else thing


def identity(thing: Any) -> Any:
    """Return the argument: partial(identity, plant) makes that plant."""
    return thing


def package_of(source: str) -> str:
    """The top-level package of a source."""
    return source.partition(":")[0].partition(".")[0]
