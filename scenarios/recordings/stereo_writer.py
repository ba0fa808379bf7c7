"""Writer of a stereo recording, in the layout of the KITTI odometry benchmark.

``image_0`` and ``image_1`` hold the left and right grey images, ``calib.txt`` the projection matrices, ``times.txt``
the capture times, ``poses.txt`` the true pose of the left camera relative to the first frame. ``rig.toml`` adds the
camera's pose on the trailer and the trailer's follow point. KITTI's projections can not describe raw images: for these
``rig.toml`` contains the whole calibration, and there is no ``calib.txt``.
"""

from __future__ import annotations

from pathlib import Path
from types import TracebackType

import numpy as np

from scenarios.recordings.png import write_png
from scenarios.results.run_directory import check_run_directory
from sensors.camera.lens import RawStereoRig
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from vehicle.clock import TICK
from vehicle.frames import FloatArray, inverse


class RecordingWriter:
    """Writes frames into ``<directory>.recording``, which is renamed to ``directory`` at the end.

    Used as a context manager. Every frame is complete on disk before the next one: the part that an interrupted run
    leaves under the working name can be used. Not frozen, as it represents growing files.

    Raises:
        ValueError: if the directory exists and is not empty.
    """

    def __init__(self, directory: Path, calibration: StereoCalibration | RawStereoRig, follow_distance: float) -> None:
        check_run_directory(directory)
        self._directory = directory.resolve()
        self._unfinished = self._directory.with_name(f"{directory.resolve().name}.recording")
        check_run_directory(self._unfinished)
        self._X_SC = calibration.X_SC
        self._X_C0W: FloatArray | None = None  # inverse of the first camera pose
        self._count = 0
        for side in (0, 1):
            (self._unfinished / f"image_{side}").mkdir(parents=True)
        if isinstance(calibration, StereoCalibration):
            (self._unfinished / "calib.txt").write_text(calibration_text(calibration), encoding="utf-8")
        (self._unfinished / "rig.toml").write_text(rig_text(calibration, follow_distance), encoding="utf-8")

    def add(self, frame: StereoFrame, X_WB: FloatArray) -> None:
        """Append a stereo pair and the true pose (4, 4) of the trailer body at its capture."""
        X_WC = X_WB @ self._X_SC
        if self._X_C0W is None:
            self._X_C0W = inverse(X_WC)
        for side, image in enumerate((frame.left, frame.right)):
            write_png(self._unfinished / f"image_{side}" / f"{self._count:06d}.png", image)
        self._append("times.txt", f"{frame.tick * TICK:.3f}")
        self._append("poses.txt", _numbers((self._X_C0W @ X_WC)[:3]))
        self._count += 1

    def _append(self, name: str, line: str) -> None:
        with (self._unfinished / name).open("a", encoding="utf-8") as file:
            file.write(line + "\n")

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Rename the recording to its final name; after an error it stays under the working name."""
        if kind is None:
            self._unfinished.rename(self._directory)


def calibration_text(calibration: StereoCalibration) -> str:
    """Projection matrices P0 and P1, 3x4 row by row, as in KITTI's calib.txt."""
    c = calibration
    P0 = np.array([[c.focal_length, 0.0, c.cx, 0.0], [0.0, c.focal_length, c.cy, 0.0], [0.0, 0.0, 1.0, 0.0]])
    P1 = P0.copy()
    P1[0, 3] = -c.focal_length * c.baseline
    return f"P0: {_numbers(P0)}\nP1: {_numbers(P1)}\n"


def rig_text(calibration: StereoCalibration | RawStereoRig, follow_distance: float) -> str:
    """The rig as TOML, numbers exact to the last bit."""
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
