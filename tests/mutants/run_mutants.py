"""Apply each mutant of `mutants.MUTANTS` to a copy of the project and run the test that has to fail.

    python tests/mutants/run_mutants.py [--workers 2] [WORD ...]

runs the mutants whose file, text or test contains every WORD, all without one. It prints a line for each and ends with status 1
where a mutant survives, that is, where its test passes.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from queue import SimpleQueue

from mutants import MUTANTS, Mutant, mutated

ROOT = Path(__file__).parents[2]
COPIED = ("fusion_sfdia", "models", "benchmarks", "tests", "docs", "pyproject.toml", "README.md")
PATIENCE = 600  # s, after which a test counts as failed: an endless loop is a failure, too
FAILED, PASSED = 1, 0  # what pytest returns


@contextmanager
def copies(count: int) -> Iterator[list[Path]]:
    """So many copies of the project with its compiled kernels, which are kept by the times of their files."""
    with tempfile.TemporaryDirectory() as folder:
        roots = [Path(folder) / str(i) for i in range(count)]
        for root in roots:
            root.mkdir()
            for name in COPIED:
                if (ROOT / name).is_dir():
                    shutil.copytree(ROOT / name, root / name, symlinks=True, ignore=shutil.ignore_patterns("_build"))
                else:
                    shutil.copy2(ROOT / name, root / name)
        yield roots


def passes(root: Path, tests: Sequence[str]) -> tuple[bool, str]:
    """Whether the tests pass in a copy of the project, and the end of what pytest prints.

    RuntimeError where they do not run at all.
    """
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    environment = {**os.environ, **threads, "PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider", "-m", "", "--tb=line", *tests]
    try:
        found = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        return False, f"no result within {PATIENCE} s"
    if found.returncode not in (PASSED, FAILED):
        raise RuntimeError(f"{' '.join(tests)} does not run:\n{found.stdout[-2000:]}{found.stderr[-2000:]}")
    return found.returncode == PASSED, found.stdout[-2000:]


def survives(root: Path, mutant: Mutant) -> bool:
    """Whether the test of a mutant passes in a copy of the project in which it is applied; the copy is as before afterwards."""
    path = root / mutant.file
    path.write_text(mutated(path.read_text(), mutant))
    try:
        return passes(root, [mutant.test])[0]
    finally:
        shutil.copy2(ROOT / mutant.file, path)


def survivors(mutants: Sequence[Mutant], workers: int = 1, show: bool = False) -> list[Mutant]:
    """Those of the mutants whose tests pass. AssertionError where a test fails without a mutant, which would kill anything."""
    free: SimpleQueue[Path] = SimpleQueue()

    def judged(mutant: Mutant) -> bool:
        root = free.get()
        try:
            found = survives(root, mutant)
        finally:
            free.put(root)
        if show:
            print(f"{'SURVIVES' if found else 'killed  '}  {mutant}", flush=True)
        return found

    with copies(workers) as roots:
        sound, printed = passes(roots[0], list(dict.fromkeys(m.test for m in mutants)))
        assert sound, f"a test fails without a mutant:\n{printed}"
        for root in roots:
            free.put(root)
        with ThreadPoolExecutor(workers) as pool:
            return [m for m, found in zip(mutants, pool.map(judged, mutants), strict=True) if found]


def main() -> int:
    parser = argparse.ArgumentParser(description="Mutants that the tests do not notice")
    parser.add_argument("words", nargs="*", metavar="WORD", help="only mutants whose file, text or test contains it")
    parser.add_argument("--workers", type=int, default=2, help="mutants at a time")
    chosen = parser.parse_args()
    mutants = [m for m in MUTANTS if all(any(word in part for part in m[:4]) for word in chosen.words)]
    if not mutants:
        parser.error(f"no mutant has all of {' '.join(chosen.words)}; a word is a part of its file, of its text or of its test")
    left = survivors(mutants, chosen.workers, show=True)
    print(f"{len(mutants)} mutants, {len(mutants) - len(left)} killed, {len(left)} survive", *left, sep="\n")
    return bool(left)


if __name__ == "__main__":
    sys.exit(main())
