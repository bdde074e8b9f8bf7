"""Set inversion agrees with codac's, and codac's rounding mode and precision do not leak."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec

import numpy as np
import pytest
from set_inversion import EQUATIONS, covered, samples, target_of

from fusion_sfdia.derivatives.intervals.codac_adapter import codac_sivia
from fusion_sfdia.derivatives.intervals.interval import Interval
from fusion_sfdia.derivatives.intervals.sivia import sivia

# not imported here: that would change the rounding mode of the whole test run
needs_codac = pytest.mark.skipif(find_spec("codac") is None, reason="needs the optional package codac")


@needs_codac
def test_codac_agrees() -> None:
    box = Interval([-3.0, -3.0], [3.0, 3.0])
    for name in ("ring", "product", "quotient", "powers", "exponential", "kinks", "two"):
        ours, theirs = (f(EQUATIONS[name], target_of(name), box, 0.05) for f in (sivia, codac_sivia))
        assert ours.complete, name
        # two enclosures of one set: each inner area is at most the other outer area (volumes are sums, hence the rounding)
        assert ours.inner_volume <= theirs.outer_volume * (1 + 1e-9), name
        assert theirs.inner_volume <= ours.outer_volume * (1 + 1e-9), name
        if name != "quotient":  # along y = 0, where x / y takes every value, codac keeps boxes of its own
            np.testing.assert_allclose([ours.hull.lo, ours.hull.hi], [theirs.hull.lo, theirs.hull.hi], atol=2 * 0.05)
        points = samples(box, 2000, 6)
        assert not np.any(covered(points, ours.inner) & ~(covered(points, theirs.inner) | covered(points, theirs.boundary))), (
            name
        )


@needs_codac
def test_unsupported_problems_are_rejected() -> None:
    with pytest.raises(ValueError, match="codac has no arctanh"):
        codac_sivia(np.arctanh, Interval(0.0, 1.0), Interval([0.0], [0.5]), 0.1)
    with pytest.raises(ValueError, match="one problem at a time"):
        codac_sivia(np.exp, Interval(0.0, 1.0), Interval([[0.0]], [[0.5]]), 0.1)


@needs_codac
def test_rounding_is_to_nearest_after_codac() -> None:
    tenth = 0.1
    codac_sivia(np.exp, Interval(0.0, 1.0), Interval([0.0], [0.5]), 0.1)
    assert tenth + 2 * tenth == 0.30000000000000004
    assert -tenth - 2 * tenth == -0.30000000000000004
    assert (Interval(1.0) + 1.0).contains(2.0)


@needs_codac
@pytest.mark.skipif(np.finfo(np.longdouble).nmant != 63, reason="needs the x87 unit's extended precision, of x86")
def test_extended_precision_is_that_of_before() -> None:
    """In a process of its own: once codac has left double precision, norms and what is made of them round otherwise."""
    script = (
        "import numpy as np\nfrom fusion_sfdia.derivatives.intervals.codac_adapter import Interval, codac_sivia\n"
        "codac_sivia(np.exp, Interval(0.0, 1.0), Interval([0.0], [0.5]), 0.1)\n"
        "print(np.longdouble(1) + np.longdouble(2) ** -60 != 1)"
    )
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert ended.stdout == "True\n", ended.stderr


@needs_codac
def test_intervals_refuse_another_rounding_mode() -> None:
    """In a process of its own: importing codac changes the mode."""
    script = "import codac\nfrom fusion_sfdia.derivatives.intervals.interval import Interval\nInterval(1.0) + 1.0"
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert "RuntimeError: the processor does not round to nearest" in ended.stderr
