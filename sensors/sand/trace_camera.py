"""Webcam behind a rover's left rear wheel: images of sand and traces.

Sun and sky light the sand outside the rover's shadow. The camera's tone curve is a square root, near that of sRGB. Not
modelled: chromatic aberration, focus, dust.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.camera.image_formation import AutoExposure, LightNoise
from sensors.messages import ColourImage, GreyImage
from sensors.sand.casters import Casters
from sensors.sand.grid import Floats
from sensors.sand.trace_rig import TraceRig
from sensors.sand.view import Body, GroundView, VisibleGround
from sensors.sand.world import LUGS, SandWorld
from vehicle.clock import TICK
from vehicle.frames import FloatArray
from vehicle.rover.truth import RoverTruth

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
        self._world, self._rig, self._webcam, self._rng = world, rig, webcam, rng
        self._view = GroundView.of(rig.camera)
        self._casters = Casters.of(world.rover, mast=world.kind.mast, lugs=LUGS)
        pixels = rig.camera.width * rig.camera.height
        self._noise = LightNoise.draw(rng, webcam.read_noise, webcam.shot_noise, pixels)
        self._H = rig.image_of_ground()
        middle = np.linalg.solve(self._H, [rig.camera.cx, rig.camera.cy, 1.0])
        self._middle: tuple[float, float] = (middle[0] / middle[2], middle[1] / middle[2])  # of the view, in R [m]
        self._exposure: tuple[int, float, float] | None = None  # tick, gain and level of the last image
        self._newest: tuple[RoverTruth, _Light] | None = None  # truth and light of the last image
        light = world.light
        self._sun, self._sky = np.array(light.sun_colour), np.array(light.sky_colour)

    @property
    def rig(self) -> TraceRig:
        """True geometry of the camera."""
        return self._rig

    def sample(self, truth: RoverTruth) -> GreyImage:
        """Image whose exposure has its middle at the truth's tick."""
        light = self._light(truth)
        self._newest = truth, light
        level = self._level(light, np.float32(_SAND @ _LUMINANCE), self._sun @ _LUMINANCE, self._sky @ _LUMINANCE)
        level = self._blurred(level, self._smear(truth))
        gain = self._gain(truth.tick, float(level[::8, ::8].mean()))
        return self._compressed(self._noise.sensed(level, gain, self._rng))

    def colour(self, truth: RoverTruth) -> ColourImage:
        """The same view in colour for display: without noise, with the exposure of the last image."""
        newest = self._newest
        light = newest[1] if newest is not None and newest[0] is truth else self._light(truth)
        gain = 1.0 if self._exposure is None else self._exposure[1]
        tint = self._view.tint(light.ground, self._world)
        tint[light.hidden] = 1.0
        channels = []
        for k in range(3):
            albedo = tint * np.float32(_STONE[k] - _SAND[k]) + np.float32(_SAND[k])
            channels.append(cv2.convertScaleAbs(self._level(light, albedo, self._sun[k], self._sky[k]), alpha=gain))
        return np.asarray(cv2.merge(channels), dtype=np.uint8)

    def _light(self, truth: RoverTruth) -> _Light:
        """Light that reaches the pixels."""
        X_WC, world, view = truth.X_WB @ self._rig.X_RC, self._world, self._view
        ground, shade = self._ground(truth)
        direct, ambient = view.light(ground, world)
        direct *= shade
        hidden = view.draw(self._bodies(truth), X_WC, ground, world.light.direction, direct, ambient)
        return _Light(ground, direct, ambient, hidden)

    def _ground(self, truth: RoverTruth) -> tuple[VisibleGround, Floats]:
        """Visible ground, and the share of the sun's light that reaches it past the rover."""
        ground = self._view.look(truth.X_WB @ self._rig.X_RC, self._world)
        shade = self._casters.shadows(truth, self._world.light.direction, ground.x, ground.y, ground.z)
        return ground, self._view.full(shade)

    def _bodies(self, truth: RoverTruth) -> Iterator[Body]:
        """Rocks around the rover, and the watched wheel."""
        for rock in self._world.rocks:
            if math.dist(rock.place[:2], truth.pose[:2]) < _NEAR:
                yield rock.body()
        yield self._casters.wheel_body(truth, self._rig.watched)

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

    def _gain(self, tick: int, level: float) -> float:
        control = self._webcam.exposure
        if control is None:
            return 1.0
        before = self._exposure
        gain = (
            control.settled(level) if before is None else control.step(before[1], before[2], (tick - before[0]) * TICK)
        )
        self._exposure = tick, gain, level
        return gain

    def _compressed(self, image: GreyImage) -> GreyImage:
        if self._webcam.jpeg_quality is None:
            return image
        _, packed = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, self._webcam.jpeg_quality])
        return np.asarray(cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE), dtype=np.uint8)
