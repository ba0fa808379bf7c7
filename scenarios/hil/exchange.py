"""Exchange with a bench at every step of control: signals out, demands in, hold and fallback."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from scenarios.hil.demands import Demands, checked_message
from scenarios.hil.link import Link, Numbers
from scenarios.hil.record import RecordedDemands, Values, record_text
from scenarios.options.outside import OutsideOptions
from scenarios.results.outside import Outside
from vehicle.clock import TICK, to_ticks


class _Held(NamedTuple):
    """The newest demands of a part."""

    tick: int  # of the step that took them
    values: tuple[float, ...]


class Exchange:
    """Sends the signals of every step, takes the demands that have come, and decides which ones hold."""

    def __init__(
        self,
        options: OutsideOptions,
        parts: Sequence[Demands],
        links: Sequence[Link],
        record: RecordedDemands | None = None,
        *,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        """Create the exchange of a run.

        Args:
            options: hold and wait.
            parts: that are steered from outside.
            links: receive the signals; without a record their demands are taken.
            record: demands of an earlier run.
            clock: wall time [s].
        """
        self.links = tuple(links)
        self._parts, self._record, self._clock = tuple(parts), record, clock
        self._hold, self._wait = to_ticks(options.hold, "outside.hold"), options.wait
        self._held: dict[str, _Held] = {}
        self._rows: list[tuple[int, Values]] = []
        self._sent = self._received = self._refused = 0
        self._fresh = self._kept = self._fallback = self._gap = 0
        self._refusal = ""

    def step(self, tick: int, signals: Callable[[], Mapping[str, float]]) -> Values:
        """Demands at this step by part; parts that are missing act by themselves."""
        if self.links:
            values = signals()
            for link in self.links:
                link.send(tick, values)
            self._sent += 1
        came = self._record.at(tick) if self._record else self._received_at(tick)
        if came:
            self._rows.append((tick, came))
        acting: dict[str, tuple[float, ...]] = {}
        for demands in self._parts:
            part = demands.part
            before = self._held.get(part)
            if before is not None:
                self._gap = max(self._gap, tick - before.tick)
            if part in came:
                self._held[part] = _Held(tick, came[part])
                self._fresh += 1
            elif before is not None and tick - before.tick <= self._hold:
                self._kept += 1
            else:
                self._fallback += 1
                continue
            acting[part] = self._held[part].values
        return acting

    def _received_at(self, tick: int) -> Values:
        """Newest demands that have come since the last step; waits for the answers to this one as the options say."""
        if not self._parts:
            return {}
        came: dict[str, tuple[float, ...]] = {}
        answered: set[str] = set()
        end = self._clock() + self._wait
        while True:
            left = end - self._clock() if self._wait and len(answered) < len(self._parts) else 0.0
            share = max(0.0, left) / len(self.links) if len(self.links) > 1 else max(0.0, left)
            messages = [message for link in self.links for message in link.receive(min(share, 0.01))]
            for message in messages:
                self._take(message, tick, came, answered)
            if left <= 0.0:
                return came

    def _take(self, numbers: Numbers | str, tick: int, came: dict[str, tuple[float, ...]], answered: set[str]) -> None:
        try:
            if isinstance(numbers, str):
                raise ValueError(numbers)
            message = checked_message(numbers, self._parts)
        except ValueError as error:
            self._refused += 1
            self._refusal = self._refusal or str(error)
            return
        self._received += 1
        came.update(message.values)
        if message.tick is None or message.tick >= tick:
            answered.update(message.values)

    def report(self) -> Outside:
        """Counts so far, and the record of the demands."""
        live = bool(self._parts) and self._record is None
        source = ", ".join(link.name for link in self.links) if live else "record" if self._parts else ""
        return Outside(
            source=source,
            sent=self._sent,
            received=self._received,
            refused=self._refused,
            first_refusal=self._refusal,
            fresh_steps=self._fresh,
            held_steps=self._kept,
            fallback_steps=self._fallback,
            longest_gap_s=self._gap * TICK,
            record=record_text(self._parts, self._rows) if live else "",
        )
