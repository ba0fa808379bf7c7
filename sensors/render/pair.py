"""Two views of a world in one framebuffer: an OpenGL context without a window, and pyrender's renderer in it.

The renderer has its own shaders, drawing order and instanced meshes: these are cut into blocks, and one call draws all
instances of a part of a thing. Importing this module imports pyrender and loads EGL.
"""

import ctypes
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
import pyrender
from numpy.typing import NDArray
from OpenGL import GL
from OpenGL.error import Error as OpenGlError
from OpenGL.raw.GL.VERSION import GL_1_1, GL_1_5, GL_3_1  # PyOpenGL's wrappers take longer than the calls
from pyrender.renderer import Renderer
from pyrender.shader_program import ShaderProgram, ShaderProgramCache

from sensors.camera.rig import StereoCalibration
from sensors.render import egl
from sensors.textures import to_bytes
from sensors.world import sky
from sensors.world.ground import Condition, RoadMap, line_range
from sensors.world.scenery import Instances
from sensors.world.things import FaceArray, Mesh, Part, grid_faces
from sensors.world.traffic import MAX_VEHICLES
from sensors.world.world import World
from vehicle.frames import FloatArray, inverse, transform

Uniforms = Mapping[str, float | tuple[float, ...] | FloatArray]

_SHADERS = Path(__file__).parent / "shaders"
FAILURES = (OSError, OpenGlError, RuntimeError)  # of an OpenGL that does not work here
_MARGIN = 2  # around each level of a sheet: repeated, so that bilinear samples do not see the neighbour [px]
_LAYOUTS = {3: (GL.GL_RGB8, GL.GL_RGB), 4: (GL.GL_RGBA8, GL.GL_RGBA)}  # channels: internal layout, layout


def upload_table(table: NDArray[np.float32]) -> int:
    """Name of a new texture with a table (ny, nx, 4) of numbers, without filtering."""
    texture = _new_texture(GL.GL_CLAMP_TO_EDGE, GL.GL_NEAREST, GL.GL_NEAREST)
    ny, nx = table.shape[:2]
    GL.glTexImage2D(GL.GL_TEXTURE_2D, 0, GL.GL_RGBA32F, nx, ny, 0, GL.GL_RGBA, GL.GL_FLOAT, np.ascontiguousarray(table))
    return texture


def upload_texture(image: NDArray[np.uint8], shrink: int, wrap: int = GL.GL_REPEAT) -> int:
    """Name of a new texture; v = 0 at its first row; ``shrink`` is OpenGL's minification filter."""
    internal, layout = _LAYOUTS[image.shape[2]]
    texture = _new_texture(wrap, GL.GL_LINEAR, shrink)
    GL.glPixelStorei(GL.GL_UNPACK_ALIGNMENT, 1)
    data = np.ascontiguousarray(image)
    GL.glTexImage2D(GL.GL_TEXTURE_2D, 0, internal, image.shape[1], image.shape[0], 0, layout, GL.GL_UNSIGNED_BYTE, data)
    GL.glGenerateMipmap(GL.GL_TEXTURE_2D)
    return texture


def upload_levels(image: NDArray[np.uint8], count: int) -> tuple[int, tuple[float, ...]]:
    """Name of a new texture with ``count`` mipmap levels of a periodic image (h, w, 4) side by side, and its sheet.

    The sheet is the size of the largest level and the margin around each, as shares of the texture. The sides of the
    image are multiples of 2^(count - 1).
    """
    levels = [image]
    for _ in range(1, count):
        half = cv2.resize(levels[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        levels.append(np.asarray(half, dtype=np.uint8))
    ny, nx = image.shape[0] + 2 * _MARGIN, sum(level.shape[1] + 2 * _MARGIN for level in levels)
    sheet, x = np.zeros((ny, nx, 4), dtype=np.uint8), 0
    for level in levels:
        framed = np.pad(level, ((_MARGIN, _MARGIN), (_MARGIN, _MARGIN), (0, 0)), mode="wrap")
        sheet[: framed.shape[0], x : x + framed.shape[1]] = framed
        x += framed.shape[1]
    texture = _new_texture(GL.GL_CLAMP_TO_EDGE, GL.GL_LINEAR, GL.GL_LINEAR)
    GL.glTexImage2D(GL.GL_TEXTURE_2D, 0, GL.GL_RGBA8, nx, ny, 0, GL.GL_RGBA, GL.GL_UNSIGNED_BYTE, sheet)
    return texture, (image.shape[1] / nx, image.shape[0] / ny, _MARGIN / nx, _MARGIN / ny)


def _new_texture(wrap: int, enlarge: int, shrink: int) -> int:
    """Name of a new texture, which is bound, with this wrapping and these filters."""
    texture = int(GL.glGenTextures(1))
    GL.glBindTexture(GL.GL_TEXTURE_2D, texture)
    for key in (GL.GL_TEXTURE_WRAP_S, GL.GL_TEXTURE_WRAP_T):
        GL.glTexParameteri(GL.GL_TEXTURE_2D, key, wrap)
    GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_MAG_FILTER, enlarge)
    GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_MIN_FILTER, shrink)
    return texture


@dataclass(frozen=True, slots=True, eq=False)
class Program:
    """A linked shader program with its uniforms."""

    identity: int
    locations: dict[str, int] = field(default_factory=dict)

    @classmethod
    def load(cls, cache: ShaderProgramCache, vertex: str, fragment: str, constants: Uniforms) -> "Program":
        """Program of two files in ``shaders``, in which constants are replaced by their values; the cache owns it."""
        defines = {name: _literal(value) for name, value in constants.items()}
        program: ShaderProgram = cache.get_program(f"{vertex}.vert", f"{fragment}.frag", defines=defines)
        program._add_to_context()
        return cls(int(program._program_id))

    def use(self, uniforms: Uniforms) -> None:
        """Make this the current program and set uniforms: numbers, vectors, matrices, or ints for texture units."""
        GL.glUseProgram(self.identity)
        for name, value in uniforms.items():
            if name not in self.locations:
                self.locations[name] = int(GL.glGetUniformLocation(self.identity, name))
            _set(self.locations[name], value)


def _literal(value: float | tuple[float, ...] | FloatArray) -> str:
    """A number or vector as text of a shader."""
    if isinstance(value, int):
        return str(value)
    numbers = np.atleast_1d(value).tolist()
    return f"vec{len(numbers)}{tuple(numbers)}" if len(numbers) > 1 else repr(numbers[0])


def _set(location: int, value: float | tuple[float, ...] | FloatArray) -> None:
    if isinstance(value, int):
        GL.glUniform1i(location, value)
        return
    array = np.ascontiguousarray(value, dtype=np.float32)
    if array.ndim == 2:
        GL.glUniformMatrix4fv(location, 1, GL.GL_TRUE, array)
    else:
        (GL.glUniform1fv, GL.glUniform2fv, GL.glUniform3fv, GL.glUniform4fv)[max(array.size, 1) - 1](location, 1, array)


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
    primitive: pyrender.Primitive
    matrices: NDArray[np.float32]  # (n, 4, 4) poses transposed for OpenGL; the last row is the instance's colour
    spheres: FloatArray  # (n, 4) bounding spheres for culling: centre in W and radius [m]

    @classmethod
    def of(cls, instances: Instances, part: Part) -> "InstancedPart":
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
                GL_1_5.glBufferSubData(GL.GL_ARRAY_BUFFER, 0, matrices.nbytes, matrices)
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


def primitive(mesh: Mesh, poses: FloatArray | None = None) -> pyrender.Primitive:
    """Pyrender primitive of a mesh, drawn once at each of the poses (n, 4, 4)."""
    shade = np.repeat(mesh.shade[:, None], 4, axis=1)
    return pyrender.Primitive(
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


def draw(primitive: pyrender.Primitive, instances: int) -> None:
    """Draw all triangles of a number of instances of a primitive."""
    GL.glBindVertexArray(primitive._vaid)
    GL_3_1.glDrawElementsInstanced(GL.GL_TRIANGLES, primitive.indices.size, GL.GL_UNSIGNED_INT, None, instances)


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


_NEAR, _FAR = 0.3, 2500.0  # [m]
_STRIP = (-0.7, 1.02)  # lowest relevant edge distance, and range: steps of 4 mm [m]
_NO_BOX = transform(np.eye(3), np.full(3, 1e4))  # from W into a box far away
_CLEARANCE = 0.3  # height of the shadow-casting part of a vehicle above the ground [m]
_DETAIL_LEVELS, _ROAD_LEVELS = 10, 6  # see ground.frag
_TAPS = 3.0  # samples of ground.frag along a pixel's footprint
_HAZE_RANGE = 800.0  # distance over which the haze takes 63 % [m]


def projection(calibration: StereoCalibration) -> FloatArray:
    """Clip coordinates (4, 4) from points in the camera frame C (OpenCV axes, z forward).

    Row v of the image becomes row v of the framebuffer, counted from OpenGL's bottom, so that images read back are
    upright. The centre of the first pixel is (0, 0), half a pixel inside OpenGL's corner.
    """
    c, P = calibration, np.zeros((4, 4))
    P[0, 0], P[0, 2] = 2.0 * c.focal_length / c.width, 2.0 * (c.cx + 0.5) / c.width - 1.0
    P[1, 1], P[1, 2] = 2.0 * c.focal_length / c.height, 2.0 * (c.cy + 0.5) / c.height - 1.0
    P[2, 2], P[2, 3] = (_FAR + _NEAR) / (_FAR - _NEAR), -2.0 * _FAR * _NEAR / (_FAR - _NEAR)
    P[3, 2] = 1.0
    return P


class PairRenderer(Renderer):  # type: ignore[misc]  # pyrender ships no types
    """Draws both views with one set of OpenGL objects; one call reads both back."""

    def __init__(self, world: World, calibration: StereoCalibration, context: egl.Context) -> None:
        super().__init__(calibration.width, calibration.height)
        self._context, self._projection = context, projection(calibration)
        self._width, self._height = calibration.width, calibration.height
        self._rays = _rays(calibration)
        nearest_level = GL.GL_LINEAR_MIPMAP_NEAREST  # as good for tracking as trilinear filtering, at half the cost
        self._transparent = {key for key, texture in world.textures.items() if texture.shape[2] == 4}
        self._textures = {key: upload_texture(texture[::-1], nearest_level) for key, texture in world.textures.items()}
        self._panorama = upload_texture(world.panorama[::-1], GL.GL_LINEAR)
        detail, detail_sheet = upload_levels(world.detail, _DETAIL_LEVELS)
        packed = _packed(world.road)
        road, road_sheet = upload_levels(packed, _ROAD_LEVELS)
        cell = world.road.cell * world.road.light.shape[1] / packed.shape[1]
        self._ground_textures = {0: detail, 1: road, **_uploaded(world.condition, world.road)}  # by texture unit
        constants = _constants(world) | {
            "DETAIL_SHEET": detail_sheet,
            "ROAD_SHEET": road_sheet,
            "DETAIL_TEXELS": 2.0 * len(world.detail) ** 2,
            "ROAD_TEXELS": 2.0 * (world.detail_period / cell) ** 2,
        }
        self._program_cache = ShaderProgramCache(shader_dir=str(_SHADERS))
        self._programs = {
            name: Program.load(self._program_cache, vertex, name, constants)
            for name, vertex in (("thing", "thing"), ("leaves", "thing"), ("sky", "sky"), ("ground", "ground"))
        }
        parts = [InstancedPart.of(instances, part) for instances in world.scenery for part in instances.thing.parts]
        self._moving = [
            [InstancedPart.of(instances, part) for part in instances.thing.parts] for instances in world.moving
        ]
        parts += [part for parts_of_one in self._moving for part in parts_of_one]
        parts.sort(key=lambda part: part.part.texture in self._transparent)  # opaque parts first
        self._culler = Culler(parts)
        self._blocks = in_blocks(world.ground)
        self._ground, self._sky = primitive(replace(world.ground, faces=self._blocks.faces)), primitive(dome())
        scene = pyrender.Scene()
        scene.add(pyrender.Mesh([self._ground, self._sky, *(part.primitive for part in parts)]))
        self._update_context(scene, 0)
        self._programs["ground"].use({name: k for k, name in enumerate(("detail", "road", "looks", "holes", "lines"))})
        self.place(world.moving)
        self._make_framebuffer()

    @property
    def name(self) -> str:
        """Name and version of the OpenGL renderer."""
        return self._context.name

    def close(self) -> None:
        """Free all objects in the context, and the context."""
        self._context.platform.make_current()
        GL.glDeleteTextures([*self._textures.values(), self._panorama, *self._ground_textures.values()])
        GL.glDeleteRenderbuffers(2, self._buffers)
        GL.glDeleteFramebuffers(1, [self._framebuffer])
        self.delete()
        self._context.close()

    def __del__(self) -> None:
        """Free nothing: pyrender would free objects of the context that happens to be current."""

    def draw(self, X_WCl: FloatArray, X_WCr: FloatArray) -> None:
        """Draw the views of the left and the right camera at poses X_WC (4, 4)."""
        self._context.platform.make_current()
        self._prepare()
        views = [(X_WC, self._projection @ inverse(X_WC)) for X_WC in (X_WCl, X_WCr)]
        self._draw_things(views)
        self._draw_ground(views)
        self._draw_sky(views)
        GL.glBindVertexArray(0)

    def place(self, moved: tuple[Instances, ...]) -> None:
        """Move the moving things and their shadows."""
        self._context.platform.make_current()
        for instances, parts in zip(moved, self._moving, strict=True):
            for part in parts:
                part.place(instances)
        boxes = [_into_box(instances) for instances in moved] + [_NO_BOX] * (MAX_VEHICLES - len(moved))
        self._programs["ground"].use({f"into_box[{k}]": box for k, box in enumerate(boxes)})

    def read_colour(self) -> NDArray[np.uint8]:
        """Both images (2, height, width, 4), RGBA: reading RGB from OpenGL takes twice as long."""
        pixels = np.empty((2, self._height, self._width, 4), dtype=np.uint8)
        GL.glReadPixels(0, 0, self._width, 2 * self._height, GL.GL_RGBA, GL.GL_UNSIGNED_BYTE, array=pixels)
        return pixels

    def read_nearness(self) -> NDArray[np.float32]:
        """Inverse depth of both views (2, height, width) along the optical axis [1/m]."""
        return np.float32(1.0 / _NEAR) - np.float32((_FAR - _NEAR) / (_FAR * _NEAR)) * self._stored_depth()

    def read_depth(self) -> FloatArray:
        """Depth of both views (2, height, width) along the optical axis [m]; infinite where nothing is."""
        stored = self._stored_depth().astype(np.float64)
        return np.where(stored < 1.0, _FAR * _NEAR / (_FAR - stored * (_FAR - _NEAR)), np.inf)

    def _stored_depth(self) -> NDArray[np.float32]:
        depth = np.empty((2, self._height, self._width), dtype=np.float32)
        GL.glReadPixels(0, 0, self._width, 2 * self._height, GL.GL_DEPTH_COMPONENT, GL.GL_FLOAT, array=depth)
        return depth

    def _make_framebuffer(self) -> None:
        """Create one framebuffer for both views, the right one above the left one; without costly multisampling."""
        self._buffers = GL.glGenRenderbuffers(2)
        self._framebuffer = int(GL.glGenFramebuffers(1))
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._framebuffer)
        formats = (GL.GL_RGBA8, GL.GL_DEPTH_COMPONENT32F)
        attachments = (GL.GL_COLOR_ATTACHMENT0, GL.GL_DEPTH_ATTACHMENT)
        for buffer, layout, attachment in zip(self._buffers, formats, attachments, strict=True):
            GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, buffer)
            GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, layout, self._width, 2 * self._height)
            GL.glFramebufferRenderbuffer(GL.GL_FRAMEBUFFER, attachment, GL.GL_RENDERBUFFER, buffer)

    def _prepare(self) -> None:
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._framebuffer)
        for capability in (GL.GL_DEPTH_TEST, GL.GL_CULL_FACE, GL.GL_SCISSOR_TEST):
            GL.glEnable(capability)
        GL.glFrontFace(GL.GL_CW)  # the projection flips the image
        GL.glDepthFunc(GL.GL_LEQUAL)  # the sky lies on the far plane
        GL.glScissor(0, 0, self._width, 2 * self._height)
        GL.glClear(GL.GL_DEPTH_BUFFER_BIT)  # the sky covers the rest

    def _view(self, index: int) -> None:
        for select in (GL.glViewport, GL.glScissor):
            select(0, index * self._height, self._width, self._height)

    def _draw_things(self, views: list[tuple[FloatArray, FloatArray]]) -> None:
        """Draw the instances in either view."""
        visible = self._culler.in_views([VP for _, VP in views], views[0][0][:3, 3])
        GL.glActiveTexture(GL.GL_TEXTURE0)
        for index, (X_WC, VP) in enumerate(views):
            self._view(index)
            for name, transparent in (("thing", False), ("leaves", True)):
                self._programs[name].use({"view_projection": VP, "camera": X_WC[:3, 3]})
                (GL.glDisable if transparent else GL.glEnable)(GL.GL_CULL_FACE)  # leaves have two sides
                for part, count in visible:
                    if (part.part.texture in self._transparent) == transparent:
                        GL.glBindTexture(GL.GL_TEXTURE_2D, self._textures[part.part.texture])
                        draw(part.primitive, count)
        GL.glEnable(GL.GL_CULL_FACE)

    def _draw_ground(self, views: list[tuple[FloatArray, FloatArray]]) -> None:
        for unit, texture in sorted(self._ground_textures.items(), reverse=True):  # unit 0 last: it stays active
            GL.glActiveTexture(GL.GL_TEXTURE0 + unit)
            GL.glBindTexture(GL.GL_TEXTURE_2D, texture)
        for index, (X_WC, VP) in enumerate(views):
            self._view(index)
            self._programs["ground"].use({"view_projection": VP, "camera": X_WC[:3, 3], "stretch": self._stretch(X_WC)})
            GL.glBindVertexArray(self._ground._vaid)
            for first, count in self._blocks.runs(in_view(VP, self._blocks.spheres)):
                GL_1_1.glDrawElements(GL.GL_TRIANGLES, 3 * count, GL.GL_UNSIGNED_INT, ctypes.c_void_p(12 * first))

    def _stretch(self, X_WC: FloatArray) -> float:
        """Length over width of the least elongated pixel on level ground, limited to ground.frag's samples."""
        steepest = float((self._rays @ -X_WC[2, :3]).max())
        return min(1.0 / max(steepest, 1e-3), _TAPS)

    def _draw_sky(self, views: list[tuple[FloatArray, FloatArray]]) -> None:
        """Draw the sky where nothing else was drawn."""
        GL.glBindTexture(GL.GL_TEXTURE_2D, self._panorama)
        for index, (X_WC, _) in enumerate(views):
            self._view(index)
            far_away = self._projection @ transform(X_WC[:3, :3].T, np.zeros(3))
            self._programs["sky"].use({"view_projection": far_away})
            draw(self._sky, 1)


def _constants(world: World) -> dict[str, float | tuple[float, ...] | FloatArray]:
    """Constants of the shaders by name; no name is part of another one."""
    road, light = world.road, world.light
    marks = {"LOOKS": world.condition.looks, "HOLES": world.condition.holes, "LINES": road.lines}
    defined = [name for name, mark in marks.items() if mark is not None]  # absent features cost nothing
    defined += ["TRAFFIC"] if world.moving else []
    defined += ["MARKED"] if defined else []
    return {
        **dict.fromkeys(defined, 1),
        "DETAIL_LAST": _DETAIL_LEVELS - 1,
        "ROAD_LAST": _ROAD_LEVELS - 1,
        "DETAIL_PERIOD": world.detail_period,
        "MAP_ORIGIN": road.origin - 0.5 * road.cell,
        "MAP_EXTENT": road.cell * np.array(road.light.shape[::-1]),
        "EDGE_STRIP": _STRIP,
        "LINE_RANGE": line_range(road),
        "SUN_DIRECTION": light.direction,
        "SUN_COLOUR": light.sun_colour,
        "SKY_COLOUR": light.sky_colour,
        "HAZE_COLOUR": np.array(sky.HAZE) * light.sky_tint,
        "HAZE_RANGE": _HAZE_RANGE,
    }


def _rays(calibration: StereoCalibration) -> FloatArray:
    """Unit vectors (9, 3) in C through the image's corners, the middles of its sides and its middle."""
    c = calibration
    corners = np.stack(np.meshgrid([0.0, 0.5, 1.0], [0.0, 0.5, 1.0]), axis=-1).reshape(-1, 2)
    xy = (corners * [c.width - 1, c.height - 1] - [c.cx, c.cy]) / c.focal_length
    rays = np.column_stack([xy, np.ones(len(xy))])
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True), dtype=np.float64)


def _uploaded(condition: Condition, road: RoadMap) -> dict[int, int]:
    """Textures of the ground's condition and of the lines between lanes, by texture unit."""
    textures = {}
    if condition.looks is not None:
        textures[2] = upload_texture(to_bytes(condition.looks), GL.GL_LINEAR_MIPMAP_NEAREST, GL.GL_CLAMP_TO_EDGE)
    if condition.holes is not None:
        textures[3] = upload_table(condition.holes)
    if road.lines is not None:
        levels = 0.5 + 0.5 * road.lines / line_range(road)
        channels = to_bytes(np.concatenate([levels, levels[..., :1]], axis=-1))
        textures[4] = upload_texture(channels, GL.GL_LINEAR, GL.GL_CLAMP_TO_EDGE)
    return textures


def _into_box(instances: Instances) -> FloatArray:
    """From W (4, 4) into the box around a single thing; the box's sides are at +-1 there."""
    vertices = np.concatenate([part.mesh.vertices for part in instances.thing.parts])
    low, high = vertices.min(axis=0) + np.array([0.0, 0.0, _CLEARANCE]), vertices.max(axis=0)
    box = transform(np.diag(0.5 * (high - low)), 0.5 * (low + high))
    return np.asarray(np.linalg.inv(instances.poses[0] @ box), dtype=np.float64)


def _packed(road: RoadMap) -> NDArray[np.uint8]:
    """The road map with its strip of edge distances, 8 bits per channel: llvmpipe samples it three times as fast.

    Its sides are multiples of the coarsest level's cell.
    """
    strip = (road.edge_distance - _STRIP[0]) / _STRIP[1]
    channels = np.stack([strip, road.light, road.gravel, road.lushness], axis=-1)
    coarsest = 2 ** (_ROAD_LEVELS - 1)
    ny, nx = (-(-side // coarsest) * coarsest for side in strip.shape)
    return to_bytes(np.asarray(cv2.resize(channels, (nx, ny), interpolation=cv2.INTER_CUBIC), dtype=np.float32))
