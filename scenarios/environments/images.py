"""Camera images as observations: grey, channels first, reduced by a whole factor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from scenarios.environments.core import Feature, observation_space, within
from sensors.messages import GreyImage
from vehicle.frames import FloatArray

_MIN_SIDE = 8  # an image with fewer pixels to a side shows nothing


class ImageObservation:
    """Observation of reduced images and features: ``{"image": uint8 (n, channels, height, width), "features"}``."""

    def __init__(self, shape: tuple[int, int, int], scale: int, features: tuple[Feature, ...]) -> None:
        """For camera images of this shape (channels, height, width), reduced by a factor.

        Raises:
            ValueError: one line, if the factor does not fit the images.
        """
        self._shape, self._scale = reduced_shape(shape, scale), scale
        self._features = observation_space(features)
        self.space = spaces.Dict({"image": spaces.Box(0, 255, self._shape, np.uint8), "features": self._features})

    def observe(self, features: FloatArray, images: Mapping[int, Sequence[GreyImage]]) -> dict[str, NDArray[Any]]:
        """Observation of n episodes from features (n, n_features) and each episode's channels; black without any."""
        reduced_images = np.zeros((len(features), *self._shape), np.uint8)
        for lane, channels in images.items():
            reduced_images[lane] = [reduced(image, self._scale) for image in channels]
        return {"image": reduced_images, "features": within(features, self._features)}


def reduced_shape(shape: tuple[int, int, int], scale: int) -> tuple[int, int, int]:
    """Channels, height and width of images reduced by a factor.

    Raises:
        ValueError: one line, if the factor is below 1 or leaves too few pixels.
    """
    channels, height, width = shape
    most = min(height, width) // _MIN_SIDE
    if not 1 <= scale <= most:
        raise ValueError(f"image_scale = {scale} must be 1 .. {most} for pictures of {width} x {height}")
    return channels, height // scale, width // scale


def reduced(image: GreyImage, scale: int) -> GreyImage:
    """The image with each square of ``scale`` pixels replaced by its mean; incomplete squares are cut off."""
    if scale == 1:
        return image
    height, width = (side // scale for side in image.shape)
    whole = image[: height * scale, : width * scale]
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)
