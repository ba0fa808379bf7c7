"""Two views of a world in one framebuffer of pyrender's OpenGL context without a window.

Importing this module imports parts of pyrender and loads EGL.
"""

import ctypes
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from OpenGL import GL
from OpenGL.error import Error as OpenGlError
from OpenGL.platform import PLATFORM

from sensors.camera.rig import StereoCalibration
from sensors.render import egl
from sensors.render.pyrender_parts import ShaderProgram
from sensors.render.things import VERTEX, Things, VertexArray, in_views
from sensors.textures import to_bytes
from sensors.world import sky
from sensors.world.ground import RoadMap, line_range
from sensors.world.scenery import Instances
from sensors.world.things import FaceArray, Mesh, grid_faces
from sensors.world.traffic import MAX_VEHICLES
from sensors.world.world import World
from vehicle.frames import FloatArray, inverse, transform

Constants = Mapping[str, float | tuple[float, ...] | FloatArray]

_SHADERS = Path(__file__).parent / "shaders"
_fast: Any = PLATFORM.GL  # the library itself: PyOpenGL's wrappers take longer than the calls of a frame
FAILURES = (OSError, OpenGlError, RuntimeError)  # of an OpenGL that does not work here
_Size = ctypes.c_ssize_t
_VIEW = 64  # numbers of the block View of the shaders, padded to the alignment of buffers
_BLUR = 1.0 / 6.0 + 1.0 / 12.0  # variance of bilinear interpolation and of a texel's square along an axis [px^2]
_SHARPENED = np.diag([0.0, 1.0, 0.0]) - 0.5 * _BLUR * np.array([[0.0, 1.0, 0.0], [1.0, -4.0, 1.0], [0.0, 1.0, 0.0]])
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
    """Name of a new texture with mipmap levels of a periodic image side by side, and its sheet, see ``levels_of``."""
    levels, sheet = levels_of(image, count)
    texture = _new_texture(GL.GL_CLAMP_TO_EDGE, GL.GL_LINEAR, GL.GL_LINEAR)
    ny, nx = levels.shape[:2]
    GL.glTexImage2D(GL.GL_TEXTURE_2D, 0, GL.GL_RGBA8, nx, ny, 0, GL.GL_RGBA, GL.GL_UNSIGNED_BYTE, levels)
    return texture, sheet


def levels_of(image: NDArray[np.uint8], count: int) -> tuple[NDArray[np.uint8], tuple[float, ...]]:
    """Image with ``count`` mipmap levels of a periodic image (h, w, 4) side by side, and its sheet.

    The sheet is the size of the largest level and the margin around each, as shares of the new image. The sides of the
    given one are multiples of 2^(count - 1). All levels but the largest are sharpened by what bilinear samples blur.
    """
    levels = [image]
    for _ in range(1, count):
        half = cv2.resize(levels[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        levels.append(np.asarray(half, dtype=np.uint8))
    ny, nx = image.shape[0] + 2 * _MARGIN, sum(level.shape[1] + 2 * _MARGIN for level in levels)
    every, x = np.zeros((ny, nx, 4), dtype=np.uint8), 0
    for n, level in enumerate(levels):
        framed = np.pad(level, ((_MARGIN, _MARGIN), (_MARGIN, _MARGIN), (0, 0)), mode="wrap")
        every[: framed.shape[0], x : x + framed.shape[1]] = cv2.filter2D(framed, -1, _SHARPENED) if n else framed
        x += framed.shape[1]
    return every, (image.shape[1] / nx, image.shape[0] / ny, _MARGIN / nx, _MARGIN / ny)


def _new_texture(wrap: int, enlarge: int, shrink: int) -> int:
    """Name of a new texture, which is bound, with this wrapping and these filters."""
    texture = int(GL.glGenTextures(1))
    GL.glBindTexture(GL.GL_TEXTURE_2D, texture)
    for key in (GL.GL_TEXTURE_WRAP_S, GL.GL_TEXTURE_WRAP_T):
        GL.glTexParameteri(GL.GL_TEXTURE_2D, key, wrap)
    GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_MAG_FILTER, enlarge)
    GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_MIN_FILTER, shrink)
    return texture


def linked(vertex: str, fragment: str, constants: Constants) -> int:
    """Name of a new program of two files in ``shaders``, in which the constants are defined."""
    defines = {name: _literal(value) for name, value in constants.items()}
    program = ShaderProgram(str(_SHADERS / f"{vertex}.vert"), str(_SHADERS / f"{fragment}.frag"), defines=defines)
    program._add_to_context()
    return int(program._program_id)


def _literal(value: float | tuple[float, ...] | FloatArray) -> str:
    """A number or vector as text of a shader."""
    if isinstance(value, int):
        return str(value)
    numbers = np.atleast_1d(value).tolist()
    return f"vec{len(numbers)}{tuple(numbers)}" if len(numbers) > 1 else repr(numbers[0])


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
class Geometry:
    """Vertices and triangles in buffers of OpenGL."""

    array: int
    vertices: int
    indices: int

    @classmethod
    def of(cls, vertices: VertexArray, faces: FaceArray | None) -> "Geometry":
        """New buffers; without faces their number may change with every frame."""
        array, (stored, indices) = int(GL.glGenVertexArrays(1)), GL.glGenBuffers(2)
        GL.glBindVertexArray(array)
        GL.glBindBuffer(GL.GL_ARRAY_BUFFER, stored)
        GL.glBufferData(GL.GL_ARRAY_BUFFER, vertices.nbytes, vertices.view(np.uint8), GL.GL_STATIC_DRAW)
        GL.glBindBuffer(GL.GL_ELEMENT_ARRAY_BUFFER, indices)
        if faces is not None:
            GL.glBufferData(GL.GL_ELEMENT_ARRAY_BUFFER, faces.nbytes, np.ascontiguousarray(faces), GL.GL_STATIC_DRAW)
        for at, (layout, offset, *_) in enumerate((VERTEX.fields or {}).values()):
            number = GL.GL_HALF_FLOAT if layout.base == np.float16 else GL.GL_FLOAT
            GL.glEnableVertexAttribArray(at)
            GL.glVertexAttribPointer(at, *layout.shape, number, False, VERTEX.itemsize, ctypes.c_void_p(offset))
        return cls(array, int(stored), int(indices))


def plain_vertices(mesh: Mesh) -> VertexArray:
    """Vertices of a mesh in W without a tint."""
    vertices = np.zeros(len(mesh.vertices), dtype=VERTEX)
    vertices["position"], vertices["normal"], vertices["uv"] = mesh.vertices, mesh.normals, mesh.uv
    return vertices


def _address(array: NDArray[Any]) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def draw(first: int, count: int) -> None:
    """Draw triangles of the bound geometry, given the first index and the number of indices."""
    _fast.glDrawElements(GL.GL_TRIANGLES, count, GL.GL_UNSIGNED_INT, ctypes.c_void_p(4 * first))


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


def sky_dome(sides: int = 24, rings: int = 4) -> Mesh:
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
_MOST_STRETCH = 3.0  # of a pixel's footprint; two samples of ground.frag then lie 1.5 of its widths apart
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


class PairRenderer:
    """Draws both views with one set of OpenGL objects; one call reads both back."""

    def __init__(self, world: World, calibration: StereoCalibration, context: egl.Context) -> None:
        self._context, self._projection = context, projection(calibration)
        self._width, self._height = calibration.width, calibration.height
        self._rays = _rays(calibration)
        nearest_level = GL.GL_LINEAR_MIPMAP_NEAREST  # as good for tracking as trilinear filtering, at half the cost
        self._textures = {key: upload_texture(texture[::-1], nearest_level) for key, texture in world.textures.items()}
        self._panorama = upload_texture(world.panorama[::-1], GL.GL_LINEAR)
        self._programs = _programs(world, _bind_ground_textures(world))
        transparent = {key for key, texture in world.textures.items() if texture.shape[2] == 4}
        self._things = Things(world.scenery, world.moving, transparent)
        self._instanced = Geometry.of(self._things.vertices, None)
        self._blocks = in_blocks(world.ground)
        self._ground = Geometry.of(plain_vertices(world.ground), self._blocks.faces)
        dome = sky_dome()
        self._sky, self._sky_size = Geometry.of(plain_vertices(dome), dome.faces), dome.faces.size
        self._views = np.zeros((2, _VIEW), dtype=np.float32)
        self._view_buffer = int(GL.glGenBuffers(1))
        GL.glBindBuffer(GL.GL_UNIFORM_BUFFER, self._view_buffer)
        GL.glBufferData(GL.GL_UNIFORM_BUFFER, self._views.nbytes, None, GL.GL_STREAM_DRAW)
        self.place(world.moving)
        self._make_framebuffer()

    @property
    def name(self) -> str:
        """Name and version of the OpenGL renderer."""
        return self._context.name

    def close(self) -> None:
        """Free the context and all objects in it."""
        self._context.close()

    def draw(self, X_WCl: FloatArray, X_WCr: FloatArray) -> None:
        """Draw the views of the left and the right camera at poses X_WC (4, 4)."""
        self._context.platform.make_current()
        VPs = [self._projection @ inverse(X_WC) for X_WC in (X_WCl, X_WCr)]
        for view, X_WC, VP in zip(self._views, (X_WCl, X_WCr), VPs, strict=True):
            view[:16], view[16:32] = VP.ravel(), (self._projection @ transform(X_WC[:3, :3].T, np.zeros(3))).ravel()
            view[32:35], view[35] = X_WC[:3, 3], self._stretch(X_WC)
        _fast.glBufferSubData(GL.GL_UNIFORM_BUFFER, _Size(0), _Size(self._views.nbytes), _address(self._views))
        indices, numbers = self._things.seen(VPs, X_WCl[:3, 3])
        _fast.glBindVertexArray(self._instanced.array)
        _fast.glBufferData(GL.GL_ELEMENT_ARRAY_BUFFER, _Size(indices.nbytes), _address(indices), GL.GL_STREAM_DRAW)
        runs = list(self._blocks.runs(in_views(VPs, self._blocks.spheres)))
        _fast.glClear(GL.GL_DEPTH_BUFFER_BIT)  # the sky covers the rest
        for index in (0, 1):
            _fast.glViewport(0, index * self._height, self._width, self._height)
            start, size = _Size(index * self._views[0].nbytes), _Size(self._views[0].nbytes)
            _fast.glBindBufferRange(GL.GL_UNIFORM_BUFFER, 0, self._view_buffer, start, size)
            self._draw_things(numbers)
            self._draw_ground(runs)
            self._draw_sky()
        if error := _fast.glGetError():
            raise RuntimeError(f"OpenGL answers {error:#x}")

    def place(self, moved: tuple[Instances, ...]) -> None:
        """Move the moving things and their shadows."""
        if not moved:
            return
        self._context.platform.make_current()
        vertices = self._things.place(moved)
        before = self._things.vertices.nbytes - vertices.nbytes
        GL.glBindBuffer(GL.GL_ARRAY_BUFFER, self._instanced.vertices)
        GL.glBufferSubData(GL.GL_ARRAY_BUFFER, before, vertices.nbytes, vertices.view(np.uint8))
        boxes = [_into_box(instances) for instances in moved] + [_NO_BOX] * (MAX_VEHICLES - len(moved))
        GL.glUseProgram(self._programs["ground"])
        location = GL.glGetUniformLocation(self._programs["ground"], "into_box")
        GL.glUniformMatrix4fv(location, len(boxes), GL.GL_TRUE, np.array(boxes, dtype=np.float32))

    def read_colour(self) -> NDArray[np.uint8]:
        """Both images (2, height, width, 4), RGBA: reading RGB from OpenGL takes twice as long."""
        pixels = np.empty((2, self._height, self._width, 4), dtype=np.uint8)
        self._read(GL.GL_RGBA, GL.GL_UNSIGNED_BYTE, pixels)
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
        self._read(GL.GL_DEPTH_COMPONENT, GL.GL_FLOAT, depth)
        return depth

    def _read(self, layout: int, number: int, pixels: NDArray[Any]) -> None:
        _fast.glReadPixels(0, 0, self._width, 2 * self._height, layout, number, _address(pixels))

    def _make_framebuffer(self) -> None:
        """Create one framebuffer for both views, the right one above the left one; without costly multisampling."""
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, int(GL.glGenFramebuffers(1)))
        formats = (GL.GL_RGBA8, GL.GL_DEPTH_COMPONENT32F)
        attachments = (GL.GL_COLOR_ATTACHMENT0, GL.GL_DEPTH_ATTACHMENT)
        for buffer, layout, attachment in zip(GL.glGenRenderbuffers(2), formats, attachments, strict=True):
            GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, buffer)
            GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, layout, self._width, 2 * self._height)
            GL.glFramebufferRenderbuffer(GL.GL_FRAMEBUFFER, attachment, GL.GL_RENDERBUFFER, buffer)
        for capability in (GL.GL_DEPTH_TEST, GL.GL_CULL_FACE):
            GL.glEnable(capability)
        GL.glFrontFace(GL.GL_CW)  # the projection flips the image
        GL.glDepthFunc(GL.GL_LEQUAL)  # the sky lies on the far plane
        GL.glActiveTexture(GL.GL_TEXTURE0)

    def _draw_things(self, numbers: list[int]) -> None:
        """Draw a number of indices of each kind."""
        _fast.glBindVertexArray(self._instanced.array)
        first = 0
        for kind, number in zip(self._things.kinds, numbers, strict=True):
            if number:
                culled = _fast.glEnable if kind.program == "thing" else _fast.glDisable  # leaves have two sides
                culled(GL.GL_CULL_FACE)
                _fast.glUseProgram(self._programs[kind.program])
                _fast.glBindTexture(GL.GL_TEXTURE_2D, self._textures[kind.texture])
                draw(first, number)
            first += number
        _fast.glEnable(GL.GL_CULL_FACE)

    def _draw_ground(self, runs: list[tuple[int, int]]) -> None:
        _fast.glUseProgram(self._programs["ground"])
        _fast.glBindVertexArray(self._ground.array)
        for first, count in runs:
            draw(3 * first, 3 * count)

    def _stretch(self, X_WC: FloatArray) -> float:
        """Length over width of the least elongated pixel on level ground, limited to ground.frag's samples."""
        steepest = float((self._rays @ -X_WC[2, :3]).max())
        return min(1.0 / max(steepest, 1e-3), _MOST_STRETCH)

    def _draw_sky(self) -> None:
        """Draw the sky where nothing else was drawn; it needs no depth of its own."""
        _fast.glUseProgram(self._programs["sky"])
        _fast.glBindTexture(GL.GL_TEXTURE_2D, self._panorama)
        _fast.glBindVertexArray(self._sky.array)
        _fast.glDepthMask(False)
        draw(0, self._sky_size)
        _fast.glDepthMask(True)


def _programs(world: World, sheets: Constants) -> dict[str, int]:
    """Names of the programs that things and the parts of the ground are drawn with."""
    constants = {**_constants(world), **sheets}
    programs = {
        "thing": linked("thing", "thing", constants),
        "leaves": linked("thing", "leaves", constants),
        "sky": linked("sky", "sky", constants),
        "ground": linked("ground", "ground", constants),
    }
    GL.glUseProgram(programs["ground"])
    for unit, sampler in enumerate(_GROUND_SAMPLERS, start=1):
        GL.glUniform1i(GL.glGetUniformLocation(programs["ground"], sampler), unit)
    return programs


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


_GROUND_SAMPLERS = ("detail", "road", "looks", "holes", "lines")  # at the texture units from 1 on


def _bind_ground_textures(world: World) -> Constants:
    """Upload the ground's textures and leave them bound; return the constants of the shaders that describe them."""
    road, condition = world.road, world.condition
    packed = _packed(road)
    cell = road.cell * road.light.shape[1] / packed.shape[1]
    textures: dict[str, int] = {}
    textures["detail"], detail_sheet = upload_levels(world.detail, _DETAIL_LEVELS)
    textures["road"], road_sheet = upload_levels(packed, _ROAD_LEVELS)
    if condition.looks is not None:
        clamp = GL.GL_CLAMP_TO_EDGE
        textures["looks"] = upload_texture(to_bytes(condition.looks), GL.GL_LINEAR_MIPMAP_NEAREST, clamp)
    if condition.holes is not None:
        textures["holes"] = upload_table(condition.holes)
    if road.lines is not None:
        levels = 0.5 + 0.5 * road.lines / line_range(road)
        channels = to_bytes(np.concatenate([levels, levels[..., :1]], axis=-1))
        textures["lines"] = upload_texture(channels, GL.GL_LINEAR, GL.GL_CLAMP_TO_EDGE)
    for name, texture in textures.items():
        GL.glActiveTexture(GL.GL_TEXTURE1 + _GROUND_SAMPLERS.index(name))
        GL.glBindTexture(GL.GL_TEXTURE_2D, texture)
    return {
        "DETAIL_SHEET": detail_sheet,
        "ROAD_SHEET": road_sheet,
        "DETAIL_TEXELS": 2.0 * len(world.detail) ** 2,
        "ROAD_TEXELS": 2.0 * (world.detail_period / cell) ** 2,
    }


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
