"""Parquet files of numbers: sizes and types are checked before anything is unpacked."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from vehicle.frames import FloatArray
from vehicle.user_file import FileKind, read_bytes, shown

_MAX_NUMBERS: Final = 100_000_000  # an hour of 250 signals at 100 Hz


def read_table(path: Path, columns: Sequence[str] | None = None) -> Any:
    """Arrow table of these columns, by default of all.

    Raises:
        ValueError: one line, if the file cannot be read, or a column is missing, too long or not of numbers.
    """
    content = read_bytes(path, FileKind.SIGNALS)
    try:
        file = pq.ParquetFile(pa.BufferReader(content))
        refusal = _refusal(file, file.schema_arrow.names if columns is None else columns)
        table = None if refusal else file.read(columns)
    except Exception as error:  # a damaged file raises almost anything
        raise ValueError(f"{path} is damaged or not a Parquet file") from error
    if refusal:
        raise ValueError(f"{path}: {refusal}")
    return table


def read_columns(path: Path, columns: Sequence[str]) -> dict[str, FloatArray]:
    """Numbers (n,) of each column, NaN where there is none.

    Raises:
        ValueError: one line, as ``read_table``.
    """
    table = read_table(path, columns)
    return {name: table[name].to_numpy().astype(np.float64) for name in columns}


def _refusal(file: Any, columns: Sequence[str]) -> str:
    """Reason why a file must not be unpacked; empty if there is none."""
    groups = sum(file.metadata.row_group(k).num_rows for k in range(file.metadata.num_row_groups))
    count = max(file.metadata.num_rows, groups) * len(columns)
    if count > _MAX_NUMBERS:
        return f"has {count} numbers: {FileKind.SIGNALS.noun} must have at most {_MAX_NUMBERS}"
    for name in columns:
        if name not in file.schema_arrow.names:
            return f"column '{name}' is missing"
        kind = file.schema_arrow.field(name).type
        if not (pa.types.is_floating(kind) or pa.types.is_integer(kind)):
            return f"column '{shown(name)}' has values of type {shown(str(kind))}, must be numbers"
    return ""
