"""Odometry of a rover, and the reference slip from its instruments."""

import dataclasses
import math

import numpy as np
import pytest

from estimators.context import RoverGeometry
from estimators.estimates import Health, SlipAngle
from estimators.slip.rover_odometry import LaserSlip, RoverOdometry, RoverPose
from sensors.messages import LaserFix, RoverReadings
from vehicle.rover.command import corner_wheels
from vehicle.rover.description import load_rover

WHEELS = corner_wheels(0.6, 0.55)
STEERED = RoverGeometry(
    wheels=WHEELS, wheel_radius=0.1, effective_track=0.55, max_steer=(1.0,) * 4, max_wheel_speed=5.0
)
SKID = RoverGeometry(wheels=WHEELS, wheel_radius=0.1, effective_track=0.9, max_steer=(0.0,) * 4, max_wheel_speed=5.0)
STEP = 50  # [ticks]


def readings(
    tick: int, heading: float = 0.0, speeds: tuple[float, ...] = (0.8,) * 4, steer: float = 0.0
) -> RoverReadings:
    return RoverReadings(tick=tick, heading=heading, wheel_speeds=np.array(speeds), steer=np.full(len(speeds), steer))


def slip(tick: int, value: float, health: Health = Health.OK) -> SlipAngle:
    return SlipAngle(
        tick=tick, value=value, std=0.01, health=health, wheel_slip=value, trace_offset=0.0, confidence=1.0
    )


def driven(rover: RoverGeometry, until: int, drift: float | None = None, steer: float = 0.0) -> RoverPose:
    odometry = RoverOdometry(rover)
    memory = odometry.init(0.0, 0.0, 0.0)
    for tick in range(0, until + 1, STEP):
        seen = None if drift is None else slip(tick, drift)
        memory, pose = odometry.step(memory, readings(tick, steer=steer), seen)
    return pose


def test_wheels_that_do_not_slip_are_taken_at_their_word() -> None:
    """8 cm/s for 10 s are 0.8 m ahead; exact but for rounding."""
    pose = driven(STEERED, 10_000)
    assert (pose.x, pose.y, pose.psi) == pytest.approx((0.8, 0.0, 0.0), abs=1e-12)


def test_wheels_that_crab_carry_the_body_aside() -> None:
    """All wheels at 30 degrees, compass straight: the way points where the wheels point."""
    pose = driven(STEERED, 10_000, steer=math.radians(30.0))
    assert math.atan2(pose.y, pose.x) == pytest.approx(math.radians(30.0), abs=1e-9)


def test_the_slip_angle_turns_the_way() -> None:
    """A wheel that goes aside by alpha still rolls its turns along its heading: y = x tan(alpha), once it is believed.

    Within its time constant of 3 s the drift is not believed yet: 240 mm of way times tan(10 deg) at most.
    """
    alpha = math.radians(10.0)
    pose = driven(STEERED, 20_000, drift=alpha)
    assert pose.x == pytest.approx(1.6, abs=1e-9)
    assert pose.y == pytest.approx(1.6 * math.tan(alpha), abs=0.24 * math.tan(alpha))
    assert pose.drift == pytest.approx(alpha, rel=2e-3)  # exp(-20 s / 3 s)
    assert driven(STEERED, STEP, drift=alpha).drift == pytest.approx((1.0 - math.exp(-1.0)) * alpha)


def test_slip_is_what_turns_off_from_where_the_wheels_pointed_then() -> None:
    """Body slip of a crabbing rover is crab and drift together: a body slip equal to the crab is no drift."""
    crab = math.radians(12.0)
    assert driven(STEERED, 10_000, drift=crab, steer=crab).drift == pytest.approx(0.0, abs=1e-9)


def test_a_lost_slip_angle_changes_nothing() -> None:
    """No trace is no news: the last known drift goes on."""
    odometry = RoverOdometry(STEERED)
    memory = odometry.init(0.0, 0.0, 0.0)
    for tick in range(0, 10_000, STEP):
        memory, pose = odometry.step(memory, readings(tick), slip(tick, 0.1))
    memory, after = odometry.step(memory, readings(10_000), slip(10_000, 0.0, Health.LOST))
    assert after.drift == pose.drift


def test_the_sides_of_a_skid_steered_rover_turn_it_by_its_effective_track() -> None:
    """Yaw rate is the difference of the sides' speeds over the effective track, not the tread."""
    rolling = RoverOdometry(SKID).rolling(readings(0, speeds=(0.7, 0.9, 0.7, 0.9)))
    assert rolling.yaw_rate == pytest.approx(0.1 * 0.2 / 0.9, abs=1e-12)
    assert rolling.v_x == pytest.approx(0.08, abs=1e-12)


def test_six_wheels_roll_as_four_do() -> None:
    """Sides of three wheels turn a skid-steered rover as those of two; steered wheels about one place turn about it."""
    wheels = load_rover("six_wheel_rover").places
    skid = RoverGeometry(
        wheels=wheels, wheel_radius=0.1, effective_track=0.9, max_steer=(0.0,) * 6, max_wheel_speed=5.0
    )
    turned = readings(0, speeds=(0.7, 0.9) * 3)
    assert RoverOdometry(skid).rolling(turned).yaw_rate == pytest.approx(0.1 * 0.2 / 0.9, abs=1e-12)
    steered = dataclasses.replace(skid, max_steer=(1.0,) * 6)
    rays = np.array([0.0, 2.0]) - steered.places()
    about = dataclasses.replace(
        turned, wheel_speeds=0.5 * np.linalg.norm(rays, axis=1), steer=np.arctan2(-rays[:, 0], rays[:, 1])
    )
    rolling = RoverOdometry(steered).rolling(about)
    assert rolling == pytest.approx((0.1, 0.0, 0.05), abs=1e-12)


def test_the_compass_wins_over_the_wheels_in_the_long_run() -> None:
    """Wheels that say straight, a compass that says 5 degrees: after five time constants it is 5 degrees."""
    odometry = RoverOdometry(STEERED)
    memory = odometry.init(0.0, 0.0, 0.0)
    for tick in range(0, 10_000, STEP):
        memory, pose = odometry.step(memory, readings(tick, heading=math.radians(5.0)))
    assert pose.psi == pytest.approx(math.radians(5.0), abs=math.radians(5.0) * 1.1 * math.exp(-5.0))


def test_fixes_draw_the_position_to_them() -> None:
    """A tracker that sees the rover 1 m beside where it believes to be: within a second's time constant it agrees."""
    odometry = RoverOdometry(STEERED)
    memory = odometry.init(0.0, 0.0, 0.0)
    for tick in range(0, 8_000, STEP):
        fix = LaserFix(tick=tick, p_WR=np.array([8e-5 * tick, 1.0, 0.0])) if tick % 200 == 0 else None
        memory, pose = odometry.step(memory, readings(tick), fix=fix)
    assert pose.y == pytest.approx(1.0, abs=1e-3)


def test_impossible_geometry_is_refused() -> None:
    """One line with name and value."""
    with pytest.raises(ValueError, match=r"wheel_radius = 0.0 must be positive"):
        RoverGeometry(wheels=WHEELS, wheel_radius=0.0, effective_track=0.5, max_steer=(0.0,) * 4, max_wheel_speed=1.0)
    with pytest.raises(ValueError, match=r"max_steer = \(0.0, 0.0\) must have a value for each of 4 wheels"):
        RoverGeometry(wheels=WHEELS, wheel_radius=0.1, effective_track=0.5, max_steer=(0.0,) * 2, max_wheel_speed=1.0)


@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_what_is_known_later_mends_the_way(heading: float) -> None:
    """A slip of 6 degrees that is seen as none at first, and rightly two seconds later: the way is mended.

    What is left are the two seconds that nothing has been known of later: 0.16 m times tan(6 deg), and a step.
    """
    alpha = math.radians(6.0)
    odometry = RoverOdometry(STEERED)
    memory = odometry.init(0.0, 0.0, heading)
    for tick in range(0, 20_001, STEP):
        seen = dataclasses.replace(slip(tick, 0.0), lagged_tick=tick - 2000, lagged_value=alpha, lagged_std=0.01)
        memory, pose = odometry.step(memory, readings(tick, heading), seen if tick >= 2000 else None)
    aside = math.cos(heading) * pose.y - math.sin(heading) * pose.x
    assert aside == pytest.approx((1.6 - 0.16) * math.tan(alpha), abs=0.01 * math.tan(alpha))


def carried(turn: float) -> RoverPose:
    """Pose of a rover that turned by ``turn`` [rad] over 1.6 m, after its last slip angle of 0.1 rad."""
    odometry, until = RoverOdometry(STEERED), 20_000
    memory = odometry.init(0.0, 0.0, 0.0)
    for tick in range(0, until + 1, STEP):
        measured = slip(tick, 0.1) if tick <= 10_000 else None
        heading = turn * min(1.0, max(0.0, (tick - 10_000) / 5_000))
        memory, pose = odometry.step(memory, readings(tick, heading), measured)
    return pose


def test_the_drift_is_carried_on_without_slip_angles() -> None:
    """Straight on nothing has changed. After a quarter turn a slope pulls along the rover, then to the other side.

    The compass is followed within 2 s, so that 8 % of a turn are left after 5 s.
    """
    straight, quarter, half = (carried(turn) for turn in (0.0, 0.5 * math.pi, math.pi))
    assert straight.carried
    assert straight.drift == pytest.approx(0.1, abs=0.005)  # low-passed over 3 s, for 10 s: 4 % are left
    assert quarter.drift == pytest.approx(0.0, abs=0.02)
    assert half.drift == pytest.approx(-0.1, abs=0.01)


def test_some_missing_images_are_no_loss() -> None:
    """One image of 16 mm is missing: nothing is carried on; a lost estimate is none, but an old one is not new."""
    odometry = RoverOdometry(STEERED)
    memory = odometry.init(0.0, 0.0, 0.0)
    flags = []
    for tick in range(0, 4001, STEP):
        measured = slip(min(tick // 400 * 400, 2000), 0.1)  # every fifth of a second one is missing, then all
        memory, pose = odometry.step(memory, readings(tick), measured)
        flags.append(pose.carried)
    begin = flags.index(True) * STEP
    assert abs(begin - (2000 + 1250)) <= STEP  # 0.1 m at 8 cm/s
    assert all(flags[flags.index(True) :])


def test_direction_of_travel_less_heading_is_the_slip() -> None:
    """Eqs (5) and (6) on a straight way at 12 degrees with a heading of 4: exact, since the way is straight."""
    source = LaserSlip()
    memory, found = source.init(), None
    for k in range(30):
        way = 0.016 * k
        at = np.array([way * math.cos(0.2094395), way * math.sin(0.2094395), 0.0])
        memory, found = source.step(memory, LaserFix(tick=200 * k, p_WR=at), math.radians(4.0))
    assert found == pytest.approx(math.radians(8.0), abs=1e-6)


def test_a_way_too_short_has_no_direction() -> None:
    """Two fixes 16 mm apart at 3 mm of noise say nothing; neither does standing still."""
    source = LaserSlip()
    memory = source.init()
    for k in range(30):
        memory, found = source.step(memory, LaserFix(tick=200 * k, p_WR=np.array([0.0, 0.0, 0.0])), 0.0)
        assert found is None


def test_its_slip_is_that_of_half_its_span_ago() -> None:
    """A heading that turns steadily with the way on a circle: body slip zero throughout, whatever the delay.

    The chord's direction is the tangent's at its middle, and the mean heading that of the middle: 1e-3 rad of the
    fit's curvature remain.
    """
    source, rate, speed = LaserSlip(), 0.05, 0.08
    memory, found = source.init(), None
    for k in range(40):
        psi = rate * 0.2 * k
        at = speed / rate * np.array([math.sin(psi), 1.0 - math.cos(psi), 0.0])
        memory, found = source.step(memory, LaserFix(tick=200 * k, p_WR=at), psi)
    assert found == pytest.approx(0.0, abs=1e-3)
