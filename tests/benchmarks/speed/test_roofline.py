"""Arithmetic is counted as it is known, and no measured step takes less than its least time."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fusion_sfdia.benchmarks.speed import bench
from fusion_sfdia.benchmarks.speed.roofline import Work, least
from fusion_sfdia.detectors import registry

EQUATIONS = """
import numpy as np
from fusion_sfdia.derivatives.dual import dual
from fusion_sfdia.derivatives.equation import compiled, equation

@equation
def square(x, c):
    return c * x * x

@compiled
def total(a):
    found = 0.0
    for i in range(a.size):
        found += square(a[2 * i - i], a.dtype.type(3))
    return found

@compiled
def slope(x):
    return square(dual(x, 1.0), 3.0).slope

@compiled
def product(a, b, into):
    np.dot(a, b, into)

def outside(a):
    b = 2.0 * a
    b /= a
    return [0] + [1 + 2], a @ a
"""
COUNT = """
import json
from fusion_sfdia.benchmarks.speed.support.arithmetic import arithmetic, install
install("toy")
import numpy as np
from toy import equations
a, m = np.ones(50), np.ones((4, 5), np.float32)
assert equations.slope(2.0) == 12.0
found = {
    "total": arithmetic(lambda: equations.total(a)),
    "single total": arithmetic(lambda: equations.total(a.astype(np.float32))),
    "slope": arithmetic(lambda: equations.slope(2.0)),
    "product": arithmetic(lambda: equations.product(m, m.T.copy(), np.empty((4, 4), np.float32))),
    "outside": arithmetic(lambda: equations.outside(a)),
}
assert equations.total(a) == 150.0 and equations.total.signatures  # compiled again
print(json.dumps(found))
"""


@pytest.mark.slow
def test_what_is_counted(tmp_path: Path) -> None:
    package = tmp_path / "toy"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "equations.py").write_text(EQUATIONS)
    start = f"import sys; sys.path[:0] = {[str(tmp_path), *sys.path]!r}\n"
    done = subprocess.run([sys.executable, "-c", start + COUNT], stdout=subprocess.PIPE, check=True)
    assert json.loads(done.stdout) == {
        "total": [0, 0, 150, 0],
        "single total": [0, 0, 0, 150],  # of a sum the precision of what is added
        "slope": [0, 0, 4, 0],  # two products of a value and a slope each
        "product": [0, 80, 0, 0],
        "outside": [50, 0, 100, 0],
    }


def test_the_least_time_is_that_of_arithmetic_or_of_the_state() -> None:
    rate = Work(1.0, 0.5, 2.0, 1.0, 0.1)
    assert least(Work(1, 2, 3, 4, 5), rate) == (2.0, 10.0, 0.5)
    assert least(Work(1, 2, 3, 4, 5), rate).all == 12.0 and least(Work(1, 2, 3, 4, 500), rate).all == 50.0


@pytest.mark.slow
def test_no_step_takes_less_than_its_least_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "plants", lambda: ("two-tanks",))
    two = {name: registry.detectors()[name] for name in ("kf-chi2", "loo-glr")}
    monkeypatch.setattr(registry, "detectors", lambda: two)
    rows = bench.run(["roofline"], seconds=0.1)
    assert all(np.isfinite(r.value) and r.value > 0 for r in rows if r.condition != "products")
    assert [r.condition for r in rows if r.detector == "none"] == list(Work._fields)
    for detector in ("kf-chi2", "loo-glr"):
        own = {(r.metric, r.quantity, r.condition): r.value for r in rows if r.detector == detector}
        measured, bound = own["step_time", "batch of 32", ""], own["step_time", "least", ""]
        assert bound < measured and own["ratio", "batch of 32", "least time"] == pytest.approx(measured / bound)
        assert bound <= sum(own["step_time", "least", what] for what in ("products", "operations", "state"))


def test_it_is_left_out_by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []
    for name, part in bench.PARTS.items():
        monkeypatch.setattr(part, "measure", lambda _, name=name: done.append(name) or [])
    bench.run([], seconds=1.0)
    assert "growth" in done and "roofline" not in done
