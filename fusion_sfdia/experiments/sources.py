"""What an object is made of, as a digest: a plant or detector of a caller's own that was changed has another one.

The package's own sources are in the name of every part of a run (see `provenance.sources_digest`); those of a caller are not.
"""

from __future__ import annotations

import hashlib
import io
import pickle
import sys
import sysconfig
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from joblib.externals import cloudpickle

OURS = "fusion_sfdia"
KNOWN = ("numpy", "scipy", "numba", "joblib", "sklearn")  # libraries whose versions decide are in the names of parts


def object_digest(thing: Any, modules: Iterable[str] = ()) -> str:
    """A digest of an object's pickled bytes and of the sources of the modules that define it, other than those of the package.

    modules: names of further modules that define it. Modules that these import are among them, but for installed libraries.
    An object that is defined in the main module is pickled whole. ValueError for what cannot be pickled.
    """
    try:
        pickled = cloudpickle.dumps(thing)
    except (pickle.PicklingError, TypeError, AttributeError) as error:
        raise ValueError(
            f"{type(thing).__name__} cannot be sent to worker processes ({error}); make it of functions, classes and arrays"
        ) from error
    reader = _ModuleReader(io.BytesIO(pickled))
    reader.load()
    digest = hashlib.sha256(pickled)
    for name, source in sorted(defining_sources({*modules, *reader.modules}).items()):
        digest.update(f"{name}\0".encode() + source + b"\0")
    return digest.hexdigest()


class _ModuleReader(pickle.Unpickler):
    """Reads an object and notes the modules that its pickle refers to."""

    def __init__(self, file: io.BytesIO) -> None:
        super().__init__(file)
        self.modules: set[str] = set()

    def find_class(self, module: str, name: str) -> Any:
        self.modules.add(module)
        return super().find_class(module, name)


def defining_sources(modules: Iterable[str]) -> dict[str, bytes]:
    """Sources by name of modules, and of those that their names come from; none of the package, of Python or of libraries.

    A module that is asked for may be of an installed package, whose own modules then count.
    """
    asked = {name for name in modules if name != "__main__"}
    packages = {name.partition(".")[0] for name in asked} - {OURS, *sys.stdlib_module_names}
    libraries = [Path(sysconfig.get_path(kind)).resolve() for kind in ("purelib", "platlib")]
    found: dict[str, bytes] = {}
    to_see, seen = list(asked), set[str]()
    while to_see:
        if (name := to_see.pop()) in seen:
            continue
        seen.add(name)
        top = name.partition(".")[0]
        if top == OURS or top in sys.stdlib_module_names or top == "__main__":
            continue
        module = import_module(name)
        path = Path(getattr(module, "__file__", None) or "")
        installed = any(folder in path.resolve().parents for folder in libraries)
        if path.suffix != ".py" or (installed and (top not in packages or top in KNOWN)):
            continue
        found[name] = path.read_bytes()
        for value in vars(module).values():
            other = value.__name__ if isinstance(value, ModuleType) else getattr(value, "__module__", None)
            if isinstance(other, str) and other in sys.modules:
                to_see.append(other)
    return found
