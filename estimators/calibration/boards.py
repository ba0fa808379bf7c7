"""Calibration of a camera or a stereo pair from photographs of a checkerboard, through OpenCV.

Zhang 2000: Z. Zhang, "A flexible new technique for camera calibration", IEEE PAMI, 2000, with the lens of
``sensors.camera.rig``. Sets of photographs that cannot give a good calibration are refused with the reason.
"""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from estimators.rigid_motion import rotation_vector
from sensors.camera.calibration_target import Checkerboard
from sensors.camera.rig import CameraModel
from sensors.messages import GreyImage
from vehicle.frames import FloatArray, inverse, orthonormalised, so3_exp, transform

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
    flags = int(cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK)
    found, corners = cv2.findChessboardCorners(image, pattern, flags=flags)
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


def _spacing(grid: NDArray[np.float32]) -> float:
    """Least distance between neighbours in a grid (rows, columns, 2) [px]."""
    return min(float(np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min()) for axis in (0, 1))


@contextmanager
def single_thread() -> Iterator[None]:
    """Run OpenCV on one thread, for calibrations that must be equal to the bit from run to run.

    ``cv2.calibrateCamera`` and ``cv2.stereoCalibrate`` sum the normal equations in the order in which threads finish.
    The setting is global; it is restored at the end.
    """
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


FEWEST = 8  # photographs: with fewer the distortion follows the noise
_OUTLIER, _OUTLIER_LEAST = 2.5, 0.3  # an image is dropped if its error exceeds both: [median errors], [px]
_KNOWN = 3.0  # standard deviations that a distortion coefficient must be away from 0
ROUNDS = 3  # in which images are dropped
HIGHEST_ERROR = 1.0  # RMS reprojection error; a flat board and a still camera give about 0.1 px [px]
_CELLS = (8, 4)  # columns and rows of the grid for the coverage
_LEAST_COVERAGE = 0.5
_TILTED, _LEAST_TILTED = math.radians(15.0), 3  # angle from frontal, and the number of boards tilted at least so
_WORST_FOCAL_LENGTH = 0.01  # relative standard deviation of fx and fy


class CameraCalibration(NamedTuple):
    """Calibrated camera, its uncertainty, and the photographs used."""

    camera: CameraModel
    std: FloatArray  # (9,) of fx, fy, cx, cy [px], k1, k2, p1, p2, k3
    errors: dict[str, float]  # RMS reprojection error of each image used [px]
    dropped: dict[str, str]  # reason by name of each image not used
    corners: FloatArray  # (n, 2) all corners used [px]
    coverage: float  # share of the picture's cells with a corner in them
    note: str = ""  # on coefficients that the photographs do not determine

    @property
    def rms(self) -> float:
        """Root mean square reprojection error [px]."""
        return math.sqrt(sum(error**2 for error in self.errors.values()) / len(self.errors))


def calibrated(views: Sequence[BoardView], board: Checkerboard) -> CameraCalibration:
    """Calibrate the camera that took the photographs.

    Raises:
        ValueError: one line with the fault of the set and the remedy.
    """
    size = _common_size(views)
    missing = f"no board of {board.columns}x{board.rows} corners found"
    dropped = {view.name: missing for view in views if view.corners is None}
    used = [view for view in views if view.corners is not None]
    _check_count(len(used), len(views), board)
    fit = _fitted(used, size, board)
    for _ in range(ROUNDS):
        limit, usual = error_limit(fit.errors), float(np.median(fit.errors))
        bad = [(view.name, error) for view, error in zip(used, fit.errors, strict=True) if error > limit]
        if not bad:
            break
        dropped |= {name: f"error of {error:.2f} px; the median is {usual:.2f} px" for name, error in bad}
        used = [view for view in used if view.name not in dropped]
        _check_count(len(used), len(views), board)
        fit = _fitted(used, size, board)
    corners = np.concatenate([corners_of(view) for view in used]).astype(np.float64)
    cells = np.clip(np.floor(corners / size * _CELLS).astype(int), 0, np.array(_CELLS) - 1)
    coverage = len(np.unique(cells, axis=0)) / (_CELLS[0] * _CELLS[1])
    _check_quality(fit, coverage)
    return CameraCalibration(
        camera=camera_model(size, fit.matrix, fit.distortion),
        std=fit.std,
        errors=dict(zip([view.name for view in used], fit.errors.tolist(), strict=True)),
        dropped=dropped,
        corners=corners,
        coverage=coverage,
        note="" if fit.std[-1] else "k3 is left at 0: the photographs do not determine it",
    )


def error_limit(errors: FloatArray) -> float:
    """Largest error of an image that is used [px]."""
    return max(_OUTLIER * float(np.median(errors)), _OUTLIER_LEAST)


class _Fit(NamedTuple):
    """Result of OpenCV's calibration."""

    matrix: FloatArray  # (3, 3)
    distortion: FloatArray  # (5,)
    std: FloatArray  # (9,)
    errors: FloatArray  # (n,) RMS of each image [px]
    tilts: FloatArray  # (n,) of the board from frontal [rad]


def _fitted(used: Sequence[BoardView], size: tuple[int, int], board: Checkerboard) -> _Fit:
    """Camera with k3, if it is known to better than a third of itself and the image does not fold over; else without.

    A k3 that follows the noise does not lower the residual, and makes nonsense of the corners of the image.
    """
    fit = _fitted_with(used, size, board, 0)
    k3, std = abs(fit.distortion[-1]), fit.std[-1]
    try:
        camera_model(size, fit.matrix, fit.distortion)
    except ValueError:
        k3 = 0.0
    return fit if k3 > _KNOWN * std else _fitted_with(used, size, board, cv2.CALIB_FIX_K3)


@single_thread()
def _fitted_with(used: Sequence[BoardView], size: tuple[int, int], board: Checkerboard, flags: int) -> _Fit:
    _, K, distortion, turns, _, std, _, errors = cv2.calibrateCameraExtended(
        [board.corners.astype(np.float32)] * len(used),
        [corners_of(view) for view in used],
        size,
        np.eye(3),
        np.zeros(5),
        flags=flags,
    )
    normals = np.array([so3_exp(np.asarray(turn, dtype=np.float64).ravel())[:, 2] for turn in turns])
    return _Fit(
        matrix=np.asarray(K, dtype=np.float64),
        distortion=np.asarray(distortion, dtype=np.float64).ravel()[:5],
        std=np.asarray(std, dtype=np.float64).ravel()[:9],
        errors=np.asarray(errors, dtype=np.float64).ravel(),
        tilts=np.arccos(np.clip(np.abs(normals[:, 2]), 0.0, 1.0)),
    )


def camera_model(size: tuple[int, int], K: FloatArray, distortion: FloatArray) -> CameraModel:
    """Camera model from OpenCV's K (3, 3) and distortion coefficients."""
    k1, k2, p1, p2, k3 = distortion.ravel()[:5].tolist()
    fx, fy, cx, cy = (float(K[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return CameraModel(width=size[0], height=size[1], fx=fx, fy=fy, cx=cx, cy=cy, distortion=(k1, k2, p1, p2, k3))


def corners_of(view: BoardView) -> Corners:
    """Corners (n, 2) of a photograph.

    Raises:
        ValueError: if no board was found in it.
    """
    if view.corners is None:
        raise ValueError(f"{view.name}: no board found")
    return view.corners


def _common_size(views: Sequence[BoardView]) -> tuple[int, int]:
    if not views:
        raise ValueError("no images")
    first = views[0]
    for view in views:
        if view.size != first.size:
            raise ValueError(
                f"{view.name} has {view.size[0]}x{view.size[1]} px, {first.name} {first.size[0]}x{first.size[1]} px; "
                "all images must come from one camera at one resolution"
            )
    return first.size


def _check_count(usable: int, given: int, board: Checkerboard) -> None:
    if usable == 0:
        raise ValueError(
            f"no image of {given} shows a board of {board.columns}x{board.rows} inner corners; count them (not the "
            "squares) and give --board COLUMNSxROWS"
        )
    if usable < FEWEST:
        raise ValueError(
            f"only {usable} of {given} images can be used; at least {FEWEST} are needed, 20 are good: move the board "
            "all over the picture, nearer and farther, tilted by 30 to 45 deg"
        )


def _check_quality(fit: _Fit, coverage: float) -> None:
    """Refuse a set that fits badly, or that determines the camera badly."""
    rms = float(np.sqrt(np.mean(fit.errors**2)))
    if np.count_nonzero(fit.tilts > _TILTED) < _LEAST_TILTED:
        raise ValueError(
            "the board is held frontally in all images (within 15 deg), which does not determine the focal length; "
            "tilt it by 30 to 45 deg in different directions"
        )
    if rms > HIGHEST_ERROR:
        raise ValueError(
            f"the corners are {rms:.2f} px RMS off the best camera (limit {HIGHEST_ERROR:g} px): is the board flat, "
            "are the images sharp and all of one lens setting?"
        )
    if coverage < _LEAST_COVERAGE:
        raise ValueError(
            f"the boards cover {100 * coverage:.0f} % of the picture (limit {100 * _LEAST_COVERAGE:.0f} %); "
            "hold the board into the corners and along the edges, too"
        )
    worst = float((fit.std[:2] / fit.matrix[[0, 1], [0, 1]]).max())
    if worst > _WORST_FOCAL_LENGTH:
        raise ValueError(
            f"the focal length is uncertain by {100 * worst:.1f} % (limit {100 * _WORST_FOCAL_LENGTH:g} %); "
            "take more images, tilted and nearer"
        )


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
    rms = float(np.sqrt(np.mean(fit.errors**2)))
    if rms > HIGHEST_ERROR:
        raise ValueError(
            f"the pairs are {rms:.1f} px RMS off one pose of the right camera (limit {HIGHEST_ERROR:g} px): were both "
            "images of each taken at the same moment?"
        )
    kept = cv2.CALIB_FIX_K3 if any(camera.note for camera in cameras) else 0
    fit = _pair_fitted(pairs, cameras, board, cv2.CALIB_USE_INTRINSIC_GUESS | kept)
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
