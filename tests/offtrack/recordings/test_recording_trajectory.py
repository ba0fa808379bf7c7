"""Trajectories: chained motions, text formats, and the drift that KITTI's definition gives."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from estimators.estimates import Health, Motion
from offtrack.exchange.recordings.estimation import drift
from offtrack.exchange.recordings.stereo_reader import camera_poses, kitti_text, read_kitti_poses, tum_text
from vehicle.frames import FloatArray, inverse, rotation_zyx, transform

PERIOD = 100  # [ticks]


def circle(count: int, step: float = 0.5, turn: float = 0.03) -> FloatArray:
    """Poses (n, 4, 4) of a camera that goes along its z axis and turns about its y axis, with some pitch."""
    X = transform(rotation_zyx(0.0, turn, 0.002), np.array([0.0, 0.01, step]))
    poses = [np.eye(4)]
    for _ in range(count - 1):
        poses.append(poses[-1] @ X)
    return np.array(poses)


def motion(poses: FloatArray, previous: int, current: int, health: Health = Health.OK) -> Motion:
    lost = health is Health.LOST
    return Motion(
        tick=current * PERIOD,
        previous_tick=previous * PERIOD,
        X_PC=np.eye(4) if lost else inverse(poses[previous]) @ poses[current],
        covariance=np.diag(np.full(6, np.inf if lost else 1e-6)),
        matches=0 if lost else 300,
        inliers=0 if lost else 280,
        health=health,
        tracks=np.zeros((0, 4), np.float32),
    )


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


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("1 2 3\n", "line 1: a pose is 12 numbers"),
        ("1 0 0 0 0 1 0 0 0 0 1 x\n", "line 1"),
        ("1 0 0 0 0 2 0 0 0 0 1 0\n", "not a rotation"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n" * 3, "has 3 poses for 5 frames"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n" * 8, "has 8 poses for 5 frames"),
    ],
)
def test_wrong_poses_are_refused(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "poses.txt").write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=r"poses\.txt") as refused:
        read_kitti_poses(tmp_path / "poses.txt", 5)
    assert says in str(refused.value)


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
