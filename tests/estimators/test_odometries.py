"""Every odometry of the catalogue on good, bad and missing views: synthetic ones, with exact truth."""

from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest

from estimators.context import Odometry
from estimators.estimates import Health, Motion
from estimators.odometry.circular import CircularOdometry
from estimators.rigid_motion import rotation_vector
from scenarios.catalogue import ODOMETRY, resolve
from sensors.camera.rig import StereoCalibration
from tests.estimators.stereo_scene import Drive

STANDING = 43  # first frame of the drive that is where the one before was


class Expected(NamedTuple):
    """What an odometry is good for on the drive."""

    rotation: float = 0.005  # RMS error of a motion; an independent bound for 400 features at 0.1 px is 0.001 [deg]
    translation: float = 1.5e-3  # the same: 0.4 mm, times three as trackers correlate [m]
    single: float = 5e-3  # error of any one motion [m]
    least_ratio: float = 0.5  # RMS of the normalised errors: covariances are not far too large
    healthy: bool = True  # an ordinary view is in good health


# Whole pixels are ten times worse, and match fewer features than a view in good health has.
VISO2 = Expected(rotation=0.06, translation=20e-3, single=60e-3, least_ratio=0.3, healthy=False)
EXPECTED = defaultdict(Expected, keyframe=Expected(rotation=0.004), viso2=VISO2)
SUB_PIXEL = [name for name in sorted(ODOMETRY) if EXPECTED[name].healthy]
Motions = Callable[[str], list[Motion]]


def made(name: str, drive: Drive) -> Odometry[Any]:
    part: Odometry[Any] = resolve("odometry", name, ODOMETRY)(drive.calibration)
    return part


@pytest.fixture(scope="module")
def motions_by(drive: Drive) -> Motions:
    return cache(lambda name: drive.run(made(name, drive), drive.frames)[1])


def states(name: str, motions: list[Motion]) -> list[str]:
    """Lost, or found: in good health, of an odometry from which that can be asked."""
    found = (Health.OK,) if EXPECTED[name].healthy else (Health.OK, Health.DEGRADED)
    return ["found" if motion.health in found else motion.health.value for motion in motions]


@pytest.mark.slow
def test_motions_are_those_of_the_camera(drive: Drive, motions_by: Motions, name: str) -> None:
    """Straight on, turning, yawing and shaking, 0.5 m a frame; errors as stated: 19 of 20 within 2.5 sigma."""
    expected, motions = EXPECTED[name], motions_by(name)
    assert states(name, motions) == ["found"] * (len(drive.frames) - 1)
    steady = motions if expected.healthy else motions[:40]  # hard braking after that: the filter lags
    rms = np.sqrt(np.mean(np.square(drive.errors(steady)), axis=0))
    assert np.degrees(rms[:3]).max() < expected.rotation
    assert 0.05 * expected.translation < rms[3:].max() < expected.translation
    ratios = np.abs(drive.normalised(steady))
    assert np.mean(ratios < 2.5) > 0.95
    assert np.sqrt(np.mean(ratios**2)) > expected.least_ratio


@pytest.mark.parametrize("name", SUB_PIXEL)
def test_matches_and_tracks_are_those_of_the_image(drive: Drive, motions_by: Motions, name: str) -> None:
    """An ordinary view has clearly more matches than the 250 of good health; tracks move with the image."""
    motions = motions_by(name)
    assert np.median([motion.matches for motion in motions]) > 330
    size = [drive.calibration.width, drive.calibration.height]
    for motion in motions:
        assert 0.8 * motion.matches < motion.inliers <= motion.matches
        assert motion.tracks.shape == (motion.inliers, 4)
    tracks = motions[10].tracks
    assert np.all((tracks[:, 2:] >= 0.0) & (tracks[:, 2:] <= size))
    flow = np.linalg.norm(tracks[:, 2:] - tracks[:, :2], axis=1)
    assert 0.5 < np.median(flow) < 30.0  # [px]


@pytest.mark.parametrize("name", SUB_PIXEL)
def test_standstill_is_no_motion(motions_by: Motions, name: str) -> None:
    standing = [motion for motion in motions_by(name) if motion.previous_tick >= 100 * (STANDING - 1)]
    assert len(standing) == 3
    for motion in standing:
        assert np.linalg.norm(motion.X_PC[:3, 3]) < 2e-3  # [m]
        assert np.linalg.norm(rotation_vector(motion.X_PC[:3, :3])) < np.radians(0.01)


@pytest.mark.parametrize("name", SUB_PIXEL)
def test_dropped_frames_are_bridged_by_a_longer_motion(drive: Drive, name: str) -> None:
    """Single, double and triple steps, up to 1.5 m and 6 deg: the prediction is stretched over them, and back."""
    chosen = [14, 15, 17, 18, 21, 22, 23, 25, 28, 29, 31, 32, 35, 38]
    motions = drive.run(made(name, drive), [drive.frames[k] for k in chosen])[1]
    assert [motion.previous_tick // 100 for motion in motions] == chosen[:-1]
    assert [motion.tick // 100 for motion in motions] == chosen[1:]
    assert all(motion.health is Health.OK for motion in motions)
    errors = drive.errors(motions)
    assert np.abs(errors[:, 3:]).max() < 5e-3  # [m]
    assert np.degrees(np.abs(errors[:, :3])).max() < 0.02
    assert np.abs(drive.normalised(motions)).max() < 5.0


@pytest.mark.parametrize(("name", "width", "speed", "count"), [("circular", 800, 7, 6), ("keyframe", 560, 9, 10)])
def test_vehicle_over_much_of_the_view_does_not_move_the_trailer(
    drive: Drive, name: str, width: int, speed: int, count: int
) -> None:
    """A textured vehicle overtakes at a ``speed`` [px a frame]; no trailer could swerve like that.

    Most corners are on it for the circular odometry. Keyframes ask for its points no more after two misses.
    """
    skin = np.random.default_rng(0).integers(40, 220, (60, 250)).astype(np.uint8).repeat(4, axis=0).repeat(4, axis=1)
    frames = []
    for k, frame in enumerate(drive.frames[15 : 15 + count]):
        left, right, u = frame.left.copy(), frame.right.copy(), 230 + speed * k
        left[140:380, u : u + width], right[140:380, u - 28 : u + width - 28] = skin[:, :width], skin[:, :width]
        frames.append(replace(frame, left=left, right=right))
    motions = drive.run(made(name, drive), [*drive.frames[12:15], *frames])[1][3:]
    if name == "circular":
        assert min(motion.inliers / motion.matches for motion in motions) < 0.45  # the vehicle has the majority
    assert all(motion.health is not Health.LOST for motion in motions)
    errors = drive.errors(motions)
    assert np.abs(errors[:, 3:]).max() < 8e-3  # [m]
    assert np.degrees(np.abs(errors[:, :3])).max() < 0.03


def test_the_draws_hardly_matter(drive: Drive, motions_by: Motions) -> None:
    """Another seed draws other hypotheses; the refined motion is the same but for a few matches on the edge."""
    other = drive.run(CircularOdometry(drive.calibration, seed=5), drive.frames[:6])[1]
    for one, another in zip(motions_by("circular"), other, strict=False):
        change = np.abs(one.X_PC[:3, 3] - another.X_PC[:3, 3]) / np.sqrt(np.diag(one.covariance)[3:])
        assert change.max() < 0.5


def test_first_motion_is_found_from_rest(drive: Drive, name: str, odometry: Odometry[Any]) -> None:
    """No prediction yet, and 1.5 m with 6 deg to go; from frame to frame first, and then from the keyframe."""
    motions = drive.run(odometry, drive.frames[30:34:3])[1]
    assert states(name, motions) == ["found"]
    assert np.linalg.norm(drive.errors(motions)[0, 3:]) < EXPECTED[name].single
    assert (motions[0].anchor is not None) == (name == "keyframe")


def test_dark_frame_is_lost_and_passed_over(drive: Drive, name: str, odometry: Odometry[Any]) -> None:
    """No texture, no information: identity, infinitely uncertain; the next motion starts before the gap."""
    frames = list(drive.frames[20:28])
    frames[4] = drive.dark(frames[4])
    motions = drive.run(odometry, frames)[1]
    assert states(name, motions) == ["found"] * 3 + ["lost"] + ["found"] * 3
    lost, after = motions[3], motions[4]
    assert np.array_equal(lost.X_PC, np.eye(4))
    assert np.all(np.isinf(np.diag(lost.covariance)))
    assert (lost.previous_tick, lost.tick) == (2300, 2400)
    assert (after.previous_tick, after.tick) == (2300, 2500)
    assert after.anchor is None or after.anchor.tick <= 2300  # the same keyframe as ever
    assert np.abs(drive.errors(motions[4:])[:, 3:]).max() < EXPECTED[name].single
    assert np.abs(drive.normalised(motions[4:])).max() < 5.0


@pytest.mark.slow
def test_long_darkness_ends(drive: Drive, name: str, odometry: Odometry[Any]) -> None:
    """Dark for longer than the ground can be recognised over: it starts again with the first light."""
    frames = [*drive.frames[10:13], *(drive.dark(frame) for frame in drive.frames[13:22]), *drive.frames[22:26]]
    motions = drive.run(odometry, frames)[1]
    assert states(name, motions[2:]) == ["lost"] * 10 + ["found"] * 3
    assert motions[12].previous_tick == 2200


def test_starting_in_the_dark_recovers(drive: Drive, name: str, odometry: Odometry[Any]) -> None:
    motions = drive.run(odometry, [drive.dark(drive.frames[0]), *drive.frames[1:4]])[1]
    assert states(name, motions) == ["lost", "found", "found"]


@pytest.mark.slow
def test_frame_from_elsewhere_is_lost_and_recovered_from(drive: Drive, name: str, odometry: Odometry[Any]) -> None:
    """Textured, but of another place: nothing agrees, and the odometry says so and goes on from there."""
    other = drive.frames[40]
    strange = replace(drive.frames[5], left=np.fliplr(other.left).copy(), right=np.fliplr(other.right).copy())
    motions = drive.run(odometry, [*drive.frames[2:5], strange, *drive.frames[6:9]])[1]
    assert states(name, motions) == ["found"] * 2 + ["lost"] * 2 + ["found"] * 2


def test_few_features_degrade(drive: Drive, motions_by: Motions, odometry: Odometry[Any], name: str) -> None:
    """Dirt over most of both lenses: still a motion, but it is not to be trusted as much, and it says how much."""
    motions = drive.run(odometry, [drive.dirty(frame) for frame in drive.frames[15:19]])[1]
    for motion, reference in zip(motions, motions_by(name)[15:18], strict=True):
        assert motion.health is Health.DEGRADED
        assert motion.matches < 250
        assert np.all(np.diag(motion.covariance) > 1.5 * np.diag(reference.covariance))
    assert np.abs(drive.normalised(motions)).max() < 5.0


@pytest.mark.parametrize("count", [1, 4])
def test_freeze_is_lost_and_recovered_from_at_once(
    drive: Drive, odometry: Odometry[Any], name: str, count: int
) -> None:
    """The first new frame is measured from the last good one, over the whole gap."""
    frames = list(drive.frames[5:15])
    frames[4 : 4 + count] = [replace(frames[3], tick=frame.tick) for frame in frames[4 : 4 + count]]
    motions = drive.run(odometry, frames)[1]
    assert [motion.health is Health.LOST for motion in motions] == [False] * 3 + [True] * count + [False] * (6 - count)
    after = motions[3 + count]
    assert (after.previous_tick, after.tick) == (800, 900 + 100 * count)
    allowed = max(count * EXPECTED[name].single, 8e-3 * count)  # after an unseen metre [m]
    assert np.abs(drive.errors(motions[3 + count :])[:, 3:]).max() < allowed


def test_every_frame_twice_is_the_drive_itself(drive: Drive, odometry: Odometry[Any], name: str) -> None:
    frames = [replace(frame, tick=2 * frame.tick + 100 * k) for frame in drive.frames[5:10] for k in (0, 1)]
    motions = [motion for motion in drive.run(odometry, frames)[1] if motion.tick >= 1400]
    assert [motion.health is Health.LOST for motion in motions] == [False, True] * 3
    moved = [replace(one, tick=one.tick // 2, previous_tick=one.previous_tick // 2) for one in motions[::2]]
    assert np.abs(drive.errors(moved)[:, 3:]).max() < max(EXPECTED[name].single, 8e-3)


def test_camera_must_be_above_the_ground(name: str, calibration: StereoCalibration) -> None:
    """Its height is where the first guess of the disparities comes from."""
    with pytest.raises(ValueError, match="must be positive"):
        resolve("odometry", name, ODOMETRY)(replace(calibration, X_SC=np.eye(4)))
