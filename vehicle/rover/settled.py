"""Static sinkage of a wheel in soil."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import casadi as ca
from scipy.optimize import brentq

from vehicle.rover.description import Rover
from vehicle.rover.soil import Soil
from vehicle.rover.terramechanics import Rolling, soil_force


def settled_sinkage(rover: Rover, soil: Soil, load: float) -> float:
    """Sinkage [m] of a wheel that rolls without slip under a load [N].

    Raises:
        ValueError: if the soil does not carry the load before the wheel is in up to its axle.
    """
    lift = _lift(rover, soil)
    if float(lift(rover.radius)) < load:
        raise ValueError(f"{soil.name} does not carry {load:.1f} N on a wheel of {rover.name}: it sinks to its axle")
    if load <= float(lift(0.0)):
        return 0.0
    sinkage: float = brentq(lambda h: float(lift(h)) - load, 0.0, rover.radius, xtol=1e-9)
    return sinkage


@lru_cache(maxsize=16)
def _lift(rover: Rover, soil: Soil) -> Any:
    h = ca.SX.sym("h")
    return ca.Function("lift", [h], [soil_force(rover, soil, h, Rolling(1.0, 0.0)).F_z])
