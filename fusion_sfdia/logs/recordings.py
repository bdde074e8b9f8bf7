"""Recordings of measurement systems as tables: TDMS of LabVIEW with npTDMS (extra `tdms`), MDF with asammdf (extra `mdf`)."""

from __future__ import annotations

import logging
import warnings
from collections import Counter
from datetime import UTC, datetime
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fusion_sfdia.common.arguments import shown, some
from fusion_sfdia.common.errors import MissingPackageError
from fusion_sfdia.logs.kinds import TDMS
from fusion_sfdia.logs.loaded_log import Finding, counted
from fusion_sfdia.logs.log_map import LogMap

Array = NDArray[Any]


class Channel(NamedTuple):
    """A channel: its name, that of its group, unit, values (K,) and their times (K,), in s or as stamps in UTC; none: (0,)."""

    name: str
    group: str
    unit: str
    values: Array
    times: Array


def read_channels(where: str, file: IO[bytes], kind: str, log_map: LogMap) -> list[Channel]:
    """Return the channels of a TDMS or MDF file. MissingPackageError, ValueError for a damaged file."""
    package, extra, read = ("npTDMS", "tdms", _of_tdms) if kind == TDMS else ("asammdf", "mdf", _of_mdf)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return read(file, log_map)
    except ImportError as error:
        raise MissingPackageError(
            f"{where}: a {kind} file needs {package}, which is not installed; install fusion-sfdia[{extra}], or export as CSV"
        ) from error
    except Exception as error:  # both raise errors of many kinds for files that are damaged
        one = f"{'a' if kind == TDMS else 'an'} {kind} file"
        raise ValueError(
            f"{where} is {one} that {package} does not read ({shown(str(error))}); copy it again, or export as CSV"
        ) from error


def by_time(where: str, channels: list[Channel], log_map: LogMap) -> tuple[list[str], list[Array], list[str], list[Finding]]:
    """Return titles, columns, units and findings of channels, with a row for each time of any; the times come first.

    A channel is called group/channel where its name occurs twice. ValueError for a file without a channel with times.
    """
    timeless = [c.name for c in channels if not c.times.size]
    channels = [c for c in channels if c.times.size]
    if not channels:
        raise ValueError(f"{where} is a recording without a channel with times; export it as CSV with a column of times")
    stamped = {c.times.dtype.kind == "M" for c in channels}
    if len(stamped) > 1:
        raise ValueError(f"{where}: some channels have stamps and others seconds as times; export those of one kind")
    tracks: list[Array] = []
    of: list[int] = []
    for c in channels:
        if np.unique(c.times).size < c.times.size:
            raise ValueError(f"{where}: times of the channel {c.name!r} occur twice; export it as CSV, one value for each time")
        k = next((k for k, t in enumerate(tracks) if t is c.times or np.array_equal(t, c.times)), len(tracks))
        tracks += [c.times] if k == len(tracks) else []
        of.append(k)
    times = tracks[0] if len(tracks) == 1 else np.unique(np.concatenate(tracks))
    names = Counter(c.name for c in channels)
    columns = [times]
    for c in channels:
        if len(tracks) == 1:
            columns.append(c.values)
            continue
        texts = c.values.dtype.kind in "OU"
        column = np.full(times.size, "" if texts else np.nan, dtype=object if texts else float)
        column[np.searchsorted(times, c.times)] = c.values
        columns.append(column)
    findings = [Finding("file", "", len(channels), f"read {counted(len(channels), 'channel')}")]
    if timeless:
        findings.append(Finding("ignored", "", len(timeless), f"no times of the channels {some(timeless)}: not used"))
    if len(tracks) > 1:
        text = f"the channels have {len(tracks)} tracks of times: rows of the times of any; step in a map makes them common"
        findings.append(Finding("file", "", len(tracks), text))
    titles = [c.name if names[c.name] == 1 else f"{c.group}/{c.name}" for c in channels]
    return [log_map.time[0], *titles], columns, ["", *(c.unit for c in channels)], findings


def _of_tdms(file: IO[bytes], log_map: LogMap) -> list[Channel]:
    """Channels with a waveform's start and increment, or beside a channel of times in their group."""
    from nptdms import TdmsFile
    from nptdms.log import log_manager

    log_manager.set_level(logging.CRITICAL)  # what it warns of ends in an error here
    found = []
    for group in TdmsFile.read(file).groups():
        channels = {c.name: c for c in group.channels() if len(c)}
        own = next((n for n, c in channels.items() if n in log_map.time or np.asarray(c[:]).dtype.kind == "M"), "")
        shared = np.asarray(channels[own][:]) if own else None
        for name, channel in channels.items():
            values = np.asarray(channel[:])
            properties = channel.properties
            if name == own or values.dtype.kind not in "biufOU":
                continue
            if shared is not None and shared.size >= values.size:
                times = shared[: values.size]
            elif properties.get("wf_increment"):
                start = properties.get("wf_start_time")
                offset = float(properties.get("wf_start_offset", 0.0))
                times = offset + float(properties["wf_increment"]) * np.arange(values.size)
                times = times if start is None else _stamps(np.datetime64(start, "ns"), times)
            else:
                times = np.empty(0)
            unit = str(properties.get("unit_string") or properties.get("NI_UnitDescription") or "")
            found.append(Channel(name, group.name, unit, values, times))
    return found


def _of_mdf(file: IO[bytes], log_map: LogMap) -> list[Channel]:
    """Channels with the master of their group, in seconds since the start that the file states."""
    from asammdf import MDF

    file.seek(64)
    if not file.read(4).startswith((b"##HD", b"HD")):  # asammdf does not close a file that fails so early
        raise ValueError("no header behind the first bytes")
    file.seek(0)
    found = []
    with MDF(file) as mdf:
        start: datetime = mdf.header.start_time
        origin = np.datetime64(start.astimezone(UTC).replace(tzinfo=None), "ns") if start.year > 1980 else None
        for index, group in enumerate(mdf.groups):
            name = getattr(group.channel_group, "acq_name", "") or f"group {index}"
            track: Array | None = None
            for number, channel in enumerate(group.channels):
                signal = mdf.get(group=index, index=number)
                values, times = signal.samples, signal.timestamps
                if mdf.masters_db.get(index) == number or values.ndim != 1 or values.dtype.names or not values.size:
                    continue
                if values.dtype.kind == "S":
                    values = np.array([v.decode("utf-8", "replace") for v in values], dtype=object)
                if track is None:
                    track = times if origin is None else _stamps(origin, times)
                if values.dtype.kind in "biufOU":
                    found.append(Channel(channel.name, name, signal.unit or "", values, track))
    return found


def _stamps(origin: Any, seconds: Array) -> Array:
    found: Array = origin + np.round(seconds * 1e9).astype("timedelta64[ns]")
    return found
