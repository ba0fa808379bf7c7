"""Log of a run: named signals over time, as one read-only table of floats, and its Parquet file.

On disk a log is a Parquet file in SI units; its schema holds the unit and meaning of every signal.
"""

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from estimators.estimates import Health
from vehicle.foundation.user_file import FileKind, nearest, read_bytes, shown
from vehicle.frames import FloatArray

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


HEALTH: Final = {Health.OK: 0.0, Health.DEGRADED: 1.0, Health.LOST: 2.0}  # values of a signal
HEALTH_WORDS: Final = {value: health.value for health, value in HEALTH.items()}
_NAN: Final = np.float64(np.nan).view(np.uint64)  # bits of every NaN in a log
_HASHED: Final = 1000  # rows that are hashed at once
OK: Final = HEALTH[Health.OK]
LOST: Final = HEALTH[Health.LOST]

MOTION: Final = (  # of a unit or a rover: name, unit and meaning
    ("x", "m", "position along the first heading"),
    ("y", "m", "position to the left of the first heading"),
    ("psi", "rad", "yaw, continuous"),
    ("v_x", "m/s", "forward speed"),
    ("v_y", "m/s", "lateral speed, + left"),
    ("yaw_rate", "rad/s", "yaw rate"),
)

TruthT = TypeVar("TruthT")
RecordT = TypeVar("RecordT")


@dataclass(frozen=True, slots=True)
class Row(Generic[TruthT, RecordT]):
    """Ground truth at one tick, with the commands and estimates of that step."""

    truth: TruthT
    record: RecordT


@dataclass(frozen=True, slots=True)
class Signal:
    """One column of a log."""

    name: str
    unit: str  # "m", "rad", "m/s", "-" for a pure number
    description: str


Column = tuple[Signal, Sequence[float] | FloatArray]  # a signal with its values (n_rows,)


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """Signals over time; NaN where a signal has no value, for example an estimate between two captures.

    Raises:
        ValueError: if the table does not fit the signals, or two signals share a name.
    """

    signals: tuple[Signal, ...]
    rows: FloatArray  # (n_rows, n_signals), read-only
    _columns: dict[str, int] = field(init=False, repr=False)  # by their names, in their order

    def __post_init__(self) -> None:
        object.__setattr__(self, "_columns", {signal.name: k for k, signal in enumerate(self.signals)})
        if len(self._columns) != len(self.signals):
            raise ValueError(f"signal names must differ from each other, got {[one.name for one in self.signals]}")
        if self.rows.ndim != 2 or self.rows.shape[1] != len(self.signals):
            raise ValueError(f"rows of shape {self.rows.shape} do not fit {len(self.signals)} signals")
        if not _is_canonical(self.rows):
            object.__setattr__(self, "rows", _canonical(len(self.rows), list(self.rows.T)))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the signals, in the order of the columns."""
        return tuple(self._columns)

    def __len__(self) -> int:
        return len(self.rows)

    def __contains__(self, name: object) -> bool:
        return name in self._columns

    def __getitem__(self, name: str) -> FloatArray:
        """The signal's values, shape (n_rows,), read-only."""
        if name not in self._columns:
            raise KeyError(f"no signal '{shown(name)}'{nearest(name, self.names)}")
        column: FloatArray = self.rows[:, self._columns[name]]
        return column

    def __eq__(self, other: object) -> bool:
        """Same signals and bitwise the same values (NaN equals NaN)."""
        if not isinstance(other, Log):
            return NotImplemented
        return self.signals == other.signals and np.array_equal(_bits(self.rows), _bits(other.rows))

    __hash__ = None  # type: ignore[assignment]  # mypy has no notion of an unhashable dataclass with its own __eq__

    @classmethod
    def of(cls, columns: Iterable[Column]) -> "Log":
        """The log of these columns; each is let go of as soon as it is copied."""
        signals, values = list[Signal](), list[Sequence[float] | FloatArray]()
        for signal, column in columns:
            signals.append(signal)
            values.append(column)
        return cls(tuple(signals), _canonical(len(values[0]), values))

    def with_columns(self, columns: Iterable[Column]) -> "Log":
        """The log with further columns."""
        return Log.of([*((signal, self[signal.name]) for signal in self.signals), *columns])

    def sha256(self) -> str:
        """Hash of the signals' names, units and values; it does not depend on the file."""
        header = repr([(signal.name, signal.unit) for signal in self.signals]).encode()
        digest = hashlib.sha256(header)
        for begin in range(0, len(self), _HASHED):
            digest.update(self.rows[begin : begin + _HASHED].tobytes())
        return digest.hexdigest()


def _canonical(n_rows: int, columns: list[Sequence[float] | FloatArray]) -> FloatArray:
    """Read-only table (n_rows, n_columns) of the columns, which are taken out of their list one by one.

    Columns are contiguous, as they are read; NaN has one bit pattern, so that equal logs have equal hashes.
    """
    table = np.empty((n_rows, len(columns)), order="F")
    for k in reversed(range(len(columns))):
        values = np.asarray(columns.pop(), dtype=np.float64)
        if values.shape != (n_rows,):
            raise ValueError(f"a column of shape {values.shape} does not fit {n_rows} rows")
        table[:, k] = values
        table[np.isnan(values), k] = np.nan
    table.flags.writeable = False
    return table


def _is_canonical(table: FloatArray) -> bool:
    """True for a table of :func:`_canonical`, which needs no copy, as nobody can change it."""
    return (
        table.dtype == np.float64
        and table.base is None
        and table.flags.f_contiguous
        and not table.flags.writeable
        and all((_bits(column[np.isnan(column)]) == _NAN).all() for column in table.T)
    )


def _bits(values: FloatArray) -> NDArray[np.uint64]:
    return values.view(np.uint64)


def write_log(log: Log, path: Path) -> None:
    """Write a Parquet file: one column per signal, NaN as null, unit and description in the field's metadata.

    They are also a JSON text under the key ``signals`` of the file's metadata, and in ``attrs`` where pandas reads it.
    """
    fields = [
        pa.field(s.name, pa.float64(), metadata={"unit": s.unit, "description": s.description}) for s in log.signals
    ]
    columns = [_with_nulls(np.ascontiguousarray(log[name])) for name in log.names]
    signals = {s.name: {"unit": s.unit, "meaning": s.description} for s in log.signals}
    metadata = {"signals": json.dumps(signals), "PANDAS_ATTRS": json.dumps({"signals": signals})}
    pq.write_table(pa.table(columns, schema=pa.schema(fields, metadata)), path, compression="zstd")


def _with_nulls(values: FloatArray) -> Any:
    """Arrow array of the values, null where they are NaN; ``pa.array`` would import pandas where that is installed."""
    known = np.packbits(~np.isnan(values), bitorder="little")
    return pa.Array.from_buffers(pa.float64(), len(values), [pa.py_buffer(known), pa.py_buffer(values)])


def read_log(path: Path) -> Log:
    """The log of a run, written by :func:`write_log`, equal to the original.

    Raises:
        ValueError: one line, if the file cannot be read or is not such a log, or its time runs back.
    """
    table = read_table(path)
    signals = tuple(_signal(path, field.name, field.metadata or {}) for field in table.schema)
    columns = [column.to_numpy() for column in table.columns]
    for name, values in zip(table.column_names, columns, strict=True):
        if name == "time" and not (np.diff(values) >= 0.0).all():
            row = int(np.flatnonzero(~(np.diff(values) >= 0.0))[0]) + 2
            raise ValueError(f"{path}: row {row}: time = {values[row - 1]:g} s must not be less than in the row before")
    return Log(signals, np.column_stack(columns) if columns else np.empty((len(table), 0)))


def _signal(path: Path, name: str, metadata: Mapping[bytes, bytes]) -> Signal:
    if not {b"unit", b"description"} <= metadata.keys():
        raise ValueError(f"{path}: is not a file of signals: {shown(name)} has no unit or no description")
    return Signal(name, metadata[b"unit"].decode(), metadata[b"description"].decode())


RowT = TypeVar("RowT")
ColumnsOf = Callable[[Sequence[RowT]], Iterable[Column]]  # columns of a part of the rows

_PART: Final = 500  # rows at a time


def columns_by_parts(rows: Sequence[RowT], *columns_of: ColumnsOf[RowT]) -> list[list[tuple[Signal, FloatArray]]]:
    """Columns over all rows, a list for each function.

    The functions get the rows in order, part by part, and first no rows at all, for the names of their columns.
    """
    tables = [[(signal, np.empty(len(rows))) for signal, _ in columns([])] for columns in columns_of]
    for begin, part in _parts(rows):
        for table, columns in zip(tables, columns_of, strict=True):
            for (_, whole), (_, values) in zip(table, columns(part), strict=True):
                whole[begin : begin + len(part)] = values
    return tables


def _parts(rows: Sequence[RowT]) -> Iterator[tuple[int, list[RowT]]]:
    """Parts of the rows, each with the place of its first one."""
    begin, left = 0, iter(rows)
    while part := list(islice(left, _PART)):
        yield begin, part
        begin += len(part)
