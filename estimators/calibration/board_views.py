"""Corner detection in photographs of a checkerboard."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from sensors.camera.calibration_target import Checkerboard
from sensors.messages import GreyImage

Corners = NDArray[np.float32]  # (n, 2) [px]

_SUB_PIXEL = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-3)  # iterations, and the last shift [px]
_WINDOW = (2, 9)  # least and greatest half width of the window a corner is refined in [px]
_WINDOW_SHARE = 0.35  # of the distance to the next corner: the window contains one corner only


class BoardView(NamedTuple):
    """One photograph."""

    name: str
    size: tuple[int, int]  # width and height [px]
    corners: Corners | None  # (n, 2) in the board's order; None: no board found


def board_view(name: str, image: GreyImage, board: Checkerboard) -> BoardView:
    """Detect the board's corners in an image, to a few hundredths of a pixel."""
    size = (image.shape[1], image.shape[0])
    pattern = (board.columns, board.rows)
    found, corners = cv2.findChessboardCorners(image, pattern, flags=_plain_flags())
    if not found:  # slower, for poor light
        found, corners = cv2.findChessboardCornersSB(image, pattern, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not found:
        return BoardView(name, size, None)
    rough = np.asarray(corners, dtype=np.float32)
    half = int(np.clip(_WINDOW_SHARE * _spacing(rough.reshape(board.rows, board.columns, 2)), *_WINDOW))
    refined = cv2.cornerSubPix(image, rough, (half, half), (-1, -1), _SUB_PIXEL)
    return BoardView(name, size, np.asarray(refined, dtype=np.float32).reshape(-1, 2))


def in_same_order(reference: Corners, corners: Corners) -> Corners:
    """Corners (n, 2), counted from the same end of the board as those of the reference.

    A board turned by 180 deg can look the same, but its direction is the same in two cameras side by side.
    """
    along = reference[-1] - reference[0]
    return corners if float(along @ (corners[-1] - corners[0])) > 0.0 else corners[::-1]


def _plain_flags() -> int:
    return int(cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK)


def _spacing(grid: NDArray[np.float32]) -> float:
    """Least distance between neighbours in a grid (rows, columns, 2) [px]."""
    return min(float(np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min()) for axis in (0, 1))
