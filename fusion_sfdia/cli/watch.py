"""The command `watch`: diagnoses rows as they arrive, from standard input, an OPC UA server or an MQTT broker."""

from __future__ import annotations

import argparse
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from datetime import UTC, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fusion_sfdia.cli.options import (
    OR_TUNED,
    add_columns,
    add_detector,
    add_kept_monitor,
    add_plant,
    add_tuned,
    columns,
    kept_monitor,
)
from fusion_sfdia.common.numerals import decimal, integer

if TYPE_CHECKING:
    from fusion_sfdia.live.left_out_lines import Remarks
    from fusion_sfdia.live.page import LivePage
    from fusion_sfdia.live.saving import SavedWatch
    from fusion_sfdia.live.status import Status
    from fusion_sfdia.live.webhook import Webhook
    from fusion_sfdia.logs.log_map import LogMap

LONGEST_LINE = 1_000_000  # bytes; a longer one is refused whole


def add_watch(commands: Any) -> None:
    """Add `watch`."""
    one = commands.add_parser(
        "watch",
        help="diagnose rows as they arrive, from standard input, an OPC UA server or an MQTT broker",
        epilog="Rows come from standard input, as CSV with a header or as JSON lines; events go to standard output, a JSON "
        "line each, in the units of the plant. Rows that are late or malformed are skipped and reported. A watch that was "
        "killed goes on from --state: give the rows since then again, or all; events that it had written come again as the "
        "same lines.",
        allow_abbrev=False,
    )
    add_plant(one)
    add_detector(one, OR_TUNED)
    add_tuned(one)
    add_kept_monitor(one)
    one.add_argument("--map", type=Path, metavar="MAP.toml", help="how rows are written: columns, units, bad texts")
    one.add_argument("--opcua", metavar="URL", help="read the rows from an OPC UA server, such as opc.tcp://host:4840")
    one.add_argument("--nodes", type=Path, metavar="NODES.toml", help="which nodes are read and written, with --opcua")
    one.add_argument("--mqtt", metavar="URL", help="read the rows from an MQTT broker: mqtt://host:1883, or mqtts:// for TLS")
    one.add_argument("--topics", type=Path, metavar="TOPICS.toml", help="which topics are read and written, with --mqtt")
    one.add_argument(
        "--allow-plain-password",
        action="store_true",
        help="send a password or token although the connection is not encrypted",
    )
    one.add_argument("--state", type=Path, metavar="FILE", help="where the state is saved, and taken up if the file is there")
    one.add_argument("--save-every", type=integer, default=1000, metavar="N", help="rows between two saves (default: 1000)")
    one.add_argument("--samples", action="store_true", help="also a line for each row: verdict and validated readings")
    one.add_argument(
        "--hold", type=decimal, metavar="S", help="seconds for which a missing input keeps its value (default: the map's, or 0)"
    )
    one.add_argument(
        "--longest-gap",
        type=decimal,
        metavar="S",
        help="pause after which the detector starts anew (default: 10 000 steps of the plant)",
    )
    one.add_argument(
        "--reorder",
        type=decimal,
        default=0.0,
        metavar="S",
        help="seconds for which rows are held to put them in order; all are diagnosed that much later (default: 0)",
    )
    one.add_argument("--no-kinds", action="store_true", help="do not name kinds of faults nor test the model, which takes time")
    one.add_argument(
        "--status-every",
        type=decimal,
        default=60.0,
        metavar="S",
        help="seconds between two status lines on standard error, topic and node; 0: none, and topics and nodes then do not "
        "show that rows have stopped (default: 60)",
    )
    one.add_argument(
        "--silent-after",
        type=decimal,
        metavar="S",
        help="seconds without a row after which the status is blind (default: 10 steps of the plant)",
    )
    one.add_argument("--webhook", metavar="URL", help="post the line of each change to this address, http:// or https://")
    one.add_argument("--webhook-token", metavar="VARIABLE", help="environment variable with the token of --webhook")
    one.add_argument(
        "--alarms", metavar="URL", help="serve alarms and health of sensors over OPC UA there, such as opc.tcp://127.0.0.1:4841"
    )
    one.add_argument("--metrics", metavar="HOST:PORT", help="serve the status to Prometheus; a port alone: on this machine")
    one.add_argument(
        "--page", type=integer, metavar="PORT", help="show state, findings and figures to a browser on this machine"
    )
    one.add_argument("--page-hours", type=decimal, metavar="H", help="hours that --page goes back, of the rows (default: 4)")
    add_columns(one, "where they are missing")
    one.set_defaults(work=_watch)


def _watch(chosen: argparse.Namespace) -> int:
    from fusion_sfdia.cli.signals import ended_in_time
    from fusion_sfdia.common.files import locked_file
    from fusion_sfdia.live.left_out_lines import Remarks

    refused = Remarks(_say)
    if chosen.state is not None and not chosen.state.absolute().parent.is_dir():
        raise ValueError(f"--state {chosen.state}: there is no folder {chosen.state.parent}; make it, or name another file")
    _require_page(chosen)
    with (
        _webhook(chosen, refused) as webhook,  # the outermost: at its end it takes some seconds for what is not yet posted
        ended_in_time(chosen.interruption),
        nullcontext() if chosen.state is None else locked_file(chosen.state),
    ):
        return _watched(chosen, webhook, refused)


def _webhook(chosen: argparse.Namespace, refused: Remarks) -> AbstractContextManager[Webhook | None]:
    from fusion_sfdia.live.webhook import Webhook

    token = None
    if (variable := chosen.webhook_token) is not None:
        if chosen.webhook is None:
            raise ValueError("--webhook-token needs --webhook, to which the token is sent; give both or neither")
        if not (token := os.environ.get(variable)):
            raise ValueError(
                "--webhook-token names no variable of the environment; give the variable's name, and set it to the token"
            )
    if chosen.webhook is None:
        return nullcontext()
    return Webhook(chosen.webhook, refused, token=token, allow_plain=chosen.allow_plain_password)


def _watched(chosen: argparse.Namespace, webhook: Webhook | None, refused: Remarks) -> int:
    from fusion_sfdia.cli.tune import bound_detector
    from fusion_sfdia.diagnosis.watch import Watch
    from fusion_sfdia.live.saving import SavedWatch
    from fusion_sfdia.live.security import SCHEMES, address, remarked_logs
    from fusion_sfdia.live.status import Status, beating, endpoint, metrics_at, served
    from fusion_sfdia.logs.log_map import AT_THE_SAMPLE, PLAIN_MAP, load_map

    for option, seconds in (("status-every", chosen.status_every), ("silent-after", chosen.silent_after)):
        if seconds is not None and not 0 <= seconds < threading.TIMEOUT_MAX:
            raise ValueError(f"--{option} is {seconds}; expected a number of seconds, at least 0")
    at = None if chosen.metrics is None else endpoint(chosen.metrics)
    if chosen.save_every < 1:
        raise ValueError(f"--save-every is {chosen.save_every}; expected at least 1 row")
    for one, other in (("opcua", "nodes"), ("mqtt", "topics")):
        if (getattr(chosen, one) is None) != (getattr(chosen, other) is None) or (getattr(chosen, one) and chosen.map):
            raise ValueError(f"--{one} needs --{other}, which states what a --map states of text; give both or neither")
    if chosen.opcua and chosen.mqtt:
        raise ValueError("--opcua and --mqtt both state where the rows come from; give one")
    for option, kind in (("opcua", "opcua"), ("mqtt", "mqtt"), ("alarms", "opcua")):  # before anything that takes time
        if (url := getattr(chosen, option)) is not None:
            address(f"--{option}", url, SCHEMES[kind])
    log_map = load_map(chosen.map) if chosen.map else PLAIN_MAP
    settings = {"reorder": chosen.reorder, "keep_last": log_map.duplicates == "last", "refused": refused}
    if chosen.longest_gap is not None:
        settings["longest_gap"] = chosen.longest_gap
    state = chosen.state if chosen.state is not None and chosen.state.exists() else None
    if chosen.monitor is not None:
        watch = kept_monitor(chosen).stream(state, **settings)
    else:
        _, bound = bound_detector(chosen.plant, chosen.detector, chosen.tuned)
        settings |= {
            "hold": log_map.hold if chosen.hold is None else chosen.hold,
            "nominal_inputs": chosen.nominal_inputs,
            "at_sample": log_map.inputs == AT_THE_SAMPLE or bool(chosen.opcua or chosen.mqtt),
            "kinds": not chosen.no_kinds,
        }
        watch = Watch(bound, **settings) if state is None else Watch.load(state, bound, **settings)
    if state is not None:
        _say(f"{state}: goes on after {watch.clock.at(watch.t or 0.0)}")
    status = Status(watch, remarks=lambda: refused.count, silent=chosen.silent_after)
    saved = SavedWatch(
        watch, _write, chosen.state, chosen.save_every, chosen.samples, status=status, undivided=chosen.interruption.deferred
    )
    if webhook is not None:
        saved.outlets.append(lambda change, line: webhook.post(line))
    chosen.interruption.save = saved.save

    def beat() -> None:
        _say(f"status: {status.report().line}")
        status.beat()

    try:
        with (
            remarked_logs(("asyncua", "asyncuagds"), refused),
            _alarms(chosen, saved),
            beating(chosen.status_every, beat),
            nullcontext() if at is None else served("metrics", *at, metrics_at(status)),
            _page(chosen, saved, status) as page,
        ):
            if chosen.opcua:
                _server(chosen, saved, page)
            elif chosen.mqtt:
                _broker(chosen, saved, page)
            else:
                _text(chosen, saved, log_map, page)
    finally:
        chosen.interruption.acknowledge()
        saved.save()
        if refused.count:
            _say(f"{refused.count} remarks in all")
    return 0


def _alarms(chosen: argparse.Namespace, saved: SavedWatch) -> AbstractContextManager[object]:
    from fusion_sfdia.live.alarm_server import alarms_served

    return nullcontext() if chosen.alarms is None else alarms_served(chosen.alarms, saved)


def _require_page(chosen: argparse.Namespace) -> None:
    """ValueError for what --page and --page-hours cannot be."""
    if chosen.page is not None and not 0 <= chosen.page <= 65535:
        raise ValueError(f"--page is {chosen.page}; expected a port, such as 8080")
    hours = chosen.page_hours
    if hours is not None and not 0 < hours < float("inf"):
        raise ValueError(f"--page-hours is {hours:g}; expected a positive number of hours, such as 4")
    if hours is not None and chosen.page is None:
        raise ValueError(
            "--page-hours needs --page, the page that goes back so far; add --page 8080, or leave --page-hours out"
        )


@contextmanager
def _page(chosen: argparse.Namespace, saved: SavedWatch, status: Status) -> Iterator[LivePage | None]:
    """Within the block, the page of --page is there."""
    if chosen.page is None:
        yield None
        return
    from fusion_sfdia.live.page import HOURS, LivePage
    from fusion_sfdia.live.status import served

    page = LivePage(saved.watch, status, chosen.page_hours or HOURS)
    saved.takers.append(page.taken)
    saved.outlets.append(lambda change, line: page.changed(change))
    with served("page", "127.0.0.1", chosen.page, page.answer) as port:
        _say(f"page: http://127.0.0.1:{port}/")
        yield page


def _text(chosen: argparse.Namespace, saved: SavedWatch, log_map: LogMap, page: LivePage | None) -> None:
    from fusion_sfdia.live.text_rows import TextRows, lines

    watch = saved.watch
    allowed = columns(chosen) if chosen.monitor is None else {"other_columns": True, "absent_sensors": chosen.absent_sensors}
    rows = TextRows(watch.detector.plant, log_map, **allowed, refused=watch.refused)
    if watch.clock.start is not None and watch.t is not None:
        rows.last = watch.clock.start.astimezone(UTC) + timedelta(seconds=watch.t)
    for number, line in enumerate(lines(sys.stdin.buffer, LONGEST_LINE), start=1):
        try:
            if line is None:
                raise ValueError(f"it has more than {LONGEST_LINE} bytes; expected a row")
            row = rows.row(line.decode(log_map.encoding, errors="replace"), ended=line.endswith(b"\n"))
        except ValueError as error:
            if rows.reader is None:
                raise
            saved.watch.refused(f"line {number}: {error}; it is not taken")
            continue
        if page is not None and not page.shown_in.tags and rows.reader is not None:
            page.show_in(rows.reader.sources.columns)
        if row is not None:
            watch.unread.update(rows.absent)
            saved.update(*row)
    saved.finish()
    rows.end()


def _server(chosen: argparse.Namespace, saved: SavedWatch, page: LivePage | None) -> None:
    import asyncio

    from fusion_sfdia.live.nodes import load_nodes
    from fusion_sfdia.live.opcua import watch_server

    nodes = load_nodes(chosen.nodes, saved.watch.detector.plant)
    if page is not None:
        page.show_in(nodes.columns(saved.watch.detector.plant))
    asyncio.run(watch_server(saved, chosen.opcua, nodes, allow_plain_password=chosen.allow_plain_password))


def _broker(chosen: argparse.Namespace, saved: SavedWatch, page: LivePage | None) -> None:
    from fusion_sfdia.live.mqtt import watch_broker
    from fusion_sfdia.live.topics import load_topics

    topics = load_topics(chosen.topics, saved.watch.detector.plant)
    if page is not None:
        page.show_in(topics.columns(saved.watch.detector.plant))
    watch_broker(saved, chosen.mqtt, topics, allow_plain_password=chosen.allow_plain_password)


def _write(line: str) -> None:
    print(line, flush=True)


def _say(line: str) -> None:
    print(f"fusion-sfdia: {line}", file=sys.stderr, flush=True)
