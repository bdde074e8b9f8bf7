"""Work grows with sensors, nodes, areas and seeds as its algebra does: counted, not timed."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fusion_sfdia.benchmarks.speed import growth
from fusion_sfdia.benchmarks.speed.support import counting
from fusion_sfdia.benchmarks.speed.support.counting import CallWork, counted
from fusion_sfdia.report.results import Row

TOY = """
import numpy as np
from toy.kernel import compiled

@compiled
def total(a):
    found = 0.0
    for value in a:
        found += value
    return found

@compiled
def product(a, b):
    return np.dot(a, b)

def one_by_one(a):
    return sum(float(value) for value in a)
"""
KERNEL = "from numba import njit\ncompiled = njit(cache=True)\n"
PRODUCTS = """
import numpy as np

def product(a, b):
    return a @ b

def solved(a, b):
    return np.linalg.solve(a, b)

def trace(a, b):
    return np.einsum("...ij,...ji->...", a, b)
"""
COUNT = """
import json
from fusion_sfdia.benchmarks.speed.support.counting import counted, install
install("toy")
import numpy as np
from toy import loops, products
found = {}
for n in (20, 40, 80):
    a, m = np.ones(n), np.eye(n) + 1.0
    calls = {
        "total": lambda: loops.total(np.ones(50 * n)),
        "one_by_one": lambda: loops.one_by_one(a),
        "compiled product": lambda: loops.product(m, m),
        "product": lambda: products.product(m, m),
        "batch": lambda: products.product(np.broadcast_to(m, (n, n, n)), m),
        "solved": lambda: products.solved(m, a),
        "trace": lambda: products.trace(m, m),
    }
    for name, call in calls.items():
        found.setdefault(name, []).append(counted(call))
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def exponents() -> dict[tuple[str, str], list[Row]]:
    found: dict[tuple[str, str], list[Row]] = {}
    for row in growth.measure(1.0):
        found.setdefault((row.detector, row.quantity), []).append(row)
    return found


@pytest.mark.long
@pytest.mark.parametrize("case", growth.CASES, ids=lambda c: f"{c.detector} {c.quantity}")
def test_the_work_grows_as_its_algebra_does(case: growth.Workload, exponents: dict[tuple[str, str], list[Row]]) -> None:
    rows = exponents[case.detector, case.quantity]
    assert [r.condition for r in rows] == list(CallWork._fields)
    assert not growth.excessive(rows)
    operations = next(r.value for r in rows if r.condition == "operations")
    assert operations + 1 > case.expected.operations + growth.ABOVE  # one more power would show


def test_a_power_more_than_expected_is_reported() -> None:
    case = growth.CASES[0]

    def row(what: str, exponent: float) -> Row:
        return Row("bench/growth", "-", case.detector, "none", case.quantity, "growth", exponent, condition=what)

    expected = case.expected._asdict()
    assert not growth.excessive([row(what, p + 0.1) for what, p in expected.items()])
    for what, p in expected.items():
        (sentence,) = growth.excessive([row(what, p + 1)])
        assert sentence == f"loo-glr: {what} grow with sensors^{p + 1:.2f}; expected an exponent of {p}"
    assert growth.excessive([row("memory", float("nan"))])


def test_the_exponent_leaves_out_what_is_constant() -> None:
    for p in (1, 2, 3):
        assert counting.growth(*(1e3 + 30 * n**p for n in (50, 100, 200))) == pytest.approx(p)
    assert counting.growth(7, 7, 7) == 0
    assert counting.growth(100, 90, 180) == counting.growth(0, 90, 180) == 1  # no difference to compare with


@pytest.mark.slow
def test_what_is_counted(tmp_path: Path) -> None:
    """A lost vectorisation shows as Python, a loop of a compiled function and a product as operations."""
    package = tmp_path / "toy"
    package.mkdir()
    for name, text in (("__init__", ""), ("loops", TOY), ("kernel", KERNEL), ("products", PRODUCTS)):
        (package / f"{name}.py").write_text(text)
    start = f"import sys; sys.path[:0] = {[str(tmp_path), *sys.path]!r}\n"
    done = subprocess.run([sys.executable, "-c", start + COUNT], stdout=subprocess.PIPE, check=True)
    found = {name: [CallWork(*w) for w in counts] for name, counts in json.loads(done.stdout).items()}
    n = np.array([20, 40, 80])

    def exponent(name: str, what: str) -> float:
        return counting.growth(*(float(getattr(w, what)) for w in found[name]))

    assert exponent("one_by_one", "python") == pytest.approx(1) and exponent("total", "python") == 0
    assert exponent("total", "operations") == pytest.approx(1, abs=0.1)
    # multiply-adds and elements of the result; objects of Python are about the same number for each size
    known = {"product": n**3 + n**2, "batch": n**4 + n**3, "solved": n**3 / 3 + n**2 + n, "trace": n**2}
    for name, work in {**known, "compiled product": known["product"]}.items():
        counts = [w.operations for w in found[name]]
        np.testing.assert_allclose(np.diff(counts), np.diff(work), rtol=0, atol=2000, err_msg=name)


def test_memory_and_elements_of_a_call() -> None:
    def twice() -> None:
        for _ in range(2):
            np.ones(10_000)

    work = counted(twice)
    assert work.memory == pytest.approx(80_000, abs=4000)
    assert work.operations == pytest.approx(20_000, abs=1000)
    assert counted(twice).python == work.python > 0


def test_counting_begins_before_what_is_counted_is_imported() -> None:
    import fusion_sfdia.derivatives.equation  # noqa: F401

    with pytest.raises(RuntimeError, match=r"fusion_sfdia\.\S* is imported already; call install before"):
        counting.install()
