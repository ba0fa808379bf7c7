"""Motion blur and rolling shutter: motion in the image while the shutter is open."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.camera.lens_map import Floats, LensMap, resampled
from vehicle.frames import FloatArray, cross, inverse, skew, so3_exp, transform

_MOST_TAPS: Final = 16  # samples of the average over an exposure; more than a pixel apart they become visible
_LONGEST: Final = 0.2  # time between captures from which a velocity is derived [s]


class Twist(NamedTuple):
    """Velocity of a frame along its own axes."""

    v: FloatArray  # (3,) of its origin [m/s]
    w: FloatArray  # (3,) [rad/s]

    def seen_from(self, X_BC: FloatArray) -> Twist:
        """Twist of a frame C that is fixed in this one, B."""
        R, p = X_BC[:3, :3], X_BC[:3, 3]
        return Twist(R.T @ (self.v + cross(self.w, p)), R.T @ self.w)


STILL: Final = Twist(np.zeros(3), np.zeros(3))


def twist_between(X_before: FloatArray, X_now: FloatArray, seconds: float) -> Twist:
    """Constant twist that moves a body from one pose (4, 4) to another; zero if the time is too long."""
    if not 0.0 < seconds <= _LONGEST:
        return STILL
    X = inverse(X_before) @ X_now
    turn = np.asarray(cv2.Rodrigues(X[:3, :3])[0], dtype=np.float64).ravel()
    translation: FloatArray = (np.eye(3) - 0.5 * skew(turn)) @ X[:3, 3]  # to turn^2/12: 0.02 % at 3 deg
    return Twist(translation / seconds, turn / seconds)


def moved(X_WB: FloatArray, twist: Twist, seconds: float) -> FloatArray:
    """Pose (4, 4) of a body that starts at X_WB (4, 4) and moves with a constant twist."""
    turn, shift = twist.w * seconds, twist.v * seconds
    X: FloatArray = X_WB @ transform(so3_exp(turn), shift + 0.5 * cross(turn, shift))
    return X


@dataclass(frozen=True, slots=True, kw_only=True)
class Shutter:
    """Exposure times of an image's rows, centred on the time stamp of the image."""

    exposure: float  # [s]
    rolling: float  # delay of the last row's exposure after the first row's [s]

    @property
    def is_instant(self) -> bool:
        """True if nothing can move during the exposure."""
        return self.exposure == 0.0 and self.rolling == 0.0

    def exposed(
        self, image: NDArray[np.uint8], lens: LensMap, nearness: Floats, twist: Twist, focal_length: float
    ) -> Floats:
        """Camera image as the mean over the exposure.

        Each pixel is looked up where its point was in the pinhole image, by its depth. Background uncovered at the
        edges of objects is approximated by its surroundings.

        Args:
            image: of the pinhole at mid-exposure, (h, w) or (h, w, 3).
            lens: the camera's pixels in it.
            nearness: inverse depth in the pinhole image (h, w) [1/m].
            twist: of the camera.
            focal_length: of the pinhole [px].
        """
        rows = np.linspace(-0.5, 0.5, len(lens.pixels), dtype=np.float32)[:, None] * np.float32(self.rolling)
        flow = _flow(lens.rays, _sampled(nearness, lens.pixels), twist, focal_length)
        if self.rolling > 0.0:  # the point's depth is that at its true place
            flow = _flow(lens.rays, _sampled(nearness, lens.pixels - rows[..., None] * flow), twist, focal_length)
        taps = self._taps(flow)
        times = self.exposure * ((np.arange(taps) + 0.5) / taps - 0.5)
        interpolation = cv2.INTER_CUBIC if taps == 1 else cv2.INTER_LINEAR  # cubic would not sharpen a mean of many
        total: Floats = np.zeros((*lens.pixels.shape[:2], *image.shape[2:]), dtype=np.float32)
        for time in times:
            cv2.accumulate(lens.apply(image, -(rows + np.float32(time))[..., None] * flow, interpolation), total)
        return np.asarray(total / np.float32(taps), dtype=np.float32)

    def _taps(self, flow: Floats) -> int:
        """Number of samples for which 99 % of the image moves by at most a pixel between two of them."""
        fastest = float(np.quantile(np.abs(flow[::8, ::8]).max(axis=-1), 0.99))
        return int(np.clip(np.ceil(fastest * self.exposure), 1, _MOST_TAPS))


def _sampled(nearness: Floats, pixels: Floats) -> Floats:
    return np.asarray(resampled(nearness, pixels, cv2.INTER_NEAREST), dtype=np.float32)


def _flow(rays: Floats, nearness: Floats, twist: Twist, focal_length: float) -> Floats:
    """Velocity (h, w, 2) of static points in the image of a moving pinhole [px/s]."""
    v, w = twist.v.astype(np.float32), twist.w.astype(np.float32)
    x, y = rays[..., 0], rays[..., 1]
    depth_rate = -v[2] * nearness - (w[0] * y - w[1] * x)  # over the depth [1/s]
    x_rate = -v[0] * nearness - (w[1] - w[2] * y) - x * depth_rate
    y_rate = -v[1] * nearness - (w[2] * x - w[0]) - y * depth_rate
    return np.float32(focal_length) * np.stack([x_rate, y_rate], axis=-1)
