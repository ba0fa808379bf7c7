"""A bench in the loop of a combination: what it gets to know, and what it steers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from estimators.estimates import OffTracking
from offtrack.exchange.bench.links import opened_exchange, signals_of
from offtrack.exchange.fmi_import.fmu_parts import driver_inputs
from offtrack.exchange.fmi_import.numbered_signals import estimate_values, reading_values
from scenarios.assembly.trailer_run import Assembly
from scenarios.loop.demands import Exchange, Link, Values, trailer_demands
from scenarios.results.summary_numbers import Outside
from sensors.messages import CombinationSignals, EgoState


class Sensed(NamedTuple):
    """What the steering law of a trailer knows at a step."""

    trailer: str
    off_tracking: OffTracking | None
    signals: CombinationSignals


class TrailerBench:
    """Signals of a combination out, demands in."""

    def __init__(self, exchange: Exchange, parts: Assembly) -> None:
        self._exchange, self._course, self._speed = exchange, parts.course, parts.scenario.speed
        self._station = 0.0  # of the guided point [m]
        watched = [trailer_demands(t.name, t.n_steered, is_last=t is parts.trailers[-1]) for t in parts.trailers]
        self._names = frozenset(signal.name for signal in signals_of(watched, len(parts.vehicle.units)))

    def step(self, tick: int, ego: EgoState, sensed: Sequence[Sensed]) -> Values:
        """Demands at this step by part: a trailer's name or "driver"; parts that are missing act by themselves."""
        return self._exchange.step(tick, lambda: self._signals(tick, ego, sensed))

    def report(self) -> Outside:
        """What went out and came in so far."""
        return self._exchange.report()

    def _signals(self, tick: int, ego: EgoState, sensed: Sequence[Sensed]) -> dict[str, float]:
        """Signals [SI] by name; the sensors of the last trailer's law come before a driver's eyes."""
        self._station, values = driver_inputs(self._course, self._speed, self._station, tick, ego)
        for one in sensed:
            ending = "" if one is sensed[-1] else f"_{one.trailer}"
            inputs = {**estimate_values(tick, one.off_tracking, self._names), **reading_values(one.signals)}
            values |= {f"{name}{ending}": value for name, value in inputs.items()}
        return {name: float(value) for name, value in values.items() if name in self._names}


def opened_bench(parts: Assembly, links: Sequence[Link], *, is_paced: bool) -> TrailerBench | None:
    """The bench of a run; None if nothing goes out or comes in.

    Raises:
        ValueError: one line, if the scenario asks for demands that nobody gives, or a link can't carry them.
    """
    exchange = opened_exchange(
        parts.scenario.outside,
        links,
        [trailer_demands(t.name, t.n_steered, is_last=t is parts.trailers[-1]) for t in parts.trailers],
        len(parts.vehicle.units),
        is_paced=is_paced,
        is_driven=parts.driver is not None,
    )
    return None if exchange is None else TrailerBench(exchange, parts)
