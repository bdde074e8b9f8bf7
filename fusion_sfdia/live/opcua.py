"""A watch on an OPC UA server: nodes are read as rows, and verdicts are written to nodes."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from datetime import UTC, datetime
from importlib import import_module
from typing import Any

import numpy as np

from fusion_sfdia.common.arguments import shown
from fusion_sfdia.common.errors import MissingPackageError
from fusion_sfdia.diagnosis.watch import Sample
from fusion_sfdia.live.address_tables import units_of
from fusion_sfdia.live.lines import health_results, results
from fusion_sfdia.live.nodes import Nodes
from fusion_sfdia.live.saving import SavedWatch
from fusion_sfdia.live.security import EXAMPLE, SCHEMES, UntrustedError, address, require_encrypted, secure
from fusion_sfdia.live.status import Report, Status
from fusion_sfdia.live.values import TimedValue, Values
from fusion_sfdia.plant.plant import Plant

FIRST_YEAR = 1970  # of time stamps; OPC UA counts from 1601, which stands for none


def asyncua() -> Any:
    """The package; MissingPackageError where it is not installed."""
    try:
        return import_module("asyncua")
    except ModuleNotFoundError as error:
        raise MissingPackageError("a watch on OPC UA needs asyncua; install it: pip install 'fusion-sfdia[opcua]'") from error


async def watch_server(saved: SavedWatch, url: str, nodes: Nodes, *, allow_plain_password: bool = False) -> None:
    """Watch the nodes of a server until cancelled, and connect again whenever the connection is lost.

    All nodes are read at once, every `nodes.period`. The time of a row is the newest source time stamp among its nodes; without
    a newer one there is no row. A time stamp that is too far from the clock of this computer counts for nothing, see `Values`.
    A reading of bad quality is missing, as is one of uncertain quality, or stale, where `nodes` states so. What happened while
    there was no connection is a gap. UntrustedError where the server's certificate is not known at the start; later that counts
    as no connection. ValueError for a password without encryption, unless that is allowed.
    """
    encrypted = nodes.security is not None and ",SignAndEncrypt," in nodes.security
    cure = f"state security = {EXAMPLE}"
    require_encrypted(nodes.password is not None, encrypted, allow_plain_password, cure)
    bridge, is_up, ever = OpcuaBridge(saved, url, nodes), True, False
    while True:
        client = None
        try:
            client = await connected(url, nodes)
            if not is_up:
                saved.watch.refused(f"{url}: connected again")
            is_up = ever = True
            await bridge.rows(client)
        except (OSError, TimeoutError, asyncua().ua.UaError, UntrustedError) as error:
            if isinstance(error, UntrustedError) and not ever:
                raise
            if is_up:
                remark = " ".join(str(error).split()) or type(error).__name__
                saved.watch.refused(f"{url}: no connection ({remark}); tried again every {nodes.retry:g} s")
            is_up = False
        finally:
            if client is not None:
                await client.disconnect()
        await asyncio.sleep(nodes.retry)


class OpcuaBridge:
    """Between the nodes of a server and a watch."""

    def __init__(
        self, saved: SavedWatch, url: str, nodes: Nodes, now: Callable[[], datetime] = lambda: datetime.now(UTC)
    ) -> None:
        self.ua, self.saved, self.url, self.nodes, self.now = asyncua().ua, saved, url, nodes, now
        self.plant: Plant = saved.watch.detector.plant
        self.period, sources = nodes.period or self.plant.dt, nodes.sources
        saved.watch.unread.update({*self.plant.sensor_names} - {*sources})
        where = {name: f"node {source.node}" for name, source in sources.items()}
        self.values = Values(saved.watch, nodes.stale, nodes.max_lead, nodes.max_lag, delay=self.period, sources=where)
        self.names = self.values.names
        self.read = [(i, self._id(sources[name].node)) for i, name in enumerate(self.names) if name in sources]
        units = units_of(self.plant)
        self.readers = {name: nodes.reader(name, units[name]) for name in sources}
        self.stamps: dict[str, datetime | None] = {}  # of the last values
        self.reports: deque[Report] = deque(maxlen=1)  # that are to be written
        self.status = saved.status = saved.status or Status(saved.watch)
        self.status.listeners.append(self.reports.append)

    def _id(self, text: str) -> Any:
        try:
            return self.ua.NodeId.from_string(text)
        except self.ua.UaError as error:
            raise ValueError(f"{text!r} is not the id of a node ({error}); expected one such as 'ns=2;s=TT-101.PV'") from error

    async def rows(self, client: Any) -> None:
        """Read and diagnose one row after another; returns with an error of the connection."""
        checked = False
        self.reports.append(self.status.report())  # a server that was started anew does not know
        while True:
            found = await client.uaclient.read_attributes([node for _, node in self.read], self.ua.AttributeIds.Value)
            if not checked:
                self.check(found)
                checked = True
            if (row := self.row(found, self.now())) is not None:
                for sample in self.saved.update(*row):
                    await self._write(client, sample)
            await self._report(client)
            await asyncio.sleep(self.period)

    def check(self, found: list[Any]) -> None:
        """Remark on nodes that have never a value, such as one that the server does not know."""
        for (i, _), value in zip(self.read, found, strict=True):
            if value.StatusCode is not None and value.StatusCode.name.startswith(
                ("BadNodeId", "BadNotReadable", "BadUserAccess")
            ):
                name = self.names[i]
                self.saved.watch.refused(
                    f"{name}: its node {self.nodes.sources[name].node} has no value ({value.StatusCode.name})"
                )
        if not any(v.SourceTimestamp or v.ServerTimestamp for v in found):
            self.saved.watch.refused("no node has a time stamp: there are no rows")

    def row(self, found: list[Any], arrived: datetime) -> tuple[datetime, Any, Any] | None:
        """The row of data values that were read at `arrived`, as `Values.row`; None without a new time stamp."""
        values = {
            self.names[i]: self._value(self.names[i], value, arrived) for (i, _), value in zip(self.read, found, strict=True)
        }
        self.stamps = {name: value.stamp for name, value in values.items()}
        if not any(value.has_time for value in values.values()):
            return None
        # those with a time first, as they tell the time of the others
        checked = {
            name: self.values.checked(name, values[name]) for name in sorted(values, key=lambda n: not values[n].has_time)
        }
        return self.values.row({name: value for name, value in checked.items() if value is not None})

    def _value(self, name: str, found: Any, arrived: datetime) -> TimedValue:
        """What an OPC UA data value states; its quality decides whether it counts, and its source time where it is new."""
        number, fault = np.nan, ""
        if self._counts(found.StatusCode) and found.Value is not None:
            number, fault = self.readers[name](found.Value.Value)
        if fault:
            fault = f"node {self.nodes.sources[name].node}: value {shown(found.Value.Value)}: {fault}"
        stamp = _aware(found.SourceTimestamp or found.ServerTimestamp)
        if stamp is None or stamp.year < FIRST_YEAR:
            return TimedValue(number, arrived, arrived, has_time=False, fault=fault)
        retained = name not in self.stamps or self.stamps[name] == stamp
        return TimedValue(number, stamp, arrived, retained=retained, fault=fault)

    def _counts(self, status: Any) -> bool:
        return status is None or status.is_good() or (self.nodes.uncertain == "use" and status.is_uncertain())

    async def _write(self, client: Any, sample: Sample) -> None:
        """Write what is asked for of a sample. What is not known is of bad quality."""
        found = results(self.saved.watch.detector, sample, self.nodes.write)
        await self._put(client, [(node, self._written(value)) for node, value in found])

    async def _report(self, client: Any) -> None:
        """Write the verdict of the moment and the health of sensors to the nodes for them, as often as they are reported."""
        if not self.reports:
            return
        report, ua = self.reports.pop(), self.ua
        found = [(node, ua.Variant(int(h), ua.VariantType.Int32)) for node, h in health_results(report, self.nodes.write)]
        if self.nodes.status is not None:
            found.append((self.nodes.status, ua.Variant(report.conclusion.text)))
        await self._put(client, [(node, ua.DataValue(value)) for node, value in found])

    async def _put(self, client: Any, found: list[tuple[str, Any]]) -> None:
        """Write data values to nodes; those that refuse theirs are reported."""
        if not found:
            return
        ids, data = [self._id(node) for node, _ in found], [value for _, value in found]
        for (node, _), status in zip(found, await client.uaclient.write_attributes(ids, data), strict=True):
            if not status.is_good():
                self.saved.watch.refused(f"node {node} does not take its value: {status.name}")

    def _written(self, value: float | str | bool | None) -> Any:
        """A data value, of bad quality where it is not known (NaN, or None of an alarm), and then with a value of its type."""
        known = value is not None and value == value
        status = self.ua.StatusCodes.Good if known else self.ua.StatusCodes.BadNoData
        return self.ua.DataValue(self.ua.Variant(False if value is None else value), self.ua.StatusCode(status))


async def connected(url: str, nodes: Nodes) -> Any:
    """A client that is connected as the nodes state."""
    _, host, _ = address("--opcua", url, SCHEMES["opcua"])
    client = asyncua().Client(url, timeout=nodes.timeout)
    if nodes.user is not None:
        client.set_user(nodes.user)
    if nodes.password is not None:
        client.set_password(nodes.password)
    if nodes.security is not None:
        await secure(client, host, nodes)
    await client.connect()
    return client


def _aware(stamp: datetime | None) -> datetime | None:
    """OPC UA has times in UTC; asyncua gives them without a zone."""
    return stamp if stamp is None or stamp.tzinfo is not None else stamp.replace(tzinfo=UTC)
