"""Instanced meshes in OpenGL's memory, cut into blocks: one call draws all instances of a part of a thing."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from OpenGL import GL
from OpenGL.raw.GL.VERSION.GL_1_1 import glDrawElements  # PyOpenGL's wrappers take longer than the calls
from OpenGL.raw.GL.VERSION.GL_1_5 import glBufferSubData
from OpenGL.raw.GL.VERSION.GL_3_1 import glDrawElementsInstanced
from pyrender import Primitive

from sensors.world import sky
from sensors.world.scenery import Instances
from sensors.world.shapes import FaceArray, Mesh, grid_faces
from sensors.world.things import Part
from vehicle.frames import FloatArray

_BLOCK = 300  # most faces of a block; smaller ones cost more in calls than they save in vertices


@dataclass(frozen=True, slots=True, eq=False)
class _Blocks:
    """Faces of a mesh, ordered by compact blocks."""

    faces: FaceArray  # (m, 3)
    starts: NDArray[np.intp]  # (n + 1,) first face of each block, and m
    spheres: FloatArray  # (n, 4) centre and radius around each block [m]

    def runs(self, selected: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
        """First face and number of faces of each run of consecutive selected blocks."""
        edges = np.flatnonzero(np.diff(np.concatenate([[False], selected, [False]]).astype(np.int8)))
        for first, behind in edges.reshape(-1, 2):
            yield int(self.starts[first]), int(self.starts[behind] - self.starts[first])


@dataclass(frozen=True, slots=True, eq=False)
class InstancedPart:
    """All instances of one part of a thing."""

    part: Part
    primitive: Primitive
    matrices: NDArray[np.float32]  # (n, 4, 4) poses transposed for OpenGL; the last row is the instance's colour
    spheres: FloatArray  # (n, 4) bounding spheres for culling: centre in W and radius [m]

    @classmethod
    def of(cls, instances: Instances, part: Part) -> InstancedPart:
        """Instances of one part of a thing."""
        matrices, spheres = _placed(instances, part)
        transposed = np.ascontiguousarray(matrices.transpose(0, 2, 1), dtype=np.float32)
        return cls(part, primitive(part.mesh, poses=matrices), transposed, spheres)

    def place(self, instances: Instances) -> None:
        """Move all instances; their number stays."""
        matrices, self.spheres[:] = _placed(instances, self.part)
        self.matrices[:] = matrices.transpose(0, 2, 1)


class Culler:
    """Joint culling of several instanced parts."""

    def __init__(self, parts: Sequence[InstancedPart]) -> None:
        self._parts = parts
        sizes = [len(part.matrices) for part in parts]
        self._starts = np.concatenate([[0], np.cumsum(sizes, dtype=int)])
        self._owner = np.repeat(np.arange(len(parts)), sizes)
        self._nearest, self._farthest = (
            np.repeat([part.part.distances[end] for part in parts], sizes) for end in (0, 1)
        )

    def in_views(self, view_projections: Sequence[FloatArray], eye: FloatArray) -> list[tuple[InstancedPart, int]]:
        """Parts with the number of instances in any view; their matrices are uploaded to the start of the buffers.

        The nearest to the ``eye`` (3,) come first, as they hide others.
        """
        if not len(self._owner):
            return []
        spheres = np.concatenate([part.spheres for part in self._parts])
        distance = np.linalg.norm(spheres[:, :3] - eye, axis=1)
        visible = np.logical_or.reduce([in_view(VP, spheres) for VP in view_projections])
        order = np.flatnonzero(visible & (distance >= self._nearest) & (distance < self._farthest))
        order = order[np.lexsort([distance[order], self._owner[order]])]
        ends = np.cumsum(np.bincount(self._owner[order], minlength=len(self._parts)))
        drawn = []
        for part, start, indices in zip(self._parts, self._starts, np.split(order, ends), strict=False):
            if len(indices):
                matrices = part.matrices[indices - start]
                GL.glBindBuffer(GL.GL_ARRAY_BUFFER, part.primitive._buffers[1])  # [1]: the instances' matrices
                glBufferSubData(GL.GL_ARRAY_BUFFER, 0, matrices.nbytes, matrices)
                drawn.append((part, len(indices)))
        return drawn


def _placed(instances: Instances, part: Part) -> tuple[FloatArray, FloatArray]:
    """Poses (n, 4, 4) with the colour as their last row, and bounding spheres (n, 4) [m]."""
    middle = 0.5 * (part.mesh.vertices.min(axis=0) + part.mesh.vertices.max(axis=0))
    reach = float(np.linalg.norm(part.mesh.vertices - middle, axis=1).max())
    centres = instances.poses[:, :3, :3] @ middle + instances.poses[:, :3, 3]
    radii = reach * np.linalg.norm(instances.poses[:, :3, 0], axis=1)
    matrices = instances.poses.copy()
    matrices[:, 3, :3] = instances.brightness[:, None] * np.array(part.colour)
    return matrices, np.column_stack([centres, radii])


def primitive(mesh: Mesh, poses: FloatArray | None = None) -> Primitive:
    """Pyrender primitive of a mesh, drawn once at each of the poses (n, 4, 4)."""
    shade = np.repeat(mesh.shade[:, None], 4, axis=1)
    return Primitive(
        positions=mesh.vertices,
        normals=mesh.normals,
        texcoord_0=mesh.uv,
        color_0=shade,
        indices=mesh.faces,
        poses=poses,
    )


def in_view(VP: FloatArray, spheres: FloatArray) -> NDArray[np.bool_]:
    """Mask of the spheres (n, 4) that reach into the view, by its left, right, lower, upper and near planes."""
    planes = np.concatenate([VP[3] + VP[:3], VP[3] - VP[:2]]).reshape(5, 4)
    planes = planes / np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
    inside: NDArray[np.bool_] = ((spheres[:, :3] @ planes[:, :3].T + planes[:, 3]) > -spheres[:, 3:]).all(axis=1)
    return inside


def draw(primitive: Primitive, instances: int) -> None:
    """Draw all triangles of a number of instances of a primitive."""
    GL.glBindVertexArray(primitive._vaid)
    glDrawElementsInstanced(GL.GL_TRIANGLES, primitive.indices.size, GL.GL_UNSIGNED_INT, None, instances)


def draw_run(first: int, count: int) -> None:
    """Draw ``count`` triangles of the bound primitive, starting with the ``first``."""
    glDrawElements(GL.GL_TRIANGLES, 3 * count, GL.GL_UNSIGNED_INT, ctypes.c_void_p(12 * first))


def in_blocks(mesh: Mesh) -> _Blocks:
    """Faces of a mesh, halved at the median of the longer side until each block is small."""
    corners = mesh.vertices[mesh.faces]  # (m, 3 corners, 3)
    parts = list(_halved(corners.mean(axis=1)[:, :2], np.arange(len(mesh.faces))))
    spheres = np.array([_sphere(corners[part].reshape(-1, 3)) for part in parts])
    starts = np.concatenate([[0], np.cumsum([len(part) for part in parts])])
    return _Blocks(mesh.faces[np.concatenate(parts)], starts, spheres)


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
