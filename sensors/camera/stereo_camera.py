"""Stereo cameras on a unit's body: ideal pinholes, and raw cameras with imperfections.

Light is measured in the renderer's grey levels and assumed proportional to them; nothing is brighter than the
renderer's white. Not modelled: chromatic aberration, focus, dead pixels, compression.
"""

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from sensors.camera.image_formation import (
    STILL,
    AutoExposure,
    ExposureControl,
    Floats,
    LensMap,
    LensSurface,
    LightNoise,
    NoiseBank,
    Shutter,
    Twist,
    covering_pinholes,
    grey,
    lens_surface,
    twist_between,
    without_alpha,
)
from sensors.camera.rig import RawStereoRig, StereoCalibration, mount_rotation
from sensors.messages import ColourImage, GreyImage, NearnessImage, StereoFrame
from vehicle.clock import TICK
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, transform


class PairSource(Protocol):
    """Renderer of both cameras' views, such as ``sensors.render.StereoRenderer``."""

    @property
    def calibration(self) -> StereoCalibration:
        """Calibration of both cameras."""

    def render(self, X_WB: FloatArray) -> tuple[ColourImage, ColourImage]:
        """Left and right image, RGB or RGBA, of cameras carried by a body at X_WB (4, 4)."""


class StereoCamera:
    """Samples stereo pairs from one unit of the vehicle; the noise of the images [grey levels] is independent."""

    def __init__(
        self, *, renderer: PairSource, unit: int, noise_std: float, rng: np.random.Generator, keep_colour: bool
    ) -> None:
        self._renderer, self._unit, self._rng, self._keep_colour = renderer, unit, rng, keep_colour
        pixels = renderer.calibration.width * renderer.calibration.height
        self._bank = NoiseBank.draw(rng, noise_std, pixels)

    @property
    def calibration(self) -> StereoCalibration:
        """Exact calibration of the cameras."""
        return self._renderer.calibration

    def sample(self, truth: Truth) -> StereoFrame:
        """Stereo pair captured at the truth's tick; ``colour`` is the left image without noise."""
        left, right = self._renderer.render(truth.bodies[self._unit])
        return StereoFrame(
            tick=truth.tick,
            left=self._bank.added_to(left, self._rng),
            right=self._bank.added_to(right, self._rng),
            colour=without_alpha(left) if self._keep_colour else None,
        )


_PIXELS_AROUND = 24  # margin of the pinhole image for motion during an exposure [px]


@dataclass(frozen=True, slots=True, kw_only=True)
class Imperfections:
    """Differences between real cameras and pinholes, apart from lens distortion and pose."""

    twist: tuple[float, float, float] = (0.0, 0.0, 0.0)  # roll, yaw, pitch of the right camera per load transfer [rad]
    read_noise: float = 0.0  # standard deviation that does not depend on the light [grey levels]
    shot_noise: float = 0.0  # standard deviation of a white pixel's light at a gain of 1 [grey levels]
    exposure_time: float = 0.0  # [s]
    rolling_shutter: float = 0.0  # from first to last row [s]
    auto_exposure: AutoExposure | None = None  # None: fixed
    vignetting: float = 0.0  # share of the light lost in the corners
    dirt: float = 0.0  # share of the lens covered by dirt
    rain: float = 0.0  # share of the lens covered by drops
    glare: float = 0.0  # strength of the sun's glare: 1 for a dusty lens


class ViewSource(Protocol):
    """Renderer of two pinhole cameras at any poses, such as ``sensors.render.StereoRenderer``."""

    @property
    def calibration(self) -> StereoCalibration:
        """Calibration of the pinholes."""

    def render_from(self, X_WCl: FloatArray, X_WCr: FloatArray) -> tuple[ColourImage, ColourImage]:
        """Left and right image, RGB or RGBA."""

    def nearness(self) -> tuple[NearnessImage, NearnessImage]:
        """Inverse depth of the last images [1/m]."""


def pinholes_for(rig: RawStereoRig, imperfections: Imperfections) -> StereoCalibration:
    """Pinholes to be rendered for a rig."""
    moving = imperfections.exposure_time > 0.0 or imperfections.rolling_shutter > 0.0
    return covering_pinholes(rig, _PIXELS_AROUND if moving else 0)


class RawStereoCamera:
    """Samples raw stereo images from one unit of the vehicle; they are not rectified.

    Chassis twist: the mount follows the twist of the chassis, which is assumed proportional to the moment that shifts
    load from one side's wheels to the other's. At a load transfer of 1 the unit is about to roll over.

    The motion during an exposure is the mean motion since the previous capture: vibration faster than the frame rate
    does not blur.

    Args:
        renderer: of the pinholes of ``pinholes_for(rig, imperfections)``.
        rig: true rig without twist.
        imperfections: of both cameras.
        sun: unit vector (3,) towards the sun in W; None under clouds.
        unit: of the vehicle that carries the rig.
        rng: of noise, dirt and drops.
        keep_colour: True if frames carry the left colour image.
    """

    def __init__(
        self,
        *,
        renderer: ViewSource,
        rig: RawStereoRig,
        imperfections: Imperfections,
        sun: FloatArray | None,
        unit: int,
        rng: np.random.Generator,
        keep_colour: bool,
    ) -> None:
        self._renderer, self.rig, self._imperfections, self._unit = renderer, rig, imperfections, unit
        self._sun = sun if imperfections.glare > 0.0 else None
        self._rng, noise_rng, *lens_rngs = rng.spawn(4)
        self._keep_colour = keep_colour
        self._shutter = Shutter(exposure=imperfections.exposure_time, rolling=imperfections.rolling_shutter)
        self._lenses = [LensMap.of(camera, renderer.calibration) for camera in (rig.left, rig.right)]
        self._surfaces: list[LensSurface] = [
            lens_surface(
                lens_rng,
                lens,
                vignetting=imperfections.vignetting,
                dirt=imperfections.dirt,
                rain=imperfections.rain,
                glare=self._sun is not None,
            )
            for lens_rng, lens in zip(lens_rngs, self._lenses, strict=True)
        ]
        pixels = rig.left.width * rig.left.height
        self._noise = LightNoise.draw(noise_rng, imperfections.read_noise, imperfections.shot_noise, pixels)
        self._previous: tuple[int, FloatArray] | None = None  # tick and pose of the body at the last capture
        self._exposure = ExposureControl(imperfections.auto_exposure)

    def sample(self, truth: Truth) -> StereoFrame:
        """Stereo pair whose mid-exposure is at the truth's tick."""
        X_WB = truth.bodies[self._unit]
        X_BC = self._mounted(float(truth.load_transfer[self._unit]) if any(self._imperfections.twist) else 0.0)
        twist = self._motion(truth.tick, X_WB)
        drawn = self._renderer.render_from(*(X_WB @ X for X in X_BC))
        near = (None, None) if self._shutter.is_instant else self._renderer.nearness()
        light = [
            self._light(side, grey(drawn[side]), near[side], twist.seen_from(X_BC[side]), X_WB @ X_BC[side])
            for side in (0, 1)
        ]
        gain = self._exposure.gain(truth.tick, *light)
        left, right = (self._noise.sensed(image, gain, self._rng) for image in light)
        colour = None
        if self._keep_colour:
            tint = self._light(0, without_alpha(drawn[0]), near[0], twist.seen_from(X_BC[0]), X_WB @ X_BC[0])
            colour = np.asarray(np.clip(np.rint(gain * tint), 0, 255), dtype=np.uint8)
        return StereoFrame(tick=truth.tick, left=left, right=right, colour=colour)

    def _mounted(self, load_transfer: float) -> tuple[FloatArray, FloatArray]:
        """X_SC of both cameras, the right one turned by the twist of the chassis."""
        twisted = transform(
            mount_rotation(*(load_transfer * angle for angle in self._imperfections.twist)), np.zeros(3)
        )
        return self.rig.X_SC, self.rig.X_SC @ self.rig.X_ClCr @ twisted

    def _motion(self, tick: int, X_WB: FloatArray) -> Twist:
        """Velocity of the body since the last capture."""
        previous, self._previous = self._previous, (tick, X_WB)
        return STILL if previous is None else twist_between(previous[1], X_WB, (tick - previous[0]) * TICK)

    def _light(
        self, side: int, image: GreyImage, nearness: NearnessImage | None, twist: Twist, X_WC: FloatArray
    ) -> Floats:
        """Light on one image sensor [grey levels], from the grey or colour image of the pinhole in its place."""
        lens, surface = self._lenses[side], self._surfaces[side]
        if nearness is None:
            gathered = lens.apply(image).astype(np.float32)
        else:
            f = self._renderer.calibration.focal_length
            gathered = self._shutter.exposed(image, lens, nearness, twist, f)
        light = surface.transmitted(gathered)
        if self._sun is None:
            return light
        veil = surface.glare(X_WC[:3, :3].T @ self._sun, self._imperfections.glare)
        veil = np.asarray(cv2.resize(veil, (light.shape[1], light.shape[0])), dtype=np.float32)
        return light + (veil if light.ndim == 2 else veil[..., None])
