"""Calibration of a run's stereo cameras from rendered boards, as it is done before a field test.

A board is held up all over the view of both cameras; its pictures give lenses and the pose between the cameras. Other
boards stand at surveyed places in front of them: they give the cameras' pose on the trailer, which takes up what an
error of the principal points turns the view by. The mount is straight meanwhile, and bends only later.
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

_BOARD: Final = Checkerboard(columns=11, rows=8, square=0.1)  # assumed: 1.4 m by 1.1 m, as large as two people can hold
_OUTERMOST: Final = [0, _BOARD.columns - 1, -_BOARD.columns, -1]  # of its corners
_HELD: Final = 30  # pairs of pictures of it
_SURVEYED: Final = 12  # more of the left camera, at known places
_COLUMNS: Final = 6  # strips of the picture that boards are held in by turns: left to chance, its sides get few
_HELD_SQUARE: Final = (40.0, 12.0)  # side of a square in the picture, from and to: near and far [px]
_STANDING_SQUARE: Final = (19.0, 9.0)  # of surveyed boards: from afar, turning and moving the camera are told apart
_NEAREST: Final = 0.5  # of any corner [m]
_TILT = (0.2, 0.8)  # from frontal [rad]
_EDGE = 8.0  # corners nearer to the edge of the picture are cut off [px]
_TRIES = 1_000  # for a place that both cameras see; one in five does


class BoardCalibration(NamedTuple):
    """A calibrated rig, and how well its boards fit."""

    rig: RawStereoRig
    rms: float  # reprojection error of corners [px]
    rotation_std: float  # of each angle between the cameras [rad]


def calibrated_with_boards(
    true: RawStereoRig, *, noise_std: float, rng: np.random.Generator, progress: Progress = no_progress
) -> BoardCalibration:
    """What boards before the cameras of the ``true`` rig say of it.

    Args:
        true: the rig that the pictures are taken with.
        noise_std: of the pictures [grey levels].
        rng: decides where boards are held, and the noise.
        progress: receives the number of pictures that are done, and of how many.

    Raises:
        ValueError: if the boards do not fit into what both cameras see, or their pictures are no good.
    """
    places = [
        _place(true, k % _COLUMNS, _HELD_SQUARE if k < _HELD else _STANDING_SQUARE, rng)
        for k in range(_HELD + _SURVEYED)
    ]
    left: list[BoardView] = []
    right: list[BoardView] = []
    for k, X_ClB in enumerate(places):
        left.append(_picture(k, true.left, X_ClB, noise_std, rng))
        if k < _HELD:
            right.append(_picture(k, true.right, inverse(true.X_ClCr) @ X_ClB, noise_std, rng))
        progress(k + 1, len(places))
    held_left, surveyed = left[:_HELD], left[_HELD:]
    fit = calibrated_pair(held_left, right, (calibrated(held_left, _BOARD), calibrated(right, _BOARD)), _BOARD)
    X_SC = _mounted(fit.left, surveyed, [true.X_SC @ X_ClB for X_ClB in places[_HELD:]], true.X_SC)
    rig = RawStereoRig(left=fit.left, right=fit.right, X_ClCr=fit.X_ClCr, X_SC=X_SC)
    return BoardCalibration(rig, fit.rms, fit.rotation_std)


def _picture(k: int, camera: CameraModel, X_CB: FloatArray, noise_std: float, rng: np.random.Generator) -> BoardView:
    image = board_image(_BOARD, camera, X_CB, noise_std=noise_std, rng=rng)
    return board_view(f"board {k + 1}", image, _BOARD)


def _place(rig: RawStereoRig, column: int, squares: tuple[float, float], rng: np.random.Generator) -> FloatArray:
    """X_ClB (4, 4) of a board that both cameras see whole, its middle in one of the strips of the left picture.

    Its ``squares`` are so large in the middle of the picture at the nearest, and so small at the farthest [px].
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
        f"rig.calibration = boards: no place found where both cameras see all of a board of {_BOARD.columns}x"
        f"{_BOARD.rows} corners; the baseline of {rig.baseline:g} m is too long or the view too narrow: use exact"
    )


def _shows(camera: CameraModel, X_CB: FloatArray) -> bool:
    """Whether all of the board's corners are in the picture."""
    p = _BOARD.corners[_OUTERMOST] @ X_CB[:3, :3].T + X_CB[:3, 3]
    if p[:, 2].min() < _NEAREST:
        return False
    pixels = camera.project(p)
    size = np.array([camera.width, camera.height])
    return bool(((pixels > _EDGE) & (pixels < size - 1.0 - _EDGE)).all())


def _mounted(
    camera: CameraModel, views: Sequence[BoardView], surveyed: Sequence[FloatArray], designed: FloatArray
) -> FloatArray:
    """X_SC (4, 4) of a camera from its pictures of boards at known poses X_SB: one pose to fit all of their corners.

    The pose on the drawings, ``designed``, tells which way up a board is seen, and is where the search begins.
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
        raise ValueError("rig.calibration = boards: none of the surveyed boards was found in its picture")
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
