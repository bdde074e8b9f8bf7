"""FMUs of the two tanks, built from `two_tanks_fmu.c` by the C compiler of this machine with the headers that FMPy ships.

`write_fmu` packs a model description and a library; the descriptions differ in what they state. Functions of the standard that
the source does not have are stubs that report an error, because FMPy needs each of them.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile

SOURCE = Path(__file__).with_name("two_tanks_fmu.c")
ERROR = 3  # a status of FMI
# name: value reference, attributes
VARIABLES = {
    "level_1": (1, 'causality="output" initial="exact" start="1" unit="m" min="0.01" max="3" nominal="1"'),
    "level_2": (2, 'causality="output" initial="exact" start="1" unit="m" min="0.01" max="3" nominal="1"'),
    "der(level_1)": (3, 'derivative="1" unit="m/s"'),
    "der(level_2)": (4, 'derivative="2" unit="m/s"'),
    "inflow": (5, 'causality="input" start="6e-4" unit="m3/s" min="0" max="2e-3"'),
    "flow_12": (6, 'causality="output" unit="m3/s" quantity="VolumeFlowRate"'),
    "flow_out": (7, 'causality="output" unit="m3/s" quantity="VolumeFlowRate"'),
    "area": (8, 'causality="parameter" variability="fixed" initial="exact" start="0.05" unit="m2"'),
    "outlet_1": (9, 'causality="parameter" variability="fixed" initial="exact" start="6e-4" unit="m2.5/s"'),
    "outlet_2": (10, 'causality="parameter" variability="fixed" initial="exact" start="6e-4" unit="m2.5/s"'),
    "leak": (11, 'causality="parameter" variability="fixed" initial="exact" start="0" unit="m3/s"'),
    "lag": (12, 'causality="parameter" variability="fixed" initial="exact" start="0" unit="s"'),
}
OF_SCALAR = ("causality", "variability", "initial")  # attributes outside of <Real> in FMI 2.0


def compiler() -> str | None:
    """The C compiler, None without one."""
    return shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")


def build(folder: Path, version: int) -> Path:
    """Compile the library for FMI 2.0 or 3.0 in a folder."""
    import fmpy
    from fmpy import fmi2, fmi3

    text, classes = SOURCE.read_text(), (fmi2.FMU2Model, fmi2.FMU2Slave, fmi3.FMU3Model, fmi3.FMU3Slave)
    needed = {name for c in classes for name in dir(c) if name.startswith(f"fmi{version}")}
    here = {f"fmi{version}{name}" for name in re.findall(r"\bNAME\((\w+)\)\(", text)} | {*re.findall(r"\bfmi\d\w+(?=\()", text)}
    stubs = folder / f"stubs{version}.c"
    stubs.write_text("".join(f"int {name}(void) {{ return {ERROR}; }}\n" for name in sorted(needed - here)))
    library = folder / f"two_tanks_{version}{fmpy.sharedLibraryExtension}"
    headers = Path(fmpy.__file__).with_name("c-code")
    sources = [f"-DFMI={version}", f"-I{headers}", str(SOURCE), str(stubs)]
    subprocess.run(
        [str(compiler()), "-shared", "-fPIC", "-O1", *sources, "-lm", "-o", str(library)],
        check=True,
    )
    return library


def description(version: int, kind: str, flags: str) -> str:
    """The model description of FMI 2.0 or 3.0 for ModelExchange or CoSimulation with these flags."""
    units = "".join(f'<Unit name="{unit}"/>' for unit in ("m", "m/s", "m3/s", "m2", "m2.5/s", "s"))
    head = f'fmiVersion="{version}.0" modelName="TwoTanks" generationTool="cc" variableNamingConvention="structured"'
    kind = f'<{kind} modelIdentifier="two_tanks" {flags}/>'
    if version == 2:
        rows = "".join(
            f'<ScalarVariable name="{name}" valueReference="{reference}" {" ".join(_attributes(text, True))}>'
            f"<Real {' '.join(_attributes(text, False))}/></ScalarVariable>"
            for name, (reference, text) in VARIABLES.items()
        )
        structure = (
            "<Outputs>" + "".join(f'<Unknown index="{i}"/>' for i in (1, 2, 6, 7)) + "</Outputs><Derivatives>"
            '<Unknown index="3"/><Unknown index="4"/></Derivatives>'
        )
        head += ' guid="two-tanks" numberOfEventIndicators="0"'
    else:
        rows = '<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>' + "".join(
            f'<Float64 name="{name}" valueReference="{reference}" {text}/>' for name, (reference, text) in VARIABLES.items()
        )
        structure = "".join(f'<Output valueReference="{i}"/>' for i in (1, 2, 6, 7)) + "".join(
            f'<ContinuousStateDerivative valueReference="{i}"/>' for i in (3, 4)
        )
        head += ' instantiationToken="two-tanks"'
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<fmiModelDescription {head}>{kind}<UnitDefinitions>{units}</UnitDefinitions>'
        f'<DefaultExperiment startTime="0" stepSize="5"/><ModelVariables>{rows}</ModelVariables>'
        f"<ModelStructure>{structure}</ModelStructure></fmiModelDescription>\n"
    )


def _attributes(text: str, outside: bool) -> list[str]:
    return [pair for pair in re.findall(r'\w+="[^"]*"', text) if (pair.partition("=")[0] in OF_SCALAR) == outside]


def write_fmu(path: Path, version: int, xml: str, library: Path | None, folder: str | None = None) -> Path:
    """Pack an FMU; folder: of the library in binaries/, that of this platform by default."""
    import fmpy

    folder = folder or (fmpy.platform if version == 2 else fmpy.platform_tuple)
    with ZipFile(path, "w", ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", xml)
        if library is not None:
            archive.write(library, f"binaries/{folder}/two_tanks{library.suffix}")
    return path
