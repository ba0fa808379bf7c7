"""Side force of the wind on the units, for numbers or ``casadi.SX``.

The air flows past a unit with the wind less the unit's own velocity, of the magnitude V and with the component V_y
across the unit. The force is air density / 2 * area * coefficient * V V_y, as side force grows with the sine of the
angle. Not modelled: lift, the shadow of one unit on the next, the growth of the flow after the edge of a gust.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import casadi as ca

from vehicle.combination.description import Vehicle
from vehicle.combination.multibody import Speeds, Vector, along, levers_to, velocity
from vehicle.tyres import Num

_DENSITY: Final = 1.2  # of air [kg/m3], 20 degrees Celsius at sea level
_CALM: Final = 1e-6  # square of a speed [m2/s2]: keeps the root's slope finite


def side_forces(vehicle: Vehicle, e: Sequence[Vector], speeds: Speeds, wind: Sequence[Vector]) -> list[Num]:
    """Force of the wind on each unit, along its y axis [N]; ``wind`` is its velocity at each unit along T [m/s]."""
    forces: list[Num] = []
    for i, unit in enumerate(vehicle.units):
        body = unit.side_wind
        if body is None:
            forces.append(0.0)
            continue
        own = velocity(levers_to(vehicle, i, body.x), e, speeds)
        flow = along(e[i], Vector(wind[i].x - own.x, wind[i].y - own.y))
        magnitude = ca.sqrt(flow.x**2 + flow.y**2 + _CALM)
        forces.append((0.5 * _DENSITY * body.area * body.coefficient) * (magnitude * flow.y))
    return forces
