"""Whether a watch is at work and what it sees: one report for a line, a topic, a node and a monitoring system."""

from __future__ import annotations

import json
import socket
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from ipaddress import ip_address
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import numpy as np

from fusion_sfdia.common.files import explained
from fusion_sfdia.common.rate import lasting
from fusion_sfdia.detectors.verdicts import Conclusion, Verdict
from fusion_sfdia.diagnosis.device_health import DeviceHealth
from fusion_sfdia.diagnosis.watch import Sample, Watch

RECENT = 100  # rows over which the share of missing readings is taken
LAST = 1.0  # s at the end for a heartbeat that is under way
PATIENCE = 30.0  # s for which a request may be under way
SILENT = 10.0  # steps of the plant without a row, after which a watch is blind


class Report(NamedTuple):
    """The verdict with its reason at a moment, blind where no row has come for long.

    last_row: time of the last row, "" before the first. rows: diagnosed in this process. missing: share of the readings of the
    last `RECENT` rows. lag: seconds by which the last row came after its own time, NaN where that has no zone. age: seconds
    since it came, NaN before the first. stamp: of the last row, s since 1970, NaN where that is not known. remarks: so far.
    device_health: of each sensor by its name the state by NAMUR NE 107.
    """

    conclusion: Conclusion
    last_row: str
    rows: int
    missing: float
    lag: float
    age: float
    stamp: float
    remarks: int
    device_health: dict[str, DeviceHealth]

    @property
    def line(self) -> str:
        """For people: "healthy; last row 2026-03-01 14:00:00+00:00, 360 rows, 1.2 % of readings missing, lag 0.4 s"."""
        lag = f", lag {lasting(self.lag)}" if self.lag == self.lag else ""
        last = f"last row {self.last_row}" if self.last_row else "no row"
        return f"{self.conclusion.text}; {last}, {self.rows} rows, {100 * self.missing:.3g} % of readings missing{lag}"

    @property
    def json(self) -> str:
        """For programs: {"status": "watching", "state": "healthy", ...}; numbers that are not known are null."""
        verdict, reason = self.conclusion
        found = {"status": "watching", "state": str(verdict), "reason": reason, "last_row": self.last_row or None}
        numbers = {"rows": self.rows, "missing": self.missing, "lag": self.lag, "age": self.age, "remarks": self.remarks}
        known = {name: value if value == value else None for name, value in numbers.items()}
        health = {name: state.name for name, state in self.device_health.items()}
        return json.dumps(found | known | {"device_health": health}, ensure_ascii=False)

    @property
    def metrics(self) -> str:
        """The text of Prometheus' exposition format, version 0.0.4."""
        found = []
        for name, kind, about, value in (
            ("rows_total", "counter", "Rows diagnosed.", self.rows),
            ("remarks_total", "counter", "Remarks on rows and values that were not taken.", self.remarks),
            ("missing_ratio", "gauge", f"Share of readings missing in the last {RECENT} rows.", self.missing),
            ("lag_seconds", "gauge", "Arrival of the last row after its own time.", self.lag),
            ("last_row_age_seconds", "gauge", "Time since the last row arrived.", self.age),
            ("last_row_timestamp_seconds", "gauge", "Time of the last row since 1970.", self.stamp),
        ):
            text = "NaN" if value != value else repr(value)
            found += [
                f"# HELP fusion_sfdia_{name} {about}",
                f"# TYPE fusion_sfdia_{name} {kind}",
                f"fusion_sfdia_{name} {text}",
            ]
        found += ["# HELP fusion_sfdia_state 1 for the present verdict.", "# TYPE fusion_sfdia_state gauge"]
        found += [f'fusion_sfdia_state{{state="{v}"}} {int(v is self.conclusion.verdict)}' for v in Verdict]
        about = ", ".join(f"{state.value} {state.name}" for state in DeviceHealth)
        found += [f"# HELP fusion_sfdia_device_health Of a sensor, by NAMUR NE 107: {about}."]
        found += ["# TYPE fusion_sfdia_device_health gauge"]
        found += [
            f"fusion_sfdia_device_health{{sensor={json.dumps(s, ensure_ascii=False)}}} {h:d}"
            for s, h in self.device_health.items()
        ]
        return "\n".join([*found, ""])


class Status:
    """The reports of a watch, which any thread may ask for.

    remarks: the number of remarks so far. silent: seconds without a row after which the watch is blind, by default `SILENT`
    steps of the plant. now: the present time. Listeners are called with each report that `beat` makes, and with one for a row
    that changes the verdict or the health of a sensor.
    """

    def __init__(
        self,
        watch: Watch,
        *,
        remarks: Callable[[], int] = lambda: 0,
        silent: float | None = None,
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
    ) -> None:
        self.watch, self.remarks, self.now = watch, remarks, now
        self.silent = SILENT * watch.detector.plant.dt if silent is None else silent
        self.listeners: list[Callable[[Report], object]] = []
        self.lock = threading.Lock()  # of all that follows
        self.rows, self.last, self.began = 0, "", now()
        self.arrived: datetime | None = None
        self.conclusion = Conclusion(Verdict.BLIND, "no row was judged yet")
        self.blind = (DeviceHealth.CHECK_FUNCTION,) * len(watch.detector.plant.sensors)
        self.health = self.blind
        self.missing: deque[float] = deque(maxlen=RECENT)
        self.lag = self.stamp = np.nan

    def taken(self, samples: tuple[Sample, ...]) -> None:
        """Rows that were diagnosed."""
        if not samples:
            return
        with self.lock:
            before = self._stands(self._waited())
            self.arrived, clock, sample = self.now(), self.watch.clock, samples[-1]
            self.conclusion, self.health, self.last = sample.conclusion, sample.device_health, clock.at(sample.t)
            self.rows += len(samples)
            self.missing.extend(float(np.mean(np.isnan(s.y))) for s in samples)
            if clock.start is not None and clock.start.tzinfo is not None:
                self.stamp = clock.start.timestamp() + sample.t
                self.lag = self.arrived.timestamp() - self.stamp
        if (self.conclusion.verdict, self.health) != (before[0].verdict, before[1]):
            self.beat()

    def report(self) -> Report:
        """The report of this moment."""
        remarks = self.remarks()
        with self.lock:
            waited = self._waited()
            known, health = self._stands(waited)
            age = np.nan if self.arrived is None else waited
            share = float(np.mean(self.missing)) if self.missing else 0.0
            of_sensors = dict(zip(self.watch.detector.plant.sensor_names, health, strict=True))
            return Report(known, self.last, self.rows, share, self.lag, age, self.stamp, remarks, of_sensors)

    def _waited(self) -> float:
        """Seconds since the last row, or since the beginning."""
        return (self.now() - (self.arrived or self.began)).total_seconds()

    def _stands(self, waited: float) -> tuple[Conclusion, tuple[DeviceHealth, ...]]:
        """The conclusion and the health of sensors that count after so many seconds without a row."""
        if waited > self.silent:
            return Conclusion(Verdict.BLIND, f"no row for {waited:.0f} s"), self.blind
        return self.conclusion, self.health

    def beat(self) -> None:
        """Report to all listeners."""
        report = self.report()
        for listener in self.listeners:
            listener(report)


@contextmanager
def beating(every: float, beat: Callable[[], object]) -> Iterator[None]:
    """Within the block, call `beat` in another thread every so many seconds; 0: never."""
    ended = threading.Event()

    def run() -> None:
        while not ended.wait(every):
            beat()

    thread = threading.Thread(target=run, daemon=True)
    if every:
        thread.start()
    try:
        yield
    finally:
        ended.set()
        if every:
            thread.join(LAST)


class Answer(NamedTuple):
    """What a server sends: type and text of the content, and further headers."""

    kind: str
    text: str
    headers: Mapping[str, str] = {}


def metrics_at(status: Status) -> Callable[[str], Answer | None]:
    """The answers for Prometheus, by their paths."""

    def answer(path: str) -> Answer | None:
        found = path in ("/", "/metrics")
        return Answer("text/plain; version=0.0.4; charset=utf-8", status.report().metrics) if found else None

    return answer


@contextmanager
def served(option: str, host: str, port: int, answer: Callable[[str], Answer | None]) -> Iterator[int]:
    """Within the block, a server at this address gives the answer for each path, 404 for None; the port, of 0 a free one.

    ValueError, which names the option, where the address cannot be had. On an address of this machine alone only requests
    that name it are answered: a page of another site cannot read it under a name of its own.
    """

    class Handler(BaseHTTPRequestHandler):
        timeout = PATIENCE

        def do_GET(self) -> None:
            try:
                named = urlsplit(f"//{self.headers.get('Host', '')}").hostname or ""
            except ValueError:
                named = ""
            known = _is_here(named) or not _is_here(host)
            found = answer(self.path.partition("?")[0]) if known else None
            kind, text, headers = found or Answer("text/plain; charset=utf-8", "there is nothing at this address\n")
            body = text.encode()
            self.send_response(404 if found is None else 200)
            for name, value in {"Content-Type": kind, "Content-Length": str(len(body)), **headers}.items():
                self.send_header(name, value)
            with suppress(ConnectionError, TimeoutError):  # the browser has gone
                self.end_headers()
                self.wfile.write(body)

        def log_message(self, format: str, *arguments: Any) -> None:
            """Requests are no remarks."""

    class Server(ThreadingHTTPServer):
        address_family = socket.AF_INET6 if ":" in host else socket.AF_INET

    try:
        server = Server((host, port), Handler)
    except OSError as error:
        raise ValueError(
            f"--{option}: {host}:{port} cannot be served ({explained(error)}); name another port, or end what uses it"
        ) from error
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True)
    thread.start()
    try:
        yield int(server.server_address[1])
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def _is_here(host: str) -> bool:
    """Whether it is an address of this machine alone."""
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False


def endpoint(text: str) -> tuple[str, int]:
    """Host and port of "9101", which is of this machine alone, "HOST:9101" or "[::1]:9101"; ValueError for anything else."""
    host, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdigit()) or int(port) > 65535 or (":" in host and not host.startswith("[")):
        raise ValueError(f"--metrics is {text!r}; expected a port, such as 9101, or HOST:PORT")
    return host.strip("[]") or "127.0.0.1", int(port)
