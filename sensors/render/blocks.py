"""Geometry prepared for drawing: a mesh cut into blocks for culling, and the sky dome."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sensors.world import sky
from sensors.world.shapes import FaceArray, Mesh, grid_faces
from vehicle.frames import FloatArray

_BLOCK = 300  # most faces of a block; smaller ones cost more in calls than they save in vertices


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Faces of a mesh, ordered by compact blocks."""

    faces: FaceArray  # (m, 3)
    starts: NDArray[np.intp]  # (n + 1,) first face of each block, and m
    spheres: FloatArray  # (n, 4) centre and radius around each block [m]

    def runs(self, selected: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
        """First face and number of faces of each run of consecutive selected blocks."""
        edges = np.flatnonzero(np.diff(np.concatenate([[False], selected, [False]]).astype(np.int8)))
        for first, behind in edges.reshape(-1, 2):
            yield int(self.starts[first]), int(self.starts[behind] - self.starts[first])


def in_blocks(mesh: Mesh) -> Blocks:
    """Faces of a mesh, halved at the median of the longer side until each block is small."""
    corners = mesh.vertices[mesh.faces]  # (m, 3 corners, 3)
    parts = list(_halved(corners.mean(axis=1)[:, :2], np.arange(len(mesh.faces))))
    spheres = np.array([_sphere(corners[part].reshape(-1, 3)) for part in parts])
    starts = np.concatenate([[0], np.cumsum([len(part) for part in parts])])
    return Blocks(mesh.faces[np.concatenate(parts)], starts, spheres)


def _halved(centres: FloatArray, part: NDArray[np.intp]) -> Iterator[NDArray[np.intp]]:
    if len(part) <= _BLOCK:
        yield part
        return
    axis = int(np.ptp(centres[part], axis=0).argmax())
    order = part[np.argsort(centres[part, axis], kind="stable")]
    yield from _halved(centres, order[: len(order) // 2])
    yield from _halved(centres, order[len(order) // 2 :])


def _sphere(points: FloatArray) -> FloatArray:
    """Centre of the bounding box and the distance of the farthest point (4,)."""
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return np.append(centre, np.linalg.norm(points - centre, axis=1).max())


def dome(sides: int = 24, rings: int = 4) -> Mesh:
    """Sky dome, visible from inside: unit directions as vertices, with coordinates on the panorama."""
    levels = np.append(np.linspace(sky.LOWEST, sky.HIGHEST, rings), [1.1, 0.5 * np.pi])  # up to the zenith [rad]
    elevation, azimuth = np.meshgrid(levels, np.linspace(0.0, 2.0 * np.pi, sides + 1), indexing="ij")
    level = np.cos(elevation)
    directions = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=-1).reshape(-1, 3)
    upwards = np.minimum((elevation - sky.LOWEST) / (sky.HIGHEST - sky.LOWEST), 0.999)
    return Mesh(
        vertices=directions,
        normals=-directions,
        uv=np.stack([azimuth / (2.0 * np.pi), upwards], axis=-1).reshape(-1, 2),
        shade=np.ones(len(directions)),
        faces=grid_faces(len(levels), sides + 1),
    )
