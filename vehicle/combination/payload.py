"""Payload of a unit: a box of uniform density that is a part of the laden unit of a vehicle file."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from vehicle.quantities import Frozen, Length, Mass, Position, quantity


class Payload(Frozen):
    """The load on a unit, included in the numbers of the laden unit."""

    mass: Mass
    cg_x: Position
    cg_height: Length
    length: Annotated[  # of a box with the load's yaw inertia: beyond the body where the laden unit's inertia needs it
        float, quantity("m", gt=0.0, le=40.0, why="no unit is longer than 40 m")
    ]
    width: Length
    height: Length  # of the box; the load bed lies below its centre by half of it

    @property
    def yaw_inertia(self) -> float:
        """About its own centre of gravity [kg m2]."""
        return self.mass * (self.length**2 + self.width**2) / 12.0

    @property
    def roll_inertia(self) -> float:
        """About its own centre of gravity [kg m2]."""
        return self.mass * (self.width**2 + self.height**2) / 12.0


class Body(NamedTuple):
    """Mass properties of a unit."""

    mass: float  # [kg]
    cg_x: float  # [m]
    cg_height: float  # [m]
    yaw_inertia: float  # about the centre of gravity [kg m2]
    roll_inertia: float | None = None  # the same; None: not known


def without(laden: Body, payload: Payload, removed: float) -> Body:
    """Mass properties without the share ``removed`` of the payload, by the parallel-axis theorem; not checked."""
    gone = removed * payload.mass
    mass = laden.mass - gone
    cg_x = (laden.mass * laden.cg_x - gone * payload.cg_x) / mass
    cg_height = (laden.mass * laden.cg_height - gone * payload.cg_height) / mass
    along = gone * (payload.cg_x - laden.cg_x) ** 2 + mass * (cg_x - laden.cg_x) ** 2
    up = gone * (payload.cg_height - laden.cg_height) ** 2 + mass * (cg_height - laden.cg_height) ** 2
    roll = laden.roll_inertia
    return Body(
        mass,
        cg_x,
        cg_height,
        laden.yaw_inertia - removed * payload.yaw_inertia - along,
        None if roll is None else roll - removed * payload.roll_inertia - up,
    )
