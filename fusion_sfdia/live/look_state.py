"""The state of a second look as arrays, for the file in which a watch is saved."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.detector import Decision, Detector
from fusion_sfdia.evaluation.events import Event
from fusion_sfdia.evaluation.hindsight_steps import Hindsight
from fusion_sfdia.filters.estimators import GaussianState
from fusion_sfdia.live.second_look import NamedEvent, SecondLook, Seen

Array = NDArray[Any]


def look_arrays(look: SecondLook) -> dict[str, Array]:
    """What `restored_look` takes up again, but for the decisions, as arrays."""
    rows = [*look.window, *look.ahead]
    found = {"read": look.read, "numbers": np.array([look.before, look.count, look.due, look.pause, len(look.window)])}
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
    told = [e.told for e in look.named]
    found["told"] = np.array([(np.nan,) * 4 if e is None else (e.start, e.end, e.size, e.open) for e in told], float)
    found["faults"] = np.array(["" if e is None else e.fault for e in told], str)
    return found


def restored_look(detector: Detector, gap: int, arrays: dict[str, Array], decisions: Sequence[Decision]) -> SecondLook:
    """The same of which `look_arrays` are; decisions: of the last samples."""
    before, count, due, pause, size = arrays["numbers"].tolist()
    core = GaussianState(arrays["x"], arrays["P"]) if "x" in arrays else None
    found = SecondLook(detector, gap, core, before, read=arrays["read"], count=int(count), due=int(due), pause=int(pause))
    found.verdict = str(arrays["verdict"])
    rows = [arrays[name] for name in ("t", "y", "u")] if "t" in arrays else [np.empty(0)] * 3
    number = len(rows[0])
    for k, (t, y, u) in enumerate(zip(*rows, strict=True)):
        steps = tuple((float(s[1]), s[2:]) for s in arrays["between"] if s[0] == k - size)
        decision = decisions[len(decisions) - number + k]
        seen = Seen(float(t), y, u, decision, float(arrays["begins"][k]), steps, arrays["out"][k])
        if k < size:
            after = Hindsight(*(arrays[f"after.{name}"][k] for name in Hindsight._fields))
            found.window.append(seen._replace(after=after))
        else:
            found.ahead.append(seen)
    for row, name, told, fault in zip(
        arrays["named"].tolist(),
        arrays["hypotheses"].tolist(),
        arrays["told"].tolist(),
        arrays["faults"].tolist(),
        strict=True,
    ):
        start, end, magnitude, is_open = told
        event = None if np.isnan(start) else Event(name, start, end, magnitude, "", bool(is_open), fault=fault)
        found.named.append(NamedEvent(int(row[0]), name, row[1], row[2], event, bool(row[3])))
    return found
