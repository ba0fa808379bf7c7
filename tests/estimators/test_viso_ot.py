"""From stereo frames to off-tracking, and from exact poses."""

import math
from dataclasses import replace

import numpy as np
import pytest

from estimators.estimates import CameraOffTracking, Health, Motion, OffTracking, lost_motion
from estimators.odometry.circular import CircularOdometry
from estimators.off_tracking.reference import ReferenceOffTracking
from estimators.off_tracking.viso_ot import VisoOt
from sensors.messages import BodyPose, StereoFrame
from tests.estimators.stereo_scene import Drive
from vehicle.frames import FloatArray, inverse, rotation_zyx, transform

FOLLOW_DISTANCE = 7.0  # shorter than a trailer, so that a short drive fills the buffer [m]


@pytest.fixture(scope="module")
def estimates(drive: Drive) -> list[CameraOffTracking]:
    return drive.run(VisoOt(drive.calibration, FOLLOW_DISTANCE, CircularOdometry(drive.calibration)), drive.frames)[1]


@pytest.fixture(scope="module")
def references(drive: Drive) -> list[OffTracking]:
    poses = [BodyPose(tick=f.tick, X_WB=X_WB) for f, X_WB in zip(drive.frames, drive.bodies, strict=True)]
    return drive.run(ReferenceOffTracking(FOLLOW_DISTANCE), poses)[1]


def test_off_tracking_from_images_is_that_of_the_exact_poses(
    drive: Drive, estimates: list[CameraOffTracking], references: list[OffTracking]
) -> None:
    """The whole chain over a turn with shake: within 10 mm, as the paper has it in simulation (0.01 to 0.04 m).

    The first frame and the first pose have no estimate: a motion needs two.
    """
    assert len(estimates) == len(drive.frames) - 1
    assert [e.off_tracking.tick for e in estimates] == [reference.tick for reference in references]
    pairs = [(e.off_tracking, r) for e, r in zip(estimates, references, strict=True) if r.health is Health.OK]
    assert len(pairs) > 25
    assert np.ptp([reference.value for _, reference in pairs]) > 0.3  # [m] the case turns
    errors = np.array([estimate.value - reference.value for estimate, reference in pairs])
    assert np.sqrt(np.mean(errors**2)) < 0.010
    ratios = errors / np.array([estimate.std for estimate, _ in pairs])
    assert np.abs(ratios).max() < 5.0  # neighbouring values share their increments, and so their bias
    assert all(estimate.health is Health.OK for estimate, _ in pairs)
    assert max(reference.std for _, reference in pairs) < 0.005  # [m] a bank that 1 cm of shake would be seen on


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


def test_lost_frame_is_without_health_and_leaves_no_trace(drive: Drive, estimates: list[CameraOffTracking]) -> None:
    """A dark frame in mid-turn: no value at its tick; the next motion spans the gap and the buffer is whole again."""
    viso_ot = VisoOt(drive.calibration, FOLLOW_DISTANCE, CircularOdometry(drive.calibration))
    frames = [*drive.frames[:34], drive.dark(drive.frames[34]), *drive.frames[35:38]]
    lost, after = (estimate.off_tracking for estimate in drive.run(viso_ot, frames)[1][33:35])
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
        stated.append(drive.run(viso_ot, drive.frames)[1][-1].off_tracking)
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
        return k + 1, replace(
            lost_motion(100 * k, 100 * k - 100), X_PC=X_PC, covariance=np.zeros((6, 6)), health=Health.OK
        )


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
    last = drive.run(viso_ot, [drive.frames[0]] * len(bodies))[1][-1].off_tracking
    assert last.health is Health.OK
    assert (last.value, last.v_y) == pytest.approx((0.0, 0.0), abs=1e-6)
