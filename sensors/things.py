"""What stands beside the road: trees, bushes, hedges, rocks, houses, posts and kerb stones, built from shapes.

Every builder draws its irregularities from the generator it is given; sizes are those of the real things [m].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sensors.shapes import Mesh, blob, box, grid_faces, joined, pole, polygon, smooth_normals

Colour = tuple[float, float, float]
WHITE: Colour = (1.0, 1.0, 1.0)
KERB_LENGTH = 0.914  # a British kerb stone, BS EN 1340 [m]
HEDGE_LENGTH = 4.0  # [m]
FENCE_LENGTH = 2.5  # [m]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Part:
    """One mesh of a thing with the texture that covers it."""

    mesh: Mesh
    texture: str  # a key of World.textures
    colour: Colour = WHITE  # multiplies the texture


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Thing:
    """A kind of object, of which many stand around."""

    name: str
    parts: tuple[Part, ...]
    variety: float  # spread of brightness between individuals, 0..1

    @property
    def radius(self) -> float:
        """Radius [m] of the upright cylinder that holds the thing."""
        return max(part.mesh.radius for part in self.parts)


def broadleaf(rng: np.random.Generator, colour: Colour) -> Thing:
    """A round-crowned tree of some 8 m: a crown of overlapping lumps on a stem."""
    lumps = [blob(rng, (0.0, 0.0, 5.4), (1.9, 1.9, 1.9), rings=6, sides=9, roughness=0.13)]
    for azimuth in np.arange(7) * 2.4 + rng.uniform(0.0, 6.0):  # the golden angle leaves no gap and no row
        r, z, size = rng.uniform(0.9, 1.7), rng.uniform(3.7, 6.7), rng.uniform(0.9, 1.4)
        centre = (r * np.cos(azimuth), r * np.sin(azimuth), z)
        lumps.append(blob(rng, centre, (size, size, 0.85 * size), roughness=0.16))
    stem = pole((0.24, -0.5), (0.13, 4.4), sides=7)
    crown = Part(mesh=joined(*lumps), texture="foliage", colour=colour)
    return Thing(name="broadleaf", parts=(Part(mesh=stem, texture="bark"), crown), variety=0.25)


def conifer(rng: np.random.Generator) -> Thing:
    """A spruce of some 9 m: ragged skirts of twigs one above the other."""
    tiers = []
    for z, radius in zip(np.linspace(1.0, 7.6, 7), np.linspace(2.0, 0.45, 7), strict=True):
        tiers.append(_skirt(rng, float(z), float(radius)))
    stem = pole((0.2, -0.5), (0.12, 2.0), sides=6)
    twigs = Part(mesh=joined(*tiers), texture="foliage", colour=(0.55, 0.68, 0.62))
    return Thing(name="conifer", parts=(Part(mesh=stem, texture="bark"), twigs), variety=0.2)


def _skirt(rng: np.random.Generator, z: float, radius: float) -> Mesh:
    """One tier of a conifer: a cone with a ragged rim, closed below by a flatter one."""
    sides = 11
    profile = np.array([(0.0, 0.10), (0.75, -0.05), (1.0, -0.12), (0.45, 0.60), (0.0, 1.35)])  # reach, height / radius
    angle = np.linspace(0.0, 2.0 * np.pi, sides + 1)
    ragged = rng.uniform(0.72, 1.12, size=sides + 1)
    ragged[-1] = ragged[0]
    reach = profile[:, :1] * ragged * radius
    height = np.broadcast_to(z + profile[:, 1:] * radius, reach.shape)
    vertices = np.stack([reach * np.cos(angle), reach * np.sin(angle), height], axis=-1).reshape(-1, 3)
    faces = grid_faces(len(profile), sides + 1)[:, ::-1].copy()
    return Mesh(
        vertices=vertices,
        normals=smooth_normals(vertices, faces),
        uv=np.stack(np.broadcast_arrays(3.0 * angle / np.pi, profile[:, 1:]), axis=-1).reshape(-1, 2) + rng.uniform(size=2),
        shade=(0.35 + 0.65 * profile[:, :1] * ragged / 1.12).ravel(),
        faces=faces,
    )


def bush(rng: np.random.Generator) -> Thing:
    """A bush of some 1.3 m."""
    lumps = []
    for azimuth in np.arange(4) * 2.4:
        size = rng.uniform(0.45, 0.7)
        centre = (0.4 * np.cos(azimuth), 0.4 * np.sin(azimuth), 0.8 * size)
        lumps.append(blob(rng, centre, (size, size, 0.95 * size), sides=7, texture_size=1.0))
    return Thing(name="bush", parts=(Part(mesh=joined(*lumps), texture="foliage"),), variety=0.3)


def rock(rng: np.random.Generator) -> Thing:
    """A boulder of half a metre, sunk into the ground."""
    lump = blob(rng, (0.0, 0.0, 0.1), (0.55, 0.4, 0.36), sides=7, roughness=0.12, texture_size=1.2)
    return Thing(name="rock", parts=(Part(mesh=lump, texture="stone", colour=(0.8, 0.78, 0.74)),), variety=0.2)


def hedge(rng: np.random.Generator) -> Thing:
    """One length of a clipped hedge along x, 1.5 m high, uneven as hedges are."""
    lumps = []
    for x in np.linspace(-0.5, 0.5, 5) * (HEDGE_LENGTH - 1.0):
        lumps.append(blob(rng, (float(x), 0.0, 0.6), (0.85, 0.65, 0.95), sides=7, roughness=0.10, texture_size=1.1))
    part = Part(mesh=joined(*lumps), texture="foliage", colour=(0.8, 0.88, 0.75))
    return Thing(name="hedge", parts=(part,), variety=0.1)


def fence() -> Thing:
    """One length of a wooden fence along x: a post and two rails."""
    half = FENCE_LENGTH / 2
    post = box((-0.06, 0.06), (-0.06, 0.06), (-0.5, 1.15), texture_size=0.8)
    rails = [box((-half, half), (0.06, 0.10), (z, z + 0.12), texture_size=0.8) for z in (0.45, 0.90)]
    return Thing(name="fence", parts=(Part(mesh=joined(post, *rails), texture="planks"),), variety=0.15)


def marker_post() -> Thing:
    """A white delineator with its black band, 1.1 m high."""
    mesh = box((-0.06, 0.06), (-0.05, 0.05), (-0.3, 1.1), texture_size=1.2)
    return Thing(name="marker_post", parts=(Part(mesh=mesh, texture="banded"),), variety=0.08)


def lamp() -> Thing:
    """A street lamp of 7 m with a short arm."""
    stem = pole((0.09, -0.3), (0.05, 7.0), sides=8)
    arm = box((-0.04, 1.4), (-0.04, 0.04), (6.94, 7.02), texture_size=1.0)
    head = box((0.9, 1.6), (-0.12, 0.12), (6.86, 7.0), texture_size=1.0)
    part = Part(mesh=joined(stem, arm, head), texture="stone", colour=(0.62, 0.65, 0.66))
    return Thing(name="lamp", parts=(part,), variety=0.05)


def bend_sign() -> Thing:
    """A chevron board on two posts, 2 m wide, readable from both sides."""
    posts = [box((-0.04, 0.04), (y - 0.04, y + 0.04), (-0.4, 1.5), texture_size=1.0) for y in (-0.7, 0.7)]
    board = box((-0.06, -0.03), (-1.0, 1.0), (0.75, 1.45), texture_size=0.7)
    back = box((0.03, 0.06), (-1.0, 1.0), (0.75, 1.45), texture_size=0.7)
    metal = Part(mesh=joined(*posts), texture="stone", colour=(0.55, 0.56, 0.57))
    return Thing(name="bend_sign", parts=(metal, Part(mesh=joined(board, back), texture="chevrons")), variety=0.05)


def kerb_stone() -> Thing:
    """A kerb stone along x, 125 mm wide with its traffic face at -y, standing 100 mm proud, its upper edge chamfered."""
    half = KERB_LENGTH / 2 - 0.004
    low, high, front, back = -0.05, 0.10, -0.01, 0.125
    profile = [(back, low), (back, high), (front + 0.03, high), (front, high - 0.05), (front, low)]  # along -x
    strips = []
    for (y0, z0), (y1, z1) in zip(profile[:-1], profile[1:], strict=True):
        strip = np.array([[-half, y1, z1], [half, y1, z1], [half, y0, z0], [-half, y0, z0]])
        strips.append(polygon(strip, texture_size=0.9))
    ends = [np.array([[x, y, z] for y, z in profile]) for x in (half, -half)]
    caps = [polygon(ends[0], texture_size=0.9, shade=0.5), polygon(ends[1][::-1], texture_size=0.9, shade=0.5)]
    part = Part(mesh=joined(*strips, *caps), texture="stone", colour=(0.95, 0.94, 0.91))
    return Thing(name="kerb_stone", parts=(part,), variety=0.12)


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
    """Two slopes with an overhang all round, seen from above and from below."""
    x, overhang = half_x + 0.35, 0.45
    slope = (ridge - eaves) / half_y
    low, y = eaves - overhang * slope + 0.06, half_y + overhang
    sides = []
    for sign in (1.0, -1.0):
        corners = np.array(
            [[sign * x, sign * y, low], [-sign * x, sign * y, low], [-sign * x, 0.0, ridge + 0.06], [sign * x, 0.0, ridge + 0.06]]
        )
        sides += [polygon(corners, texture_size=3.0), polygon(corners[::-1], texture_size=3.0, shade=0.3)]
    chimney = box((0.3 * half_x, 0.3 * half_x + 0.7), (-0.35, 0.35), (eaves, ridge + 0.7), texture_size=3.0)
    return joined(*sides, chimney)


def _windows(half_x: float, half_y: float, rows: int) -> Mesh:
    """Windows in rows on all four walls, a hand's breadth proud of them."""
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


def wood(rng: np.random.Generator) -> Thing:
    """The edge of a wood seen from afar: 18 m of crowns along x, 7 to 11 m high."""
    crowns = []
    for x in np.linspace(-8.0, 8.0, 7):
        height, width = rng.uniform(7.0, 11.0), rng.uniform(2.2, 3.2)
        centre = (float(x), rng.uniform(-1.5, 1.5), 0.45 * height)
        crowns.append(blob(rng, centre, (width, width, 0.55 * height), rings=4, sides=6, roughness=0.12, texture_size=4.0))
    part = Part(mesh=joined(*crowns), texture="foliage", colour=(0.72, 0.80, 0.70))
    return Thing(name="wood", parts=(part,), variety=0.15)
