"""Recordings can be read by anyone who reads KITTI, and survive an interruption."""

from __future__ import annotations

import math
import subprocess
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest

from offtrack.exchange.recordings.writers import RecordingWriter
from sensors.camera.rig import CameraModel, RawStereoRig, StereoCalibration, StereoRig, load_raw_rig
from sensors.messages import StereoFrame
from vehicle.frames import FloatArray, inverse, rotation_zyx, transform

RIG = StereoRig(facing="rear", width=64, height=32, hfov=math.radians(100), x=-12.0, y=0.0, z=3.0, baseline=0.5)
CALIBRATION = RIG.calibration()


def frame(k: int) -> StereoFrame:
    rng = np.random.default_rng(k)
    left, right = rng.integers(0, 256, (2, 32, 64), dtype=np.uint8)
    return StereoFrame(tick=100 * k + 50, left=left, right=right)


def pose(k: int) -> FloatArray:
    return transform(rotation_zyx(0.3 * k, 0.01, -0.02 * k), np.array([5.0 + k, 2.0, 0.1]))


def record(directory: Path, frames: int, rig: StereoCalibration | RawStereoRig = CALIBRATION) -> None:
    with RecordingWriter(directory, rig, 11.9) as recording:
        for k in range(frames):
            recording.add(frame(k), pose(k))


def test_a_recording_is_read_by_anyone_who_reads_kitti(tmp_path: Path) -> None:
    """PNG loses nothing; times are in seconds, to the tick; poses are X_C0Ck = X_SC^-1 X_WS0^-1 X_WSk X_SC.

    A point 10 m ahead on the axis projects to the principal point on the left, f b / Z further left on the right. KITTI
    has no place for the rig, which is exact.
    """
    record(tmp_path / "a", 4)
    for k in range(4):
        for side, image in ((0, frame(k).left), (1, frame(k).right)):
            back = cv2.imread(str(tmp_path / "a" / f"image_{side}" / f"{k:06d}.png"), cv2.IMREAD_UNCHANGED)
            np.testing.assert_array_equal(back, image)
    assert (tmp_path / "a" / "times.txt").read_text().split() == ["0.050", "0.150", "0.250", "0.350"]
    poses = np.loadtxt(tmp_path / "a" / "poses.txt").reshape(-1, 3, 4)
    np.testing.assert_allclose(poses[0], np.eye(4)[:3], atol=1e-11)  # twelve digits are written
    expected = inverse(CALIBRATION.X_SC) @ inverse(pose(0)) @ pose(3) @ CALIBRATION.X_SC
    np.testing.assert_allclose(poses[3], expected[:3], atol=1e-10)
    lines = (tmp_path / "a" / "calib.txt").read_text().splitlines()
    assert [line[:3] for line in lines] == ["P0:", "P1:"]
    P0, P1 = (np.array(line[3:].split(), dtype=float).reshape(3, 4) for line in lines)
    left, right = (P @ [0.0, 0.0, 10.0, 1.0] / 10.0 for P in (P0, P1))
    assert left[:2] == pytest.approx([31.5, 15.5])
    assert left[0] - right[0] == pytest.approx(CALIBRATION.focal_length * 0.5 / 10.0)
    rig = tomllib.loads((tmp_path / "a" / "rig.toml").read_text(encoding="utf-8"))
    np.testing.assert_array_equal(np.array(rig["X_SC"]), CALIBRATION.X_SC)
    assert (rig["baseline"], rig["follow_distance"]) == (0.5, 11.9)


def test_a_raw_rig_is_written_whole_and_in_the_place_of_projections(tmp_path: Path) -> None:
    """KITTI's calib.txt has no place for lenses; whoever finds one takes the images for rectified."""
    camera = CameraModel(width=64, height=32, fx=40.0, fy=40.1, cx=31.0, cy=15.0, distortion=(-0.1, 0.02, 1e-3, 0, 0))
    X_ClCr = transform(rotation_zyx(0.01, 0.02, 0.0), np.array([0.5, 0.01, 0.0]))
    raw = RawStereoRig(left=camera, right=camera, X_ClCr=X_ClCr, X_SC=RIG.calibration().X_SC)
    record(tmp_path / "a", 2, raw)
    assert not (tmp_path / "a" / "calib.txt").exists()
    back = load_raw_rig(tmp_path / "a" / "rig.toml")
    assert (back.left, back.right) == (camera, camera)
    np.testing.assert_array_equal(back.X_ClCr, raw.X_ClCr)
    np.testing.assert_array_equal(back.X_SC, raw.X_SC)
    assert tomllib.loads((tmp_path / "a" / "rig.toml").read_text(encoding="utf-8"))["follow_distance"] == 11.9
    poses = np.loadtxt(tmp_path / "a" / "poses.txt").reshape(-1, 3, 4)
    expected = inverse(raw.X_SC) @ inverse(pose(0)) @ pose(1) @ raw.X_SC  # of the raw left camera
    np.testing.assert_allclose(poses[1], expected[:3], atol=1e-10)


def test_an_interrupted_recording_is_whole_and_gives_way_to_the_next(tmp_path: Path) -> None:
    """The frames so far, with as many lines in the lists as there are images; recording again replaces them."""
    with RecordingWriter(tmp_path / "a", CALIBRATION, 11.9) as recording:
        recording.add(frame(0), pose(0))
        recording.add(frame(1), pose(1))
        recording.end(interrupted=True)
    assert len((tmp_path / "a" / "times.txt").read_text().splitlines()) == 2
    assert len((tmp_path / "a" / "poses.txt").read_text().splitlines()) == 2
    assert len(list((tmp_path / "a").glob("image_*/*.png"))) == 4
    record(tmp_path / "a", 3)
    assert len((tmp_path / "a" / "times.txt").read_text().splitlines()) == 3
    with pytest.raises(ValueError, match="not empty"):
        record(tmp_path / "a", 3)


def test_what_a_killed_recording_left_is_in_nobodys_way(tmp_path: Path) -> None:
    """The folder of a process that is gone is removed; a user's own folder of a similar name is not."""
    gone = subprocess.run(["sh", "-c", "echo $$"], capture_output=True, text=True, check=True).stdout.strip()
    (tmp_path / f".a.{gone}.unfinished" / "image_0").mkdir(parents=True)
    for name in ("a.recording", ".a.mine.unfinished", ".ab.1.unfinished"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "mine.txt").touch()
    record(tmp_path / "a", 1)
    assert {path.name for path in tmp_path.iterdir()} == {"a", "a.recording", ".a.mine.unfinished", ".ab.1.unfinished"}


def test_an_error_leaves_nothing_and_what_is_there_is_kept(tmp_path: Path) -> None:
    """A full disk, for example; a directory with something in it is refused before anything is written."""

    def on_a_full_disk() -> None:
        with RecordingWriter(tmp_path / "a", CALIBRATION, 11.9) as recording:
            recording.add(frame(0), pose(0))
            raise OSError("full")

    with pytest.raises(OSError, match="full"):
        on_a_full_disk()
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "mine.txt").touch()
    with pytest.raises(ValueError, match="not empty"):
        record(tmp_path, 1)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
