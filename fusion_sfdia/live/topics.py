"""Which MQTT topics are the sensors and inputs of a plant, and where its verdicts go: the file topics.toml."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fusion_sfdia.core.arguments import shown
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.live.tables import load_tables, require_known, require_texts
from fusion_sfdia.live.values import Value, real

SECONDS = {"s": 1.0, "ms": 1e-3}


class Source(NamedTuple):
    """A topic, and where its JSON object has value, time and quality: keys, joined by dots where objects are nested."""

    topic: str
    value: str = "value"
    time: str = "time"
    quality: str = "quality"


@dataclass(frozen=True)
class Topics:
    """Topics, and how their payloads are read.

    read: the topic of each sensor and input, or a table of the fields of `Source`; payloads in the plant's units. write: of
    some sensors {"value", "sigma", "verdict": topic}, and the topics "verdict" and "alarm" of the whole. status: a topic that
    says "watching", or "gone". good: values of quality that are good, any other is bad, upper and lower case alike. epoch: unit
    of times that are numbers, since 1970, "s" or "ms". together: seconds by which stamps of one row may differ, None for half
    the plant's dt. stale: as in `Values`. retry: seconds between attempts to connect; qos: quality of service, 0, 1 or 2. user,
    and the password in a file (password_file) or an environment variable (password_variable). ca, certificate, key: files for
    TLS.
    """

    read: dict[str, Any]
    write: dict[str, Any] = field(default_factory=dict)
    status: str | None = None
    good: tuple[Any, ...] = ("good", "ok", True, 192)
    epoch: str = "s"
    together: float | None = None
    stale: float | None = None
    retry: float = 5.0
    qos: int = 1
    user: str | None = None
    password_file: str | None = None
    password_variable: str | None = None
    ca: str | None = None
    certificate: str | None = None
    key: str | None = None

    @property
    def sources(self) -> dict[str, Source]:
        """Where the value of each sensor and input comes from."""
        return {name: Source(at) if isinstance(at, str) else Source(**at) for name, at in self.read.items()}

    @property
    def password(self) -> str | None:
        """The password, None without one; ValueError where the environment variable is not set."""
        if self.password_file is not None:
            return Path(self.password_file).read_text(encoding="utf-8").rstrip("\r\n")
        if self.password_variable is None:
            return None
        if (found := os.environ.get(self.password_variable)) is None:
            raise ValueError(f"password_variable is {self.password_variable!r}, which the environment does not have; set it")
        return found

    def value(self, source: Source, payload: bytes, arrived: datetime | None) -> Value:
        """What a payload states: a number, or a JSON object; NaN for anything else and of bad quality.

        arrived: the time where the payload has none.
        """
        try:
            found = json.loads(payload)
        except (ValueError, RecursionError):
            return Value(np.nan, arrived)
        if not isinstance(found, dict):
            return Value(real(found), arrived)
        quality, stamp = _at(found, source.quality), _at(found, source.time)
        number = real(_at(found, source.value))
        counts = quality is None or _plain(quality) in set(map(_plain, self.good))
        return Value(number if counts else np.nan, arrived if stamp is None else self._stamp(stamp))

    def _stamp(self, stamp: Any) -> datetime | None:
        """A time, in UTC where it states no zone; None of what is no time."""
        try:
            if isinstance(stamp, str):
                found = datetime.fromisoformat(stamp)
                return found if found.tzinfo else found.replace(tzinfo=UTC)
            return datetime.fromtimestamp(float(stamp) * SECONDS[self.epoch], UTC)
        except (ValueError, TypeError, OverflowError, OSError):
            return None


def load_topics(path: str | Path, plant: Plant) -> Topics:
    """Read topics.toml: the fields of `Topics`, read and write as tables; ValueError for anything else, see `load_tables`."""
    known = [f.name for f in fields(Topics)]
    found = load_tables(path, plant, known, ("together", "stale", "retry"), _require_source, _require_topic, _address)
    require_texts(path, found, ("user", "password_file", "password_variable", "ca", "certificate", "key"))
    for name, value, expected in (
        ("epoch", found.get("epoch", "s"), tuple(SECONDS)),
        ("qos", found.get("qos", 1), (0, 1, 2)),
    ):
        if value not in expected:
            raise ValueError(f"{path}: {name} is {shown(value)}; expected {' or '.join(map(repr, expected))}")
    if "good" in found:
        if not isinstance(found["good"], list) or not found["good"]:
            raise ValueError(f"{path}: good is {shown(found['good'])}; expected a list of values, such as ['good', 192]")
        found["good"] = tuple(found["good"])
    if "password_file" in found and "password_variable" in found:
        raise ValueError(f"{path}: password_file and password_variable both state the password; give one")
    return Topics(**found)


def _require_source(where: str, value: Any) -> None:
    if not isinstance(value, dict):
        return _require_topic(where, value)
    require_known(f"{where}:", value, Source._fields)
    for what in Source._fields:
        if what != "topic" and not isinstance(value.get(what, ""), str):
            raise ValueError(f"{where}: {what} is {shown(value[what])}; expected a key, such as 'pv.value'")
    _require_topic(f"{where}: topic", value.get("topic"))


def _address(value: Any) -> tuple[str, str]:
    """The topic, and the key of the value on it."""
    source = Source(value) if isinstance(value, str) else Source(**value)
    return source.topic, source.value


def _require_topic(where: str, value: Any) -> None:
    if not isinstance(value, str) or not value or set("+#") & set(value):
        raise ValueError(f"{where} is {shown(value)}; expected a topic, such as 'plant/TT-101', without + and #")


def _at(found: Any, path: str) -> Any:
    """The value at a key, or at keys joined by dots; None where there is none."""
    if isinstance(found, dict) and path in found:
        return found[path]
    for key in path.split("."):
        found = found.get(key) if isinstance(found, dict) else None
    return found


def _plain(value: Any) -> Any:
    return value.lower() if isinstance(value, str) else (type(value) is bool, value) if isinstance(value, int | float) else None
