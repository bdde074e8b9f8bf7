"""An OPC UA server with the two tanks, as a process: `python opcua_plant.py PORT ROWS.npz FIRST`.

Each request that reads the first node moves on by one row, from row FIRST on; the last row stays. It prints "ready" when it
takes connections, and at the end of its input what was written to it last, null where its quality is bad.
"""

from __future__ import annotations

import asyncio
import json
import sys
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
from asyncua import Server, ua

START = datetime(2026, 3, 1, 14, 0)  # UTC, as OPC UA has it
NAMES = ("l1", "l2", "q12", "q2", "inflow")
OUTPUTS: dict[str, Any] = {"l1.value": 0.0, "l1.sigma": 0.0, "l1.verdict": "", "verdict": "", "alarm": False, "watch": ""}
OUTPUTS |= {"l1.health": ua.Variant(0, ua.VariantType.Int32)}
QUALITY = {0: ua.StatusCodes.Good, 1: ua.StatusCodes.UncertainSensorNotAccurate, 2: ua.StatusCodes.BadSensorFailure}


class Rows:
    """The row that is shown, counted on by the first node."""

    def __init__(self, path: str, first: int) -> None:
        with np.load(path) as file:
            self.t, self.values, self.quality = file["t"], file["values"], file["quality"]
        self.k = first - 1

    def shown(self, i: int, node: Any, attribute: Any) -> Any:
        if i == 0:
            self.k = min(self.k + 1, self.t.size - 1)
        stamp = (START.replace(tzinfo=UTC) + timedelta(seconds=float(self.t[self.k]))).replace(tzinfo=None)
        status = ua.StatusCode(QUALITY[int(self.quality[self.k, i])])
        value = ua.Variant(float(self.values[self.k, i]), ua.VariantType.Double)
        return ua.DataValue(Value=value, StatusCode=status, SourceTimestamp=stamp)


async def serve(port: int, path: str, first: int) -> None:
    server = Server()
    await server.init()
    server.set_endpoint(f"opc.tcp://127.0.0.1:{port}/")
    space = await server.register_namespace("tanks")
    rows = Rows(path, first)
    for i, name in enumerate(NAMES):
        node = await server.nodes.objects.add_variable(ua.NodeId(name, space), name, 0.0)
        server.set_attribute_value_callback(node.nodeid, lambda n, a, i=i: rows.shown(i, n, a))
    for name, value in OUTPUTS.items():
        node = await server.nodes.objects.add_variable(ua.NodeId(name, space), name, value)
        await node.set_writable()
    async with server:
        print("ready", flush=True)
        await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)  # until the test closes it
        written = {}
        for name in OUTPUTS:
            last = await server.get_node(ua.NodeId(name, space)).read_data_value(raise_on_bad_status=False)
            written[name] = last.Value.Value if last.StatusCode.is_good() else None
        print(json.dumps(written), flush=True)


if __name__ == "__main__":
    asyncio.run(serve(int(sys.argv[1]), sys.argv[2], int(sys.argv[3])))
