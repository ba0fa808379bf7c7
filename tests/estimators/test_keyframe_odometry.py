"""Keyframe-anchored odometry on synthetic stereo views with exact truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from estimators.estimates import Health, Motion
from estimators.odometry.circular import CircularOdometry
from estimators.odometry.keyframe import KeyframeOdometry
from estimators.rigid_motion import rotation_vector, stretched
from sensors.messages import GreyImage
from tests.estimators.stereo_scene import Drive
from vehicle.frames import FloatArray, inverse

STANDING = 43  # first frame of the drive that is where the one before was


@pytest.fixture(scope="module")
def motions(drive: Drive) -> list[Motion]:
    return drive.run(KeyframeOdometry(drive.calibration), drive.frames)[1]


def travelled(motions: Sequence[Motion]) -> FloatArray:
    X = np.eye(4)
    for motion in motions:
        X = X @ motion.X_PC
    return X


def test_motions_are_those_of_the_camera(drive: Drive, motions: list[Motion]) -> None:
    """Straight on, turning, yawing and shaking, 0.5 m a frame."""
    errors = drive.errors(motions)
    assert len(motions) == len(drive.frames) - 1
    assert all(motion.health is Health.OK for motion in motions)
    rms = np.sqrt(np.mean(errors**2, axis=0))
    # 400 features at 0.1 px are good for 0.001 deg and 0.4 mm; errors of neighbours are alike: x 3
    assert np.degrees(rms[:3]).max() < 0.004
    assert rms[3:].max() < 1.5e-3


def test_drift_is_less_than_from_frame_to_frame(drive: Drive, motions: list[Motion]) -> None:
    """Over any 7 m of travel the errors of 14 motions do not accumulate: the purpose of keyframes."""
    circular, memory = CircularOdometry(drive.calibration), CircularOdometry(drive.calibration).init()
    chained = []
    for frame in drive.frames:
        memory, motion = circular.step(memory, frame)
        chained += [motion] if motion is not None else []
    drifts = []
    for source in (motions, chained):
        ends = [(k, k + 14) for k in range(0, 28, 2)]
        lateral = [drive.deviation(drive.camera_motion(a, b), travelled(source[a:b])) for a, b in ends]
        drifts.append(np.sqrt(np.mean(np.square(lateral), axis=0)))
    assert np.all(drifts[0][3:] < 3e-3)  # [m] 0.04 % of the way
    assert drifts[0][1] < 0.7 * drifts[1][1]  # yaw about the camera's y: what off-tracking lives on


def test_covariances_are_consistent_with_the_errors(drive: Drive, motions: list[Motion]) -> None:
    """Of single motions and against the keyframe: 19 of 20 within 2.5 standard deviations, and not all of them tiny."""
    anchored = []
    for motion in motions:
        assert motion.anchor is not None
        truth = drive.camera_motion(motion.anchor.tick // 100, motion.tick // 100)
        anchored.append(drive.deviation(truth, motion.anchor.X_AC) / np.sqrt(np.diag(motion.anchor.covariance)))
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


def test_rotations_stay_rotations(motions: list[Motion]) -> None:
    """Products of many poses drift off SO(3) if nobody sees to it."""
    for motion in motions:
        assert motion.X_PC[:3, :3] @ motion.X_PC[:3, :3].T == pytest.approx(np.eye(3), abs=1e-12)


def test_matches_are_of_those_offered(drive: Drive, motions: list[Motion]) -> None:
    """420 points are looked for in an ordinary view and most are found, well above the 250 that health needs."""
    assert np.median([motion.matches for motion in motions]) > 330
    for motion in motions:
        assert 0.8 * motion.matches < motion.inliers <= motion.matches <= 420
        assert motion.tracks.shape == (motion.inliers, 4)
        assert np.all((motion.tracks[:, 2:] >= 0.0) & (motion.tracks[:, 2:] <= [1343.0, 390.0]))


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


def test_reversing_is_driving_backwards(drive: Drive) -> None:
    """The frames in the opposite order: every motion is the inverse of the true one."""
    backwards = [replace(frame, tick=100 * k) for k, frame in enumerate(drive.frames[12:40][::-1])]
    motions = drive.run(KeyframeOdometry(drive.calibration), backwards)[1]
    for k, motion in enumerate(motions):
        assert motion.health is Health.OK
        truth = inverse(drive.camera_motion(38 - k, 39 - k))
        assert np.abs(drive.deviation(truth, motion.X_PC)[3:]).max() < 4e-3  # [m] 4 sigma of a frame


def test_dropped_frames_are_bridged(drive: Drive) -> None:
    """Irregular ticks: single, double and triple steps, up to 1.5 m and 6 deg."""
    chosen = [14, 15, 17, 18, 21, 22, 23, 25, 28, 29, 31, 32]
    motions = drive.run(KeyframeOdometry(drive.calibration), [drive.frames[k] for k in chosen])[1]
    assert [motion.tick // 100 for motion in motions] == chosen[1:]
    assert all(motion.health is Health.OK for motion in motions)
    assert np.abs(drive.errors(motions)[:, 3:]).max() < 5e-3  # [m]
    assert np.abs(drive.normalised(motions)).max() < 5.0


def test_first_motion_is_measured_from_a_keyframe(drive: Drive) -> None:
    """1.5 m with 6 deg to go from rest: frame-to-frame odometry says where to look, and no more."""
    motion = drive.run(KeyframeOdometry(drive.calibration), drive.frames[30:34:3])[1][0]
    assert motion.health is Health.OK
    assert motion.anchor is not None


def test_darkness_leaves_no_trace(drive: Drive) -> None:
    """Dark for one frame: the next is measured from the same keyframe as ever."""
    frames = list(drive.frames[20:28])
    frames[4] = drive.dark(frames[4])
    motions = drive.run(KeyframeOdometry(drive.calibration), frames)[1]
    assert all(motion.health is Health.OK for motion in motions if motion.tick != 2400)
    assert motions[4].anchor is not None
    assert motions[4].anchor.tick <= 2300


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
    """The prediction misses by some 40 px, five times the reach of the patches: Lucas-Kanade leads them there."""
    odometry = KeyframeOdometry(drive.calibration)
    memory, _ = drive.run(odometry, drive.frames[20:25])
    assert memory.last is not None
    swerving = memory.last.X_PC @ yawed(np.radians(4.0))
    memory, motion = odometry.step(memory._replace(last=replace(memory.last, X_PC=swerving)), drive.frames[25])
    assert motion is not None
    assert motion.health is Health.OK
    assert motion.anchor is not None
    assert np.abs(drive.normalised([motion])).max() < 5.0


def yawed(angle: float) -> FloatArray:
    X = np.eye(4)
    X[:3, :3] = [[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]]
    return X


def test_exposure_may_change_from_frame_to_frame(drive: Drive) -> None:
    """Brighter and darker by 30 %, frame by frame: patches are compared with their gain taken out."""
    gains = [1.0, 1.25, 0.8, 1.1, 0.7, 1.0, 1.3, 0.9]
    frames = [
        replace(f, left=exposed(f.left, gain), right=exposed(f.right, gain))
        for f, gain in zip(drive.frames[15:23], gains, strict=True)
    ]
    motions = drive.run(KeyframeOdometry(drive.calibration), frames)[1]
    assert all(motion.health is Health.OK for motion in motions)
    assert np.abs(drive.errors(motions)[:, 3:]).max() < 4e-3  # [m] 4 sigma of a frame


def exposed(image: GreyImage, gain: float) -> GreyImage:
    return np.asarray(np.clip(np.rint(gain * image.astype(np.float64)), 0, 255), dtype=np.uint8)


def test_vehicle_over_a_quarter_of_the_view_does_not_move_the_trailer(drive: Drive) -> None:
    """A textured vehicle overtakes: its points miss, and after two misses they are not asked again."""
    rng = np.random.default_rng(0)
    skin = rng.integers(40, 220, (60, 250)).astype(np.uint8).repeat(4, axis=0).repeat(4, axis=1)
    frames = []
    for k, frame in enumerate(drive.frames[15:25]):
        left, right = frame.left.copy(), frame.right.copy()
        u = 230 + 9 * k  # [px]
        left[140:380, u : u + 560], right[140:380, u - 28 : u + 532] = skin[:, :560], skin[:, :560]
        frames.append(replace(frame, left=left, right=right))
    motions = drive.run(KeyframeOdometry(drive.calibration), [*drive.frames[12:15], *frames])[1][3:]
    assert all(motion.health is not Health.LOST for motion in motions)
    errors = drive.errors(motions)
    assert np.abs(errors[:, 3:]).max() < 8e-3  # [m]
    assert np.degrees(np.abs(errors[:, :3])).max() < 0.03


@pytest.mark.parametrize(
    ("health", "leap", "believed"),
    [(Health.OK, 0.3, True), (Health.DEGRADED, 0.3, False), (Health.DEGRADED, 0.05, True)],
)
def test_a_doubtful_leap_is_not_believed(
    drive: Drive, monkeypatch: pytest.MonkeyPatch, health: Health, leap: float, believed: bool
) -> None:
    """A vehicle that hides the view and keeps its distance looks like having stopped dead: 30 m/s2.

    Such a frame is lost, and passed over: the next one is measured from the frame before it.
    """
    odometry = KeyframeOdometry(drive.calibration)
    before, _ = drive.run(odometry, drive.frames[:4])
    after, motion = odometry.step(before, drive.frames[4])
    assert motion is not None
    X = motion.X_PC.copy()
    X[2, 3] += leap
    monkeypatch.setattr(odometry, "_measured", lambda *_: (after, replace(motion, X_PC=X, health=health)))
    memory, told = odometry.step(before, drive.frames[4])
    assert told is not None
    assert (told.health is not Health.LOST) == believed
    assert memory.keyframes is (after if believed else before).keyframes
    assert memory.previous is (after if believed else before).previous
    if not believed:
        assert np.array_equal(told.X_PC, np.eye(4))
        assert told.anchor is None
        assert np.isinf(np.diag(told.covariance)).all()


@pytest.mark.parametrize(
    ("share", "lost_for", "believed"),
    [(0.7, 0.4, True), (0.0, 0.4, False), (0.0, 2.0, False), (1.4, 2.0, True), (0.0, 6.0, True)],
)
def test_what_is_seen_first_after_a_loss_must_go_on_as_before(
    drive: Drive, monkeypatch: pytest.MonkeyPatch, share: float, lost_for: float, believed: bool
) -> None:
    """In good health even, and if brakes could explain it: at rest is what a vehicle close behind would look like.

    After five seconds nobody knows any more how fast it ought to be.
    """
    odometry = KeyframeOdometry(drive.calibration)
    before, _ = drive.run(odometry, drive.frames[:4])
    last = before.last
    assert last is not None
    X = stretched(last.X_PC, share)
    frame = replace(drive.frames[4], tick=last.tick + round(1000 * lost_for))
    again = replace(last, tick=frame.tick, previous_tick=frame.tick - (last.tick - last.previous_tick), X_PC=X)
    monkeypatch.setattr(odometry, "_measured", lambda *_: (before, again))
    _, told = odometry.step(before, frame)
    assert told is not None
    assert (told.health is not Health.LOST) == believed
