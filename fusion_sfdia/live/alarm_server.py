"""An OPC UA server of the watch: the health of each sensor, and alarms that are acknowledged and shelved.

Nodes, types and their numbers are of OPC UA for Devices (OPC 10000-100, 4.5.4), of which the server has what is named here;
states and methods of alarms are of OPC UA Alarms and Conditions (OPC 10000-9). asyncua sends their events and calls their
methods; the states, and what the methods change, are kept here.
"""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from collections.abc import Callable, Coroutine, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib import import_module
from typing import Any

from fusion_sfdia.common.clock import Clock
from fusion_sfdia.diagnosis.alarms import BLIND, Raised, cause_of
from fusion_sfdia.diagnosis.changes import Change
from fusion_sfdia.diagnosis.device_health import DeviceHealth
from fusion_sfdia.diagnosis.sentences import Words, wordings
from fusion_sfdia.live.opcua import asyncua
from fusion_sfdia.live.saving import SavedWatch
from fusion_sfdia.live.security import SCHEMES, address
from fusion_sfdia.live.status import Report, Status
from fusion_sfdia.plant.plant import Plant

DEVICES, OWN = "http://opcfoundation.org/UA/DI/", "urn:fusion-sfdia:alarms"  # namespaces
ENUMERATION, DIAGNOSTIC_ALARM = 6244, 15143  # numbers of nodes of DEVICES
ALARM_TYPES = {  # likewise, with their names
    DeviceHealth.FAILURE: (15292, "FailureAlarmType"),
    DeviceHealth.CHECK_FUNCTION: (15441, "CheckFunctionAlarmType"),
    DeviceHealth.OFF_SPEC: (15590, "OffSpecAlarmType"),
    DeviceHealth.MAINTENANCE_REQUIRED: (15739, "MaintenanceRequiredAlarmType"),
}
PROCESS_SEVERITY = 700  # severity, from 1 to 1000, of an alarm that is of no sensor
SEVERITY = {
    DeviceHealth.FAILURE: 800,
    DeviceHealth.CHECK_FUNCTION: 600,
    DeviceHealth.OFF_SPEC: 400,
    DeviceHealth.MAINTENANCE_REQUIRED: 200,
}
KEPT = 100  # ids of events of each alarm, which a client may acknowledge
MOST_PENDING = 1000  # changes and reports that wait to be sent
UNSHELVED, TIMED, ONE_SHOT = "Unshelved", "TimedShelved", "OneShotShelved"


@dataclass
class Condition:
    """The alarm of a cause. node, shelving: ids of its node and of that of its shelving; ids: of its last events."""

    node: Any
    shelving: Any
    generator: Any
    active: bool = False
    acknowledged: bool = True
    shelved: str = UNSHELVED
    severity: int = 1
    comment: str = ""
    timer: asyncio.TimerHandle | None = None
    ids: deque[bytes] = field(default_factory=lambda: deque(maxlen=KEPT))

    @property
    def retained(self) -> bool:
        """Whether it is of interest to clients that connect."""
        return self.active or not self.acknowledged


class AlarmServer:
    """The server; everything but the constructor runs in one event loop. clock: of the rows. words: of sentences."""

    def __init__(self, plant: Plant, url: str, clock: Callable[[], Clock], words: Words) -> None:
        address("--alarms", url, SCHEMES["opcua"])
        self.plant, self.url, self.clock, self.words = plant, url, clock, words
        self.ua, self.events = asyncua().ua, import_module("asyncua.common.event_objects")
        self.conditions: dict[str, Condition] = {}  # by cause
        self.health: dict[str, Any] = {}  # nodes by sensor
        self.folders: dict[str, Any] = {}  # of the alarms of a sensor, "" of the others
        self.tasks: set[asyncio.Task[Any]] = set()
        self.lock = asyncio.Lock()  # one change after another

    async def start(self, raised: dict[str, Raised]) -> None:
        """Begin to serve; raised: alarms of before, of which those that stand are to be acknowledged again."""
        ua, plant = self.ua, self.plant
        self.server = server = asyncua().Server()
        await server.init()
        server.set_endpoint(self.url)
        server.set_server_name("fusion-sfdia")
        server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        server.set_identity_tokens([ua.AnonymousIdentityToken])
        self.devices, self.own = [await server.register_namespace(uri) for uri in (DEVICES, OWN)]
        await self._add_types()
        top = await server.nodes.objects.add_object(self._id("plant"), ua.QualifiedName(plant.name, self.own))
        self.folders[""] = await top.add_folder(self._id("alarms"), ua.QualifiedName("Alarms", self.own))
        for name in plant.sensor_names:
            node = await top.add_object(self._id(name), ua.QualifiedName(name, self.own))
            self.health[name] = await node.add_variable(
                self._id(f"{name}.DeviceHealth"),
                ua.QualifiedName("DeviceHealth", self.devices),
                int(DeviceHealth.CHECK_FUNCTION),
                ua.VariantType.Int32,
                ua.NodeId(ENUMERATION, self.devices),
            )
            named = ua.QualifiedName("DeviceHealthAlarms", self.devices)
            self.folders[name] = await node.add_folder(self._id(f"{name}.DeviceHealthAlarms"), named)
        self.begin, self.end = [
            await server.get_event_generator(event()) for event in (self.events.RefreshStartEvent, self.events.RefreshEndEvent)
        ]
        ids = ua.ObjectIds
        for method, numbers in (
            (self.acknowledge, (ids.AcknowledgeableConditionType_Acknowledge,)),
            (self.add_comment, (ids.ConditionType_AddComment,)),
            (self.refresh, (ids.ConditionType_ConditionRefresh, ids.ConditionType_ConditionRefresh2)),
            (self.unshelve, (ids.ShelvedStateMachineType_Unshelve, ids.AlarmConditionType_ShelvingState_Unshelve)),
            (self.shelve_once, (ids.ShelvedStateMachineType_OneShotShelve, ids.AlarmConditionType_ShelvingState_OneShotShelve)),
            (self.shelve_for, (ids.ShelvedStateMachineType_TimedShelve, ids.AlarmConditionType_ShelvingState_TimedShelve)),
        ):
            for number in numbers:
                server.link_method(server.get_node(number), method)
        for cause, alarm in raised.items():
            if alarm.open:
                condition = await self._condition(cause)
                condition.active, condition.acknowledged = True, False
                self._describe(condition, alarm.state, f"{cause}: active since before the watch was started")
                await self._send(condition)
        await server.start()

    async def stop(self) -> None:
        """End, after the changes until now are sent."""
        async with self.lock:
            internal = self.server.iserver
            internal.time_task.cancel()  # its clock, for whose next second the server would wait
            with suppress(asyncio.CancelledError):
                await internal.time_task
            internal.time_task = None
            await self.server.stop()

    async def _add_types(self) -> None:
        ua, server = self.ua, self.server
        named = ua.QualifiedName("DeviceHealthEnumeration", self.devices)
        kind = await server.get_node(ua.ObjectIds.Enumeration).add_data_type(ua.NodeId(ENUMERATION, self.devices), named)
        texts = [ua.LocalizedText(state.name) for state in DeviceHealth]
        await kind.add_property(self._id("EnumStrings"), ua.QualifiedName("EnumStrings", 0), texts)
        base = server.get_node(ua.ObjectIds.InstrumentDiagnosticAlarmType)
        named = ua.QualifiedName("DeviceHealthDiagnosticAlarmType", self.devices)
        diagnostic = await base.add_object_type(ua.NodeId(DIAGNOSTIC_ALARM, self.devices), named)
        for number, name in ALARM_TYPES.values():
            await diagnostic.add_object_type(ua.NodeId(number, self.devices), ua.QualifiedName(name, self.devices))

    def _id(self, name: str) -> Any:
        return self.ua.NodeId(name, self.own)

    async def reported(self, report: Report) -> None:
        """Show the health of the sensors."""
        async with self.lock:
            for name, state in report.device_health.items():
                await self.health[name].write_value(int(state), self.ua.VariantType.Int32)

    async def changed(self, change: Change) -> None:
        """Raise, update or end the alarm of a change. One that has become more severe is to be acknowledged again."""
        async with self.lock:
            if change.what == "reset":
                for name, condition in self.conditions.items():
                    if condition.active and name != BLIND:
                        self._end(condition)
                        await self._send(condition)
            if (cause := cause_of(change)) is None or change.alarm is None:
                return
            condition = await self._condition(cause)
            stood, before = condition.active, condition.severity
            self._describe(condition, change.device_health, change.sentence(self.words, self.clock()))
            if change.alarm.active:
                condition.active = True
            elif stood:
                self._end(condition)
            if change.alarm.new or (stood and condition.active and condition.severity > before):
                condition.acknowledged, condition.comment = False, ""
            await self._send(condition, self.clock().moment(change.t))

    def _end(self, condition: Condition) -> None:
        condition.active = False
        if condition.shelved == ONE_SHOT:
            self._shelve(condition, UNSHELVED)

    async def _condition(self, cause: str) -> Condition:
        """The alarm of a cause, which is made when it is needed first."""
        if cause in self.conditions:
            return self.conditions[cause]
        ua = self.ua
        sensor = cause.removeprefix("sensor ") if cause.startswith("sensor ") else ""
        node = await self.folders[sensor].add_object(self._id(f"alarm {cause}"), ua.QualifiedName(cause, self.own))
        shelving = await node.add_object(self._id(f"alarm {cause}.ShelvingState"), ua.QualifiedName("ShelvingState", 0))
        event = self.events.AlarmCondition()
        event.add_property("NodeId", node.nodeid, ua.VariantType.NodeId)
        event.add_property("ShelvingState/CurrentState", None, ua.VariantType.LocalizedText)
        event.SourceNode, event.SourceName = self._id(sensor or "plant"), sensor or self.plant.name
        event.InputNode = self.health[sensor].nodeid if sensor else ua.NodeId()
        event.ConditionName, event.BranchId, event.ClientUserId = cause, ua.NodeId(), ""
        event.Quality = ua.StatusCode(ua.StatusCodes.Good)
        generator = await self.server.get_event_generator(event)
        found = self.conditions[cause] = Condition(node.nodeid, shelving.nodeid, generator)
        return found

    def _describe(self, condition: Condition, health: DeviceHealth | None, text: str) -> None:
        ua, event = self.ua, condition.generator.event
        of_process = ua.NodeId(ua.ObjectIds.OffNormalAlarmType)
        event.EventType = of_process if health is None else ua.NodeId(ALARM_TYPES[health][0], self.devices)
        condition.severity = PROCESS_SEVERITY if health is None else SEVERITY[health]
        event.LastSeverity, event.Severity = event.Severity, condition.severity
        event.Message = ua.LocalizedText(text)

    async def _send(self, condition: Condition, moment: datetime | None = None, subscription: int | None = None) -> None:
        """Send an event with the state of an alarm, to all clients or to those of one subscription."""
        event, text = condition.generator.event, self.ua.LocalizedText
        for name, value, words in (
            ("EnabledState", True, "Enabled"),
            ("ActiveState", condition.active, "Active" if condition.active else "Inactive"),
            ("AckedState", condition.acknowledged, "Acknowledged" if condition.acknowledged else "Unacknowledged"),
        ):
            setattr(event, name, text(words))
            setattr(event, f"{name}/Id", value)
        setattr(event, "ShelvingState/CurrentState", text(condition.shelved))
        event.SuppressedOrShelved = condition.shelved != UNSHELVED
        event.Retain, event.Comment = condition.retained, text(condition.comment)
        moment = moment if moment is not None and moment.tzinfo is not None else datetime.now(UTC)
        await condition.generator.trigger(moment.astimezone(UTC), subscription_id=subscription)
        condition.ids.append(event.EventId.Value)

    # --- methods, which clients call with a condition or its shelving as object; they give a status code, or their outputs

    def _called(self, at: Any) -> Condition | None:
        return next((c for c in self.conditions.values() if at in (c.node, c.shelving)), None)

    async def acknowledge(self, at: Any, event_id: Any, comment: Any) -> Any:
        """Acknowledge the state that an event has reported, with a comment."""
        return await self._commented(at, event_id, comment, acknowledge=True)

    async def add_comment(self, at: Any, event_id: Any, comment: Any) -> Any:
        """Add a comment to an alarm."""
        return await self._commented(at, event_id, comment, acknowledge=False)

    async def _commented(self, at: Any, event_id: Any, comment: Any, *, acknowledge: bool) -> Any:
        codes = self.ua.StatusCodes
        async with self.lock:
            if (condition := self._called(at)) is None:
                return self.ua.StatusCode(codes.BadNodeIdUnknown)
            if event_id.Value not in condition.ids:
                return self.ua.StatusCode(codes.BadEventIdUnknown)
            if acknowledge and condition.acknowledged:
                return self.ua.StatusCode(codes.BadConditionBranchAlreadyAcked)
            condition.acknowledged |= acknowledge
            if comment.Value is not None and comment.Value.Text:  # an empty one leaves that of before
                condition.comment = comment.Value.Text
            await self._send(condition)
            return []

    async def refresh(self, at: Any, subscription: Any, *_: Any) -> Any:
        """Send the states of all alarms of interest once more, to one subscription."""
        async with self.lock:
            await self.begin.trigger(subscription_id=subscription.Value)
            for condition in self.conditions.values():
                if condition.retained:
                    await self._send(condition, subscription=subscription.Value)
            await self.end.trigger(subscription_id=subscription.Value)
            return []

    async def unshelve(self, at: Any) -> Any:
        """End the shelving of an alarm."""
        return await self._shelved(at, UNSHELVED)

    async def shelve_once(self, at: Any) -> Any:
        """Shelve an alarm until it ends."""
        return await self._shelved(at, ONE_SHOT)

    async def shelve_for(self, at: Any, milliseconds: Any) -> Any:
        """Shelve an alarm for a time."""
        if not 0 < milliseconds.Value < 1000 * threading.TIMEOUT_MAX:
            return self.ua.StatusCode(self.ua.StatusCodes.BadShelvingTimeOutOfRange)
        return await self._shelved(at, TIMED, milliseconds.Value / 1000)

    async def _shelved(self, at: Any, how: str, seconds: float = 0.0) -> Any:
        codes = self.ua.StatusCodes
        async with self.lock:
            if (condition := self._called(at)) is None:
                return self.ua.StatusCode(codes.BadNodeIdUnknown)
            if how == condition.shelved:
                wrong = codes.BadConditionNotShelved if how == UNSHELVED else codes.BadConditionAlreadyShelved
                return self.ua.StatusCode(wrong)
            self._shelve(condition, how)
            if how == TIMED:
                loop = asyncio.get_running_loop()
                condition.timer = loop.call_later(seconds, self._unshelve_later, condition)
            await self._send(condition)
            return []

    def _unshelve_later(self, condition: Condition) -> None:
        task = asyncio.get_running_loop().create_task(self.unshelve(condition.node))
        self.tasks.add(task)  # of which the loop alone keeps no reference
        task.add_done_callback(self.tasks.discard)

    def _shelve(self, condition: Condition, how: str) -> None:
        if condition.timer is not None:
            condition.timer.cancel()
        condition.shelved, condition.timer = how, None


@contextmanager
def alarms_served(url: str, saved: SavedWatch) -> Iterator[AlarmServer]:
    """Within the block, serve health and alarms of a watch at this address, from a thread of its own.

    OSError where the address cannot be taken, ValueError where it is none, MissingPackageError without asyncua.
    """
    watch, say = saved.watch, saved.watch.refused
    found = AlarmServer(watch.detector.plant, url, lambda: watch.clock, wordings(watch.detector))
    saved.status = saved.status or Status(watch)
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever, daemon=True)
    thread.start()

    pending: set[Future[None]] = set()

    def done(future: Future[None]) -> None:
        pending.discard(future)
        if not future.cancelled() and (error := future.exception()) is not None:
            say(f"{url}: an alarm was not sent ({type(error).__name__})")

    def send(work: Coroutine[Any, Any, None]) -> None:
        if len(pending) >= MOST_PENDING:
            work.close()
            say(f"{url}: an alarm was not sent, since {MOST_PENDING} before it are not sent yet")
            return
        pending.add(future := asyncio.run_coroutine_threadsafe(work, loop))
        future.add_done_callback(done)

    try:
        asyncio.run_coroutine_threadsafe(found.start(watch.alarms.raised), loop).result()
        saved.outlets.append(lambda change, line: send(found.changed(change)))
        saved.status.listeners.append(lambda report: send(found.reported(report)))
        try:
            yield found
        finally:
            asyncio.run_coroutine_threadsafe(found.stop(), loop).result()
    finally:
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()
