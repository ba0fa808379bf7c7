"""ROS ``camera_info``: ``left.yaml`` and ``right.yaml``, whose R and P rectify and tell where the right camera is."""

from collections.abc import Sequence

import numpy as np

from offtrack.exchange.recordings.calibrations.cameras import Pair, Table, Tables, baseline, numbers, pinhole
from sensors.camera.rig import CameraModel
from vehicle.frames import transform


def pair(tables: Tables, size: Sequence[int]) -> Pair:
    """Cameras of two tables."""
    left, right = (_camera(table, size) for table in tables)
    R_l, R_r = (numbers(table["rectification_matrix"]).reshape(3, 3) for table in tables)
    P_l, P_r = (numbers(table["projection_matrix"]).reshape(3, 4) for table in tables)
    if not all(np.any(R) for R in (R_l, R_r)) or not min(P_l[0, 0], P_r[0, 0]) > 0.0:
        raise ValueError("rectification_matrix or projection_matrix is empty: calibrate the cameras as a pair")
    return left, right, transform(R_l.T @ R_r, R_l.T @ np.array([baseline(P_l, P_r), 0.0, 0.0]))


def _camera(table: Table, size: Sequence[int]) -> CameraModel:
    own = table.get("image_width") or size[0], table.get("image_height") or size[1]
    return pinhole(table, numbers(table["camera_matrix"])[[0, 4, 2, 5]], table["distortion_coefficients"], own)
