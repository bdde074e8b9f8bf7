"""Health and alarms as a client of OPC UA sees them, on a server of the test."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Coroutine, Iterator
from math import nan
from typing import Any, NamedTuple

import pytest
from toy_plants import readings, tanks

from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.diagnosis.changes import Change
from fusion_sfdia.diagnosis.device_health import DeviceHealth
from fusion_sfdia.diagnosis.events import Event, UndecidedEvent
from fusion_sfdia.diagnosis.watch import Watch
from fusion_sfdia.live.alarm_server import DEVICES, OWN, alarms_served
from fusion_sfdia.live.saving import SavedWatch

asyncua = pytest.importorskip("asyncua")
ua = asyncua.ua
pytestmark = pytest.mark.slow  # the server is started once, which takes two seconds

PATIENCE = 60  # s, after which the test fails instead of hanging
IDS = ua.ObjectIds


class Operator:
    """A client that hears the events of alarms."""

    def __init__(self, client: Any) -> None:
        self.client, self.heard = client, asyncio.Queue[Any]()
        self.subscription = 0

    def event_notification(self, event: Any) -> None:
        self.heard.put_nowait(event)

    async def next(self) -> Any:
        """What the next event states: its type, name, and whether it is active, acknowledged, shelved and of interest."""
        self.event = event = await asyncio.wait_for(self.heard.get(), PATIENCE)
        if not hasattr(event, "ActiveState/Id") or getattr(event, "ActiveState/Id") is None:
            return event.EventType.Identifier
        states = [getattr(event, name) for name in ("ActiveState/Id", "AckedState/Id", "SuppressedOrShelved", "Retain")]
        return (event.EventType.Identifier, event.ConditionName, *states)

    async def call(self, number: int, *arguments: Any, at: Any = None) -> None:
        await self.client.get_node(at or self.event.NodeId).call_method(ua.NodeId(number), *arguments)

    async def own(self, name: str) -> Any:
        return self.client.get_node(ua.NodeId(name, await self.client.get_namespace_index(OWN)))


class Served(NamedTuple):
    """A watch with its server, of which l1 has a bias from 10 on; the rows are those after its first 20."""

    saved: SavedWatch
    url: str
    rows: list[Any]

    def work(self, work: Callable[[Operator], Coroutine[Any, Any, None]]) -> None:
        """Do the work with a client."""

        async def connected() -> None:
            async with asyncua.Client(self.url, timeout=PATIENCE) as client:
                operator = Operator(client)
                subscription = await client.create_subscription(10, operator)
                operator.subscription = subscription.subscription_id
                kinds = [IDS.AlarmConditionType, IDS.RefreshStartEventType, IDS.RefreshEndEventType]
                await subscription.subscribe_events(evtypes=[client.get_node(ua.NodeId(k)) for k in kinds])
                await work(operator)

        asyncio.run(asyncio.wait_for(connected(), PATIENCE))

    def change(self, *fields: Any) -> None:
        self.saved._changed(self.saved.watch.alarms.with_alarm(of_sensor(*fields)))


def saved_watch() -> SavedWatch:
    return SavedWatch(Watch(LeaveOneOutBank(tanks(), window=1), at_sample=True, refused=pytest.fail), lambda line: None)


@pytest.fixture(scope="module")
def served() -> Iterator[Served]:
    t, _, y, u = readings(tanks(), 30, 1, seed=1)
    y = y[:, 0].copy()
    y[10:, 0] += 0.5
    rows = list(zip(t, y, u[:, 0], strict=True))
    found = saved_watch()
    for row in rows[:20]:
        found.watch.update(*row)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        url = f"opc.tcp://127.0.0.1:{free.getsockname()[1]}/"
    with alarms_served(url, found):
        yield Served(found, url, rows[20:])


def of_sensor(name: str, number: int, what: str, t: float, fault: str = "bias") -> Change:
    return Change(number, what, t, Event(name, t, t, 0.5, "m", what != "closed", fault=fault, sigmas=9.0))


OFF, FAILED = (15590, "sensor l2"), (15292, "sensor l2")  # OffSpecAlarmType, FailureAlarmType


def test_an_alarm_is_raised_acknowledged_worsened_ended_and_sent_again_on_request(served: Served) -> None:

    async def work(operator: Operator) -> None:
        served.change("l2", 1, "opened", 0.0)
        assert await operator.next() == (*OFF, True, False, False, True)
        first = operator.event
        assert first.Severity == 400 and first.SourceName == "l2" and " l2 " in first.Message.Text
        await operator.call(IDS.AcknowledgeableConditionType_Acknowledge, first.EventId, ua.LocalizedText("seen"))
        assert await operator.next() == (*OFF, True, True, False, True)
        assert operator.event.Comment.Text == "seen"
        for event_id, code in ((first.EventId, "BadConditionBranchAlreadyAcked"), (b"other", "BadEventIdUnknown")):
            with pytest.raises(ua.UaError, match=code):
                await operator.call(IDS.AcknowledgeableConditionType_Acknowledge, event_id, ua.LocalizedText(""))
        served.change("l2", 1, "named", 100.0, "freeze")
        assert await operator.next() == (*FAILED, True, False, False, True)  # worse: to be acknowledged again
        await operator.call(IDS.ConditionType_AddComment, operator.event.EventId, ua.LocalizedText("on its way"))
        assert await operator.next() == (*FAILED, True, False, False, True) and operator.event.Comment.Text == "on its way"
        served.change("l2", 1, "closed", 200.0, "freeze")
        assert await operator.next() == (*FAILED, False, False, False, True)  # until it is acknowledged
        await operator.call(IDS.ConditionType_ConditionRefresh, operator.subscription, at=ua.NodeId(IDS.ConditionType))
        sent = [await operator.next() for _ in range(4)]
        standing = (OFF[0], "sensor l1", True, False, False, True)  # since before the server was started
        assert sent == [IDS.RefreshStartEventType, standing, (*FAILED, False, False, False, True), IDS.RefreshEndEventType]
        served.change("l2", 2, "opened", 300.0, "freeze")  # within ten minutes: no new alarm
        served.change("l2", 2, "closed", 301.0, "freeze")
        assert [(await operator.next())[2:4] for _ in range(2)] == [(True, False), (False, False)]
        await operator.call(IDS.AcknowledgeableConditionType_Acknowledge, operator.event.EventId, ua.LocalizedText(""))
        assert await operator.next() == (*FAILED, False, True, False, False) and operator.event.Comment.Text == "on its way"
        served.change("l2", 3, "opened", 400.0, "freeze")
        assert (await operator.next())[2:4] == (True, True)  # flaps: it stays acknowledged
        served.saved._changed(Change(4, "reset", 401.0, reason="x"))
        ended = {(await operator.next())[1:4] for _ in range(2)}
        assert ended == {("sensor l1", False, False), ("sensor l2", False, True)}
        served.change("l2", 3, "closed", 402.0, "freeze")
        assert (await operator.next())[1:4] == ("sensor l2", False, True)

    served.work(work)


def test_a_flood_gives_an_operator_one_new_alarm_in_ten_minutes_for_one_cause(served: Served) -> None:
    """A sensor's fault, and an undecided alarm, come and go each minute of an hour, and again after ten quiet minutes. What an
    operator has to acknowledge is a new alarm.
    """

    def changed(number: int, what: str, t: float) -> int:
        """Both causes change; how many events a client gets."""
        served.change("q12", number, what, t)
        suspects = (("l1", "inflow"), ("q2", "outlet"))[number % 2]  # whoever they are, it is one cause
        event = UndecidedEvent(" or ".join(suspects), t, t, nan, "", open=what == "opened", suspects=suspects)
        served.saved._changed(served.saved.watch.alarms.with_alarm(Change(1000 + number, what, t, event)))
        return 2

    async def work(operator: Operator) -> None:
        async def heard(count: int, new: int) -> None:
            """Take so many events, of which so many are new alarms, and acknowledge these."""
            found = [(await operator.next(), operator.event) for _ in range(count)]
            unseen = [event for (_, _, active, acknowledged, *_), event in found if active and not acknowledged]
            assert len(unseen) == len({event.NodeId for event in unseen}) == new
            assert {state[1] for state, _ in found} == {"sensor q12", "undecided"}
            for event in unseen:
                number, text = IDS.AcknowledgeableConditionType_Acknowledge, ua.LocalizedText("seen")
                await operator.call(number, event.EventId, text, at=event.NodeId)
                assert (await operator.next())[2:4] == (True, True)

        await heard(changed(0, "opened", 1000.0), new=2)
        flood = [(k, what, 1000.0 + 60.0 * k + after) for k in range(60) for what, after in (("opened", 0.0), ("closed", 5.0))]
        await heard(sum(changed(*one) for one in flood[1:]), new=0)
        end = flood[-1][2]
        await heard(changed(60, "opened", end + 599.0) + changed(60, "closed", end + 600.0), new=0)
        await heard(changed(61, "opened", end + 1200.0), new=2)
        await heard(changed(61, "closed", end + 1201.0), new=0)

    served.work(work)


def test_an_alarm_is_shelved_until_it_ends_and_for_a_time(served: Served) -> None:

    async def work(operator: Operator) -> None:
        served.change("q2", 1, "opened", 0.0)
        await operator.next()
        shelving = (await operator.own("alarm sensor q2.ShelvingState")).nodeid
        await operator.call(IDS.AlarmConditionType_ShelvingState_OneShotShelve, at=shelving)
        assert (await operator.next())[4] is True
        with pytest.raises(ua.UaError, match="BadConditionAlreadyShelved"):
            await operator.call(IDS.ShelvedStateMachineType_OneShotShelve, at=shelving)
        served.change("q2", 1, "closed", 5.0)
        assert (await operator.next())[4] is False
        with pytest.raises(ua.UaError, match="BadConditionNotShelved"):
            await operator.call(IDS.ShelvedStateMachineType_Unshelve, at=shelving)
        with pytest.raises(ua.UaError, match="BadShelvingTimeOutOfRange"):
            await operator.call(IDS.ShelvedStateMachineType_TimedShelve, 0.0, at=shelving)
        await operator.call(IDS.ShelvedStateMachineType_TimedShelve, 1.0, at=shelving)  # a millisecond
        assert [(await operator.next())[4] for _ in range(2)] == [True, False]
        await operator.call(IDS.ShelvedStateMachineType_TimedShelve, 1e7, at=shelving)
        await operator.call(IDS.ShelvedStateMachineType_Unshelve, at=shelving)
        assert [(await operator.next())[4] for _ in range(2)] == [True, False]
        with pytest.raises(ua.UaError, match="BadNodeIdUnknown"):
            await operator.call(IDS.ShelvedStateMachineType_Unshelve, at=(await operator.own("l2")).nodeid)

    served.work(work)


def test_health_is_a_node_of_each_sensor(served: Served) -> None:
    async def work(operator: Operator) -> None:
        space = await operator.client.get_namespace_index(DEVICES)
        node = await operator.own("l1.DeviceHealth")
        assert await node.read_data_type() == ua.NodeId(6244, space)
        assert await node.read_browse_name() == ua.QualifiedName("DeviceHealth", space)
        texts = await (await operator.own("EnumStrings")).read_value()
        assert [text.Text for text in texts] == [state.name for state in DeviceHealth]
        assert await node.read_value() == DeviceHealth.CHECK_FUNCTION  # no row yet
        changes = asyncio.Queue[Any]()

        class Handler:
            def datachange_notification(self, node: Any, value: Any, data: Any) -> None:
                changes.put_nowait(value)

        nodes = [await operator.own(f"{name}.DeviceHealth") for name in ("l1", "l2")]
        subscription = await operator.client.create_subscription(10, Handler())
        await subscription.subscribe_data_change(nodes)
        first = [await asyncio.wait_for(changes.get(), PATIENCE) for _ in nodes]
        for row in served.rows:
            served.saved.update(*row)
        later = [await asyncio.wait_for(changes.get(), PATIENCE) for _ in nodes]
        assert first == [DeviceHealth.CHECK_FUNCTION] * 2 and sorted(later) == [DeviceHealth.NORMAL, DeviceHealth.OFF_SPEC]
        with pytest.raises(ua.UaError, match=r"BadUserAccessDenied|BadNotWritable"):
            await node.write_value(ua.Variant(0, ua.VariantType.Int32))
        with pytest.raises(ua.UaError, match="BadUserAccessDenied"):
            await operator.client.nodes.objects.add_object(space, "mine")

    served.work(work)


def test_an_address_that_is_none_or_has_a_password_is_refused() -> None:
    for url in ("http://127.0.0.1", "opc.tcp://user:pass@127.0.0.1"):
        with pytest.raises(ValueError, match=r"^--alarms ") as caught, alarms_served(url, saved_watch()):
            pass
        assert "pass@" not in str(caught.value)
