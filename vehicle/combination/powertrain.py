"""Torques of engine and endurance brake at the driven wheels, for numbers or ``casadi.SX``.

The ratio is continuous: the force is limited by that of the lowest gear, then by the power. Differentials are open. A
governor ends the torque of a wheel at the largest speed of its rim: in the gear that belongs to the road speed, or with
traction control, which acts on each wheel by itself, at its slip. Not modelled: shifts.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import casadi as ca

from vehicle.combination.description import Vehicle
from vehicle.combination.layout import Wheel
from vehicle.combination.powertrain_data import AirDrag
from vehicle.tyres import Num

_CLUTCH_OMEGA: Final = 1.0  # below it the clutch slips, and the engine's power does not limit the torque [rad/s]
_LEAST_SPEED: Final = 0.1  # avoids division by zero where the force limits a retarder anyway [m/s]


class DriveTorque(NamedTuple):
    """Torque of the driveline on one wheel."""

    torque: Num  # in the gear's direction if it drives forward [N m]
    per_spin: Num  # by which it falls with the spin at the governor [N m s]


def drive_torque(vehicle: Vehicle, wheel: Wheel, acceleration: Num, gear: Num, omega: Num, v_x: Num) -> DriveTorque:
    """Driving torque on a wheel under a demand [m/s2] behind its lag, within the limits of engine and governor.

    A wheel that still turns the other way is slowed by the slipping clutch, at the demanded torque. ``v_x`` is the
    wheel's velocity along its plane [m/s].
    """
    radius, powertrain = wheel.axle.wheel_radius, vehicle.powertrain
    force = vehicle.mass * ca.fmax(acceleration, 0.0)
    if powertrain is not None:
        force = ca.fmin(force, powertrain.launch_force)
    turning = gear * omega
    available = vehicle.drive.max_power / ca.fmax(turning, _CLUTCH_OMEGA)
    torque = wheel.drive_share * ca.fmin(radius * force, available)
    if powertrain is None:
        return DriveTorque(gear * torque, 0.0)
    travel = ca.fmax(gear * v_x, 0.0)
    if powertrain.traction_control:
        governed = (1.0 + powertrain.traction_slip) * travel + powertrain.traction_slip_speed
    else:
        governed = ca.fmax(powertrain.overspeed * travel, powertrain.lowest_gear_speed)
    per_band = 1.0 / powertrain.governor_band
    room = per_band * (ca.fmin(governed, powertrain.top_speed) - radius * turning)
    open_ = ca.fmax(ca.fmin(room, 1.0), 0.0)
    falling = ca.logic_and(room > 0.0, room < 1.0)
    return DriveTorque(gear * open_ * torque, falling * ((radius * per_band) * torque))


def retards_first(vehicle: Vehicle) -> bool:
    """True if an endurance brake acts before the service brakes."""
    retarder = None if vehicle.powertrain is None else vehicle.powertrain.retarder
    return retarder is not None and retarder.acts_first


def retarding(vehicle: Vehicle, acceleration: Num, v_x: Num) -> Num:
    """Force [N] at all driven treads of an endurance brake that acts first, under a demand [m/s2] at a speed [m/s]."""
    if not retards_first(vehicle):
        return 0.0
    return ca.fmin(-vehicle.mass * ca.fmin(acceleration, 0.0), retarder_capacity(vehicle, v_x))


def retarder_capacity(vehicle: Vehicle, v_x: Num) -> Num:
    """Largest force [N] of the endurance brake at a speed [m/s]; 0 without one."""
    retarder = None if vehicle.powertrain is None else vehicle.powertrain.retarder
    if retarder is None:
        return 0.0
    speed = ca.fabs(v_x)
    building = (retarder.max_force / retarder.full_speed) * speed
    by_power = retarder.max_power / ca.fmax(speed, _LEAST_SPEED)
    return ca.fmin(ca.fmin(building, retarder.max_force), by_power)


def air_drag(air: AirDrag, v_x: Num) -> Num:
    """Force [N] of the air against the motion at a speed [m/s] in still air; it acts on the tractor."""
    return (0.5 * air.density * air.drag_area) * v_x * ca.fabs(v_x)
