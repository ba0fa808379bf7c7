"""Parameters of a part beside its name: ``law@tuned.toml``, as `offtrack tune` writes them."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from vehicle.parameter_file import read_toml
from vehicle.user_file import FileKind, shown

TABLES: Final = {"trailer_steering": "steering", "slip_compensation": "driving"}
_SUFFIX: Final = ".toml"


def parameters_beside(value: str) -> tuple[str, Path | None]:
    """Name of a part, and the file of its parameters: of ``law@tuned.toml`` they are ``law`` and ``tuned.toml``."""
    name, at, file = value.rpartition("@")
    return (name, Path(file)) if at and file.endswith(_SUFFIX) else (value, None)


def expanded(key: str, value: str) -> tuple[tuple[str, str], ...]:
    """Settings that a value of a key stands for: itself, or the part and its parameters.

    The file is a scenario, whose table of parameters counts, or that table alone.

    Raises:
        ValueError: one line, if the file can not be read or holds no such table.
    """
    name, file = parameters_beside(value)
    if file is None or key not in TABLES:
        return ((key, value),)
    prefix = TABLES[key]
    table: dict[str, Any] = read_toml(file, FileKind.SCENARIO)
    if prefix in table or "course" in table:
        table = table.get(prefix, {})
    plain = {name: text for name, text in table.items() if isinstance(text, bool | int | float | str)}
    if not plain or len(plain) != len(table):
        raise ValueError(f"{key} = {shown(value)}: the file must hold the table [{prefix}], or parameters alone")
    return ((key, name), *((f"{prefix}.{word}", _text(number)) for word, number in plain.items()))


def _text(value: bool | int | float | str) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
