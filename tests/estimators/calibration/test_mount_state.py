"""Right cameras that expose late, or are knocked: what single pairs tell of them, and what becomes of the motions."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimators.calibration import mount_state
from estimators.calibration.corrections import NONE, SelfCalibratedMotion, doubt
from estimators.calibration.epipolar import EpipolarFit, RightRotation, fitted_to_rays
from estimators.calibration.self_calibration import SelfCalibratedOdometry, ground_contradicts
from estimators.context import Odometry
from estimators.estimates import Health
from estimators.odometry.circular import CircularOdometry
from estimators.odometry.keyframe import KeyframeOdometry
from estimators.odometry.viso2 import Viso2Odometry
from estimators.rigid_motion import stretched
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from tests.estimators.stereo_scene import Drive, Scene
from vehicle.frames import FloatArray, inverse

KNOCKED = RightRotation(*np.radians([0.9, -1.0, 0.8]).tolist())
SHIFTS = [np.array([0.03, 0.01, -0.14]), np.array([0.0, 0.0, 0.12]), np.array([0.02, -0.01, -0.8])]  # [m]
SPEED = mount_state.Twist(np.zeros(3), np.array([0.0, 0.0, -5.0]), 0.0)
DELAY_S = 0.05  # of the drive below: 0.25 m at 5 m/s [s]
FRAMES = 9


def points(rng: np.random.Generator, n: int = 300) -> FloatArray:
    """Points (n, 3) in the left camera: ground 3 m below, and things."""
    rays = rng.uniform([-1.0, -0.2, 1.0], [1.0, 0.33, 1.0], (n, 3))
    depth = np.where(rays[:, 1] > 0.05, 3.0 / np.maximum(rays[:, 1], 0.05), rng.uniform(6.0, 60.0, n))
    return rays * depth[:, None]


def rays(p: FloatArray) -> FloatArray:
    return p[:, :2] / p[:, 2:]


@pytest.mark.parametrize("shift", SHIFTS)
@pytest.mark.parametrize("rotation", [RightRotation(0.0, 0.0, 0.0), KNOCKED])
def test_one_pair_tells_rotation_and_displacement(
    calibration: StereoCalibration, rotation: RightRotation, shift: FloatArray
) -> None:
    """From a start at zero; a seventh of the points is matched wrongly, and some of these are near the truth."""
    rng = np.random.default_rng(2)
    p = points(rng)
    q = rays((p - [calibration.baseline, 0.0, 0.0] - shift) @ rotation.matrix())
    q[::7] += rng.normal(0.0, 0.05, q[::7].shape)
    found = fitted_to_rays(calibration, rays(p), q, np.zeros(4), np.array([*shift[:2], 0.0]))
    assert found is not None
    np.testing.assert_allclose(found.values, [*rotation, shift[2]], atol=2e-4)


def test_its_standard_deviation_is_that_of_the_rows(calibration: StereoCalibration) -> None:
    """Independent errors of 0.1 px in all coordinates: normalised errors have a root mean square of one."""
    ratios, sigma = [], 0.1 / calibration.focal_length
    for seed in range(40):
        rng = np.random.default_rng(seed)
        p = points(rng)
        r, q = (rays(p - [x, 0.0, 0.0]) + sigma * rng.standard_normal((len(p), 2)) for x in (0.0, calibration.baseline))
        found = fitted_to_rays(calibration, r, q, np.zeros(4), np.zeros(3))
        assert found is not None
        ratios.append(found.values / np.sqrt(np.diag(found.covariance)))
    rms = np.sqrt(np.mean(np.square(ratios), axis=0))
    assert np.all((rms > 0.7) & (rms < 1.4))  # 40 samples: 0.11; robust weights cost a tenth


def test_points_that_share_no_epipolar_geometry_tell_nothing(calibration: StereoCalibration) -> None:
    rng = np.random.default_rng(3)
    r, q = rng.uniform(-0.3, 0.3, (2, 200, 2))
    assert fitted_to_rays(calibration, r, q, np.zeros(4), np.zeros(3)) is None
    assert fitted_to_rays(calibration, r[:20], r[:20] - [0.05, 0.0], np.zeros(4), np.zeros(3)) is None


def fit(roll: float = 0.0, yaw: float = 0.0, pitch: float = 0.0, shift: float = 0.0) -> EpipolarFit:
    """A fit with these angles [deg] and displacement [m], as exact as they are on rendered frames."""
    std = np.array([*np.radians([0.001, 0.004, 0.001]), 1e-3])
    return EpipolarFit(np.array([*np.radians([roll, yaw, pitch]), shift]), np.diag(std**2), 0.1)


def updated(
    state: mount_state.MountState, seen: EpipolarFit, twist: mount_state.Twist = SPEED
) -> mount_state.MountState:
    return mount_state.with_fit(state, mount_state.innovation(state, seen, twist, 0.5), 1.0)


def test_a_lens_error_looks_like_yaw_until_motion_tells_them_apart() -> None:
    """0.2 deg in the rows of 30 pairs leave yaw uncertain by 0.1 deg; once it is known, a knock shows at once."""
    state = mount_state.initial()
    for _ in range(30):
        state = updated(state, fit(yaw=0.2))
    assert np.degrees(state.std[mount_state.YAW]) > 0.1
    exact = np.diag([0.0, np.radians(0.002) ** -2, 0.0])
    state = mount_state.with_information(state, exact, exact @ (np.zeros(3) - state.mean[:3]))
    assert np.degrees(state.mean[[mount_state.YAW, mount_state.LENS]]) == pytest.approx([0.0, 0.2], abs=0.01)
    assert mount_state.is_surprising(state, mount_state.innovation(state, fit(yaw=0.5), SPEED, 0.5))
    state = updated(mount_state.reopened(state), fit(yaw=0.5))
    assert np.degrees(state.mean[mount_state.YAW]) == pytest.approx(0.3, abs=0.02)
    assert np.degrees(state.std[mount_state.YAW]) < 0.05


def test_speed_tells_a_delay_from_an_offset() -> None:
    """10 ms at 5 and at 10 m/s beside a constant 3 mm."""
    state = mount_state.initial()
    for k in range(40):
        v = -5.0 - 5.0 * (k % 2)
        state = updated(state, fit(shift=0.01 * v + 0.003), SPEED._replace(velocity=np.array([0.0, 0.0, v])))
    assert state.mean[mount_state.DELAY] == pytest.approx(0.01, abs=3e-4)
    assert state.mean[mount_state.OFFSET] == pytest.approx(0.003, abs=2e-3)


@pytest.mark.parametrize(
    ("yaw_deg", "std_deg", "left_over", "correcting", "health"),
    [
        (0.05, 0.002, 0.0, False, Health.DEGRADED),
        (-0.21, 0.002, 0.0, False, Health.LOST),
        (0.21, 0.1, 0.0, False, Health.OK),  # what is uncertain refutes nothing
        (-0.26, 0.1, 0.0, False, Health.LOST),  # unless no lens is as wrong
        (0.21, 0.002, 0.0, True, Health.OK),  # it will be removed
        (0.0, 0.002, 0.2, True, Health.DEGRADED),
        (0.0, 0.002, -0.3, False, Health.LOST),
    ],
)
def test_a_pair_is_doubted_for_what_is_not_corrected(
    calibration: StereoCalibration, yaw_deg: float, std_deg: float, left_over: float, correcting: bool, health: Health
) -> None:
    """A wrong yaw of a calibration that is only watched, or a displacement, in baselines, that is not compensated."""
    state = mount_state.MountState(np.radians([0.0, yaw_deg, 0.0, 0.0, 0.0, 0.0]), np.radians(std_deg) ** 2 * np.eye(6))
    found = doubt(calibration, state, NONE, 5.0, left_over * calibration.baseline, correcting=correcting)
    assert found.health is health
    assert found.shift == pytest.approx(abs(left_over) * calibration.baseline)
    assert found.refuted == (yaw_deg != 0.0 and health is not Health.OK)
    known = correcting or abs(yaw_deg) > min(4.0 * std_deg, 0.25)
    assert np.degrees(found.angles[1]) == pytest.approx(math.hypot(yaw_deg, std_deg) if known else 0.0, abs=1e-3)


def test_a_standing_camera_learns_nothing_of_a_delay() -> None:
    state = mount_state.initial()
    for _ in range(20):
        state = updated(state, fit(), SPEED._replace(velocity=np.zeros(3)))
    assert state.std[mount_state.DELAY] == pytest.approx(mount_state.initial().std[mount_state.DELAY])


@pytest.fixture(scope="module")
def late(drive: Drive) -> Drive:
    """The first frames of the drive, their right images exposed late."""
    scene, rng, calibration = Scene(drive.calibration), np.random.default_rng(5), drive.calibration
    frames = []
    for k, frame in enumerate(drive.frames[:FRAMES]):
        onwards = stretched(inverse(drive.bodies[k]) @ drive.bodies[k + 1], DELAY_S / 0.1)
        X_WC = drive.bodies[k] @ onwards @ calibration.X_SC
        frames.append(replace(frame, right=scene.view(X_WC @ calibration.X_ClCr, rng)))
    return replace(drive, frames=frames)


def run(odometry: Odometry[Any], frames: Sequence[StereoFrame]) -> list[SelfCalibratedMotion]:
    return [motion for motion in Drive.run(odometry, frames)[1] if isinstance(motion, SelfCalibratedMotion)]


def calibrating(drive: Drive, frames: Sequence[StereoFrame], *, correcting: bool = True) -> list[SelfCalibratedMotion]:
    """Motions of the circular odometry that calibrates itself."""
    alone = CircularOdometry(drive.calibration)
    return run(SelfCalibratedOdometry(drive.calibration, alone, correcting=correcting), frames)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [KeyframeOdometry, CircularOdometry])
def test_a_late_right_camera_is_noticed_and_compensated(late: Drive, kind: Any) -> None:
    """0.25 m between the exposures: from the second motion on the delay is known and the motions are right."""
    motions = run(SelfCalibratedOdometry(late.calibration, kind(late.calibration), correcting=False), late.frames)
    assert motions[0].health is Health.LOST
    assert motions[-1].right_delay == pytest.approx(DELAY_S, abs=3.0 * motions[-1].right_delay_std)
    assert motions[-1].right_delay_std < 4e-3
    found = [motion for motion in motions[1:] if motion.health is not Health.LOST]
    assert len(found) == len(motions) - 1
    assert np.abs(late.errors(found)[3:, 3:]).max() < 0.05  # of 0.5 m, with 0.25 m between the exposures
    assert np.mean(np.abs(late.normalised(found)) < 2.5) > 0.95


def test_an_odometry_that_cannot_compensate_is_lost(late: Drive) -> None:
    viso2 = Viso2Odometry(late.calibration)
    motions = run(SelfCalibratedOdometry(late.calibration, viso2), late.frames[:4])
    assert all(motion.health is Health.LOST for motion in motions)


def test_a_degree_in_every_angle_is_found_from_the_start(drive: Drive) -> None:
    """The first pair applies what it shows; after a metre and a half the rotation is known to 0.01 deg."""
    frames = [drive.knocked(frame, KNOCKED) for frame in drive.frames[:6]]
    motions = calibrating(drive, frames)
    assert all(motion.health is not Health.LOST for motion in motions)
    assert np.abs(np.degrees(np.array(motions[-1].right_rotation) - KNOCKED)).max() < 0.01
    assert np.abs(drive.errors(motions)[3:, 3:]).max() < 3e-3


def test_a_knock_costs_one_frame(drive: Drive) -> None:
    """The first pair after it contradicts the estimate and is lost; the second one confirms it."""
    frames = [drive.knocked(f, KNOCKED) if k >= 8 else f for k, f in enumerate(drive.frames[:12])]
    motions = calibrating(drive, frames)
    assert [motion.health is Health.LOST for motion in motions] == [k == 7 for k in range(11)]
    assert motions[8].previous_tick == frames[8].tick
    assert np.abs(np.degrees(np.array(motions[-1].right_rotation) - KNOCKED)).max() < 0.05
    assert np.abs(drive.normalised(motions[8:])).max() < 3.0


@pytest.mark.slow
def test_a_passing_disturbance_leaves_the_calibration_as_it_was(drive: Drive) -> None:
    """The right camera is turned for five frames: after the second sound pair it is known as well as before."""
    frames = [drive.knocked(f, KNOCKED) if 10 <= k < 15 else f for k, f in enumerate(drive.frames[:18])]
    motions = calibrating(drive, frames)
    before, after = motions[8], motions[15]
    assert all(motion.health is not Health.LOST for motion in motions[15:])
    assert np.abs(np.degrees(np.array(after.right_rotation) - before.right_rotation)).max() < 0.01
    assert max(np.array(after.right_rotation_std) / before.right_rotation_std) < 1.5
    assert np.abs(drive.normalised(motions[15:])).max() < 3.0


@pytest.mark.slow
def test_a_calibration_that_is_only_watched_is_refuted(drive: Drive) -> None:
    """0.09 deg of yaw: degraded after the first metre, with the error covered; a degree: lost."""

    def watched(yaw_deg: float) -> list[SelfCalibratedMotion]:
        rotation = RightRotation(0.0, float(np.radians(yaw_deg)), 0.0)
        frames = [drive.knocked(frame, rotation) for frame in drive.frames[:8]]
        return calibrating(drive, frames, correcting=False)

    assert not any(motion.miscalibrated for motion in watched(0.0))
    slightly = watched(0.09)[3:]
    assert all(motion.miscalibrated and motion.health is Health.DEGRADED for motion in slightly)
    assert np.mean(np.abs(drive.normalised(slightly)) < 2.5) > 0.95
    assert all(motion.health is Health.LOST for motion in watched(-1.0))


def test_a_short_motion_is_checked_by_the_ground(drive: Drive) -> None:
    """At 5 m/s the ground moves on, and from frame 42 on the trailer stands: neither is a slower motion, nor none."""
    images = [frame.left for frame in drive.frames]

    def contradicts(first: int, X_PC: FloatArray) -> bool:
        return ground_contradicts(drive.calibration, images[first], images[first + 1], X_PC)

    assert not any(contradicts(first, drive.camera_motion(first, first + 1)) for first in range(8, len(images) - 1))
    assert contradicts(10, np.eye(4))
    assert contradicts(10, stretched(drive.camera_motion(10, 11), 0.2))
    assert contradicts(44, stretched(drive.camera_motion(10, 11), 0.5))
    dark = np.zeros_like(images[0])
    assert not ground_contradicts(drive.calibration, dark, images[0], np.eye(4))


def test_yaw_and_delay_are_told_apart_in_a_turn() -> None:
    """Views whose delay was compensated with 1 ms too little see the rest of it as yaw: 0.2 rad/s times 1 ms."""
    state = updated(mount_state.initial(), fit(shift=-0.25))  # 50 ms at 5 m/s
    turning = SPEED._replace(turn=np.array([0.0, 0.2, 0.0]))
    exact = np.diag([0.0, np.radians(0.001) ** -2, 0.0])
    seen = state.mean[:3] + np.array([0.0, 2e-4, 0.0])
    found = mount_state.with_information(
        state, exact, exact @ (seen - state.mean[:3]), turning, float(state.mean[mount_state.DELAY])
    )
    assert found.mean[mount_state.YAW] + 0.2 * (
        found.mean[mount_state.DELAY] - state.mean[mount_state.DELAY]
    ) == pytest.approx(seen[1], abs=2e-5)
    assert found.std[mount_state.YAW] > np.radians(0.005)  # the delay is known to 1 ms, not better


def test_in_a_turn_a_known_delay_explains_the_yaw_that_a_pair_shows() -> None:
    """50 ms at 0.2 rad/s are 0.57 deg: they are no knock of the right camera, which is 0.1 m slower at its end."""
    state = mount_state.initial()
    exact = np.diag([0.0, np.radians(0.002) ** -2, 0.0])
    state = mount_state.with_information(updated(state, fit(shift=-0.25)), exact, exact @ -state.mean[:3])
    turning = SPEED._replace(turn=np.array([0.0, 0.2, 0.0]))
    seen = mount_state.innovation(state, fit(yaw=math.degrees(0.2 * DELAY_S), shift=-0.255), turning, 0.5)
    assert not mount_state.is_surprising(state, seen)
    assert np.degrees(mount_state.with_fit(state, seen, 1.0).mean[mount_state.YAW]) == pytest.approx(0.0, abs=0.02)
