"""Slip of a tractor's rear axle due to tyres that scrub, from the data sheet.

Axles of a group can not all roll: in a curve, and when some of them are steered, their tyres push against each other
and turn the trailer. The hitch holds against that, and its force pushes the tractor's rear axle to the side. A
semitrailer with steered axles in a tight bend causes 16 mrad, as much as the bend's own lateral force.

With linear tyres F_i = -C_i (u + kappa x_i - delta_i), where u is the unknown slip at the unit's front, kappa the
curvature of its path, and x_i the position of axle i. The moments about the front hitch determine u, then the forces at
the front hitch follow, unit by unit from the steered trailer to the tractor. Forces of inertia and gravity are left
out; they are in proportion to the lateral acceleration, which includes the gravity along the axles of a banked road.

The signals have the angles of one trailer. Steered axles of those ahead of it point where they travel, for that is what
they are steered for.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from estimators.hitch_motion import hitch_motions
from sensors.messages import CombinationSignals
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.unit import Axle
from vehicle.frames import limited_angle

_LEAN = 0.07  # lean of a laden trailer's body per lateral acceleration: 4 deg/g
_MOST_STEER = 0.8  # angle of an axle that follows its direction of travel [rad]
_LEAST_SPEED = 0.5  # curvature is yaw rate over speed, and noise at rest [m/s]


class _Tyres(NamedTuple):
    """Tyres of one axle."""

    x: float  # [m]
    load: float  # of the axle [N]
    stiffness: float  # of the axle [N/rad]
    steered: bool

    @classmethod
    def of(cls, axle: Axle, load: float) -> "_Tyres":
        return cls(axle.x, load, float(axle.tyre.stiffness(0.5 * load).y) * load, axle.steered)

    @property
    def arm(self) -> float:
        """Moment about the unit's origin per slip angle [N m/rad]."""
        return self.stiffness * self.x


class _Motion(NamedTuple):
    """Motion of a unit."""

    v_x: float  # along its axis [m/s]
    direction: float  # tangent of its direction of travel at the origin, + left [-]
    curvature: float  # of its path [1/m]


class TyreScrub:
    """Nominal slip of the tractor's rear axle due to scrub of its own tyres and those of the trailers."""

    def __init__(self, vehicle: Vehicle, unit: int) -> None:
        """For signals of the towed ``unit``."""
        loads = static_axle_loads(vehicle)
        self._units = [list(map(_Tyres.of, ahead.axles, of)) for ahead, of in zip(vehicle.units, loads, strict=True)]
        self._units = self._units[: unit + 1]
        self._hitches = vehicle.hitch_levers(unit)
        self._arms = sum(tyres.arm for tyres in self._units[-1])
        self._rear = [tyres for tyres in self._units[0] if not tyres.steered]

    def slip(self, signals: CombinationSignals) -> float:
        """Slip angle [rad] of the tractor's rear axle, + to the left."""
        motions, gammas = self._motions(signals), signals.articulation
        force_x, force_y = 0.0, 0.0  # of the unit behind on this one, at its rear hitch [N]
        for unit in range(len(self._units) - 1, 0, -1):
            last = unit == len(self._units) - 1
            axles, motion = self._units[unit], motions[unit]
            angles = _angles(axles, signals.angles.tolist() if last else _travel(axles, motion))
            moment = 0.0 if last else force_y * self._hitches[unit]
            x, y = _forces(axles, angles, motion.curvature, moment)
            c, s = math.cos(gammas[unit - 1]), math.sin(gammas[unit - 1])
            force_x, force_y = c * (x + force_x) + s * (y + force_y), c * (y + force_y) - s * (x + force_x)
        return self._rear_slip(motions[0].curvature, force_y)

    def per_acceleration(self) -> float:
        """Slip angle of the tractor's rear axle per lateral acceleration [rad s2/m] of tyres that carry their load.

        Each tyre takes the part of the side force that is its part of the load.
        """
        stiffness = sum(tyres.stiffness for tyres in self._rear)
        return -sum(tyres.load for tyres in self._rear) / (GRAVITY * stiffness) if self._rear else 0.0

    def rolling(self, signals: CombinationSignals) -> float:
        """Tangent of the trailer's direction of travel at its hitch, + left, that its axles ask for on a straight."""
        axles = self._units[-1]
        angles = _angles(axles, signals.angles.tolist())
        return sum(tyres.arm * math.tan(angle) for tyres, angle in zip(axles, angles, strict=True)) / self._arms

    @property
    def axle_distance(self) -> float:
        """Distance [m] behind the trailer's hitch of the point that its axles let roll."""
        return -sum(tyres.arm * tyres.x for tyres in self._units[-1]) / self._arms

    def trailer_per_acceleration(self) -> float:
        """Slip angle of the trailer's axles per lateral acceleration [rad s2/m], from the moments about its hitch."""
        return -sum(tyres.load * tyres.x for tyres in self._units[-1]) / (GRAVITY * self._arms)

    def bank(self, signals: CombinationSignals) -> float:
        """Pull [m/s2] of a banked road on the trailer, + to the right, as slip feels it: gravity along its axles.

        It is what the accelerometer measures beyond the curve. The body leans out, and the sensor with it.
        """
        motion = self._motions(signals)[-1]
        return signals.lateral_acceleration / (1.0 + _LEAN) - motion.curvature * motion.v_x**2

    def _motions(self, signals: CombinationSignals) -> list[_Motion]:
        """Motion of every unit at its front hitch, the tractor's at its rear axle, without slip of the tractor."""
        rates, gammas = signals.yaw_rates.tolist(), signals.articulation.tolist()
        motions = []
        for v_x, v_y, yaw_rate in hitch_motions(signals.speed, 0.0, self._hitches, rates, gammas):
            least = math.copysign(max(abs(v_x), _LEAST_SPEED), v_x)
            motions.append(_Motion(v_x, v_y / least, yaw_rate / least))
        return motions

    def _rear_slip(self, curvature: float, force_y: float) -> float:
        """Slip at the tractor's origin, from the moments about its foremost axle."""
        if not self._rear:
            return 0.0
        front = self._units[0][0].x
        moment = force_y * (self._hitches[0] - front)
        moment -= sum(tyres.stiffness * tyres.x * curvature * (tyres.x - front) for tyres in self._rear)
        return moment / sum(tyres.stiffness * (tyres.x - front) for tyres in self._rear)


def _forces(axles: Sequence[_Tyres], angles: Sequence[float], curvature: float, moment: float) -> tuple[float, float]:
    """Sum of the tyres' forces [N] along x and y, whose moment about the front hitch balances another one [N m]."""
    arms = [tyres.stiffness * math.cos(angle) * tyres.x for tyres, angle in zip(axles, angles, strict=True)]
    free = [curvature * tyres.x - angle for tyres, angle in zip(axles, angles, strict=True)]
    u = (moment - sum(arm * slip for arm, slip in zip(arms, free, strict=True))) / sum(arms)
    forces = [-tyres.stiffness * (u + slip) for tyres, slip in zip(axles, free, strict=True)]
    x = -sum(force * math.sin(angle) for force, angle in zip(forces, angles, strict=True))
    return x, sum(force * math.cos(angle) for force, angle in zip(forces, angles, strict=True))


def _travel(axles: Sequence[_Tyres], motion: _Motion) -> list[float]:
    """Direction of travel of every steered axle [rad]."""
    tangents = (motion.direction + motion.curvature * tyres.x for tyres in axles if tyres.steered)
    return [limited_angle(math.atan(tangent), _MOST_STEER) for tangent in tangents]


def _angles(axles: Sequence[_Tyres], steered: Sequence[float]) -> list[float]:
    """Angle of every axle [rad]."""
    given = iter(steered)
    return [next(given, 0.0) if tyres.steered else 0.0 for tyres in axles]
