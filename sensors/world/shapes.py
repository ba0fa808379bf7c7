"""Triangle meshes of roadside objects, as plain arrays.

Every shape stands on z = 0 and reaches below it, so that it does not float on sloping ground.
"""

from __future__ import annotations

from dataclasses import dataclass

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

    def moved(self, *, by: tuple[float, float, float], yaw: float = 0.0) -> Mesh:
        """The mesh turned by ``yaw`` [rad] about z and then shifted."""
        c, s = np.cos(yaw), np.sin(yaw)
        R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return Mesh(
            vertices=self.vertices @ R.T + np.array(by),
            normals=self.normals @ R.T,
            uv=self.uv,
            shade=self.shade,
            faces=self.faces,
        )


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
        kept = lump.faces[(area > 0.0) & ~hidden.all(axis=1)]
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
