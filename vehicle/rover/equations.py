"""Equations of motion of a rover on sloping ground, as CasADi expressions.

A rigid body moves on the plane that leans as the ground does under its wheels on average; each wheel feels besides
how the ground under it leans more than that. The rockers spread the load, so that no wheel carries more for unevenness;
the balance of moments of the forces in that plane says how it shifts along and across. Not modelled: moments about the
vertical in a contact, and what the body's own rolling and pitching takes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca

from vehicle.actuators import steer_rate
from vehicle.rover.description import Rover
from vehicle.rover.footprint import Footprint
from vehicle.rover.ground_plane import Plane, plane_under
from vehicle.rover.layout import RoverInput, RoverState
from vehicle.rover.soil import Soil
from vehicle.rover.terramechanics import GRAVITY
from vehicle.rover.wheel import Under, WheelForce, WheelState, ground_force, sinking, slip_rate, spin_up
from vehicle.tyres import Num


class Balance(NamedTuple):
    """What a state leads to at once."""

    rate: RoverState[Num]
    loads: ca.SX  # (n,) [N]


class _Sum(NamedTuple):
    """Forces on the body along its axes [N], and their moment about R's origin [N m]."""

    X: Num
    Y: Num
    M: Num


def balance(
    rover: Rover, footprint: Footprint, soil: Soil | None, s: RoverState[ca.SX], u: RoverInput[ca.SX]
) -> Balance:
    """Time derivative of the state, and the wheels' loads."""
    places = footprint.places
    plane = plane_under(s.psi, u)
    count = len(rover.wheels)
    wheels = [_wheel(rover, s, k, place) for k, place in enumerate(places)]
    under = [Under(soil, u.firm[k], u.friction) for k in range(count)]

    def forces_under(loads: Sequence[Num]) -> list[WheelForce]:
        return [ground_force(rover, *it) for it in zip(under, wheels, loads, strict=True)]

    weight = rover.mass * GRAVITY
    held = _Sum(weight * plane.e_x[2], weight * plane.e_y[2], 0.0)  # the forces of a rover that does not accelerate
    first = _loads(rover, footprint, plane, held)
    loads = _loads(rover, footprint, plane, _sum(places, s, forces_under(first)))
    forces = forces_under(loads)
    felt = [slip_rate(rover, w) for w in wheels]
    sunk = [sinking(rover, *it) for it in zip(under, wheels, loads, (force.lift for force in forces), strict=True)]
    rate = _motion(rover, plane, s, _leaning(places, plane, loads, _sum(places, s, forces)))
    return Balance(
        rate._replace(
            wheel_speed=ca.vertcat(
                *(
                    spin_up(rover, s.wheel_speed[k], u.wheel_speed[k], force.torque, driven=rover.wheels[k].driven)
                    for k, force in enumerate(forces)
                )
            ),
            turn=s.wheel_speed,
            steer=ca.vertcat(*(_steering(rover, k, s.steer[k], u.steer[k]) for k in range(count))),
            slip_x=ca.vertcat(*(x for x, _ in felt)),
            slip_y=ca.vertcat(*(y for _, y in felt)),
            sinkage=ca.vertcat(*sunk),
        ),
        ca.vertcat(*loads),
    )


def _wheel(rover: Rover, s: RoverState[ca.SX], k: int, place: tuple[Num, Num]) -> WheelState:
    p_x, p_y = place
    v_x, v_y = s.v_x - s.yaw_rate * p_y, s.v_y + s.yaw_rate * p_x
    c, d = ca.cos(s.steer[k]), ca.sin(s.steer[k])
    along, across = v_x * c + v_y * d, v_y * c - v_x * d
    return WheelState(rover.radius * s.wheel_speed[k], along, across, s.slip_x[k], s.slip_y[k], s.sinkage[k])


def _sum(places: Sequence[tuple[Num, Num]], s: RoverState[ca.SX], forces: Sequence[WheelForce]) -> _Sum:
    """What the ground does to all wheels together, in the plane."""
    whole = _Sum(0.0, 0.0, 0.0)
    for k, (force, (p_x, p_y)) in enumerate(zip(forces, places, strict=True)):
        c, d = ca.cos(s.steer[k]), ca.sin(s.steer[k])
        X, Y = force.F_x * c - force.F_y * d, force.F_x * d + force.F_y * c
        whole = _Sum(whole.X + X, whole.Y + Y, whole.M + p_x * Y - p_y * X)
    return whole


def _leaning(places: Sequence[tuple[Num, Num]], plane: Plane, loads: Sequence[Num], whole: _Sum) -> _Sum:
    """The same with what pushes wheels down that stand steeper than the plane."""
    for load, lean, (p_x, p_y) in zip(loads, plane.leans, places, strict=True):
        X, Y = -load * lean.along, -load * lean.across
        whole = _Sum(whole.X + X, whole.Y + Y, whole.M + p_x * Y - p_y * X)
    return whole


def _loads(rover: Rover, footprint: Footprint, plane: Plane, whole: _Sum) -> list[Num]:
    """Loads [N] that balance the moments of the ground's forces about the mass centre."""
    N = rover.mass * GRAVITY * plane.upright
    return footprint.loads(N, N * rover.cg_x - whole.X * rover.cg_height, -whole.Y * rover.cg_height)


def _motion(rover: Rover, plane: Plane, s: RoverState[ca.SX], whole: _Sum) -> RoverState[Num]:
    """Rates of the body's six states; of the others none."""
    e_x, e_y = plane.e_x, plane.e_y
    a_x = whole.X / rover.mass - GRAVITY * e_x[2]  # of the centre of gravity
    a_y = whole.Y / rover.mass - GRAVITY * e_y[2]
    yaw = (whole.M - rover.cg_x * whole.Y) / rover.yaw_inertia
    return RoverState(
        x=s.v_x * e_x[0] + s.v_y * e_y[0],
        y=s.v_x * e_x[1] + s.v_y * e_y[1],
        psi=s.yaw_rate * plane.upright / (e_x[0] ** 2 + e_x[1] ** 2),  # turns of e_x about the normal, seen from above
        v_x=a_x + s.yaw_rate * (s.v_y + rover.cg_x * s.yaw_rate),
        v_y=a_y - rover.cg_x * yaw - s.yaw_rate * s.v_x,
        yaw_rate=yaw,
        wheel_speed=0.0,
        turn=0.0,
        steer=0.0,
        slip_x=0.0,
        slip_y=0.0,
        sinkage=0.0,
    )


def _steering(rover: Rover, k: int, angle: Num, demand: Num) -> Num:
    if not rover.wheels[k].steered:
        return 0.0
    return steer_rate(angle, demand, lag=rover.steer_lag, limit=rover.steer_limit, rate_limit=rover.steer_rate_limit)
