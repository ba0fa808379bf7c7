"""Circular odometry on synthetic stereo views with exact truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from estimators.estimates import Health, Motion
from estimators.rigid_motion import rotation_vector
from estimators.stereo_odometry import CircularOdometry, OdometryMemory
from sensors.messages import GreyImage, StereoFrame
from sensors.rig import StereoCalibration
from vehicle.frames import FloatArray

STANDING = 43  # first frame of the drive that is where the one before was


def run(odometry: CircularOdometry, frames: Sequence[StereoFrame]) -> tuple[OdometryMemory, list[Motion]]:
    memory, motions = odometry.init(), []
    for frame in frames:
        memory, motion = odometry.step(memory, frame)
        if motion is not None:
            motions.append(motion)
    return memory, motions


@pytest.fixture(scope="module")
def motions(drive) -> list[Motion]:
    return run(CircularOdometry(drive.calibration), drive.frames)[1]


def error(drive, motion: Motion) -> FloatArray:
    """Error (6,) of the motion along the axes of the frame it starts from: what its covariance is about."""
    X_PC = drive.camera_motion(motion.previous_tick // 100, motion.tick // 100)
    R_error = X_PC[:3, :3] @ motion.X_PC[:3, :3].T
    return np.concatenate([rotation_vector(R_error), X_PC[:3, 3] - motion.X_PC[:3, 3]])


def normalised(drive, motions: Sequence[Motion]) -> FloatArray:
    return np.array([error(drive, motion) / np.sqrt(np.diag(motion.covariance)) for motion in motions])


def changed(frame: StereoFrame, left: GreyImage, right: GreyImage) -> StereoFrame:
    return replace(frame, left=left, right=right)


def black(frame: StereoFrame) -> StereoFrame:
    return changed(frame, np.zeros_like(frame.left), np.zeros_like(frame.right))


def test_motions_are_those_of_the_camera(drive, motions: list[Motion]) -> None:
    """Straight on, turning, yawing and shaking, 0.5 m a frame: a few millimetres and thousandths of a degree."""
    errors = np.array([error(drive, motion) for motion in motions])
    assert len(motions) == len(drive.frames) - 1
    assert all(motion.health is Health.OK for motion in motions)
    rms = np.sqrt(np.mean(errors**2, axis=0))
    # an independent bound for 400 features at 0.1 px is 0.001 deg and 0.4 mm a frame; trackers correlate: x 3
    assert np.degrees(rms[:3]).max() < 0.005
    assert rms[3:].max() < 1.5e-3


def test_covariance_is_consistent_with_the_errors(drive, motions: list[Motion]) -> None:
    """Normalised errors: 19 of 20 within 2.5 standard deviations, and not all of them tiny either."""
    ratios = np.abs(normalised(drive, motions))
    assert np.mean(ratios < 2.5) > 0.95
    assert np.sqrt(np.mean(ratios**2)) > 0.5


def test_ordinary_frames_have_clearly_more_matches_than_the_threshold(motions: list[Motion]) -> None:
    """Fewer than 250 are DEGRADED; an ordinary view keeps its distance from that."""
    assert np.median([motion.matches for motion in motions]) > 350
    for motion in motions:
        assert motion.inliers > 0.8 * motion.matches
        assert motion.tracks.shape == (motion.inliers, 4)


def test_tracks_are_where_the_points_went(drive, motions: list[Motion]) -> None:
    """Tracks move with the image: backwards view, so the ground draws together, and there are two ends to each."""
    motion = motions[10]
    size = [drive.calibration.width, drive.calibration.height]
    assert np.all((motion.tracks >= 0.0) & (motion.tracks <= np.tile(size, 2)))
    flow = np.linalg.norm(motion.tracks[:, 2:] - motion.tracks[:, :2], axis=1)
    assert 0.5 < np.median(flow) < 30.0  # [px]


def test_standstill_is_no_motion(drive, motions: list[Motion]) -> None:
    """The truck stands: what is left is the noise of the images."""
    standing = [motion for motion in motions if motion.previous_tick >= 100 * (STANDING - 1)]
    assert len(standing) == 3
    for motion in standing:
        assert np.linalg.norm(motion.X_PC[:3, 3]) < 2e-3  # [m]
        assert np.linalg.norm(rotation_vector(motion.X_PC[:3, :3])) < np.radians(0.01)
        assert motion.health is Health.OK


@pytest.mark.parametrize("every", [2, 3])
def test_dropped_frames_are_bridged_by_a_longer_motion(drive, every: int) -> None:
    """Frames missing in between: the motion spans them, up to 1.5 m and 6 deg."""
    frames = drive.frames[20 : STANDING - 1 : every]
    motions = run(CircularOdometry(drive.calibration), frames)[1]
    assert all(motion.tick - motion.previous_tick == 100 * every for motion in motions)
    assert all(motion.health is not Health.LOST for motion in motions)
    errors = np.array([error(drive, motion) for motion in motions])
    assert np.abs(errors[:, 3:]).max() < 2.5e-3 * every  # [m]
    assert np.degrees(np.abs(errors[:, :3])).max() < 0.01 * every


def test_one_dropped_frame_does_not_upset_the_prediction(drive) -> None:
    """Constant velocity is stretched over the gap, and back again after it."""
    frames = [frame for k, frame in enumerate(drive.frames[20:30]) if k != 5]
    motions = run(CircularOdometry(drive.calibration), frames)[1]
    assert [motion.tick - motion.previous_tick for motion in motions] == [100] * 4 + [200] + [100] * 3
    assert np.abs(normalised(drive, motions)).max() < 5.0
    assert all(motion.health is Health.OK for motion in motions)


def test_first_motion_is_found_from_rest(drive) -> None:
    """No prediction yet, and 1.5 m with 6 deg to go: what the first look finds leads the second to the rest."""
    motion = run(CircularOdometry(drive.calibration), drive.frames[30:34:3])[1][0]
    assert motion.health is Health.OK
    assert np.linalg.norm(error(drive, motion)[3:]) < 5e-3  # [m]


def test_black_frame_is_lost_and_passed_over(drive) -> None:
    """No texture, no information: identity, infinitely uncertain; the next motion starts before the gap."""
    frames = list(drive.frames[20:28])
    frames[4] = black(frames[4])
    motions = run(CircularOdometry(drive.calibration), frames)[1]
    assert [motion.health for motion in motions] == [Health.OK] * 3 + [Health.LOST] + [Health.OK] * 3
    lost, after = motions[3], motions[4]
    assert np.array_equal(lost.X_PC, np.eye(4))
    assert np.all(np.isinf(np.diag(lost.covariance)))
    assert (lost.previous_tick, lost.tick) == (2300, 2400)
    assert (after.previous_tick, after.tick) == (2300, 2500)
    assert np.abs(normalised(drive, motions[4:])).max() < 5.0


def test_long_darkness_ends(drive) -> None:
    """Dark for longer than the ground can be recognised over: the odometry starts again with the first light."""
    frames = [*drive.frames[10:13], *(black(frame) for frame in drive.frames[13:22]), *drive.frames[22:26]]
    motions = run(CircularOdometry(drive.calibration), frames)[1]
    assert all(motion.health is Health.LOST for motion in motions[2:12])
    assert all(motion.health is Health.OK for motion in motions[12:])
    assert motions[12].previous_tick == 2200


def test_starting_in_the_dark_recovers(drive) -> None:
    """A first frame without texture must not stay the one that all others are compared with."""
    motions = run(CircularOdometry(drive.calibration), [black(drive.frames[0]), *drive.frames[1:4]])[1]
    assert [motion.health for motion in motions] == [Health.LOST, Health.OK, Health.OK]


def test_frame_from_elsewhere_is_lost(drive) -> None:
    """Textured, but of another place: nothing agrees, and the odometry says so and goes on from there."""
    other = drive.frames[40]
    frames = [*drive.frames[2:5], changed(drive.frames[5], np.fliplr(other.left).copy(), np.fliplr(other.right).copy())]
    motions = run(CircularOdometry(drive.calibration), [*frames, *drive.frames[6:9]])[1]
    health = [motion.health for motion in motions]
    assert health == [Health.OK, Health.OK, Health.LOST, Health.LOST, Health.OK, Health.OK]


def test_vehicle_that_fills_the_view_does_not_move_the_trailer(drive) -> None:
    """A vehicle that most corners are on cuts in: no trailer could swerve like that, so the world is what is left."""
    rng = np.random.default_rng(0)
    skin = rng.integers(40, 220, (60, 250)).astype(np.uint8).repeat(4, axis=0).repeat(4, axis=1)
    frames = []
    for k, frame in enumerate(drive.frames[15:21]):
        left, right = frame.left.copy(), frame.right.copy()
        u = 230 + 7 * k  # the vehicle overtakes [px]
        left[140:380, u : u + 800], right[140:380, u - 28 : u + 772] = skin[:, :800], skin[:, :800]
        frames.append(changed(frame, left, right))
    motions = run(CircularOdometry(drive.calibration), [*drive.frames[12:15], *frames])[1][3:]
    assert min(motion.inliers / motion.matches for motion in motions) < 0.45  # the vehicle has the majority
    assert all(motion.health is not Health.LOST for motion in motions)
    errors = np.array([error(drive, motion) for motion in motions])
    assert np.abs(errors[:, 3:]).max() < 8e-3  # [m]
    assert np.degrees(np.abs(errors[:, :3])).max() < 0.03


def test_few_features_degrade(drive) -> None:
    """Dirt over most of both lenses: still a motion, but it is not to be trusted as much, and it says how much."""
    frames = []
    for frame in drive.frames[15:19]:
        left, right = np.full_like(frame.left, 90), np.full_like(frame.right, 90)
        left[:, 500:800], right[:, 460:800] = frame.left[:, 500:800], frame.right[:, 460:800]
        frames.append(changed(frame, left, right))
    motions = run(CircularOdometry(drive.calibration), frames)[1]
    clear = run(CircularOdometry(drive.calibration), drive.frames[15:19])[1]
    for motion, reference in zip(motions, clear, strict=True):
        assert motion.health is Health.DEGRADED
        assert motion.matches < 250
        assert np.all(np.diag(motion.covariance) > 1.5 * np.diag(reference.covariance))
    assert np.abs(normalised(drive, motions)).max() < 5.0


def test_step_is_pure_and_repeatable(drive) -> None:
    """The same memory and frame give the same motion, bit by bit, however often they are used."""
    odometry = CircularOdometry(drive.calibration)
    memory, _ = run(odometry, drive.frames[:4])
    results = [odometry.step(memory, drive.frames[4])[1] for _ in range(2)]
    results.append(run(CircularOdometry(drive.calibration), drive.frames[:5])[1][-1])
    for result in results[1:]:
        assert np.array_equal(result.X_PC, results[0].X_PC)
        assert np.array_equal(result.covariance, results[0].covariance)
        assert np.array_equal(result.tracks, results[0].tracks)


def test_the_draws_hardly_matter(drive, motions: list[Motion]) -> None:
    """Another seed draws other hypotheses; the refined motion is the same but for a few matches on the edge."""
    other = run(CircularOdometry(drive.calibration, seed=5), drive.frames[:6])[1]
    for one, another in zip(motions, other, strict=False):
        change = np.abs(one.X_PC[:3, 3] - another.X_PC[:3, 3]) / np.sqrt(np.diag(one.covariance)[3:])
        assert change.max() < 0.5


def test_camera_must_be_above_the_ground(calibration: StereoCalibration) -> None:
    """Its height is where the first guess of the disparities comes from."""
    with pytest.raises(ValueError, match="must be positive"):
        CircularOdometry(replace(calibration, X_SC=np.eye(4)))
