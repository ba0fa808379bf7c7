"""The things of a world in one table of vertices, and the choice of those that cameras see."""

from collections.abc import Sequence, Set
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sensors.world.scenery import Instances
from sensors.world.things import Part
from vehicle.frames import FloatArray

VERTEX = np.dtype([("position", "f4", 3), ("normal", "f4", 3), ("uv", "f4", 2), ("tint", "f2", 4)])
VertexArray = NDArray[np.void]  # of VERTEX; the tint is a colour and the visible share of the sky
IndexArray = NDArray[np.uint32]


class Kind(NamedTuple):
    """What is drawn in one call: the shaders and the texture."""

    program: str
    texture: str


class Things:
    """All instances of all parts in W, each a piece of one list of triangles."""

    def __init__(self, fixed: Sequence[Instances], moving: Sequence[Instances], transparent: Set[str]) -> None:
        instanced = [(instances, part) for instances in (*fixed, *moving) for part in instances.thing.parts]
        wanted = [Kind("leaves" if part.texture in transparent else "thing", part.texture) for _, part in instanced]
        self.kinds = sorted(set(wanted), reverse=True)  # things hide more than leaves
        sizes = [len(instances.poses) for instances, _ in instanced]
        self._moving = sum(len(instances.poses) * len(instances.thing.parts) for instances in fixed)  # first piece
        self._kind = np.repeat([self.kinds.index(kind) for kind in wanted], sizes).astype(int)
        self._distances = np.repeat([part.distances for _, part in instanced], sizes, axis=0).reshape(-1, 2)
        self._count = np.repeat([part.mesh.faces.size for _, part in instanced], sizes).astype(int)
        self._spheres = np.concatenate([np.empty((0, 4)), *(_spheres(*one) for one in instanced)])
        vertices, indices, start = [np.empty(0, dtype=VERTEX)], [np.empty(0, dtype=np.uint32)], 0
        for instances, part in instanced:
            placed = vertices_of(instances, part)
            starts = start + np.arange(len(placed)) * placed.shape[1]
            indices.append((starts[:, None] + part.mesh.faces.ravel()).astype(np.uint32).ravel())
            vertices.append(placed.ravel())
            start += placed.size
        self.vertices, self._indices = np.concatenate(vertices), np.concatenate(indices)
        self._first = np.cumsum(self._count) - self._count

    def place(self, moved: Sequence[Instances]) -> VertexArray:
        """Move the moving things; their vertices are the last ones of the table."""
        instanced = [(instances, part) for instances in moved for part in instances.thing.parts]
        for at, (instances, part) in enumerate(instanced, start=self._moving):
            self._spheres[at] = _spheres(instances, part)
        return np.concatenate([vertices_of(instances, part).ravel() for instances, part in instanced])

    def seen(self, view_projections: Sequence[FloatArray], eye: FloatArray) -> tuple[IndexArray, list[int]]:
        """Indices of the vertices of all pieces in any view, by kind, and their number for each kind.

        The nearest to the ``eye`` (3,) come first, as they hide others.
        """
        distance = np.linalg.norm(self._spheres[:, :3] - eye, axis=1)
        within = (distance >= self._distances[:, 0]) & (distance < self._distances[:, 1])
        chosen = np.flatnonzero(within & in_views(view_projections, self._spheres))
        chosen = chosen[np.lexsort([distance[chosen], self._kind[chosen]])]
        count = self._count[chosen]
        ends = np.cumsum(count)
        where = np.arange(count.sum()) + np.repeat(self._first[chosen] - (ends - count), count)
        numbers = np.bincount(self._kind[chosen], weights=count, minlength=len(self.kinds))
        return self._indices[where], numbers.astype(int).tolist()


def vertices_of(instances: Instances, part: Part) -> VertexArray:
    """Vertices (n, v) of one part of n instances in W."""
    mesh, rotations = part.mesh, instances.poses[:, None, :3, :3]
    vertices = np.empty((len(instances.poses), len(mesh.vertices)), dtype=VERTEX)
    vertices["position"] = (rotations @ mesh.vertices[..., None])[..., 0] + instances.poses[:, None, :3, 3]
    vertices["normal"] = (rotations @ mesh.normals[..., None])[..., 0]
    vertices["uv"] = mesh.uv
    vertices["tint"][..., :3] = instances.brightness[:, None, None] * np.array(part.colour)
    vertices["tint"][..., 3] = mesh.shade
    return vertices


def _spheres(instances: Instances, part: Part) -> FloatArray:
    """Bounding spheres (n, 4) of one part of n instances: centre in W and radius [m]."""
    vertices = part.mesh.vertices
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    reach = float(np.linalg.norm(vertices - middle, axis=1).max())
    centres = instances.poses[:, :3, :3] @ middle + instances.poses[:, :3, 3]
    return np.column_stack([centres, reach * np.linalg.norm(instances.poses[:, :3, 0], axis=1)])


def in_views(view_projections: Sequence[FloatArray], spheres: FloatArray) -> NDArray[np.bool_]:
    """Mask of the spheres (n, 4) that reach into any view, by its left, right, lower, upper and near planes."""
    planes = np.array(
        [[VP[3] + VP[0], VP[3] + VP[1], VP[3] + VP[2], VP[3] - VP[0], VP[3] - VP[1]] for VP in view_projections]
    )
    planes = planes / np.linalg.norm(planes[..., :3], axis=-1, keepdims=True)
    beyond = planes[..., :3] @ spheres[:, :3].T + planes[..., 3:] <= -spheres[:, 3]  # (views, 5, n)
    inside: NDArray[np.bool_] = ~beyond.any(axis=1).all(axis=0)
    return inside
