"""Calibration of a run's stereo cameras from rendered boards, as before a field test.

A board is held all over the view of both cameras: its pictures give the lenses and the pose between the cameras. Other
boards stand at surveyed positions: they give the cameras' pose on the trailer, which also compensates the rotation of
the view by errors of the principal points. The mount is straight during the calibration and bends only later.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import cv2
import numpy as np

from estimators.calibration.board_views import BoardView, board_view, in_same_order
from estimators.calibration.single_camera import calibrated
from estimators.calibration.stereo import calibrated_pair
from estimators.rigid_motion import rotation_vector
from scenarios.progress import Progress, no_progress
from sensors.camera.calibration_target import Checkerboard, board_image, random_board_pose
from sensors.camera.lens import CameraModel, RawStereoRig
from vehicle.frames import FloatArray, inverse, so3_exp, transform

_BOARD: Final = Checkerboard(columns=11, rows=8, square=0.1)  # assumed: 1.4 m by 1.1 m, the largest for two people
_OUTERMOST: Final = [0, _BOARD.columns - 1, -_BOARD.columns, -1]  # of its corners
_HELD: Final = 30  # number of image pairs of the held board
_SURVEYED: Final = 12  # number of left images of surveyed boards
_COLUMNS: Final = 6  # strips of the image, used in turn: random positions would leave its sides nearly empty
_HELD_SQUARE: Final = (40.0, 12.0)  # side of a square in the image, nearest and farthest [px]
_SURVEYED_SQUARE: Final = (19.0, 9.0)  # the same of surveyed boards: distance separates rotation from translation
_NEAREST: Final = 0.5  # smallest depth of any corner [m]
_TILT = (0.2, 0.8)  # range of angles from frontal [rad]
_EDGE = 8.0  # smallest distance of a corner from the edge of the image [px]
_TRIES = 1_000  # largest number of tries for a pose that both cameras see; one in five succeeds


class BoardCalibration(NamedTuple):
    """A calibrated rig with the residuals of the fit."""

    rig: RawStereoRig
    rms: float  # RMS reprojection error of corners [px]
    rotation_std: float  # standard deviation of each angle between the cameras [rad]


def calibrated_with_boards(
    true: RawStereoRig, *, noise_std: float, rng: np.random.Generator, progress: Progress = no_progress
) -> BoardCalibration:
    """Calibrate a rig from rendered pictures of boards.

    Args:
        true: the rig that takes the pictures.
        noise_std: image noise [grey levels].
        rng: determines the poses of the boards, and the noise.
        progress: receives the number of finished pictures, and their total.

    Raises:
        ValueError: if the boards do not fit into the view of both cameras, or the calibration fails.
    """
    poses = [
        _board_pose(true, k % _COLUMNS, _HELD_SQUARE if k < _HELD else _SURVEYED_SQUARE, rng)
        for k in range(_HELD + _SURVEYED)
    ]
    left: list[BoardView] = []
    right: list[BoardView] = []
    for k, X_ClB in enumerate(poses):
        left.append(_picture(k, true.left, X_ClB, noise_std, rng))
        if k < _HELD:
            right.append(_picture(k, true.right, inverse(true.X_ClCr) @ X_ClB, noise_std, rng))
        progress(k + 1, len(poses))
    held_left, surveyed = left[:_HELD], left[_HELD:]
    fit = calibrated_pair(held_left, right, (calibrated(held_left, _BOARD), calibrated(right, _BOARD)), _BOARD)
    X_SC = _mounted(fit.left, surveyed, [true.X_SC @ X_ClB for X_ClB in poses[_HELD:]], true.X_SC)
    rig = RawStereoRig(left=fit.left, right=fit.right, X_ClCr=fit.X_ClCr, X_SC=X_SC)
    return BoardCalibration(rig, fit.rms, fit.rotation_std)


def _picture(k: int, camera: CameraModel, X_CB: FloatArray, noise_std: float, rng: np.random.Generator) -> BoardView:
    image = board_image(_BOARD, camera, X_CB, noise_std=noise_std, rng=rng)
    return board_view(f"board {k + 1}", image, _BOARD)


def _board_pose(rig: RawStereoRig, column: int, squares: tuple[float, float], rng: np.random.Generator) -> FloatArray:
    """X_ClB (4, 4) of a board that both cameras see completely, with its centre in one strip of the left image.

    ``squares`` is the side of its squares in the middle of the image, nearest and farthest [px].
    """
    nearest, farthest = (rig.left.fx * _BOARD.square / px for px in squares)
    width, height = rig.left.width, rig.left.height
    for _ in range(_TRIES):
        depth, at = rng.uniform(nearest, farthest), rng.uniform([column, 0.0], [column + 1.0, 1.0])
        ray = rig.left.rays(at * [width / _COLUMNS, height])
        X_ClB = random_board_pose(_BOARD, rng, ray=ray, depth=depth, tilt=rng.uniform(*_TILT))
        if _shows(rig.left, X_ClB) and _shows(rig.right, inverse(rig.X_ClCr) @ X_ClB):
            return X_ClB
    raise ValueError(
        f"rig.calibration = boards: no position found where both cameras see all of a board of {_BOARD.columns}x"
        f"{_BOARD.rows} corners; the baseline of {rig.baseline:g} m is too long or the view too narrow: use exact"
    )


def _shows(camera: CameraModel, X_CB: FloatArray) -> bool:
    """True if all corners of the board are in the image."""
    p = _BOARD.corners[_OUTERMOST] @ X_CB[:3, :3].T + X_CB[:3, 3]
    if p[:, 2].min() < _NEAREST:
        return False
    pixels = camera.project(p)
    size = np.array([camera.width, camera.height])
    return bool(((pixels > _EDGE) & (pixels < size - 1.0 - _EDGE)).all())


def _mounted(
    camera: CameraModel, views: Sequence[BoardView], surveyed: Sequence[FloatArray], designed: FloatArray
) -> FloatArray:
    """X_SC (4, 4) of a camera from pictures of boards at known poses X_SB: the pose that fits all corners best.

    The ``designed`` pose resolves the orientation of a board in the image, and starts the search.
    """
    lens, X_CS = (camera.matrix, np.array(camera.distortion)), inverse(designed)
    points, corners = [], []
    for view, X_SB in zip(views, surveyed, strict=True):
        if view.corners is not None:
            on_board = _BOARD.corners @ X_SB[:3, :3].T + X_SB[:3, 3]
            expected = camera.project(on_board @ X_CS[:3, :3].T + X_CS[:3, 3]).astype(np.float32)
            points.append(on_board)
            corners.append(in_same_order(expected, view.corners).astype(np.float64))
    if not points:
        raise ValueError("rig.calibration = boards: no surveyed board was detected in its image")
    _, turn, p = cv2.solvePnP(
        np.concatenate(points),
        np.concatenate(corners),
        *lens,
        rotation_vector(X_CS[:3, :3])[:, None],
        X_CS[:3, 3:].copy(),
        useExtrinsicGuess=True,
    )
    R_CS = so3_exp(np.asarray(turn, dtype=np.float64).ravel())
    return inverse(transform(R_CS, np.asarray(p, dtype=np.float64).ravel()))
