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
    bridge = Bridge(saved, url, nodes)
    connected = True
    while True:
        try:
            async with bridge.client() as client:
                await bridge.secure(client)
                async with client:
                    if not connected:
                        saved.watch.refused(f"{url}: connected again")
                    connected = True
                    await bridge.rows(client)
        except (OSError, TimeoutError, asyncio.IncompleteReadError, asyncua().ua.UaError) as error:
            if connected:
                remark = " ".join(str(error).split()) or type(error).__name__
                saved.watch.refused(f"{url}: no connection ({remark}); tried again every {nodes.retry:g} s")
            connected = False
            await asyncio.sleep(nodes.retry)
