"""Keyframe-anchored odometry on synthetic stereo views with exact truth."""

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce

import numpy as np
import pytest

from estimators.estimates import Health, Motion
from estimators.odometry.circular import CircularOdometry
from estimators.odometry.keyframe import KeyframeOdometry
from estimators.odometry.keyframe_tracking import new_keyframe, tracked
from estimators.rigid_motion import rotation_vector
from sensors.messages import GreyImage
from tests.estimators.stereo_scene import Drive
from vehicle.frames import FloatArray, inverse, so3_exp, transform

STANDING = 43  # first frame of the drive that is where the one before was


@pytest.fixture(scope="module")
def motions(drive: Drive) -> list[Motion]:
    return drive.run(KeyframeOdometry(drive.calibration), drive.frames)[1]


def test_points_of_the_ground_lie_on_it_within_their_covariance(drive: Drive) -> None:
    """Heights of the nearest ones: half of them within 0.67 standard deviations, as of normal errors, or more."""
    X_WK = drive.bodies[12] @ drive.calibration.X_SC
    keyframe = new_keyframe(drive.calibration, drive.frames[12], X_WK, np.random.default_rng(0))
    heights = keyframe.points @ X_WK[2, :3] + X_WK[2, 3]
    std = np.sqrt(np.einsum("i,nij,j->n", X_WK[2, :3], keyframe.covariance, X_WK[2, :3]))
    ground = (keyframe.points[:, 2] < 12.0) & (np.abs(heights) < 0.2)  # the rest are walls
    assert np.count_nonzero(ground) > 100
    assert np.median(np.abs(heights / std)[ground]) < 0.67


def test_points_of_a_keyframe_are_found_where_they_were_in_an_image_that_is_clipped(drive: Drive) -> None:
    """The same picture twice as bright: not clipped alike, half of the patches would be off by 0.03 px or more."""
    frame = drive.frames[12]
    keyframe = new_keyframe(drive.calibration, frame, np.eye(4), np.random.default_rng(0))
    left, right = (np.minimum(2 * image.astype(np.int64), 255).astype(np.uint8) for image in (frame.left, frame.right))
    seen = tracked(drive.calibration, [keyframe], replace(frame, left=left, right=right), np.eye(4))
    off = seen.observations.z[:, 0] - keyframe.centres[seen.feature, 0]
    assert np.mean(seen.found) > 0.6
    assert np.median(np.abs(off[seen.found])) < 0.01


def test_motions_without_a_compiler_are_the_same(
    drive: Drive, motions: list[Motion], monkeypatch: pytest.MonkeyPatch
) -> None:
    """NumPy and OpenCV in place of the compiled kernels: equal to a hundredth of what a motion is wrong by."""
    monkeypatch.setenv("OFFTRACK_COMPILER", "none")
    same = drive.run(KeyframeOdometry(drive.calibration), drive.frames[:8])[1]
    for motion, other in zip(motions, same, strict=False):
        assert pytest.approx(other.X_PC, abs=1e-5) == motion.X_PC
        assert motion.inliers == pytest.approx(other.inliers, abs=3)


def travelled(motions: Sequence[Motion]) -> FloatArray:
    return reduce(np.matmul, [motion.X_PC for motion in motions], np.eye(4))


@pytest.mark.slow
def test_drift_is_less_than_from_frame_to_frame(drive: Drive, motions: list[Motion]) -> None:
    """Over any 7 m of travel the errors of 14 motions do not accumulate: the purpose of keyframes."""
    chained = drive.run(CircularOdometry(drive.calibration), drive.frames)[1]
    drifts = []
    for source in (motions, chained):
        ends = [(k, k + 14) for k in range(0, 28, 2)]
        lateral = [drive.deviation(drive.camera_motion(a, b), travelled(source[a:b])) for a, b in ends]
        drifts.append(np.sqrt(np.mean(np.square(lateral), axis=0)))
    assert np.all(drifts[0][3:] < 3.5e-3)  # [m] 0.05 % of the way; over draws it is 0.7 to 3 mm
    assert drifts[0][1] < 0.7 * drifts[1][1]  # yaw about the camera's y: what off-tracking lives on


def test_covariances_are_consistent_with_the_errors(drive: Drive, motions: list[Motion]) -> None:
    """Of single motions and against the keyframe: 19 of 20 within 2.5 standard deviations, and not all of them tiny."""
    anchored = []
    for motion in motions:
        assert motion.anchor is not None
        truth = drive.camera_motion(motion.anchor.tick // 100, motion.tick // 100)
        anchored.append(drive.deviation(truth, motion.anchor.X_AC) / np.sqrt(np.diag(motion.anchor.covariance)))
    assert max(motion.covariance.max() for motion in motions) < 1e-3  # from the first one on
    for ratios in (np.abs(drive.normalised(motions)), np.abs(anchored)):
        assert np.mean(ratios < 2.5) > 0.95
        assert np.sqrt(np.mean(np.square(ratios))) > 0.5


def test_anchors_and_motions_are_one_chain(motions: list[Motion]) -> None:
    """From the anchor to the current frame it is the motions in between, exactly: values telescope."""
    for k, motion in enumerate(motions):
        assert motion.anchor is not None
        between = [one for one in motions[: k + 1] if one.previous_tick >= motion.anchor.tick]
        assert travelled(between) == pytest.approx(motion.anchor.X_AC, abs=1e-9)  # rounding of some products
    ticks = [motion.anchor.tick for motion in motions if motion.anchor]
    assert 6 <= len(set(ticks)) <= 20  # 21 m and 70 deg of turn: at 2 m or 6 deg each
    assert ticks == sorted(ticks)
    for motion in motions:  # products of many poses drift off SO(3) if nobody sees to it
        assert motion.X_PC[:3, :3] @ motion.X_PC[:3, :3].T == pytest.approx(np.eye(3), abs=1e-12)


@pytest.mark.slow
def test_standstill_is_no_motion_and_needs_no_keyframe(drive: Drive) -> None:
    """The truck stands for 20 frames, with new noise each: nothing wanders, as all of them hang on one keyframe."""
    rng, still = np.random.default_rng(4), drive.frames[STANDING]
    frames = [replace(still, tick=still.tick + 100 * k, left=noisy(still.left, rng)) for k in range(1, 21)]
    memory, _ = drive.run(KeyframeOdometry(drive.calibration), drive.frames[36 : STANDING + 1])
    after, motions = drive.run(KeyframeOdometry(drive.calibration), frames, memory)
    assert [keyframe.tick for keyframe in after.keyframes] == [keyframe.tick for keyframe in memory.keyframes]
    assert np.linalg.norm(travelled(motions)[:3, 3]) < 2e-3  # [m] one error, not twenty
    assert np.degrees(np.linalg.norm(rotation_vector(travelled(motions)[:3, :3]))) < 0.005


def noisy(image: GreyImage, rng: np.random.Generator) -> GreyImage:
    return np.asarray(np.clip(image + np.rint(rng.standard_normal(image.shape)), 0, 255), dtype=np.uint8)


@pytest.mark.slow
def test_reversing_is_driving_backwards(drive: Drive) -> None:
    backwards = [replace(frame, tick=100 * k) for k, frame in enumerate(drive.frames[12:40][::-1])]
    motions = drive.run(KeyframeOdometry(drive.calibration), backwards)[1]
    for k, motion in enumerate(motions):
        assert motion.health is Health.OK
        truth = inverse(drive.camera_motion(38 - k, 39 - k))
        assert np.abs(drive.deviation(truth, motion.X_PC)[3:]).max() < 4e-3  # [m] 4 sigma of a frame


def test_lost_keyframes_fall_back_to_frame_to_frame(drive: Drive) -> None:
    """Keyframes that show nothing of the world (spoilt here): degraded, from the frame before, and then whole again."""
    odometry = KeyframeOdometry(drive.calibration)
    memory, _ = drive.run(odometry, drive.frames[10:14])
    spoilt = tuple(keyframe._replace(image=np.full_like(keyframe.image, 90.0)) for keyframe in memory.keyframes)
    motions = drive.run(odometry, drive.frames[14:18], memory._replace(keyframes=spoilt))[1]
    assert [motion.health for motion in motions] == [Health.DEGRADED, Health.OK, Health.OK, Health.OK]
    assert motions[0].anchor is None
    assert motions[1].anchor is not None
    assert motions[1].anchor.tick == 1400
    assert np.abs(drive.normalised(motions)).max() < 5.0


def test_sudden_shake_is_found_again(drive: Drive) -> None:
    """The prediction misses by some 40 px, five times the reach of the patches: coarse images lead them there."""
    odometry = KeyframeOdometry(drive.calibration)
    memory, _ = drive.run(odometry, drive.frames[20:25])
    assert memory.last is not None
    swerving = memory.last.X_PC @ transform(so3_exp(np.array([0.0, np.radians(4.0), 0.0])), np.zeros(3))
    memory, motion = odometry.step(memory._replace(last=replace(memory.last, X_PC=swerving)), drive.frames[25])
    assert motion is not None
    assert motion.health is Health.OK
    assert motion.anchor is not None
    assert np.abs(drive.normalised([motion])).max() < 5.0


@pytest.mark.parametrize(("dirty", "leap", "believed"), [(False, 0.3, True), (True, 0.3, False), (True, 0.03, True)])
def test_a_doubtful_leap_is_not_believed(drive: Drive, dirty: bool, leap: float, believed: bool) -> None:
    """From few features a change of velocity by 30 m/s2 is no motion: a vehicle that hides the view looks like that.

    Such a frame is lost, and passed over: the next one is measured from the frame before it.
    """
    odometry = KeyframeOdometry(drive.calibration)
    frames = [drive.dirty(frame) if dirty else frame for frame in drive.frames[:5]]
    before, _ = drive.run(odometry, frames[:4])
    assert before.last is not None
    X = before.last.X_PC.copy()
    X[2, 3] += leap
    before = before._replace(last=replace(before.last, X_PC=X))
    memory, motion = odometry.step(before, frames[4])
    assert motion is not None
    assert (motion.health is not Health.LOST) == believed
    assert memory.previous is not None
    assert memory.previous.tick == (400 if believed else 300)
    if not believed:
        assert memory.keyframes is before.keyframes
        assert np.array_equal(motion.X_PC, np.eye(4))
        assert motion.anchor is None
        assert np.isinf(np.diag(motion.covariance)).all()
