"""Data of driveline, endurance brakes and air drag."""

from __future__ import annotations

from typing import Annotated, Final

from vehicle.quantities import Flag, Frozen, quantity

_FORCE: Final = "1 kN moves a car, 1 MN the heaviest transport"
_POWER: Final = "powers are in W, not kW"


class Retarder(Frozen):
    """Endurance brake on the driven wheels: engine drag, engine brake or retarder.

    If it does not act first, it does a part of the driven axles' own share of a brake demand, so that no force changes.
    """

    max_force: Annotated[float, quantity("N", ge=100.0, le=1e6, why=_FORCE)]  # at the treads
    max_power: Annotated[float, quantity("W", ge=1e3, le=5e6, why=_POWER)]  # at the wheels
    full_speed: Annotated[  # below it the force falls to 0 with the speed
        float, quantity("m/s", ge=0.1, le=20.0, why="an engine drags from walking pace on")
    ]
    acts_first: Flag = False  # it does all that it can, and the service brakes the rest; unstable on slippery ground


class Powertrain(Frozen):
    """Engine and gearbox as a force limit, a power limit (``Drive.max_power``) and a governor; continuous ratio."""

    launch_force: Annotated[float, quantity("N", ge=100.0, le=1e6, why=_FORCE)]  # at the treads in the lowest gear
    lowest_gear_speed: Annotated[  # of the rims at governed engine speed in the lowest gear
        float, quantity("m/s", ge=0.3, le=20.0, why="a crawler gear has 0.3 m/s, a car's first gear 15 m/s")
    ]
    overspeed: Annotated[  # governed engine speed over that at which the gear in use is driven
        float, quantity("-", ge=1.0, le=5.0, why="the governor is above the speed in use; gears span a factor of 2")
    ]
    top_speed: Annotated[  # of the rims in the highest gear at governed engine speed, or at a road speed limiter
        float, quantity("m/s", ge=1.0, le=100.0, why="from a transporter's 4 km/h to 360 km/h")
    ]
    governor_band: Annotated[  # of the rims' speed, over which the torque falls to 0
        float, quantity("m/s", ge=0.1, le=5.0, why="a governor takes a few percent of the engine's speed")
    ]
    traction_control: Flag = True
    traction_slip: Annotated[float, quantity("-", ge=0.01, le=1.0, why="driven tyres have their peak at 0.05 to 0.3")]
    traction_slip_speed: Annotated[  # added to it: for setting off
        float, quantity("m/s", ge=0.1, le=5.0, why="walking pace at most")
    ]
    retarder: Retarder | None = None


class AirDrag(Frozen):
    """Drag of the air on the straight combination."""

    drag_area: Annotated[float, quantity("m2", ge=0.1, le=30.0, why="drag coefficient times frontal area; cars 0.6 m2")]
    density: Annotated[float, quantity("kg/m3", ge=0.5, le=1.6, why="from 8000 m of height to severe frost")]
