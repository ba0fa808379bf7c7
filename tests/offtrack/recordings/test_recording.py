"""Recordings as KITTI's readers take them; trajectories: chained motions, text formats, and drift."""

import math
import subprocess
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from estimators.estimates import Health, Motion, lost_motion
from offtrack.exchange.recordings.estimation import drift
from offtrack.exchange.recordings.stereo_reader import camera_poses, kitti_text, read_kitti_poses, tum_text
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
        recording.end()
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


PERIOD = 100  # [ticks]


def circle(count: int, step: float = 0.5, turn: float = 0.03) -> FloatArray:
    """Poses (n, 4, 4) of a camera that goes along its z axis and turns about its y axis, with some pitch."""
    X = transform(rotation_zyx(0.0, turn, 0.002), np.array([0.0, 0.01, step]))
    poses = [np.eye(4)]
    for _ in range(count - 1):
        poses.append(poses[-1] @ X)
    return np.array(poses)


def motion(poses: FloatArray, previous: int, current: int, health: Health = Health.OK) -> Motion:
    lost = lost_motion(current * PERIOD, previous * PERIOD)
    known: dict[str, Any] = {"X_PC": inverse(poses[previous]) @ poses[current], "covariance": np.diag(np.full(6, 1e-6))}
    return lost if health is Health.LOST else replace(lost, **known, matches=300, inliers=280, health=health)


@pytest.mark.parametrize(
    ("count", "lost", "tolerance"),
    [
        (60, (), 1e-12),  # rounding of 60 products
        (10, (4, 5), 1e-5),  # bridged at the last velocity; the stretch of a screw motion is one to second order
    ],
)
def test_motions_chain_to_the_poses_they_came_from(count: int, lost: tuple[int, ...], tolerance: float) -> None:
    """On a turning path: every increment belongs to the frame that it starts from; frames after a bridge hang on it."""
    poses = circle(count)
    motions = [motion(poses, k - 1, k, Health.LOST if k in lost else Health.OK) for k in range(1, count)]
    got = camera_poses([k * PERIOD for k in range(count)], motions)
    np.testing.assert_allclose(got, poses, atol=tolerance)


def test_a_frame_that_was_passed_over_is_corrected_by_the_next_motion() -> None:
    """A motion from before the lost frame takes the place of the bridge, even if the speed changed meanwhile."""
    poses = circle(6)
    poses[3:] = poses[2] @ transform(np.eye(3), np.array([0.0, 0.0, 3.0])) @ inverse(poses[3]) @ poses[3:]
    motions = [motion(poses, 0, 1), motion(poses, 1, 2), motion(poses, 2, 3, Health.LOST), motion(poses, 2, 4)]
    got = camera_poses([k * PERIOD for k in range(5)], motions)
    np.testing.assert_allclose(got[[1, 2, 4]], poses[[1, 2, 4]], atol=1e-12)


def test_a_dropped_frame_lies_between_its_neighbours() -> None:
    """Every frame of the sequence has a line in KITTI's format; a constant velocity fills the gap."""
    poses = circle(8)
    motions = [motion(poses, 0, 1), motion(poses, 1, 2), motion(poses, 2, 5), motion(poses, 5, 6)]
    got = camera_poses([k * PERIOD for k in range(8)], motions)
    # The chord over three frames, 0.09 rad, is theta^2 / 24 = 0.3 per mille shorter than its 1.5 m of arc.
    np.testing.assert_allclose(got[:7], poses[:7], atol=3e-4)
    np.testing.assert_array_equal(got[7], got[6])  # after the end nothing is known
    np.testing.assert_array_equal(camera_poses([0, 100], []), np.tile(np.eye(4), (2, 1, 1)))


def test_kitti_text_reads_back(tmp_path: Path) -> None:
    poses = circle(12)
    (tmp_path / "poses.txt").write_text(kitti_text(poses), encoding="utf-8")
    np.testing.assert_allclose(read_kitti_poses(tmp_path / "poses.txt", 12), poses, atol=1e-11)


def test_tum_text_has_time_position_and_quaternion() -> None:
    """A turn by 90 degrees about y: q = (0, sin 45, 0, cos 45), the scalar last."""
    pose = transform(rotation_zyx(0.0, math.pi / 2, 0.0), np.array([1.0, 2.0, 3.0]))
    comment, line = tum_text([12.5], pose[None]).strip().split("\n")
    assert comment.startswith("#")
    numbers = [float(word) for word in line.split()]
    assert numbers == pytest.approx([12.5, 1.0, 2.0, 3.0, 0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5)], abs=1e-9)


def straight(count: int, step: float) -> FloatArray:
    return np.array([transform(np.eye(3), np.array([0.0, 0.0, k * step])) for k in range(count)])


def test_an_odometry_that_is_one_percent_short_has_one_percent_of_drift() -> None:
    """Straight ahead every subsequence is 1 % short, whatever its length; it ends up to a step beyond that."""
    found = drift(straight(1001, 1.0), straight(1001, 0.99))
    assert found is not None
    assert found.translation == pytest.approx(0.01, rel=0.011)  # 101 m driven for 100 m asked
    assert found.rotation == 0.0
    assert found.lengths == (100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0)
    # starts at 0, 10, ...; the last frame must be more than the length away: 90 + 80 + ... + 20
    assert found.subsequences == sum(range(20, 100, 10))
    assert drift(straight(50, 1.0), straight(50, 0.9)) is None  # shorter than every length
    assert drift(straight(1, 1.0), straight(1, 1.0)) is None


def test_the_choice_of_the_world_is_no_drift() -> None:
    true = circle(500)
    found = drift(true, transform(rotation_zyx(1.0, 0.2, -0.3), np.array([5.0, -7.0, 2.0])) @ true)
    assert found is not None
    assert found.translation < 1e-12
    assert found.rotation < 1e-9  # an angle from a rotation matrix is good to the root of the rounding error


def test_a_constant_yaw_error_is_told_per_metre() -> None:
    """1e-4 rad in every metre; the position goes astray by half of it times the length squared."""
    turned = [np.eye(4)]
    for _ in range(349):
        turned.append(turned[-1] @ transform(rotation_zyx(0.0, 1e-4, 0.0), np.array([0.0, 0.0, 1.0])))
    found = drift(straight(350, 1.0), np.array(turned), lengths=(100.0,))
    assert found is not None
    assert found.rotation == pytest.approx(1e-4, rel=0.011)  # 101 steps over 100 m
    assert found.translation == pytest.approx(0.5 * 1e-4 * 101.0, rel=0.03)  # a step is not infinitely short
