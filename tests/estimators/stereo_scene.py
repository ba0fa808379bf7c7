"""Stereo views with exact truth: a textured ground plane and a few textured walls, ray-cast without any renderer."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from estimators.calibration.epipolar import RightRotation, homography
from estimators.estimates import Motion
from estimators.rigid_motion import rotation_vector
from sensors.camera.rig import StereoCalibration
from sensors.messages import GreyImage, StereoFrame
from vehicle.frames import FloatArray, rotation_zyx, transform

Image: TypeAlias = NDArray[np.float32]

NOISE = 2.0  # [grey levels], as on the rendered frames
NEAREST_HORIZON = 1.0 / 200.0  # the ground is drawn up to here [1/m]


def texture(rng: np.random.Generator, size: int) -> Image:
    """Grey texture (size, size), periodic, with detail of every size."""
    k = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None]) * size
    k[0, 0] = np.inf
    waves = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((size, size))) / k**0.6, s=(size, size))
    return np.asarray(np.clip(120.0 + 30.0 * waves / waves.std(), 0.0, 255.0), dtype=np.float32)


def pyramid(image: Image, levels: int) -> list[Image]:
    """The image and its halvings."""
    images = [image]
    for _ in range(levels):
        halved = cv2.resize(images[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        images.append(np.asarray(halved, dtype=np.float32))
    return images


class Scene:
    """A ground plane z = 0 and vertical walls along both sides of the x axis, drawn by plane homographies.

    Rows are sampled twice and averaged, and textures filtered to the size of a pixel, so that the images are free of
    aliasing and corners are where the geometry has them.
    """

    texel = 0.02  # [m]

    def __init__(self, calibration: StereoCalibration, seed: int = 3) -> None:
        rng = np.random.default_rng(seed)
        self.size = (calibration.width, 2 * calibration.height)
        f = calibration.focal_length
        self.K = np.array([[f, 0.0, calibration.cx], [0.0, 2.0 * f, 2.0 * calibration.cy + 0.5], [0.0, 0.0, 1.0]])
        self.ground = pyramid(texture(rng, 2048), 7)
        self.walls = [
            (np.array([x, side * rng.uniform(6.0, 12.0), 0.0]), rng.uniform(-0.6, 0.6), pyramid(texture(rng, 256), 3))
            for x in np.arange(-60.0, 30.0, 7.0)
            for side in (-1.0, 1.0)
        ]

    def view(self, X_WC: FloatArray, rng: np.random.Generator) -> GreyImage:
        """The image of a camera at X_WC (4, 4), with sensor noise."""
        image = np.full(self.size[::-1], 200.0, np.float32)
        self._draw_ground(image, X_WC)
        for foot, yaw, levels in sorted(self.walls, key=lambda wall: -np.linalg.norm(wall[0] - X_WC[:3, 3])):
            self._draw_wall(image, X_WC, foot, np.array([np.cos(yaw), np.sin(yaw), 0.0]), levels)
        image = cv2.resize(image, (self.size[0], self.size[1] // 2), interpolation=cv2.INTER_AREA)
        noisy = image + NOISE * rng.standard_normal(image.shape, dtype=np.float32)
        return np.asarray(np.clip(np.rint(noisy), 0, 255), dtype=np.uint8)

    def _draw_ground(self, image: Image, X_WC: FloatArray) -> None:
        to_pixels = self.K @ X_WC[:3, :3].T @ np.column_stack([np.eye(3)[:, :2], -X_WC[:3, 3]])
        to_metres = np.asarray(np.linalg.inv(to_pixels), dtype=np.float64)
        u, v = np.arange(self.size[0])[None], np.arange(self.size[1])[:, None]
        inverse_depth = to_metres[2, 0] * u + to_metres[2, 1] * v + to_metres[2, 2]
        first = int(np.argmax(inverse_depth.max(axis=1) > NEAREST_HORIZON))
        seen = inverse_depth[first:] > NEAREST_HORIZON
        pixel = 1.0 / np.maximum(inverse_depth[:, self.size[0] // 2], NEAREST_HORIZON) / self.K[0, 0]  # across [m]
        footprint = np.sqrt(pixel**3 * self.K[0, 0] / X_WC[2, 3])  # geometric mean of across and along [m]
        level = np.clip(np.log2(np.maximum(footprint / self.texel, 1.0)), 0.0, len(self.ground) - 1.001)
        drawn = np.zeros_like(image)
        for number, texels in enumerate(self.ground):
            weight = np.asarray(np.maximum(0.0, 1.0 - np.abs(level - number)), dtype=np.float32)
            rows = np.flatnonzero(weight[first:] > 0.0) + first
            if len(rows) > 0:
                part = self._warped(texels, number, to_metres, (0, rows[0]), (self.size[0], rows[-1] + 1 - rows[0]))
                drawn[rows[0] : rows[-1] + 1] += weight[rows[0] : rows[-1] + 1, None] * part
        np.copyto(image[first:], drawn[first:], where=seen)

    def _draw_wall(
        self, image: Image, X_WC: FloatArray, foot: FloatArray, along: FloatArray, levels: list[Image]
    ) -> None:
        up, (width, height) = np.array([0.0, 0.0, 1.0]), (256 * self.texel, 256 * self.texel)
        corners = np.array([foot, foot + width * along, foot + width * along + height * up, foot + height * up])
        seen = (corners - X_WC[:3, 3]) @ X_WC[:3, :3]
        if seen[:, 2].min() < 2.0:
            return
        outline = (seen @ self.K.T)[:, :2] / seen[:, 2:]
        low = np.maximum(np.floor(outline.min(axis=0)).astype(int), 0)
        size = np.minimum(np.ceil(outline.max(axis=0)).astype(int), self.size) - low
        if size.min() < 4:
            return
        to_metres = np.linalg.inv(self.K @ X_WC[:3, :3].T @ np.column_stack([along, up, foot - X_WC[:3, 3]]))
        scale = seen[:, 2].mean() / self.K[0, 0] / self.texel
        number = int(np.clip(np.round(np.log2(max(scale, 1.0))), 0, len(levels) - 1))
        mask = np.zeros(tuple(size[::-1]), np.uint8)
        cv2.fillConvexPoly(mask, np.rint(outline - low).astype(np.int32), 1)
        part = self._warped(levels[number], number, to_metres, tuple(low), tuple(size))
        np.copyto(image[low[1] : low[1] + size[1], low[0] : low[0] + size[0]], part, where=mask > 0)

    def _warped(
        self, texels: Image, level: int, to_metres: FloatArray, corner: tuple[int, int], size: tuple[int, int]
    ) -> Image:
        scale = 1.0 / self.texel / 2**level
        to_texels = np.array([[scale, 0.0, 0.5 / 2**level - 0.5], [0.0, scale, 0.5 / 2**level - 0.5], [0.0, 0.0, 1.0]])
        shift = np.array([[1.0, 0.0, corner[0]], [0.0, 1.0, corner[1]], [0.0, 0.0, 1.0]])
        warped = cv2.warpPerspective(
            texels,
            to_texels @ to_metres @ shift,
            tuple(int(n) for n in size),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_WRAP,
        )
        return np.asarray(warped, dtype=np.float32)


@dataclass(frozen=True)
class Drive:
    """Frames of a drive and the true poses of the trailer body at them."""

    calibration: StereoCalibration
    frames: list[StereoFrame]
    bodies: list[FloatArray]

    def camera_motion(self, first: int, second: int) -> FloatArray:
        """True X_PC (4, 4) of the left camera between two frames."""
        X_SC = self.calibration.X_SC
        return np.linalg.inv(self.bodies[first] @ X_SC) @ self.bodies[second] @ X_SC

    @staticmethod
    def run(odometry: Any, frames: Sequence[Any], memory: Any = None) -> tuple[Any, list[Any]]:
        """Memory of an odometry, or of another estimator, after some messages, and what it found."""
        found = []
        memory = odometry.init() if memory is None else memory
        for frame in frames:
            memory, one = odometry.step(memory, frame)
            found += [] if one is None else [one]
        return memory, found

    def errors(self, motions: Sequence[Motion]) -> FloatArray:
        """Of motions (n, 6), along the axes of the frame that each starts from: what their covariances are about."""
        truths = [self.camera_motion(motion.previous_tick // 100, motion.tick // 100) for motion in motions]
        return np.array([self.deviation(truth, motion.X_PC) for truth, motion in zip(truths, motions, strict=True)])

    def normalised(self, motions: Sequence[Motion]) -> FloatArray:
        """The same in standard deviations."""
        return self.errors(motions) / np.sqrt([np.diag(motion.covariance) for motion in motions])

    @staticmethod
    def deviation(truth: FloatArray, X: FloatArray) -> FloatArray:
        """Error (6,) of a pose along the axes that it starts from."""
        return np.concatenate([rotation_vector(truth[:3, :3] @ X[:3, :3].T), truth[:3, 3] - X[:3, 3]])

    @staticmethod
    def dark(frame: StereoFrame) -> StereoFrame:
        """A frame of the same moment without any light."""
        return replace(frame, left=np.zeros_like(frame.left), right=np.zeros_like(frame.right))

    def knocked(self, frame: StereoFrame, rotation: RightRotation) -> StereoFrame:
        """The frame with its right camera turned: its image moves by the homography back from the straight one."""
        H = homography(self.calibration, rotation.matrix().T)
        size = (self.calibration.width, self.calibration.height)
        right = cv2.warpPerspective(frame.right, H, size, borderMode=cv2.BORDER_REPLICATE)
        return replace(frame, right=np.asarray(right, dtype=np.uint8))

    @staticmethod
    def dirty(frame: StereoFrame) -> StereoFrame:
        """The frame with dirt over most of both lenses."""
        left, right = np.full_like(frame.left, 90), np.full_like(frame.right, 90)
        left[:, 500:800], right[:, 460:800] = frame.left[:, 500:800], frame.right[:, 460:800]
        return replace(frame, left=left, right=right)


def stereo_drive(calibration: StereoCalibration) -> Drive:
    """46 frames at 10 Hz."""
    scene, rng = Scene(calibration), np.random.default_rng(1)
    bodies = [body_pose(k) for k in range(46)]
    frames = []
    for k, X_WB in enumerate(bodies):
        X_WC = X_WB @ calibration.X_SC
        left, right = scene.view(X_WC, rng), scene.view(X_WC @ calibration.X_ClCr, rng)
        frames.append(StereoFrame(tick=100 * k, left=left, right=right))
    return Drive(calibration, frames, bodies)


def body_pose(k: int) -> FloatArray:
    """Trailer body 0.1 k seconds into a drive at 5 m/s: straight and yawing, then turning left, shaking all the way.

    In the end it brakes hard and stands from frame 42 on.
    """
    s = np.clip(0.1 * (43 - np.arange(1, k + 1)), 0.0, 0.5).sum()  # way of the hitch [m]
    ways = np.linspace(0.0, s, 2001)
    curvature = np.clip((ways - 5.0) / 8.0, 0.0, 1.0) / 15.0
    heading = np.concatenate([[0.0], np.cumsum(0.5 * (curvature[1:] + curvature[:-1]) * np.diff(ways))])
    x, y = np.trapezoid(np.cos(heading), ways), np.trapezoid(np.sin(heading), ways)
    yaw = heading[-1] - np.radians(10.0) * (1.0 - np.cos(s / 7.0))
    pitch, roll = np.radians(0.3) * np.sin(0.9 * s), np.radians(0.4) * np.sin(0.6 * s + 1.0)
    return transform(rotation_zyx(yaw, pitch, roll), np.array([x, y, 0.01 * np.sin(1.3 * s)]))
