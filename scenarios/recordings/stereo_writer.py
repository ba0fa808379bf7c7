"""Writer of a stereo recording, in the layout of the KITTI odometry benchmark.

``image_0`` and ``image_1`` hold the left and right grey images, ``calib.txt`` the projection matrices, ``times.txt``
the capture times, ``poses.txt`` the true pose of the left camera relative to the first frame. ``rig.toml`` adds the
camera's pose on the trailer and the trailer's follow point. KITTI's projections can not describe raw images: for these
``rig.toml`` contains the whole calibration, and there is no ``calib.txt``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scenarios.recordings.png import write_png
from scenarios.recordings.recording_folder import RecordingFolder
from sensors.camera.lens import RawStereoRig
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from vehicle.clock import TICK
from vehicle.frames import FloatArray, inverse


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
