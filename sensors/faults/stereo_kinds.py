"""Fault kinds of the right camera of a stereo pair."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar, cast

import cv2
import numpy as np

from sensors.camera.lens import mount_rotation
from sensors.camera.shutter import STILL, Twist, moved, twist_between
from sensors.faults.fault import FaultContext, Pinhole, T
from sensors.faults.image_kinds import ImageFault, camera_of
from sensors.messages import GreyImage
from sensors.sensor import Message, Sensor, image_fields
from vehicle.clock import TICK, to_ticks
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray
from vehicle.option import Option


class StereoFault:
    """Base of fault kinds that need a stereo pair."""

    needs: ClassVar[str] = "a stereo camera"

    @classmethod
    def applies_to(cls, message: type[Message]) -> bool:
        """Messages with two images will do."""
        return len(image_fields(message)) == 2


class Desync(StereoFault):
    """The right camera exposes later than the left one.

    Its image is taken where the steady motion of the body since the last capture will have carried it by then.
    """

    options: ClassVar[tuple[Option, ...]] = (
        Option("lag", 0.01, "the right exposure is later by this time", unit="s", low=0.001, high=0.09),
    )

    def __init__(self, amount: tuple[float, ...], context: FaultContext) -> None:
        self._lag = to_ticks(amount[0], "desync: lag")
        self._unit = context.unit
        _, self._right = image_fields(context.message)
        self._previous: tuple[int, FloatArray] | None = None  # tick and X_WB of the last capture

    def sample(self, sensor: Sensor[T, Message], truth: T, active: bool) -> Message | None:
        """The pair of this tick, its right image from some ticks later."""
        if not isinstance(truth, Truth):
            raise ValueError(f"faults: desync needs a combination's ground truth, not {type(truth).__name__}")
        twist = self._twist(truth)
        message = sensor.sample(truth)
        if not active or message is None:
            return message
        bodies = truth.bodies.copy()
        bodies[self._unit] = moved(bodies[self._unit], twist, self._lag * TICK)
        later = sensor.sample(cast(T, replace(truth, tick=truth.tick + self._lag, bodies=bodies)))
        return None if later is None else replace(message, **{self._right: getattr(later, self._right)})

    def _twist(self, truth: Truth) -> Twist:
        """Velocity of the body since the last capture."""
        previous, X_WB = self._previous, truth.bodies[self._unit]
        self._previous = truth.tick, X_WB
        return twist_between(previous[1], X_WB, (truth.tick - previous[0]) * TICK) if previous else STILL


class Decalibration(StereoFault, ImageFault):
    """The right camera is turned against its calibration."""

    options: ClassVar[tuple[Option, ...]] = tuple(
        Option(name, default, f"{name} of the right camera", unit="deg", low=-5.0, high=5.0)
        for name, default in (("roll", -0.15), ("yaw", 0.1), ("pitch", 0.0))
    )

    def __init__(self, amount: tuple[float, ...], context: FaultContext) -> None:
        self._H = _rotation_homography(camera_of(context), np.radians(amount))

    def degraded(self, image: GreyImage, camera: int) -> GreyImage:
        """The left image as it is, the right image as the turned camera sees the scene."""
        return image if camera == 0 else _warped(image, self._H)


def _rotation_homography(c: Pinhole, angles: FloatArray) -> FloatArray:
    """The homography (3, 3) from the image of the straight camera to that of the turned one; exact for a pinhole."""
    K = np.array([[c.focal_length, 0.0, c.cx], [0.0, c.focal_length, c.cy], [0.0, 0.0, 1.0]])
    H: FloatArray = K @ mount_rotation(*angles).T @ np.linalg.inv(K)
    return H


def _warped(image: GreyImage, H: FloatArray) -> GreyImage:
    size = (image.shape[1], image.shape[0])
    warped = cv2.warpPerspective(image, H, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(warped, dtype=np.uint8)
