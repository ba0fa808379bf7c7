"""Image formation behind the lens: from what reaches the sensor to the grey image that is sent.

The grey conversion, Gaussian noise that does not depend on the light or that grows with it, rounding and saturation.
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


@dataclass(frozen=True, slots=True, eq=False)
class LightNoise:
    """Noise of a sensor that counts photons: its variance grows with the light, from that of the read-out on."""

    samples: NDArray[np.float32]  # (n,) of unit deviation
    read: float  # standard deviation in the dark [grey levels]
    shot: float  # standard deviation at white and a gain of 1, without the read-out's [grey levels]

    @classmethod
    def draw(cls, rng: np.random.Generator, read: float, shot: float, pixels: int) -> LightNoise:
        """Noise for images of so many pixels.

        Raises:
            ValueError: if a deviation is out of range.
        """
        for name, std in (("read_noise", read), ("shot_noise", shot)):
            if not 0.0 <= std <= _MAX_STD:
                raise ValueError(f"{name} = {std} grey levels must be between 0 and {_MAX_STD:g}")
        return cls(rng.standard_normal(max(_BANK, 2 * pixels), dtype=np.float32), read, shot)

    def sensed(self, light: NDArray[np.float32], gain: float, rng: np.random.Generator) -> GreyImage:
        """The image (h, w) that the sensor sends of the light [grey levels at a gain of 1], amplified by ``gain``."""
        level = light * np.float32(gain)
        start = int(rng.integers(self.samples.size - level.size))
        noise = self.samples[start : start + level.size].reshape(level.shape)
        # Photon noise before the amplifier has a variance of shot^2 light/255; the amplifier squares its gain into it.
        std = cv2.sqrt(np.float32(self.read**2) + np.float32(self.shot**2 * gain / 255.0) * np.clip(level, 0.0, 255.0))
        return np.asarray(cv2.add(level, noise * std, dtype=cv2.CV_8U), dtype=np.uint8)


def grey(colour: ColourImage) -> GreyImage:
    """Luminance (height, width) of an RGB image (ITU-R BT.601 weights)."""
    return np.asarray(cv2.cvtColor(colour, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
