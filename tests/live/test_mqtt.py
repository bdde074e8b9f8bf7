"""A watch on mosquitto in its own process, which is killed and comes back."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from toy_plants import readings, tanks

from fusion_sfdia.cli.main import main
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.diagnosis.watch import Watch
from fusion_sfdia.live import mqtt
from fusion_sfdia.live.saving import SavedWatch
from fusion_sfdia.live.topics import Topics, load_topics
from fusion_sfdia.live.values import TimedValue, Values

paho = pytest.importorskip("paho.mqtt.client")

MOSQUITTO = shutil.which("mosquitto", path=os.pathsep.join([os.environ.get("PATH", ""), "/usr/sbin", "/usr/local/sbin"]))
needs_mosquitto = pytest.mark.skipif(MOSQUITTO is None, reason="needs the broker mosquitto (Debian: apt install mosquitto)")
PATIENCE = 120  # s, after which the test fails instead of hanging
START = datetime(2026, 3, 1, 14, 0, tzinfo=UTC)
TOPICS = """
retry = 0.05
max_lag = inf
status = "tanks/watch"
events = "tanks/events"

[read]
l1 = { topic = "tanks/levels", value = "l1.pv", quality = "l1.q", time = "at" }
l2 = { topic = "tanks/levels", value = "l2.pv", time = "at" }
q12 = "tanks/q12"
q2 = "tanks/q2"
inflow = "tanks/inflow"

[write]
verdict = "tanks/verdict"
alarm = "tanks/alarm"
l1 = { value = "tanks/l1/value", sigma = "tanks/l1/sigma", verdict = "tanks/l1/verdict", health = "tanks/l1/health" }
"""


class EndedError(Exception):
    """The last row was diagnosed."""


class Broker:
    """mosquitto as a process, always on one port."""

    def __init__(self, folder: Path, settings: str = "allow_anonymous true\n") -> None:
        with socket.socket() as found:
            found.bind(("127.0.0.1", 0))
            self.port = found.getsockname()[1]
        self.file = folder / "mosquitto.conf"
        self.file.write_text(f"listener {self.port} 127.0.0.1\nuser root\n{settings}")

    def start(self) -> None:
        self.process = subprocess.Popen([str(MOSQUITTO), "-c", str(self.file)], stderr=subprocess.PIPE, text=True)
        assert self.process.stderr
        while " running" not in (line := self.process.stderr.readline()):
            assert line, "mosquitto has ended"

    def kill(self) -> None:
        self.process.kill()
        self.process.communicate(timeout=PATIENCE)


class Field:
    """A client in the place of the plant: it publishes rows, and hears what the watch publishes."""

    def __init__(self, broker: Broker) -> None:
        self.client = client = paho.Client(paho.CallbackAPIVersion.VERSION2)
        client.reconnect_delay_set(0.05, 0.05)
        self.heard: dict[str, Any] = {}
        self.watching = threading.Event()
        self.news = threading.Condition()
        client.on_connect = lambda c, *_: c.subscribe("tanks/#", 1)
        client.on_message = self._message
        client.connect_async("127.0.0.1", broker.port)
        client.loop_start()

    def _message(self, client: Any, userdata: Any, message: Any) -> None:
        if message.topic == "tanks/watch":
            (
                self.watching.set
                if message.payload != b"gone" and json.loads(message.payload)["status"] == "watching"
                else self.watching.clear
            )()
            return
        with self.news:
            self.heard[message.topic] = json.loads(message.payload)
            self.news.notify_all()

    def publish(self, t: float, y: np.ndarray, u: np.ndarray, *, good: bool = True) -> None:
        """The levels in one object, the others each in its own."""
        at = (START + timedelta(seconds=t)).isoformat()
        levels = {"at": at, "l1": {"pv": y[0], "q": "GOOD" if good else "BAD"}, "l2": {"pv": y[1]}}
        objects = {"levels": levels}
        objects |= {name: {"value": v, "time": at} for name, v in zip(("q12", "q2", "inflow"), (y[2], y[3], u[0]), strict=True)}
        for name, found in objects.items():
            self.client.publish(f"tanks/{name}", json.dumps(found), 1)

    def end(self) -> None:
        self.client.disconnect()
        self.client.loop_stop()


def detector() -> LeaveOneOutBank:
    return LeaveOneOutBank(tanks(), window=1)


def rows_of(steps: int) -> list[tuple[float, np.ndarray, np.ndarray]]:
    t, _, y, u = readings(tanks(), steps, 1, seed=4)
    y, u = y[:, 0].copy(), u[:, 0]
    y[20:, 0] += 0.3
    return list(zip((t - t[0]).tolist(), y, u, strict=True))


def lines_of(rows: list[Any]) -> list[dict[str, Any]]:
    found: list[str] = []
    saved = SavedWatch(Watch(detector(), at_sample=True), found.append, samples=True)
    for row in rows:
        saved.update(*row)
    return [without_stamps(line) for line in found]


def without_stamps(line: str) -> dict[str, Any]:
    return {name: value for name, value in json.loads(line).items() if "time" not in name and name != "text"}


@pytest.fixture
def topics(tmp_path: Path) -> Topics:
    (tmp_path / "topics.toml").write_text(TOPICS)
    return load_topics(tmp_path / "topics.toml", tanks())


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    found = Broker(tmp_path)
    found.start()
    yield found
    found.kill()


@pytest.mark.slow
@needs_mosquitto
def test_topics_are_rows_and_a_broker_that_is_killed_and_comes_back_is_a_gap(broker: Broker, topics: Topics) -> None:
    steps, killed, back, bad = 40, 29, 33, 8
    rows, remarks, found = rows_of(steps), [], []
    field = Field(broker)
    left = iter([*range(killed + 1), *range(back, steps)])

    def following() -> None:
        if (k := next(left, None)) is None:
            raise EndedError
        if k == back:
            field.watching.clear()
            broker.kill()
            broker.start()
            assert field.watching.wait(PATIENCE)
        field.publish(*rows[k], good=k != bad)

    def write(line: str) -> None:
        found.append(known := without_stamps(line))
        if known["event"] == "sample" and known["t"] > 0:  # the first row waits for the second
            following()

    saved = SavedWatch(Watch(detector(), at_sample=True, refused=remarks.append), write, samples=True)

    def first() -> None:
        assert field.watching.wait(PATIENCE)
        following()
        following()

    starting = threading.Thread(target=first)
    starting.start()
    with pytest.raises(EndedError):
        mqtt.watch_broker(saved, f"mqtt://127.0.0.1:{broker.port}", topics)
    starting.join()
    rows[bad][1][0] = np.nan
    expected = lines_of(rows[: killed + 1] + rows[back:])
    assert found == expected and {"l1"} <= {e.get("hypothesis") for e in found}
    last_but_one = [e for e in found if e["event"] == "sample"][-2]
    with field.news:
        assert field.news.wait_for(lambda: not field.watching.is_set() and len(field.heard) >= 11, PATIENCE)
    assert field.heard["tanks/l1/value"]["value"] == last_but_one["values"]["l1"] != rows[-2][1][0]
    assert field.heard["tanks/l1/sigma"]["value"] == last_but_one["sigma"]["l1"]
    assert field.heard["tanks/l1/verdict"]["value"] == "isolated" and field.heard["tanks/alarm"]["value"] is True
    assert "l1" in field.heard["tanks/verdict"]["value"]
    assert last_but_one["device_health"]["l1"] == "OFF_SPEC"
    assert field.heard["tanks/l1/health"]["value"] == "CHECK_FUNCTION", "nobody watches any more"
    assert without_stamps(json.dumps(field.heard["tanks/events"])) in [e for e in found if e["event"] != "sample"]
    stamp = datetime.fromisoformat(field.heard["tanks/alarm"]["time"])
    assert stamp == START + timedelta(seconds=rows[-2][0])
    field.end()
    assert "no connection" in remarks[0] and remarks[1].endswith("connected again") and len(remarks) == 2


def certified(folder: Path) -> str:
    """Files of an own authority and a server, and the settings of mosquitto with them and a password."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import NameOID

    key, name = ec.generate_private_key(ec.SECP256R1()), x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "tanks")])
    made = x509.CertificateBuilder().subject_name(name).issuer_name(name).public_key(key.public_key())
    made = made.serial_number(1).not_valid_before(datetime(2020, 1, 1)).not_valid_after(datetime(2120, 1, 1))
    made = made.add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
    made = made.add_extension(
        x509.SubjectAlternativeName([x509.IPAddress(__import__("ipaddress").ip_address("127.0.0.1"))]), critical=False
    )
    pem, plain = serialization.Encoding.PEM, serialization.NoEncryption()
    (folder / "own.pem").write_bytes(made.sign(key, hashes.SHA256()).public_bytes(pem))
    (folder / "own.key").write_bytes(key.private_bytes(pem, serialization.PrivateFormat.PKCS8, plain))
    passwords = folder / "passwords"
    passwords.write_text("watch:secret\n")
    command = Path(str(MOSQUITTO)).name.replace("mosquitto", "mosquitto_passwd")
    subprocess.run([shutil.which(command) or command, "-U", str(passwords)], check=True)
    return f"allow_anonymous false\npassword_file {passwords}\ncertfile {folder}/own.pem\nkeyfile {folder}/own.key\n"


@pytest.mark.slow
@needs_mosquitto
@pytest.mark.skipif(shutil.which("mosquitto_passwd") is None, reason="needs mosquitto_passwd, which comes with mosquitto")
def test_a_connection_with_tls_and_a_password_that_is_refused_without_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broker = Broker(tmp_path, certified(tmp_path))
    broker.start()
    settings = f'ca = "{tmp_path}/own.pem"\nuser = "watch"\npassword_variable = "TANKS"\n'
    (tmp_path / "topics.toml").write_text(settings + TOPICS)
    topics, url = load_topics(tmp_path / "topics.toml", tanks()), f"mqtts://127.0.0.1:{broker.port}"
    with pytest.raises(ValueError, match="'TANKS', which the environment does not have"):
        mqtt.watch_broker(SavedWatch(Watch(detector()), print), url, topics)
    said: list[str] = []

    def refused(remark: str) -> None:
        said.append(remark)
        monkeypatch.setenv("TANKS", "secret")
        raise EndedError

    monkeypatch.setenv("TANKS", "wrong")
    with pytest.raises(EndedError):
        mqtt.watch_broker(SavedWatch(Watch(detector(), refused=refused), print), url, topics)
    assert "no connection (Not authorized)" in said[0]
    bridge = mqtt.MqttBridge(SavedWatch(Watch(detector()), print), url, topics)
    up = threading.Event()
    bridge.client.on_subscribe = lambda *_: up.set()
    bridge.client.connect("127.0.0.1", broker.port)
    bridge.client.loop_start()
    assert up.wait(PATIENCE)
    bridge.client.disconnect()
    bridge.client.loop_stop()
    broker.kill()


def test_a_payload_is_a_number_or_an_object_with_value_time_and_quality(topics: Topics) -> None:
    now, plain, nested = START, topics.sources["q2"], topics.sources["l1"]
    expected: dict[bytes, tuple[float, datetime | None]] = {
        b"1.5": (1.5, now),
        b" 2 ": (2.0, now),
        b"": (np.nan, now),
        b"Bad": (np.nan, now),
        b"[1]": (np.nan, now),
        b"true": (np.nan, now),
        b"1e999": (np.nan, now),
        b'{"value": 1}': (1.0, now),
        b'{"value": "1"}': (1.0, now),
        b'{"value": 1, "quality": 192}': (1.0, now),
        b'{"value": 1, "quality": "Good"}': (1.0, now),
        b'{"value": 1, "quality": true}': (1.0, now),
        b'{"value": 1, "quality": 1}': (np.nan, now),
        b'{"value": 1, "quality": "uncertain"}': (np.nan, now),
        b'{"value": 1, "quality": [1]}': (np.nan, now),
        b'{"value": 1, "time": "2026-03-01T15:00:00+01:00"}': (1.0, START),
        b'{"value": 1, "time": 1772373600}': (1.0, START),
        b'{"value": 1, "time": "noon"}': (1.0, None),
    }
    for payload, (number, stamp) in expected.items():
        found = topics.value(plain, payload, now)
        assert found.stamp == stamp and np.array_equal(found.number, number, equal_nan=True), payload
    assert topics.value(nested, b'{"l1": {"pv": 3, "q": "good"}, "at": "2026-03-01 14:00"}', None) == TimedValue(3.0, START)
    in_ms = Topics({}, epoch="ms", good=("fine",))
    assert in_ms.value(plain, b'{"value": 1, "time": 1772373600000, "quality": "FINE"}', None) == TimedValue(1.0, START)


def completed(values: Values, *given: tuple[str, float]) -> list[tuple[float, list[float]]]:
    """Rows from values, each with its number as its time, as seconds and readings."""
    rows, found = mqtt.TopicRows(values, 5, 2.5), []
    for name, seconds in given:
        stamp = START + timedelta(seconds=seconds)
        found += [((t - START).total_seconds(), [*y, *u]) for t, y, u in rows.take(name, TimedValue(seconds, stamp))]
    return found


def test_a_row_is_complete_with_all_values_or_the_first_of_the_next() -> None:
    names = ("l1", "l2", "q12", "q2", "inflow")
    found = completed(
        Values(Watch(detector()), None), *[(n, 0.0) for n in names], *[(n, 5.0 + 0.1 * k) for k, n in enumerate(names)]
    )
    assert found == [(0.0, [0.0] * 5), (5.4, [5.0, 5.1, 5.2, 5.3, 5.4])]
    silent = [*[(n, 0.0) for n in names], *[(n, t) for t in (5.0, 10.0, 15.0) for n in names[1:]]]
    assert completed(Values(Watch(detector()), None), *silent)[1:] == [(5.0, [0.0] + [5.0] * 4), (10.0, [0.0] + [10.0] * 4)]
    stale = completed(Values(Watch(detector()), 7.0), *silent)
    assert np.isnan(stale[2][1][0]) and stale[1][1][0] == 0.0
    again = [*[(n, 0.0) for n in names], ("l1", 0.0), ("l2", -1.0), *[(n, 5.0) for n in names]]
    assert len(completed(Values(Watch(detector()), None), *again)) == 2


def test_of_too_many_messages_the_oldest_are_lost_and_counted(topics: Topics, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mqtt, "QUEUED", 3)
    said: list[str] = []
    bridge = mqtt.MqttBridge(SavedWatch(Watch(detector(), refused=said.append), print), "mqtt://x", topics)
    for k in range(5):
        message = paho.MQTTMessage(topic=b"tanks/q2")
        message.payload, message.retain = str(k).encode(), k == 4
        bridge._message(None, None, message)
    found = [bridge.next() for _ in range(3)]
    assert [m.payload for m in found] == [b"2", b"3", b"4"] and found[0].arrived and found[2].arrived is None
    assert said == ["mqtt://x: 2 messages were lost, as they came faster than they were diagnosed"]


def test_a_file_of_topics_or_an_address_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "topics.toml"
    for change, message in (
        (('"tanks/q2"', '"tanks/+"'), r"q2 is 'tanks/\+'; expected a topic"),
        (("quality =", "state ="), "l1: unknown name 'state'; known: topic, value, time, quality"),
        (('value = "l1.pv"', "value = 1"), "l1: value is 1; expected a key"),
        (("retry = 0.05", "retry = 0"), "retry is 0; expected a positive number of seconds"),
        (("retry = 0.05", "qos = 3"), "qos is 3; expected 0 or 1 or 2"),
        (("retry = 0.05", 'epoch = "min"'), "epoch is 'min'; expected 's' or 'ms' or 'us' or 'ns'"),
        (("retry = 0.05", 'decimal = ";"'), "decimal is ';'; expected '.' or ','"),
        (("max_lag = inf", "max_lag = nan"), "max_lag is nan; expected seconds of at least 0, or inf"),
        (("max_lag = inf", "max_lead = -1"), "max_lead is -1; expected seconds of at least 0, or inf"),
        (("retry = 0.05", 'tz = "Amsterdam"'), "tz is 'Amsterdam'; expected a time zone by its place"),
        (("retry = 0.05", 'time_format = "dd.mm"'), "format is 'dd.mm'; expected one as strptime takes it"),
        (('"tanks/q2"', '{ topic = "tanks/q2", unit = "bar" }'), "unit 'bar' does not convert to 'm3/s'"),
        (('"tanks/q2"', '{ topic = "tanks/q2", unit = 1 }'), "q2: unit is 1; expected a unit"),
        (('"tanks/q2"', '{ topic = "tanks/q2", states = { on = true } }'), "q2: states is {'on': True}; expected numbers"),
        (("retry = 0.05", 'good = "good"'), "good is 'good'; expected a list"),
        (("retry = 0.05", 'password = "x"'), "unknown name 'password'"),
        (("retry = 0.05", 'password_file = "a"\npassword_variable = "B"'), "both state the password"),
        (("inflow =", "#"), "nothing for the inputs inflow"),
        (('"tanks/alarm"', "3"), "alarm is 3; expected a topic"),
        (('"tanks/alarm"', '"tanks/q2"'), r"\[read\] q2 and \[write\] alarm both have the address 'tanks/q2'"),
        (('"tanks/l1/sigma"', '"tanks/levels"'), r"\[read\] l2 and \[write.l1\] sigma both have the address"),
        (('"tanks/l1/sigma"', '"tanks/alarm"'), r"\[write\] alarm and \[write.l1\] sigma both have the address"),
        (('"tanks/l1/sigma"', '{ topic = "a" }'), r"\[write.l1\]: sigma is {'topic': 'a'}; expected a topic"),
        (('"tanks/watch"', '"tanks/levels"'), r"\[read\] l2 and status both have the address 'tanks/levels'"),
        (('"tanks/watch"', '"tanks/verdict"'), r"\[write\] verdict and status both have the address"),
        (('"tanks/inflow"', '"tanks/q2"'), "sensor q2 and input inflow are both read from 'tanks/q2', key 'value'"),
        (('"l2.pv"', '"l1.pv"'), "sensor l1 and sensor l2 are both read from 'tanks/levels', key 'l1.pv'"),
        (("[write]", '[write]\ninflow = { value = "a" }'), r"\[write\]: inflow is an input; expected sensors"),
    ):
        path.write_text(TOPICS.replace(*change, 1))
        with pytest.raises(ValueError, match=message):
            load_topics(path, tanks())
    for url in ("host:1883", "tcp://host", "mqtt://", "mqtt://host:x", "mqtt://host/a"):
        with pytest.raises(ValueError, match="--mqtt is no address that can be watched; expected mqtt://host:1883"):
            mqtt.address(url)
    assert mqtt.address("mqtts://host") == ("host", 8883, True)
    (tmp_path / "secret").write_text("from a file\n")
    assert Topics({}, password_file=str(tmp_path / "secret")).password == "from a file"


def test_the_command_needs_both_and_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["watch", "--plant", "two-tanks", "--detector", "loo-chi2", "--mqtt", "mqtt://127.0.0.1:1"]
    (tmp_path / "topics.toml").write_text(TOPICS)
    both = [*command, "--topics", str(tmp_path / "topics.toml")]
    assert main(command) == 2 and "--mqtt needs --topics" in capsys.readouterr().err
    assert main([*both, "--opcua", "opc.tcp://x", "--nodes", "x"]) == 2
    assert "--opcua and --mqtt both state" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "paho.mqtt.client", None)
    assert main(both) == 1
    assert "pip install 'fusion-sfdia[mqtt]'" in capsys.readouterr().err
