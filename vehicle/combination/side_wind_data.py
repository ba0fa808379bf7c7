"""Data of a unit's body in side wind, as a vehicle file gives them."""

from __future__ import annotations

from typing import Annotated

from vehicle.quantities import Frozen, Height, Position, quantity


class SideWind(Frozen):
    """A unit's body in side wind: its table ``side_wind``."""

    area: Annotated[float, quantity("m2", ge=0.5, le=200.0, why="of the side: a car has 4 m2, a trailer of 4 m 45 m2")]
    coefficient: Annotated[  # side force over dynamic pressure, area and sine of the wind's angle to the unit
        float, quantity("-", ge=0.2, le=5.0, why="bodies of vehicles have 0.8 to 2")
    ]
    x: Position  # of the pressure's centre
    height: Height  # of the pressure's centre
