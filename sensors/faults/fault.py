"""A fault of a sensor or of its wires as plain data; ``sensors.faults.wrappers`` makes it happen.

| kind          | amount (default)                       | what happens                                              |
|---------------|----------------------------------------|-----------------------------------------------------------|
| dropout       | share of messages (0.1)                | messages are lost, each by chance                         |
| duplicate     | share of messages (0.1)                | the message before is sent again under the new time       |
| freeze        |                                        | the last message before is sent again and again           |
| delay         | captures (1)                           | messages come late, under the time of their capture       |
| desync        | lag [s] (0.01)                         | the right camera exposes later than the left one          |
| decalibration | roll, yaw, pitch [deg] (-0.15, 0.1, 0) | the right camera is knocked askew                         |
| dirt          | share of the lens (0.3)                | a splash of dirt on both lenses                           |
| glare         | of the sun (1)                         | a veil of light around a spot in the upper half           |
| blackout      |                                        | images are black                                          |

Each begins at ``start`` and ends after ``duration``. The last five befall cameras only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal, get_args

from vehicle.clock import to_ticks

Kind = Literal["dropout", "duplicate", "freeze", "delay", "desync", "decalibration", "dirt", "glare", "blackout"]
KINDS: Final[tuple[Kind, ...]] = get_args(Kind)
# Amounts: their default, and what each must lie between.
_AMOUNTS: Final[dict[Kind, tuple[tuple[float, ...], float, float]]] = {
    "dropout": ((0.1,), 0.0, 1.0),
    "duplicate": ((0.1,), 0.0, 1.0),
    "freeze": ((), 0.0, 0.0),
    "delay": ((1.0,), 1.0, 50.0),
    "desync": ((0.01,), 0.001, 0.09),
    "decalibration": ((-0.15, 0.1, 0.0), -5.0, 5.0),
    "dirt": ((0.3,), 0.0, 1.0),
    "glare": ((1.0,), 0.0, 5.0),
    "blackout": ((), 0.0, 0.0),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One fault: its kind, how much of it, and when.

    Raises:
        ValueError: naming what is out of range.
    """

    kind: Kind
    amount: tuple[float, ...] = ()  # see the table above; none: the default
    start: float = 0.0  # [s]
    duration: float | None = None  # [s]; None: to the end

    def __post_init__(self) -> None:
        default, low, high = _AMOUNTS[self.kind]
        if len(self.amount) not in (0, len(default)) or not all(low <= value <= high for value in self.amount):
            needed = f"{len(default)} of {low:g} to {high:g}" if default else "none"
            raise ValueError(f"{self.kind}: amount = {list(self.amount)} must be {needed}")
        if self.kind == "delay" and self.amount and self.amount[0] % 1.0:
            raise ValueError(f"delay: amount = {self.amount[0]:g} must be a whole number of captures")
        if self.start < 0.0 or (self.duration is not None and self.duration <= 0.0):
            raise ValueError(f"{self.kind}: start = {self.start} s and duration = {self.duration} s must be positive")

    @property
    def amounts(self) -> tuple[float, ...]:
        """How much, the default filled in."""
        return self.amount or _AMOUNTS[self.kind][0]

    def at(self, tick: int) -> bool:
        """Whether it prevails at a tick."""
        begin = to_ticks(self.start, f"{self.kind}: start")
        end = math.inf if self.duration is None else begin + to_ticks(self.duration, f"{self.kind}: duration")
        return begin <= tick < end
