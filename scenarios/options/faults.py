"""Faults of the cameras, or of the reference unit in their place, as a scenario file describes them.

Each is a table, ``{kind = "dropout", amount = 0.1, start = 5.0, duration = 2.0}``, or shorter the text
``dropout:0.1@5+2``; amounts of several numbers are separated by commas, several faults in one text by semicolons.
``sensors.faults.fault`` tells the kinds and their amounts.
"""

from __future__ import annotations

import re
from typing import Annotated, Any

from pydantic import BeforeValidator, model_validator

from scenarios.options.base import Options, quantity
from sensors.faults.fault import KINDS, Fault, Kind
from vehicle.parameter_file import nearest

_TEXT = re.compile(r"(?P<kind>[^:@]+)(:(?P<amount>[^@]*))?(@(?P<start>[^+]*)(\+(?P<duration>.*))?)?")


def _numbers(amount: Any) -> Any:
    return (amount,) if isinstance(amount, int | float) else amount


class FaultOptions(Options):
    """One fault."""

    kind: Kind
    amount: Annotated[tuple[float, ...], BeforeValidator(_numbers)] = ()
    start: float = quantity(0.0, "s", ge=0.0, le=1e5)
    duration: float | None = quantity(None, "s", ge=0.001, le=1e5)

    @model_validator(mode="after")
    def _possible(self) -> FaultOptions:
        self.fault()
        return self

    def fault(self) -> Fault:
        """In the words of the sensors."""
        return Fault(kind=self.kind, amount=self.amount, start=self.start, duration=self.duration)


def _tables(faults: Any) -> Any:
    """Texts as tables; whatever else is left to the validation."""
    if isinstance(faults, str):
        return tuple(_table(text.strip()) for text in faults.split(";") if text.strip() not in ("", "none"))
    if isinstance(faults, list | tuple):
        return tuple(_table(fault) if isinstance(fault, str) else fault for fault in faults)
    return faults


def _table(text: str) -> dict[str, Any]:
    match = _TEXT.fullmatch(text)
    if match is None or match["kind"] not in KINDS:
        kind = text if match is None else match["kind"]
        raise ValueError(f"unknown fault '{kind}'{nearest(kind, KINDS)}; expected kind:amount@start+duration")
    table: dict[str, Any] = {"kind": match["kind"]}
    if match["amount"]:
        table["amount"] = tuple(match["amount"].split(","))
    return table | {key: match[key] for key in ("start", "duration") if match[key]}


Faults = Annotated[tuple[FaultOptions, ...], BeforeValidator(_tables)]
