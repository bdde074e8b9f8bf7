"""The digest of an object: the same in every process, another where anything of it was changed."""

from __future__ import annotations

import subprocess
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fusion_sfdia.study.experiments.sources import defining_sources, object_digest

SCRIPT = '''
from dataclasses import dataclass
from typing import NamedTuple
from fusion_sfdia.study.experiments.sources import object_digest

class Memory(NamedTuple):
    last: float

@dataclass(frozen=True)
class Rule:
    """Of the main module."""
    limit: float = {limit}

    def exceeded(self, y):
        return Memory(abs(y) > self.limit * FACTOR)

FACTOR = {factor}
print(object_digest(lambda plant: Rule()))
'''


def of_a_script(folder: Path, root: Path, **values: float) -> str:
    (folder / "script.py").write_text(SCRIPT.format(**values), encoding="utf-8")
    command = [sys.executable, str(folder / "script.py")]
    return subprocess.run(command, check=True, capture_output=True, text=True, env={"PYTHONPATH": str(root)}).stdout


@pytest.mark.slow
def test_a_class_of_the_main_module_has_one_digest_in_all_processes(tmp_path: Path, root: Path) -> None:
    first = of_a_script(tmp_path, root, limit=1.0, factor=2.0)
    assert of_a_script(tmp_path, root, limit=1.0, factor=2.0) == first
    assert (
        len({first, of_a_script(tmp_path, root, limit=1.5, factor=2.0), of_a_script(tmp_path, root, limit=1.0, factor=3.0)})
        == 3
    )


def test_values_and_functions_decide() -> None:
    def scaled(by: float) -> Any:
        return lambda x: by * x

    assert object_digest(scaled(1.0)) == object_digest(scaled(1.0)) != object_digest(scaled(2.0))
    assert object_digest(np.arange(3.0)) != object_digest(np.arange(4.0))
    assert object_digest(partial(round, ndigits=1)) != object_digest(partial(round, ndigits=2))


def test_modules_of_an_object_and_what_they_import_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "mine_of_sources"
    package.mkdir()
    for name, text in {
        "__init__": "",
        "plant": "import numpy\nfrom . import constants\nfrom .parts.pipe import make\n",
        "constants": "LENGTH = 3.0\n",
        "unused": "",
        "parts/__init__": "",
        "parts/pipe": "from ..shapes import ROUND\ndef make():\n    return ROUND\n",
        "shapes": "import json\nROUND = 1\n",
    }.items():
        (package / name).parent.mkdir(exist_ok=True)
        (package / f"{name}.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    found = set(defining_sources(["mine_of_sources.plant", "numpy.linalg", "json", "fusion_sfdia.detectors.registry"]))
    expected = {f"mine_of_sources.{name}" for name in ("plant", "constants", "parts.pipe", "shapes")}
    assert found == {"mine_of_sources", *expected}
    make = sys.modules["mine_of_sources.parts.pipe"].make
    before = object_digest(make)
    (package / "shapes.py").write_text("ROUND = 2\n", encoding="utf-8")
    assert object_digest(make) != before


def test_what_cannot_be_sent_is_refused() -> None:
    with pytest.raises(ValueError, match="cannot be sent to other processes"):
        object_digest(SimpleNamespace(file=sys.stdout))
