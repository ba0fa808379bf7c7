"""The strip of ground behind the wheel, seen straight from above."""

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

STEP: Final = 0.002  # of the patch: lug marks of 5 mm are still seen, and the camera resolves 1.2 mm [m]
HALF_WIDTH: Final = 0.32  # of the patch: a trace 0.7 m long at 18 deg, and the templates beside it [m]
BAND: Final = 0.04  # way over which the trace is averaged: one and a half lugs [m]
_ROWS: Final = round(BAND / STEP)  # of a band
_FARTHEST: Final = 0.72  # behind the wheel: older traces tell nothing about the slip of the last seconds [m]
_NEEDED: Final = 4  # bands without which there is no use in a camera
_MARGIN: Final = 0.016  # that the wheel's lugs and width, and roll and pitch of half a degree take from either end [m]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundPatch:
    """Rows go back from the wheel, columns to its left; behind the wheel's own picture, before the image's end.

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
        aside = STEP * (np.arange(columns) - columns // 2)
        at = self._pixels(*np.meshgrid(behind, aside, indexing="ij")).astype(np.float32)
        maps = cv2.convertMaps(at[..., 0], at[..., 1], cv2.CV_16SC2)
        for name, value in (("behind", behind), ("columns", columns), ("_maps", maps)):
            object.__setattr__(self, name, value)

    @property
    def bands(self) -> FloatArray:
        """Middles of the bands [m]."""
        middles: FloatArray = self.behind.reshape(-1, _ROWS).mean(axis=1)
        return middles

    def rectified(self, image: GreyImage) -> NDArray[np.uint8]:
        """The image as a map of the ground."""
        return np.asarray(cv2.remap(image, *self._maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

    def _pixels(self, behind: FloatArray, aside: FloatArray) -> FloatArray:
        """Where in the distorted image places beside and behind the wheel are seen; level ground, wheel not sunk."""
        x, y = self.rig.wheel
        places = np.stack([x - behind, y + aside, np.zeros_like(behind)], axis=-1)
        X_CR = inverse(self.rig.X_RC)
        seen = places @ X_CR[:3, :3].T + X_CR[:3, 3]
        return self.rig.camera.pixels(seen[..., :2] / seen[..., 2:])

    def _visible(self) -> tuple[float, float]:
        """First and last place behind the wheel that neither the wheel nor the image's edge hides [m]."""
        s = np.arange(0.0, _FARTHEST, STEP)
        camera, r = self.rig.X_RC[:3, 3], self.rig.wheel_radius
        ahead, height = camera[0] - self.rig.wheel[0], camera[2]
        # The ray from the ground to the camera passes the hub, r above B, on its rear side at r or more.
        beyond = s * (height - r) - r * ahead >= r * np.hypot(ahead + s, height)
        at = self._pixels(s, np.zeros_like(s))
        inside = (at >= 0.0).all(axis=1) & (at[:, 0] < self.rig.camera.width) & (at[:, 1] < self.rig.camera.height)
        seen = s[beyond & inside]
        return (seen[0] + _MARGIN, seen[-1] - _MARGIN) if len(seen) else (0.0, 0.0)
