"""A wheel on its axle: how it spins, slips and brakes, for numbers or ``casadi.SX``."""

from __future__ import annotations

from typing import Final, NamedTuple

import casadi as ca

from vehicle.description import Axle, Vehicle
from vehicle.layout import Wheel
from vehicle.multibody import Vector, along, from_unit
from vehicle.tyres import Num, Planar, deflection_rate, force, rolling_speed

_BRAKE_WINDUP: Final = 0.02  # turn over which a brake's holding torque builds up [rad]: 1 cm at the tread
_ROLLING_OMEGA: Final = 0.4  # spin over which rolling resistance builds up [rad/s]: 0.2 m/s
_CLUTCH_OMEGA: Final = 1.0  # below it the clutch slips and the engine's power is no limit [rad/s]


class WheelState(NamedTuple):
    """The states of one wheel and what acts on it."""

    omega: Num  # spin [rad/s]
    deflection: Planar  # of its tyre [-]
    brake_windup: Num  # brake torque acting over brake torque applied, -1 to 1
    delta: Num  # its own road-wheel angle [rad]
    hub: Vector  # velocity along the unit's axes [m/s]
    load: Num  # [N]
    friction: Num  # [-]
    acceleration: Num  # that drive and brake torques stand for [m/s2]


class WheelMotion(NamedTuple):
    """Rates of a wheel's states, the ground's force on its unit, and what there is to tell of it."""

    omega: Num  # [rad/s2]
    deflection: Planar  # [1/s]
    brake_windup: Num  # [1/s]
    force: Vector  # along the unit's axes [N]
    slip_angle: Num  # [rad]
    friction_used: Num  # horizontal force over friction times load [-]


def road_wheel_angle(axle: Axle, y: float, delta: Num) -> Num:
    """Angle [rad] of the wheel y [m] to the left of the axle's middle, whose own angle is ``delta``.

    The wheels' axes meet at ``ackermann_x``: tan = t / (1 - y t / (x - ackermann_x)), with t = tan(delta).
    """
    if axle.ackermann_x is None:
        return delta
    t = ca.tan(delta)
    return ca.atan(t / (1.0 - y * t / (axle.x - axle.ackermann_x)))


def wheel_motion(vehicle: Vehicle, wheel: Wheel, s: WheelState) -> WheelMotion:
    """The motion of a wheel in a state."""
    tyre, radius = wheel.axle.tyre, wheel.axle.wheel_radius
    plane = Vector(ca.cos(s.delta), ca.sin(s.delta))
    v = along(plane, s.hub)
    V_s = Planar(s.omega * radius - v.x, -v.y)
    z_rate = deflection_rate(s.deflection, V_s, v.x, s.load, s.friction, tyre)
    F = force(s.deflection, z_rate, s.load, s.friction, tyre)
    brake = wheel.brake_share * vehicle.mass * radius * ca.fmax(-s.acceleration, 0.0)
    rolling_drag = tyre.rolling_resistance * s.load * radius * ca.tanh(s.omega / _ROLLING_OMEGA)
    torque = _drive_torque(vehicle, wheel, s) - brake * s.brake_windup - rolling_drag - radius * F.x
    return WheelMotion(
        omega=torque / wheel.axle.wheel_inertia,
        deflection=z_rate,
        brake_windup=(s.omega - ca.fabs(s.omega) * s.brake_windup) / _BRAKE_WINDUP,
        force=from_unit(plane, Vector(F.x, F.y)),
        slip_angle=ca.atan(v.y / rolling_speed(v.x)),
        friction_used=ca.sqrt(F.x**2 + F.y**2) / (s.friction * s.load),
    )


def _drive_torque(vehicle: Vehicle, wheel: Wheel, s: WheelState) -> Num:
    """Torque [N m] of the driveline, within the engine's power."""
    if wheel.drive_share == 0.0:
        return 0.0
    demanded = vehicle.mass * wheel.axle.wheel_radius * ca.fmax(s.acceleration, 0.0)
    return wheel.drive_share * ca.fmin(demanded, vehicle.drive.max_power / ca.fmax(s.omega, _CLUTCH_OMEGA))
