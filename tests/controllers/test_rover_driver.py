"""A rover's path following, on wheels that slip as they are told to."""

import math

import numpy as np
import pytest

from controllers.path import Path, arc, line
from controllers.rover_driver import Compensation, RoverDriver
from estimators.context import RoverGeometry
from estimators.slip.rover_odometry import Rolling, RoverOdometry, RoverPose
from sensors.messages import RoverReadings
from vehicle.frames import Pose2
from vehicle.rover.command import corner_wheels
from vehicle.rover.description import load_rover

WHEELS, SIX_PLACES = corner_wheels(0.6, 0.55), load_rover("six_wheel_rover").places


def geometry(max_steer: tuple[float, ...], effective_track: float) -> RoverGeometry:
    """A rover with four or six wheels, by the limits of their angles [rad]; wheels at 0 cannot be steered."""
    wheels = WHEELS if len(max_steer) == 4 else SIX_PLACES
    return RoverGeometry(
        wheels=wheels, wheel_radius=0.1, effective_track=effective_track, max_steer=max_steer, max_wheel_speed=5.0
    )


STEERED, SIX = geometry((1.0,) * 4, 0.55), geometry((1.0,) * 6, 0.6)
SKID, SIX_SKID = geometry((0.0,) * 4, 0.9), geometry((0.0,) * 6, 1.3)
CORNERS = geometry((1.0, 1.0, 0.0, 0.0, 1.0, 1.0), 0.6)
FRONT = geometry((1.0, 1.0, 0.0, 0.0), 0.55)  # as a car
SPEED, DT = 0.08, 0.05
STRAIGHT = Path(Pose2(0.0, 0.0, 0.0), (line(7.0),))


def lateral_errors(
    rover: RoverGeometry, compensation: Compensation, *, slip: float, path: Path = STRAIGHT, y: float = 0.0
) -> np.ndarray:
    """Lateral errors [m] along a run with perfect knowledge of the pose, every wheel going ``slip`` [rad] aside."""
    driver, odometry = RoverDriver(rover, path, SPEED, compensation=compensation), RoverOdometry(rover)
    memory, pose, errors = driver.init(), np.array([0.0, y, 0.0]), []
    for k in range(int(0.95 * path.length / SPEED / DT)):
        seen = RoverPose(tick=50 * k, x=pose[0], y=pose[1], psi=pose[2], drift=slip, rolling=Rolling(SPEED, 0.0, 0.0))
        memory, command = driver.step(memory, seen)
        told = RoverReadings(
            tick=50 * k, heading=0.0, wheel_speeds=np.array(command.wheel_speed), steer=np.array(command.steer)
        )
        rolling = odometry.rolling(told)
        course = pose[2] + math.atan2(rolling.v_y, rolling.v_x) + slip
        v = math.hypot(rolling.v_x, rolling.v_y)
        pose = pose + DT * np.array([v * math.cos(course), v * math.sin(course), rolling.yaw_rate])
        on_path = path.pose(memory.station)
        errors.append(math.cos(on_path.psi) * (pose[1] - on_path.y) - math.sin(on_path.psi) * (pose[0] - on_path.x))
    return np.array(errors)


@pytest.mark.parametrize("rover", [STEERED, SKID, SIX, CORNERS, FRONT, SIX_SKID])
def test_without_slip_every_rover_comes_to_its_path(rover: RoverGeometry) -> None:
    """10 cm beside it at the start; the approach length is 0.5 m, so after 6 m e^-12 of them are left."""
    errors = lateral_errors(rover, "none", slip=0.0, y=0.1)
    assert abs(errors[-1]) < 1e-4
    assert np.abs(errors).max() <= 0.1 + 1e-9


def test_uncompensated_slip_keeps_the_rover_beside_its_path() -> None:
    """It travels along the path where the turn towards it equals the slip: tan(slip) times the approach length."""
    slip = math.radians(8.0)
    assert lateral_errors(STEERED, "none", slip=slip)[-1] == pytest.approx(0.5 * math.tan(slip), rel=0.02)


@pytest.mark.parametrize(
    ("rover", "compensation"),
    [
        (STEERED, "crab"),
        (STEERED, "heading"),
        (SKID, "heading"),
        (SIX, "crab"),
        (SIX, "heading"),
        (SIX_SKID, "heading"),
    ],
)
def test_compensated_slip_leaves_nothing(rover: RoverGeometry, compensation: Compensation) -> None:
    assert abs(lateral_errors(rover, compensation, slip=math.radians(8.0))[-1]) < 1e-4


def test_swapping_left_and_right_flips_the_way() -> None:
    path = Path(Pose2(0.0, 0.0, 0.0), (line(1.0), arc(2.0, 0.4)))
    mirrored = Path(Pose2(0.0, 0.0, 0.0), (line(1.0), arc(2.0, -0.4)))
    left = lateral_errors(STEERED, "crab", slip=0.1, path=path, y=0.05)
    right = lateral_errors(STEERED, "crab", slip=-0.1, path=mirrored, y=-0.05)
    np.testing.assert_allclose(left, -right, atol=1e-9)


@pytest.mark.parametrize("rover", [STEERED, SIX, CORNERS, FRONT])
def test_steered_wheels_roll_about_one_centre(rover: RoverGeometry) -> None:
    """On an arc every wheel's axle points at one place, and wheels that can not be steered keep straight."""
    path = Path(Pose2(0.0, 0.0, 0.0), (arc(4.0, 0.5),))
    driver = RoverDriver(rover, path, SPEED)
    memory = driver.init()
    for k in range(100):  # steering in takes some steps
        pose = RoverPose(tick=50 * k, x=0.0, y=0.0, psi=0.0, drift=0.0, rolling=Rolling(SPEED, 0.0, 0.0))
        memory, command = driver.step(memory, pose)
    steer = np.array(command.steer)
    assert np.all(steer[np.array(rover.max_steer) == 0.0] == 0.0)
    axles = np.column_stack([-np.sin(steer), np.cos(steer)])
    gaps = rover.places()
    across = axles[:, 0] * gaps[:, 1] - axles[:, 1] * gaps[:, 0]
    system = np.column_stack([-axles[:, 1], axles[:, 0]])
    centre, *_ = np.linalg.lstsq(system, across, rcond=None)
    assert system @ centre == pytest.approx(across, abs=1e-9)
    assert np.hypot(*centre) == pytest.approx(2.0, rel=0.05)


def test_wheels_stay_within_their_limits() -> None:
    """Far off its path the rover asks for the most it may."""
    driver = RoverDriver(STEERED, STRAIGHT, SPEED, compensation="crab")
    memory = driver.init()
    for k in range(100):
        pose = RoverPose(tick=50 * k, x=0.0, y=5.0, psi=2.0, drift=0.3, rolling=Rolling(SPEED, 0.0, 0.0))
        memory, command = driver.step(memory, pose)
        assert max(map(abs, command.steer)) <= max(STEERED.max_steer) + 1e-12
        assert max(map(abs, command.wheel_speed)) <= STEERED.max_wheel_speed + 1e-12


@pytest.mark.parametrize(
    ("compensation", "speed", "said"),
    [("crab", 0.08, "needs steered wheels"), ("none", 9.0, "speed = 9 m/s")],
)
def test_what_can_not_be_is_refused(compensation: Compensation, speed: float, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        RoverDriver(SKID, STRAIGHT, speed, compensation=compensation)
