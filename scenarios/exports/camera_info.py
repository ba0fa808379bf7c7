"""Calibration of a recording's cameras as ROS's CameraInfo states it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from estimators.calibration.rectification import Rectifier
from scenarios.recordings.images import image_size
from scenarios.recordings.mounting import read_rig
from scenarios.recordings.projections import read_projections
from scenarios.recordings.sequence import StereoSequence
from sensors.camera.lens import CameraModel, load_raw_rig
from vehicle.frames import FloatArray


def camera_infos(sequence: StereoSequence) -> dict[str, dict[str, Any]]:
    """Fields of both cameras: size, K (9), D (5), R (9) and P (12), of raw or of rectified images as recorded.

    Raises:
        ValueError: one line, if the recording has no readable calibration.
    """
    size = image_size(sequence)
    rig_file = sequence.directory / "rig.toml"
    if rig_file.is_file() and read_rig(rig_file).raw:
        return _raw(rig_file)
    projections = read_projections(sequence.directory / "calib.txt", sequence.layout)
    K = np.array(
        [
            [projections.focal_length, 0.0, projections.cx],
            [0.0, projections.focal_length, projections.cy],
            [0.0, 0.0, 1.0],
        ]
    )
    return {
        side: _fields(size, K, np.zeros(5), np.eye(3), _projection(K, shift))
        for side, shift in (("left", 0.0), ("right", projections.baseline))
    }


def _raw(path: Path) -> dict[str, dict[str, Any]]:
    raw = load_raw_rig(path)
    rectified = Rectifier(raw).calibration
    f = rectified.focal_length
    K = np.array([[f, 0.0, rectified.cx], [0.0, f, rectified.cy], [0.0, 0.0, 1.0]])
    R_left = np.linalg.inv(rectified.X_SC)[:3, :3] @ raw.X_SC[:3, :3]
    return {
        "left": _of_lens(raw.left, R_left, _projection(K, 0.0)),
        "right": _of_lens(raw.right, R_left @ raw.X_ClCr[:3, :3], _projection(K, rectified.baseline)),
    }


def _of_lens(camera: CameraModel, R: FloatArray, P: FloatArray) -> dict[str, Any]:
    return _fields((camera.width, camera.height), camera.matrix, np.array(camera.distortion), R, P)


def _projection(K: FloatArray, baseline: float) -> FloatArray:
    return np.column_stack([K, [-K[0, 0] * baseline, 0.0, 0.0]])


def _fields(size: tuple[int, int], K: FloatArray, D: FloatArray, R: FloatArray, P: FloatArray) -> dict[str, Any]:
    return {
        "width": size[0],
        "height": size[1],
        "distortion_model": "plumb_bob",
        "d": D.astype(np.float64),
        "k": K.astype(np.float64).ravel(),
        "r": R.astype(np.float64).ravel(),
        "p": P.astype(np.float64).ravel(),
    }
