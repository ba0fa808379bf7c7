"""Meshes in OpenGL's memory, and crowds of them: all individuals of a part of a thing are drawn by one call."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from OpenGL import GL
from pyrender import Primitive

from sensors.scenery import Stand
from sensors.shapes import Mesh
from sensors.things import Part
from vehicle.frames import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Crowd:
    """All individuals of one part of a thing."""

    part: Part
    primitive: Primitive
    matrices: NDArray[np.float32]  # (n, 4, 4) poses transposed for OpenGL; the last element is the brightness
    spheres: FloatArray  # (n, 4) centre in W and radius [m]: what need not be drawn if it is out of view

    @classmethod
    def of(cls, stand: Stand, part: Part) -> Crowd:
        """The crowd of one part of the things that stand somewhere."""
        middle = 0.5 * (part.mesh.vertices.min(axis=0) + part.mesh.vertices.max(axis=0))
        reach = float(np.linalg.norm(part.mesh.vertices - middle, axis=1).max())
        centres = stand.poses[:, :3, :3] @ middle + stand.poses[:, :3, 3]
        radii = reach * np.linalg.norm(stand.poses[:, :3, 0], axis=1)
        matrices = stand.poses.copy()
        matrices[:, 3, 3] = stand.brightness
        transposed = np.ascontiguousarray(matrices.transpose(0, 2, 1), dtype=np.float32)
        return cls(part, primitive(part.mesh, poses=matrices), transposed, np.column_stack([centres, radii]))

    def muster(self, view_projections: list[FloatArray], eye: FloatArray, farthest: float) -> int:
        """Number of individuals that any of the views may see, after putting their matrices first in the buffer.

        Those farther than ``farthest`` [m] from the ``eye`` (3,) are left out.
        """
        seen = np.logical_or.reduce([in_view(VP, self.spheres) for VP in view_projections])
        seen &= np.linalg.norm(self.spheres[:, :3] - eye, axis=1) < farthest
        if seen.any():
            GL.glBindBuffer(GL.GL_ARRAY_BUFFER, self.primitive._buffers[1])  # [1]: the instances' matrices
            GL.glBufferSubData(GL.GL_ARRAY_BUFFER, 0, np.ascontiguousarray(self.matrices[seen]))
        return int(seen.sum())


def primitive(mesh: Mesh, poses: FloatArray | None = None) -> Primitive:
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
    GL.glBindVertexArray(primitive._vaid)
    GL.glDrawElementsInstanced(
        GL.GL_TRIANGLES, primitive.indices.size, GL.GL_UNSIGNED_INT, ctypes.c_void_p(0), instances
    )
