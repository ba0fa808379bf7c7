"""Rectified strip of ground behind the wheel, as seen from above."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.messages import GreyImage
from sensors.sand.trace_rig import TraceRig
from vehicle.frames import FloatArray, inverse

FloatImage = NDArray[np.float32]

STEP: Final = 0.002  # pixel size: resolves lug marks of 5 mm; the camera resolves 1.2 mm [m]
HALF_WIDTH: Final = 0.32  # of the patch: a trace 0.7 m long at 18 deg, plus the width of the templates [m]
BAND: Final = 0.04  # length over which the trace is averaged: one and a half lugs [m]
_ROWS: Final = round(BAND / STEP)  # of a band
_FARTHEST: Final = 0.72  # behind the wheel: older parts carry no information on recent slip [m]
_NEEDED: Final = 4  # least number of bands
_MARGIN: Final = 0.016  # cut off at both ends for the wheel's lugs and width, and for roll and pitch of 0.5 deg [m]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundPatch:
    """Map of the visible ground behind the wheel: rows go backwards, columns to the left.

    Raises:
        ValueError: if the camera sees too little of the ground behind the wheel.
    """

    rig: TraceRig
    behind: FloatArray = field(init=False)  # (rows,) of each row from the wheel's lowest point B [m]
    columns: int = field(init=False)
    _maps: tuple[NDArray[np.int16], NDArray[np.uint16]] = field(init=False)

    def __post_init__(self) -> None:
        begin, end = self._visible()
        rows = _ROWS * int((end - begin) / BAND + 1e-6)
        if rows < _NEEDED * _ROWS:
            raise ValueError(
                f"rig: the camera sees the ground {begin:.2f} to {end:.2f} m behind the wheel; it has to be seen "
                f"over at least {_NEEDED * BAND:.2f} m"
            )
        behind = begin + STEP * (0.5 + np.arange(rows))
        columns = 2 * round(HALF_WIDTH / STEP) + 1
        lateral = STEP * (np.arange(columns) - columns // 2)
        at = self._pixels(*np.meshgrid(behind, lateral, indexing="ij")).astype(np.float32)
        maps = cv2.convertMaps(at[..., 0], at[..., 1], cv2.CV_16SC2)
        for name, value in (("behind", behind), ("columns", columns), ("_maps", maps)):
            object.__setattr__(self, name, value)

    @property
    def bands(self) -> FloatArray:
        """Centres of the bands behind the wheel [m]."""
        middles: FloatArray = self.behind.reshape(-1, _ROWS).mean(axis=1)
        return middles

    def rectified(self, image: GreyImage) -> NDArray[np.uint8]:
        """Image rectified to a map of the ground."""
        return np.asarray(cv2.remap(image, *self._maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

    def _pixels(self, behind: FloatArray, lateral: FloatArray) -> FloatArray:
        """Pixels in the distorted image of points behind and beside the wheel; level ground, no sinkage."""
        x, y = self.rig.wheel
        points = np.stack([x - behind, y + lateral, np.zeros_like(behind)], axis=-1)
        X_CR = inverse(self.rig.X_RC)
        p_C = points @ X_CR[:3, :3].T + X_CR[:3, 3]
        return self.rig.camera.pixels(p_C[..., :2] / p_C[..., 2:])

    def _visible(self) -> tuple[float, float]:
        """First and last visible distance behind the wheel, limited by the wheel and the image's edge [m]."""
        s = np.arange(0.0, _FARTHEST, STEP)
        camera, r = self.rig.X_RC[:3, 3], self.rig.wheel_radius
        ahead, height = camera[0] - self.rig.wheel[0], camera[2]
        # visible where the ray to the camera passes behind the hub, r above B, at a distance of at least r
        beyond = s * (height - r) - r * ahead >= r * np.hypot(ahead + s, height)
        at = self._pixels(s, np.zeros_like(s))
        inside = (at >= 0.0).all(axis=1) & (at[:, 0] < self.rig.camera.width) & (at[:, 1] < self.rig.camera.height)
        visible = s[beyond & inside]
        return (visible[0] + _MARGIN, visible[-1] - _MARGIN) if len(visible) else (0.0, 0.0)
