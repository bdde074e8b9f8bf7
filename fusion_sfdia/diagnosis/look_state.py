"""The state of a second look as arrays, for the file in which a watch is saved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.detectors.detector import Decision, Detector
from fusion_sfdia.detectors.storage import SavedArrays, whole_numbers
from fusion_sfdia.diagnosis.events import Event
from fusion_sfdia.diagnosis.hindsight import LEAD
from fusion_sfdia.diagnosis.hindsight_steps import Hindsight
from fusion_sfdia.diagnosis.second_look import WINDOW, NamedEvent, SecondLook, Seen
from fusion_sfdia.filters.estimators import GaussianState

Array = NDArray[Any]


def look_arrays(look: SecondLook) -> dict[str, Array]:
    """What `restored_look` takes up again, but for the decisions, as arrays."""
    rows = [*look.window, *look.ahead]
    found = {
        "said": np.array(sorted(look.said), str),
        "numbers": np.array([look.before, look.count, look.due, look.pause, len(look.window)]),
    }
    found |= {"verdict": np.array(look.verdict)}
    if look.core is not None:
        found |= {"x": look.core.x, "P": look.core.P}
    for name in ("t", "y", "u", "begins", "out") if rows else ():
        found[name] = np.array([getattr(s, name) for s in rows])
    for name in Hindsight._fields if look.window else ():
        found[f"after.{name}"] = np.array([getattr(s.after, name) for s in look.window])
    steps = [(k, t, *u) for k, s in enumerate(look.ahead) for t, u in s.between]
    found["between"] = np.array(steps or np.empty((0, 2)), float)
    found["named"] = np.array([(e.id, e.start, e.end, e.final) for e in look.named], float).reshape(-1, 4)
    found["hypotheses"] = np.array([e.hypothesis for e in look.named], str)
    reported = [e.reported for e in look.named]
    found["reported"] = np.array(
        [(np.nan,) * 4 if e is None else (e.start, e.end, e.size, e.open) for e in reported], float
    ).reshape(-1, 4)
    found["faults"] = np.array(["" if e is None else e.fault for e in reported], str)
    return found


def restored_look(fresh: SecondLook, saved: SavedArrays, decisions: Sequence[Decision]) -> SecondLook:
    """The look whose `look_arrays` were saved. fresh: one of the same detector, for what is not saved; decisions: of the last
    samples. ValueError for arrays that `look_arrays` did not give.
    """
    detector = fresh.detector
    n, m = len(detector.plant.sensors), len(detector.plant.inputs)
    numbers = saved.take("numbers", "f", 5)
    before = float(numbers[0])
    count, due, pause, size = whole_numbers("numbers", numbers[1:])
    core = None
    if "x" in saved.arrays:
        x = saved.take("x", "f", None)
        core = GaussianState(x, saved.take("P", "f", x.size, x.size))
    said, verdict = set(saved.take("said", "U", None).tolist()), str(saved.take("verdict", "U"))
    found = replace(fresh.anew(), core=core, before=before, count=count, due=due, pause=pause, said=said, verdict=verdict)
    times = saved.take("t", "f", None) if "t" in saved.arrays else np.empty(0)
    rows = times.size
    if not size <= rows <= min(len(decisions), size + LEAD) or size > WINDOW:
        raise ValueError(f"'numbers' states {size} of {rows} rows")
    y, u, begins, out = (
        saved.take(name, kind, rows, *axes) if rows else np.empty((0, *axes))
        for name, kind, axes in (("y", "f", (n,)), ("u", "f", (m,)), ("begins", "f", ()), ("out", "b", (n,)))
    )
    after = [
        saved.take(f"after.{name}", kind, size, *axes) if size else np.empty((0, *axes))
        for name, kind, axes in zip(Hindsight._fields, "ffffi", ((n,), (n,), (n,), (), ()), strict=True)
    ]
    between = saved.take("between", "f", None, None)
    if between.shape[1] != (2 + m if len(between) else 2):
        raise ValueError(f"'between' has shape {between.shape}; expected {2 + m} columns, 2 without rows")
    ahead = whole_numbers("between", between[:, 0])
    for k in range(rows):
        steps = tuple((float(s[1]), s[2:]) for at, s in zip(ahead, between, strict=True) if at == k - size)
        seen = Seen(float(times[k]), y[k], u[k], decisions[len(decisions) - rows + k], float(begins[k]), steps, out[k])
        if k < size:
            found.window.append(seen._replace(after=Hindsight(*(values[k] for values in after))))
        else:
            found.ahead.append(seen)
    found.named += _restored_events(detector, saved)
    return found


def _restored_events(detector: Detector, saved: SavedArrays) -> list[NamedEvent]:
    named = saved.take("named", "f", None, 4)
    names = saved.take("hypotheses", "U", len(named)).tolist()
    reported = saved.take("reported", "f", len(named), 4).tolist()
    faults = saved.take("faults", "U", len(named)).tolist()
    if unknown := set(names) - set(detector.plant.sensor_names):
        raise ValueError(f"'hypotheses' has {unknown}, which are no sensors")
    found = []
    for k, (number, final) in enumerate(whole_numbers("named", named[:, [0, 3]])):
        start, end, size, is_open = reported[k]
        event = None if np.isnan(start) else Event(names[k], start, end, size, "", bool(is_open), fault=faults[k])
        found.append(NamedEvent(number, names[k], float(named[k, 1]), float(named[k, 2]), event, bool(final)))
    return found
