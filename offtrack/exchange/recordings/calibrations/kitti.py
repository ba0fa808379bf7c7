"""KITTI: ``calib.txt``, the projections of rectified cameras; offtrack's own recordings have one, too."""

import os
from pathlib import Path

import numpy as np

from offtrack.exchange.recordings.stereo_sequence import Folders
from sensors.camera.rig import StereoCalibration
from vehicle.foundation.user_file import FileKind, read_text
from vehicle.frames import FloatArray, transform

_FOCAL_TOLERANCE = 1e-3  # of the focal lengths of a rectified pair, relative: 0.1 px at 100 px from the middle
_LARGEST = 1e9  # number of a projection matrix [px], [px m]
_OFFSET_TOLERANCE = 0.05  # of the right camera from the left one's x axis, over the baseline; KITTI's own: 0.005


def read_projections(path: Path, folders: Folders, size: tuple[int, int]) -> StereoCalibration:
    """Read the projections of the two cameras of these folders, with images of this width and height [px].

    ``X_SC`` is the pose of the left camera in KITTI's camera 0, whose poses are in ``poses.txt``.

    Raises:
        ValueError: one line, if one is missing, or if they do not belong to a rectified pair of such images.
    """
    lines = _lines(path)
    left, right = (_matrix(path, lines, name) for name in (folders.left_projection, folders.right_projection))
    f, cx, cy = left[0, 0], left[0, 2], left[1, 2]
    if not f > 0.0 or abs(left[1, 1] / f - 1.0) > _FOCAL_TOLERANCE:
        raise ValueError(f"{path}: focal lengths {f:g} and {left[1, 1]:g} px must be positive and equal")
    if np.abs(left[:, :3] - right[:, :3]).max() > _FOCAL_TOLERANCE * f:
        raise ValueError(
            f"{path}: {folders.left_projection} and {folders.right_projection} differ in more than their last column: "
            "the pair is not rectified; give its calibration with --calibration FILE.toml"
        )
    p_Cl, p_Cr = (-np.linalg.solve(P[:, :3], P[:, 3]) for P in (left, right))  # from camera 0
    p_ClCr = p_Cr - p_Cl
    if not p_ClCr[0] > 0.0 or np.abs(p_ClCr[1:]).max() > _OFFSET_TOLERANCE * p_ClCr[0]:
        raise ValueError(
            f"{path}: baseline {p_ClCr[0]:g} m must be positive and along the left camera's x; "
            "are left and right swapped?"
        )
    for name, value, extent in (("column", cx, size[0]), ("row", cy, size[1])):
        if not 0.0 <= value <= extent - 1:
            raise ValueError(
                f"{path}: principal point at {name} {value:g} lies outside images of {size[0]}x{size[1]} px: "
                "is it the calibration of these images?"
            )
    return StereoCalibration(
        width=size[0],
        height=size[1],
        focal_length=float(f),
        cx=float(cx),
        cy=float(cy),
        baseline=float(p_ClCr[0]),
        X_SC=transform(np.eye(3), p_Cl.astype(np.float64)),
    )


def _lines(path: Path) -> dict[str, str]:
    if not os.path.lexists(path):
        raise ValueError(
            f"{path} is missing: it contains the projection matrices P0 and P1 of rectified images; "
            "for raw images use --calibration FILE (TOML, or YAML or XML of Kalibr, EuRoC, ROS or OpenCV)"
        )
    pairs = (line.partition(":") for line in read_text(path, FileKind.CALIBRATION).splitlines())
    return {name.strip(): values for name, _, values in pairs}


def _matrix(path: Path, lines: dict[str, str], name: str) -> FloatArray:
    try:
        P = np.array([float(value) for value in lines.get(name, "").split()]).reshape(3, 4)
    except ValueError:
        P = np.full((3, 4), np.nan)
    if not np.all(np.abs(P) <= _LARGEST) or abs(np.linalg.det(P[:, :3])) < 1e-9:
        raise ValueError(
            f"{path}: a line '{name}: ' with the 12 numbers of a 3x4 projection matrix, row by row, is missing or wrong"
        )
    return P
