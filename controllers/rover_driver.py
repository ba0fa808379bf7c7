"""Rover drivers: their interface, and path following on wheels that slip.

The rover travels at the angle ``drift`` to the direction of its wheels. ``heading`` turns the whole body against the
drift, which every rover can. ``crab`` keeps the body along the path and points the wheels against the drift, which
needs steering on all wheels. ``none`` ignores the drift.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal, NamedTuple, Protocol, Self, TypeVar

from controllers.path import Path
from estimators.context import RoverGeometry
from estimators.slip.rover_odometry import RoverPose
from vehicle.clock import elapsed_since
from vehicle.frames import limited_angle, wrap
from vehicle.option import Parameter, PartParameters, quantity
from vehicle.rover.command import RoverCommand

Compensation = Literal["none", "heading", "crab"]

_STEEPEST: Final = 0.6  # turn towards the path at most [rad]
_TIGHTEST: Final = 0.6  # least radius of a yaw demand: the wheelbase [m]
_STEER_RATE: Final = 0.5  # of the demanded wheel angles [rad/s]

Memory = TypeVar("Memory")


@dataclass(frozen=True, slots=True, kw_only=True)
class RoverDriverContext:
    """Everything that a rover driver may know before the run."""

    rover: RoverGeometry
    path: Path
    speed: float  # set speed of the wheels [m/s]
    compensation: Compensation
    options: Mapping[str, Parameter] = field(default_factory=dict)  # by name; those not given keep their defaults


class RoverDriverLike(Protocol[Memory]):
    """A rover driver: pure, memory in and memory out."""

    def init(self) -> Memory:
        """Memory before the first step."""

    def step(self, memory: Memory, pose: RoverPose, /) -> tuple[Memory, RoverCommand]:
        """New memory and command at the tick of the estimated pose."""


class RoverDriverPart(RoverDriverLike[Memory], Protocol[Memory]):
    """A rover driver with its declarations; the class is what the catalogue holds."""

    @classmethod
    def of(cls, context: RoverDriverContext) -> Self:
        """Driver for one run.

        Raises:
            ValueError: one line, if the context does not fit or an option is outside its limits.
        """


class RoverDriverMemory(NamedTuple):
    """State of the driver between two steps."""

    tick: int | None
    station: float  # along the path [m]
    steer: tuple[float, ...]  # last demand [rad]


class RoverDriver(RoverDriverPart[RoverDriverMemory]):
    """Keeps R's origin on a path at a set speed.

    Raises:
        ValueError: if the speed is not positive or above that of the wheels, or if crab is demanded of wheels that are
            not steered.
    """

    class Parameters(PartParameters):
        """Gains of the path follower."""

        approach: float = quantity(  # the default is a rover's length
            0.5, "m", 0.05, 10.0, "distance in which a lateral error falls to 1/e", tune=(0.2, 2.0)
        )
        heading_gain: float = quantity(0.8, "1/s", 0.05, 10.0, "yaw rate per heading error", tune=(0.2, 3.0))

    def __init__(
        self,
        rover: RoverGeometry,
        path: Path,
        speed: float,
        *,
        compensation: Compensation = "none",
        parameters: Parameters | None = None,
    ) -> None:
        """For the set ``speed`` of the wheels [m/s], which slip reduces."""
        given = parameters or self.Parameters()
        if compensation == "crab" and min(rover.max_steer) <= 0.0:
            raise ValueError("slip_compensation = crab needs steered wheels, all of them; use heading")
        fastest = rover.max_wheel_speed * rover.wheel_radius
        if not 0.0 < speed <= fastest:
            raise ValueError(
                f"speed = {speed:g} m/s must be positive and at most {fastest:.3g} m/s, the limit of the wheels"
            )
        self._rover, self._path, self._speed = rover, path, speed
        self._wheels = rover.places().tolist()
        fixed = [x for (x, _), most in zip(self._wheels, rover.max_steer, strict=True) if most <= 0.0]
        self._fixed_x = sum(fixed) / len(fixed) if fixed else 0.0  # mean position of the wheels without steering [m]
        self._approach, self._heading_gain = given.approach, given.heading_gain
        self._heading, self._crab = compensation == "heading", compensation == "crab"

    @classmethod
    def of(cls, context: RoverDriverContext) -> Self:
        """Driver for one run."""
        return cls(
            context.rover,
            context.path,
            context.speed,
            compensation=context.compensation,
            parameters=cls.Parameters.of(context.options, "driving"),
        )

    def init(self) -> RoverDriverMemory:
        """At the start of the path, wheels straight."""
        return RoverDriverMemory(tick=None, station=0.0, steer=(0.0,) * len(self._wheels))

    def step(self, memory: RoverDriverMemory, pose: RoverPose) -> tuple[RoverDriverMemory, RoverCommand]:
        """New memory and command at the pose's tick."""
        station = self._path.project(pose.x, pose.y, memory.station)
        on_path = self._path.pose(station)
        to_path = math.cos(on_path.psi) * (on_path.y - pose.y) - math.sin(on_path.psi) * (on_path.x - pose.x)
        approach = limited_angle(math.atan(to_path / self._approach), _STEEPEST)
        crab = approach - pose.drift if self._crab else 0.0
        aim = on_path.psi + (0.0 if self._crab else approach) - (pose.drift if self._heading else 0.0)
        yaw_rate = self._path.curvature(station) * self._speed + self._heading_gain * wrap(aim - pose.psi)
        fastest = self._speed / _TIGHTEST
        command = self._command(crab, max(-fastest, min(fastest, yaw_rate)))
        elapsed = elapsed_since(memory.tick, pose.tick)
        command = command._replace(steer=_reachable(memory.steer, command.steer, _STEER_RATE * elapsed))
        return RoverDriverMemory(pose.tick, station, command.steer), command

    def _command(self, crab: float, yaw_rate: float) -> RoverCommand:
        """Wheel speeds and angles for travel at the angle ``crab`` [rad] to the heading and a yaw rate [rad/s].

        Steered wheels roll without slip in the rigid motion, and so do unsteered ones on one transverse line. Without
        any steering the rover turns by the difference between the speeds of its sides.
        """
        r, limit = self._rover, self._rover.max_wheel_speed
        if not r.steered:
            half = 0.5 * r.effective_track * yaw_rate
            sides = (self._speed - half, self._speed + half)
            left, right = (max(-limit, min(limit, side / r.wheel_radius)) for side in sides)
            speeds = tuple(left if y > 0.0 else right for _, y in self._wheels)
            return RoverCommand(wheel_speed=speeds, steer=(0.0,) * len(speeds))
        v_x, v_y = self._speed * math.cos(crab), self._speed * math.sin(crab) - yaw_rate * self._fixed_x
        velocities = [(v_x - yaw_rate * y, v_y + yaw_rate * x) for x, y in self._wheels]
        return RoverCommand(
            wheel_speed=tuple(min(limit, math.hypot(*velocity) / r.wheel_radius) for velocity in velocities),
            steer=tuple(
                limited_angle(math.atan2(lateral, forward), most)
                for (forward, lateral), most in zip(velocities, r.max_steer, strict=True)
            ),
        )


def _reachable(last: tuple[float, ...], wanted: tuple[float, ...], reach: float) -> tuple[float, ...]:
    """The wanted angles, changed by at most ``reach`` from the last ones [rad]."""
    return tuple(old + max(-reach, min(reach, new - old)) for old, new in zip(last, wanted, strict=True))
