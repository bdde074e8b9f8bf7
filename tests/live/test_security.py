"""Connections: no secret in an address or a message, no password without encryption, no certificate that is not known."""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import socket
import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from toy_plants import tanks

from fusion_sfdia.cli.main import main
from fusion_sfdia.detectors.kalman_banks.leave_one_out_bank import LeaveOneOutBank
from fusion_sfdia.diagnosis.watch import Watch
from fusion_sfdia.live import mqtt, opcua, security
from fusion_sfdia.live.nodes import Nodes, load_nodes
from fusion_sfdia.live.saving import SavedWatch
from fusion_sfdia.live.topics import Topics

x509 = pytest.importorskip("cryptography.x509")
URI = "urn:example.org:FreeOpcUa:opcua-asyncio"  # of asyncua's clients
PATIENCE = 60  # s, after which the test fails instead of hanging
READ = "\n[read]\nl1 = 'ns=2;s=l1'\ninflow = 'ns=2;s=inflow'\n"
SECRET = "hunter2"


def certificate(
    folder: Path,
    name: str,
    issuer: tuple[Any, Any] | None = None,
    *,
    ca: bool = False,
    ends: int = 2120,
    host: str = "127.0.0.1",
) -> tuple[Any, Any]:
    """Write NAME.der, NAME.pem and NAME.key; the certificate and its key."""
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import rsa
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

    key = rsa.generate_private_key(65537, 2048)
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    by, by_key = (subject, key) if issuer is None else (issuer[0].subject, issuer[1])
    try:
        named: Any = x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        named = x509.DNSName(host)
    made = x509.CertificateBuilder().subject_name(subject).issuer_name(by).public_key(key.public_key())
    made = made.serial_number(x509.random_serial_number()).not_valid_before(datetime(2020, 1, 1, tzinfo=UTC))
    made = made.not_valid_after(datetime(ends, 1, 1, tzinfo=UTC))
    made = made.add_extension(x509.BasicConstraints(ca=ca, path_length=None), critical=True)
    made = made.add_extension(x509.SubjectAlternativeName([x509.UniformResourceIdentifier(URI), named]), critical=False)
    usage = [ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH]
    made = made.add_extension(x509.ExtendedKeyUsage(usage), critical=False)
    flags = dict.fromkeys(("digital_signature", "content_commitment", "key_encipherment", "data_encipherment"), True)
    flags |= {"key_agreement": False, "key_cert_sign": ca, "crl_sign": ca, "encipher_only": False, "decipher_only": False}
    found = made.add_extension(x509.KeyUsage(**flags), critical=True).sign(by_key, hashes.SHA256())
    pem, der = serialization.Encoding.PEM, serialization.Encoding.DER
    (folder / f"{name}.pem").write_bytes(found.public_bytes(pem))
    (folder / f"{name}.der").write_bytes(found.public_bytes(der))
    plain = serialization.NoEncryption()
    (folder / f"{name}.key").write_bytes(key.private_bytes(pem, serialization.PrivateFormat.PKCS8, plain))
    (folder / f"{name}-key.pem").write_bytes(key.private_bytes(pem, serialization.PrivateFormat.PKCS8, plain))
    return found, key


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A server, one of an authority, one of another host, one that has expired, a client, and another server."""
    folder = tmp_path_factory.mktemp("certificates")
    authority = certificate(folder, "authority", ca=True)
    for name, how in (
        ("server", {}),
        ("other", {}),
        ("client", {}),
        ("issued", {"issuer": authority}),
        ("elsewhere", {"issuer": authority, "host": "elsewhere.example"}),
        ("expired", {"ends": 2021}),
        ("issued-expired", {"issuer": authority, "ends": 2021}),
    ):
        certificate(folder, name, **how)  # type: ignore[arg-type]
    return folder


def shown(path: Path) -> str:
    return security.fingerprint(path.read_bytes())


@pytest.mark.parametrize(
    "userinfo",
    [f"me:{SECRET}@", f"{SECRET}@", f"me:{SECRET}/x@", f"me:{SECRET}#@", f"me:{SECRET}?@", f":{SECRET}@", f"me:{SECRET}%40@"],
)
@pytest.mark.parametrize(
    ("option", "scheme"), [("opcua", "opc.tcp://"), ("mqtt", "mqtt://"), ("mqtt", "mqtts://"), ("mqtt", "")]
)
def test_an_address_with_a_secret_is_refused_without_repeating_it(
    userinfo: str, option: str, scheme: str, capsys: pytest.CaptureFixture[str]
) -> None:
    beside = {"opcua": "--nodes", "mqtt": "--topics"}[option]
    assert main(["watch", "--plant", "two-tanks", f"--{option}", f"{scheme}{userinfo}host", beside, "absent.toml"]) == 2
    said = capsys.readouterr()
    assert SECRET not in said.err + said.out and f"--{option} has a user name or password in its address" in said.err
    assert "password_file or password_variable" in said.err


@pytest.mark.parametrize(
    "url", [f"mqtt://me:{SECRET}", f"mqtt://host?password={SECRET}", f"mqtt://host#{SECRET}", f"{SECRET}://host"]
)
def test_an_address_of_another_form_is_not_repeated_either(url: str) -> None:
    for option, schemes in security.SCHEMES.items():
        with pytest.raises(ValueError, match=f"{option} is no address that can be watched; expected") as refused:
            security.address(option, url, schemes)
        assert SECRET not in str(refused.value)
    assert security.address("", "opc.tcp://plc/path", security.SCHEMES["opcua"]) == ("opc.tcp", "plc", 4840)
    assert security.address("", "mqtts://[::1]", security.SCHEMES["mqtt"]) == ("mqtts", "::1", 8883)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (f"security = 'Basic256Sha256,Sign,own.pem,own.key::{SECRET}'", "security has another form"),
        (f"security = 'Basic256Sha256,Sign,own.pem,{SECRET}.key,server.der'", "security has another form"),
        (f"security = 'None,None,own.pem,{SECRET}.key'", "security has another form"),
        (f"security = '{SECRET}.key'", "security has another form"),
        (f"password = '{SECRET}'", "unknown name 'password'"),
        (f"password_file = ['{SECRET}']", "password_file is no text"),
        (f"key_password_variable = {{a = '{SECRET}'}}", "key_password_variable is no text"),
        ("password_file = 'a'\npassword_variable = 'b'", "both state the password"),
        ("key_password_file = 'a'\nkey_password_variable = 'b'", "both state the password"),
        ("server_certificate = 'sha256:AB'", "no fingerprint of 64 hexadecimal digits"),
        ("server_certificate = 'nodes.toml'\ntrusted = 'x'", "server_certificate needs security"),
        ("trusted = 'x'", "trusted needs security, without which no certificate is checked"),
    ],
)
def test_settings_of_a_connection_that_do_not_fit_are_refused_without_secrets(
    line: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "nodes.toml").write_text(line + READ)
    with pytest.raises(ValueError, match=message) as refused:
        load_nodes("nodes.toml", tanks())
    assert SECRET not in str(refused.value)


def test_a_password_comes_from_a_file_or_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "secret").write_text(f"{SECRET}\n")
    monkeypatch.setenv("TANKS", SECRET)
    for given in ({"password_file": str(tmp_path / "secret")}, {"password_variable": "TANKS"}):
        assert Nodes({}, **given).password == Topics({}, **given).password == SECRET
    monkeypatch.delenv("TANKS")
    with pytest.raises(ValueError, match="password_variable is 'TANKS', which the environment does not have; set it"):
        _ = Nodes({}, password_variable="TANKS").password


@pytest.mark.parametrize("mode", [None, "Sign"])
def test_a_password_without_encryption_is_refused_unless_it_is_allowed(
    mode: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TANKS", SECRET)
    stated = None if mode is None else f"Basic256Sha256,{mode},own.pem,own.key"
    nodes = Nodes({"l1": "i=1"}, user="me", password_variable="TANKS", security=stated)
    topics = Topics({"l1": "l1"}, user="me", password_variable="TANKS")
    saved = SavedWatch(Watch(LeaveOneOutBank(tanks(), window=1)), print)

    class ConnectedError(Exception):
        pass

    def connect(*_: Any, **__: Any) -> Any:
        raise ConnectedError

    monkeypatch.setattr(opcua, "connected", connect)
    monkeypatch.setattr(mqtt, "MqttBridge", connect)
    for host in ("127.0.0.1", "plc"):  # loopback, too
        with pytest.raises(
            ValueError, match=r"would be sent without encryption.*SignAndEncrypt.*--allow-plain-password"
        ) as one:
            asyncio.run(opcua.watch_server(saved, f"opc.tcp://{host}", nodes))
        with pytest.raises(
            ValueError, match=r"would be sent without encryption.*use mqtts://, or .*--allow-plain-password"
        ) as two:
            mqtt.watch_broker(saved, f"mqtt://{host}", topics)
        assert SECRET not in f"{one.value}{two.value}"
        with pytest.raises(ConnectedError):
            asyncio.run(opcua.watch_server(saved, f"opc.tcp://{host}", nodes, allow_plain_password=True))
        with pytest.raises(ConnectedError):
            mqtt.watch_broker(saved, f"mqtt://{host}", topics, allow_plain_password=True)
        with pytest.raises(ConnectedError):
            mqtt.watch_broker(saved, f"mqtts://{host}", topics)
        encrypted = Nodes({"l1": "i=1"}, user="me", password_variable="TANKS", security="Basic256,SignAndEncrypt,a,b")
        with pytest.raises(ConnectedError):
            asyncio.run(opcua.watch_server(saved, f"opc.tcp://{host}", encrypted))


# --- certificates of OPC UA


def known(files: Path, name: str, **settings: str | None) -> None:
    der = (files / f"{name}.der").read_bytes()
    stated, trusted = settings.get("server_certificate"), settings.get("trusted")
    asyncio.run(security.require_known(der, settings.get("host") or "127.0.0.1", stated, trusted))


def test_a_certificate_is_known_by_its_fingerprint_its_file_a_folder_or_an_authority(files: Path, tmp_path: Path) -> None:
    pytest.importorskip("asyncua")
    own, ca = tmp_path / "own", tmp_path / "ca"
    for folder, names in ((own, ("server.der", "expired.pem")), (ca, ("authority.der",))):
        folder.mkdir()
        for name in names:
            (folder / name).write_bytes((files / name).read_bytes())
    for stated in ("server.der", "server.pem"):
        known(files, "server", server_certificate=str(files / stated))
    digits = shown(files / "server.der")
    for text in (f"sha256:{digits}", f"SHA256:{digits.lower()}", f"sha256:{digits.replace(':', '')}"):
        known(files, "server", server_certificate=text)
    known(files, "server", trusted=str(own))
    known(files, "expired", trusted=str(own))
    known(files, "issued", trusted=str(ca))
    known(files, "elsewhere", trusted=str(ca), host="Elsewhere.Example")
    for name, settings in (
        ("server", {}),
        ("server", {"trusted": str(ca)}),
        ("issued", {"trusted": str(own)}),
        ("elsewhere", {"trusted": str(ca)}),
        ("issued-expired", {"trusted": str(ca)}),
    ):
        message = (
            rf"the server is not known. Its SHA-256 is {shown(files / f'{name}.der')}; where the server itself shows the same"
        )
        with pytest.raises(security.UntrustedError, match=message):
            known(files, name, **settings)
    with pytest.raises(
        security.UntrustedError, match="is another than server_certificate states: renewed, or of another server"
    ):
        known(files, "other", server_certificate=str(files / "server.der"), trusted=str(own))
    (tmp_path / "notes.txt").write_text("-----BEGIN")
    with pytest.raises(ValueError, match="which is no certificate"):
        security.stated_fingerprint(str(tmp_path / "notes.txt"))


async def asked(files: Path, nodes: Nodes, server_name: str = "server") -> Any:
    """What a client as `nodes` states reads of a server with that certificate, which signs and encrypts."""
    from asyncua import Server, ua

    server = Server()
    await server.init()
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port = found.getsockname()[1]
    server.set_endpoint(f"opc.tcp://127.0.0.1:{port}/")
    await server.set_application_uri(URI)
    server.set_security_policy([ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
    await server.load_certificate(str(files / f"{server_name}.der"))
    await server.load_private_key(str(files / f"{server_name}-key.pem"))
    node = await server.nodes.objects.add_variable(ua.NodeId("l1", 2), "l1", 3.0)
    async with server:
        client = await opcua.connected(f"opc.tcp://127.0.0.1:{port}/", nodes)
        try:
            return await client.get_node(node.nodeid).read_value()
        finally:
            await client.disconnect()


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_real_server_is_read_where_its_certificate_is_known_and_refused_where_not(files: Path) -> None:
    pytest.importorskip("asyncua")
    stated = f"Basic256Sha256,SignAndEncrypt,{files / 'client.der'},{files / 'client-key.pem'}"

    def read(**settings: str) -> Any:
        return asyncio.run(asyncio.wait_for(asked(files, Nodes({"l1": "ns=2;s=l1"}, security=stated, **settings)), PATIENCE))

    digits = shown(files / "server.der")
    with pytest.raises(
        security.UntrustedError, match=f"is not known. Its SHA-256 is {digits}.*server_certificate = .sha256:{digits}"
    ):
        read()
    assert read(server_certificate=f"sha256:{digits}") == 3.0
    with pytest.raises(security.UntrustedError, match=f"is another than server_certificate states.*Its SHA-256 is {digits}"):
        read(server_certificate=str(files / "other.der"))


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_own_files_that_are_not_there_end_the_watch(files: Path) -> None:
    pytest.importorskip("asyncua")
    for certificate_file, key, what in (("absent.der", "client-key.pem", "certificate"), ("client.der", SECRET, "key")):
        stated = f"Basic256Sha256,SignAndEncrypt,{files / certificate_file},{files / key}"
        with pytest.raises(ValueError, match=f"there is no file of the own {what}") as refused:
            asyncio.run(asyncio.wait_for(asked(files, Nodes({"l1": "i=1"}, security=stated)), PATIENCE))
        assert SECRET not in str(refused.value)


def test_a_certificate_that_changes_later_is_remarked_and_tried_again(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("asyncua")
    remarks: list[str] = []
    saved = SavedWatch(Watch(LeaveOneOutBank(tanks(), window=1), refused=remarks.append), print)
    steps: Iterator[Any] = iter(
        [None, security.UntrustedError("its certificate"), security.UntrustedError("again"), KeyError()]
    )

    class Client:
        async def disconnect(self) -> None:
            pass

    async def connected(*_: Any) -> Client:
        if isinstance(step := next(steps), Exception):
            raise step
        return Client()

    async def rows(*_: Any) -> None:
        raise ConnectionError("lost")

    monkeypatch.setattr(opcua, "connected", connected)
    monkeypatch.setattr(opcua.OpcuaBridge, "rows", rows)
    nodes = Nodes({"l1": "i=1", "inflow": "i=2"}, retry=0.0)
    with pytest.raises(KeyError):
        asyncio.run(opcua.watch_server(saved, "opc.tcp://plc", nodes))
    assert remarks == ["opc.tcp://plc: no connection (lost); tried again every 0 s"]
    steps = iter([security.UntrustedError("its certificate")])
    with pytest.raises(security.UntrustedError):
        asyncio.run(opcua.watch_server(saved, "opc.tcp://plc", nodes))


# --- certificates of MQTT


@contextmanager
def tls_server(files: Path, name: str) -> Iterator[int]:
    """A server on a port that makes TLS handshakes until the block ends."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(files / f"{name}.pem", files / f"{name}.key")
    with socket.create_server(("127.0.0.1", 0)) as listening:
        ended = threading.Event()

        def serve() -> None:
            while True:
                plain, _ = listening.accept()
                if ended.is_set():
                    return plain.close()
                try:
                    with plain, context.wrap_socket(plain, server_side=True) as tls:
                        tls.recv(1)
                except OSError:  # the client has gone
                    pass

        thread = threading.Thread(target=serve)
        thread.start()
        port = listening.getsockname()[1]
        try:
            yield port
        finally:
            ended.set()
            socket.create_connection(("127.0.0.1", port), PATIENCE).close()
            thread.join(PATIENCE)


def test_a_broker_is_known_by_its_fingerprint_its_file_or_its_authority(files: Path) -> None:
    def met(name: str, **settings: str) -> None:
        with tls_server(files, name) as port:
            security.require_known_broker("127.0.0.1", port, security.tls_context(Topics({}, **settings)), PATIENCE)

    digits = shown(files / "server.der")
    with pytest.raises(
        security.UntrustedError, match=f"the broker .*is not known. Its SHA-256 is {digits}.*of its authority as ca"
    ):
        met("server")
    for stated in (f"sha256:{digits}", str(files / "server.pem"), str(files / "server.der")):
        met("server", server_certificate=stated)
        with pytest.raises(security.UntrustedError, match="is another than server_certificate states"):
            met("other", server_certificate=stated)
    met("expired", server_certificate=str(files / "expired.pem"))
    met("issued", ca=str(files / "authority.pem"))
    for name in ("elsewhere", "issued-expired", "other"):
        with pytest.raises(security.UntrustedError, match="is not known"):
            met(name, ca=str(files / "authority.pem"))
    with socket.socket() as free:  # nobody listens: tried again later
        free.bind(("127.0.0.1", 0))
        security.require_known_broker("127.0.0.1", free.getsockname()[1], security.tls_context(Topics({})), PATIENCE)


def test_paho_checks_the_stated_certificate_before_it_sends_anything(files: Path) -> None:
    paho = pytest.importorskip("paho.mqtt.client")
    for name, fails in (("server", False), ("other", True)):
        client = paho.Client(paho.CallbackAPIVersion.VERSION2)
        client.tls_set_context(security.tls_context(Topics({}, server_certificate=str(files / "server.der"))))
        with tls_server(files, name) as port:
            if fails:
                with pytest.raises(ssl.SSLCertVerificationError, match="is another than server_certificate states"):
                    client.connect("127.0.0.1", port)
            else:
                client.connect("127.0.0.1", port)
                client.disconnect()
                client.loop_misc()
                client._sock_close()


def test_files_for_tls_that_do_not_fit_are_refused(files: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="there is no file of ca, for TLS"):
        security.tls_context(Topics({}, ca=str(tmp_path / "absent")))
    with pytest.raises(ValueError, match=r"certificate or key cannot be read; expected \.pem files that belong together"):
        security.tls_context(Topics({}, certificate=str(files / "server.pem"), key=str(files / "other.key")))


# --- what libraries log


def test_warnings_of_a_library_are_said_once_a_kind_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    said: list[str] = []
    with security.remarked_logs(("asyncua",), said.append):
        logger = logging.getLogger("asyncua.client.client")
        for k in range(3):
            logger.warning("Requested session timeout to be %dms", k)
            try:
                raise OSError("gone\naway")
            except OSError:
                logger.exception("Error while renewing session")
        logger.info("no remark")
    assert said == [
        "asyncua: Requested session timeout to be 0ms (said once)",
        "asyncua: Error while renewing session: OSError gone away (said once)",
    ]
    assert capsys.readouterr().err == "" and logging.getLogger("asyncua").propagate
