"""Pose of a recording's cameras on the trailer: from its ``rig.toml``, from options, or assumed and reported."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, cast, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator

from estimators.estimates import Health
from estimators.odometry.circular import CircularOdometry
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from vehicle.foundation.quantity import checked
from vehicle.foundation.user_file import FileKind, nearest, read_toml, without_sources
from vehicle.frames import R_BODY_CAMERA, FloatArray, is_rotation, rotation_zyx, transform

Facing = Literal["rear", "left", "right", "front", "down"]


class _AssumedPose(NamedTuple):
    """Assumed pose of cameras that face in one direction."""

    yaw: float  # [rad]
    pitch: float  # [rad]
    share: float  # distance from the hitch back to the cameras over the follow distance [-]
    words: str


_ASSUMED_POSES: Final[dict[Facing, _AssumedPose]] = {
    "rear": _AssumedPose(math.pi, 0.0, 1.0, "to the rear"),
    "left": _AssumedPose(0.5 * math.pi, 0.0, 0.5, "to the left"),
    "right": _AssumedPose(-0.5 * math.pi, 0.0, 0.5, "to the right"),
    "front": _AssumedPose(0.0, 0.0, 0.0, "to the front"),
    "down": _AssumedPose(0.0, 0.5 * math.pi, 0.5, "down"),
}
_FOLLOW_DISTANCE = 14.0  # default: de Saxe 2018, section 3.1 [m]
_HEIGHT = 3.0  # default: the same section [m]
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
        X = np.array(rows)
        if X.shape != (4, 4) or not is_rotation(X[:3, :3], 1e-6):
            raise ValueError("must be a pose: 4 rows of 4 numbers, the upper left 3x3 a rotation")
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
    for facing in get_args(Facing):
        if name == facing:
            return cast(Facing, facing)
    raise ValueError(f"--facing = {name}: unknown{nearest(name, get_args(Facing))}")


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
    if rig.X_SC is not None and placed == (None,) * len(placed):
        direction_std = _direction_std(options, rig, calibration, 0.0, assumed)
        return Mounting(rig.X_SC, follow_distance, rig.roll_axis_height, direction_std, tuple(assumed))
    direction = options.facing
    if direction is None:
        direction = facing() or "rear"
        assumed.append(f"cameras face {_ASSUMED_POSES[direction].words}, found from their motion (--facing)")
    pose = _ASSUMED_POSES[direction]
    x, y, z = options.x, options.y or 0.0, options.z
    if x is None:
        x = -pose.share * follow_distance
        assumed.append(f"cameras {-x:g} m behind the hitch (--camera-x)")
    if z is None:
        z = _HEIGHT
        assumed.append(f"cameras {z:g} m above the ground (--camera-height)")
    R_SC = rotation_zyx(pose.yaw, pose.pitch, 0.0) @ R_BODY_CAMERA
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


def facing_by_motion(calibration: StereoCalibration, frames: Iterable[StereoFrame]) -> Facing | None:
    """Facing direction of cameras on a vehicle that drives forward; None if it hardly moves.

    Cameras that move along their own z face to the front, against it to the rear. Cameras that face left move along
    their x, as the front is on the right in their images. In images of cameras that look down, the front is at the top.
    """
    level = replace(calibration, X_SC=transform(R_BODY_CAMERA, np.array([0.0, 0.0, _HEIGHT])))
    odometry = CircularOdometry(level)
    memory, travel = odometry.init(), np.zeros(3)
    for frame in islice(frames, _LONGEST_WAIT):
        memory, motion = odometry.step(memory, frame)
        if motion is not None and motion.health is not Health.LOST:
            travel += motion.X_PC[:3, 3]
        if np.linalg.norm(travel) > _CLEAR_DISTANCE:
            break
    else:
        return None
    along = int(np.argmax(np.abs(travel)))
    return (("right", "left"), ("down", "down"), ("rear", "front"))[along][int(travel[along] > 0.0)]
