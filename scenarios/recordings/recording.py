"""A recording opened: its frames, their calibration, where the cameras sit, and true poses if there are any."""

from __future__ import annotations

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
    """Whatever makes a rectified pair of a raw one, such as ``estimators.calibration.rectification.Rectifier``."""

    @property
    def calibration(self) -> StereoCalibration:
        """Of the rectified pair."""
        ...

    def step(self, frame: StereoFrame) -> StereoFrame:
        """The rectified pair."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recording:
    """A stereo sequence with all that is known about it."""

    sequence: StereoSequence
    size: tuple[int, int]  # of all images [px]
    calibration: StereoCalibration  # of the rectified pair
    rectification: Rectification | None  # None: the images are rectified
    follow_distance: float  # hitch to follow point [m]
    poses: FloatArray | None  # (n, 4, 4) true poses of the left camera from the first frame
    notes: tuple[str, ...]  # what is odd about the recording
    assumed: tuple[str, ...]  # what nobody has said

    def rectified(self, frame: StereoFrame) -> StereoFrame:
        """The frame as the calibration describes it."""
        return self.rectification.step(frame) if self.rectification else frame

    def rectified_left(self, image: GreyImage) -> GreyImage:
        """A left image alone as the calibration describes it."""
        return self.rectified(StereoFrame(tick=0, left=image, right=image)).left


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Cameras:
    """What the calibration files of a recording say."""

    calibration: StereoCalibration  # of the rectified pair; its X_SC is not the last word
    rectification: Rectification | None
    rig: Rig
    X_CP: FloatArray  # (4, 4) pose, in the rectified left camera, of the camera that ``poses.txt`` speaks of


def open_recording(
    directory: Path,
    *,
    calibration_file: Path | None = None,
    rate_hz: float | None = None,
    options: MountingOptions | None = None,
) -> Recording:
    """The recording in a folder, complete but for the images themselves.

    Args:
        directory: with two folders of images, ``times.txt`` and ``calib.txt``; ``rig.toml`` says where the cameras
            sit, and can take the place of ``calib.txt`` for raw images; ``poses.txt`` holds true poses.
        calibration_file: goes before what is in the folder; a TOML file describes raw images.
        rate_hz: takes the place of ``times.txt``.
        options: go before ``rig.toml``.

    Raises:
        ValueError: one line naming the file that is wrong, and what to do.
    """
    sequence = find_sequence(directory, rate_hz)
    size = image_size(sequence)
    cameras = _cameras(sequence, size, calibration_file)
    calibration = cameras.calibration
    placed = mounting(
        options or MountingOptions(),
        cameras.rig,
        calibration.baseline,
        lambda: facing_by_motion(calibration, _rectified(sequence, size, cameras.rectification)),
    )
    return Recording(
        sequence=sequence,
        size=size,
        calibration=replace(calibration, X_SC=placed.X_SC),
        rectification=cameras.rectification,
        follow_distance=placed.follow_distance,
        poses=_poses(sequence, cameras.X_CP),
        notes=sequence.notes,
        assumed=placed.assumed,
    )


def _cameras(sequence: StereoSequence, size: tuple[int, int], file: Path | None) -> _Cameras:
    """What the files say: that of the option, ``rig.toml`` of raw cameras, or ``calib.txt`` and ``rig.toml``."""
    beside = sequence.directory / "rig.toml"
    rig = read_rig(beside) if beside.exists() else Rig()
    if file is None and rig.raw:
        file = beside
    if file is not None and file.suffix == ".toml":
        given = read_rig(file)
        rig = Rig(
            X_SC=rig.X_SC if given.X_SC is None else given.X_SC,
            follow_distance=given.follow_distance or rig.follow_distance,
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
    """True poses X_C0C of the frames, from a file with those of a camera P at X_CP on the same rig."""
    benchmark = sequence.directory.resolve().parent.parent / "poses" / f"{sequence.directory.resolve().name}.txt"
    path = next((p for p in (sequence.directory / "poses.txt", benchmark) if p.is_file()), None)
    if path is None:
        return None
    listed = read_kitti_poses(path, sequence.lines)
    X_WC = listed[[files.line for files in sequence.frames]] @ inverse(X_CP)
    poses: FloatArray = inverse(X_WC[0]) @ X_WC
    return poses
