"""Time as integer ticks: schedules of sampled parts and messages in flight.

As in dm_control's observables, rates are whole ticks and latency is kept out of the sensor models.
"""

from dataclasses import dataclass
from typing import Generic, TypeVar

TICK = 1e-3  # [s] one tick, and the plant's integration step

Message = TypeVar("Message")


def to_ticks(seconds: float, name: str) -> int:
    """Number of ticks in a time span [s].

    Raises:
        ValueError: if ``seconds`` is negative or does not divide into ticks of 1 ms.
    """
    ticks = round(seconds / TICK)
    if seconds < 0.0 or abs(ticks * TICK - seconds) > 1e-9:
        raise ValueError(f"{name} = {seconds} s must be a whole, non-negative number of {TICK * 1e3:g} ms ticks")
    return ticks


def elapsed_since(last: int | None, tick: int) -> float:
    """Time [s] from the tick of the last step to this one; 0 before the first step."""
    return 0.0 if last is None else (tick - last) * TICK


@dataclass(frozen=True, slots=True, kw_only=True)
class Schedule:
    """Sample k is taken at tick ``offset + k * period`` and delivered ``latency`` ticks later."""

    period: int  # [ticks]
    offset: int = 0  # [ticks]
    latency: int = 0  # [ticks]

    def __post_init__(self) -> None:
        if self.period <= 0 or self.offset < 0 or self.latency < 0:
            raise ValueError(f"period, offset, latency must be > 0, >= 0, >= 0 ticks, got {self}")

    @classmethod
    def at_rate(cls, rate_hz: float, *, latency: float = 0.0, name: str = "rate_hz") -> "Schedule":
        """A schedule from a rate [Hz] and a latency [s].

        Raises:
            ValueError: if the period or the latency is not a whole number of ticks.
        """
        if rate_hz <= 0.0:
            raise ValueError(f"{name} = {rate_hz} Hz must be positive")
        return cls(period=to_ticks(1.0 / rate_hz, f"1/{name}"), latency=to_ticks(latency, "latency"))

    def due(self, tick: int) -> bool:
        """True if a sample is taken at this tick."""
        return tick >= self.offset and (tick - self.offset) % self.period == 0


@dataclass(frozen=True, slots=True)
class Pipe(Generic[Message]):
    """Messages in flight, oldest first, each with the tick of its delivery."""

    in_flight: tuple[tuple[int, Message], ...] = ()

    def put(self, delivery_tick: int, message: Message) -> "Pipe[Message]":
        """A pipe with one more message in flight."""
        return Pipe((*self.in_flight, (delivery_tick, message)))

    def deliver(self, tick: int) -> "tuple[Pipe[Message], tuple[Message, ...]]":
        """A pipe without the messages due by ``tick``, and those messages."""
        due = tuple(message for when, message in self.in_flight if when <= tick)
        return Pipe(tuple(item for item in self.in_flight if item[0] > tick)) if due else self, due
