"""What moves in the image while the shutter is open, and from its first row to its last."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.camera.lens_map import Floats, LensMap, resampled
from vehicle.frames import FloatArray, cross, inverse, skew, so3_exp, transform

_MOST_TAPS: Final = 16  # of the average that stands for an exposure; further apart than a pixel they begin to show
_LONGEST: Final = 0.2  # between two captures; after a longer one nothing is known of the motion [s]


class Twist(NamedTuple):
    """Velocity of a frame along its own axes."""

    v: FloatArray  # (3,) of its origin [m/s]
    w: FloatArray  # (3,) [rad/s]

    def seen_from(self, X_BC: FloatArray) -> Twist:
        """The twist of frame C that is fixed in this one, B."""
        R, p = X_BC[:3, :3], X_BC[:3, 3]
        return Twist(R.T @ (self.v + cross(self.w, p)), R.T @ self.w)


STILL: Final = Twist(np.zeros(3), np.zeros(3))


def twist_between(X_before: FloatArray, X_now: FloatArray, seconds: float) -> Twist:
    """The steady twist that took a body from one pose (4, 4) to another; none over too long a time."""
    if not 0.0 < seconds <= _LONGEST:
        return STILL
    X = inverse(X_before) @ X_now
    turn = np.asarray(cv2.Rodrigues(X[:3, :3])[0], dtype=np.float64).ravel()
    way: FloatArray = (np.eye(3) - 0.5 * skew(turn)) @ X[:3, 3]  # to turn^2/12: 0.02 % at 3 deg
    return Twist(way / seconds, turn / seconds)


def moved(X_WB: FloatArray, twist: Twist, seconds: float) -> FloatArray:
    """Where a steady twist takes a body from X_WB (4, 4)."""
    turn, way = twist.w * seconds, twist.v * seconds
    X: FloatArray = X_WB @ transform(so3_exp(turn), way + 0.5 * cross(turn, way))
    return X


@dataclass(frozen=True, slots=True, kw_only=True)
class Shutter:
    """When light falls on the rows of an image: the middle of it all is the time that the image is stamped with."""

    exposure: float  # [s]
    rolling: float  # the last row is exposed so much later than the first one [s]

    @property
    def is_instant(self) -> bool:
        """Whether nothing can move meanwhile."""
        return self.exposure == 0.0 and self.rolling == 0.0

    def exposed(
        self, image: NDArray[np.uint8], lens: LensMap, nearness: Floats, twist: Twist, focal_length: float
    ) -> Floats:
        """The camera's image as the mean of what it sees while the shutter is open.

        Each pixel is looked up where its point stood in the pinhole's image, by the depth there; at the edges of
        things what they uncover is guessed to be like its surroundings.

        Args:
            image: of the pinhole at the middle of the exposure, (h, w) or (h, w, 3).
            lens: what the camera's pixels are in it.
            nearness: inverse depth in the pinhole's image (h, w) [1/m].
            twist: of the camera.
            focal_length: of the pinhole [px].
        """
        rows = np.linspace(-0.5, 0.5, len(lens.at), dtype=np.float32)[:, None] * np.float32(self.rolling)
        flow = _flow(lens.rays, _sampled(nearness, lens.at), twist, focal_length)
        if self.rolling > 0.0:  # where the point really stood it is as far away as there
            flow = _flow(lens.rays, _sampled(nearness, lens.at - rows[..., None] * flow), twist, focal_length)
        taps = self._taps(flow)
        times = self.exposure * ((np.arange(taps) + 0.5) / taps - 0.5)
        how = cv2.INTER_CUBIC if taps == 1 else cv2.INTER_LINEAR  # a mean of many is no sharper for it
        total: Floats = np.zeros((*lens.at.shape[:2], *image.shape[2:]), dtype=np.float32)
        for time in times:
            cv2.accumulate(lens.seen(image, -(rows + np.float32(time))[..., None] * flow, how), total)
        return np.asarray(total / np.float32(taps), dtype=np.float32)

    def _taps(self, flow: Floats) -> int:
        """So many that even the fastest hundredth of the image moves hardly more than a pixel from one to the next."""
        fastest = float(np.quantile(np.abs(flow[::8, ::8]).max(axis=-1), 0.99))
        return int(np.clip(np.ceil(fastest * self.exposure), 1, _MOST_TAPS))


def _sampled(nearness: Floats, at: Floats) -> Floats:
    return np.asarray(resampled(nearness, at, cv2.INTER_NEAREST), dtype=np.float32)


def _flow(rays: Floats, nearness: Floats, twist: Twist, focal_length: float) -> Floats:
    """Velocity (h, w, 2) of what stands still in W through the image of a moving pinhole [px/s]."""
    v, w = twist.v.astype(np.float32), twist.w.astype(np.float32)
    x, y = rays[..., 0], rays[..., 1]
    away = -v[2] * nearness - (w[0] * y - w[1] * x)  # rate of the depth, over the depth
    x_rate = -v[0] * nearness - (w[1] - w[2] * y) - x * away
    y_rate = -v[1] * nearness - (w[2] * x - w[0]) - y * away
    return np.float32(focal_length) * np.stack([x_rate, y_rate], axis=-1)
