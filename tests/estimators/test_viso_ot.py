"""From stereo frames to off-tracking, and from exact poses."""

from __future__ import annotations

import math

import numpy as np
import pytest

from estimators.estimates import CameraOffTracking, Health, Motion, OffTracking
from estimators.odometry.circular import CircularOdometry
from estimators.off_tracking.reference import ReferenceOffTracking
from estimators.off_tracking.viso_ot import VisoOt
from sensors.messages import BodyPose, StereoFrame
from tests.estimators.stereo_scene import Drive
from vehicle.frames import FloatArray, inverse, rotation_zyx, transform

FOLLOW_DISTANCE = 7.0  # shorter than a trailer, so that a short drive fills the buffer [m]


@pytest.fixture(scope="module")
def estimates(drive: Drive) -> list[CameraOffTracking]:
    viso_ot = VisoOt(drive.calibration, FOLLOW_DISTANCE, CircularOdometry(drive.calibration))
    memory, results = viso_ot.init(), []
    for frame in drive.frames:
        memory, estimate = viso_ot.step(memory, frame)
        if estimate is not None:
            results.append(estimate)
    return results


@pytest.fixture(scope="module")
def references(drive: Drive) -> list[OffTracking]:
    reference = ReferenceOffTracking(FOLLOW_DISTANCE)
    memory, results = reference.init(), []
    for frame, X_WB in zip(drive.frames, drive.bodies, strict=True):
        memory, off_tracking = reference.step(memory, BodyPose(tick=frame.tick, X_WB=X_WB))
        if off_tracking is not None:
            results.append(off_tracking)
    return results


def test_off_tracking_from_images_is_that_of_the_exact_poses(
    estimates: list[CameraOffTracking], references: list[OffTracking]
) -> None:
    """The whole chain over a turn with shake: within 10 mm, as the paper has it in simulation (0.01 to 0.04 m)."""
    assert [e.off_tracking.tick for e in estimates] == [reference.tick for reference in references]
    pairs = [(e.off_tracking, r) for e, r in zip(estimates, references, strict=True) if r.health is Health.OK]
    assert len(pairs) > 25
    assert np.ptp([reference.value for _, reference in pairs]) > 0.3  # [m] the case turns
    errors = np.array([estimate.value - reference.value for estimate, reference in pairs])
    assert np.sqrt(np.mean(errors**2)) < 0.010
    ratios = errors / np.array([estimate.std for estimate, _ in pairs])
    assert np.abs(ratios).max() < 5.0  # neighbouring values share their increments, and so their bias
    assert all(estimate.health is Health.OK for estimate, _ in pairs)


def test_path_and_velocity_are_those_of_the_hitch(
    estimates: list[CameraOffTracking], references: list[OffTracking]
) -> None:
    """Lever arm and axes: a rear camera 14 m behind sees the hitch go forwards at 5 m/s."""
    for estimate, reference in list(zip(estimates, references, strict=True))[20:40]:
        ours = estimate.off_tracking
        assert ours.v_x == pytest.approx(reference.v_x, abs=0.03)  # [m/s] 3 mm in 0.1 s
        assert ours.v_y == pytest.approx(reference.v_y, abs=0.03)
        assert ours.yaw_rate == pytest.approx(reference.yaw_rate, abs=np.radians(0.1))
        assert ours.hitch_direction == pytest.approx(reference.hitch_direction, abs=np.radians(0.5))
        assert ours.path_tangent == pytest.approx(reference.path_tangent, abs=np.radians(0.5))
        assert len(ours.path) == len(reference.path)
        assert np.abs(ours.path - reference.path).max() < 0.03  # [m]


def test_first_frame_and_first_pose_have_no_estimate(drive: Drive) -> None:
    """A motion needs two."""
    viso_ot = VisoOt(drive.calibration, FOLLOW_DISTANCE, CircularOdometry(drive.calibration))
    assert viso_ot.step(viso_ot.init(), drive.frames[0])[1] is None
    reference = ReferenceOffTracking(FOLLOW_DISTANCE)
    assert reference.step(reference.init(), BodyPose(tick=0, X_WB=drive.bodies[0]))[1] is None


def test_lost_frame_is_without_health_and_leaves_no_trace(drive: Drive, estimates: list[CameraOffTracking]) -> None:
    """A dark frame in mid-turn: no value at its tick; the next motion spans the gap and the buffer is whole again."""
    viso_ot = VisoOt(drive.calibration, FOLLOW_DISTANCE, CircularOdometry(drive.calibration))
    memory, results = viso_ot.init(), []
    for k, frame in enumerate(drive.frames[:38]):
        if k == 34:
            frame = drive.dark(frame)
        memory, estimate = viso_ot.step(memory, frame)
        results.append(estimate)
    dark, next_one = results[34:36]
    assert dark is not None
    assert next_one is not None
    lost, after = dark.off_tracking, next_one.off_tracking
    assert (lost.health, lost.value, lost.std) == (Health.LOST, 0.0, np.inf)
    assert lost.v_x == pytest.approx(estimates[33].off_tracking.v_x, abs=0.1)  # at the last velocity
    assert after.health is Health.OK
    assert after.value == pytest.approx(estimates[34].off_tracking.value, abs=0.01)  # two different odometries [m]


@pytest.mark.slow
def test_an_uncertain_direction_of_the_camera_widens_the_estimate_by_its_lever(drive: Drive) -> None:
    """0.2 deg turn a path of 7 m by 24 mm at the follow point; the value stays."""
    stated = []
    for direction_std in (0.0, math.radians(0.2)):
        odometry = CircularOdometry(drive.calibration)
        viso_ot = VisoOt(drive.calibration, FOLLOW_DISTANCE, odometry, direction_std=direction_std)
        memory = viso_ot.init()
        for frame in drive.frames:
            memory, estimate = viso_ot.step(memory, frame)
        assert estimate is not None
        stated.append(estimate.off_tracking)
    assert stated[1].value == stated[0].value
    widened = math.sqrt(stated[1].std ** 2 - stated[0].std ** 2)
    assert widened == pytest.approx(math.radians(0.2) * FOLLOW_DISTANCE)


class ExactOdometry:
    """Motions of cameras at given poses, (n, 4, 4)."""

    def __init__(self, poses: list[FloatArray]) -> None:
        self._poses = poses

    def init(self) -> int:
        return 0

    def step(self, memory: int, frame: StereoFrame) -> tuple[int, Motion | None]:
        k = memory
        if k == 0:
            return 1, None
        X_PC = inverse(self._poses[k - 1]) @ self._poses[k]
        tracks = np.empty((0, 4), np.float32)
        motion = Motion(
            tick=100 * k,
            previous_tick=100 * k - 100,
            X_PC=X_PC,
            covariance=np.zeros((6, 6)),
            matches=300,
            inliers=300,
            health=Health.OK,
            tracks=tracks,
        )
        return k + 1, motion


def test_points_at_the_height_of_the_roll_axis_do_not_move_as_the_body_rolls(drive: Drive) -> None:
    """Straight on, rolling by 2 deg about an axis 0.8 m up: on the ground the path would wave by 28 mm."""
    height, rolls = 0.8, math.radians(2.0) * np.sin(np.arange(100))
    axis = transform(np.eye(3), np.array([0.0, 0.0, height]))
    bodies = [
        transform(rotation_zyx(0.0, 0.0, roll), np.array([0.1 * k, 0.0, height])) @ inverse(axis)
        for k, roll in enumerate(rolls)
    ]
    odometry = ExactOdometry([X_WS @ drive.calibration.X_SC for X_WS in bodies])
    viso_ot = VisoOt(drive.calibration, FOLLOW_DISTANCE, odometry, path_height=height)
    memory = viso_ot.init()
    for _ in bodies:
        memory, estimate = viso_ot.step(memory, drive.frames[0])
    assert estimate is not None
    assert estimate.off_tracking.health is Health.OK
    assert estimate.off_tracking.value == pytest.approx(0.0, abs=1e-6)
    assert estimate.off_tracking.v_y == pytest.approx(0.0, abs=1e-6)
