"""Calibration of a stereo pair from simultaneous photographs of a checkerboard."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from estimators.calibration.board_views import BoardView, Corners, in_same_order
from estimators.calibration.single_camera import (
    FEWEST,
    HIGHEST_ERROR,
    ROUNDS,
    CameraCalibration,
    camera_model,
    corners_of,
    error_limit,
    single_thread,
)
from estimators.rigid_motion import rotation_vector
from sensors.camera.calibration_target import Checkerboard
from sensors.camera.lens import CameraModel
from vehicle.frames import FloatArray, inverse, orthonormalised, so3_exp, transform

_OF_CENTRES = 0.5  # share of the principal points' errors in the rotation between the cameras: measured


class StereoFit(NamedTuple):
    """Calibrated stereo pair and its uncertainty."""

    left: CameraModel
    right: CameraModel
    X_ClCr: FloatArray  # (4, 4)
    rotation_std: float  # of the worst angle of X_ClCr [rad]
    position_std: float  # of each coordinate [m]
    errors: dict[str, float]  # RMS reprojection error of each pair used [px]
    dropped: dict[str, str]  # reason by name of each pair not used

    @property
    def rms(self) -> float:
        """Root mean square reprojection error [px]."""
        return math.sqrt(sum(error**2 for error in self.errors.values()) / len(self.errors))


def calibrated_pair(
    left: Sequence[BoardView],
    right: Sequence[BoardView],
    cameras: tuple[CameraCalibration, CameraCalibration],
    board: Checkerboard,
) -> StereoFit:
    """Calibrate the stereo pair that took the photographs, given as pairs in the same order.

    The separately calibrated cameras are refined together with the pose between them, which halves its error.

    Raises:
        ValueError: one line with the fault of the set.
    """
    if len(left) != len(right):
        raise ValueError(f"{len(left)} left and {len(right)} right images: they must be pairs, in the same order")
    pairs, dropped = [], {}
    for a, b in zip(left, right, strict=True):
        reasons = [cameras[k].dropped[view.name] for k, view in enumerate((a, b)) if view.name in cameras[k].dropped]
        if reasons:
            dropped[a.name] = reasons[0]
        else:
            pairs.append(_Pair(a.name, corners_of(a), in_same_order(corners_of(a), corners_of(b))))
    _check_pairs(pairs)
    for _ in range(ROUNDS):
        fit = _pair_fitted(pairs, cameras, board, cv2.CALIB_FIX_INTRINSIC)  # so wrong pairs cannot distort the cameras
        limit = error_limit(fit.errors)
        if (fit.errors <= limit).all():
            break
        bad = [(pair.name, error) for pair, error in zip(pairs, fit.errors, strict=True) if error > limit]
        dropped |= {name: f"error of {error:.2f} px in both images together" for name, error in bad}
        pairs = [pair for pair in pairs if pair.name not in dropped]
        _check_pairs(pairs)
    _check_agreement(fit)
    fit = _pair_fitted(pairs, cameras, board, cv2.CALIB_USE_INTRINSIC_GUESS)
    rotation_std, position_std = _spread(pairs, fit, board)
    centres = np.array([camera.std[2:4] / camera.camera.fx for camera in cameras])  # of the principal points [rad]
    return StereoFit(
        left=fit.left,
        right=fit.right,
        X_ClCr=fit.X_ClCr,
        rotation_std=math.hypot(rotation_std, _OF_CENTRES * float(np.linalg.norm(centres, axis=0).max())),
        position_std=position_std,
        errors=dict(zip([pair.name for pair in pairs], fit.errors.tolist(), strict=True)),
        dropped=dropped,
    )


class _Pair(NamedTuple):
    """Corners in two simultaneous photographs."""

    name: str
    left: Corners
    right: Corners


class _PairFit(NamedTuple):
    """Result of OpenCV's stereo calibration."""

    left: CameraModel
    right: CameraModel
    X_ClCr: FloatArray
    errors: FloatArray  # (n,) RMS of each pair [px]


@single_thread()
def _pair_fitted(
    pairs: Sequence[_Pair], cameras: tuple[CameraCalibration, CameraCalibration], board: Checkerboard, flags: int
) -> _PairFit:
    left, right = (calibration.camera for calibration in cameras)
    size = (left.width, left.height)
    _, K_l, distortion_l, K_r, distortion_r, R, T, *_, errors = cv2.stereoCalibrateExtended(
        [board.corners.astype(np.float32)] * len(pairs),
        [pair.left for pair in pairs],
        [pair.right for pair in pairs],
        left.matrix,
        np.array(left.distortion),
        right.matrix,
        np.array(right.distortion),
        size,
        np.eye(3),
        np.zeros(3),
        flags=flags,
    )
    R_CrCl, p_CrCl = np.asarray(R, dtype=np.float64), np.asarray(T, dtype=np.float64).ravel()
    return _PairFit(
        left=camera_model(size, np.asarray(K_l), np.asarray(distortion_l)),
        right=camera_model((right.width, right.height), np.asarray(K_r), np.asarray(distortion_r)),
        X_ClCr=inverse(transform(orthonormalised(R_CrCl), p_CrCl)),
        errors=np.sqrt(np.mean(np.square(np.asarray(errors, dtype=np.float64)), axis=1)),
    )


def _check_pairs(pairs: Sequence[_Pair]) -> None:
    if len(pairs) < FEWEST:
        raise ValueError(
            f"only {len(pairs)} pairs can be used; at least {FEWEST} must show the board to both cameras, "
            "taken at the same moment"
        )


def _check_agreement(fit: _PairFit) -> None:
    rms = float(np.sqrt(np.mean(fit.errors**2)))
    if rms > HIGHEST_ERROR:
        raise ValueError(
            f"the pairs are {rms:.1f} px RMS off one pose of the right camera (limit {HIGHEST_ERROR:g} px): were both "
            "images of each taken at the same moment?"
        )


def _spread(pairs: Sequence[_Pair], fit: _PairFit, board: Checkerboard) -> tuple[float, float]:
    """Standard deviations [rad, m] of the mean pose, from how far the poses of single pairs differ."""
    turns, shifts = [], []
    for pair in pairs:
        X_ClB, X_CrB = _board_pose(pair.left, fit.left, board), _board_pose(pair.right, fit.right, board)
        error = inverse(fit.X_ClCr) @ X_ClB @ inverse(X_CrB)
        turns.append(rotation_vector(error[:3, :3]))
        shifts.append(error[:3, 3])
    of_mean = 1.0 / math.sqrt(len(pairs))
    return float(np.sqrt(np.mean(np.square(turns)))) * of_mean, float(np.sqrt(np.mean(np.square(shifts)))) * of_mean


def _board_pose(corners: Corners, model: CameraModel, board: Checkerboard) -> FloatArray:
    """X_CB (4, 4) from one photograph."""
    _, turn, p = cv2.solvePnP(board.corners, corners.astype(np.float64), model.matrix, np.array(model.distortion))
    return transform(so3_exp(np.asarray(turn, dtype=np.float64).ravel()), np.asarray(p, dtype=np.float64).ravel())
