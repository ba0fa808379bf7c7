"""Options of faults, of sensors and of the rest of the loop.

Each is a table, ``{kind = "dropout", amount = 0.1, start = 5.0, duration = 2.0}``, or shorter the text
``dropout:0.1@5+2``: kind, amount, start [s] and duration [s]. All but the kind may be left out. Amounts of several
numbers are separated by commas, several faults in one text by semicolons.

``sensors.faults.fault`` and ``scenarios.loop_faults.fault`` name the kinds. The user's own kind is given by its
import path: ``mymod:Flicker``, with amount and times ``mymod:Flicker:0.2@5+1``. After the first colon, a word is the
class and a number is the amount. A catalogue name before the first colon is always that kind.
"""

from __future__ import annotations

import re
from typing import Annotated, Any

from pydantic import BeforeValidator, model_validator

from scenarios.catalogue import FAULT, resolve
from scenarios.loop_faults.fault import LoopFault, is_loop_kind
from sensors.faults.fault import Fault, checked_kind, defaults
from vehicle.foundation.parameter_file import nearest
from vehicle.foundation.quantity import Frozen, option, quantity
from vehicle.foundation.user_file import shown

_NAMES = "|".join(FAULT)
_TEXT = re.compile(
    rf"(?P<kind>(?:{_NAMES})(?=[:@]|$)|[A-Za-z_][\w.]*(?::[A-Za-z_]\w*)?)"
    r"(:(?P<amount>[^@]*))?(@(?P<start>[^+]*)(\+(?P<duration>.*))?)?"
)


def _numbers(amount: Any) -> Any:
    return (amount,) if isinstance(amount, int | float) else tuple(amount) if isinstance(amount, list) else amount


class FaultOptions(Frozen):
    """One fault."""

    kind: str = option("Fault kind (see offtrack parts fault) or package.module:Name.")
    amount: Annotated[tuple[float, ...], BeforeValidator(_numbers)] = option(
        "Numbers of the fault; not given: the kind's defaults.", ()
    )
    start: float = quantity(0.0, "s", 0.0, 1e5, "Time at which the fault begins.")
    duration: float | None = quantity(None, "s", 0.001, 1e5, "Duration of the fault; not given: to the end.")

    def __str__(self) -> str:
        """The fault as ``--set faults=`` takes it."""
        amount = ",".join(f"{number:g}" for number in self.amount)
        duration = "" if self.duration is None else f"+{self.duration:g}"
        return f"{self.kind}{amount and ':'}{amount}@{self.start:g}{duration}"

    @model_validator(mode="after")
    def _possible(self) -> FaultOptions:
        self.fault()
        return self

    def fault(self) -> Fault | LoopFault:
        """Build the fault. Of the loop's faults, later numbers of the amount may be left out."""
        _check_name(self.kind)
        part = resolve("kind", self.kind, FAULT)
        if is_loop_kind(part):
            amount = self.amount and (*self.amount, *defaults(part)[len(self.amount) :])
            return LoopFault(name=self.kind, kind=part, amount=amount, start=self.start, duration=self.duration)
        kind = checked_kind(self.kind, part)
        return Fault(name=self.kind, kind=kind, amount=self.amount, start=self.start, duration=self.duration)


def _tables(faults: Any) -> Any:
    """Convert texts to tables; leave anything else to the validation."""
    if isinstance(faults, str):
        return tuple(_table(text.strip()) for text in faults.split(";") if text.strip() not in ("", "none"))
    if isinstance(faults, list | tuple):
        return tuple(_table(fault) if isinstance(fault, str) else fault for fault in faults)
    return faults


def _table(text: str) -> dict[str, Any]:
    match = _TEXT.fullmatch(text)
    if match is None:
        raise ValueError(f"fault '{shown(text)}' must be written as kind:amount@start+duration")
    _check_name(match["kind"])
    table: dict[str, Any] = {"kind": match["kind"]}
    if match["amount"]:
        table["amount"] = tuple(map(_number, match["amount"].split(",")))
    return table | {key: _number(match[key]) for key in ("start", "duration") if match[key]}


def _number(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text  # refused by the validation, which names the key


def _check_name(kind: str) -> None:
    if kind not in FAULT and ":" not in kind:
        raise ValueError(f"unknown fault '{shown(kind)}'{nearest(kind, FAULT)} (or package.module:Name)")


Faults = Annotated[tuple[FaultOptions, ...], BeforeValidator(_tables)]
