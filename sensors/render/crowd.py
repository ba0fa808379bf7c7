"""Meshes in OpenGL's memory, and crowds of them: all individuals of a part of a thing are drawn by one call."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from OpenGL import GL
from OpenGL.raw.GL.VERSION.GL_1_1 import glDrawElements  # what PyOpenGL wraps around these takes longer than they do
from OpenGL.raw.GL.VERSION.GL_1_5 import glBufferSubData
from OpenGL.raw.GL.VERSION.GL_3_1 import glDrawElementsInstanced
from pyrender import Primitive

from sensors.world.scenery import Stand
from sensors.world.shapes import Mesh
from sensors.world.things import Part
from vehicle.frames import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Crowd:
    """All individuals of one part of a thing."""

    part: Part
    primitive: Primitive
    matrices: NDArray[np.float32]  # (n, 4, 4) poses transposed for OpenGL; their last row is the individual's colour
    spheres: FloatArray  # (n, 4) centre in W and radius [m]: what need not be drawn if it is out of view

    @classmethod
    def of(cls, stand: Stand, part: Part) -> Crowd:
        """The crowd of one part of the things that stand somewhere."""
        matrices, spheres = _placed(stand, part)
        transposed = np.ascontiguousarray(matrices.transpose(0, 2, 1), dtype=np.float32)
        return cls(part, primitive(part.mesh, poses=matrices), transposed, spheres)

    def place(self, stand: Stand) -> None:
        """Put as many individuals elsewhere."""
        matrices, self.spheres[:] = _placed(stand, self.part)
        self.matrices[:] = matrices.transpose(0, 2, 1)


class Muster:
    """Several crowds together, so that who is in view is worked out for all of them at once."""

    def __init__(self, crowds: Sequence[Crowd]) -> None:
        self._crowds = crowds
        sizes = [len(crowd.matrices) for crowd in crowds]
        self._starts = np.concatenate([[0], np.cumsum(sizes, dtype=int)])
        self._owner = np.repeat(np.arange(len(crowds)), sizes)
        self._nearest, self._farthest = (
            np.repeat([crowd.part.distances[end] for crowd in crowds], sizes) for end in (0, 1)
        )

    def seen(self, view_projections: Sequence[FloatArray], eye: FloatArray) -> list[tuple[Crowd, int]]:
        """Crowds with the number of individuals that any view may see, their matrices being first in their buffers.

        The nearest to the ``eye`` (3,) come first, as they hide others.
        """
        if not len(self._owner):
            return []
        spheres = np.concatenate([crowd.spheres for crowd in self._crowds])
        distance = np.linalg.norm(spheres[:, :3] - eye, axis=1)
        seen = np.logical_or.reduce([in_view(VP, spheres) for VP in view_projections])
        order = np.flatnonzero(seen & (distance >= self._nearest) & (distance < self._farthest))
        order = order[np.lexsort([distance[order], self._owner[order]])]
        ends = np.cumsum(np.bincount(self._owner[order], minlength=len(self._crowds)))
        mustered = []
        for crowd, start, own in zip(self._crowds, self._starts, np.split(order, ends), strict=False):
            if len(own):
                matrices = crowd.matrices[own - start]
                GL.glBindBuffer(GL.GL_ARRAY_BUFFER, crowd.primitive._buffers[1])  # [1]: the instances' matrices
                glBufferSubData(GL.GL_ARRAY_BUFFER, 0, matrices.nbytes, matrices)
                mustered.append((crowd, len(own)))
        return mustered


def _placed(stand: Stand, part: Part) -> tuple[FloatArray, FloatArray]:
    """Poses (n, 4, 4) with the colour as their last row, and spheres (n, 4) around the individuals [m]."""
    middle = 0.5 * (part.mesh.vertices.min(axis=0) + part.mesh.vertices.max(axis=0))
    reach = float(np.linalg.norm(part.mesh.vertices - middle, axis=1).max())
    centres = stand.poses[:, :3, :3] @ middle + stand.poses[:, :3, 3]
    radii = reach * np.linalg.norm(stand.poses[:, :3, 0], axis=1)
    matrices = stand.poses.copy()
    matrices[:, 3, :3] = stand.brightness[:, None] * np.array(part.colour)
    return matrices, np.column_stack([centres, radii])


def primitive(mesh: Mesh, poses: FloatArray | None = None) -> Primitive:
    """A mesh as a primitive of pyrender, drawn once at each of the poses (n, 4, 4)."""
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
    """Which spheres (n, 4) reach into the view, judged by its left, right, lower, upper and near plane."""
    planes = np.concatenate([VP[3] + VP[:3], VP[3] - VP[:2]]).reshape(5, 4)
    planes = planes / np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
    inside: NDArray[np.bool_] = ((spheres[:, :3] @ planes[:, :3].T + planes[:, 3]) > -spheres[:, 3:]).all(axis=1)
    return inside


def draw(primitive: Primitive, instances: int) -> None:
    """All triangles of so many instances of a primitive."""
    GL.glBindVertexArray(primitive._vaid)
    glDrawElementsInstanced(GL.GL_TRIANGLES, primitive.indices.size, GL.GL_UNSIGNED_INT, None, instances)


def draw_run(first: int, count: int) -> None:
    """So many triangles from the first one on of the primitive that is bound."""
    glDrawElements(GL.GL_TRIANGLES, 3 * count, GL.GL_UNSIGNED_INT, ctypes.c_void_p(12 * first))
