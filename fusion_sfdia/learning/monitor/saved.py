"""What was learnt as arrays and, for JSON, names and settings, and back: nothing that imports code."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from fusion_sfdia.learning.monitor.channels import Channels
from fusion_sfdia.learning.monitor.held_out import Family, LearntLimits, Limits
from fusion_sfdia.learning.monitor.residuals import Scale, Test
from fusion_sfdia.learning.monitor.stated_physics import Stated
from fusion_sfdia.learning.monitor.steps import JumpLimits
from fusion_sfdia.plant.signals import Signal

Arrays = dict[str, NDArray[Any]]

OF_CHANNELS = ("used", "hold", "far", "floor", "mean", "sd")
OF_SCALE = ("centre", "precision", "level", "lead")
OF_LIMITS = ("limit", "trend", "explained", "partner", "deviation")


def packed(channels: Channels, learnt: LearntLimits) -> tuple[Arrays, dict[str, Any]]:
    """Arrays by name, and the rest."""
    arrays: Arrays = {name: getattr(channels, name) for name in OF_CHANNELS} | {"edges": learnt.edges}
    arrays |= {f"stated {name}": value for name, value in learnt.stated._asdict().items()}
    arrays |= {f"jumps {name}": value for name, value in learnt.jumps._asdict().items()}
    families = {"own": Family(learnt.model, learnt.limits)} | ({"absolute": learnt.absolute} if learnt.absolute else {})
    return arrays, {
        "sensors": [[s.name, s.unit] for s in channels.sensors],
        "inputs": [[s.name, s.unit] for s in channels.inputs],
        "left_out": channels.left_out,
        "still": channels.still,
        "longest": learnt.longest,
        "families": {name: _packed(name, family, arrays) for name, family in families.items()},
    }


def unpacked(arrays: Arrays, about: dict[str, Any]) -> tuple[Channels, LearntLimits]:
    """What `packed` was given; KeyError, TypeError or ValueError for anything else."""
    sensors, inputs = (tuple(Signal(*s) for s in about[what]) for what in ("sensors", "inputs"))
    used, hold, far, floor, mean, sd = (arrays[name] for name in OF_CHANNELS)
    channels = Channels(sensors, inputs, used, hold, far, floor, mean, sd, dict(about["left_out"]), dict(about["still"]))
    families = {name: _unpacked(name, given, arrays) for name, given in about["families"].items()}
    own = families["own"]
    stated = Stated(*(arrays[f"stated {name}"] for name in Stated._fields))
    jumps = JumpLimits(*(arrays[f"jumps {name}"] for name in JumpLimits._fields))
    return channels, LearntLimits(
        own.model, own.limits, arrays["edges"], stated, jumps, families.get("absolute"), int(about["longest"])
    )


def _packed(name: str, family: Family, arrays: Arrays) -> dict[str, Any]:
    for scale in family.model:
        arrays |= {f"{name} {scale.w} {what}": getattr(scale, what) for what in OF_SCALE}
    arrays |= {f"{name} {what}": getattr(family.limits, what) for what in OF_LIMITS}
    return {
        "scales": [[s.w, s.ridge, s.limit] for s in family.model],
        "tests": [[t.kind, t.scale] for t in family.limits.tests],
        "rate": family.limits.rate,
        "alarms": family.limits.alarms,
    }


def _unpacked(name: str, given: dict[str, Any], arrays: Arrays) -> Family:
    model = []
    for w, ridge, limit in given["scales"]:
        centre, precision, level, lead = (arrays[f"{name} {w} {what}"] for what in OF_SCALE)
        model.append(Scale(w, ridge, centre, precision, level, lead, limit))
    tests = tuple(Test(*t) for t in given["tests"])
    limit, trend, explained, partner, deviation = (arrays[f"{name} {what}"] for what in OF_LIMITS)
    (mean, low, high), (count, least, most) = given["rate"], given["alarms"]
    rates = (mean, low, high), (count, least, most)
    return Family(tuple(model), Limits(tests, limit, *rates, (), (), trend, explained, partner, deviation))
