"""Outputs of a vehicle's lateral motion by name, as CasADi expressions.

A name is a kind and a number: of the unit, or of the axle in the whole vehicle, front to rear from 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Final, Literal, get_args

import casadi as ca

from vehicle.combination.chain import output
from vehicle.combination.description import Vehicle
from vehicle.combination.layout import Input, State
from vehicle.combination.multibody import Speeds, acceleration, along, axes, levers_to, velocity
from vehicle.parameter_file import nearest
from vehicle.tyres import Num

OutputKind = Literal[
    "yaw_rate",  # [rad/s]
    "lateral_velocity",  # of each unit's origin, along its y axis [m/s]
    "lateral_acceleration",  # of each centre of gravity, along the unit's y axis [m/s2]
    "articulation",  # of each towed unit: psi of the unit ahead less its own [rad]
    "load_transfer",  # right less left wheel loads of each unit, over their sum [-]
    "axle_position",  # of each axle's middle, to the left of the path [m]
    "follow_position",  # of each follow point, to the left of the path [m]
]
_FROM_PATH: Final = ("axle_position", "follow_position")


def check_outputs(kinds: Sequence[OutputKind], *, path: bool) -> None:
    """Check that the kinds are known, and that there is a path for those measured from it.

    Raises:
        ValueError: naming the first such kind.
    """
    for kind in kinds:
        if kind not in get_args(OutputKind):
            raise ValueError(f"unknown output '{kind}'{nearest(kind, get_args(OutputKind))}")
        if kind in _FROM_PATH and not path:
            raise ValueError(f"output '{kind}' is measured from a path: it needs path=True")


def lateral_outputs(vehicle: Vehicle, s: State[ca.SX], u: Input[ca.SX], rate: State[ca.SX]) -> dict[str, Num]:
    """Every output by name; ``rate`` is the derivative of the state. The path is W's x axis."""
    psi, yaw_rate = ca.vertsplit(s.psi), ca.vertsplit(s.yaw_rate)
    e, speeds = axes(psi), Speeds(s.v_x, s.v_y, yaw_rate)
    rates = Speeds(rate.v_x, rate.v_y, ca.vertsplit(rate.yaw_rate))
    units = list(enumerate(vehicle.units))
    axle_places = [(i, axle.x) for i, unit in units for axle in unit.axles]
    transfer = ca.vertsplit(output(vehicle, s, u).lateral_load_transfer)

    def lateral_position(unit: int, x: float) -> ca.SX:
        return s.y + sum(length * ca.sin(psi[k]) for k, length in levers_to(vehicle, unit, x))

    def lateral_velocity(unit: int, x: float) -> Num:
        return along(e[unit], velocity(levers_to(vehicle, unit, x), e, speeds)).y

    def lateral_acceleration(unit: int, x: float) -> Num:
        return along(e[unit], acceleration(levers_to(vehicle, unit, x), e, speeds, rates)).y

    return {
        **{f"yaw_rate_{i}": r for i, r in enumerate(yaw_rate)},
        **{f"lateral_velocity_{i}": lateral_velocity(i, 0.0) for i, _ in units},
        **{f"lateral_acceleration_{i}": lateral_acceleration(i, unit.cg_x) for i, unit in units},
        **{f"articulation_{i}": ahead - own for i, (ahead, own) in enumerate(pairwise(psi), start=1)},
        **{f"load_transfer_{i}": t for i, t in enumerate(transfer)},
        **{f"axle_position_{k}": lateral_position(i, x) for k, (i, x) in enumerate(axle_places)},
        **{
            f"follow_position_{i}": lateral_position(i, unit.follow_x) for i, unit in units if unit.follow_x is not None
        },
    }
