"""Fault kinds of images: those of any camera, and those of the right camera of a stereo pair."""

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import ClassVar, cast

import cv2
import numpy as np

from sensors.camera.image_formation import STILL, Twist, behind_dirt, dirt_layer, glare_veil, moved, twist_between
from sensors.camera.rig import mount_rotation
from sensors.faults.fault import FaultContext, Options, Pinhole, T
from sensors.messages import GreyImage, Message, Sensor, image_fields
from vehicle.clock import TICK, to_ticks
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray
from vehicle.option import Option


class ImageFault(ABC):
    """Base of fault kinds that degrade each image by itself; the colour picture for people is left out meanwhile."""

    options: ClassVar[Options] = ()
    needs: ClassVar[str] = "a camera"

    @classmethod
    def applies_to(cls, message: type[Message]) -> bool:
        """Any message with images will do."""
        return len(image_fields(message)) > 0

    @abstractmethod
    def degraded(self, image: GreyImage, camera: int) -> GreyImage:
        """The faulty image of a camera: 0 for a single or left one, 1 for the right one."""

    def sample(self, sensor: Sensor[T, Message], truth: T, active: bool) -> Message | None:
        """The message with degraded images."""
        message = sensor.sample(truth)
        if message is None or not active:
            return message
        fields = enumerate(image_fields(type(message)))
        changed = {name: self.degraded(getattr(message, name), camera) for camera, name in fields}
        return replace(message, **changed, **without_colour(message))


def without_colour(message: Message) -> dict[str, None]:
    """Changes that remove the colour picture from a message."""
    return {"colour": None} if "colour" in message.__dataclass_fields__ else {}


def camera_of(context: FaultContext) -> Pinhole:
    """Intrinsics of the faulty camera.

    Raises:
        ValueError: if the sensor sends images but its intrinsics are unknown.
    """
    if context.camera is None:
        raise ValueError(f"faults: the intrinsics of the camera that sends {context.message.__name__} are not known")
    return context.camera


class Blackout(ImageFault):
    """Images are black."""

    def __init__(self, amount: tuple[float, ...], context: FaultContext) -> None:
        """No number and nothing of the sensor is needed."""

    def degraded(self, image: GreyImage, camera: int) -> GreyImage:
        """A black image."""
        return np.zeros_like(image)


class Dirt(ImageFault):
    """A splash of dirt covers a share of each lens."""

    options: ClassVar[Options] = (Option("share", 0.3, "share of the lens that is covered", low=0.0, high=1.0),)

    def __init__(self, amount: tuple[float, ...], context: FaultContext) -> None:
        camera, (share,) = camera_of(context), amount
        shape = camera.height, camera.width
        self._dirt = tuple(dirt_layer(context.rng, shape, share) for _ in image_fields(context.message))

    def degraded(self, image: GreyImage, camera: int) -> GreyImage:
        """The image behind the dirt."""
        return behind_dirt(image, self._dirt[camera])


class Glare(ImageFault):
    """Light is scattered around a spot in the upper half of the images."""

    options: ClassVar[Options] = (Option("strength", 1.0, "brightness relative to the sun", low=0.0, high=5.0),)

    def __init__(self, amount: tuple[float, ...], context: FaultContext) -> None:
        (strength,), c, rng = amount, camera_of(context), context.rng
        u0, v0 = rng.uniform(0.1, 0.9) * c.width, rng.uniform(0.0, 0.4) * c.height
        v, u = np.mgrid[0 : c.height, 0 : c.width].astype(np.float32)
        angle = np.arctan(np.hypot(u - np.float32(u0), v - np.float32(v0)) / np.float32(c.focal_length))
        self._veil = glare_veil(angle, strength)  # [grey levels]

    def degraded(self, image: GreyImage, camera: int) -> GreyImage:
        """The image under a veil of light."""
        return np.asarray(cv2.add(image, self._veil, dtype=cv2.CV_8U), dtype=np.uint8)


class Gain(ImageFault):
    """One camera, the right one of a pair, exposes otherwise: its grey levels are scaled and shifted."""

    options: ClassVar[Options] = (
        Option("factor", 0.7, "grey levels of the sound image are multiplied by it", low=0.1, high=10.0),
        Option("offset", 0.0, "grey levels that are added", low=-255.0, high=255.0),
    )

    def __init__(self, amount: tuple[float, ...], context: FaultContext) -> None:
        self._factor, self._offset = amount
        self._camera = len(image_fields(context.message)) - 1

    def degraded(self, image: GreyImage, camera: int) -> GreyImage:
        """The image of the other exposure; grey levels saturate at black and white."""
        if camera != self._camera:
            return image
        levels = np.rint(self._factor * np.arange(256.0) + self._offset).clip(0.0, 255.0).astype(np.uint8)
        return levels[image]


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

    options: ClassVar[Options] = (
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

    options: ClassVar[Options] = tuple(
        Option(name, default, f"{name} of the right camera", unit="deg", low=-5.0, high=5.0)
        for name, default in (("roll", -0.15), ("yaw", 0.1), ("pitch", 0.0))
    )

    def __init__(self, amount: tuple[float, ...], context: FaultContext) -> None:
        c = camera_of(context)
        K = np.array([[c.focal_length, 0.0, c.cx], [0.0, c.focal_length, c.cy], [0.0, 0.0, 1.0]])
        # from the image of the straight camera to that of the turned one; exact for a pinhole
        self._H: FloatArray = K @ mount_rotation(*np.radians(amount)).T @ np.linalg.inv(K)

    def degraded(self, image: GreyImage, camera: int) -> GreyImage:
        """The left image as it is, the right image as the turned camera sees the scene."""
        if camera == 0:
            return image
        flags, border = cv2.INTER_CUBIC, cv2.BORDER_REPLICATE
        warped = cv2.warpPerspective(image, self._H, image.shape[::-1], flags=flags, borderMode=border)
        return np.asarray(warped, dtype=np.uint8)
