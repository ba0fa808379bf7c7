"""A virtual driver at the trailer's rear: PID with preview on the off-tracking error.

Cheng, Roebuck, Odhams and Cebon's scheme as de Saxe & Cebon 2018 describe it: a driver sits at the follow point and
steers it onto the path of the hitch by proportion, integral and derivative of the off-tracking that he sees some way
ahead. With the no-slip estimate (off_tracking = kinematic) it is Cheng's controller; with a measured off-tracking it is
Miao's reformulation, which does not mind slip. Gains are not published. Derived here:

- the driver turns one angle delta, of an axle in the place of the whole group: x_c = sum(x_i^2)/sum(x_i), where equal
  angles of all axles have their moment; the group then turns about a common centre with the same moment;
- on a circle of radius R a trailer that follows perfectly needs delta = -(x_c - L_f/2)/R, while the path at the
  distance p ahead of the follow point lies at -p (L_f - p)/(2 R) beside the axis. So the proportion
  2 (x_c - L_f/2)/(p (L_f - p)) needs no error in a steady turn: ``gain`` is in multiples of it.

With the kinematic estimate the law does what that says, and that knows nothing of a tractor that slides: where the
driven axle is at the limit of its friction (0.2, uphill on a cross-fall of 5 %) it goes downhill with the hitch, the
estimate is 1.3 m off before the trailer is steered at all, and the rear is steered 2 m off its path. Path preview does
the same by that estimate, and neither does by a measured one. A shorter preview makes the proportion larger: at 0.7 m
the combination leaves the road there.
"""

from __future__ import annotations

import math
from typing import ClassVar, NamedTuple

import numpy as np

from controllers.trailer import SteerCommand, SteeringLaw, TrailerGeometry
from controllers.trailer_steering.kinematics import AxleGroup, held
from controllers.trailer_steering.limits import check_steered, reachable
from estimators.estimates import Health, OffTracking
from estimators.off_tracking.hitch_path import crossing
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.frames import FloatArray
from vehicle.option import Option, check_options
from vehicle.polyline import arc_length

_CREEP = 0.2  # slower than this, or backwards, the law has no meaning and the axles stay where they are [m/s]
_SMOOTHING = 0.5  # low-pass on the derivative of the error [m]
_LEAST_LEVER = 0.5  # of x_c - L_f/2 in the proportional gain, for groups about the middle [m]
_MOST_BIAS = 0.15  # of the integral: slip on ice, and some more [rad]


class VirtualDriverMemory(NamedTuple):
    """What the law carries from one step to the next."""

    tick: int | None  # of the last step; None before the first
    seen: OffTracking | None  # newest usable estimate
    error: float  # previewed error then [m]
    slope: float  # its derivative over the way, low-passed [-]
    bias: float  # integral part [rad]
    demand: tuple[float, ...]  # last command [rad]


class VirtualDriver(SteeringLaw[VirtualDriverMemory]):
    """Angles by which a driver at the rear would steer the follow point onto the path."""

    options: ClassVar[tuple[Option, ...]] = (
        Option("preview", 1.5, "distance ahead of the follow point at which the driver looks", "m", 0.2, 6.0),
        Option("gain", 1.0, "proportional part; 1: a steady turn needs no error", "-", 0.0, 5.0),
        Option("integral", 0.02, "angle per error and metre travelled", "rad/m2", 0.0, 0.5),
        Option("derivative", 0.1, "angle per change of the error over the distance travelled", "rad", 0.0, 3.0),
    )

    def __init__(
        self,
        trailer: TrailerGeometry,
        *,
        preview: float = 1.5,
        gain: float = 1.0,
        integral: float = 0.02,
        derivative: float = 0.1,
    ) -> None:
        """A controller for the trailer; ``options`` describes the parameters.

        Raises:
            ValueError: if the trailer has no steered axle, or a parameter is outside its limits.
        """
        check_steered("virtual_driver", trailer)
        given = {"preview": preview, "gain": gain, "integral": integral, "derivative": derivative}
        check_options(self.options, given)
        self._trailer, self._axles = trailer, AxleGroup.of(trailer)
        self._preview, self._integral, self._derivative = preview, integral, derivative
        self._x_c = self._axles.second_moment / self._axles.first_moment
        lever = max(self._x_c - 0.5 * trailer.follow_distance, _LEAST_LEVER)
        self._gain = gain * 2.0 * lever / (preview * (trailer.follow_distance - preview))

    def init(self) -> VirtualDriverMemory:
        """Nothing seen yet, wheels straight."""
        straight = (0.0,) * len(self._trailer.steered_distances)
        return VirtualDriverMemory(None, None, 0.0, 0.0, 0.0, straight)

    def step(
        self, memory: VirtualDriverMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[VirtualDriverMemory, SteerCommand]:
        """New memory and command at ``tick``."""
        elapsed = 0.0 if memory.tick is None else (tick - memory.tick) * TICK
        memory, last = memory._replace(tick=tick), np.array(memory.demand)
        if off_tracking is not None and off_tracking.health is not Health.LOST:
            memory = self._noticed(memory, off_tracking)
        wanted, seen = last, memory.seen
        if seen is not None and seen.v_x >= _CREEP:
            error = self._error(seen.path, self._preview + seen.v_x * seen.age(tick))
            wanted = self._angles(seen.hitch_direction, memory, memory.error if error is None else error)
        demand = reachable(self._trailer, last, wanted, elapsed)
        return memory._replace(demand=tuple(demand.tolist())), SteerCommand(angles=demand)

    def _noticed(self, memory: VirtualDriverMemory, seen: OffTracking) -> VirtualDriverMemory:
        """Memory with a new estimate: its error, and what follows for derivative and integral."""
        before, error = memory.seen, self._error(seen.path, self._preview)
        if error is None or (before is not None and seen.tick <= before.tick):
            return memory
        if before is None:
            return memory._replace(seen=seen, error=error)
        way = max(0.0, seen.v_x) * (seen.tick - before.tick) * TICK
        slope, bias = memory.slope, memory.bias
        if way > 0.0:
            share = 1.0 - math.exp(-way / _SMOOTHING)
            slope += share * ((error - memory.error) / way - slope)
        if min(map(abs, memory.demand)) < self._trailer.max_steer - 1e-6:  # it waits while no axle can steer more
            bias = max(-_MOST_BIAS, min(_MOST_BIAS, bias + self._integral * seen.value * way))
        return memory._replace(seen=seen, error=error, slope=slope, bias=bias)

    def _error(self, path: FloatArray, ahead: float) -> float | None:
        """How far beside the axis a path (n, 2) lies ``ahead`` of the follow point [m]; None if it is not that long."""
        x = min(0.0, ahead - self._trailer.follow_distance)
        passed = crossing(path, arc_length(path), x)
        return None if passed is None else passed.y

    def _angles(self, hitch_direction: float, memory: VirtualDriverMemory, error: float) -> FloatArray:
        """Angles (n_steered,) [rad] with the moment of the driver's one angle."""
        angle = self._gain * error + memory.bias + self._derivative * memory.slope
        lead, reach = held(hitch_direction), self._x_c / self._trailer.follow_distance
        follow = (math.tan(held(angle)) - math.tan(lead) * (1.0 - reach)) / reach
        return self._axles.steer_angles(lead, math.atan(follow), 0.0)
