"""Two views of a world in one framebuffer: pyrender's renderer with own shaders and drawing order.

Importing this module imports pyrender and loads EGL.
"""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray
from OpenGL import GL
from pyrender import Mesh as GlMesh
from pyrender import Scene
from pyrender.renderer import Renderer

from sensors.camera.rig import StereoCalibration
from sensors.render.context import (
    Context,
    Program,
    Uniforms,
    open_context,
    shader_cache,
    upload_table,
    upload_texture,
)
from sensors.render.instancing import Culler, InstancedPart, dome, draw, draw_run, in_blocks, in_view, primitive
from sensors.textures import to_bytes
from sensors.world import sky
from sensors.world.ground import Condition, RoadMap, line_range
from sensors.world.scenery import Instances
from sensors.world.traffic import MAX_VEHICLES
from sensors.world.world import World
from vehicle.frames import FloatArray, inverse, transform

_NEAR, _FAR = 0.3, 2500.0  # [m]
_STRIP = (-0.7, 1.02)  # lowest relevant edge distance, and range: steps of 4 mm [m]
_NO_BOX = transform(np.eye(3), np.full(3, 1e4))  # from W into a box far away
_CLEARANCE = 0.3  # height of the shadow-casting part of a vehicle above the ground [m]
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

    def __init__(self, context: Context, world: World, calibration: StereoCalibration) -> None:
        super().__init__(calibration.width, calibration.height)
        self._context, self._projection = context, projection(calibration)
        self._width, self._height = calibration.width, calibration.height
        self._rays = _rays(calibration)
        self._program_cache = shader_cache()
        self._programs = {
            name: Program.load(self._program_cache, vertex, name)
            for name, vertex in (("thing", "thing"), ("leaves", "thing"), ("sky", "sky"))
        }
        marks = {"LOOKS": world.condition.looks, "HOLES": world.condition.holes, "LINES": world.road.lines}
        defined = [name for name, mark in marks.items() if mark is not None]  # absent features cost nothing
        defined += ["TRAFFIC"] if world.moving else []
        defined += ["MARKED"] if defined else []
        self._programs["ground"] = Program.load(self._program_cache, "ground", "ground", *defined)
        nearest_level = GL.GL_LINEAR_MIPMAP_NEAREST  # as good for tracking as trilinear filtering, at half the cost
        self._transparent = {key for key, texture in world.textures.items() if texture.shape[2] == 4}
        self._textures = {key: upload_texture(texture[::-1], nearest_level) for key, texture in world.textures.items()}
        self._panorama = upload_texture(world.panorama[::-1], GL.GL_LINEAR)
        self._ground_textures = {  # by texture unit
            0: upload_texture(world.detail, nearest_level),  # see ground.frag
            1: upload_texture(_packed(world.road), nearest_level),  # smooth: its levels do not show
            **_uploaded(world.condition, world.road),
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
        scene = Scene()
        scene.add(GlMesh([self._ground, self._sky, *(part.primitive for part in parts)]))
        self._update_context(scene, 0)
        self._set_constants(world)
        self.place(world.moving)
        self._make_framebuffer()
        self._pixels = np.empty((2 * self._height, self._width, 4), dtype=np.uint8)

    @classmethod
    def open(cls, world: World, calibration: StereoCalibration) -> PairRenderer:
        """Renderer on a new context."""
        return cls(open_context(), world, calibration)

    @property
    def name(self) -> str:
        """Name and version of the OpenGL renderer."""
        return self._context.name

    def close(self) -> None:
        """Free all objects in the context, and the context."""
        self._context.make_current()
        GL.glDeleteTextures([*self._textures.values(), self._panorama, *self._ground_textures.values()])
        GL.glDeleteRenderbuffers(2, self._buffers)
        GL.glDeleteFramebuffers(1, [self._framebuffer])
        self.delete()
        self._context.close()

    def __del__(self) -> None:
        """Free nothing: pyrender would free objects of the context that happens to be current."""

    def draw(self, X_WCl: FloatArray, X_WCr: FloatArray) -> None:
        """Draw the views of the left and the right camera at poses X_WC (4, 4)."""
        self._context.make_current()
        self._prepare()
        views = [(X_WC, self._projection @ inverse(X_WC)) for X_WC in (X_WCl, X_WCr)]
        self._draw_things(views)
        self._draw_ground(views)
        self._draw_sky(views)
        GL.glBindVertexArray(0)

    def place(self, moved: tuple[Instances, ...]) -> None:
        """Move the moving things and their shadows."""
        self._context.make_current()
        for instances, parts in zip(moved, self._moving, strict=True):
            for part in parts:
                part.place(instances)
        boxes = [_into_box(instances) for instances in moved] + [_NO_BOX] * (MAX_VEHICLES - len(moved))
        self._programs["ground"].use({f"into_box[{k}]": box for k, box in enumerate(boxes)})

    def read_colour(self) -> NDArray[np.uint8]:
        """Both images (2, height, width, 3), RGB."""
        GL.glReadPixels(0, 0, *self._pixels.shape[1::-1], GL.GL_RGBA, GL.GL_UNSIGNED_BYTE, array=self._pixels)
        colour = cv2.cvtColor(self._pixels, cv2.COLOR_RGBA2RGB)  # reading RGB from OpenGL takes twice as long
        return np.asarray(colour, dtype=np.uint8).reshape(2, self._height, self._width, 3)

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

    def _set_constants(self, world: World) -> None:
        """Set the uniforms that never change."""
        light: Uniforms = {
            "sun": world.light.direction,
            "sun_colour": world.light.sun_colour,
            "sky_colour": world.light.sky_colour,
        }
        haze_colour = np.array(sky.HAZE) * world.light.sky_tint
        haze: Uniforms = {"haze": haze_colour, "haze_range": _HAZE_RANGE}
        road = world.road
        size = road.cell * np.array(road.light.shape[::-1])
        layers: Uniforms = {
            "detail": 0,
            "road": 1,
            "looks": 2,
            "holes": 3,
            "lines": 4,
            "line_range": line_range(road),
            "detail_period": world.detail_period,
        }
        on_map: Uniforms = {"map_origin": road.origin - 0.5 * road.cell, "map_size": size, "strip": _STRIP}
        self._programs["ground"].use({**light, **haze, **layers, **on_map})
        for name in ("thing", "leaves"):
            self._programs[name].use({**light, **haze, "surface": 0})
        self._programs["sky"].use({"panorama": 0})

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
            self._programs["ground"].use({"view_projection": VP, "camera": X_WC[:3, 3]})
            GL.glTexParameterf(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_LOD_BIAS, -math.log2(self._stretch(X_WC)))
            GL.glBindVertexArray(self._ground._vaid)
            for first, count in self._blocks.runs(in_view(VP, self._blocks.spheres)):
                draw_run(first, count)

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
        textures[2] = upload_texture(to_bytes(condition.looks), GL.GL_LINEAR_MIPMAP_NEAREST)
    if condition.holes is not None:
        textures[3] = upload_table(condition.holes)
    if road.lines is not None:
        levels = 0.5 + 0.5 * road.lines / line_range(road)
        textures[4] = upload_texture(to_bytes(np.concatenate([levels, levels[..., :1]], axis=-1)), GL.GL_LINEAR)
    return textures


def _into_box(instances: Instances) -> FloatArray:
    """From W (4, 4) into the box around a single thing; the box's sides are at +-1 there."""
    vertices = np.concatenate([part.mesh.vertices for part in instances.thing.parts])
    low, high = vertices.min(axis=0) + np.array([0.0, 0.0, _CLEARANCE]), vertices.max(axis=0)
    box = transform(np.diag(0.5 * (high - low)), 0.5 * (low + high))
    return np.asarray(np.linalg.inv(instances.poses[0] @ box), dtype=np.float64)


def _packed(road: RoadMap) -> NDArray[np.uint8]:
    """The road map with its strip of edge distances, 8 bits per channel: llvmpipe samples it three times as fast."""
    strip = (road.edge_distance - _STRIP[0]) / _STRIP[1]
    channels = np.stack([strip, road.light, road.gravel, road.lushness], axis=-1)
    return to_bytes(channels)
