"""Image formation behind the lens: from what reaches the sensor to the grey image that is sent.

Modelled: the grey conversion, additive Gaussian noise, rounding and saturation. Not modelled: motion blur, rolling
shutter, vignetting, exposure control, noise that grows with the signal.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.messages import ColourImage, GreyImage

_BANK = 1 << 22  # samples at least: eight images of 1344x391 px, so that two hardly ever show the same stretch
_MAX_STD = 50.0  # with more, most pixels of a mid-grey image would saturate or nearly so [grey levels]


@dataclass(frozen=True, slots=True, eq=False)
class NoiseBank:
    """White Gaussian noise drawn once; every image takes a stretch of it that begins at random."""

    samples: NDArray[np.int16]  # (n,) [grey levels]

    @classmethod
    def draw(cls, rng: np.random.Generator, std: float, pixels: int) -> NoiseBank:
        """A bank of the given standard deviation [grey levels] for images of so many pixels.

        Samples are whole grey levels, as is everything a camera of 8 bits sends: rounding adds a variance of 1/12.

        Raises:
            ValueError: if ``std`` is out of range.
        """
        if not 0.0 <= std <= _MAX_STD:
            raise ValueError(f"noise_std = {std} grey levels must be between 0 and {_MAX_STD:g}")
        noise = rng.standard_normal(max(_BANK, 2 * pixels), dtype=np.float32)
        noise *= np.float32(std)
        return cls(np.rint(noise).astype(np.int16))

    def added_to(self, image: GreyImage, rng: np.random.Generator) -> GreyImage:
        """The image with a fresh stretch of noise on it, saturated at 0 and 255."""
        start = int(rng.integers(self.samples.size - image.size))
        noise = self.samples[start : start + image.size].reshape(image.shape)
        return np.asarray(cv2.add(image, noise, dtype=cv2.CV_8U), dtype=np.uint8)


def grey(colour: ColourImage) -> GreyImage:
    """Luminance (height, width) of an RGB image (ITU-R BT.601 weights)."""
    return np.asarray(cv2.cvtColor(colour, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
