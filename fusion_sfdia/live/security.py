"""Connections that can be trusted: addresses without secrets, passwords from files or the environment, known certificates.

A certificate is known where it is the one that `server_certificate` states, by its file or its SHA-256 fingerprint; of an OPC
UA server also where it is in the folder `trusted` or issued by an authority there for this host; of an MQTT broker where the
authorities of the system, or of the file `ca`, have issued it for this host. A password is sent through an encrypted connection
alone. No message repeats an address that is refused, a password, or the name of a key.
"""

from __future__ import annotations

import ipaddress
import logging
import os
import socket
import ssl
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

SCHEMES = {"opcua": {"opc.tcp": 4840}, "mqtt": {"mqtt": 1883, "mqtts": 8883}}  # with their usual ports
FINGERPRINT = "sha256:"
POLICIES = ("Aes256Sha256RsaPss", "Aes128Sha256RsaOaep", "Basic256Sha256", "Basic256", "Basic128Rsa15")
MODES = ("Sign", "SignAndEncrypt")
EXAMPLE = "'Basic256Sha256,SignAndEncrypt,own.pem,own.key'"


class UntrustedError(ValueError):
    """A server with a certificate that is not known."""


@dataclass(frozen=True, kw_only=True)
class Connection:
    """What both bridges need to connect.

    user, and the password in a file (password_file) or an environment variable (password_variable); the same for the password
    of an own key that is encrypted. server_certificate: the only one that is accepted, its file (.der or .pem) or "sha256:" and
    its fingerprint.
    """

    user: str | None = None
    password_file: str | None = None
    password_variable: str | None = None
    key_password_file: str | None = None
    key_password_variable: str | None = None
    server_certificate: str | None = None

    @property
    def password(self) -> str | None:
        """The password, None without one; ValueError where the environment variable is not set."""
        return _secret("password", self.password_file, self.password_variable)

    @property
    def key_password(self) -> str | None:
        """That of the own key."""
        return _secret("key_password", self.key_password_file, self.key_password_variable)


def _secret(what: str, file: str | None, variable: str | None) -> str | None:
    if file is not None:
        return Path(file).read_text(encoding="utf-8").rstrip("\r\n")
    if variable is None:
        return None
    if (found := os.environ.get(variable)) is None:
        raise ValueError(f"{what}_variable is {variable!r}, which the environment does not have; set it")
    return found


def require_connection(path: str | Path, found: dict[str, Any], *more: str) -> None:
    """Raise ValueError where a field of `Connection`, or one of `more`, is no text, or a password is stated twice."""
    for name in (*(f.name for f in fields(Connection)), *more):
        if name in found and not (isinstance(found[name], str) and found[name]):
            raise ValueError(f"{path}: {name} is no text; expected one in quotes")
    for what in ("password", "key_password"):
        if f"{what}_file" in found and f"{what}_variable" in found:
            raise ValueError(f"{path}: {what}_file and {what}_variable both state the password; give one")
    if "server_certificate" in found:
        stated_fingerprint(found["server_certificate"])


def require_security(path: str | Path, found: dict[str, Any]) -> None:
    """Raise ValueError where the security of OPC UA has another form, or certificates are stated without it."""
    if "security" not in found:
        if given := [name for name in ("server_certificate", "trusted") if name in found]:
            raise ValueError(f"{path}: {given[0]} needs security, without which no certificate is checked; expected {EXAMPLE}")
        return
    parts = found["security"].split(",")
    if len(parts) != 4 or parts[0] not in POLICIES or parts[1] not in MODES or not all(parts) or "::" in parts[3]:
        raise ValueError(
            f"{path}: security has another form than Policy,Mode,certificate,key, such as {EXAMPLE}; policies: "
            f"{', '.join(POLICIES)}; modes: {', '.join(MODES)}. The server's certificate is stated as server_certificate, the "
            "password of a key by key_password_file or key_password_variable"
        )


def address(option: str, url: str, schemes: dict[str, int], paths: Collection[str] = ()) -> tuple[str, str, int]:
    """Scheme, host and port of scheme://host[:port]; paths: those that may follow, any where empty.

    ValueError, which does not repeat the address, for anything else, above all for one with a user name or a password.
    """
    example = " or ".join(f"{scheme}://host:{port}" for scheme, port in schemes.items())
    if "@" in url:
        raise ValueError(
            f"{option} has a user name or password in its address, where other users and logs see it; expected {example}, "
            "with user and password_file or password_variable in the file of --nodes or --topics"
        )
    try:
        found = urlsplit(url)
        host, port = found.hostname, found.port
    except ValueError:
        host, port, found = None, None, urlsplit("")
    if found.scheme not in schemes or not host or found.query or found.fragment or (paths and found.path not in paths):
        raise ValueError(f"{option} is no address that can be watched; expected {example}")
    return found.scheme, host, port or schemes[found.scheme]


def require_encrypted(has_password: bool, encrypted: bool, allowed: bool, cure: str) -> None:
    """Raise ValueError where a password would be sent through a connection that is not encrypted, unless that is allowed."""
    if has_password and not encrypted and not allowed:
        raise ValueError(
            f"the password would be sent without encryption, so that the network can read it; {cure}, or accept that with "
            "--allow-plain-password (allow_plain_password=True)"
        )


def fingerprint(der: bytes) -> str:
    """The SHA-256 of a certificate as tools show it, AB:CD:..."""
    return sha256(der).digest().hex(":").upper()


def stated_fingerprint(stated: str) -> str:
    """The fingerprint of a certificate that is stated by "sha256:" and its fingerprint, or by its file."""
    if stated.lower().startswith(FINGERPRINT):
        digits = stated[len(FINGERPRINT) :].replace(":", "").strip().upper()
        if len(digits) != 64 or set(digits) - set("0123456789ABCDEF"):
            raise ValueError(
                "server_certificate has no fingerprint of 64 hexadecimal digits behind sha256:; expected sha256:AB:CD..."
            )
        return ":".join(digits[i : i + 2] for i in range(0, 64, 2))
    content = Path(stated).read_bytes()
    if b"-----BEGIN" not in content:
        return fingerprint(content)
    try:
        text = content.decode("ascii")
        start, end = "-----BEGIN CERTIFICATE-----", "-----END CERTIFICATE-----"
        return fingerprint(ssl.PEM_cert_to_DER_cert(text[text.index(start) : text.index(end) + len(end)]))
    except ValueError as error:
        raise ValueError(
            f"server_certificate is {stated!r}, which is no certificate; expected a .der or .pem file of one"
        ) from error


def untrusted(whose: str, der: bytes, stated: str | None, more: str) -> UntrustedError:
    """The error for a certificate that is not known: its fingerprint, and how to trust it."""
    found = fingerprint(der)
    what = "is not known" if stated is None else "is another than server_certificate states: renewed, or of another server"
    return UntrustedError(
        f"the certificate of {whose} {what}. Its SHA-256 is {found}; where the server itself shows the same, state it as "
        f'server_certificate = "{FINGERPRINT}{found}"{more}'
    )


# --- OPC UA


async def secure(client: Any, host: str, settings: Any) -> None:
    """Set the security of an asyncua client, as `Nodes` states it; UntrustedError where the server's certificate is not known.

    ValueError for own files that cannot be read.
    """
    policy_name, mode_name, certificate, key = settings.security.split(",")
    ua, crypto = import_module("asyncua.ua"), import_module("asyncua.crypto.uacrypto")
    policy = getattr(import_module("asyncua.crypto.security_policies"), f"SecurityPolicy{policy_name}")
    mode = getattr(ua.MessageSecurityMode, mode_name)
    for what, file in (("certificate", certificate), ("key", key)):
        if not Path(file).is_file():
            raise ValueError(f"security: there is no file of the own {what}; make it, or name another one")
    endpoints = await client.connect_and_get_server_endpoints()
    presented = crypto.x509_from_der(client.find_endpoint(endpoints, mode, policy.URI).ServerCertificate)
    if presented is None:
        raise UntrustedError("the server states no certificate for this security")
    der: bytes = crypto.der_from_x509(presented)
    await require_known(der, host, settings.server_certificate, settings.trusted)
    try:
        await client.set_security(policy, certificate, key, settings.key_password, der, mode)
    except (ValueError, TypeError) as error:
        raise ValueError(
            f"security: the own certificate or key cannot be read ({type(error).__name__}); expected .pem or .der files, and "
            "key_password_file or key_password_variable for a key that is encrypted"
        ) from error


async def require_known(der: bytes, host: str, stated: str | None, trusted: str | None) -> None:
    """Raise UntrustedError unless the certificate (DER) of an OPC UA server is the stated one, or the folder `trusted` has it.

    stated: as `Connection.server_certificate`, which alone counts where it is given. A certificate that is trusted itself may
    have expired; one of an authority in the folder may not, and has to name the host.
    """
    if stated is not None:
        if stated_fingerprint(stated) != fingerprint(der):
            raise untrusted("the server", der, stated, "")
        return
    if trusted is not None:
        files = [p for p in Path(trusted).iterdir() if p.suffix.lower() in (".der", ".pem")]
        if fingerprint(der) in {stated_fingerprint(str(p)) for p in files} or await _issued(der, host, Path(trusted)):
            return
    place = (
        "or put its file (.der, .pem) into a folder, trusted"
        if trusted is None
        else f"or put its file (.der, .pem) into {trusted}"
    )
    raise untrusted("the server", der, None, f", {place}")


async def _issued(der: bytes, host: str, folder: Path) -> bool:
    """Whether an authority in the folder has issued the certificate, for this host, and it has not expired."""
    x509 = import_module("cryptography.x509")
    certificate = x509.load_der_x509_certificate(der)
    store = import_module("asyncua.crypto.truststore").TrustStore([folder], [])
    await store.load_trust()
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return False
    try:
        named = ipaddress.ip_address(host) in names.get_values_for_type(x509.IPAddress)
    except ValueError:
        named = host.lower() in {name.lower() for name in names.get_values_for_type(x509.DNSName)}
    return bool(named and store.is_trusted(certificate))


# --- MQTT over TLS


class _PinnedSocket(ssl.SSLSocket):
    """A TLS socket whose handshake fails unless the peer has the certificate that its context states."""

    def do_handshake(self, block: bool = False) -> None:
        super().do_handshake(block)
        context = self.context
        if isinstance(context, _PinnedContext) and fingerprint(self.getpeercert(binary_form=True) or b"") != context.pinned:
            self.close()
            raise ssl.SSLCertVerificationError("its certificate is another than server_certificate states")


class _PinnedContext(ssl.SSLContext):
    sslsocket_class = _PinnedSocket
    pinned: str


def tls_context(settings: Any) -> ssl.SSLContext:
    """The TLS settings of `Topics`; ValueError where its files are no certificates or keys."""
    for what in ("ca", "certificate", "key"):
        if (file := getattr(settings, what)) is not None and not Path(file).is_file():
            raise ValueError(f"there is no file of {what}, for TLS; make it, or name another one")
    if settings.server_certificate is None:
        context = ssl.create_default_context(cafile=settings.ca)
    else:
        context = _PinnedContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE  # the one certificate is compared instead
        context.pinned = stated_fingerprint(settings.server_certificate)
    if settings.certificate is not None:
        try:
            context.load_cert_chain(settings.certificate, settings.key, settings.key_password or "")
        except ssl.SSLError as error:
            raise ValueError(
                "certificate or key cannot be read; expected .pem files that belong together, and key_password_file or "
                "key_password_variable for a key that is encrypted"
            ) from error
    return context


def require_known_broker(host: str, port: int, context: ssl.SSLContext, timeout: float) -> None:
    """Raise UntrustedError where the certificate of a broker is not known; nothing where it cannot be reached."""
    try:
        with socket.create_connection((host, port), timeout) as plain, context.wrap_socket(plain, server_hostname=host):
            pass
    except ssl.SSLCertVerificationError as error:
        pinned = context.pinned if isinstance(context, _PinnedContext) else None
        der = _presented(host, port, timeout)
        reason = f" ({error.verify_message})" if getattr(error, "verify_message", "") else ""
        raise untrusted(f"the broker{reason}", der, pinned, ", or the file of its authority as ca") from error
    except OSError:
        pass


def _presented(host: str, port: int, timeout: float) -> bytes:
    """The certificate that a server presents."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    with socket.create_connection((host, port), timeout) as plain, context.wrap_socket(plain, server_hostname=host) as tls:
        return tls.getpeercert(binary_form=True) or b""


# --- what libraries log


class _Remarks(logging.Handler):
    """Says each kind of warning of a library once, in a line without a traceback."""

    def __init__(self, say: Callable[[str], None]) -> None:
        super().__init__(logging.WARNING)
        self.say, self.kinds = say, set[tuple[str, str]]()

    def emit(self, record: logging.LogRecord) -> None:
        kind = (record.name, str(record.msg))
        if kind in self.kinds:
            return
        self.kinds.add(kind)
        error = record.exc_info[1] if isinstance(record.exc_info, tuple) else None
        reason = f": {type(error).__name__} {error}" if error is not None else ""
        self.say(" ".join(f"{record.name.partition('.')[0]}: {record.getMessage()}{reason} (said once)".split()))


@contextmanager
def remarked_logs(names: Collection[str], say: Callable[[str], None]) -> Iterator[None]:
    """Say what the loggers of these names warn of meanwhile, each kind once, instead of writing it with tracebacks."""
    handler, loggers = _Remarks(say), [logging.getLogger(name) for name in names]
    before = [logger.propagate for logger in loggers]
    for logger in loggers:
        logger.addHandler(handler)
        logger.propagate = False
    try:
        yield
    finally:
        for logger, propagate in zip(loggers, before, strict=True):
            logger.removeHandler(handler)
            logger.propagate = propagate
