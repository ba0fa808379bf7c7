"""Cameras of recordings: photographs and files of their calibration, and their pose on the trailer.

The pose comes from a recording's ``rig.toml``, from options, or is assumed and reported.
"""

import math
import os
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, cast, get_args

import cv2
import numpy as np
import tomli_w
from pydantic import BaseModel, ConfigDict, Field, field_validator

from estimators.calibration.boards import BoardView, CameraCalibration, board_view
from estimators.estimates import Health
from estimators.odometry.circular import CircularOdometry
from offtrack.exchange.recordings.layouts.file_pairs import file_pairs
from scenarios.image_file import images_in, read_grey_upright
from scenarios.progress import Progress
from sensors.camera.calibration_target import Checkerboard
from sensors.camera.rig import StereoCalibration, check_rigid
from sensors.messages import StereoFrame
from vehicle.foundation.quantity import checked
from vehicle.foundation.user_file import FileKind, nearest, read_toml, without_sources
from vehicle.frames import R_BODY_CAMERA, FloatArray, rotation_zyx, transform

Facing = Literal["rear", "left", "right", "front", "down"]


# Assumed yaw and pitch [rad], and the distance from the hitch back to the cameras over the follow distance.
_ASSUMED: Final[dict[Facing, tuple[float, float, float]]] = {
    "rear": (math.pi, 0.0, 1.0),
    "left": (0.5 * math.pi, 0.0, 0.5),
    "right": (-0.5 * math.pi, 0.0, 0.5),
    "front": (0.0, 0.0, 0.0),
    "down": (0.0, 0.5 * math.pi, 0.5),
}
_FOLLOW_DISTANCE = 14.0  # default: de Saxe 2018, section 3.1 [m]
_HEIGHT = 3.0  # default: the same section [m]
_WIDTH, _QUICK = 640, 5  # of images [px] in the first frames, in which it is sought at first
_CLEAR_DISTANCE = 1.0  # after which the direction of travel is clear: 100 times the odometry's error [m]
# Standard deviations of the camera's direction where a recording does not state one.
_PRINCIPAL_POINT = 1.0  # assumed of a calibrated principal point: calibrations of one camera differ by this [px]
_ALIGNED = math.radians(0.1)  # assumed of a camera whose mounting is not known: 1 cm in 6 m [rad]
_LONGEST_WAIT = 300  # for this distance [frames]


class _RigTable(BaseModel):
    """The part of a ``rig.toml`` that describes the mounting; the file of a raw pair contains more."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    X_SC: tuple[tuple[float, float, float, float], ...]  # pose of the left camera in the trailer, 4x4
    follow_distance: float | None = Field(None, gt=0.0, json_schema_extra={"unit": "m"})  # hitch to follow point
    roll_axis_height: float = Field(0.0, ge=0.0, le=3.0, json_schema_extra={"unit": "m"})  # about which the body rolls
    direction_std_deg: float | None = Field(None, ge=0.0, le=10.0, json_schema_extra={"unit": "deg"})  # of the camera
    left: dict[str, Any] | None = None  # of a raw pair

    @field_validator("X_SC")
    @classmethod
    def _rigid(cls, rows: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
        try:
            check_rigid("the matrix", np.array(rows))
        except ValueError as error:
            raise ValueError(f"must be a pose: {error}") from None
        return rows


@dataclass(frozen=True, slots=True, kw_only=True)
class MountingOptions:
    """The user's options on cameras and trailer; None where there is none."""

    follow_distance: float | None = None  # hitch to follow point [m]
    facing: Facing | None = None
    x: float | None = None  # middle of the pair, ahead of the hitch, negative behind it [m]
    y: float | None = None  # + left [m]
    z: float | None = None  # above the ground [m]
    direction_std: float | None = None  # 1 sigma of the direction, by mount and calibration [rad]
    upside_down: bool = False  # the pair is turned by half a turn about its optical axes

    def __post_init__(self) -> None:
        if self.follow_distance is not None and not 0.0 < self.follow_distance < math.inf:
            raise ValueError(f"--follow-distance = {self.follow_distance:g} m must be positive")
        if self.z is not None and not 0.0 < self.z < math.inf:
            raise ValueError(f"--camera-height = {self.z:g} m must be positive")


def facing_named(name: str) -> Facing:
    """Facing direction of this name.

    Raises:
        ValueError: if there is no such direction.
    """
    name = {"forward": "front", "forwards": "front", "backward": "rear", "back": "rear"}.get(name, name)
    if name not in get_args(Facing):
        raise ValueError(f"--facing = {name}: unknown{nearest(name, get_args(Facing))}")
    return cast(Facing, name)


@dataclass(frozen=True, slots=True, eq=False)
class Mounting:
    """Pose of the left camera in the trailer, and the trailer's follow point."""

    X_SC: FloatArray  # (4, 4)
    follow_distance: float  # hitch to follow point [m]
    roll_axis_height: float = 0.0  # of the axis about which the trailer's body rolls [m]
    direction_std: float = 0.0  # 1 sigma of the left camera's direction in the trailer [rad]
    assumed: tuple[str, ...] = ()  # assumptions in words


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rig:
    """Mounting data of a file; None where it has none."""

    X_SC: FloatArray | None = None
    follow_distance: float | None = None  # [m]
    roll_axis_height: float = 0.0  # [m]
    direction_std: float | None = None  # 1 sigma of the left camera's direction in the trailer [rad]
    raw: bool = False  # True if the file also contains the calibration of raw images


def read_rig(path: Path) -> Rig:
    """Read the mounting from a ``rig.toml``; the pose of a camera that is not above the ground is ignored.

    Raises:
        ValueError: one line naming file and key.
    """
    table = checked(_RigTable, without_sources(read_toml(path, FileKind.CALIBRATION)), str(path))
    X_SC = np.array(table.X_SC)
    return Rig(
        X_SC=X_SC if X_SC[2, 3] > 0.0 else None,
        follow_distance=table.follow_distance,
        roll_axis_height=table.roll_axis_height,
        direction_std=None if table.direction_std_deg is None else math.radians(table.direction_std_deg),
        raw=table.left is not None,
    )


def mounting(
    options: MountingOptions, rig: Rig, calibration: StereoCalibration, facing: Callable[[], Facing | None]
) -> Mounting:
    """Mounting from options, then from a rig, then from assumptions.

    Rear-facing cameras are assumed above the follow point, front-facing ones above the hitch, all others halfway.

    Args:
        options: the user's options.
        rig: mounting data of the recording.
        calibration: of the rectified cameras.
        facing: finds the facing direction from the cameras' motion; called only if it is not known otherwise.
    """
    assumed: list[str] = []
    follow_distance = options.follow_distance or rig.follow_distance
    if follow_distance is None:
        follow_distance = _FOLLOW_DISTANCE
        assumed.append(f"follow point {follow_distance:g} m behind the hitch (--follow-distance)")
    placed = (options.facing, options.x, options.y, options.z)
    turned = rotation_zyx(math.pi if options.upside_down else 0.0, 0.0, 0.0)  # about the optical axis
    if rig.X_SC is not None and placed == (None,) * len(placed):
        direction_std = _direction_std(options, rig, calibration, 0.0, assumed)
        X_SC: FloatArray = rig.X_SC @ transform(turned, np.zeros(3))
        return Mounting(X_SC, follow_distance, rig.roll_axis_height, direction_std, tuple(assumed))
    direction = options.facing
    if direction is None:
        found = facing()
        direction = found or "rear"
        source = ", found from their motion" if found else ": their motion does not show it"
        assumed.append(f"cameras face {'' if direction == 'down' else 'to the '}{direction}{source} (--facing)")
    yaw, pitch, share = _ASSUMED[direction]
    x, y, z = options.x, options.y or 0.0, options.z
    if x is None:
        x = -share * follow_distance
        assumed.append(f"cameras {-x:g} m behind the hitch (--camera-x)")
    if z is None:
        z = _HEIGHT
        assumed.append(f"cameras {z:g} m above the ground (--camera-height)")
    R_SC = rotation_zyx(yaw, pitch, 0.0) @ R_BODY_CAMERA @ turned
    p_SC = np.array([x, y, z]) - R_SC @ np.array([0.5 * calibration.baseline, 0.0, 0.0])
    direction_std = _direction_std(options, rig, calibration, _ALIGNED, assumed)
    return Mounting(transform(R_SC, p_SC), follow_distance, rig.roll_axis_height, direction_std, tuple(assumed))


def _direction_std(
    options: MountingOptions, rig: Rig, calibration: StereoCalibration, mount: float, assumed: list[str]
) -> float:
    """Standard deviation [rad] of the camera's direction, with that of its ``mount``; what is assumed is listed."""
    if options.direction_std is not None:
        return options.direction_std
    by_calibration = rig.direction_std
    if by_calibration is None:
        by_calibration = _PRINCIPAL_POINT / calibration.focal_length
    std = math.hypot(by_calibration, mount)
    if std != rig.direction_std:
        assumed.append(f"direction of the cameras known to {math.degrees(std):.2g} deg (--direction-std)")
    return std


def facing_by_motion(
    calibration: StereoCalibration, frames: Iterable[StereoFrame], *, upside_down: bool = False
) -> Facing | None:
    """Facing direction of cameras on a vehicle that drives forward; None if it hardly moves.

    Cameras that move along their own z face to the front, against it to the rear. Cameras that face left move along
    their x, as the front is on the right in their images. In images of cameras that look down, the front is at the top.
    """
    frames = iter(frames)
    first = list(islice(frames, _QUICK))
    travel = _travel(calibration, first, min(1.0, _WIDTH / calibration.width))
    if travel is None:
        travel = _travel(calibration, chain(first, islice(frames, _LONGEST_WAIT)), 1.0)
    if travel is None:
        return None
    if upside_down:
        travel[:2] *= -1.0
    along = int(np.argmax(np.abs(travel)))
    return (("right", "left"), ("down", "down"), ("rear", "front"))[along][int(travel[along] > 0.0)]


def _travel(calibration: StereoCalibration, frames: Iterable[StereoFrame], scale: float) -> FloatArray | None:
    """Sum (3,) of the cameras' motions [m] once it is long enough, by scaled images; None before."""
    size = round(scale * calibration.width), round(scale * calibration.height)
    f, cx, cy = (scale * value for value in (calibration.focal_length, calibration.cx, calibration.cy))
    X_SC = transform(R_BODY_CAMERA, np.array([0.0, 0.0, _HEIGHT]))
    level = replace(calibration, width=size[0], height=size[1], focal_length=f, cx=cx, cy=cy, X_SC=X_SC)
    odometry = CircularOdometry(level)
    memory, travel = odometry.init(), np.zeros(3)
    for frame in frames:
        pair = (cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in (frame.left, frame.right))
        left, right = (np.asarray(image, dtype=np.uint8) for image in pair)
        memory, motion = odometry.step(memory, StereoFrame(tick=frame.tick, left=left, right=right))
        if motion is not None and motion.health is not Health.LOST:
            travel += motion.X_PC[:3, 3]
        if np.linalg.norm(travel) > _CLEAR_DISTANCE:
            return travel
    return None


class Photographs(NamedTuple):
    """Photographs of a board: pairs in the same order, or those of one camera on the left."""

    left: list[Path]
    right: list[Path]
    notes: tuple[str, ...] = ()


def photographs(given: Sequence[Path], right: Sequence[Path]) -> Photographs:
    """Photographs of one camera or of two.

    A folder stands for the images in it; one folder that contains ``left`` and ``right`` stands for the pairs in these.
    Images whose names say left and right, in one folder or list, are those of two cameras. Pairs are found by the
    numbers in the names.

    Raises:
        ValueError: one line, if a path does not exist, a folder contains no images, or there are no pairs.
    """
    if not right and len(given) == 1 and all((given[0] / side).is_dir() for side in ("left", "right")):
        given, right = [given[0] / "left"], [given[0] / "right"]
    one, other = _images(given), _images(right)
    if other:  # the shell gives the option only the first of several names
        kind = _kind(other[0])
        other += [path for path in one if _kind(path) == kind != _kind(one[0])]
        one = [path for path in one if path not in other]
    else:
        sides = [[path for path in one if _says(path, side)] for side in ("left", "right")]
        if not all(sides) or len(sides[0]) + len(sides[1]) != len(one):
            return Photographs(one, [])
        one, other = sides
    pairs = file_pairs(one, other)
    kept = sorted(pairs.left.keys() & pairs.right.keys())
    alone = [*(pairs.left[k] for k in pairs.left.keys() - kept), *(pairs.right[k] for k in pairs.right.keys() - kept)]
    notes = [f"no partner, not used: {', '.join(sorted(path.name for path in alone))}"] if alone else []
    return Photographs([pairs.left[k] for k in kept], [pairs.right[k] for k in kept], (*pairs.notes, *notes))


def _kind(path: Path) -> tuple[Path, str]:
    """Folder and name without its numbers."""
    return path.parent, re.sub(r"\d+", "#", path.name)


def _says(path: Path, side: str) -> bool:
    """True if the name of an image says that it is of the left or right camera: ``left12.jpg``, ``R_12.jpg``."""
    words = re.findall(r"[a-z]+", path.stem.lower())
    return any(side in word for word in words) or words[:1] == [side[0]]


def _images(given: Sequence[Path]) -> list[Path]:
    images: list[Path] = []
    for path in given:
        if path.is_dir():
            images += images_in(path)
        elif os.path.lexists(path):
            images.append(path)
        else:
            raise ValueError(f"{path}: no such file or folder")
    return images


def board_of(text: str, square: float) -> Checkerboard:
    """Board from a text such as 9x6: the inner corners along a row and along a column.

    Raises:
        ValueError: if the text has another form.
    """
    columns, _, rows = text.lower().partition("x")
    if not (columns.isdecimal() and rows.isdecimal()):
        raise ValueError(f"--board {text}: expected COLUMNSxROWS of inner corners, for example 9x6")
    return Checkerboard(columns=int(columns), rows=int(rows), square=square)


def views_of(paths: Sequence[Path], board: Checkerboard, progress: Progress) -> list[BoardView]:
    """Corners of the board in each image; a view is named after its image and the folder that contains it.

    Raises:
        ValueError: if an image can not be read.
    """
    views = []
    for done, path in enumerate(paths, start=1):
        views.append(board_view(f"{path.parent.name}/{path.name}", read_grey_upright(path), board))
        progress(done, len(paths), path.name)
    return views


def camera_text(calibration: CameraCalibration) -> str:
    """Parameters of one camera and their standard deviations, as TOML."""
    camera, std = calibration.camera, calibration.std.tolist()
    names = ("fx", "fy", "cx", "cy")
    table: dict[str, Any] = {
        "camera": {name: getattr(camera, name) for name in ("width", "height", *names)}
        | {"distortion": list(camera.distortion)},
        "standard_deviation": dict(zip(names, std[:4], strict=True)) | {"distortion": std[4:]},
    }
    units = (
        "# One camera. Lengths in pixels; the centre of the first pixel is (0, 0). distortion: k1, k2, p1, p2, k3.\n"
    )
    return units + tomli_w.dumps(table)


def coverage_picture(cameras: dict[str, CameraCalibration], path: Path) -> None:
    """Draw the corners of all boards in the image plane, coloured by their error, for each camera."""
    from matplotlib.figure import Figure

    model = next(iter(cameras.values())).camera
    figure = Figure(figsize=(7.0 * len(cameras), 1.2 + 5.0 * model.height / model.width), layout="constrained")
    for ax, (name, calibration) in zip(np.atleast_1d(figure.subplots(1, len(cameras))), cameras.items(), strict=True):
        camera, errors = calibration.camera, np.array(list(calibration.errors.values()))
        each = np.repeat(errors, len(calibration.corners) // len(errors))
        shown = ax.scatter(*calibration.corners.T, c=each, s=6.0, cmap="viridis", vmin=0.0)
        ax.plot(camera.cx, camera.cy, "+", color="crimson", markersize=12)
        ax.set(xlim=(0, camera.width), ylim=(camera.height, 0), aspect="equal", xlabel="u [px]", ylabel="v [px]")
        ax.set_title(
            f"{name}: {len(errors)} images, {calibration.rms:.3f} px RMS, {100 * calibration.coverage:.0f} % covered"
        )
        figure.colorbar(shown, ax=ax, label="RMS error of the image [px]")
    figure.savefig(path, dpi=110)
