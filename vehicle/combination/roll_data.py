"""Data of springs in roll: of axles, bodies and couplings, as a vehicle file gives them."""

from __future__ import annotations

import math
from typing import Annotated, Final

from vehicle.quantities import Flag, Frozen, Inertia, quantity

_DEGREE: Final = math.pi / 180.0  # [rad]; a product, as numbers of a vehicle may be symbols
_STIFFNESS: Final = "1e4 is a car's axle, and at 1e7 an axle is rigid beside its tyres"


class Suspension(Frozen):
    """Springs of one axle in roll, and its tyres under load: the table ``suspension`` of an axle."""

    roll_stiffness: Annotated[float, quantity("N m/rad", ge=1e4, le=1e7, why=_STIFFNESS)]  # springs and stabiliser
    roll_centre_height: Annotated[
        float, quantity("m", ge=0.01, le=2.0, why="roll centres lie between the ground and the top of the wheels")
    ]
    tyre_stiffness: Annotated[  # vertical, of one wheel; of both tyres of a twin wheel
        float, quantity("N/m", ge=5e4, le=1e7, why="1.5e5 is a car's tyre, 2e6 a twin wheel of a truck")
    ]
    roll_damping: (
        Annotated[float, quantity("N m s/rad", ge=3e2, le=1e6, why="1e3 is a car's axle, 1e5 one of a heavy truck")]
        | None
    ) = None  # None for all axles of a unit: by its ``suspension_damping``
    at_front: Flag = False  # the unit's frame twists between this axle and the others

    def tyre_roll_stiffness(self, track: float, twin_spacing: float | None) -> float:
        """Roll stiffness of the axle on its tyres [N m/rad], with the spacing of twin tyres if it is given [m]."""
        squares = track**2 if twin_spacing is None else track**2 + twin_spacing**2
        return 0.5 * self.tyre_stiffness * squares


class RollBody(Frozen):
    """A unit's body in roll: its table ``roll``."""

    inertia: Inertia  # about the axis along the body through its centre of gravity
    frame_stiffness: (
        Annotated[
            float, quantity("N m/rad", ge=1e4, le=1e8, why="a ladder frame has some 1e5 to 1e6; leave out a rigid body")
        ]
        | None
    ) = None  # twist between front support (axles ``at_front`` or the fifth wheel) and rear; None: rigid


class Coupling(Frozen):
    """The fifth wheel under a unit's front end: its table ``coupling``. Without it, the hitch rolls freely."""

    roll_stiffness: Annotated[float, quantity("N m/rad", ge=1e4, le=1e8, why=_STIFFNESS)]
    plate_width: Annotated[  # over which it presses on the trailer's plate
        float, quantity("m", ge=0.1, le=3.0, why="fifth wheels are 0.6 m to 1 m wide, turntables as wide as the unit")
    ]
    lash_deg: Annotated[float, quantity("deg", ge=0.0, le=20.0, why="the kingpin catches a trailer that separates")]

    @property
    def lash(self) -> float:
        """Angle between separation and the kingpin's catch [rad]."""
        return _DEGREE * self.lash_deg
