"""Fault kinds of images: they apply to cameras, single or stereo."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import ClassVar

import cv2
import numpy as np

from sensors.camera.lens_map import Floats
from sensors.camera.lens_surface import behind_dirt, dirt_layer, glare_veil
from sensors.faults.fault import FaultContext, Pinhole, T
from sensors.messages import GreyImage
from sensors.sensor import Message, Sensor, image_fields
from vehicle.option import Option


class ImageFault(ABC):
    """Base of fault kinds that degrade each image by itself; the colour picture for people is left out meanwhile."""

    options: ClassVar[tuple[Option, ...]] = ()
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

    options: ClassVar[tuple[Option, ...]] = (
        Option("share", 0.3, "share of the lens that is covered", low=0.0, high=1.0),
    )

    def __init__(self, amount: tuple[float, ...], context: FaultContext) -> None:
        camera, (share,) = camera_of(context), amount
        shape = camera.height, camera.width
        self._dirt = tuple(dirt_layer(context.rng, shape, share) for _ in image_fields(context.message))

    def degraded(self, image: GreyImage, camera: int) -> GreyImage:
        """The image behind the dirt."""
        return behind_dirt(image, self._dirt[camera])


class Glare(ImageFault):
    """Light is scattered around a spot in the upper half of the images."""

    options: ClassVar[tuple[Option, ...]] = (
        Option("strength", 1.0, "brightness relative to the sun", low=0.0, high=5.0),
    )

    def __init__(self, amount: tuple[float, ...], context: FaultContext) -> None:
        (strength,) = amount
        self._veil = _glare(camera_of(context), context.rng, strength)

    def degraded(self, image: GreyImage, camera: int) -> GreyImage:
        """The image under a veil of light."""
        return np.asarray(cv2.add(image, self._veil, dtype=cv2.CV_8U), dtype=np.uint8)


class Gain(ImageFault):
    """One camera, the right one of a pair, exposes otherwise: its grey levels are scaled and shifted."""

    options: ClassVar[tuple[Option, ...]] = (
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


def _glare(c: Pinhole, rng: np.random.Generator, strength: float) -> Floats:
    """A veil [grey levels] around a sun somewhere in the upper half of the image."""
    u0, v0 = rng.uniform(0.1, 0.9) * c.width, rng.uniform(0.0, 0.4) * c.height
    v, u = np.mgrid[0 : c.height, 0 : c.width].astype(np.float32)
    angle = np.arctan(np.hypot(u - np.float32(u0), v - np.float32(v0)) / np.float32(c.focal_length))
    return glare_veil(angle, strength)
