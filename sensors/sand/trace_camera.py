"""Webcam behind a rover's left rear wheel: its images of sand and traces, by ray tracing.

Sun and sky light the sand outside the rover's shadow. The camera's tone curve is a square root, near that of sRGB. Not
modelled: chromatic aberration, focus, dust.

Only rays between every second row and column of pixels are traced, the others are interpolated. The error is below the
relief within two pixels, some tenths of a millimetre.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.camera.image_formation import AutoExposure, ExposureControl, LightNoise
from sensors.camera.rig import CameraModel
from sensors.messages import ColourImage, GreyImage
from sensors.sand.field import decoded
from sensors.sand.grid import TEXEL, Floats, Window, window_around
from sensors.sand.solids import Casters, Hits
from sensors.sand.trace_rig import TraceRig
from sensors.sand.world import LUGS, SandWorld
from vehicle.engine.compiler import kernel
from vehicle.frames import FloatArray
from vehicle.rover.truth import RoverTruth

_STEPS: Final = 3  # of the fixed-point iteration; each reduces the error by slope times tangent of the view angle
_AROUND: Final = 0.05  # margin around the ground that is visible by plane geometry [m]
_BORDER: Final = 4  # of rays around the image [px]
_NEAREST: Final = 0.1  # smallest depth of a body [m]
_BOWED: Final = 6  # largest bend of a straight edge by the lens [px]
_NUMBERS: Final = (f"TEXEL={TEXEL}f",)
_LEAST_FALL: Final = 0.05  # smallest descent of a ray to the ground, over its depth


class Body(Protocol):
    """Body on the ground, such as ``sensors.sand.solids.Ellipsoid``."""

    @property
    def corners(self) -> FloatArray:
        """Corners of its bounding box (8, 3) in W [m]."""

    def hit(self, eye: FloatArray, rays: Floats, sun: FloatArray) -> Hits:
        """Intersections with rays (..., 3) from an eye."""


class VisibleGround(NamedTuple):
    """Places (h / 2, w / 2) on the ground that are seen: one for four pixels, and a border around the image."""

    window: Window
    u: Floats  # column and row in the window [texels]
    v: Floats
    x: Floats  # in W [m]
    y: Floats
    z: Floats


@dataclass(frozen=True, slots=True, eq=False)
class GroundView:
    """Ray tracer of one camera."""

    camera: CameraModel
    rays: Floats  # (2, h, w) x and y at depth 1 of each pixel
    between: Floats  # (2, h / 2 + .., w / 2 + ..) the same for the traced rays, one between four pixels, and a border

    @classmethod
    def of(cls, camera: CameraModel) -> "GroundView":
        """Ray tracer for all pixels of a camera."""
        v, u = np.mgrid[0.0 : camera.height, 0.0 : camera.width]
        row = np.arange(0.5 - _BORDER, camera.height + _BORDER - 1, 2.0)
        column = np.arange(0.5 - _BORDER, camera.width + _BORDER - 1, 2.0)
        pixels = np.stack([u, v], axis=-1), np.stack(np.meshgrid(column, row), axis=-1)
        rays, between = (np.ascontiguousarray(np.moveaxis(camera.rays(at), -1, 0), dtype=np.float32) for at in pixels)
        return cls(camera, rays, between)

    def full(self, half: Floats, *part: slice) -> Floats:
        """Image for all pixels, or for a part (rows, columns), from values of the traced rays."""
        spans = part or tuple(slice(0, size) for size in self.rays.shape[1:])
        near = tuple(slice((span.start + _BORDER) // 2 - 1, (span.stop + _BORDER + 1) // 2 + 1) for span in spans)
        wide = cv2.resize(half[near], None, fx=2.0, fy=2.0, interpolation=cv2.INTER_LINEAR)
        inner = zip(spans, (_BORDER - 2 * rays.start for rays in near), strict=True)
        return np.asarray(wide[tuple(slice(span.start + by, span.stop + by) for span, by in inner)], dtype=np.float32)

    def footprint(self, X_WC: FloatArray, world: SandWorld) -> FloatArray:
        """Outline (n, 2) of the visible ground, taken as a plane [m].

        Raises:
            ValueError: if the camera is below the ground or does not look down at it.
        """
        b = self.between
        edge = np.concatenate([b[:, 0, ::16], b[:, -1, ::16], b[:, ::16, 0], b[:, ::16, -1], b[:, -1, -1:]], axis=1)
        rays = edge.T.astype(float) @ X_WC[:3, :2].T + X_WC[:3, 2]
        eye = X_WC[:3, 3]
        a, bx, by = _plane(world, eye)
        fall = bx * rays[:, 0] + by * rays[:, 1] - rays[:, 2]
        above = eye[2] - (a + bx * eye[0] + by * eye[1])
        if above <= 0.0 or fall.min() < _LEAST_FALL:
            raise ValueError(f"the trace camera is {above:.2f} m above the ground and must look down at it")
        return np.asarray(eye[:2] + (above / fall)[:, None] * rays[:, :2])

    def look(self, X_WC: FloatArray, world: SandWorld) -> VisibleGround:
        """Visible ground from X_WC (4, 4)."""
        window = window_around(self.footprint(X_WC, world), _AROUND)
        height, eye, corner = world.field.height(window), X_WC[:3, 3], window.corner
        a, bx, by = _plane(world, eye)
        ex, ey = ((eye[:2] - corner) / TEXEL).tolist()
        below = a + bx * eye[0] + by * eye[1] - eye[2]  # the plane under the eye [m]
        compiled = kernel("sensors.sand", "view.c", "look", _NUMBERS)
        if compiled is None:
            u, v, z = self._traced(X_WC, height, (ex, ey, below, bx, by))
        else:
            u, v, z = places = np.empty((3, *self.between.shape[1:]), np.float32)
            numbers = np.array([*X_WC[:3, :3].ravel(), ex, ey, eye[2], below, bx, by], np.float32)
            compiled(u.size, _STEPS, *height.shape, self.between, numbers, height, places)
        x, y = u * np.float32(TEXEL) + np.float32(corner[0]), v * np.float32(TEXEL) + np.float32(corner[1])
        return VisibleGround(window, u, v, x, y, z)

    def _traced(self, X_WC: FloatArray, height: Floats, plane: tuple[float, ...]) -> tuple[Floats, Floats, Floats]:
        """Column and row [texels] and height [m] of the places that the rays meet; iterated from a plane."""
        ex, ey, below, bx, by = (np.float32(number) for number in plane)
        rx, ry, rz = _turned(self.between, X_WC)
        kx, ky = rx / rz, ry / rz  # horizontal distance of a ray per metre of rise
        down: Floats = np.divide(below, 1.0 - bx * kx - by * ky, dtype=np.float32)
        kx *= np.float32(1.0 / TEXEL)
        ky *= np.float32(1.0 / TEXEL)
        eye_z = np.float32(X_WC[2, 3])
        for _ in range(_STEPS):
            down = _looked_up(height, ex + kx * down, ey + ky * down) - eye_z
        return ex + kx * down, ey + ky * down, down + eye_z

    def light(self, ground: VisibleGround, shade: Floats, world: SandWorld) -> tuple[Floats, Floats]:
        """Shares of the light of sun and sky that open ground reflects to every pixel; ``shade`` as the places."""
        lit = world.field.light(ground.window)
        compiled = kernel("sensors.sand", "view.c", "reflect", _NUMBERS)
        if compiled is not None:
            direct, ambient = np.empty((2, *self.rays.shape[1:]), np.float32)
            sizes = (*direct.shape, _BORDER, shade.shape[1], *lit.shape[:2])
            compiled(*sizes, ground.u, ground.v, shade, lit, direct, ambient)
            return direct, ambient
        direct, ambient = cv2.split(decoded(_looked_up(lit, self.full(ground.u), self.full(ground.v))))
        return np.asarray(direct * self.full(shade), dtype=np.float32), np.asarray(ambient, dtype=np.float32)

    def tint(self, ground: VisibleGround, world: SandWorld) -> Floats:
        """Greyness of the ground at every pixel, 0 to 1."""
        tint = _looked_up(world.field.tint(ground.window), ground.u, ground.v)
        return self.full(np.asarray(tint, dtype=np.float32)) * np.float32(1.0 / 255.0)

    def draw(
        self,
        bodies: Iterable[Body],
        X_WC: FloatArray,
        ground: VisibleGround,
        sun: FloatArray,
        direct: Floats,
        ambient: Floats,
    ) -> NDArray[np.bool_]:
        """Draw the visible parts of bodies into the shares of light.

        Returns:
            Mask of the pixels in which they hide the ground.
        """
        hidden = np.zeros(direct.shape, dtype=bool)
        for body in bodies:
            part = self._part(X_WC, body.corners)
            if part is None:
                continue
            rays = np.stack(_turned(self.rays[:, *part], X_WC), axis=-1)
            hits = body.hit(X_WC[:3, 3], rays, sun)
            z = self.full(ground.z, *part)[hits.met]
            to_ground = (z - np.float32(X_WC[2, 3])) / rays[..., 2][hits.met]
            first = hits.depth < to_ground
            shown = hits.met
            shown[hits.met] = first
            direct[part][shown] = 0.5 * (hits.facing * hits.albedo)[first]
            ambient[part][shown] = 0.5 * (hits.sky * hits.albedo)[first]
            hidden[part] |= shown
        return hidden

    def _part(self, X_WC: FloatArray, corners: FloatArray) -> tuple[slice, slice] | None:
        """Rows and columns that show a box with corners (n, 3) in W; None if it is out of view."""
        p_C = (corners - X_WC[:3, 3]) @ X_WC[:3, :3]
        if p_C[:, 2].min() < _NEAREST:
            return None  # too near to be drawn
        u, v = self.camera.project(p_C).T
        rows, columns = (
            slice(max(0, int(at.min()) - _BOWED), min(size, int(at.max()) + _BOWED + 1))
            for at, size in ((v, self.camera.height), (u, self.camera.width))
        )
        return None if rows.stop <= rows.start or columns.stop <= columns.start else (rows, columns)


def _turned(rays: Floats, X_WC: FloatArray) -> list[Floats]:
    """Components in W (x, y, z) of rays (2, ...) with depth 1."""
    x, y = rays
    turned = []
    for along_x, along_y, along_z in X_WC[:3, :3].astype(np.float32):
        along = along_x * x
        along += along_y * y
        along += along_z
        turned.append(along)
    return turned


def _looked_up(layer: NDArray[Any], u: Floats, v: Floats) -> NDArray[Any]:
    return np.asarray(cv2.remap(layer, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


def _plane(world: SandWorld, place: FloatArray) -> tuple[float, float, float]:
    """Coefficients (a, bx, by) of the plane a + bx x + by y that is tangent to the large shape below a place."""
    x, y = place[:2].tolist()
    bx, by = np.asarray(world.terrain.gradient(x, y)).reshape(2).tolist()
    return float(world.terrain.height(x, y)) - bx * x - by * y, bx, by


_LUMINANCE: Final = np.array([0.299, 0.587, 0.114])  # ITU-R BT.601
_SUN, _SKY = 1.3, 0.7  # shares of the light for a sun of middle height; the sky's share has light from sand around
_NEAR: Final = 2.5  # distance from the rover's middle within which rocks may be in view [m]
_SAND, _STONE = np.array([0.56, 0.45, 0.33]), np.array([0.40, 0.37, 0.35])  # albedo in red, green, blue
_SHORTEST_SMEAR: Final = 1.0  # below it the blur of the lens dominates [px]
_REGULATED: Final = AutoExposure(time_constant=1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Webcam:
    """Imperfections of a webcam; the numbers are assumed for a cheap one of 2007."""

    read_noise: float = 2.0  # standard deviation, independent of the light [grey levels]
    shot_noise: float = 3.0  # standard deviation of a white pixel's light at a gain of 1 [grey levels]
    blur: float = 0.6  # of lens and demosaicing, standard deviation [px]
    exposure_time: float = 0.01  # [s]
    exposure: AutoExposure | None = _REGULATED  # None: fixed
    jpeg_quality: int | None = 85  # None: no compression


class _Light(NamedTuple):
    """Visible ground, and the reflected shares of the light of sun and sky (h, w)."""

    ground: VisibleGround
    direct: Floats
    ambient: Floats
    hidden: NDArray[np.bool_]  # True where a rock or the wheel hides the ground; they are as grey as stones


class TraceCamera:
    """Camera that samples ground images of a rover.

    Args:
        world: the sand; ``SandWorld.drive`` must keep it up to date with the rover.
        rig: true geometry of the camera.
        webcam: imperfections of the camera.
        rng: draws the noise.
    """

    def __init__(self, world: SandWorld, rig: TraceRig, webcam: Webcam, rng: np.random.Generator) -> None:
        self._world, self.rig, self._webcam, self._rng = world, rig, webcam, rng
        self._view = GroundView.of(rig.camera)
        self._casters = Casters.of(world.rover, mast=world.kind.mast, lugs=LUGS)
        pixels = rig.camera.width * rig.camera.height
        self._noise = LightNoise.draw(rng, webcam.read_noise, webcam.shot_noise, pixels)
        self._H = rig.image_of_ground()
        middle = np.linalg.solve(self._H, [rig.camera.cx, rig.camera.cy, 1.0])
        self._middle: tuple[float, float] = (middle[0] / middle[2], middle[1] / middle[2])  # of the view, in R [m]
        self._exposure = ExposureControl(webcam.exposure)
        self._newest: tuple[RoverTruth, _Light] | None = None  # truth and light of the last image
        light = world.light
        self._sun, self._sky = np.array(light.sun_colour), np.array(light.sky_colour)

    def sample(self, truth: RoverTruth) -> GreyImage:
        """Image whose exposure has its middle at the truth's tick."""
        light = self._light(truth)
        self._newest = truth, light
        level = self._level(light, np.float32(_SAND @ _LUMINANCE), self._sun @ _LUMINANCE, self._sky @ _LUMINANCE)
        level = self._blurred(level, self._smear(truth))
        gain = self._exposure.gain(truth.tick, level)
        return self._compressed(self._noise.sensed(level, gain, self._rng))

    def colour(self, truth: RoverTruth) -> ColourImage:
        """The same view in colour for display: without noise, with the exposure of the last image."""
        newest = self._newest
        light = newest[1] if newest is not None and newest[0] is truth else self._light(truth)
        gain = 1.0 if self._exposure.last is None else self._exposure.last[1]
        tint = self._view.tint(light.ground, self._world)
        tint[light.hidden] = 1.0
        channels = np.empty((3, *tint.shape), np.uint8)
        compiled = kernel("sensors.sand", "view.c", "paint", _NUMBERS)
        for channel, sun, sky, sand, stone in zip(channels, self._sun, self._sky, _SAND, _STONE, strict=True):
            if compiled is None:
                albedo = tint * np.float32(stone - sand) + np.float32(sand)
                cv2.convertScaleAbs(self._level(light, albedo, sun, sky), channel, alpha=gain)
            else:
                numbers = np.array([_SUN * sun, _SKY * sky, sand, stone - sand, 255.0 * gain], np.float32)
                compiled(tint.size, numbers, light.direct, light.ambient, tint, channel)
        return np.asarray(cv2.merge(list(channels)), dtype=np.uint8)

    def _light(self, truth: RoverTruth) -> _Light:
        """Light that reaches the pixels."""
        X_WC, world, view = truth.X_WB @ self.rig.X_RC, self._world, self._view
        ground = view.look(X_WC, world)
        shade = self._casters.shadows(truth, world.light.direction, ground.x, ground.y, ground.z)
        direct, ambient = view.light(ground, shade, world)
        hidden = view.draw(self._bodies(truth), X_WC, ground, world.light.direction, direct, ambient)
        return _Light(ground, direct, ambient, hidden)

    def _bodies(self, truth: RoverTruth) -> Iterator[Body]:
        """Rocks around the rover, and the watched wheel."""
        for rock in self._world.rocks:
            if math.dist(rock.place[:2], truth.pose[:2]) < _NEAR:
                yield rock.body()
        yield self._casters.wheel_body(truth, self.rig.watched)

    def _level(self, light: _Light, albedo: np.float32 | Floats, sun: float, sky: float) -> Floats:
        """Grey levels at a gain of 1."""
        share = np.asarray(cv2.addWeighted(light.direct, _SUN * sun, light.ambient, _SKY * sky, 0.0), dtype=np.float32)
        share *= albedo
        cv2.sqrt(share, share)
        share *= np.float32(255.0)
        return share

    def _smear(self, truth: RoverTruth) -> FloatArray:
        """Motion of the middle of the view in the image during the exposure (2,) [px]."""
        v_x, v_y, yaw_rate = (truth.velocity * self._webcam.exposure_time).tolist()
        x, y = self._middle
        moved = np.array([[x, y, 1.0], [x - v_x + yaw_rate * y, y - v_y - yaw_rate * x, 1.0]]) @ self._H.T
        before, after = moved[:, :2] / moved[:, 2:]
        return np.asarray(after - before)

    def _blurred(self, level: Floats, smear: FloatArray) -> Floats:
        """Image blurred by lens and shutter; motion during the exposure is a straight smear."""
        if self._webcam.blur:
            level = np.asarray(cv2.GaussianBlur(level, (0, 0), self._webcam.blur), dtype=np.float32)
        if np.abs(smear).max() < _SHORTEST_SMEAR:
            return level
        reach = math.ceil(0.5 * float(np.abs(smear).max())) + 1
        kernel = np.zeros((2 * reach + 1, 2 * reach + 1), np.float32)
        ends = [np.round((reach + side * smear) * 256.0).astype(int).tolist() for side in (-0.5, 0.5)]
        cv2.line(kernel, ends[0], ends[1], (1.0,), 1, cv2.LINE_8, 8)
        return np.asarray(cv2.filter2D(level, -1, kernel / kernel.sum()), dtype=np.float32)

    def _compressed(self, image: GreyImage) -> GreyImage:
        if self._webcam.jpeg_quality is None:
            return image
        _, packed = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, self._webcam.jpeg_quality])
        return np.asarray(cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE), dtype=np.uint8)
