"""A combination driven by a law on open ground without cameras, and the log of what it did."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np

from controllers.driver import PERIOD as DRIVER_PERIOD
from scenarios.loop.referee import Referee
from scenarios.results.log import Log, Signal
from vehicle.clock import TICK, to_ticks
from vehicle.combination.description import Vehicle
from vehicle.combination.plant import DivergedError, Plant, VehicleCommand
from vehicle.combination.truth import Truth
from vehicle.frames import Pose2
from vehicle.surface import Surface

PERIOD: Final = to_ticks(DRIVER_PERIOD, "control period")  # of pilots and log alike [ticks]

_UNIT: Final = (
    ("x", "m", "position east"),
    ("y", "m", "position north"),
    ("psi", "rad", "yaw, continuous"),
    ("v_x", "m/s", "forward speed"),
    ("v_y", "m/s", "lateral speed of the frame's origin, + left"),
    ("yaw_rate", "rad/s", "yaw rate"),
    ("roll", "rad", "roll of the body in W"),
    ("load_transfer", "-", "right less left wheel loads over their sum"),
)
_WHOLE: Final = (
    Signal("steer_tractor", "rad", "road-wheel angle of the first steered axle, + left"),
    Signal("friction_used_steer", "-", "horizontal over available tyre force, all wheels of the first steered axle"),
    Signal("friction_used_max", "-", "largest share of the available friction that any tyre uses"),
    Signal("wheel_load_min", "N", "smallest vertical load of any wheel"),
)


class Pilot(Protocol):
    """Whoever steers and holds the speed; pure, memory in and memory out."""

    def init(self) -> Any:
        """Memory before the first step."""
        ...

    def step(self, memory: Any, truth: Truth) -> tuple[Any, VehicleCommand]:
        """New memory and the command until the next step."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drive:
    """What a combination did."""

    outcome: str  # "completed" or what befell it
    log: Log


def drive(
    vehicle: Vehicle,
    surface: Surface,
    pilot: Pilot,
    *,
    speed: float,
    done: Callable[[Truth], bool],
    patience: float,
) -> Drive:
    """The combination driven from the origin along +x, rolling straight at ``speed`` [m/s] to begin with.

    Args:
        vehicle: the combination.
        surface: the ground; there is no road to leave.
        pilot: steers, every ``PERIOD``.
        speed: at the start [m/s].
        done: whether the manoeuvre is over.
        patience: how long it may take at most [s].
    """
    plant, referee = Plant(vehicle, surface), Referee(vehicle)
    state, memory, lifted = plant.initial_state(Pose2(0.0, 0.0, 0.0), speed), pilot.init(), referee.init()
    truths: list[Truth] = []
    outcome: str | None = None
    while outcome is None:
        truth = plant.observe(state, len(truths) * PERIOD)
        truths.append(truth)
        memory, command = pilot.step(memory, truth)
        lifted, outcome = referee.step(lifted, truth)
        if outcome is None and done(truth):
            outcome = "completed"
        elif outcome is None and truth.tick * TICK > patience:
            outcome = "timed out"
        try:
            state = plant.step(state, command, PERIOD)
        except DivergedError:
            outcome = "diverged"
    return Drive(outcome=outcome, log=drive_log(vehicle, truths))


def drive_log(vehicle: Vehicle, truths: Sequence[Truth]) -> Log:
    """The log of a drive, a row for each of the truths, in the names of a run's log."""
    units = [unit.name for unit in vehicle.units]
    tractor = vehicle.units[0]
    first = tractor.axles.index(tractor.steered_axles[0])
    wheels = slice(2 * first, 2 * first + 2)  # wheels are listed axle by axle, tractor first
    rows = np.array([list(_values(truth, wheels)) for truth in truths])
    per_unit = tuple(Signal(f"{name}_{u}", unit, f"{u}: {meaning}") for u in units for name, unit, meaning in _UNIT)
    return Log((Signal("time", "s", "time"), *per_unit, *_WHOLE), rows)


def _values(truth: Truth, wheels: slice) -> Iterator[float]:
    yield truth.tick * TICK
    for pose, velocity, X_WB, transfer in zip(
        truth.poses, truth.velocities, truth.bodies, truth.load_transfer, strict=True
    ):
        yield from pose
        yield from velocity
        yield float(np.arctan2(X_WB[2, 1], X_WB[2, 2]))
        yield float(transfer)
    yield float(truth.steer[0])
    yield float(np.average(truth.friction_used[wheels], weights=truth.wheel_loads[wheels]))
    yield float(truth.friction_used.max())
    yield float(truth.wheel_loads.min())
