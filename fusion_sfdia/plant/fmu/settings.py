"""An FMU and the file beside it that states what no FMU does: model.toml of model.fmu, with the arguments of `from_fmu`."""

from __future__ import annotations

import tomllib
from inspect import signature
from pathlib import Path

from fusion_sfdia.common.references import did_you_mean
from fusion_sfdia.plant.fmu.from_fmu import from_fmu
from fusion_sfdia.plant.fmu.interface import CO_SIMULATION, Interface, Variable, read_interface
from fusion_sfdia.plant.plant import Plant

NEEDED = ("sensors", "initial_sigma", "process_sigma")


def fmu_plant(path: str | Path) -> Plant:
    """Return the plant of an FMU with the settings of the file beside it; ValueError as of `from_fmu`, or without the file."""
    path = Path(path)
    beside, known = path.with_suffix(".toml"), [*signature(from_fmu).parameters][1:]
    if not beside.is_file():
        read_interface(path)
        raise ValueError(
            f"{path} states no noise, as no FMU does; expected {beside} beside it, with {', '.join(NEEDED)}: `fusion-sfdia fmu "
            f"{path} > {beside}` writes one to fill in"
        )
    try:
        settings = tomllib.loads(beside.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ValueError(f"{beside} is no TOML ({error}); correct it") from error
    if wrong := [key for key in settings if key not in known]:
        raise ValueError(f"{beside} has {wrong[0]!r}; {did_you_mean(wrong[0], known)}expected of: {', '.join(known)}")
    if missing := [key for key in NEEDED if key not in settings]:
        raise ValueError(f"{beside} has no {missing[0]}; expected {', '.join(NEEDED)}, as from_fmu takes them")
    return from_fmu(path, **settings)


def describe(path: str | Path, kind: str | None = None) -> str:
    """What an FMU is, as the TOML file beside it with noise to fill in (nan), which `fmu_plant` refuses until then."""
    found = read_interface(path, kind)
    lines = [f"# {found}", f"# {jacobians(found)}"]
    if found.kind == CO_SIMULATION and not found.get_and_set:
        lines.append("# cannot get and set its state (canGetAndSetFMUstate): no plant can be made of it")
    lines += [
        "",
        *([] if kind is None else [f'kind = "{kind}"']),
        f"dt = {'nan' if found.step is None else found.step}  # s between readings",
    ]
    for title, names in (
        ("sensors]  # standard deviation of the noise of each reading", found.outputs),
        ("initial_sigma]  # standard deviation of the initial value of each state", found.states),
        ("process_sigma]  # standard deviation of the process noise of each state over one dt", found.states),
    ):
        lines += ["", f"[{title}", *(_row(v, "nan") for v in found.of("variable", names))]
    lines += ["", "# [start_values]  # in place of those of the FMU", *_parameters(found)]
    return "\n".join([*lines, "", f"# inputs: {', '.join(found.inputs) or 'none'}"])


def jacobians(found: Interface) -> str:
    """How the plant of an interface finds its Jacobians."""
    if found.kind == CO_SIMULATION:
        return f"Jacobians by differences as wide as the tolerance of its solver, {found.tolerance:g}, asks for"
    if found.directional:
        return "Jacobians exact, from its directional derivatives; of sensors that read neither outputs nor states, differences"
    return "Jacobians by differences: it gives no directional derivatives"


def _parameters(found: Interface) -> list[str]:
    chosen = [v for v in found.variables.values() if v.causality == "parameter" and isinstance(v.start, float)]
    return [f"# {_row(v, repr(v.start))}" for v in chosen]


def _row(v: Variable, value: str) -> str:
    scale = "" if v.scale is None else f", nominally {v.scale:g}"
    key = v.name.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{key}" = {value}  # {v.unit}{scale}'
