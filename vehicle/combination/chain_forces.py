"""Forces on the units of a chain: of the ground, by inertia, and at the hitches, as CasADi expressions."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from vehicle.combination.description import Vehicle
from vehicle.combination.layout import Input, State, Wheel
from vehicle.combination.multibody import Speeds, Vector, acceleration, along, from_unit, levers_to
from vehicle.combination.wheel import WheelMotion
from vehicle.tyres import Num


class GroundForce(NamedTuple):
    """Action of the ground on a unit."""

    force: Vector  # of its tyres, along the tractor's axes [N]
    moment: Num  # of its tyres, about its centre of gravity [N m]
    sides: list[Num]  # of each axle's tyres, along the unit's y axis [N]
    gravity: Vector  # along the ground, along the tractor's axes [m/s2]


def course_of(s: State[ca.SX]) -> Vector:
    """Direction of the tractor's x axis in W."""
    return Vector(ca.cos(s.psi[0]), ca.sin(s.psi[0]))


def ground_forces(
    vehicle: Vehicle,
    layout: tuple[Wheel, ...],
    e: list[Vector],
    rolling: list[WheelMotion],
    s: State[ca.SX],
    u: Input[ca.SX],
) -> list[GroundForce]:
    """Action of the ground on each unit."""
    course = course_of(s)
    axles = list(zip(layout[::2], rolling[::2], rolling[1::2], strict=True))
    forces = []
    for i, unit in enumerate(vehicle.units):
        force = Vector(0.0, 0.0)
        moment: Num = 0.0
        sides: list[Num] = []
        for axle, left, right in (one for one in axles if one[0].unit == i):
            across = left.force.y + right.force.y
            turning = (axle.axle.x - unit.cg_x) * across + axle.y * (right.force.x - left.force.x)
            moment = moment + (turning - (left.moment_opposing + right.moment_opposing))
            force = Vector(force.x + (left.force.x + right.force.x), force.y + across)
            sides.append(across)
        gravity = along(course, Vector(u.gravity_x[i], u.gravity_y[i]))
        forces.append(GroundForce(from_unit(e[i], force), moment, sides, gravity))
    return forces


def specific_forces(
    vehicle: Vehicle, e: list[Vector], speeds: Speeds, rates: Speeds, ground: list[GroundForce]
) -> list[Vector]:
    """Acceleration less gravity at each centre of gravity, along the tractor's axes [m/s2]."""
    specific = []
    for i, unit in enumerate(vehicle.units):
        a = acceleration(levers_to(vehicle, i, unit.cg_x), e, speeds, rates)
        specific.append(Vector(a.x - ground[i].gravity.x, a.y - ground[i].gravity.y))
    return specific


def hitch_forces(
    vehicle: Vehicle, e: list[Vector], specific: list[Vector], ground: list[GroundForce], winds: list[Num]
) -> list[Vector]:
    """Force at the front hitch of each towed unit, along its axes [N], from the balance of the units behind it."""
    forces: list[Vector] = []
    behind = Vector(0.0, 0.0)
    for i in reversed(range(1, len(vehicle.units))):
        mass, tyres = vehicle.units[i].mass, ground[i].force
        behind = Vector(
            mass * specific[i].x - tyres.x + behind.x,
            mass * specific[i].y - tyres.y + behind.y,
        )
        if vehicle.exposed:
            push = from_unit(e[i], Vector(0.0, winds[i]))
            behind = Vector(behind.x - push.x, behind.y - push.y)
        forces.insert(0, along(e[i], behind))
    return forces
