"""Calibrations of raw stereo pairs as other programs write them: Kalibr, EuRoC, ROS, OpenCV.

| program | file | where the right camera is |
|---|---|---|
| Kalibr | ``camchain*.yaml`` | ``T_cn_cnm1`` of cam1: from the left camera to the right one |
| EuRoC | ``sensor.yaml`` of each camera | ``T_BS``: pose of the camera in the body |
| ROS ``camera_info`` | ``left.yaml`` and ``right.yaml`` | by R and P, which rectify |
| OpenCV | YAML or XML with M1, D1, M2, D2, R, T | R, T: from the left camera to the right one |

Lenses are plumb_bob (radtan), rational_polynomial, and of fisheyes equidistant.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml

from offtrack.exchange.recordings.bag_messages import baseline
from scenarios.roads.path_file import read_xml
from sensors.camera.rig import CameraModel, RawStereoRig
from vehicle.foundation.user_file import MAX_NESTING, FileKind, read_text, shown
from vehicle.frames import FloatArray, inverse, orthonormalised, transform

SUFFIXES: Final = (".yaml", ".yml", ".xml")
_MOST_EVENTS: Final = 20_000  # of a YAML file
_FISHEYES: Final = ("equidistant", "fisheye")
_LENSES: Final = (
    "plumb_bob", "radtan", "radial-tangential", "pinhole-radtan", "rational_polynomial", "none", "", *_FISHEYES,
)  # fmt: skip
_MATRICES: Final = {  # names of OpenCV's samples and of other programs
    "M1": ("M1", "K1", "cameraMatrix1", "camera_matrix_1", "left_camera_matrix"),
    "D1": ("D1", "distCoeffs1", "dist_coeffs_1", "left_distortion"),
    "M2": ("M2", "K2", "cameraMatrix2", "camera_matrix_2", "right_camera_matrix"),
    "D2": ("D2", "distCoeffs2", "dist_coeffs_2", "right_distortion"),
    "R": ("R", "rotation", "stereo_R"),
    "T": ("T", "translation", "stereo_T"),
}


def foreign_files(folders: tuple[Path, Path]) -> tuple[Path, ...]:
    """Calibration files of other programs beside the folders of the left and the right images, or in the one above."""
    own = tuple(folder.parent / "sensor.yaml" for folder in folders)
    if folders[0].parent != folders[1].parent and all(path.is_file() for path in own):
        return own
    for place in (folders[0].parent, folders[0].parent.parent):
        for pattern in ("camchain*.y*ml", "*stereo*.y*ml", "*stereo*.xml", "*intrinsics*.y*ml"):
            if found := sorted(place.glob(pattern)):
                return (found[0],)
        pair = place / "left.yaml", place / "right.yaml"
        if all(path.is_file() for path in pair):
            return pair
    return ()


def foreign_rig(files: tuple[Path, ...], size: tuple[int, int]) -> RawStereoRig:
    """Raw stereo pair from one file, or from those of the left and the right camera; its X_SC is the identity.

    Args:
        files: a file, or that of the left and that of the right camera. The left one will do, if the other is found
            by its name, or that of its folder.
        size: width and height [px] of the images, for files that do not say it.

    Raises:
        ValueError: one line naming the file and what is missing or wrong in it.
    """
    first = files[0]
    tables = [_table(path) for path in files]
    if len(tables) == 1 and ("camera_matrix" in tables[0] or "intrinsics" in tables[0]):
        files = first, _of_right_camera(first)
        tables.append(_table(files[1]))
    try:
        if len(tables) == 2:
            left, right = (_camera(table, size) for table in tables)
            X_ClCr = _between(*tables)
        elif "cam1" in tables[0]:
            left, right = (_camera(tables[0][name], size) for name in ("cam0", "cam1"))
            X_ClCr = inverse(_numbers(tables[0]["cam1"]["T_cn_cnm1"]).reshape(4, 4))
        else:
            left, right, X_ClCr = _of_opencv(tables[0], size)
        R = orthonormalised(X_ClCr[:3, :3])
        return RawStereoRig(left=left, right=right, X_ClCr=transform(R, X_ClCr[:3, 3]), X_SC=np.eye(4))
    except KeyError as error:
        raise ValueError(f"{first}: {error.args[0]} is missing: is it the calibration of a stereo pair?") from None
    except (TypeError, AttributeError, IndexError) as error:
        raise ValueError(f"{first}: can not be read as the calibration of a stereo pair: {error}") from None
    except ValueError as error:
        raise ValueError(f"{' and '.join(map(str, files))}: {error}") from error


def _of_right_camera(left: Path) -> Path:
    """File of the right camera beside that of the left one: ``right.yaml``, ``cam1/sensor.yaml``."""
    for was, instead in (("left", "right"), ("cam0", "cam1")):
        for other in (left.with_name(left.name.replace(was, instead)), left.parent.with_name(instead) / left.name):
            if (was in left.name or left.parent.name == was) and other != left and other.is_file():
                return other
    raise ValueError(f"{left}: calibration of one camera, and none of the right one beside it (right.yaml, cam1)")


class _Loader(yaml.SafeLoader):  # type: ignore[misc]  # it ships no types
    """YAML with OpenCV's matrices."""


def _matrix(loader: Any, node: Any) -> Any:
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _matrix)


def _check_yaml(text: str) -> None:
    """Refuse what takes the loader long: aliases, which multiply, and more than a calibration has."""
    depth = 0
    for count, event in enumerate(yaml.parse(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if isinstance(event, yaml.AliasEvent) or depth > MAX_NESTING or count > _MOST_EVENTS:
            rule = f"no aliases, at most {_MOST_EVENTS} values, {MAX_NESTING} deep"
            raise ValueError(f"line {event.start_mark.line + 1}: a calibration has {rule}")


def _table(path: Path) -> dict[str, Any]:
    """Contents of a YAML or XML file."""
    if path.suffix == ".xml":
        root = read_xml(path, "opencv_storage")
        return {one.name: {part.name: part.text for part in one.children} or one.text for one in root.children}
    text = read_text(path, FileKind.CALIBRATION)
    if text.startswith("%YAML"):
        text = text.partition("\n")[2]  # OpenCV writes %YAML:1.0, which is none
    try:
        _check_yaml(text)
        table = yaml.load(text, _Loader)  # a SafeLoader
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise ValueError(f"{path}: not a YAML file: {shown(' '.join(str(error).split()), 200)}") from None
    if not isinstance(table, dict):
        raise ValueError(f"{path}: has no keys: is it the calibration of a camera?")
    return table


def _numbers(value: Any) -> FloatArray:
    """Numbers of a list, of a matrix with its data, or of a text."""
    if isinstance(value, Mapping):
        value = value["data"]
    if isinstance(value, str):
        value = value.split()
    return np.array(value, dtype=np.float64).ravel()


def _camera(table: Mapping[str, Any], size: tuple[int, int]) -> CameraModel:
    """Camera of Kalibr, EuRoC or ROS."""
    if "camera_matrix" in table:
        K = _numbers(table["camera_matrix"])
        intrinsics, coefficients = K[[0, 4, 2, 5]], table["distortion_coefficients"]
        said = [table.get("image_width"), table.get("image_height")]
    else:
        intrinsics = _numbers(table["intrinsics"])
        coefficients = table.get("distortion_coeffs", table.get("distortion_coefficients", []))
        said = table.get("resolution", [None, None])
    lens = str(table.get("distortion_model", ""))
    if lens not in _LENSES or str(table.get("camera_model", "pinhole")) != "pinhole":
        raise ValueError(
            f"camera {shown(str(table.get('camera_model', 'pinhole')))} with lens {shown(lens)}: must be a pinhole "
            "with plumb_bob, radtan, rational_polynomial or equidistant; rectify the images first"
        )
    size = int(said[0] or size[0]), int(said[1] or size[1])
    return _model(intrinsics, _numbers(coefficients), size, fisheye=lens in _FISHEYES)


def _model(
    intrinsics: FloatArray, coefficients: FloatArray, size: tuple[int, int], *, fisheye: bool = False
) -> CameraModel:
    most = 4 if fisheye else 8
    if len(intrinsics) != 4 or np.any(coefficients[most:]):
        found = f"{len(intrinsics)} intrinsics, {len(coefficients)} coefficients"
        raise ValueError(f"{found}: must be 4 and at most {most}")
    k = [*coefficients.tolist(), *[0.0] * most][:most]
    distortion = tuple(k if fisheye or any(k[5:]) else k[:5])
    fx, fy, cx, cy = intrinsics.tolist()
    return CameraModel(
        width=size[0], height=size[1], fx=fx, fy=fy, cx=cx, cy=cy, distortion=distortion, fisheye=fisheye
    )


def _between(left: Mapping[str, Any], right: Mapping[str, Any]) -> FloatArray:
    """Pose X_ClCr (4, 4) by the poses of both cameras in a body, or by what rectifies them."""
    if "T_BS" in left:
        X_BCl, X_BCr = (_numbers(table["T_BS"]).reshape(4, 4) for table in (left, right))
        return inverse(X_BCl) @ X_BCr
    R_l, R_r = (_numbers(table["rectification_matrix"]).reshape(3, 3) for table in (left, right))
    P_l, P_r = (_numbers(table["projection_matrix"]).reshape(3, 4) for table in (left, right))
    return transform(R_l.T @ R_r, R_l.T @ np.array([baseline(P_l, P_r), 0.0, 0.0]))


def _of_opencv(table: Mapping[str, Any], size: tuple[int, int]) -> tuple[CameraModel, CameraModel, FloatArray]:
    """Cameras and X_ClCr of OpenCV's stereo calibration."""
    found = {key: next((table[name] for name in names if name in table), None) for key, names in _MATRICES.items()}
    missing = [key for key, value in found.items() if value is None]
    if missing:
        raise KeyError(", ".join(missing))
    numbers = {key: _numbers(value) for key, value in found.items()}
    cameras = [_model(numbers[f"M{k}"][[0, 4, 2, 5]], numbers[f"D{k}"], size) for k in (1, 2)]
    return cameras[0], cameras[1], inverse(transform(numbers["R"].reshape(3, 3), numbers["T"]))
