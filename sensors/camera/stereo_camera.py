"""The stereo camera on a unit's body: truth in, stamped grey pairs out."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from sensors.camera.image_formation import NoiseBank, grey
from sensors.camera.rig import StereoCalibration
from sensors.messages import ColourImage, GreyImage, StereoFrame
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray


class PairSource(Protocol):
    """Whatever can show both cameras' views, such as ``sensors.render.StereoRenderer``."""

    @property
    def calibration(self) -> StereoCalibration:
        """Of both cameras."""
        ...

    def render(self, X_WB: FloatArray) -> tuple[ColourImage, ColourImage]:
        """Left and right RGB image of cameras carried by a body at X_WB (4, 4)."""
        ...


class StereoCamera:
    """Samples the view from one unit of the vehicle; each image gets noise of its own.

    Raises:
        ValueError: if ``noise_std`` [grey levels] is out of range or there can be no such unit.
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
        """Of the cameras, exactly."""
        return self._renderer.calibration

    def sample(self, truth: Truth) -> StereoFrame:
        """The stereo pair as captured at the truth's tick; ``colour`` is what the left camera saw, without noise."""
        left, right = self._renderer.render(truth.bodies[self._unit])
        return StereoFrame(
            tick=truth.tick,
            left=self._sent(left),
            right=self._sent(right),
            colour=left if self._keep_colour else None,
        )

    def _sent(self, colour: ColourImage) -> GreyImage:
        return self._bank.added_to(grey(colour), self._rng)
