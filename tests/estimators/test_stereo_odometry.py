"""Circular odometry on synthetic stereo views with exact truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.estimates import Health, Motion
from estimators.odometry.circular import CircularOdometry
from estimators.rigid_motion import rotation_vector
from tests.estimators.stereo_scene import Drive

STANDING = 43  # first frame of the drive that is where the one before was


@pytest.fixture(scope="module")
def motions(drive: Drive) -> list[Motion]:
    return drive.run(CircularOdometry(drive.calibration), drive.frames)[1]


def test_motions_are_those_of_the_camera(drive: Drive, motions: list[Motion]) -> None:
    """Straight on, turning, yawing and shaking, 0.5 m a frame: a few millimetres and thousandths of a degree."""
    errors = drive.errors(motions)
    assert len(motions) == len(drive.frames) - 1
    assert all(motion.health is Health.OK for motion in motions)
    rms = np.sqrt(np.mean(errors**2, axis=0))
    # an independent bound for 400 features at 0.1 px is 0.001 deg and 0.4 mm a frame; trackers correlate: x 3
    assert np.degrees(rms[:3]).max() < 0.005
    assert rms[3:].max() < 1.5e-3


def test_covariance_is_consistent_with_the_errors(drive: Drive, motions: list[Motion]) -> None:
    """Normalised errors: 19 of 20 within 2.5 standard deviations, and not all of them tiny either."""
    ratios = np.abs(drive.normalised(motions))
    assert np.mean(ratios < 2.5) > 0.95
    assert np.sqrt(np.mean(ratios**2)) > 0.5


def test_ordinary_frames_have_clearly_more_matches_than_the_threshold(motions: list[Motion]) -> None:
    """Fewer than 250 are DEGRADED; an ordinary view keeps its distance from that."""
    assert np.median([motion.matches for motion in motions]) > 350
    for motion in motions:
        assert motion.inliers > 0.8 * motion.matches
        assert motion.tracks.shape == (motion.inliers, 4)


def test_tracks_are_where_the_points_went(drive: Drive, motions: list[Motion]) -> None:
    """Tracks move with the image: backwards view, so the ground draws together, and there are two ends to each."""
    motion = motions[10]
    size = [drive.calibration.width, drive.calibration.height]
    assert np.all((motion.tracks >= 0.0) & (motion.tracks <= np.tile(size, 2)))
    flow = np.linalg.norm(motion.tracks[:, 2:] - motion.tracks[:, :2], axis=1)
    assert 0.5 < np.median(flow) < 30.0  # [px]


def test_standstill_is_no_motion(drive: Drive, motions: list[Motion]) -> None:
    """The truck stands: what is left is the noise of the images."""
    standing = [motion for motion in motions if motion.previous_tick >= 100 * (STANDING - 1)]
    assert len(standing) == 3
    for motion in standing:
        assert np.linalg.norm(motion.X_PC[:3, 3]) < 2e-3  # [m]
        assert np.linalg.norm(rotation_vector(motion.X_PC[:3, :3])) < np.radians(0.01)
        assert motion.health is Health.OK


@pytest.mark.parametrize("every", [2, 3])
def test_dropped_frames_are_bridged_by_a_longer_motion(drive: Drive, every: int) -> None:
    """Frames missing in between: the motion spans them, up to 1.5 m and 6 deg."""
    frames = drive.frames[20 : STANDING - 1 : every]
    motions = drive.run(CircularOdometry(drive.calibration), frames)[1]
    assert all(motion.tick - motion.previous_tick == 100 * every for motion in motions)
    assert all(motion.health is not Health.LOST for motion in motions)
    errors = drive.errors(motions)
    assert np.abs(errors[:, 3:]).max() < 2.5e-3 * every  # [m]
    assert np.degrees(np.abs(errors[:, :3])).max() < 0.01 * every


def test_one_dropped_frame_does_not_upset_the_prediction(drive: Drive) -> None:
    """Constant velocity is stretched over the gap, and back again after it."""
    frames = [frame for k, frame in enumerate(drive.frames[20:30]) if k != 5]
    motions = drive.run(CircularOdometry(drive.calibration), frames)[1]
    assert [motion.tick - motion.previous_tick for motion in motions] == [100] * 4 + [200] + [100] * 3
    assert np.abs(drive.normalised(motions)).max() < 5.0
    assert all(motion.health is Health.OK for motion in motions)


def test_vehicle_that_fills_the_view_does_not_move_the_trailer(drive: Drive) -> None:
    """A vehicle that most corners are on cuts in: no trailer could swerve like that, so the world is what is left."""
    rng = np.random.default_rng(0)
    skin = rng.integers(40, 220, (60, 250)).astype(np.uint8).repeat(4, axis=0).repeat(4, axis=1)
    frames = []
    for k, frame in enumerate(drive.frames[15:21]):
        left, right = frame.left.copy(), frame.right.copy()
        u = 230 + 7 * k  # the vehicle overtakes [px]
        left[140:380, u : u + 800], right[140:380, u - 28 : u + 772] = skin[:, :800], skin[:, :800]
        frames.append(replace(frame, left=left, right=right))
    motions = drive.run(CircularOdometry(drive.calibration), [*drive.frames[12:15], *frames])[1][3:]
    assert min(motion.inliers / motion.matches for motion in motions) < 0.45  # the vehicle has the majority
    assert all(motion.health is not Health.LOST for motion in motions)
    errors = drive.errors(motions)
    assert np.abs(errors[:, 3:]).max() < 8e-3  # [m]
    assert np.degrees(np.abs(errors[:, :3])).max() < 0.03


def test_the_draws_hardly_matter(drive: Drive, motions: list[Motion]) -> None:
    """Another seed draws other hypotheses; the refined motion is the same but for a few matches on the edge."""
    other = drive.run(CircularOdometry(drive.calibration, seed=5), drive.frames[:6])[1]
    for one, another in zip(motions, other, strict=False):
        change = np.abs(one.X_PC[:3, 3] - another.X_PC[:3, 3]) / np.sqrt(np.diag(one.covariance)[3:])
        assert change.max() < 0.5
