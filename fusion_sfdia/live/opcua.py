"""A watch on an OPC UA server: nodes are read as rows, and verdicts are written to nodes."""

from __future__ import annotations

import asyncio
from datetime import UTC, datetime, timedelta
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.core.detector import MissingPackageError
from fusion_sfdia.core.plant import Plant
from fusion_sfdia.live.lines import sensor_verdicts, validated
from fusion_sfdia.live.nodes import Nodes
from fusion_sfdia.live.saving import SavedWatch
from fusion_sfdia.live.watch import Sample

Array = NDArray[Any]


def asyncua() -> Any:
    """The package; MissingPackageError where it is not installed."""
    try:
        return import_module("asyncua")
    except ModuleNotFoundError as error:
        raise MissingPackageError("a watch on OPC UA needs asyncua; install it: pip install 'fusion-sfdia[opcua]'") from error


async def watch_server(saved: SavedWatch, url: str, nodes: Nodes) -> None:
    """Watch the nodes of a server until cancelled, and connect again whenever the connection is lost.

    All nodes are read at once, every `nodes.period`. The time of a row is the newest source time stamp among its nodes; without
    a newer one there is no row. A reading of bad quality is missing, as is one of uncertain quality, or stale, where `nodes`
    states so. What happened while there was no connection is a gap.
    """
    bridge, is_up = Bridge(saved, url, nodes), True
    while True:
        client = None
        try:
            client = await connected(url, nodes)
            if not is_up:
                saved.watch.refused(f"{url}: connected again")
            is_up = True
            await bridge.rows(client)
        except (OSError, TimeoutError, asyncua().ua.UaError) as error:
            if is_up:
                remark = " ".join(str(error).split()) or type(error).__name__
                saved.watch.refused(f"{url}: no connection ({remark}); tried again every {nodes.retry:g} s")
            is_up = False
        finally:
            if client is not None:
                await client.disconnect()
        await asyncio.sleep(nodes.retry)


class Bridge:
    """Between the nodes of a server and a watch."""

    def __init__(self, saved: SavedWatch, url: str, nodes: Nodes) -> None:
        self.ua, self.saved, self.url, self.nodes = asyncua().ua, saved, url, nodes
        self.plant: Plant = saved.watch.detector.plant
        self.names = (*self.plant.sensor_names, *(s.name for s in self.plant.inputs))
        self.read = [(i, self._id(nodes.read[name])) for i, name in enumerate(self.names) if name in nodes.read]
        self.newest: datetime | None = None

    def _id(self, text: str) -> Any:
        try:
            return self.ua.NodeId.from_string(text)
        except self.ua.UaError as error:
            raise ValueError(f"{text!r} is not the id of a node ({error}); expected one such as 'ns=2;s=TT-101.PV'") from error

    async def rows(self, client: Any) -> None:
        """Read and diagnose one row after another; returns with an error of the connection."""
        period, checked = self.nodes.period or self.plant.dt, False
        while True:
            found = await client.uaclient.read_attributes([node for _, node in self.read], self.ua.AttributeIds.Value)
            if not checked:
                self.check(found)
                checked = True
            if (row := self._row(found)) is not None:
                for sample in self.saved.take(*row):
                    await self._write(client, sample)
            await asyncio.sleep(period)

    def check(self, found: list[Any]) -> None:
        """Remark on nodes that have never a value, such as one that the server does not know."""
        for (i, _), value in zip(self.read, found, strict=True):
            if value.StatusCode is not None and value.StatusCode.name.startswith(
                ("BadNodeId", "BadNotReadable", "BadUserAccess")
            ):
                name = self.names[i]
                self.saved.watch.refused(f"{name}: its node {self.nodes.read[name]} has no value ({value.StatusCode.name})")
        if not any(v.SourceTimestamp or v.ServerTimestamp for v in found):
            self.saved.watch.refused("no node has a time stamp: there are no rows")

    def _row(self, found: list[Any]) -> tuple[datetime, Array, Array] | None:
        """The time stamp, y (N,) and u (m,) of the values read; None where no node has a newer time stamp."""
        stamps = [_aware(v.SourceTimestamp or v.ServerTimestamp) for v in found]
        known = [s for s in stamps if s is not None]
        if not known or (self.newest is not None and max(known) <= self.newest):
            return None
        self.newest = newest = max(known)
        values = np.full(len(self.plant.sensors) + len(self.plant.inputs), np.nan)
        for (i, _), value, stamp in zip(self.read, found, stamps, strict=True):
            old = stamp is None or (newest - stamp).total_seconds() > (self.nodes.stale or np.inf)
            if not old and self._counts(value.StatusCode) and value.Value is not None:
                values[i] = _real(value.Value.Value)
        count = len(self.plant.sensors)
        return self.on_grid(newest), values[:count], values[count:]

    def _counts(self, status: Any) -> bool:
        return status is None or status.is_good() or (self.nodes.uncertain == "use" and status.is_uncertain())

    def on_grid(self, stamp: datetime) -> datetime:
        """The stamp, of a plant that holds for steps of dt only the nearest one a number of steps after the first."""
        start, dt = self.saved.watch.clock.start or stamp, self.plant.dt
        if not self.plant.numerics.fixed_dt:
            return stamp
        return start + timedelta(seconds=round((stamp - start).total_seconds() / dt) * dt)

    async def _write(self, client: Any, sample: Sample) -> None:
        """Write what is asked for of a sample; nodes that refuse it are reported."""
        value, sigma = validated(self.plant, sample)
        verdicts = sensor_verdicts(self.plant, sample.y, sample.decision)
        isolated = [h for h, i in zip(self.saved.watch.detector.hypotheses, sample.decision.isolated, strict=True) if i]
        found: dict[str, Any] = {"alarm": bool(sample.decision.alarm), "verdict": ", ".join(isolated) or "none isolated"}
        ids, values = [], []
        for name, where in self.nodes.write.items():
            if isinstance(where, str):
                ids.append(where)
                values.append(found[name])
            else:
                i = self.plant.sensor_index(name)
                of_sensor = {"value": float(value[i]), "sigma": float(sigma[i]), "verdict": verdicts[i]}
                ids += where.values()
                values += [of_sensor[what] for what in where]
        if not ids:
            return
        data = [self.ua.DataValue(self.ua.Variant(v)) for v in values]
        for node, status in zip(ids, await client.uaclient.write_attributes(list(map(self._id, ids)), data), strict=True):
            if not status.is_good():
                self.saved.watch.refused(f"node {node} does not take its value: {status.name}")


async def connected(url: str, nodes: Nodes) -> Any:
    """A client that is connected as the nodes state."""
    client = asyncua().Client(url, timeout=nodes.timeout)
    if nodes.user is not None:
        client.set_user(nodes.user)
    if nodes.password is not None:
        client.set_password(nodes.password)
    if nodes.security is not None:
        try:
            await client.set_security_string(nodes.security)
        except AttributeError as error:
            raise ValueError(
                f"security is {nodes.security!r}; expected Policy,Mode,certificate,key, such as "
                "'Basic256Sha256,SignAndEncrypt,own.pem,own.key'"
            ) from error
    await client.connect()
    return client


def _aware(stamp: datetime | None) -> datetime | None:
    """OPC UA has times in UTC; asyncua gives them without a zone."""
    return stamp if stamp is None or stamp.tzinfo is not None else stamp.replace(tzinfo=UTC)


def _real(value: Any) -> float:
    """A number as a float, anything else as missing."""
    return float(value) if isinstance(value, int | float | np.number) and np.isfinite(value) else np.nan
