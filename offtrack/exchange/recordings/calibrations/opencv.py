"""OpenCV: YAML or XML with M1, D1, M2, D2, and R, T from the left camera to the right one."""

from collections.abc import Sequence
from typing import Final

from offtrack.exchange.recordings.calibrations.cameras import Pair, Tables, numbers, pinhole
from vehicle.frames import inverse, transform

_NAMES: Final = {  # of OpenCV's samples and of other programs
    "M1": ("M1", "K1", "cameraMatrix1", "camera_matrix_1", "left_camera_matrix"),
    "D1": ("D1", "distCoeffs1", "dist_coeffs_1", "left_distortion"),
    "M2": ("M2", "K2", "cameraMatrix2", "camera_matrix_2", "right_camera_matrix"),
    "D2": ("D2", "distCoeffs2", "dist_coeffs_2", "right_distortion"),
    "R": ("R", "rotation", "stereo_R"),
    "T": ("T", "translation", "stereo_T"),
}


def pair(tables: Tables, size: Sequence[int]) -> Pair:
    """Cameras of one table, which does not tell their size."""
    found = {key: next((tables[0][name] for name in names if name in tables[0]), None) for key, names in _NAMES.items()}
    if missing := [key for key, value in found.items() if value is None]:
        raise KeyError(", ".join(missing))
    left, right = (pinhole({}, numbers(found[f"M{k}"])[[0, 4, 2, 5]], found[f"D{k}"], size) for k in (1, 2))
    return left, right, inverse(transform(numbers(found["R"]).reshape(3, 3), numbers(found["T"])))
