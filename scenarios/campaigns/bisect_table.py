"""The table ``bisect`` of a campaign: which number of which fault is searched for its smallest value that fails."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from scenarios.campaigns.fault_entry import FaultEntry
from scenarios.options.base import Options

Number = Literal["amount", "duration"]
_FINEST = 1e-4  # tolerance, as a share of the range


class Bisect(Options):
    """One search, made for each law, further axis and seed; other lists of the fault have their first value."""

    fault: str  # title of an entry
    of: Number = "amount"  # its first number; a kind with several keeps the others
    low: float
    high: float
    onset: float | None = None  # [s]; not given: the first of the entry
    duration: float | None = None  # [s]; not given: the first of the entry
    tolerance: Annotated[float, Field(gt=0.0)]  # width of the interval that holds the smallest value that fails
    seeds: tuple[Annotated[int, Field(ge=0, strict=True)], ...] = ()  # empty: those of the entry
    only: dict[str, Any] = Field(default_factory=dict)  # values of the axes; others: all

    @model_validator(mode="after")
    def _possible(self) -> Bisect:
        if not self.low < self.high:
            raise ValueError(f"low = {self.low:g} must be below high = {self.high:g}")
        if self.tolerance < _FINEST * (self.high - self.low):
            raise ValueError(f"tolerance = {self.tolerance:g} must be at least {_FINEST:g} of the range")
        return self

    def text_of(self, entry: FaultEntry, value: float) -> str:
        """The fault with this value, as ``faults=`` takes it.

        Raises:
            ValueError: one line, if the kind does not take it.
        """
        given = {"amounts": None, "onsets": self.onset, "durations": self.duration} | {f"{self.of}s": value}
        return entry.text_with({key: (number,) for key, number in given.items() if number is not None})
