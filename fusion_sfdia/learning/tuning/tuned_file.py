"""A document of tables as readable TOML: dicts of numbers, text, lists and such dicts, written to the last bit."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fusion_sfdia.common.files import atomic_write


def write_document(path: Path, document: Mapping[str, Any], comments: Mapping[str, str]) -> None:
    """Write tables [name] and [[name]], each below its comment; "" is that of the whole."""
    lines = [f"# {line}" for line in comments.get("", "").splitlines()]
    for name, content in document.items():
        tables = content if isinstance(content, list) else [content]
        for table in tables:
            title = f"[[{_key(name)}]]" if isinstance(content, list) else f"[{_key(name)}]"
            lines += ["", *(f"# {line}" for line in comments.get(name, "").splitlines()), title]
            lines += [f"{_key(key)} = {_value(value)}" for key, value in table.items()]
    with atomic_write(path) as file:
        file.write("\n".join(lines) + "\n")


def read_document(path: Path) -> dict[str, Any]:
    """Read a TOML file; ValueError, which names it, where it is none."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ValueError(f"{path} is not a TOML file ({error}); expected what `fusion-sfdia tune` writes") from error


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _text(name)


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(value: Any) -> str:
    match value:
        case bool():
            return str(value).lower()
        case str():
            return _text(value)
        case int() | float():
            return repr(value)  # also inf and nan
        case Mapping():
            return f"{{ {', '.join(f'{_key(k)} = {_value(v)}' for k, v in value.items())} }}"
        case list() | tuple():
            return f"[{', '.join(map(_value, value))}]"
    raise ValueError(f"a TOML file cannot hold {value!r}")
