"""What live sources deliver: payloads, nodes and time stamps of all kinds, each of which costs itself alone."""

from __future__ import annotations

import json
import math
import random
from collections.abc import Callable, Iterable, Iterator
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pytest
from toy_plants import readings, tanks

from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.diagnosis.watch import Watch
from fusion_sfdia.live import mqtt, opcua
from fusion_sfdia.live.live_readings import DoubleKeyError, Reader, json_value
from fusion_sfdia.live.nodes import Nodes
from fusion_sfdia.live.saving import SavedWatch
from fusion_sfdia.live.topics import Topics, TopicSource
from fusion_sfdia.logs.conversion import conversion
from fusion_sfdia.logs.numbers import Numbers

START = datetime(2026, 3, 1, 14, 0, tzinfo=UTC)
NAMES = ("l1", "l2", "q12", "q2", "inflow")
DT = 5.0  # s, of the tanks
STEPS = 60
PAYLOADS = 10_000
BIAS = 30  # row from which l2 has a bias

Change = Callable[[int, str, dict[str, Any]], dict[str, Any]]


def rows_of(steps: int = STEPS) -> list[tuple[float, np.ndarray, np.ndarray]]:
    t, _, y, u = readings(tanks(), steps, 1, seed=4)
    y = y[:, 0].copy()
    y[BIAS:, 1] += 0.3
    return list(zip((t - t[0]).tolist(), y, u[:, 0], strict=True))


def missing(rows: list[Any], *cells: tuple[int, str]) -> list[Any]:
    """The rows without the readings of these names in these rows."""
    found = [(t, y.copy(), u.copy()) for t, y, u in rows]
    for k, name in cells:
        found[k][1 if name != "inflow" else 2][NAMES.index(name) % 4] = np.nan
    return found


def watching(**settings: Any) -> tuple[SavedWatch, list[dict[str, Any]], list[str]]:
    """A watch, the samples it writes, by seconds since START, and its remarks."""
    lines: list[dict[str, Any]] = []
    remarks: list[str] = []

    def write(line: str) -> None:
        found = json.loads(line)
        if found["event"] == "sample":
            at = (datetime.fromisoformat(found["time"]) - START).total_seconds() if "time" in found else found["t"]
            lines.append({"at": at, "isolated": found["isolated"], "values": found["values"]})

    watch = Watch(LeaveOneOutBank(tanks(), window=1), at_sample=True, kinds=False, hold=15.0, refused=remarks.append)
    return SavedWatch(watch, write, samples=True), lines, remarks


def diagnosed(rows: list[Any]) -> list[dict[str, Any]]:
    saved, lines, _ = watching()
    for row in rows:
        saved.update(*row)
    return lines


def messages(change: Change = lambda k, name, found: found, lag: float = 0.2, steps: int = STEPS) -> Iterator[mqtt.Message]:
    """A message for each name of each row; change(k, name, {"value", "time", "arrived"}) gives what is sent instead."""
    for k, (t, y, u) in enumerate(rows_of(steps)):
        for i, (name, value) in enumerate(zip(NAMES, [*y, *u], strict=True)):
            stamp = START + timedelta(seconds=t)
            found = {"value": float(value), "time": stamp, "arrived": stamp + timedelta(seconds=lag + 0.01 * i)}
            found = change(k, name, found)
            arrived = found.pop("arrived")
            if isinstance(found.get("time"), datetime):
                found["time"] = found["time"].isoformat()
            payload = found.pop("payload", None)
            yield mqtt.Message(name, payload if payload is not None else json.dumps(found).encode(), arrived)


def through_mqtt(given: Iterable[mqtt.Message], **topics: Any) -> tuple[list[dict[str, Any]], list[str]]:
    pytest.importorskip("paho.mqtt.client")
    saved, lines, remarks = watching()
    bridge = mqtt.MqttBridge(saved, "mqtt://x", Topics({n: n for n in NAMES}, **topics), now=lambda: START)
    for message in given:
        bridge.take(message)
    return lines, remarks


def same(found: list[dict[str, Any]], expected: list[dict[str, Any]], *, tolerance: float = 0.0) -> None:
    """The samples that have been written, all but the last, whose row may wait for a later message."""
    assert len(expected) - 1 <= len(found) <= len(expected)
    for one, other in zip(found, expected, strict=False):
        assert one["at"] == pytest.approx(other["at"], abs=tolerance) and one["isolated"] == other["isolated"]
        assert one["values"] == pytest.approx(other["values"], rel=1e-9 + tolerance, nan_ok=True)


@pytest.mark.parametrize(
    ("cell", "number", "fault"),
    [
        (23.5, 23.5, ""),
        (7, 7.0, ""),
        (np.int16(7), 7.0, ""),
        (np.float32(0.5), 0.5, ""),
        ("23.5", 23.5, ""),
        (" -1e-3 ", -1e-3, ""),
        ("23,5", 23.5, ""),
        ("0,125", 0.125, ""),
        ("1,250", math.nan, "decimal mark or separates thousands"),
        ("1.250,5", math.nan, "no finite number"),
        ("300 K", 26.85, ""),
        ("23,5 °C", 23.5, ""),
        ("77 degF", 25.0, ""),
        ("5 bar", math.nan, "'bar' does not convert to 'degC'"),
        ("5 9^9^9^9", math.nan, "no"),
        ("5 K^99", math.nan, "no"),
        ("5 " + "m" * 999, math.nan, "no"),
        (2**64, math.nan, "no finite number"),
        (-(2**70), math.nan, "no finite number"),
        (10**400, math.nan, "no finite number"),
        ("9" * 30, math.nan, "no finite number"),
        (1e300, 1e300, ""),
        (None, math.nan, ""),
        (math.nan, math.nan, ""),
        ("NaN", math.nan, ""),
        ("", math.nan, ""),
        ("unavailable", math.nan, ""),
        ("N/A", math.nan, ""),
        (math.inf, math.nan, "no finite number"),
        ("-inf", math.nan, "no finite number"),
        (True, math.nan, "a truth value"),
        (np.False_, math.nan, "a truth value"),
        ("ON", math.nan, "give the numbers of such texts as states"),
        ([23.5], math.nan, "an array"),
        (np.arange(3), math.nan, "an array"),
        ({"a": 1}, math.nan, "no finite number"),
        (datetime(2026, 3, 1), math.nan, "no finite number"),
        (b"1", math.nan, "no finite number"),
        (1j, math.nan, "no finite number"),
    ],
    ids=lambda value: repr(value)[:20],
)
def test_a_cell_is_a_number_of_the_plant_or_missing(cell: Any, number: float, fault: str) -> None:
    found = Reader("degC")(cell)
    assert found.number == pytest.approx(number, nan_ok=True) and (fault in found.fault if fault else not found.fault)


def test_units_states_and_marks_are_as_stated() -> None:
    states = {"On": 20.0, "true": 1.0, "unknown": 2.0}
    reader = Reader("K", conversion("degC", "K"), Numbers(",", states=states))
    for cell, number in ((20, 293.15), ("20", 293.15), ("20,5", 293.65), ("20 K", 20.0), (" ON ", 293.15), (True, 274.15)):
        assert reader(cell).number == pytest.approx(number)
    assert reader("Unknown").number == 275.15 and reader(7).number == 280.15 and math.isnan(reader(False).number)
    assert math.isnan(Reader(numbers=Numbers(states={"3": 1.0}))(4).number)  # of codes no other one is a number
    assert reader("20.5").fault and Reader()("20.5 whatever").number == 20.5


def test_json_with_a_key_twice_is_refused_at_any_depth() -> None:
    for text in ('{"a": 1, "a": 1}', '[{"b": {"c": 1, "c": 2}}]'):
        with pytest.raises(DoubleKeyError, match="occurs twice"):
            json_value(text)
    with pytest.raises(ValueError, match="nested too deeply"):
        json_value("[" * 100_000)


def test_the_first_unusable_payload_of_each_source_is_said_with_the_cure() -> None:
    payloads = {
        "l1": (b'{"Value": 1.0, "raw": 2}', "topic l1: payload '{\"Value\": 1.0, \"raw\": 2}': no key 'value'; its keys: "
               "'Value', 'raw': give value = 'Value' in the table of its topic"),
        "l2": (b"ON", "topic l2: payload 'ON': no finite number; give the numbers of such texts as states"),
        "q12": (b'{"value": 1, "quality": 0}', "its quality is 0, not among the good ones"),
        "q2": (b"\xff\xfe\x00", "no text in UTF-8"),
    }  # fmt: skip

    def spoilt(k: int, name: str, found: dict[str, Any]) -> dict[str, Any]:
        return found | {"payload": payloads[name][0]} if name in payloads and k >= 10 else found

    lines, remarks = through_mqtt(messages(spoilt))
    assert len(lines) >= STEPS - 2  # rows without any reading are rows
    assert sorted(r.partition(":")[0] for r in remarks) == sorted(payloads)
    for remark in remarks:
        name = remark.partition(":")[0]
        assert payloads[name][1] in remark and remark.endswith("; its value is missing")


@pytest.mark.parametrize(
    ("quality", "good", "counts"),
    [
        ("GOOD_LOCAL_OVERRIDE", None, True), ("Good, clamped", None, True), ("goodish", None, False), ("OK", None, True),
        (True, None, True), (192, None, True), ("Uncertain", None, False), ("bad_sensor", None, False), (False, None, False),
        (0, None, False), (216, None, False), (1, None, False), (0, "opc-ua", True), (0x80000000, "opc-ua", False),
        (216, "opc-da", True), (64, "opc-da", False), (0, (0,), True), (192, (0,), False), ("valid", ("valid",), True),
        ({"a": 1}, None, False), ([], "opc-da", False), (2**70, "opc-ua", False),
    ],
)  # fmt: skip
def test_a_value_counts_with_a_quality_that_is_stated_good(quality: Any, good: Any, counts: bool) -> None:
    topics = Topics({}) if good is None else Topics({}, good=good)
    found = topics.value(TopicSource("t"), json.dumps({"value": 1.0, "quality": quality}).encode(), START)
    assert (found.number == 1.0) == counts and not (counts and found.fault)


def test_times_are_read_in_all_units_and_0_or_nothing_is_no_time() -> None:
    topics, seconds = Topics({}), 1772373600
    for text in (seconds, seconds * 1000, seconds * 10**6, seconds * 10**9, str(seconds), "2026-03-01T14:00:00.0000000Z"):
        assert topics.value(TopicSource("t"), json.dumps({"value": 1, "time": text}).encode(), None).stamp == START
    for text in ("", 0, None, "0", 0.0):
        found = topics.value(TopicSource("t"), json.dumps({"value": 1, "time": text}).encode(), START)
        assert found.stamp == START and not found.has_time and found.number == 1.0
    for text in ("noon", True, False, [], {}, 10**30, "9" * 5000, "10.01.2026 14:00"):
        found = topics.value(TopicSource("t"), json.dumps({"value": 1, "time": text}).encode(), START)
        assert found.stamp is None and "expected ISO 8601, or a number since 1970" in found.fault
    local = Topics({}, time_format="%d.%m.%Y %H:%M", tz="Europe/Amsterdam")
    assert local.value(TopicSource("t"), b'{"value": 1, "time": "01.03.2026 15:00"}', None).stamp == START


def test_messages_of_one_hour_give_their_rows_whatever_unit_their_times_have() -> None:
    expected = diagnosed(rows_of())
    assert any("l2" in sample["isolated"] for sample in expected)
    same(through_mqtt(messages())[0], expected)
    for scale in (1e3, 1e6, 1e9):

        def scaled(k: int, name: str, found: dict[str, Any], scale: float = scale) -> dict[str, Any]:
            return found | {"time": int(found["time"].timestamp() * scale), "value": f"{found['value']!r}"}

        lines, remarks = through_mqtt(messages(scaled))
        same(lines, expected)
        assert not remarks


AHEAD = {"18 h": timedelta(hours=18), "50 s": timedelta(seconds=50), "20 s": timedelta(seconds=20), "10 years": timedelta(3652)}


@pytest.mark.parametrize("name", ["l1", "inflow"])
@pytest.mark.parametrize("which", [*AHEAD, "9999", "1970", "a year back", "2 h back"])
def test_a_wrong_stamp_costs_its_own_value_alone(which: str, name: str) -> None:
    wrong = {
        "9999": lambda s: datetime(9999, 12, 31, 23, 59, 59, tzinfo=UTC),
        "1970": lambda s: datetime(1970, 1, 1, tzinfo=UTC),
        "a year back": lambda s: s - timedelta(365),
        "2 h back": lambda s: s - timedelta(hours=2),
    } | {text: (lambda s, by=by: s + by) for text, by in AHEAD.items()}

    def change(k: int, n: str, found: dict[str, Any]) -> dict[str, Any]:
        return found | {"time": wrong[which](found["time"])} if (k, n) == (12, name) else found

    lines, remarks = through_mqtt(messages(change))
    same(lines, diagnosed(missing(rows_of(), (12, name))))
    assert len(remarks) == 1 and remarks[0].startswith(f"{name}: time stamp ") and "such values are missing" in remarks[0]


def test_a_clock_that_was_set_back_a_year_gives_no_reading_and_is_named_with_its_offset() -> None:
    def change(k: int, name: str, found: dict[str, Any]) -> dict[str, Any]:
        return found | {"time": found["time"] - timedelta(365)} if name == "l1" and k >= 10 else found

    lines, remarks = through_mqtt(messages(change))
    same(lines, diagnosed(missing(rows_of(), *[(k, "l1") for k in range(10, STEPS)])))
    assert len(remarks) == 2 and "behind its arrival, more than max_lag = 3600 s" in remarks[0]
    assert "l1: its clock is 365 days behind (median of 5 values" in remarks[1]


@pytest.mark.parametrize("off", [-7200.0, -1800.0, -40.0, 45.0, 3600.0])
def test_clocks_that_are_steadily_off_are_named_with_their_offset(off: float) -> None:
    def change(k: int, name: str, found: dict[str, Any]) -> dict[str, Any]:
        return found | {"time": found["time"] + timedelta(seconds=off)}

    lines, remarks = through_mqtt(messages(change))
    steady = [r for r in remarks if "its clock is" in r]
    assert len(steady) == 5 and sum("its clock is" in r or "such values are missing" in r for r in remarks) <= 10
    words = {
        -7200.0: "2 h behind",
        -1800.0: "30 min behind",
        -40.0: "40.2 s behind",
        45.0: "44.8 s ahead",
        3600.0: "60 min ahead",
    }
    assert all(words[off] in r or words[off].replace("60 min", "1 h") in r for r in steady)
    if -3600 < off < 60:  # within the bounds all is diagnosed, on the clock of the sources
        assert len(lines) >= STEPS - 3 and any("l2" in sample["isolated"] for sample in lines)
    else:
        assert all(np.isnan(list(map(float, s["values"].values()))).all() or not s["isolated"] for s in lines)


@pytest.mark.parametrize("off", [50.0, -50.0])
def test_a_clock_that_is_off_holds_up_no_other_when_its_source_falls_silent(off: float) -> None:
    def change(k: int, name: str, found: dict[str, Any]) -> dict[str, Any]:
        return found | {"time": found["time"] + timedelta(seconds=off)} if name == "q2" else found

    given = [m for i, m in enumerate(messages(change)) if m.topic != "q2" or i < 5 * 20]
    lines, remarks = through_mqtt(given)
    assert [s["at"] for s in lines] == [DT * k for k in range(STEPS - 1)] and any("l2" in s["isolated"] for s in lines)
    assert any(r.startswith("q2: its clock is 50") or r.startswith("q2: its clock is 49.8") for r in remarks)


def test_a_bound_that_is_infinite_plays_back_a_recording() -> None:
    def late(k: int, name: str, found: dict[str, Any]) -> dict[str, Any]:
        return found | {"arrived": START + timedelta(days=900, seconds=0.01 * k)}

    lines, remarks = through_mqtt(messages(late), max_lag=math.inf)
    same(lines, diagnosed(rows_of()))
    assert not remarks


@pytest.mark.parametrize("behind", [0.0, 30.0, 3000.0])
@pytest.mark.parametrize("names", [("q2",), ("l1",), ("inflow", "l1")])
def test_a_payload_without_a_time_belongs_to_the_row_of_its_arrival(behind: float, names: tuple[str, ...]) -> None:
    """Also where the sources that state a time have clocks that are behind, and whichever comes first."""

    def change(k: int, name: str, found: dict[str, Any]) -> dict[str, Any]:
        found = found | {"arrived": found["arrived"] + timedelta(seconds=behind)}
        return {n: v for n, v in found.items() if n != "time"} if name in names else found

    lines, remarks = through_mqtt(messages(change))
    same(lines, diagnosed(rows_of()))
    assert len(remarks) == (5 - len(names) if behind else 0)


@pytest.mark.parametrize("at", [0, 1, 12])
@pytest.mark.parametrize("behind", [30.0, 3000.0])
def test_one_payload_without_a_time_makes_no_other_late(at: int, behind: float) -> None:
    def change(k: int, name: str, found: dict[str, Any]) -> dict[str, Any]:
        found = found | {"arrived": found["arrived"] + timedelta(seconds=behind)}
        return {n: v for n, v in found.items() if n != "time"} if (k, name) == (at, "l1") else found

    same(through_mqtt(messages(change))[0], diagnosed(rows_of()))


def test_payloads_without_any_time_are_rows_of_their_arrival() -> None:
    lines, remarks = through_mqtt(messages(lambda k, name, found: {n: v for n, v in found.items() if n != "time"}))
    same(lines, diagnosed(rows_of()), tolerance=0.3)
    assert not remarks and len(lines) >= STEPS - 2


def test_a_retained_message_from_the_future_or_unusable_does_not_stop_a_restart() -> None:
    poison = [
        b'{"value": 1, "time": "2036-01-01T00:00:00Z"}',
        b'{"value": 1, "time": 253402300799}',
        b"18446744073709551616",
        b"\xff",
    ]
    given = [mqtt.Message(name, payload, None) for name, payload in zip(NAMES, poison, strict=False)]
    lines, remarks = through_mqtt([*given, *messages()])
    same(lines, diagnosed(rows_of()))
    assert len(remarks) == 4


def test_of_200_stamps_ahead_none_hides_a_fault_of_another_topic() -> None:
    rng = random.Random(1)
    found = 0
    for _ in range(5):
        cells = sorted({(rng.randrange(1, STEPS - 1), rng.choice(["l1", "q12", "q2"])) for _ in range(40)})
        ahead = {cell: timedelta(seconds=10 ** rng.uniform(1.8, 9.0)) for cell in cells}  # beyond the bound of 60 s

        def change(k: int, name: str, given: dict[str, Any], ahead: dict[Any, timedelta] = ahead) -> dict[str, Any]:
            return given | {"time": given["time"] + ahead[k, name]} if (k, name) in ahead else given

        lines, _ = through_mqtt(messages(change))
        same(lines, diagnosed(missing(rows_of(), *cells)))
        found += any("l2" in sample["isolated"] for sample in lines)
    assert found == 5


def hostile(rng: random.Random) -> bytes:
    """A payload of any kind that a broker can hold."""
    number = rng.choice(
        ["1", "-0", "1e999", "9" * rng.randrange(1, 6000), "NaN", "-Infinity", "1.5", '"1,5"', '"7 m"', "null", "true"]
    )
    stamp = rng.choice(
        [
            str(START.timestamp() + rng.uniform(-1e5, 1e5)),
            "0",
            '""',
            '"x"',
            "1e300",
            "9" * 25,
            '"9999-12-31T23:59:59-12:00"',
            '"0001-01-01T00:00:00+14:00"',
            "[]",
            "true",
            "253402300799",
            "-62135596800",
            '"2026-03-01"',
            '"24:00"',
            '"2026-02-30 00:00"',
        ]
    )
    unit = rng.choice(["m", "K", "%", "9^9^9", "x" * 400, "**", "((", "m^-1", "é", "a b c", "m/0", "1/0"])
    kinds: list[Callable[[], bytes]] = [
        lambda: rng.randbytes(rng.randrange(0, 60)),
        lambda: number.encode(),
        lambda: f'{{"value": {number}, "time": {stamp}}}'.encode(),
        lambda: f'{{"value": {number}, "quality": {stamp}}}'.encode(),
        lambda: (rng.choice("[{") * rng.choice([3, 2000, 100_000])).encode(),
        lambda: b'{"value":' * 500 + b"1" + b"}" * 500,
        lambda: json.dumps({"value": list(range(rng.randrange(2000)))}).encode(),
        lambda: "".join(chr(rng.choice([rng.randrange(0xD800), rng.randrange(0x10000, 0x10FFFF)])) for _ in range(20)).encode(),
        lambda: f"{number} {unit}".encode(),
        lambda: b'{"value": 1, "value": 2}',
        lambda: f'{{"Value": {number}, "a": {{"b": {{"c": {{"d": 1}}}}}}, "\\ud800": 1}}'.encode(),
        lambda: json.dumps({"value": {"value": number}, "time": {"time": stamp}, "quality": [stamp]}).encode(),
    ]
    return rng.choice(kinds)()


@pytest.mark.parametrize(
    "settings", [{}, {"good": "opc-ua", "max_lead": math.inf, "max_lag": math.inf}], ids=["usual", "unbounded"]
)
def test_every_payload_that_a_broker_can_hold_leaves_the_watch_running(settings: dict[str, Any]) -> None:
    rng = random.Random(36)

    def given() -> Iterator[mqtt.Message]:
        for k in range(PAYLOADS):
            arrived = START + timedelta(seconds=0.5 * k)
            yield mqtt.Message(rng.choice(NAMES), hostile(rng), arrived if rng.random() < 0.9 else None)
        for message in messages():
            payload = json.loads(message.payload)
            shifted = datetime.fromisoformat(payload["time"]) + timedelta(seconds=6000)
            yield message._replace(
                payload=json.dumps(payload | {"time": shifted.isoformat()}).encode(),
                arrived=message.arrived + timedelta(seconds=6000),
            )

    lines, remarks = through_mqtt(given(), **settings)
    if not settings:  # without bounds a stamp of any year is believed
        after = [sample for sample in lines if sample["at"] >= 6000.0 + DT * BIAS]
        assert len(after) >= STEPS - BIAS - 2 and any("l2" in sample["isolated"] for sample in after)
    assert sum(": topic " in remark for remark in remarks) == len(NAMES)  # one for each topic


def data_values(k: int, row: Any, change: Change) -> tuple[list[Any], datetime]:
    ua = pytest.importorskip("asyncua").ua
    t, y, u = row
    stamp, found = START + timedelta(seconds=t), []
    for name, value in zip(NAMES, [*y, *u], strict=True):
        given = change(k, name, {"value": float(value), "time": stamp})
        time = given["time"].replace(tzinfo=None) if given["time"] else None
        kind = given.get("kind", ua.VariantType.Double)
        found.append(ua.DataValue(Value=ua.Variant(given["value"], kind), SourceTimestamp=time))
    return found, stamp + timedelta(seconds=0.3)


def through_opcua(change: Change = lambda k, name, found: found, **nodes: Any) -> tuple[list[dict[str, Any]], list[str]]:
    saved, lines, remarks = watching()
    bridge = opcua.OpcuaBridge(saved, "", Nodes({n: f"ns=2;s={n}" for n in NAMES}, **nodes))
    for k, row in enumerate(rows_of()):
        if (found := bridge.row(*data_values(k, row, change))) is not None:
            saved.update(*found)
    return lines, remarks


@pytest.mark.parametrize("name", ["l1", "inflow"])
@pytest.mark.parametrize("ahead", [20.0, 50.0, 18 * 3600.0, 3.2e8, 2.5e11, -3.2e7, -7200.0])
def test_a_wrong_source_time_of_a_node_costs_its_own_value_alone(ahead: float, name: str) -> None:
    pytest.importorskip("asyncua")

    def change(k: int, n: str, found: dict[str, Any]) -> dict[str, Any]:
        return found | {"time": found["time"] + timedelta(seconds=ahead)} if (k, n) == (12, name) else found

    lines, remarks = through_opcua(change)
    same(lines, diagnosed(missing(rows_of(), (12, name))))
    assert len(remarks) == 1 and remarks[0].startswith(f"node ns=2;s={name}: time stamp ")


def test_a_node_whose_clock_is_a_year_back_or_without_a_time() -> None:
    pytest.importorskip("asyncua")

    def back(k: int, n: str, found: dict[str, Any]) -> dict[str, Any]:
        return found | {"time": found["time"] - timedelta(365)} if n == "l1" else found

    lines, remarks = through_opcua(back)
    same(lines, diagnosed(missing(rows_of(), *[(k, "l1") for k in range(1, STEPS)])))  # the first may be old and right
    assert len(remarks) == 2 and "its clock is 365 days behind" in remarks[1]
    for none in (None, datetime(1601, 1, 1)):
        lines, remarks = through_opcua(lambda k, n, found, none=none: found | {"time": none} if n == "l1" else found)
        same(lines, diagnosed(rows_of()))
        assert not remarks


def test_a_node_that_does_not_change_keeps_its_old_source_time() -> None:
    pytest.importorskip("asyncua")
    rows = [(t, np.where([True, False, False, False], rows_of()[0][1], y), u) for t, y, u in rows_of()]

    def constant(k: int, n: str, found: dict[str, Any]) -> dict[str, Any]:
        return found | {"time": START - timedelta(21), "value": float(rows[0][1][0])} if n == "l1" else found

    lines, remarks = through_opcua(constant)
    same(lines, diagnosed(rows))
    assert not remarks


def test_values_of_nodes_are_read_as_those_of_payloads() -> None:
    ua = pytest.importorskip("asyncua").ua
    nodes = Nodes({n: f"ns=2;s={n}" for n in NAMES} | {"l2": {"node": "ns=2;s=l2", "unit": "mm"}})
    saved, _, remarks = watching()
    bridge = opcua.OpcuaBridge(saved, "", nodes)
    values = (ua.Variant("1,5"), ua.Variant(1500, ua.VariantType.Int32), ua.Variant(2**64 - 1, ua.VariantType.UInt64),
              ua.Variant([1.0, 2.0]), ua.Variant(True))  # fmt: skip
    _, y, u = bridge.row([ua.DataValue(Value=v, SourceTimestamp=START.replace(tzinfo=None)) for v in values], START)
    assert y[:2].tolist() == [1.5, 1.5] and np.isnan(y[3]) and np.isnan(u[0])
    assert [r.split(":")[0] for r in remarks] == ["q12", "q2", "inflow"]
