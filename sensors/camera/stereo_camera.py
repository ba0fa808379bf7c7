"""Ideal stereo camera on a unit's body: pinholes with white noise."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from sensors.camera.image_formation import NoiseBank, grey
from sensors.camera.rig import StereoCalibration
from sensors.messages import ColourImage, GreyImage, StereoFrame
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray


class PairSource(Protocol):
    """Renderer of both cameras' views, such as ``sensors.render.StereoRenderer``."""

    @property
    def calibration(self) -> StereoCalibration:
        """Calibration of both cameras."""
        ...

    def render(self, X_WB: FloatArray) -> tuple[ColourImage, ColourImage]:
        """Left and right RGB image of cameras carried by a body at X_WB (4, 4)."""
        ...


class StereoCamera:
    """Samples stereo pairs from one unit of the vehicle; the noise of the images is independent.

    Raises:
        ValueError: if ``noise_std`` [grey levels] is out of range or ``unit`` is negative.
    """

    def __init__(
        self, *, renderer: PairSource, unit: int, noise_std: float, rng: np.random.Generator, keep_colour: bool
    ) -> None:
        if unit < 0:
            raise ValueError(f"unit = {unit} must be 0 (the tractor) or more")
        self._renderer, self._unit, self._rng, self._keep_colour = renderer, unit, rng, keep_colour
        pixels = renderer.calibration.width * renderer.calibration.height
        self._bank = NoiseBank.draw(rng, noise_std, pixels)

    @property
    def calibration(self) -> StereoCalibration:
        """Exact calibration of the cameras."""
        return self._renderer.calibration

    def sample(self, truth: Truth) -> StereoFrame:
        """Stereo pair captured at the truth's tick; ``colour`` is the left image without noise."""
        left, right = self._renderer.render(truth.bodies[self._unit])
        return StereoFrame(
            tick=truth.tick,
            left=self._noisy(left),
            right=self._noisy(right),
            colour=left if self._keep_colour else None,
        )

    def _noisy(self, colour: ColourImage) -> GreyImage:
        return self._bank.added_to(grey(colour), self._rng)
