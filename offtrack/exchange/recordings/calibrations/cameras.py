"""Cameras of calibration files: lenses are plumb_bob (radtan), rational_polynomial, and of fisheyes equidistant."""

from collections.abc import Mapping, Sequence
from typing import Any, Final, TypeAlias

import numpy as np

from sensors.camera.rig import CameraModel
from vehicle.foundation.user_file import shown
from vehicle.frames import FloatArray

Table: TypeAlias = Mapping[str, Any]  # contents of a file
Tables: TypeAlias = Sequence[Table]  # of the pair's file, or of the left and the right camera's
Pair: TypeAlias = tuple[CameraModel, CameraModel, FloatArray]  # left and right camera, X_ClCr (4, 4)
_FISHEYES: Final = ("equidistant", "fisheye")
_LENSES: Final = (
    "plumb_bob", "radtan", "radial-tangential", "pinhole-radtan", "rational_polynomial", "none", "", *_FISHEYES,
)  # fmt: skip


def numbers(value: Any) -> FloatArray:
    """Numbers of a list, of a matrix with its data, or of a text."""
    if isinstance(value, Mapping):
        value = value["data"]
    if isinstance(value, str):
        value = value.split()
    return np.array(value, dtype=np.float64).ravel()


def pinhole(table: Table, intrinsics: FloatArray, coefficients: Any, size: Sequence[Any]) -> CameraModel:
    """Camera with the lens that its table names, or with OpenCV's.

    Args:
        table: of the camera.
        intrinsics: fx, fy, cx, cy [px].
        coefficients: of the distortion.
        size: width and height [px].

    Raises:
        ValueError: if the camera is no pinhole, or its lens is unknown or has more coefficients.
    """
    lens, kind = str(table.get("distortion_model", "")), str(table.get("camera_model", "pinhole"))
    if lens not in _LENSES or kind != "pinhole":
        raise ValueError(
            f"camera {shown(kind)} with lens {shown(lens)}: must be a pinhole with plumb_bob, radtan, "
            "rational_polynomial or equidistant; rectify the images first"
        )
    coefficients, fisheye = numbers(coefficients), lens in _FISHEYES
    most = 4 if fisheye else 8
    if len(intrinsics) != 4 or np.any(coefficients[most:]):
        found = f"{len(intrinsics)} intrinsics, {len(coefficients)} coefficients"
        raise ValueError(f"{found}: must be 4 and at most {most}")
    k = [*coefficients.tolist(), *[0.0] * most][:most]
    fx, fy, cx, cy = intrinsics.tolist()
    return CameraModel(
        width=int(size[0]), height=int(size[1]), fx=fx, fy=fy, cx=cx, cy=cy,
        distortion=tuple(k if fisheye or any(k[5:]) else k[:5]), fisheye=fisheye,
    )  # fmt: skip


def listed(table: Table, size: Sequence[Any]) -> CameraModel:
    """Camera with ``intrinsics`` in a list, of Kalibr and EuRoC."""
    coefficients = table.get("distortion_coeffs", table.get("distortion_coefficients", []))
    return pinhole(table, numbers(table["intrinsics"]), coefficients, table.get("resolution", size))


def baseline(P_l: FloatArray, P_r: FloatArray) -> float:
    """Distance [m] of the right camera along the left one's x axis, by the difference of projections P (3, 4)."""
    return float(P_l[0, 3] / P_l[0, 0] - P_r[0, 3] / P_r[0, 0])
