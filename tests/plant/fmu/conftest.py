"""FMUs of the two tanks, each built once a session."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
from tank_fmus import build, compiler, description, write_fmu

MakeFmu = Callable[..., Path]


@pytest.fixture(scope="session")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> MakeFmu:
    """fmu(version, kind, flags): the path of an FMU with these capabilities; kind is "ModelExchange" or "CoSimulation"."""
    pytest.importorskip("fmpy", reason="needs FMPy (the extra fmu)")
    if compiler() is None:
        pytest.skip("needs a C compiler (cc, gcc or clang), to build FMUs")
    folder = tmp_path_factory.mktemp("fmus")
    library = cache(lambda version: build(folder, version))

    @cache
    def made(version: int, kind: str, flags: str = "") -> Path:
        path = folder / f"{kind}{version}{''.join(c for c in flags if c.isalnum())}.fmu"
        return write_fmu(path, version, description(version, kind, flags), library(version))

    return made


@pytest.fixture(scope="session")
def library(fmu: MakeFmu) -> Path:
    """The compiled library of FMI 2.0."""
    return next(fmu(2, "ModelExchange").parent.glob("two_tanks_2.*"))
