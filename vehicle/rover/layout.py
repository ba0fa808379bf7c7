"""Entries of the state and input vectors of the rover's equations."""

from __future__ import annotations

from typing import Generic, NamedTuple, TypeVar

V = TypeVar("V")  # a part of a vector: numpy array, SX, or its size


class RoverState(NamedTuple, Generic[V]):
    """State of a rover with n wheels, in the order of its file."""

    x: V  # of R in W [m]
    y: V  # [m]
    psi: V  # [rad]
    v_x: V  # of R's origin along the body, in the plane of the ground [m/s]
    v_y: V  # across, + left [m/s]
    yaw_rate: V  # about the ground's normal [rad/s]
    wheel_speed: V  # (n,) of rotation, + forward [rad/s]
    turn: V  # (n,) angle rolled since the start [rad]
    steer: V  # (n,) + left [rad]
    slip_x: V  # (n,) lagged slip along the wheel, as slip / (1 + size of slip) [-]
    slip_y: V  # (n,) the same across
    sinkage: V  # (n,) [m]


class RoverInput(NamedTuple, Generic[V]):
    """Demands and ground during a step."""

    wheel_speed: V  # (n,) demanded [rad/s]
    steer: V  # (n,) demanded [rad]
    step: V  # length of a step [s]
    slope_x: V  # (n,) of the ground under each wheel, along W's x [-]
    slope_y: V  # (n,) along W's y [-]
    firm: V  # (n,) 1 where the ground does not give way, else 0
    friction: V  # of firm ground [-]


def state_sizes(n: int) -> RoverState[int]:
    """Sizes of the state's parts for n wheels."""
    return RoverState(1, 1, 1, 1, 1, 1, n, n, n, n, n, n)


def input_sizes(n: int) -> RoverInput[int]:
    """Sizes of the input's parts for n wheels."""
    return RoverInput(n, n, 1, n, n, n, 1)
