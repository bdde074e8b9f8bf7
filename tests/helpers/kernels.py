"""Run the numerical tests with other processors' kernels: `python tests/helpers/kernels.py [--oldest] [arguments of pytest]`.

OpenBLAS and NumPy choose their code by processor, and sums taken in another order round otherwise. Each kernel of `KERNELS`
gives a run of the quick tests, all but the folders and files of `NOT_NUMERICAL` and the contract on large plants: a new file
takes part unless it is named there; the oldest is run with NumPy's baseline, as on a processor of its time. What this machine
cannot run is left out and reported, and so is the kernel that all tests run with here anyway.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import scipy.linalg  # noqa: F401  (loads SciPy's OpenBLAS, in addition to NumPy's)
from numpy._core._multiarray_umath import __cpu_features__ as features
from threadpoolctl import threadpool_info

# kernel of OpenBLAS: NumPy's names, old and new, of what it needs of the processor
KERNELS = {"Prescott": ("SSE3", "X86_V2"), "Haswell": ("AVX2", "X86_V3"), "SkylakeX": ("AVX512_SKX", "X86_V4")}

# folders and files with little arithmetic of their own: the command line, reports, scenario runs, files and processes,
# FMUs, which calculate by themselves
NOT_NUMERICAL = (
    "benchmarks", "cli", "comparison", "experiments", "fmu", "live", "logs", "mutants", "outlier_detectors",
    "test_architecture.py", "test_blind.py", "test_diagnose.py", "test_diagnosis_document.py", "test_engine_virtual_sensors.py",
    "test_entrances.py", "test_entry_points.py", "test_events.py", "test_figure_files.py", "test_files.py",
    "test_hostile_texts.py", "test_kind_trials.py", "test_lag.py", "test_log_report.py", "test_nomenclature.py",
    "test_notebooks.py", "test_order_of_findings.py", "test_package.py",
    "test_progress.py", "test_project_files.py", "test_readme.py", "test_references.py",
    "test_real_logs_scores.py",
    "test_registry.py", "test_report.py", "test_report_browser.py", "test_results_pages.py", "test_row_order.py",
    "test_sample_tables.py", "test_second_look.py", "test_site.py", "test_site_examples.py", "test_slow_sensors.py",
    "test_storage.py", "test_study_acceptance.py", "test_study_after_tuning.py", "test_study_audit.py", "test_study_errors.py",
    "test_study_robustness.py", "test_valve_log.py", "test_watch.py", "test_watch_states.py",
)  # fmt: skip
# The contract on the two largest plants takes as long as all else, that of slow references nearly so; their numbers are in the
# tests of the plants and of the filters themselves.
OLDEST = "--oldest"
LEFT_OUT = (
    "contracts",
    "learning",
    "study",
    "test_steady_gains.py",
)  # with OLDEST: whole models and detectors, for minutes
SMALL = ("-k", "not (test_contract and (gas-pipeline or power-network or filterpy))")


def settings() -> dict[str, dict[str, str]]:
    """Environment variables by name of the kernel, for the kernels that this machine can run."""
    found: dict[str, dict[str, str]] = {}
    if own := {library["architecture"] for library in threadpool_info() if library["internal_api"] == "openblas"}:
        for kernel, needs in KERNELS.items():
            if own == {kernel}:
                print(f"left out: OpenBLAS {kernel}; it is what all tests run with here anyway")
            elif any(features.get(name) for name in needs):
                found[f"OpenBLAS {kernel}"] = {"OPENBLAS_CORETYPE": kernel}
            else:
                print(f"left out: OpenBLAS {kernel} needs a processor with {' or '.join(needs)}")
    else:
        print("left out: the kernels of OpenBLAS; NumPy and SciPy use another library here")
    # of those that NumPy chooses at run time, the ones this machine has: it warns of any other
    chosen = np.show_config("dicts")["SIMD Extensions"].get("found", [])
    if chosen:
        oldest = next(iter(found), None)
        name, kernel = (f"{oldest}, NumPy's baseline", found.pop(oldest)) if oldest else ("NumPy's baseline", {})
        found[name] = kernel | {"NPY_DISABLE_CPU_FEATURES": " ".join(chosen)}
    else:
        print("left out: NumPy's baseline; it is what NumPy runs here anyway")
    return found


def main(arguments: Sequence[str]) -> int:
    """Run pytest for each setting; with `--oldest` for that alone, which differs most, without LEFT_OUT. 1 if one failed."""
    own = [a for a in arguments if a != OLDEST]
    chosen = list(settings().items())[-1 if OLDEST in arguments else 0 :]
    folder = Path(__file__).resolve().parent.parent
    without = {*NOT_NUMERICAL, *(LEFT_OUT if OLDEST in arguments else ())}
    files = sorted(p for p in folder.rglob("test_*.py") if not {*p.relative_to(folder).parts} & without)
    failed = []
    for name, variables in chosen:
        print(f"\n-- {name}: {' '.join(f'{k}={v!r}' for k, v in variables.items())}", flush=True)
        start = time.monotonic()
        command = [sys.executable, "-m", "pytest", "-q", *SMALL, *own, *map(str, files)]
        if subprocess.run(command, env=os.environ | variables, cwd=folder.parent, check=False).returncode:
            failed.append(name)
        print(f"-- {name}: {time.monotonic() - start:.0f} s", flush=True)
    print(f"\nfailed: {', '.join(failed)}" if failed else "\nthe same under every kernel")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
