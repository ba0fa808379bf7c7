"""Inputs of a plant step: the command of the controllers, and the ground under the vehicle."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import accumulate, pairwise
from typing import Generic, NamedTuple, TypeVar

import casadi as ca

from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.layout import Input, input_sizes, turned_axles

V = TypeVar("V")  # a part of a vector: numpy array, SX, or its size


class CommandInputs(NamedTuple, Generic[V]):
    """Command of driver and trailer controllers; the field order is the order in the vector."""

    steer: V  # of the tractor's foremost steered axle; linked axles follow by their ratio [rad]
    acceleration: V  # above 0 drives the way the gear does, below 0 brakes [m/s2]
    trailer_steer: V  # of every steered trailer axle, front to rear [rad]
    gear: V  # +1 forward, -1 backward
    drive_torque: V  # (n_axles,) of a further drive on each axle, + forward [N m]; () without ``has_torque_inputs``
    brake_torque: V  # (n_axles,) of a further brake on each axle, not below 0 [N m]; () as above
    brake_share: V  # (n_wheels,) of each brake's torque that acts [-]; () without ``has_failing_brakes``


class GroundInputs(NamedTuple, Generic[V]):
    """Ground under the vehicle; the field order is the order in the vector."""

    friction: V  # (n_wheels,) friction coefficient under each wheel [-]
    slope_x: V  # (N,) rise of the ground under each unit's centre of gravity, along W's x [-]
    slope_y: V  # (N,) along W's y [-]
    road: V  # (n_wheels,) height of the rough road under each wheel above the smooth one [m]
    wind: V  # (N,) velocity of the wind at each unit along W's y [m/s]; () of a vehicle that is not ``exposed``


def command_sizes(vehicle: Vehicle) -> CommandInputs[int]:
    """Length of every part of the vector."""
    n_trailer, of_chain = sum(len(unit.steered_axles) for unit in vehicle.units[1:]), input_sizes(vehicle)
    return CommandInputs(1, 1, n_trailer, 1, of_chain.drive_torque, of_chain.brake_torque, of_chain.brake_share)


def ground_input_sizes(vehicle: Vehicle) -> GroundInputs[int]:
    """Length of every part of the vector."""
    of_chain = input_sizes(vehicle)
    return GroundInputs(of_chain.friction, of_chain.gravity_x, of_chain.gravity_y, of_chain.road, of_chain.wind)


def slices(sizes: Iterable[int]) -> list[slice]:
    """Slices of a vector with parts of these sizes."""
    return [slice(start, stop) for start, stop in pairwise(accumulate(sizes, initial=0))]


def chain_input(vehicle: Vehicle, command: CommandInputs[ca.SX], ground: GroundInputs[ca.SX]) -> Input[ca.SX]:
    """Input of the chain.

    The tractor's actuators turn their first axles by the driver's demand; every trailer actuator takes the mean of the
    demands of its axles.
    """
    tractor = vehicle.units[0]
    trailer_demands = dict(enumerate(ca.vertsplit(command.trailer_steer), start=len(tractor.steered_axles)))
    actuator_demands = [
        *(command.steer / actuator.ratios[0] for actuator in tractor.actuators),
        *(
            sum(trailer_demands[axle] / ratio for axle, ratio in turned) / len(turned)
            for turned in turned_axles(vehicle)[len(tractor.actuators) :]
        ),
    ]
    gravity_x, gravity_y = gravity_along(ground.slope_x, ground.slope_y)
    return Input(
        steer=ca.vertcat(ca.SX(0, 1), *actuator_demands),
        acceleration=command.acceleration,
        gear=command.gear,
        friction=ground.friction,
        gravity_x=gravity_x,
        gravity_y=gravity_y,
        road=ground.road,
        wind=ground.wind,
        drive_torque=command.drive_torque,
        brake_torque=command.brake_torque,
        brake_share=command.brake_share,
    )


def gravity_along(slope_x: ca.SX, slope_y: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Components of gravity along ground of these slopes, along W's x and y [m/s2]."""
    normal = GRAVITY / ca.sqrt(1.0 + slope_x**2 + slope_y**2)
    return -normal * slope_x, -normal * slope_y
