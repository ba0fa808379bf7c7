"""Houses: walls, a gable roof and windows."""

from __future__ import annotations

import numpy as np

from sensors.world.shapes import Mesh, box, joined, polygon
from sensors.world.things import Colour, Part, Thing


def house(*, size: tuple[float, float], eaves: float, walls: str, wall_colour: Colour, rows: int) -> Thing:
    """A house with a gable roof along x; ``size`` is length and width, ``rows`` the number of storeys with windows."""
    half_x, half_y = size[0] / 2, size[1] / 2
    ridge = eaves + 0.8 * half_y
    gables = []
    for sign in (1.0, -1.0):
        x, y = sign * half_x, sign * half_y
        gables.append(polygon(np.array([[x, -y, eaves], [x, y, eaves], [x, 0.0, ridge]]), texture_size=2.4))
    shell = box((-half_x, half_x), (-half_y, half_y), (-1.0, eaves), texture_size=2.4, lid=False)
    parts = [
        Part(mesh=joined(shell, *gables), texture=walls, colour=wall_colour),
        Part(mesh=_roof(half_x, half_y, eaves, ridge), texture="tiles"),
    ]
    if rows:
        parts.append(Part(mesh=_windows(half_x, half_y, rows), texture="window"))
    return Thing(name="house", parts=tuple(parts), variety=0.12)


def _roof(half_x: float, half_y: float, eaves: float, ridge: float) -> Mesh:
    """Two slopes with an overhang all round, visible from above and from below."""
    x, overhang = half_x + 0.35, 0.45
    slope = (ridge - eaves) / half_y
    low, top, y = eaves - overhang * slope + 0.06, ridge + 0.06, half_y + overhang
    sides = []
    for sign in (1.0, -1.0):
        corners = np.array([[x, sign * y, low], [-x, sign * y, low], [-x, 0.0, top], [x, 0.0, top]])
        corners[:, 0] *= sign
        sides += [polygon(corners, texture_size=3.0), polygon(corners[::-1], texture_size=3.0, shade=0.3)]
    chimney = box((0.3 * half_x, 0.3 * half_x + 0.7), (-0.35, 0.35), (eaves, ridge + 0.7), texture_size=3.0)
    return joined(*sides, chimney)


def _windows(half_x: float, half_y: float, rows: int) -> Mesh:
    """Windows in rows on all four walls, 3 cm in front of them."""
    panes = []
    for along, out, yaw in ((half_x, half_y, 0.0), (half_y, half_x, np.pi / 2)):
        count = max(1, int(2 * along / 2.6))
        for place in (np.arange(count) - 0.5 * (count - 1)) * 2.6:
            for storey in range(rows):
                z = 1.0 + 2.7 * storey
                pane = np.array([[-0.55, 0, z], [0.55, 0, z], [0.55, 0, z + 1.3], [-0.55, 0, z + 1.3]])
                for side in (0.0, np.pi):
                    mesh = polygon(pane, texture_size=1.3).moved(by=(float(place), -out - 0.03, 0.0))
                    panes.append(mesh.moved(by=(0.0, 0.0, 0.0), yaw=yaw + side))
    return joined(*panes)
