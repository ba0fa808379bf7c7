"""Initial state of a run, as a CasADi expression."""

from __future__ import annotations

from typing import Final, Generic, NamedTuple, TypeVar

import casadi as ca

from vehicle.combination.description import Vehicle
from vehicle.combination.layout import State, state_sizes, wheels
from vehicle.combination.multibody import Vector, along
from vehicle.combination.plant_inputs import GroundInputs, gravity_along
from vehicle.combination.sprung import settled

V = TypeVar("V")  # a part of a vector: numpy array, SX, or its size


class Start(NamedTuple, Generic[V]):
    """Chosen part of the state; the field order is the order in the vector."""

    x: V  # of To in W [m]
    y: V
    psi: V  # of the straight combination [rad]
    speed: V  # [m/s]


START_SIZES: Final = Start(1, 1, 1, 1)


def rolling_freely(vehicle: Vehicle, start: Start[ca.SX], ground: GroundInputs[ca.SX]) -> State[ca.SX]:
    """State of the straight combination rolling freely, its bodies settled on their springs."""
    sizes = state_sizes(vehicle)
    course = Vector(ca.cos(start.psi), ca.sin(start.psi))
    gravity_x, gravity_y = gravity_along(ground.slope_x, ground.slope_y)
    pulls = [along(course, Vector(gravity_x[i], gravity_y[i])) for i in range(len(vehicle.units))]
    bodies = settled(vehicle, [-pull.x for pull in pulls], [-pull.y for pull in pulls])
    resting = State(*(ca.SX.zeros(size) for size in sizes))
    return resting._replace(
        x=start.x,
        y=start.y,
        psi=ca.repmat(start.psi, sizes.psi, 1),
        v_x=start.speed,
        heave=ca.vertcat(*(attitude.heave for attitude, _ in bodies)),
        pitch=ca.vertcat(*(attitude.pitch for attitude, _ in bodies)),
        roll=ca.vertcat(*(attitude.roll for attitude, _ in bodies)),
        heave_spring=ca.vertcat(*(spring.heave for _, spring in bodies)),
        pitch_spring=ca.vertcat(*(spring.pitch for _, spring in bodies)),
        roll_spring=ca.vertcat(*(spring.roll for _, spring in bodies)),
        omega=ca.vertcat(*(start.speed / wheel.axle.wheel_radius for wheel in wheels(vehicle))),
        brake_windup=ca.repmat(ca.sign(start.speed), sizes.brake_windup, 1),
    )
