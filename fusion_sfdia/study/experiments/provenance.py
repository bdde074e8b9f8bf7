"""Where numbers come from: code, versions, commit, machine."""

from __future__ import annotations

import hashlib
import importlib.metadata
import os
import platform
import subprocess
from functools import cache
from pathlib import Path

import fusion_sfdia
from fusion_sfdia import benchmarks, models

OPTIONAL = ("codac", "faultdiagnosistoolbox", "osqp")  # what can be done depends on them
LIBRARIES = ("numpy", "scipy", "scikit-learn", "numba", "filterpy", "joblib", "matplotlib")


@cache
def versions() -> dict[str, str]:
    """Return the versions of Python, of the main libraries and of optional ones, "absent" where they are not installed."""
    found = {"python": platform.python_version()} | {name: importlib.metadata.version(name) for name in LIBRARIES}
    for name in OPTIONAL:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "absent"
    return found


@cache
def sources_digest() -> str:
    """A digest of the package's sources and data, the same however it is installed: parts of older code are not reused."""
    found = {}
    for package in (fusion_sfdia, models, benchmarks):
        folder = Path(package.__path__[0])
        for at, _, files in os.walk(folder):
            for path in (Path(at) / name for name in files):
                if path.suffix in (".py", ".pyi", ".json", ".toml"):
                    found[f"{package.__name__.replace('.', '/')}/{path.relative_to(folder).as_posix()}"] = path.read_bytes()
    digest = hashlib.sha256()
    for name, content in sorted(found.items()):
        digest.update(name.encode() + b"\0" + content + b"\0")
    return digest.hexdigest()


def cores() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def git_commit() -> str | None:
    """Return the commit of the checkout that the package is run from, with "+" where it was edited; None outside one."""
    folder = str(Path(fusion_sfdia.__path__[0]))

    def git(*arguments: str) -> str:
        return subprocess.run(("git", "-C", folder, *arguments), capture_output=True, text=True, check=True).stdout.strip()

    try:
        git("ls-files", "--error-unmatch", "__init__.py")  # an installed copy may lie within another project's checkout
        return git("rev-parse", "HEAD") + ("+" if git("status", "--porcelain", "--untracked-files=no") else "")
    except (OSError, subprocess.CalledProcessError):
        return None
