"""Reader of a stereo recording: frames, calibration, pose of the cameras on the trailer, and true poses if known."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from estimators.calibration.rectification import Rectifier
from scenarios.recordings.images import Dropped, image_size, stream
from scenarios.recordings.mounting import MountingOptions, Rig, facing_by_motion, mounting, read_rig
from scenarios.recordings.projections import read_projections
from scenarios.recordings.sequence import Layout, StereoSequence, find_sequence
from scenarios.recordings.trajectory import read_kitti_poses
from sensors.camera.lens import load_raw_rig
from sensors.camera.rig import StereoCalibration
from sensors.messages import GreyImage, StereoFrame
from vehicle.frames import FloatArray, inverse


class Rectification(Protocol):
    """Rectifies raw pairs, such as ``estimators.calibration.rectification.Rectifier``."""

    @property
    def calibration(self) -> StereoCalibration:
        """Calibration of the rectified pair."""
        ...

    def step(self, frame: StereoFrame) -> StereoFrame:
        """Rectify a pair."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recording:
    """A stereo sequence with its calibration and mounting."""

    sequence: StereoSequence
    size: tuple[int, int]  # of all images [px]
    calibration: StereoCalibration  # of the rectified pair
    rectification: Rectification | None  # None: the images are rectified already
    follow_distance: float  # hitch to follow point [m]
    roll_axis_height: float  # of the axis about which the trailer's body rolls [m]
    direction_std: float  # 1 sigma of the left camera's direction in the trailer [rad]
    poses: FloatArray | None  # (n, 4, 4) true poses of the left camera relative to the first frame
    notes: tuple[str, ...]  # on irregularities of the recording
    assumed: tuple[str, ...]  # assumptions on the mounting in words

    def rectified(self, frame: StereoFrame) -> StereoFrame:
        """Rectified frame, as the calibration describes it."""
        return self.rectification.step(frame) if self.rectification else frame

    def rectified_left(self, image: GreyImage) -> GreyImage:
        """Rectified left image."""
        return self.rectified(StereoFrame(tick=0, left=image, right=image)).left


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Cameras:
    """Contents of a recording's calibration files."""

    calibration: StereoCalibration  # of the rectified pair; its X_SC is replaced by the mounting
    rectification: Rectification | None
    rig: Rig
    X_CP: FloatArray  # (4, 4) pose in the rectified left camera of the camera whose poses are in ``poses.txt``


def open_recording(
    directory: Path,
    *,
    calibration_file: Path | None = None,
    rate_hz: float | None = None,
    options: MountingOptions | None = None,
) -> Recording:
    """Open the recording in a folder, without reading the images.

    Args:
        directory: contains two folders of images, ``times.txt`` and ``calib.txt``. ``rig.toml`` has the pose of the
            cameras and, for raw images, their calibration in place of ``calib.txt``; ``poses.txt`` has true poses.
        calibration_file: overrides the calibration in the folder; a TOML file describes raw images.
        rate_hz: replaces ``times.txt``.
        options: override ``rig.toml``.

    Raises:
        ValueError: one line naming the wrong file and the remedy.
    """
    sequence = find_sequence(directory, rate_hz)
    size = image_size(sequence)
    cameras = _cameras(sequence, size, calibration_file)
    calibration = cameras.calibration
    mounted = mounting(
        options or MountingOptions(),
        cameras.rig,
        calibration,
        lambda: facing_by_motion(calibration, _rectified(sequence, size, cameras.rectification)),
    )
    return Recording(
        sequence=sequence,
        size=size,
        calibration=replace(calibration, X_SC=mounted.X_SC),
        rectification=cameras.rectification,
        follow_distance=mounted.follow_distance,
        roll_axis_height=mounted.roll_axis_height,
        direction_std=mounted.direction_std,
        poses=_poses(sequence, cameras.X_CP),
        notes=sequence.notes,
        assumed=mounted.assumed,
    )


def _cameras(sequence: StereoSequence, size: tuple[int, int], file: Path | None) -> _Cameras:
    """Cameras from the option's file, from the ``rig.toml`` of raw images, or from ``calib.txt`` and ``rig.toml``."""
    own_rig = sequence.directory / "rig.toml"
    rig = read_rig(own_rig) if os.path.lexists(own_rig) else Rig()
    if file is None and rig.raw:
        file = own_rig
    if file is not None and file.suffix == ".toml":
        given = read_rig(file)
        rig = Rig(
            X_SC=rig.X_SC if given.X_SC is None else given.X_SC,
            follow_distance=given.follow_distance or rig.follow_distance,
            roll_axis_height=given.roll_axis_height or rig.roll_axis_height,
            direction_std=rig.direction_std if given.direction_std is None else given.direction_std,
        )
        return _raw_cameras(file, size, rig)
    return _rectified_cameras(file or sequence.directory / "calib.txt", sequence.layout, size, rig)


def _raw_cameras(path: Path, size: tuple[int, int], rig: Rig) -> _Cameras:
    raw = load_raw_rig(path)
    for side, camera in (("left", raw.left), ("right", raw.right)):
        if (camera.width, camera.height) != size:
            raise ValueError(
                f"{path}: the {side} camera has {camera.width}x{camera.height} px, the images {size[0]}x{size[1]}: "
                "is it the calibration of these images?"
            )
    if rig.X_SC is not None:
        raw = replace(raw, X_SC=rig.X_SC)
    rectifier = Rectifier(raw)
    X_SC = rectifier.calibration.X_SC
    return _Cameras(
        calibration=rectifier.calibration,
        rectification=rectifier,
        rig=replace(rig, X_SC=None if rig.X_SC is None else X_SC),
        X_CP=inverse(X_SC) @ raw.X_SC,
    )


def _rectified_cameras(path: Path, layout: Layout, size: tuple[int, int], rig: Rig) -> _Cameras:
    projections = read_projections(path, layout)
    for name, value, extent in (("column", projections.cx, size[0]), ("row", projections.cy, size[1])):
        if not 0.0 <= value <= extent - 1:
            raise ValueError(
                f"{path}: principal point at {name} {value:g} lies outside images of {size[0]}x{size[1]} px: "
                "is it the calibration of these images?"
            )
    calibration = StereoCalibration(
        width=size[0],
        height=size[1],
        focal_length=projections.focal_length,
        cx=projections.cx,
        cy=projections.cy,
        baseline=projections.baseline,
        X_SC=np.eye(4),
    )
    return _Cameras(calibration=calibration, rectification=None, rig=rig, X_CP=inverse(projections.X_C0C))


def _rectified(
    sequence: StereoSequence, size: tuple[int, int], rectification: Rectification | None
) -> Iterator[StereoFrame]:
    for _, frame in stream(sequence.frames, size):
        if not isinstance(frame, Dropped):
            yield rectification.step(frame) if rectification else frame


def _poses(sequence: StereoSequence, X_CP: FloatArray) -> FloatArray | None:
    """True poses X_C0C of the frames, from a file with the poses of a camera P at X_CP on the same rig."""
    benchmark = sequence.directory.resolve().parent.parent / "poses" / f"{sequence.directory.resolve().name}.txt"
    path = next((p for p in (sequence.directory / "poses.txt", benchmark) if os.path.lexists(p)), None)
    if path is None:
        return None
    X_WP = read_kitti_poses(path, sequence.lines)
    X_WC = X_WP[[files.line for files in sequence.frames]] @ inverse(X_CP)
    poses: FloatArray = inverse(X_WC[0]) @ X_WC
    return poses
