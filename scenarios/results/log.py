"""Log of a run: named signals over time, as one read-only table of floats.

On disk a log is a Parquet file in SI units; its schema holds the unit and meaning of every signal.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Generic, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from estimators.estimates import Health
from scenarios.results.parquet_file import read_table
from vehicle.frames import FloatArray
from vehicle.user_file import shown

HEALTH: Final = {Health.OK: 0.0, Health.DEGRADED: 1.0, Health.LOST: 2.0}  # values of a signal
HEALTH_WORDS: Final = {value: health.value for health, value in HEALTH.items()}
OK: Final = HEALTH[Health.OK]
LOST: Final = HEALTH[Health.LOST]

MOTION: Final = (  # of a unit or a rover: name, unit and meaning
    ("x", "m", "position east"),
    ("y", "m", "position north"),
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

    def __post_init__(self) -> None:
        if len(set(self.names)) != len(self.signals):
            raise ValueError(f"signal names must differ from each other, got {self.names}")
        if self.rows.ndim != 2 or self.rows.shape[1] != len(self.signals):
            raise ValueError(f"rows of shape {self.rows.shape} do not fit {len(self.signals)} signals")
        # One bit pattern for every NaN, so that equal logs have equal hashes; columns contiguous, as they are read.
        table = np.where(np.isnan(self.rows), np.nan, self.rows).copy(order="F")
        table.flags.writeable = False
        object.__setattr__(self, "rows", table)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the signals, in the order of the columns."""
        return tuple(signal.name for signal in self.signals)

    def __len__(self) -> int:
        return len(self.rows)

    def __contains__(self, name: object) -> bool:
        return name in self.names

    def __getitem__(self, name: str) -> FloatArray:
        """The signal's values, shape (n_rows,), read-only."""
        if name not in self.names:
            raise KeyError(f"no signal {name!r} in this log; it has {', '.join(self.names)}")
        column: FloatArray = self.rows[:, self.names.index(name)]
        return column

    def __eq__(self, other: object) -> bool:
        """Same signals and bitwise the same values (NaN equals NaN)."""
        if not isinstance(other, Log):
            return NotImplemented
        return self.signals == other.signals and self.rows.tobytes() == other.rows.tobytes()

    __hash__ = None  # type: ignore[assignment]  # mypy has no notion of an unhashable dataclass with its own __eq__

    @classmethod
    def of(cls, columns: Iterable[Column]) -> Log:
        """The log of these columns."""
        signals, values = zip(*columns, strict=True)
        return cls(signals, np.column_stack(values))

    def with_columns(self, columns: Iterable[Column]) -> Log:
        """The log with further columns."""
        signals, values = zip(*columns, strict=True)
        return Log((*self.signals, *signals), np.column_stack([self.rows, *values]))

    def sha256(self) -> str:
        """Hash of the signals' names, units and values; it does not depend on the file."""
        header = repr([(signal.name, signal.unit) for signal in self.signals]).encode()
        return hashlib.sha256(header + self.rows.tobytes()).hexdigest()


def write_log(log: Log, path: Path) -> None:
    """Write a Parquet file: one column per signal, NaN as null, unit and description in the field's metadata."""
    fields = [
        pa.field(s.name, pa.float64(), metadata={"unit": s.unit, "description": s.description}) for s in log.signals
    ]
    columns = [pa.array(log[name], from_pandas=True) for name in log.names]  # from_pandas: NaN becomes null
    pq.write_table(pa.table(columns, schema=pa.schema(fields)), path, compression="zstd")


def read_log(path: Path) -> Log:
    """The log written by :func:`write_log`, equal to the original.

    Raises:
        ValueError: one line, if the file cannot be read or is not such a log.
    """
    table = read_table(path)
    signals = tuple(_signal(path, field.name, field.metadata or {}) for field in table.schema)
    columns = [column.to_numpy() for column in table.columns]
    return Log(signals, np.column_stack(columns) if columns else np.empty((len(table), 0)))


def _signal(path: Path, name: str, metadata: Mapping[bytes, bytes]) -> Signal:
    if not {b"unit", b"description"} <= metadata.keys():
        raise ValueError(f"{path}: is not a file of signals: {shown(name)} has no unit or no description")
    return Signal(name, metadata[b"unit"].decode(), metadata[b"description"].decode())
