"""Tyres: laws of the steady force, one a module, and the elastic carcass that all of them act through."""

from vehicle.tyres.bristle import (
    ROLLING_SPEED_FLOOR,
    Contact,
    Grip,
    Num,
    Planar,
    contact,
    deflection_rate,
    push,
    rolling_speed,
)
from vehicle.tyres.laws import grip, steady_force, stiffness

__all__ = [
    "ROLLING_SPEED_FLOOR",
    "Contact",
    "Grip",
    "Num",
    "Planar",
    "contact",
    "deflection_rate",
    "grip",
    "push",
    "rolling_speed",
    "steady_force",
    "stiffness",
]
