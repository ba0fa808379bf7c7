"""Camera pictures as observations: grey, channels first, reduced by a whole factor."""

from __future__ import annotations

import cv2
import numpy as np

from sensors.messages import GreyImage

_LEAST = 8  # a picture of fewer pixels to a side shows nothing


def reduced_shape(shape: tuple[int, int, int], scale: int) -> tuple[int, int, int]:
    """Channels, height and width of pictures that have been reduced by a factor.

    Raises:
        ValueError: one line, if it is none, or leaves next to nothing.
    """
    channels, height, width = shape
    most = min(height, width) // _LEAST
    if not 1 <= scale <= most:
        raise ValueError(f"image_scale = {scale} must be 1 .. {most} for pictures of {width} x {height}")
    return channels, height // scale, width // scale


def reduced(image: GreyImage, scale: int) -> GreyImage:
    """The image with squares of ``scale`` pixels as one each, their mean; rows and columns left over are cut off."""
    if scale == 1:
        return image
    height, width = (side // scale for side in image.shape)
    whole = image[: height * scale, : width * scale]
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)
