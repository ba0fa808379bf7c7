"""A virtual driver at the trailer's rear: PID with preview on the off-tracking error.

Cheng, Roebuck, Odhams and Cebon's scheme as de Saxe & Cebon 2018 describe it: a virtual driver at the follow point
steers it onto the path of the hitch by proportional, integral and derivative action on the off-tracking at some
distance ahead. With the no-slip estimate (off_tracking = kinematic) it is Cheng's controller; with a measured
off-tracking it is Miao's reformulation, which tolerates slip. Gains are not published. Derived here:

- the driver sets one angle delta, of a single axle in place of the group, at x_c = sum(x_i^2)/sum(x_i), where equal
  angles of all axles have their moment; the group then turns about a common centre with the same moment;
- on a circle of radius R, perfect path following needs delta = -(x_c - L_f/2)/R, while the path at the distance p ahead
  of the follow point has the lateral offset -p (L_f - p)/(2 R) from the axis. So the proportional gain
  2 (x_c - L_f/2)/(p (L_f - p)) needs no error in a steady turn: ``gain`` is a multiple of it;
- on rolling axles the trailer's yaw integrates the angle, at v/x_c, and turns the previewed point by L_f - p. So the
  loop crosses over at gain (L_f - p) v/x_c, which grows with speed, while the age of the estimate, the lag of the
  actuators and that of the tyres do not shrink. From the speed on at which the crossover times the sum of these lags
  reaches ``_PHASE``, the gain falls so that it stays there: the margin is the same for every trailer and speed.

The kinematic estimate does not include the slip of a sliding tractor. With the driven axle at its friction limit (0.2,
uphill on a cross-fall of 5 %) the hitch slides downhill, the estimate is wrong by 1.3 m before the trailer is steered
at all, and the rear is steered 2 m off its path. Path preview does the same with that estimate; neither does with a
measured one. A shorter preview makes the gain larger: at 0.7 m the combination leaves the road there.
"""

from __future__ import annotations

import math
from typing import ClassVar, NamedTuple

import numpy as np

from controllers.trailer import SteerCommand, SteeringLaw, TrailerGeometry
from controllers.trailer_steering.kinematics import AxleGroup, limited_direction
from controllers.trailer_steering.limits import check_steered, reachable
from estimators.estimates import Health, OffTracking
from estimators.off_tracking.hitch_path import crossing
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.frames import FloatArray
from vehicle.option import Option, check_options
from vehicle.polyline import arc_length

_CREEP = 0.2  # below this speed, and in reverse, the axles keep their angles [m/s]
_SMOOTHING = 0.5  # low-pass on the derivative of the error [m]
_LEAST_LEVER = 0.5  # of x_c - L_f/2 in the proportional gain, for groups near the middle [m]
_MOST_BIAS = 0.15  # of the integral: slip on ice, with margin [rad]
_PHASE = 0.7  # crossover times lags, at most: 40 deg of the integrator's 90 deg are spent [rad]
# Lags of tyres of the usual kind: they roll half a metre until the force is there, and the force needs to turn the
# trailer's mass, with a cornering stiffness of 4.6 times the load.
_RELAXATION = 0.5  # [m]
_YAW_LAG = 0.022  # over the speed: 1/(4.6 g) [s2/m]


class VirtualDriverMemory(NamedTuple):
    """State of the law between two steps."""

    tick: int | None  # of the last step; None before the first
    estimate: OffTracking | None  # newest usable one
    error: float  # previewed error then [m]
    slope: float  # its derivative over the distance, low-passed [-]
    delay: float  # mean age of the estimate between its arrival and that of the next one [s]
    bias: float  # integral part [rad]
    demand: tuple[float, ...]  # last command [rad]


class VirtualDriver(SteeringLaw[VirtualDriverMemory]):
    """PID with preview on the off-tracking, as by a driver at the rear."""

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
        """Memory without any estimate, wheels straight."""
        straight = (0.0,) * len(self._trailer.steered_distances)
        return VirtualDriverMemory(None, None, 0.0, 0.0, 0.0, 0.0, straight)

    def step(
        self, memory: VirtualDriverMemory, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[VirtualDriverMemory, SteerCommand]:
        """New memory and command at ``tick``."""
        elapsed = 0.0 if memory.tick is None else (tick - memory.tick) * TICK
        memory, last = memory._replace(tick=tick), np.array(memory.demand)
        if off_tracking is not None and off_tracking.health is not Health.LOST:
            memory = self._with_estimate(memory, tick, off_tracking)
        wanted, estimate = last, memory.estimate
        if estimate is not None and estimate.v_x >= _CREEP:
            error = self._error(estimate.path, self._preview + estimate.v_x * estimate.age(tick))
            share = self._share(estimate.v_x, memory.delay)
            wanted = self._angles(estimate.hitch_direction, memory, memory.error if error is None else error, share)
        demand = reachable(self._trailer, last, wanted, elapsed)
        return memory._replace(demand=tuple(demand.tolist())), SteerCommand(angles=demand)

    def _with_estimate(self, memory: VirtualDriverMemory, tick: int, estimate: OffTracking) -> VirtualDriverMemory:
        """Memory with a new estimate: error, derivative and integral."""
        before, error = memory.estimate, self._error(estimate.path, self._preview)
        if error is None or (before is not None and estimate.tick <= before.tick):
            return memory
        if before is None:
            return memory._replace(estimate=estimate, error=error)
        interval = (estimate.tick - before.tick) * TICK
        distance = max(0.0, estimate.v_x) * interval
        slope, bias, delay = memory.slope, memory.bias, estimate.age(tick) + 0.5 * interval
        if distance > 0.0:
            share = 1.0 - math.exp(-distance / _SMOOTHING)
            slope += share * ((error - memory.error) / distance - slope)
        if min(map(abs, memory.demand)) < self._trailer.max_steer - 1e-6:  # else it waits at the limit of all axles
            integral = self._share(estimate.v_x, delay) ** 2 * self._integral  # it stays as far below the crossover
            bias = max(-_MOST_BIAS, min(_MOST_BIAS, bias + integral * estimate.value * distance))
        return memory._replace(estimate=estimate, error=error, slope=slope, delay=delay, bias=bias)

    def _share(self, speed: float, delay: float) -> float:
        """Share of the gain [-] at a speed [m/s] with estimates of this mean age [s]."""
        speed = max(speed, _CREEP)
        lag = delay + self._trailer.actuator_lag + _RELAXATION / speed + _YAW_LAG * speed
        crossover = self._gain * (self._trailer.follow_distance - self._preview) / self._x_c * speed
        return min(1.0, _PHASE / (crossover * lag)) if crossover > 0.0 else 1.0

    def _error(self, path: FloatArray, ahead: float) -> float | None:
        """Lateral offset [m] of a path (n, 2) from the axis, ``ahead`` [m] of the follow point; None if too short."""
        x = min(0.0, ahead - self._trailer.follow_distance)
        passed = crossing(path, arc_length(path), x)
        return None if passed is None else passed.y

    def _angles(self, hitch_direction: float, memory: VirtualDriverMemory, error: float, share: float) -> FloatArray:
        """Angles (n_steered,) [rad] with the moment of the virtual driver's single angle."""
        angle = share * self._gain * error + memory.bias + self._derivative * memory.slope
        lead, reach = limited_direction(hitch_direction), self._x_c / self._trailer.follow_distance
        follow = (math.tan(limited_direction(angle)) - math.tan(lead) * (1.0 - reach)) / reach
        return self._axles.steer_angles(lead, math.atan(follow), 0.0)
