"""A controller on a bench in the loop: its protocol, its demands with checks, record, hold and fallback."""

import csv
import io
import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

from estimators.estimates import OffTracking
from scenarios.options.tables import OutsideOptions
from scenarios.results.run_summary import Outside
from sensors.messages import CombinationSignals, EgoState
from vehicle.clock import TICK, to_ticks
from vehicle.foundation.data_file import Column, open_table
from vehicle.foundation.user_file import nearest, shown

if TYPE_CHECKING:
    from scenarios.assembly.trailer_run import Assembly

DRIVER: Final = "driver"
TICK_NAME: Final = "tick"  # of the signals that a message answers; it may lack
_QUARTER: Final = 0.5 * math.pi


class Demand(NamedTuple):
    """One demanded number."""

    name: str
    unit: str
    limit: float  # of its size
    default: float | None = None  # where a message lacks it; None: it must have it


class Demands(NamedTuple):
    """Numbers that belong together: those of the driver, or of one trailer. A message has all of them or none."""

    part: str  # "driver" or the trailer's name
    numbers: tuple[Demand, ...]


class Message(NamedTuple):
    """A message that passed the checks."""

    tick: int | None  # of the signals that it answers; None: it does not say
    values: Mapping[str, tuple[float, ...]]  # by part


def driver_demands() -> Demands:
    """Demands in place of the tractor's driver."""
    return Demands(
        DRIVER,
        (
            Demand("steer_demand", "rad", _QUARTER),
            Demand("acceleration_demand", "m/s2", 20.0),
            Demand("gear_demand", "-", 1.0, default=1.0),
        ),
    )


def trailer_demands(name: str, n_steered: int, *, is_last: bool) -> Demands:
    """Demands for the steered axles of a trailer; those of a trailer ahead of the last end with its name."""
    ending = "" if is_last else f"_{name}"
    axles = range(1, n_steered + 1)
    return Demands(name, tuple(Demand(f"steer_demand_{k}{ending}", "rad", _QUARTER) for k in axles))


def checked_message(numbers: Mapping[str, object], parts: Sequence[Demands]) -> Message:
    """Demands in a message of numbers by name.

    Raises:
        ValueError: one line with the name, the value and its limit.
    """
    known = {demand.name: demand for part in parts for demand in part.numbers}
    for name in numbers:
        if name != TICK_NAME and name not in known:
            raise ValueError(f"unknown demand '{shown(name, 40)}'{nearest(name, tuple(known))}")
    given = {name: _number(known[name], value) for name, value in numbers.items() if name != TICK_NAME}
    values = {part.part: _of_part(part, given) for part in parts if any(one.name in given for one in part.numbers)}
    if not values:
        raise ValueError("has no demand")
    return Message(_tick(numbers.get(TICK_NAME)), values)


def _number(demand: Demand, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= demand.limit:  # also NaN
        rule = f"a number within -{demand.limit:.4g} to {demand.limit:.4g} {demand.unit}"
        raise ValueError(f"{demand.name} = {shown(repr(value), 40)} must be {rule}")
    if demand.name == "gear_demand" and abs(value) != 1.0:
        raise ValueError(f"gear_demand = {value:g} must be 1 or -1")
    return float(value)


def _of_part(part: Demands, given: Mapping[str, float]) -> tuple[float, ...]:
    values = [given.get(one.name, one.default) for one in part.numbers]
    for one, value in zip(part.numbers, values, strict=True):
        if value is None:
            raise ValueError(f"{one.name} is missing")
    return tuple(value for value in values if value is not None)


def _tick(value: object) -> int | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError(f"tick = {shown(repr(value), 40)} must be a whole number")
    return value


RECORD_NAME: Final = "demands.csv"
_CAME: Final = "came_"  # begins the name of the column that says whether a part's demands came at that tick: 1 or 0

Values = Mapping[str, tuple[float, ...]]  # by part


def record_text(parts: Sequence[Demands], rows: Sequence[tuple[int, Values]]) -> str:
    """The record as CSV: a line for every step in which demands came; numbers are exact."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = [name for part in parts for name in (f"{_CAME}{part.part}", *(one.name for one in part.numbers))]
    writer.writerow([TICK_NAME, *names])
    for tick, values in rows:
        cells: list[float] = []
        for part in parts:
            came = part.part in values
            cells += [int(came), *(values[part.part] if came else (0.0,) * len(part.numbers))]
        writer.writerow([tick, *cells])
    return text.getvalue()


def recorded_demands(path: Path, parts: Sequence[Demands]) -> Mapping[int, Values]:
    """The demands of a record, by the tick of the step that took them.

    Raises:
        ValueError: one line, if it is no record of such demands.
    """
    columns = [Column(TICK_NAME, 1e9, "ms")]
    for part in parts:
        columns.append(Column(f"{_CAME}{part.part}", 1.0, "-"))
        columns += [Column(one.name, one.limit, one.unit) for one in part.numbers]
    steps: dict[int, Values] = {}
    for tick, *cells in open_table(path).numbers(columns).tolist():
        at = 0
        values: dict[str, tuple[float, ...]] = {}
        for part in parts:
            came, end = cells[at], at + 1 + len(part.numbers)
            if came:
                values[part.part] = tuple(cells[at + 1 : end])
            at = end
        steps[int(tick)] = values
    return steps


Numbers = Mapping[str, object]  # of a message by name, not checked yet


class Link(Protocol):
    """A link that sends signals and receives demands."""

    @property
    def name(self) -> str:
        """Name in messages, such as "udp"."""

    def send(self, tick: int, values: Mapping[str, float]) -> None:
        """Send signals [SI]; never waits."""

    def receive(self, timeout: float) -> list[Numbers | str]:
        """All messages that have come, oldest first; a text is the reason why one can't be read.

        Waits for the first one, at most for the timeout [s].
        """


class Sensed(NamedTuple):
    """What the steering law of a trailer knows at a step."""

    trailer: str
    off_tracking: OffTracking | None
    signals: CombinationSignals


class Bench(Protocol):
    """A controller on a bench: the links to it, and the signals that it gets."""

    @property
    def links(self) -> Sequence[Link]:
        """Open links; at least one."""

    def prepare(self, parts: "Assembly", trailers: Sequence[Demands], taken: Sequence[Demands]) -> None:
        """Learn the combination, the demands of all watched ``trailers``, and the demands that are ``taken``.

        Raises:
            ValueError: one line, if a link can't carry the demands.
        """

    def signals(self, tick: int, ego: EgoState, sensed: Sequence[Sensed]) -> Mapping[str, float]:
        """Signals [SI] by name at a step; ``sensed`` is in the order of the trailers."""


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
        bench: Bench | None,
        record: Mapping[int, Values] | None = None,
        *,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        """Create the exchange of a run.

        Args:
            options: hold and wait.
            parts: that are steered from outside.
            bench: receives the signals; without a record its demands are taken.
            record: demands of an earlier run, by tick.
            clock: wall time [s].
        """
        self._bench, self._links = bench, tuple(bench.links) if bench else ()
        self._parts, self._record, self._clock = tuple(parts), record, clock
        self._hold, self._wait = to_ticks(options.hold, "outside.hold"), options.wait
        self._held: dict[str, _Held] = {}
        self._rows: list[tuple[int, Values]] = []
        self._sent = self._received = self._refused = 0
        self._fresh = self._kept = self._fallback = self._gap = 0
        self._refusal = ""

    def step(self, tick: int, ego: EgoState, sensed: Sequence[Sensed]) -> Values:
        """Demands at this step by part: a trailer's name or "driver"; parts that are missing act by themselves."""
        if self._bench:
            values = self._bench.signals(tick, ego, sensed)
            for link in self._links:
                link.send(tick, values)
            self._sent += 1
        came = self._record.get(tick, {}) if self._record is not None else self._received_at(tick)
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
            share = max(0.0, left) / len(self._links) if len(self._links) > 1 else max(0.0, left)
            messages = [message for link in self._links for message in link.receive(min(share, 0.01))]
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
        source = ", ".join(link.name for link in self._links) if live else "record" if self._parts else ""
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


def opened_exchange(parts: "Assembly", bench: Bench | None, *, is_paced: bool) -> Exchange | None:
    """The exchange of a run that may keep wall time (``is_paced``); None if nothing goes out or comes in.

    Raises:
        ValueError: one line, if demands are asked for that nobody gives or takes, or a link can't carry them.
    """
    options = parts.scenario.outside
    trailers = [trailer_demands(t.name, t.n_steered, is_last=t is parts.trailers[-1]) for t in parts.trailers]
    taken = _taken(options, trailers, is_driven=parts.driver is not None)
    if not taken and bench is None:
        return None
    record = None if options.record is None or not taken else recorded_demands(Path(options.record), taken)
    asked = f"outside.demands = {options.demands}"
    if taken and record is None:
        if bench is None:
            raise ValueError(f"{asked}: needs --udp, --can, or outside.record of an earlier run")
        if not is_paced and not options.wait:
            raise ValueError(f"{asked}: needs --paced, or outside.wait, for else the loop does not wait for demands")
    if bench is not None:
        bench.prepare(parts, trailers, taken if record is None else ())
    return Exchange(options, taken, bench, record)


def _taken(options: OutsideOptions, trailers: Sequence[Demands], *, is_driven: bool) -> tuple[Demands, ...]:
    steered = [trailer for trailer in trailers if trailer.numbers]
    if options.demands in ("trailer", "both") and not steered:
        raise ValueError(f"outside.demands = {options.demands}: the vehicle has no trailer with steered axles")
    if options.demands in ("driver", "both") and not is_driven:
        raise ValueError(f"outside.demands = {options.demands}: the motion is prescribed, nobody drives")
    return (
        *(steered if options.demands in ("trailer", "both") else ()),
        *([driver_demands()] if options.demands in ("driver", "both") else ()),
    )
