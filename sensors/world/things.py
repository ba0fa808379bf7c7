"""Roadside things such as rocks, fences, signs and plants, and the triangle meshes that they are made of.

Sizes are those of real things [m]. The generator passed to a builder decides the irregularities.

Every shape stands on z = 0 and reaches below it, so that it does not float on sloping ground.
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from vehicle.frames import FloatArray

FaceArray = NDArray[np.int32]
_ROUNDING = 1e-6  # of positions [m]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mesh:
    """Triangles, counter-clockwise seen from outside."""

    vertices: FloatArray  # (n, 3) [m]
    normals: FloatArray  # (n, 3) unit length
    uv: FloatArray  # (n, 2) texture coordinates, one repeat of the texture per unit
    shade: FloatArray  # (n,) visible share of the sky, 0 to 1: dark under twigs or eaves
    faces: FaceArray  # (m, 3)

    @property
    def radius(self) -> float:
        """Radius [m] of the smallest vertical cylinder about the origin around the mesh."""
        return float(np.hypot(self.vertices[:, 0], self.vertices[:, 1]).max())

    def moved(self, *, by: tuple[float, float, float], yaw: float = 0.0) -> "Mesh":
        """The mesh turned by ``yaw`` [rad] about z and then shifted."""
        c, s = np.cos(yaw), np.sin(yaw)
        R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return replace(self, vertices=self.vertices @ R.T + np.array(by), normals=self.normals @ R.T)


def joined(*meshes: Mesh) -> Mesh:
    """Several meshes as one."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    return Mesh(
        vertices=np.concatenate([mesh.vertices for mesh in meshes]),
        normals=np.concatenate([mesh.normals for mesh in meshes]),
        uv=np.concatenate([mesh.uv for mesh in meshes]),
        shade=np.concatenate([mesh.shade for mesh in meshes]),
        faces=np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)]).astype(np.int32),
    )


def massed(*lumps: Mesh) -> Mesh:
    """Overlapping closed lumps as one mesh, without the invisible triangles inside of other lumps."""
    outside = []
    for lump in lumps:
        a, b, c = (lump.vertices[lump.faces[:, i]] for i in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        places = np.stack([a, b, c, 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)], axis=1)  # (m, 6, 3)
        hidden = np.zeros(places.shape[:2], dtype=bool)
        for other in lumps:
            if other is not lump:
                hidden[~hidden] = inside(other, places[~hidden])
        kept = lump.faces[(area > _ROUNDING) & ~hidden.all(axis=1)]
        used, faces = np.unique(kept, return_inverse=True)
        outside.append(
            Mesh(
                vertices=lump.vertices[used],
                normals=lump.normals[used],
                uv=lump.uv[used],
                shade=lump.shade[used],
                faces=faces.reshape(-1, 3).astype(np.int32),
            )
        )
    return joined(*outside)


def inside(mesh: Mesh, points: FloatArray) -> NDArray[np.bool_]:
    """Mask of the points (n, 3) inside a closed mesh; those outside its bounding box are sorted out first."""
    low, high = mesh.vertices.min(axis=0) - _ROUNDING, mesh.vertices.max(axis=0) + _ROUNDING
    within: NDArray[np.bool_] = ((points >= low) & (points <= high)).all(axis=1)
    within[within] = _enclosed(mesh, points[within])
    return within


def _enclosed(mesh: Mesh, points: FloatArray) -> NDArray[np.bool_]:
    """Mask of the points (n, 3) from which the solid angle of a closed mesh is the whole sphere.

    Solid angle of a triangle after Van Oosterom and Strackee (1983).
    """
    a, b, c = (mesh.vertices[mesh.faces[:, i]] - points[:, None] for i in range(3))  # (n, m, 3)
    la, lb, lc = (np.linalg.norm(side, axis=-1) for side in (a, b, c))
    volume = (a * np.cross(b, c)).sum(axis=-1)
    spread = la * lb * lc + (a * b).sum(axis=-1) * lc + (b * c).sum(axis=-1) * la + (c * a).sum(axis=-1) * lb
    enclosed: NDArray[np.bool_] = 2.0 * np.arctan2(volume, spread).sum(axis=1) > 2.0 * np.pi
    return enclosed


def grid_faces(rows: int, columns: int) -> FaceArray:
    """Triangles of a lattice of rows x columns vertices, counter-clockwise if columns turn left from rows."""
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    return np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3).astype(np.int32)


def smooth_normals(vertices: FloatArray, faces: FaceArray) -> FloatArray:
    """Unit normals (n, 3): area-weighted mean over the triangles around each vertex."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    per_face = np.cross(b - a, c - a)
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], per_face)
    unit: FloatArray = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return unit


def polygon(corners: FloatArray, *, texture_size: float, shade: float = 1.0) -> Mesh:
    """A flat convex polygon, (n, 3) counter-clockwise; v follows the height, u runs along the first edge."""
    along = (corners[1] - corners[0]) / np.linalg.norm(corners[1] - corners[0])
    normal = np.cross(along, corners[2] - corners[0])
    normal /= np.linalg.norm(normal)
    up = np.cross(normal, along)
    from_first = corners - corners[0]
    n = len(corners)
    return Mesh(
        vertices=corners,
        normals=np.tile(normal, (n, 1)),
        uv=np.stack([from_first @ along, from_first @ up], axis=1) / texture_size,
        shade=np.full(n, shade),
        faces=np.array([[0, i, i + 1] for i in range(1, n - 1)], dtype=np.int32),
    )


def box(
    x: tuple[float, float], y: tuple[float, float], z: tuple[float, float], *, texture_size: float, lid: bool = True
) -> Mesh:
    """An upright box between the given limits [m], without its bottom."""
    foot = np.array([[x[0], y[0]], [x[1], y[0]], [x[1], y[1]], [x[0], y[1]]])
    sides = [
        polygon(
            np.array([[*foot[i], z[0]], [*foot[i - 3], z[0]], [*foot[i - 3], z[1]], [*foot[i], z[1]]]),
            texture_size=texture_size,
        )
        for i in range(4)
    ]
    top = polygon(np.column_stack([foot, np.full(4, z[1])]), texture_size=texture_size)
    return joined(*sides, top) if lid else joined(*sides)


def pole(bottom: tuple[float, float], top: tuple[float, float], *, sides: int, texture_size: float = 1.0) -> Mesh:
    """A tapering upright pole; ``bottom`` and ``top`` are (radius, height) [m]."""
    angle = np.linspace(0.0, 2.0 * np.pi, sides + 1)
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    ends = [circle * radius + np.array([0.0, 0.0, height]) for radius, height in (bottom, top)]
    around = angle / (2.0 * np.pi) * max(1.0, round(2.0 * np.pi * bottom[0] / texture_size))
    return Mesh(
        vertices=np.concatenate(ends),
        normals=np.concatenate([circle, circle]),
        uv=np.concatenate([np.stack([around, np.full_like(angle, end[1] / texture_size)], 1) for end in (bottom, top)]),
        shade=np.ones(2 * len(angle)),
        faces=grid_faces(2, sides + 1)[:, ::-1].copy(),
    )


def blob(
    rng: np.random.Generator,
    centre: tuple[float, float, float],
    radii: tuple[float, float, float],
    *,
    rings: int = 5,
    sides: int = 8,
    roughness: float = 0.15,
    texture_size: float = 1.5,
) -> Mesh:
    """A lumpy ball, for crowns, bushes and rocks."""
    circle, half_circle = np.linspace(0.0, 2.0 * np.pi, sides + 1), np.linspace(np.pi, 0.0, rings + 1)
    polar, azimuth = np.meshgrid(half_circle, circle, indexing="ij")
    lumps = 1.0 + roughness * rng.standard_normal(polar.shape)
    lumps[:, -1] = lumps[:, 0]  # closed all round
    lumps[0], lumps[-1] = lumps[0, 0], lumps[-1, 0]
    direction = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=-1)
    vertices = (direction * lumps[..., None] * np.array(radii) + np.array(centre)).reshape(-1, 3)
    normals = direction.reshape(-1, 3) / np.array(radii)
    uv = np.stack([azimuth * radii[0], (np.pi - polar) * radii[2]], axis=-1).reshape(-1, 2) / texture_size
    return Mesh(
        vertices=vertices,
        normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
        uv=uv + rng.uniform(size=2),
        shade=np.clip(0.72 + 0.33 * direction[..., 2].ravel() + 0.5 * (lumps.ravel() - 1.0), 0.25, 1.0),
        faces=grid_faces(rings + 1, sides + 1)[:, ::-1].copy(),
    )


def cards(rng: np.random.Generator, places: FloatArray, outwards: FloatArray, size: float, shade: FloatArray) -> Mesh:
    """Square cards at places (n, 3) in random attitudes, lit as if they faced ``outwards`` (n, 3): leaves and twigs."""
    n = len(places)
    across = rng.standard_normal((n, 3)) + np.array([0.0, 0.0, 0.01])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    up = np.cross(across, rng.standard_normal((n, 3)))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    half = 0.5 * size * rng.uniform(0.75, 1.25, size=(n, 1))
    corners = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    vertices = [places + half * (s * across + t * up) for s, t in corners]
    first = 4 * np.arange(n)[:, None]
    return Mesh(
        vertices=np.stack(vertices, axis=1).reshape(-1, 3),
        normals=np.repeat(outwards, 4, axis=0),
        uv=np.tile(0.5 + 0.5 * corners, (n, 1)),
        shade=np.repeat(shade, 4),
        faces=np.concatenate([first + np.array([0, 1, 2]), first + np.array([0, 2, 3])]).astype(np.int32),
    )


def scattered_on(rng: np.random.Generator, mesh: Mesh, count: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Random points (count, 3), outward normals (count, 3) and shades (count,), uniform on a mesh's surface."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    face = rng.choice(len(area), size=count, p=area / area.sum())
    weight = rng.dirichlet(np.ones(3), size=count)
    corners = mesh.faces[face]
    normals = np.einsum("ij,ijk->ik", weight, mesh.normals[corners])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    places = np.einsum("ij,ijk->ik", weight, mesh.vertices[corners])
    return places, normals, np.einsum("ij,ij->i", weight, mesh.shade[corners])


Colour = tuple[float, float, float]
WHITE: Colour = (1.0, 1.0, 1.0)
KERB_LENGTH = 0.914  # a British kerb stone, BS EN 1340 [m]
FENCE_LENGTH = 2.5  # [m]
TWIGS_RANGE = 50.0  # farther away twigs are smaller than a pixel [m]
_JOINTS_RANGE = 30.0  # farther away the joints of kerb stones are invisible [m]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Part:
    """One mesh of a thing with the texture that covers it."""

    mesh: Mesh
    texture: str  # a key of World.textures
    colour: Colour = WHITE  # multiplies the texture
    distances: tuple[float, float] = (0.0, math.inf)  # nearest and farthest at which it is drawn [m]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Thing:
    """A kind of object."""

    name: str
    parts: tuple[Part, ...]
    variety: float  # spread of brightness between individuals, 0..1

    @property
    def nearest_parts(self) -> tuple[Part, ...]:
        """Parts that are drawn at close range."""
        return tuple(part for part in self.parts if part.distances[0] == 0.0)

    @property
    def radius(self) -> float:
        """Radius [m] of the smallest vertical cylinder around the thing."""
        return max(part.mesh.radius for part in self.parts)


def rock(rng: np.random.Generator) -> Thing:
    """A boulder of half a metre, partly in the ground."""
    lump = blob(rng, (0.0, 0.0, 0.1), (0.55, 0.4, 0.36), sides=7, roughness=0.12, texture_size=1.2)
    return Thing(name="rock", parts=(Part(mesh=lump, texture="stone", colour=(0.8, 0.78, 0.74)),), variety=0.2)


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
    """A kerb stone along x, 125 mm wide with its traffic face at -y, 100 mm proud, its upper edge chamfered."""
    half = KERB_LENGTH / 2 - 0.004
    low, high, front, back = -0.05, 0.10, -0.01, 0.125
    profile = [(back, low), (back, high), (front + 0.03, high), (front, high - 0.05), (front, low)]  # along -x
    strips = []
    for (y0, z0), (y1, z1) in pairwise(profile):
        strip = np.array([[-half, y1, z1], [half, y1, z1], [half, y0, z0], [-half, y0, z0]])
        strips.append(polygon(strip, texture_size=0.9))
    ends = [np.array([[x, y, z] for y, z in profile]) for x in (half, -half)]
    caps = [polygon(ends[0], texture_size=0.9, shade=0.5), polygon(ends[1][::-1], texture_size=0.9, shade=0.5)]
    colour = (0.95, 0.94, 0.91)
    near = Part(mesh=joined(*strips, *caps), texture="stone", colour=colour, distances=(0.0, _JOINTS_RANGE))
    far = Part(mesh=joined(*strips), texture="stone", colour=colour, distances=(_JOINTS_RANGE, math.inf))
    return Thing(name="kerb_stone", parts=(near, far), variety=0.12)


HEDGE_LENGTH = 4.0  # [m]
_LUMPS_RANGE = 45.0  # distance from which on lumps have fewer triangles [m]

Lump = tuple[Mesh, Mesh]  # near and far level of detail


def _lump(
    rng: np.random.Generator,
    centre: tuple[float, float, float],
    radii: tuple[float, float, float],
    *,
    sides: int = 6,
    roughness: float = 0.15,
    texture_size: float = 1.5,
) -> Lump:
    """A lump of foliage in two levels of detail whose textures coincide."""
    near = blob(rng, centre, radii, rings=4, sides=sides, roughness=roughness, texture_size=texture_size)
    far = blob(
        np.random.default_rng(0), centre, radii, rings=3, sides=sides - 1, roughness=0.0, texture_size=texture_size
    )
    return near, replace(far, uv=far.uv + near.uv[0] - far.uv[0])


def _leafy(
    rng: np.random.Generator, lumps: list[Lump], sprays: int, size: float, colour: Colour
) -> tuple[Part, Part, Part]:
    """Lumps of foliage in both levels of detail, and sprays of leaves on them."""
    mass, afar = (massed(*meshes) for meshes in zip(*lumps, strict=True))
    places, outwards, shade = scattered_on(rng, mass, sprays)
    fringe = cards(rng, places, outwards, size, np.minimum(shade + 0.1, 1.0))
    return (
        Part(mesh=mass, texture="foliage", colour=colour, distances=(0.0, _LUMPS_RANGE)),
        Part(mesh=afar, texture="foliage", colour=colour, distances=(_LUMPS_RANGE, math.inf)),
        Part(mesh=fringe, texture="twigs", colour=colour, distances=(0.0, TWIGS_RANGE)),
    )


def broadleaf(rng: np.random.Generator, colour: Colour) -> Thing:
    """A broad-leaved tree of about 8 m: a crown of overlapping lumps on a stem."""
    lumps = [_lump(rng, (0.0, 0.0, 5.4), (1.9, 1.9, 1.9), sides=7, roughness=0.10)]
    for azimuth in np.arange(7) * 2.4 + rng.uniform(0.0, 6.0):  # golden angle: no gaps, no rows
        r, z, size = rng.uniform(0.9, 1.7), rng.uniform(3.6, 6.9), rng.uniform(0.8, 1.3)
        centre = (r * np.cos(azimuth), r * np.sin(azimuth), z)
        lumps.append(_lump(rng, centre, (size, size, 0.85 * size), roughness=0.12))
    stem = Part(mesh=pole((0.24, -0.5), (0.13, 4.4), sides=7), texture="bark")
    return Thing(name="broadleaf", parts=(stem, *_leafy(rng, lumps, 100, 0.8, colour)), variety=0.25)


def conifer(rng: np.random.Generator) -> Thing:
    """A spruce of about 9 m: ragged tiers of twigs above each other."""
    tiers = []
    for z, radius in zip(np.linspace(1.0, 7.4, 6), np.linspace(2.0, 0.5, 6), strict=True):
        ragged = rng.uniform(0.72, 1.12, size=9)
        tiers.append((_skirt(ragged, float(z), float(radius)), _skirt(ragged[::2], float(z), float(radius))))
    stem = pole((0.2, -0.5), (0.12, 2.0), sides=6)
    twigs = _leafy(rng, tiers, 70, 0.6, (0.55, 0.68, 0.62))
    return Thing(name="conifer", parts=(Part(mesh=stem, texture="bark"), *twigs), variety=0.2)


def _skirt(ragged: FloatArray, z: float, radius: float) -> Mesh:
    """One tier of a conifer: a cone with a ragged rim (n,) relative to the radius, closed below by a flatter one."""
    profile = np.array([(0.0, 0.10), (0.75, -0.05), (1.0, -0.12), (0.45, 0.60), (0.0, 1.35)])  # reach, height / radius
    ragged = np.append(ragged, ragged[0])
    angle = np.linspace(0.0, 2.0 * np.pi, len(ragged))
    reach = profile[:, :1] * ragged * radius
    height = np.broadcast_to(z + profile[:, 1:] * radius, reach.shape)
    vertices = np.stack([reach * np.cos(angle), reach * np.sin(angle), height], axis=-1).reshape(-1, 3)
    faces = grid_faces(len(profile), len(angle))[:, ::-1].copy()
    return Mesh(
        vertices=vertices,
        normals=smooth_normals(vertices, faces),
        uv=np.stack(np.broadcast_arrays(3.0 * angle / np.pi, profile[:, 1:]), axis=-1).reshape(-1, 2),
        shade=(0.35 + 0.65 * profile[:, :1] * ragged / 1.12).ravel(),
        faces=faces,
    )


def bush(rng: np.random.Generator) -> Thing:
    """A bush of about 1.3 m."""
    lumps = []
    for azimuth in np.arange(3) * 2.4:
        size = rng.uniform(0.45, 0.7)
        centre = (0.4 * np.cos(azimuth), 0.4 * np.sin(azimuth), 0.8 * size)
        lumps.append(_lump(rng, centre, (size, size, 0.95 * size), texture_size=1.0))
    return Thing(name="bush", parts=_leafy(rng, lumps, 20, 0.4, (0.95, 1.0, 0.85)), variety=0.3)


def hedge(rng: np.random.Generator) -> Thing:
    """One length of a clipped, uneven hedge along x, 1.5 m high."""
    lumps = []
    for x in np.linspace(-0.5, 0.5, 4) * (HEDGE_LENGTH - 1.0):
        lumps.append(_lump(rng, (float(x), 0.0, 0.6), (0.95, 0.65, 0.95), texture_size=1.1))
    return Thing(name="hedge", parts=_leafy(rng, lumps, 36, 0.35, (0.82, 0.9, 0.78)), variety=0.1)


def wood(rng: np.random.Generator) -> Thing:
    """The edge of a distant wood: 18 m of crowns along x, 6 to 10 m high."""
    crowns = []
    for x in np.linspace(-8.0, 8.0, 5):
        height, width = rng.uniform(6.0, 10.0), rng.uniform(2.8, 4.2)
        centre = (float(x), rng.uniform(-1.5, 1.5), 0.45 * height)
        size = (width, width, 0.55 * height)
        crowns.append(blob(rng, centre, size, rings=3, sides=7, roughness=0.09, texture_size=5.0))
    mass = Part(mesh=massed(*crowns), texture="foliage", colour=(0.75, 0.82, 0.72))
    return Thing(name="wood", parts=(mass,), variety=0.15)
