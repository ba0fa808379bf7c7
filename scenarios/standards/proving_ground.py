"""A combination driven by a law on open ground without cameras, and the log of what it did."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np

from controllers.driver import PERIOD as DRIVER_PERIOD
from controllers.driver import DriverLike
from scenarios.loop.channel import InLine
from scenarios.loop.pilot import CombinationPilot, SteeredTrailer
from scenarios.loop.referee import Referee
from scenarios.loop.session import Session
from scenarios.loop.stopwatch import Stopwatch
from scenarios.results.log import Column, Log, Signal
from scenarios.results.trailer_signals import tyre_columns, unit_columns
from scenarios.standards.pilots import SteerProgramme, steered_trailer
from vehicle.clock import TICK, to_ticks
from vehicle.closing import close_part
from vehicle.combination.description import Vehicle
from vehicle.combination.plant import Plant
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface

MemoryT = TypeVar("MemoryT")

PERIOD: Final = to_ticks(DRIVER_PERIOD, "control period")  # of pilots and log alike [ticks]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drive:
    """A finished drive."""

    outcome: str  # "completed" or the mishap
    log: Log


class ManoeuvreJudge:
    """Ends a drive when its manoeuvre is over, at a mishap, or when it takes too long."""

    def __init__(self, vehicle: Vehicle, done: Callable[[Truth], bool], patience: float) -> None:
        """Wait ``patience`` [s] at most until the manoeuvre is ``done``; there is no road to leave."""
        self._referee = Referee(vehicle)
        self._memory = self._referee.init()
        self._done, self._patience = done, patience

    @property
    def progress(self) -> float:
        """A manoeuvre is done or not."""
        return 0.0

    def outcome(self, truth: Truth) -> str | None:
        """Outcome of the drive; None if it continues."""
        self._memory, mishap = self._referee.step(self._memory, truth)
        if mishap is not None:
            return mishap
        if self._done(truth):
            return "completed"
        return "timed out" if truth.tick * TICK > self._patience else None


def drive(
    vehicle: Vehicle,
    surface: Surface,
    driver: DriverLike[MemoryT],
    *,
    trailer_steering: str,
    speed: float,
    done: Callable[[Truth], bool],
    patience: float,
) -> Drive:
    """Drive a combination from the origin along +x, rolling straight at first.

    Args:
        vehicle: the combination.
        surface: the ground; there is no road to leave.
        driver: of the tractor, asked every ``PERIOD``.
        trailer_steering: law of the last unit's steered axles.
        speed: at the start [m/s].
        done: true once the manoeuvre is over.
        patience: longest duration [s].
    """
    stopwatch, plant = Stopwatch(), Plant(vehicle, surface)
    watched = steered_trailer(vehicle, trailer_steering)
    trailers = () if watched is None else (SteeredTrailer(watched, InLine(), stopwatch),)
    session = Session(
        plant,
        plant.initial_state(Pose2(0.0, 0.0, 0.0), speed),
        period=PERIOD,
        pilot=CombinationPilot(vehicle, driver, trailers),
        judge=ManoeuvreJudge(vehicle, done, patience),
        channels=[trailer.channel for trailer in trailers],
        stopwatch=stopwatch,
    )
    try:
        while session.outcome is None:
            session.advance()
    finally:
        close_part(watched)
    return Drive(outcome=session.outcome, log=drive_log(vehicle, [row.truth for row in session.rows]))


def drive_programme(
    vehicle: Vehicle, angles: FloatArray, *, speed: float, friction: float, trailer_steering: str
) -> Drive:
    """Drive a programme of steer angles (n,) [rad], one every ``PERIOD``, at a speed [m/s] on level ground."""
    end = len(angles) * PERIOD
    return drive(
        vehicle,
        Surface(friction=friction),
        SteerProgramme(angles, speed, PERIOD),
        trailer_steering=trailer_steering,
        speed=speed,
        done=lambda truth: truth.tick >= end,
        patience=2.0 * end * TICK,
    )


def drive_log(vehicle: Vehicle, truths: Sequence[Truth]) -> Log:
    """The log of a drive, a row for each of the truths, in the names of a run's log."""
    return Log.of(_columns(vehicle, truths))


def _columns(vehicle: Vehicle, truths: Sequence[Truth]) -> Iterator[Column]:
    yield Signal("time", "s", "time"), [truth.tick * TICK for truth in truths]
    for k, unit in enumerate(vehicle.units):
        yield from unit_columns(truths, k, unit.name)
        transfer = Signal(f"load_transfer_{unit.name}", "-", f"{unit.name}: right less left wheel loads over their sum")
        yield transfer, [truth.load_transfer[k] for truth in truths]
    steer = Signal("steer_tractor", "rad", "road-wheel angle of the first steered axle, + left")
    yield steer, [truth.steer[0] for truth in truths]
    tractor = vehicle.units[0]
    first = tractor.axles.index(tractor.steered_axles[0])
    wheels = slice(2 * first, 2 * first + 2)  # wheels are listed axle by axle, tractor first
    used = Signal(
        "friction_used_steer", "-", "horizontal over available tyre force, all wheels of the first steered axle"
    )
    yield used, [np.average(truth.friction_used[wheels], weights=truth.wheel_loads[wheels]) for truth in truths]
    yield from tyre_columns(truths)
