"""Recorded stereo images on disk, in the layout of the KITTI odometry benchmark.

``image_0`` and ``image_1`` hold the left and right grey images, ``calib.txt`` the projection matrices, ``times.txt``
the capture times, ``poses.txt`` the true pose of the left camera relative to the first frame; ``rig.toml`` adds what
KITTI has no place for: how the camera sits on the trailer, and where the trailer's follow point is. Of raw images,
which KITTI's projections can not describe, ``rig.toml`` holds the whole calibration in the place of ``calib.txt``.
"""

from __future__ import annotations

from pathlib import Path
from types import TracebackType

import cv2
import numpy as np

from scenarios.results.run import check_run_directory
from sensors.camera.lens import RawStereoRig
from sensors.camera.rig import StereoCalibration
from sensors.messages import GreyImage, StereoFrame
from vehicle.clock import TICK
from vehicle.frames import FloatArray, inverse

_FAST_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]  # noise compresses no better at 9, only ten times more slowly


class RecordingWriter:
    """Writes frames as they come into ``<directory>.recording``, which takes its name when all went well.

    Used as a context manager. Every frame is complete on disk before the next one, so what an interrupted run leaves
    under the working name can be used as it is. Not frozen, as it stands for files that grow.

    Raises:
        ValueError: if the directory exists and holds something.
    """

    def __init__(self, directory: Path, calibration: StereoCalibration | RawStereoRig, follow_distance: float) -> None:
        check_run_directory(directory)
        self._directory = directory.resolve()
        self._growing = self._directory.with_name(f"{directory.resolve().name}.recording")
        check_run_directory(self._growing)
        self._X_SC = calibration.X_SC
        self._X_C0W: FloatArray | None = None  # inverse of the first camera pose
        self._count = 0
        for side in (0, 1):
            (self._growing / f"image_{side}").mkdir(parents=True)
        if isinstance(calibration, StereoCalibration):
            (self._growing / "calib.txt").write_text(calibration_text(calibration), encoding="utf-8")
        (self._growing / "rig.toml").write_text(rig_text(calibration, follow_distance), encoding="utf-8")

    def add(self, frame: StereoFrame, X_WB: FloatArray) -> None:
        """Appends a stereo pair and the true pose (4, 4) of the trailer body at its capture."""
        X_WC = X_WB @ self._X_SC
        if self._X_C0W is None:
            self._X_C0W = inverse(X_WC)
        for side, image in enumerate((frame.left, frame.right)):
            _write_image(self._growing / f"image_{side}" / f"{self._count:06d}.png", image)
        self._append("times.txt", f"{frame.tick * TICK:.3f}")
        self._append("poses.txt", _numbers((self._X_C0W @ X_WC)[:3]))
        self._count += 1

    def _append(self, name: str, line: str) -> None:
        with (self._growing / name).open("a", encoding="utf-8") as file:
            file.write(line + "\n")

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Gives the recording its final name, unless an error ended it: then it stays under the working name."""
        if kind is None:
            self._growing.rename(self._directory)


def calibration_text(calibration: StereoCalibration) -> str:
    """The projection matrices P0 and P1, 3x4 row by row, as in KITTI's calib.txt."""
    c = calibration
    P0 = np.array([[c.focal_length, 0.0, c.cx, 0.0], [0.0, c.focal_length, c.cy, 0.0], [0.0, 0.0, 1.0, 0.0]])
    P1 = P0.copy()
    P1[0, 3] = -c.focal_length * c.baseline
    return f"P0: {_numbers(P0)}\nP1: {_numbers(P1)}\n"


def rig_text(calibration: StereoCalibration | RawStereoRig, follow_distance: float) -> str:
    """The rig as TOML, numbers to the last bit."""
    if isinstance(calibration, RawStereoRig):
        return f"follow_distance = {follow_distance!r}  # hitch to follow point [m]\n{calibration.to_toml()}"
    rows = ",\n".join(f"  [{', '.join(repr(float(value)) for value in row)}]" for row in calibration.X_SC)
    return (
        f"baseline = {calibration.baseline!r}  # [m]\n"
        f"follow_distance = {follow_distance!r}  # hitch to follow point [m]\n"
        f"# pose of the left camera (x right, y down, z ahead) in the trailer (origin: hitch on the ground) [m]\n"
        f"X_SC = [\n{rows},\n]\n"
    )


def _numbers(matrix: FloatArray) -> str:
    return " ".join(f"{value:.12e}" for value in matrix.ravel())


def _write_image(path: Path, image: GreyImage) -> None:
    if not cv2.imwrite(str(path), image, _FAST_PNG):
        raise OSError(f"could not write {path}: is the disk full?")
