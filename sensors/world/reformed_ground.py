"""Ground that wheels change as they roll over it: mud, slush, wet sand.

A sinking wheel presses, smears and splashes, so the rear camera sees other ground than the front camera saw at the same
place. Only the appearance is modelled: a strip along every wheel's track shows other ground of the same kind, which may
flow along with the vehicle while it is in view. Wheels come in groups, such as those of one unit of the vehicle; each
group changes the ground again. Relief is not modelled.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.camera.rig import StereoCalibration
from sensors.camera.stereo_camera import PairSource
from sensors.messages import ColourImage
from vehicle.foundation.quantity import check_number
from vehicle.frames import FloatArray, inverse, transform
from vehicle.surface import Surface

# Offset in W to the ground that is shown after each group: beyond the cameras' view [m]
_OFFSETS = np.array([[1.3, 1.1], [-1.1, 1.3]])
_NEAR = 4.0  # distance from a camera beyond which tracks are out of view [m]
_SUBPIXEL = 4  # fractional bits of pixel coordinates when drawing


class ReformedGround:
    """Renderer of downward cameras above ground that wheels re-form: a ``PairSource`` around another one.

    It stores the body's pose at every call, so the calls have to be in the order of the drive.
    """

    def __init__(
        self, source: PairSource, surface: Surface, wheels: Sequence[FloatArray], *, width: float, flow: float = 0.0
    ) -> None:
        """Renderer around ``source``, for groups of wheels (n, 2) [m] in the body's frame, the foremost group first.

        Each wheel re-forms a strip of ``width`` [m], which moves at ``flow`` times the body's velocity.

        Raises:
            ValueError: if the width is not positive, the flow not within 0 and 1, or there are more than two groups.
        """
        if not width > 0.0:
            raise ValueError(f"width of the re-formed strip = {width} m must be positive")
        check_number("flow of the re-formed ground", flow, 0.0, 1.0)
        if len(wheels) > len(_OFFSETS):
            raise ValueError(f"{len(wheels)} groups of wheels: at most {len(_OFFSETS)} can be distinguished")
        self._source, self._surface, self._width, self._flow = source, surface, width, flow
        self._groups = [np.column_stack([group, np.zeros(len(group)), np.ones(len(group))]) for group in wheels]
        self._bodies: list[FloatArray] = []  # X_WB (4, 4) of every call, oldest first

    @property
    def calibration(self) -> StereoCalibration:
        """Calibration of both cameras."""
        return self._source.calibration

    def render(self, X_WB: FloatArray) -> tuple[ColourImage, ColourImage]:
        """Left and right RGB image of cameras carried by a body at X_WB (4, 4)."""
        self._bodies.append(X_WB.copy())
        X_WCl = X_WB @ self.calibration.X_SC
        poses = (X_WCl, X_WCl @ self.calibration.X_ClCr)
        left, right = self._source.render(X_WB)
        for group, offset in zip(self._groups, _OFFSETS, strict=False):
            after = self._source.render(self._displaced(X_WB, offset))
            tracks = np.array([(group @ body.T)[:, :3] for body in self._bodies])  # (calls, n, 3)
            left, right = (
                np.where(self._rolled_pixels(X_WC, tracks)[..., None], new, old)
                for X_WC, new, old in zip(poses, after, (left, right), strict=True)
            )
        return left, right

    def _displaced(self, X_WB: FloatArray, offset: FloatArray) -> FloatArray:
        """Pose of the body above the ground that is shown instead, at the same height above it."""
        here, start = X_WB[:2, 3], self._bodies[0][:2, 3]
        there = here + offset - self._flow * (here - start)  # ground that moves along falls behind more slowly
        rise = float(self._surface.height(*there) - self._surface.height(*here))
        return transform(np.eye(3), np.array([*(there - here), rise])) @ X_WB

    def _rolled_pixels(self, X_WC: FloatArray, tracks: FloatArray) -> NDArray[np.bool_]:
        """Mask (height, width) of a camera's pixels that show ground along the wheels' ``tracks`` (calls, n, 3)."""
        c = self.calibration
        mask = np.zeros((c.height, c.width), dtype=np.uint8)
        near = np.hypot(*np.moveaxis(tracks[..., :2] - X_WC[:2, 3], -1, 0)) < _NEAR
        X_CW = inverse(X_WC)
        for wheel in range(tracks.shape[1]):
            points = tracks[near[:, wheel], wheel] @ X_CW[:3, :3].T + X_CW[:3, 3]
            if len(points) > 1:
                pixels = c.focal_length * points[:, :2] / points[:, 2:] + (c.cx, c.cy)
                thickness = max(1, round(self._width * c.focal_length / float(points[:, 2].mean())))
                line = np.rint(pixels * (1 << _SUBPIXEL)).astype(np.int32)
                cv2.polylines(mask, [line], isClosed=False, color=1, thickness=thickness, shift=_SUBPIXEL)
        return mask > 0
