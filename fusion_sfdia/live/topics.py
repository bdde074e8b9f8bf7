"""Which MQTT topics are the sensors and inputs of a plant, and where its verdicts go: the file topics.toml."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from fusion_sfdia.common.arguments import require_names, shown
from fusion_sfdia.live.address_tables import (
    columns_of,
    load_tables,
    require_bounds,
    require_readers,
    require_states,
    require_texts,
)
from fusion_sfdia.live.live_readings import DoubleKeyError, Reader, json_value
from fusion_sfdia.live.security import Connection, require_connection
from fusion_sfdia.live.values import MAX_LAG, MAX_LEAD, TimedValue
from fusion_sfdia.logs.columns import Source
from fusion_sfdia.logs.conversion import conversion
from fusion_sfdia.logs.log_map import OPC_DA, OPC_UA, LogMap
from fusion_sfdia.logs.numbers import Numbers, good_codes
from fusion_sfdia.logs.times import instant
from fusion_sfdia.plant.plant import Plant

EPOCHS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
ABSENT = object()
NO_TIME = (ABSENT, None, "", 0, "0")  # of sources without a clock, or whose clock is not set
BAD = ("bad", "uncertain", "invalid", "error", "false", "fault", "not")  # of texts of quality that are known not to be good
MOST_KEYS, DEEPEST = 5, 3


class TopicSource(NamedTuple):
    """A topic, and where its JSON object has value, time and quality: keys, joined by dots where objects are nested.

    unit: of the numbers, "" for the plant's. states: the numbers of texts and of true and false.
    """

    topic: str
    value: str = "value"
    time: str = "time"
    quality: str = "quality"
    unit: str = ""
    states: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True)
class Topics(Connection):
    """Topics, and how their payloads are read.

    read: the topic of each sensor and input, or a table of the fields of `TopicSource`. write: of some sensors {"value",
    "sigma", "verdict", "health": topic}, and the topics "verdict" and "alarm" of the whole. status: a topic with the `Report`
    of the watch as JSON, or "gone". events: a topic for the JSON line of each change. good: values of quality that are good,
    upper and lower case alike, of texts also longer ones that begin so; "opc-da" or "opc-ua" for the codes of these; any
    other is bad. epoch: unit of times that are numbers since 1970 where their size does not tell. time_format, tz: of times
    in text, as format and tz of a LogMap. decimal: the mark of decimals in texts. together: seconds by which stamps of one
    row may differ, None for half the plant's dt. stale, max_lead, max_lag: as in `Values`. retry: seconds between attempts to
    connect; qos: quality of service, 0, 1 or 2. ca: file of the authority of the broker, for TLS; certificate, key: files of
    an own certificate. The rest of the connection: see `Connection`.
    """

    read: dict[str, Any]
    write: dict[str, Any] = field(default_factory=dict)
    status: str | None = None
    events: str | None = None
    good: str | tuple[Any, ...] = ("good", "ok", True, 192)
    epoch: str = "s"
    time_format: str = ""
    tz: str = ""
    decimal: str = "."
    together: float | None = None
    stale: float | None = None
    max_lead: float = MAX_LEAD
    max_lag: float = MAX_LAG
    retry: float = 5.0
    qos: int = 1
    ca: str | None = None
    certificate: str | None = None
    key: str | None = None

    @property
    def sources(self) -> dict[str, TopicSource]:
        """Where the value of each sensor and input comes from."""
        return {name: TopicSource(at) if isinstance(at, str) else TopicSource(**at) for name, at in self.read.items()}

    @cached_property
    def times(self) -> LogMap:
        """How times are written; ValueError for a format or zone that there is not."""
        return LogMap(format=self.time_format, tz=self.tz, decimal=self.decimal)

    def columns(self, plant: Plant) -> tuple[Source, ...]:
        """The topics as columns of a log, of which they are the tags, with the key where it is none of the usual ones."""
        usual = TopicSource("").value
        tags = {name: s.topic if s.value == usual else f"{s.topic} {s.value}" for name, s in self.sources.items()}
        return columns_of(plant, {name: (tag, self.sources[name].unit) for name, tag in tags.items()})

    def reader(self, name: str, unit: str) -> Reader:
        """How the values of a sensor or an input in this unit are read; ValueError for a unit that does not convert to it."""
        source = self.sources[name]
        return Reader(unit, conversion(source.unit, unit), Numbers(self.decimal, states=source.states))

    def value(self, source: TopicSource, payload: bytes, arrived: datetime | None, read: Reader | None = None) -> TimedValue:
        """What a payload states: a number, with or without a unit, or a JSON object; NaN for anything else and of bad quality.

        arrived: the time where the payload has none. read: how its value is read.
        """
        read = read or Reader(numbers=Numbers(self.decimal, states=source.states))
        try:
            text = payload.decode().strip()
            found = json_value(text)
        except DoubleKeyError as error:
            return TimedValue(np.nan, arrived, arrived, False, fault=self._unusable(source, payload, str(error)))
        except UnicodeDecodeError:
            return TimedValue(np.nan, arrived, arrived, False, fault=self._unusable(source, payload, "no text in UTF-8"))
        except ValueError:
            found = text
        if not isinstance(found, dict):
            number, fault = read(found)
            return TimedValue(number, arrived, arrived, False, fault=fault and self._unusable(source, payload, fault))
        number, fault = self._number(source, found, read)
        stamp, has_time = arrived, False
        if (given := _at(found, source.time)) not in NO_TIME or isinstance(given, bool):
            stamp, has_time = self._stamp(given, arrived), True
            if stamp is None:
                expected = f"a time as {self.time_format}" if self.time_format else "ISO 8601, or a number since 1970"
                fault = f"its time {shown(given)} is none; expected {expected}: state time_format for another form"
        return TimedValue(number, stamp, arrived, has_time, fault=fault and self._unusable(source, payload, fault))

    def _number(self, source: TopicSource, found: dict[str, Any], read: Reader) -> tuple[float, str]:
        """The number of an object, and why it cannot be used, "" where it can or is stated to be missing."""
        if (value := _at(found, source.value)) is ABSENT:
            keys = sorted(_keys(found), key=lambda key: key.casefold() != source.value.casefold())
            cure = f": give value = {keys[0]!r} in the table of its topic" if keys else ""
            has = ", ".join(map(shown, keys[:MOST_KEYS])) or "none with a number"
            return np.nan, f"no key {source.value!r}; its keys: {has}{cure}"
        if (quality := _at(found, source.quality)) is not ABSENT and quality is not None:
            try:
                if not self._is_good(quality):
                    return np.nan, ""
            except ValueError as error:
                return np.nan, str(error)
        return read(value)

    def _is_good(self, quality: Any) -> bool:
        """Whether a value of quality is good; ValueError for one that is neither good nor known to be bad."""
        if isinstance(self.good, str):
            try:
                if isinstance(quality, int) and not 0 <= quality < 2**32:
                    raise ValueError("no code")
                return bool(good_codes([quality], self.good)[0])
            except (ValueError, TypeError):
                raise ValueError(f"its quality {shown(quality)} is no code of {self.good!r}") from None
        known = [_plain(good) for good in self.good]
        plain = _plain(quality)
        if plain is not None and plain in known:
            return True
        if isinstance(plain, str):
            if any(isinstance(good, str) and plain.startswith(good) and not plain[len(good)].isalnum() for good in known):
                return True
            if plain.startswith(BAD):
                return False
        if quality is False:
            return False
        raise ValueError(
            f"its quality is {shown(quality)}, not among the good ones, {', '.join(map(shown, self.good))}: state good, "
            "a list, 'opc-da' or 'opc-ua'"
        )

    def _unusable(self, source: TopicSource, payload: bytes, why: str) -> str:
        return f"topic {source.topic}: payload {shown(payload.decode(errors='replace'))}: {why}"

    def _stamp(self, stamp: Any, arrived: datetime | None) -> datetime | None:
        """A time, in UTC where it states no zone; None of what is no time."""
        try:
            seconds, found = instant(stamp, self.times, near=arrived, now=arrived)
            return found or datetime.fromtimestamp(seconds * EPOCHS[self.epoch], UTC)
        except (ValueError, TypeError, OverflowError, OSError):
            return None


def load_topics(path: str | Path, plant: Plant) -> Topics:
    """Read topics.toml: the fields of `Topics`, read and write as tables; ValueError for anything else, see `load_tables`."""
    known = [f.name for f in fields(Topics)]
    found = load_tables(path, plant, known, ("together", "stale", "retry"), _require_source, _require_topic, _address)
    require_bounds(path, found)
    require_texts(path, found, ("time_format", "tz"))
    require_connection(path, found, "ca", "certificate", "key")
    for name, value, expected in (
        ("epoch", found.get("epoch", "s"), tuple(EPOCHS)),
        ("decimal", found.get("decimal", "."), (".", ",")),
        ("qos", found.get("qos", 1), (0, 1, 2)),
    ):
        if value not in expected:
            raise ValueError(f"{path}: {name} is {shown(value)}; expected {' or '.join(map(repr, expected))}")
    if "good" in found and found["good"] not in (OPC_DA, OPC_UA):
        if not isinstance(found["good"], list) or not found["good"]:
            raise ValueError(
                f"{path}: good is {shown(found['good'])}; expected a list of values, such as ['good', 192], or "
                "'opc-da' or 'opc-ua'"
            )
        found["good"] = tuple(found["good"])
    topics = Topics(**found)
    try:
        topics.times  # noqa: B018, refuses a format or zone that there is not
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    require_readers(path, topics.sources, topics.reader, plant)
    return topics


def _require_source(where: str, value: Any) -> None:
    if not isinstance(value, dict):
        return _require_topic(where, value)
    require_names(f"{where}:", value, TopicSource._fields)
    for what in TopicSource._fields:
        if what not in ("topic", "states") and not isinstance(value.get(what, ""), str):
            expected = "a unit, such as 'degC'" if what == "unit" else "a key, such as 'pv.value'"
            raise ValueError(f"{where}: {what} is {shown(value[what])}; expected {expected}")
    require_states(where, value)
    _require_topic(f"{where}: topic", value.get("topic"))


def _address(value: Any) -> tuple[str, str]:
    """The topic, and the key of the value on it."""
    source = TopicSource(value) if isinstance(value, str) else TopicSource(**value)
    return source.topic, source.value


def _require_topic(where: str, value: Any) -> None:
    if not isinstance(value, str) or not value or set("+#") & set(value):
        raise ValueError(f"{where} is {shown(value)}; expected a topic, such as 'plant/TT-101', without + and #")


def _at(found: Any, path: str) -> Any:
    """The value at a key, or at keys joined by dots; ABSENT where there is none."""
    if isinstance(found, dict) and path in found:
        return found[path]
    for key in path.split("."):
        found = found.get(key, ABSENT) if isinstance(found, dict) else ABSENT
    return found


def _keys(found: dict[str, Any], depth: int = 1) -> Iterator[str]:
    """The keys of numbers and texts, joined by dots where objects are nested."""
    for key, value in found.items():
        if isinstance(value, dict) and depth < DEEPEST:
            yield from (f"{key}.{inner}" for inner in _keys(value, depth + 1))
        elif isinstance(value, int | float | str):
            yield key


def _plain(value: Any) -> Any:
    return (
        value.strip().lower()
        if isinstance(value, str)
        else (type(value) is bool, value)
        if isinstance(value, int | float)
        else None
    )
