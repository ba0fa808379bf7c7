"""Image formation behind the lens: from the light on the sensor to the grey image that is sent.

Modelled: control of the exposure by the brightness of previous images, conversion to grey, Gaussian noise that is
constant or grows with the light, rounding and saturation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.messages import ColourImage, GreyImage

_TARGET: Final = 118.0  # mean level of the control: 18 % reflectance at the usual gamma of 2.2 [grey levels]
_GAINS: Final = (0.25, 8.0)  # limits of shutter and amplifier, relative to the fixed exposure
_BANK = 1 << 22  # fewest samples: eight images of 1344x391 px, so that two rarely get the same noise
_MAX_STD = 50.0  # with more, most pixels of a mid-grey image would saturate or nearly so [grey levels]


@dataclass(frozen=True, slots=True, kw_only=True)
class AutoExposure:
    """Exposure that follows the mean level of both images with a first-order lag, in stops."""

    time_constant: float  # [s]

    def settled(self, level: float) -> float:
        """Steady-state gain for images of a mean level [grey levels at a gain of 1]."""
        return min(max(_TARGET / max(level, 1e-3), _GAINS[0]), _GAINS[1])

    def step(self, gain: float, level: float, seconds: float) -> float:
        """Gain a number of seconds after an image of this level was taken at the given gain."""
        share = 1.0 - math.exp(-seconds / self.time_constant)
        return gain * math.exp(share * math.log(self.settled(level) / gain))


@dataclass(frozen=True, slots=True, eq=False)
class NoiseBank:
    """White Gaussian noise drawn once; every image takes a section of it with a random start."""

    samples: NDArray[np.int16]  # (n,) [grey levels]

    @classmethod
    def draw(cls, rng: np.random.Generator, std: float, pixels: int) -> NoiseBank:
        """Bank of the given standard deviation [grey levels] for images of this number of pixels.

        Samples are whole grey levels, as an 8-bit camera sends them: rounding adds a variance of 1/12.

        Raises:
            ValueError: if ``std`` is out of range.
        """
        if not 0.0 <= std <= _MAX_STD:
            raise ValueError(f"noise_std = {std} grey levels must be between 0 and {_MAX_STD:g}")
        noise = rng.standard_normal(max(_BANK, 2 * pixels), dtype=np.float32)
        noise *= np.float32(std)
        return cls(np.rint(noise).astype(np.int16))

    def added_to(self, image: GreyImage, rng: np.random.Generator) -> GreyImage:
        """Image plus a new section of the noise, saturated at 0 and 255."""
        start = int(rng.integers(self.samples.size - image.size))
        noise = self.samples[start : start + image.size].reshape(image.shape)
        return np.asarray(cv2.add(image, noise, dtype=cv2.CV_8U), dtype=np.uint8)


@dataclass(frozen=True, slots=True, eq=False)
class LightNoise:
    """Photon and read-out noise of an image sensor: its variance grows linearly with the light."""

    samples: NDArray[np.float32]  # (n,) of unit deviation
    read: float  # standard deviation in the dark [grey levels]
    shot: float  # standard deviation at white and a gain of 1, without the read-out noise [grey levels]

    @classmethod
    def draw(cls, rng: np.random.Generator, read: float, shot: float, pixels: int) -> LightNoise:
        """Noise for images of this number of pixels.

        Raises:
            ValueError: if a deviation is out of range.
        """
        for name, std in (("read_noise", read), ("shot_noise", shot)):
            if not 0.0 <= std <= _MAX_STD:
                raise ValueError(f"{name} = {std} grey levels must be between 0 and {_MAX_STD:g}")
        return cls(rng.standard_normal(max(_BANK, 2 * pixels), dtype=np.float32), read, shot)

    def sensed(self, light: NDArray[np.float32], gain: float, rng: np.random.Generator) -> GreyImage:
        """Noisy image (h, w) of the light [grey levels at a gain of 1], amplified by ``gain``."""
        level = light * np.float32(gain)
        start = int(rng.integers(self.samples.size - level.size))
        noise = self.samples[start : start + level.size].reshape(level.shape)
        # Photon noise before the amplifier has a variance of shot^2 light/255; the amplifier squares its gain into it.
        std = cv2.sqrt(np.float32(self.read**2) + np.float32(self.shot**2 * gain / 255.0) * np.clip(level, 0.0, 255.0))
        return np.asarray(cv2.add(level, noise * std, dtype=cv2.CV_8U), dtype=np.uint8)


def grey(colour: ColourImage) -> GreyImage:
    """Luminance (height, width) of an RGB image (ITU-R BT.601 weights)."""
    return np.asarray(cv2.cvtColor(colour, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
