"""Writers of stereo and rover recordings.

``image_0`` and ``image_1`` hold the left and right grey images, ``calib.txt`` the projection matrices, ``times.txt``
the capture times, ``poses.txt`` the true pose of the left camera relative to the first frame. ``rig.toml`` adds the
camera's pose on the trailer and the trailer's follow point. KITTI's projections can not describe raw images: for these
``rig.toml`` contains the whole calibration, and there is no ``calib.txt``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, Self

import cv2
import numpy as np

from offtrack.exchange.recordings.rover_recording import (
    IMAGES,
    READINGS,
    RIG,
    SLIP,
    SLIP_COLUMNS,
    columns,
    header,
    rig_toml,
)
from scenarios.results.run_directory import appearing_at_once, mark_interrupted
from sensors.camera.rig import RawStereoRig, StereoCalibration
from sensors.messages import GreyImage, RoverView, StereoFrame
from sensors.sand.trace_rig import TraceRig
from vehicle.clock import TICK
from vehicle.frames import FloatArray, inverse
from vehicle.rover.truth import RoverTruth

if TYPE_CHECKING:
    from scenarios.assembly.rover_run import RoverAssembly
    from scenarios.assembly.trailer_run import Assembly


class RecordingFolder:
    """Folder of a recording, which appears at the end of the block, or not at all after an error.

    Raises:
        ValueError: when the block is entered, if the directory can not be made or contains other files.
    """

    def __init__(self, directory: Path) -> None:
        self._appearing = appearing_at_once(directory)

    def __enter__(self) -> Self:
        self._folder = self._appearing.__enter__()
        self._begin()
        return self

    def _begin(self) -> None:
        """Write what does not change during the recording."""

    def end(self, *, interrupted: bool) -> None:
        """End the recording; the recording of an interrupted run may be replaced."""
        if interrupted:
            mark_interrupted(self._folder)

    def note(self, name: str, line: str) -> None:
        """Write a file of one line besides those of the recording."""
        self._append(name, line)

    def _append(self, name: str, line: str) -> None:
        with (self._folder / name).open("a", encoding="utf-8") as file:
            file.write(line + "\n")

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._appearing.__exit__(kind, error, trace)


_FAST_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]  # noise compresses no better at 9, only ten times more slowly


def write_png(path: Path, image: GreyImage) -> None:
    """Write a grey image.

    Raises:
        OSError: if it could not be written.
    """
    if not cv2.imwrite(str(path), image, _FAST_PNG):
        raise OSError(f"could not write {path}: is the disk full?")


class RecordingWriter(RecordingFolder):
    """Writes a recording frame by frame."""

    def __init__(
        self,
        directory: Path,
        calibration: StereoCalibration | RawStereoRig,
        follow_distance: float,
        roll_axis_height: float = 0.0,
    ) -> None:
        super().__init__(directory)
        self._calibration, self._distances = calibration, (follow_distance, roll_axis_height)
        self._X_C0W: FloatArray | None = None  # inverse of the first camera pose
        self._count = 0

    def _begin(self) -> None:
        for side in (0, 1):
            (self._folder / f"image_{side}").mkdir()
        if isinstance(self._calibration, StereoCalibration):
            (self._folder / "calib.txt").write_text(calibration_text(self._calibration), encoding="utf-8")
        rig = rig_text(self._calibration, *self._distances)
        (self._folder / "rig.toml").write_text(rig, encoding="utf-8")

    def add(self, frame: StereoFrame, X_WB: FloatArray) -> None:
        """Append a stereo pair and the true pose (4, 4) of the trailer body at its capture."""
        X_WC = X_WB @ self._calibration.X_SC
        if self._X_C0W is None:
            self._X_C0W = inverse(X_WC)
        for side, image in enumerate((frame.left, frame.right)):
            write_png(self._folder / f"image_{side}" / f"{self._count:06d}.png", image)
        self._append("times.txt", f"{frame.tick * TICK:.3f}")
        self._append("poses.txt", _numbers((self._X_C0W @ X_WC)[:3]))
        self._count += 1


def calibration_text(calibration: StereoCalibration) -> str:
    """Projection matrices P0 and P1, 3x4 row by row, as in KITTI's calib.txt."""
    c = calibration
    P0 = np.array([[c.focal_length, 0.0, c.cx, 0.0], [0.0, c.focal_length, c.cy, 0.0], [0.0, 0.0, 1.0, 0.0]])
    P1 = P0.copy()
    P1[0, 3] = -c.focal_length * c.baseline
    return f"P0: {_numbers(P0)}\nP1: {_numbers(P1)}\n"


def rig_text(
    calibration: StereoCalibration | RawStereoRig, follow_distance: float, roll_axis_height: float = 0.0
) -> str:
    """The rig as TOML, numbers exact to the last bit."""
    trailer = (
        f"follow_distance = {follow_distance!r}  # hitch to follow point [m]\n"
        f"roll_axis_height = {roll_axis_height!r}  # of the axis about which the trailer's body rolls [m]\n"
        "direction_std_deg = 0.0  # 1 sigma of the camera's direction in the trailer; 0: exact [deg]\n"
    )
    if isinstance(calibration, RawStereoRig):
        return f"{trailer}{calibration.to_toml()}"
    rows = ",\n".join(f"  [{', '.join(repr(float(value)) for value in row)}]" for row in calibration.X_SC)
    return (
        f"baseline = {calibration.baseline!r}  # [m]\n"
        f"{trailer}"
        f"# pose of the left camera (x right, y down, z ahead) in the trailer (origin: hitch on the ground) [m]\n"
        f"X_SC = [\n{rows},\n]\n"
    )


def _numbers(matrix: FloatArray) -> str:
    return " ".join(f"{value:.12e}" for value in matrix.ravel())


class RoverRecordingWriter(RecordingFolder):
    """Writes a recording view by view."""

    def __init__(self, directory: Path, rig: TraceRig) -> None:
        super().__init__(directory)
        self._rig, self._count = rig, 0

    def _begin(self) -> None:
        (self._folder / IMAGES).mkdir()
        (self._folder / RIG).write_text(rig_toml(self._rig), encoding="utf-8")
        (self._folder / READINGS).write_text(header(columns(self._rig)), encoding="utf-8")
        (self._folder / SLIP).write_text(header(SLIP_COLUMNS), encoding="utf-8")

    def add(self, view: RoverView, truth: RoverTruth) -> None:
        """Append a view and the true slip angle at its capture."""
        time = f"{view.tick * TICK:.3f}"
        steer = np.degrees(view.steer)
        numbers = [math.degrees(view.heading), *view.wheel_speeds.tolist(), *steer.tolist()]
        write_png(self._folder / IMAGES / f"{self._count:06d}.png", view.image)
        self._append(READINGS, ",".join([time, *(f"{number:.9g}" for number in numbers)]))
        self._append(SLIP, f"{time},{math.degrees(truth.slip_angle):.9g}")
        self._count += 1


def _of_trailer(directory: Path, parts: Assembly) -> RecordingWriter:
    if parts.cameras is None:
        raise ValueError("there is no camera to record")
    last = parts.trailers[-1]
    return RecordingWriter(directory, parts.cameras.calibrated, last.geometry.follow_distance, last.path_height)


def _of_rover(directory: Path, parts: RoverAssembly) -> RoverRecordingWriter:
    return RoverRecordingWriter(directory, parts.rig)


_WRITERS: Final[dict[str, Callable[[Path, Any], RecordingFolder]]] = {"trailer": _of_trailer, "rover": _of_rover}


def recording_in(directory: Path) -> Callable[[Any], Any]:
    """What opens the recording of a run in a directory: call it with the assembled parts.

    Raises:
        ValueError: when it is called, one line, if the parts have no camera.
    """
    return lambda parts: _WRITERS[parts.scenario.vehicle_kind](directory, parts)
