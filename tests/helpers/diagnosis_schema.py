"""What `--json` prints, held against the schema of the package."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

from jsonschema import Draft202012Validator

import fusion_sfdia


@cache
def schema() -> dict[str, Any]:
    read: dict[str, Any] = json.loads((Path(fusion_sfdia.__file__).parent / "report" / "diagnosis.schema.json").read_text())
    Draft202012Validator.check_schema(read)
    return read


def require_described(text: str) -> dict[str, Any]:
    """The document of a diagnosis, which the schema holds for and describes every name of."""
    document: dict[str, Any] = json.loads(text)
    Draft202012Validator(schema()).validate(document)
    assert document.keys() == schema()["properties"].keys()
    of_events = schema()["$defs"]["event"]["properties"].keys() | {"start_row", "end_row", "passing", "in_log"}
    assert all(event.keys() <= of_events for event in document["events"])
    return document


def require_event(line: dict[str, Any]) -> None:
    """That a line of `watch` names what it found as the events of a diagnosis do, and the schema describes all else."""
    names: set[str] = set()
    for part in ("event", "change"):
        Draft202012Validator({"$ref": f"#/$defs/{part}", "$defs": schema()["$defs"]}).validate(line)
        names |= schema()["$defs"][part]["properties"].keys()
    assert line.keys() <= names


def require_line(part: str, line: dict[str, Any]) -> None:
    """That the schema holds for a "sample" or a "status" of `watch`, and describes every name of it."""
    Draft202012Validator({"$ref": f"#/$defs/{part}", "$defs": schema()["$defs"]}).validate(line)
    assert line.keys() <= schema()["$defs"][part]["properties"].keys()
