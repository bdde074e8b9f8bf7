"""Frames of pandas, Polars and Arrow."""

from __future__ import annotations

from typing import Any

from fusion_sfdia.common.errors import MissingPackageError


def is_frame(data: object) -> bool:
    """Whether data is a table with named columns, which all of pandas, Polars and Arrow give by Arrow's C stream."""
    return hasattr(data, "columns") and hasattr(data, "__arrow_c_stream__")


def as_pandas(frame: Any) -> Any:
    """A frame as one of pandas; another than pandas' own needs pyarrow."""
    if type(frame).__module__.split(".")[0] == "pandas":
        return frame
    import pandas

    try:
        return pandas.DataFrame.from_arrow(frame)
    except ImportError as error:
        raise MissingPackageError("a frame of Polars or Arrow needs pyarrow: install fusion-sfdia[parquet]") from error
