"""What the vectors of the rover's equations hold, entry by entry."""

from __future__ import annotations

from typing import Generic, NamedTuple, TypeVar

V = TypeVar("V")  # a part of a vector: numpy array, SX, or its size


class RoverState(NamedTuple, Generic[V]):
    """State of a rover; wheels in the order of ``command.WHEELS``."""

    x: V  # of R in W [m]
    y: V  # [m]
    psi: V  # [rad]
    v_x: V  # of R's origin along the body, in the plane of the ground [m/s]
    v_y: V  # across, + left [m/s]
    yaw_rate: V  # about the ground's normal [rad/s]
    wheel_speed: V  # (4,) of rotation, + forward [rad/s]
    turn: V  # (4,) angle rolled since the start [rad]
    steer: V  # (4,) + left [rad]
    slip_x: V  # (4,) slip that the ground has felt, along the wheel, as slip / (1 + size of slip) [-]
    slip_y: V  # (4,) the same across
    sinkage: V  # (4,) [m]


class RoverInput(NamedTuple, Generic[V]):
    """What acts on a rover during a step."""

    wheel_speed: V  # (4,) demanded [rad/s]
    steer: V  # (4,) demanded [rad]
    step: V  # length of a step [s]
    slope_x: V  # (4,) of the ground under each wheel, along W's x [-]
    slope_y: V  # (4,) along W's y [-]
    firm: V  # (4,) 1 where the ground does not give way, else 0
    friction: V  # of firm ground [-]


STATE_SIZES = RoverState(1, 1, 1, 1, 1, 1, 4, 4, 4, 4, 4, 4)
INPUT_SIZES = RoverInput(4, 4, 1, 4, 4, 4, 1)
