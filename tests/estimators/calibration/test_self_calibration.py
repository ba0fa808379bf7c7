"""Self-calibration: a right camera that is turned is noticed, by how much, and its images are straightened."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimators.calibration.corrections import SelfCalibratedMotion
from estimators.calibration.epipolar import RightRotation, homography, moved, sensitivity
from estimators.calibration.mount_state import UNKNOWN, YAW, MountState, geometry, with_information
from estimators.calibration.rotation_fit import Images, View, from_motion
from estimators.calibration.self_calibration import SelfCalibratedOdometry, look_due, looked, view_due
from estimators.estimates import Health
from estimators.odometry.circular import CircularOdometry
from sensors.camera.rig import StereoCalibration
from tests.estimators.stereo_scene import Drive
from vehicle.frames import FloatArray, rotation_zyx, transform

TURNED = RightRotation(*np.radians([-0.15, 0.10, 0.05]).tolist())  # de Saxe 2018, section 4.4, and some pitch
NOISE = 0.05  # of an image coordinate [px]
MOVED = transform(rotation_zyx(0.05, 0.004, -0.003), np.array([0.3, 0.0, -5.0]))  # X_PC, backwards


def turned_image(calibration: StereoCalibration, p_Cl: FloatArray, rotation: RightRotation) -> FloatArray:
    """Images of points (n, 3) of the left camera in the rotated right one [px]."""
    p = (p_Cl - [calibration.baseline, 0.0, 0.0]) @ rotation.matrix()
    return calibration.focal_length * p[:, :2] / p[:, 2:] + [calibration.cx, calibration.cy]


def world_points(calibration: StereoCalibration, rng: np.random.Generator, n: int = 250) -> FloatArray:
    """Points (n, 3) in the left camera: ground 3 m below up to 25 m away, and things up to 80 m away."""
    rays = rng.uniform([-1.0, 0.12], [1.0, 0.32], (n, 2))
    ground = np.column_stack([rays, np.ones(n)]) * (3.0 / rays[:, 1:])
    rays = rng.uniform([-1.0, -0.3], [1.0, 0.1], (n // 3, 2))
    things = np.column_stack([rays, np.ones(n // 3)]) * rng.uniform(6.0, 80.0, (n // 3, 1))
    return np.concatenate([ground, things])


def images(calibration: StereoCalibration, p: FloatArray, rng: np.random.Generator, rotation: RightRotation) -> Images:
    def noisy(pixels: FloatArray) -> Any:
        return (pixels + NOISE * rng.standard_normal(pixels.shape)).astype(np.float32)

    variance = np.broadcast_to(NOISE**2 * np.array([1.0, 0.5, 1.0]), (len(p), 3))
    left = calibration.focal_length * p[:, :2] / p[:, 2:] + [calibration.cx, calibration.cy]
    right = turned_image(calibration, p, rotation)
    return Images(noisy(left), noisy(right), variance, geometry(0.0, UNKNOWN, calibration.baseline))


def two_views(
    calibration: StereoCalibration, seed: int, rotation: RightRotation, wrong: float = 0.0
) -> tuple[Images, Images]:
    """Images of the same points before and after the motion ``MOVED``; some of the things moved by themselves."""
    rng = np.random.default_rng(seed)
    p_P = world_points(calibration, rng)
    p_C = (p_P - MOVED[:3, 3]) @ MOVED[:3, :3]
    p_C += (rng.random(len(p_C)) < wrong)[:, None] * rng.normal(0.0, 0.3, p_C.shape)
    return images(calibration, p_P, rng, rotation), images(calibration, p_C, rng, rotation)


def fitted(calibration: StereoCalibration, views: tuple[Images, Images], X_PC: FloatArray) -> tuple[float, float]:
    """Yaw and its standard deviation [rad] from two views, roll and pitch being known from the rows of pairs."""
    prior = np.array([TURNED.roll, 0.0, TURNED.pitch])
    state = MountState(
        np.append(prior, np.zeros(3)), np.diag(np.append(np.radians([0.001, 0.4, 0.001]), np.ones(3)) ** 2)
    )
    found = from_motion(calibration, *views, X_PC, prior, state.covariance[:3, :3])
    assert found is not None
    state = with_information(state, found.information, found.gradient)
    return float(state.mean[YAW]), float(state.std[YAW])


def test_straightened_points_are_those_of_the_camera_as_calibrated(calibration: StereoCalibration) -> None:
    """Exactly, whatever their depth: a camera that turns about its optical centre sees the same rays."""
    p = world_points(calibration, np.random.default_rng(0))
    rotation = RightRotation(0.02, -0.03, 0.01)
    straight = moved(homography(calibration, rotation.matrix()), turned_image(calibration, p, rotation))
    as_calibrated = turned_image(calibration, p, RightRotation(0.0, 0.0, 0.0))
    np.testing.assert_allclose(straight, as_calibrated, atol=1e-9)


def test_sensitivity_is_the_derivative(calibration: StereoCalibration) -> None:
    q, h = np.array([[100.0, 50.0], [1200.0, 380.0], [700.0, 200.0]]), 1e-6
    for k in range(3):
        step = RightRotation(*(h * np.eye(3)[k]).tolist())
        back = RightRotation(*(-h * np.eye(3)[k]).tolist())
        difference = moved(homography(calibration, step.matrix()), q) - moved(homography(calibration, back.matrix()), q)
        np.testing.assert_allclose(sensitivity(calibration, q)[..., k], difference / (2 * h), rtol=1e-6, atol=1e-3)


@pytest.mark.parametrize("wrong", [0.0, 0.2])
def test_motion_tells_yaw(calibration: StereoCalibration, wrong: float) -> None:
    """Two views 5 m apart, also when a fifth of the points move by themselves; with an honest standard deviation."""
    ratios = []
    for seed in range(12):
        yaw, std = fitted(calibration, two_views(calibration, seed, TURNED, wrong), MOVED)
        error = yaw - TURNED.yaw
        assert abs(np.degrees(error)) < 0.006
        assert np.degrees(std) < 0.005
        ratios.append(error / std)
    # neighbours and views whose errors are alike are allowed for, and so are lenses; here there are none of these
    assert 0.15 < np.sqrt(np.mean(np.square(ratios))) < 0.7


def test_yaw_needs_a_way(calibration: StereoCalibration) -> None:
    """After 1 cm there is no parallax to compare the disparities with: yaw stays unknown."""
    p = world_points(calibration, np.random.default_rng(0))
    rng, hardly = np.random.default_rng(1), transform(np.eye(3), np.array([0.0, 0.0, -0.01]))
    pair = images(calibration, p, rng, TURNED), images(calibration, p - hardly[:3, 3], rng, TURNED)
    assert np.degrees(fitted(calibration, pair, hardly)[1]) > 0.2


def test_too_few_points_tell_nothing(calibration: StereoCalibration) -> None:
    first, second = two_views(calibration, 0, TURNED)
    few, again = (Images(v.left[:20], v.right[:20], v.variance[:20], v.geometry) for v in (first, second))
    assert from_motion(calibration, few, again, MOVED, np.zeros(3), np.eye(3)) is None


@pytest.fixture(scope="module")
def turned_drive(drive: Drive) -> Drive:
    return replace(drive, frames=[drive.knocked(frame, TURNED) for frame in drive.frames])


def self_calibrated(calibration: StereoCalibration) -> SelfCalibratedOdometry[Any]:
    return SelfCalibratedOdometry(calibration, CircularOdometry(calibration))


@pytest.fixture(scope="module")
def calibrated(turned_drive: Drive) -> list[Any]:
    return turned_drive.run(self_calibrated(turned_drive.calibration), turned_drive.frames)[1]


@pytest.mark.slow
def test_the_rotation_is_found_within_a_few_metres(calibrated: list[SelfCalibratedMotion]) -> None:
    """Roll and pitch at once, yaw after some metres, all to a few thousandths of a degree; and so they stay."""
    for motion in calibrated[1:]:
        assert abs(np.degrees(motion.right_rotation.roll - TURNED.roll)) < 0.005
        assert abs(np.degrees(motion.right_rotation.pitch - TURNED.pitch)) < 0.005
    for motion in calibrated[15:]:
        assert abs(np.degrees(motion.right_rotation.yaw - TURNED.yaw)) < 0.004


def test_its_standard_deviation_is_honest(calibrated: list[SelfCalibratedMotion]) -> None:
    """From the first frame to the last the truth lies within three standard deviations, which end small."""
    for motion in calibrated:
        ratio = (np.array(motion.right_rotation) - np.array(TURNED)) / np.array(motion.right_rotation_std)
        assert np.abs(ratio).max() < 3.0
    assert np.degrees(calibrated[0].right_rotation_std.yaw) > 0.05
    assert np.degrees(max(calibrated[-1].right_rotation_std)) < 0.006


@pytest.mark.slow
def test_motions_are_as_good_as_with_a_straight_camera(
    turned_drive: Drive, calibrated: list[SelfCalibratedMotion]
) -> None:
    """Without self-calibration the translation is wrong by per cents; with it by no more than noise."""
    plain = turned_drive.run(CircularOdometry(turned_drive.calibration), turned_drive.frames)[1]
    late = slice(10, 40)
    biased = np.abs(turned_drive.errors(plain[late])[:, 3:].mean(axis=0)).max()
    left = np.abs(turned_drive.errors(calibrated[late])[:, 3:].mean(axis=0)).max()
    assert biased > 8e-3  # 0.1 deg of yaw at 10 m is 3.5 % of depth, so of 0.5 m a frame
    assert left < 1e-3  # 0.5 m a frame, noise of 30 frames
    rms = np.sqrt(np.mean(turned_drive.errors(calibrated[late]) ** 2, axis=0))
    assert np.degrees(rms[:3]).max() < 0.005  # as for a straight pair, see test_odometries
    assert rms[3:].max() < 1.5e-3


def test_covariance_covers_the_time_before_yaw_is_known(
    turned_drive: Drive, calibrated: list[SelfCalibratedMotion]
) -> None:
    assert np.mean(np.abs(turned_drive.normalised(calibrated)) < 2.5) > 0.95
    assert np.sqrt(calibrated[0].covariance[5, 5]) > 3.0 * np.sqrt(calibrated[-5].covariance[5, 5])


@pytest.mark.slow
def test_nothing_is_done_where_nothing_is_turned(drive: Drive) -> None:
    plain = drive.run(CircularOdometry(drive.calibration), drive.frames[:30])[1]
    watched: list[Any] = drive.run(self_calibrated(drive.calibration), drive.frames[:30])[1]
    for motion, same in zip(plain, watched, strict=True):
        np.testing.assert_array_equal(motion.X_PC, same.X_PC)
        assert motion.inliers == same.inliers
        assert np.abs(np.degrees(np.array(same.right_rotation))).max() < 0.02  # nothing yet, or nearly nothing


def test_a_view_that_a_turn_took_out_of_sight_is_replaced_at_once_only_in_doubt(calibration: StereoCalibration) -> None:
    """16 deg round a bend of 8 m: later frames share few points, and new views cost a fifth of the watch."""
    memory, none = self_calibrated(calibration).init(), np.empty((0, 2), np.float32)
    view = View(np.empty((0, 0), np.uint8), none, none, np.empty((0, 2)), np.empty((0, 3)), geometry(0.0, UNKNOWN, 0.5))
    assert view_due(memory)  # yaw is in doubt, and there is no view
    certain = memory.state._replace(covariance=1e-12 * np.eye(6))
    bent = memory._replace(X_VC=transform(rotation_zyx(math.radians(16.0), 0.0, 0.0), np.array([0.0, 0.3, 2.2])))
    assert look_due(bent._replace(view=view, look=4.0))
    for state, due in ((memory.state, True), (certain, False)):
        after = looked(bent._replace(view=view, look=4.0, state=state))
        assert after.view is None
        assert not look_due(after)
        assert view_due(after) is due
    far = looked(bent._replace(state=certain))._replace(X_VC=transform(np.eye(3), np.array([0.0, 0.0, 5.1])))
    assert view_due(far)


@pytest.mark.slow
def test_blinded_cameras_are_lost_and_found_again(turned_drive: Drive) -> None:
    """Black frames tell nothing of the rotation: what was known is kept, and used at once afterwards."""
    frames = list(turned_drive.frames[:25])
    frames[12:14] = map(turned_drive.dark, frames[12:14])
    motions: list[Any] = turned_drive.run(self_calibrated(turned_drive.calibration), frames)[1]
    assert motions[11].health is Health.LOST
    assert motions[-1].health is not Health.LOST
    assert abs(np.degrees(motions[-1].right_rotation.yaw - TURNED.yaw)) < 0.006
    assert np.isfinite(motions[-1].covariance).all()
