"""A watch on an MQTT broker: messages become rows, and verdicts are published."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from importlib import import_module
from queue import Empty, Full, Queue
from typing import Any, NamedTuple

import numpy as np

from fusion_sfdia.common.errors import MissingPackageError
from fusion_sfdia.diagnosis.device_health import DeviceHealth
from fusion_sfdia.diagnosis.watch import Sample
from fusion_sfdia.live import security
from fusion_sfdia.live.address_tables import units_of
from fusion_sfdia.live.lines import health_results, results
from fusion_sfdia.live.saving import SavedWatch
from fusion_sfdia.live.status import Report, Status
from fusion_sfdia.live.topics import Topics
from fusion_sfdia.live.values import TimedValue, Values

QUEUED = 10_000  # messages
CONNECTING = 5.0  # s


class Message(NamedTuple):
    """What came on a topic, and when; None of a retained message, whose time is not known."""

    topic: str
    payload: bytes
    arrived: datetime | None


def paho() -> Any:
    """The client of the package; MissingPackageError where it is not installed."""
    try:
        return import_module("paho.mqtt.client")
    except ModuleNotFoundError as error:
        raise MissingPackageError("a watch on MQTT needs paho-mqtt; install it: pip install 'fusion-sfdia[mqtt]'") from error


def address(url: str) -> tuple[str, int, bool]:
    """Host, port and whether TLS is used, of mqtt://host[:port] or mqtts://host[:port]; ValueError for anything else."""
    scheme, host, port = security.address("--mqtt", url, security.SCHEMES["mqtt"], ("", "/"))
    return host, port, scheme == "mqtts"


def watch_broker(saved: SavedWatch, url: str, topics: Topics, *, allow_plain_password: bool = False) -> None:
    """Watch the topics of a broker until interrupted; whenever the connection is lost, another is made.

    Messages wait in a queue while a row is diagnosed. Where more than QUEUED wait, the oldest is lost, and counted. What was
    published while there was no connection is a gap. UntrustedError where the broker's certificate is not known; ValueError for
    a password without TLS, unless that is allowed.
    """
    host, port, tls = address(url)
    security.require_encrypted(topics.password is not None, tls, allow_plain_password, "use mqtts://")
    bridge = MqttBridge(saved, url, topics)
    if bridge.context is not None:
        security.require_known_broker(host, port, bridge.context, CONNECTING)
    bridge.client.connect_async(host, port)
    bridge.client.loop_start()
    try:
        while True:
            bridge.take(bridge.next())
    finally:
        bridge.unvouched()
        if topics.status is not None and bridge.client.is_connected():
            bridge.client.publish(topics.status, "gone", topics.qos, retain=True).wait_for_publish(1.0)
        bridge.client.disconnect()
        bridge.client.loop_stop()


class MqttBridge:
    """Between the topics of a broker and a watch. The callbacks run in the thread of the client, all else in the caller's."""

    def __init__(
        self, saved: SavedWatch, url: str, topics: Topics, now: Callable[[], datetime] = lambda: datetime.now(UTC)
    ) -> None:
        mqtt = paho()
        _, _, tls = address(url)
        self.context = security.tls_context(topics) if tls else None
        self.saved, self.url, self.topics, self.now = saved, url, topics, now
        self.sources = sources = topics.sources
        plant = saved.watch.detector.plant
        saved.watch.unread.update({*plant.sensor_names} - {*sources})
        self.by_topic: dict[str, list[str]] = {}
        for name, source in sources.items():
            self.by_topic.setdefault(source.topic, []).append(name)
        self.readers = {name: topics.reader(name, unit) for name, unit in units_of(plant).items() if name in sources}
        together = topics.together or plant.dt / 2
        values = Values(
            saved.watch,
            topics.stale,
            topics.max_lead,
            topics.max_lag,
            together=together,
            sources={name: source.topic for name, source in sources.items()},
        )
        self.rows = TopicRows(values, len(topics.read), together)
        self.queue: Queue[Message] = Queue(QUEUED)
        self.remarks: Queue[str] = Queue(100)
        self.lost, self.is_up = 0, True
        self.client = client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
        client.reconnect_delay_set(topics.retry, topics.retry)
        client.max_queued_messages_set(QUEUED)
        if topics.user is not None:
            client.username_pw_set(topics.user, topics.password)
        if self.context is not None:
            client.tls_set_context(self.context)
        if topics.status is not None:
            client.will_set(topics.status, "gone", topics.qos, retain=True)
        saved.status = saved.status or Status(saved.watch)
        saved.status.listeners.append(self._report)
        if (events := topics.events) is not None:
            saved.outlets.append(lambda change, line: self._publish_line(events, line))
        client.on_connect, client.on_connect_fail = self._connected, lambda *_: self._down(self._failure())
        client.on_disconnect = lambda c, u, flags, reason, p: self._down(str(reason)) if reason.is_failure else None
        client.on_subscribe, client.on_message = self._subscribed, self._message

    def next(self) -> Message:
        """The next message; what the other thread has to remark is said meanwhile."""
        while True:
            try:
                found = self.queue.get(timeout=1.0)
            except Empty:
                found = None
            while not self.remarks.empty():
                self.saved.watch.refused(self.remarks.get())
            if self.lost:
                lost, self.lost = self.lost, 0
                self.saved.watch.refused(f"{self.url}: {lost} messages were lost, as they came faster than they were diagnosed")
            if found is not None:
                return found

    def take(self, message: Message) -> None:
        """Read a message, diagnose the rows that it completes, and publish what is asked for."""
        for name in self.by_topic.get(message.topic, ()):
            value = self.topics.value(self.sources[name], message.payload, message.arrived, self.readers[name])
            if message.arrived is None:
                value = value._replace(arrived=self.now(), retained=True)
            for row in self.rows.take(name, value):
                for sample in self.saved.update(*row):
                    self._publish(sample)

    def _publish(self, sample: Sample) -> None:
        """{"value": 1.2, "time": "2026-03-01 14:00:00+00:00"}, which stays with the broker for those that come later; a value
        that is not known is null.
        """
        if not self.client.is_connected():
            return
        time = self.saved.watch.clock.at(sample.t)
        for topic, value in results(self.saved.watch.detector, sample, self.topics.write):
            self._keep(topic, None if value != value else value, time)

    def _keep(self, topic: str, value: Any, time: str | None) -> None:
        self.client.publish(topic, json.dumps({"value": value, "time": time}), self.topics.qos, retain=True)

    def _connected(self, client: Any, userdata: Any, flags: Any, reason: Any, properties: Any) -> None:
        if reason.is_failure:
            return self._down(str(reason))
        client.subscribe([(topic, self.topics.qos) for topic in self.by_topic])

    def _subscribed(self, client: Any, userdata: Any, mid: int, reasons: list[Any], properties: Any) -> None:
        for topic, reason in zip(self.by_topic, reasons, strict=True):
            if reason.is_failure:
                self._remark(f"{self.url}: topic {topic} is not given ({reason})")
        if not self.is_up:
            self._remark(f"{self.url}: connected again")
        self.is_up = True
        if self.saved.status is not None:
            self._report(self.saved.status.report())

    def _failure(self) -> str:
        """Why no connection was made."""
        host, port, _ = address(self.url)
        try:
            if self.is_up and self.context is not None:
                security.require_known_broker(host, port, self.context, CONNECTING)
        except (OSError, security.UntrustedError) as error:
            return str(error)
        return "refused or not reachable"

    def _publish_line(self, topic: str, line: str) -> None:
        """A change, which the client keeps until it is connected if qos is 1 or 2, and where there is room."""
        mqtt = paho()
        lost = (mqtt.MQTT_ERR_QUEUE_SIZE,) if self.topics.qos else (mqtt.MQTT_ERR_NO_CONN,)
        if self.client.publish(topic, line, self.topics.qos).rc in lost:
            self._remark(f"{self.url}: a change was not published")

    def _report(self, report: Report) -> None:
        """Publish the status and the health of sensors, which stay with the broker until others come, or the will, "gone"."""
        if not self.client.is_connected():
            return
        for topic, health in health_results(report, self.topics.write):
            self._keep(topic, health.name, report.last_row or None)
        if self.topics.status is not None:
            self.client.publish(self.topics.status, report.json, self.topics.qos, retain=True)

    def unvouched(self) -> None:
        """At the end, the health of all sensors as what it is without a watch: to be checked."""
        if self.saved.status is not None:
            report = self.saved.status.report()
            self._report(report._replace(device_health=dict.fromkeys(report.device_health, DeviceHealth.CHECK_FUNCTION)))

    def _down(self, why: str) -> None:
        if self.is_up:
            self._remark(f"{self.url}: no connection ({why}); tried again every {self.topics.retry:g} s")
        self.is_up = False

    def _remark(self, text: str) -> None:
        if not self.remarks.full():
            self.remarks.put(text)

    def _message(self, client: Any, userdata: Any, message: Any) -> None:
        found = Message(message.topic, message.payload, None if message.retain else self.now())
        while True:
            try:
                return self.queue.put_nowait(found)
            except Full:
                try:
                    self.queue.get_nowait()
                    self.lost += 1
                except Empty:
                    pass


class TopicRows:
    """Rows from values that arrive one after another.

    A row has the values whose stamps are within `together` s of its first one. It is complete when each of the `count` names
    has one, or when a value with a later stamp comes; a name without one keeps its last value, unless that is stale. A value
    without a time belongs to the row of its arrival, one that is dropped for its time is missing in it.
    """

    def __init__(self, values: Values, count: int, together: float) -> None:
        self.values, self.count, self.together = values, count, together
        self.latest: dict[str, TimedValue] = {}
        self.fresh: set[str] = set()
        self.first: datetime | None = None  # stamp of the row that is not complete

    def take(self, name: str, value: TimedValue) -> Iterator[tuple[datetime, Any, Any]]:
        """The rows that a value completes, none, one or two; a repeated value is dropped."""
        if (counts := self.values.checked(name, value)) is None or counts.stamp is None:
            return
        value, stamp = counts, counts.stamp
        before = self.latest.get(name)
        if before is not None and before.stamp is not None and stamp <= before.stamp:
            if (before.stamp - stamp).total_seconds() > self.together and name not in self.fresh:
                self.latest[name] = before._replace(number=np.nan)  # its clock was set back: it has no reading of this row
            return
        if value.has_time and self.values.newest is None and self.first is not None:
            self._shift(stamp)
        if self.first is not None and (stamp - self.first).total_seconds() > self.together:
            yield from self._complete()
        self.latest[name] = value
        if self.first is None and (self.values.newest is None or stamp > self.values.newest):
            self.first = stamp
        if self.first is not None and (self.first - stamp).total_seconds() <= self.together:
            self.fresh.add(name)
            if len(self.fresh) == self.count:
                yield from self._complete()

    def _shift(self, stamp: datetime) -> None:
        """Put the first row, of values without a time so far, on the clocks of the sources, with their first stamp."""
        if any(self.latest[name].has_time for name in self.fresh):
            return
        for name in self.fresh:
            value = self.latest[name]
            if value.arrived is not None:
                self.latest[name] = value._replace(stamp=self.values.clocks.of_arrival(value.arrived))
        self.first = min((v.stamp for name in self.fresh if (v := self.latest[name]).stamp), default=stamp)

    def _complete(self) -> Iterator[tuple[datetime, Any, Any]]:
        row = self.values.row(self.latest, self.fresh)
        self.first = None
        self.fresh.clear()
        if row is not None:
            yield row
