"""Laws on the measured path: path preview and virtual driver, in closed loops and on given estimates."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from controllers.trailer import TrailerGeometry
from controllers.trailer_steering.path_laws import PathPreview, VirtualDriver
from estimators.estimates import Health, OffTracking
from scenarios.courses import roundabout, straight
from tests.trailers import ALL_STEERED as TRAILER
from tests.trailers import TWO_OF_THREE, estimate, signals, steps

SINGLE = replace(TRAILER, axle_distances=(9.31,), steered=(True,))
ROUNDABOUT = roundabout(front_x=5.2, width=2.55)


def tuned(**parameters: float) -> PathPreview:
    return PathPreview(TRAILER, parameters=PathPreview.Parameters(**parameters))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "trailer", "rms", "worst"),
    [
        (PathPreview, SINGLE, 0.008, 0.03),
        (PathPreview, TWO_OF_THREE, 0.008, 0.03),
        (VirtualDriver, TRAILER, 0.012, 0.04),
    ],
)
def test_the_follow_point_keeps_to_the_path_round_a_roundabout(
    drive: Any, law: Any, trailer: TrailerGeometry, rms: float, worst: float
) -> None:
    """Beats the buffer-only law without prediction, 0.021 m RMS and 0.094 m at most (10 km/h, 0.1 s and 0.15 s late).

    What is left comes from the turn out of the circle, which the hitch begins before any estimate shows it.
    """
    run = drive(ROUNDABOUT, trailer, law(trailer))
    assert run.rms < rms
    assert run.worst < worst


@pytest.mark.slow
def test_required_angles_and_rates_in_the_roundabout(drive: Any) -> None:
    """Domain reference A.3, perfect path following at 10 km/h: peak at the exit, steady, counter-steer, rate.

    With fresh estimates and quick actuators the loop comes close to perfect: corrections of some mm take up to 0.6 deg.
    """
    quick = replace(TRAILER, actuator_lag=0.02, max_steer_rate=2.0)
    run = drive(ROUNDABOUT, quick, PathPreview(quick), latency=0.0)
    degrees = np.degrees(run.steer)
    steady = degrees[np.searchsorted(run.station, 105.0)]  # at the end of the circle
    assert -degrees.min(axis=0) == pytest.approx([14.4, 20.9, 27.7], abs=0.6)
    assert -steady == pytest.approx([7.7, 17.5, 26.3], abs=0.15)
    assert degrees.max(axis=0) == pytest.approx([5.5, 2.8, 1.2], abs=0.6)


def sliding_outwards(lateral_acceleration: float) -> float:
    """Mean slip of axles with 4.6 F_z/rad, half as stiff again as assumed, and 1 deg from a cross-fall."""
    return -1.5 * 0.022 * lateral_acceleration - 0.0175


@pytest.mark.slow
def test_slip_is_estimated_and_steered_against(drive: Any) -> None:
    """1 deg is 0.24 m at 14 m. Left to the gain alone, a slip of s leaves s / gain; estimated, next to nothing."""
    straight_on = straight(front_x=5.2, length=55.0)
    estimated = drive(straight_on, TRAILER, PathPreview(TRAILER), slip=sliding_outwards)
    ignorant = tuned(integral=0.0, compliance=0.0, slip_distance=100.0, gain=0.5)
    left_to_gain = drive(straight_on, TRAILER, ignorant, slip=sliding_outwards)
    assert abs(estimated.off_tracking[-1]) < 0.005  # what the closing of the loop left in the integral, dying out
    assert (
        abs(left_to_gain.off_tracking[-1]) > 0.02
    )  # 100 m of low-pass see two fifths of it in 55 m: 0.0175 * 0.6 / gain


@pytest.mark.slow
def test_foreseeing_the_inertial_slip_pays(drive: Any) -> None:
    """With tyres as assumed, the slip of a turn is compensated at its beginning, not 1.5 m later.

    A tenth less error into the turn and round it; foreseen and measured twice over, it would be several times more.
    """
    tyres: Any = {"slip": lambda lateral_acceleration: -0.022 * lateral_acceleration, "speed_kmh": 15.0, "until": 20.0}
    foreseen = drive(ROUNDABOUT, TRAILER, tuned(slip_distance=1.5), **tyres)
    only_measured = drive(ROUNDABOUT, TRAILER, tuned(slip_distance=1.5, compliance=0.0), **tyres)
    assert foreseen.rms < 0.9 * only_measured.rms


@pytest.mark.slow
def test_cornering_on_softer_tyres_than_assumed_stays_within_the_bars(drive: Any) -> None:
    """Slip that comes and goes with the turn, half of it not foreseen; after the loop has closed on the entry."""
    run = drive(ROUNDABOUT, TWO_OF_THREE, PathPreview(TWO_OF_THREE), slip=sliding_outwards)
    error = run.off_tracking[run.station > 29.0]
    assert math.sqrt(float(np.nanmean(error**2))) < 0.02
    assert np.nanmax(np.abs(error)) < 0.06


# The law alone, on given estimates.

PATH = estimate(0).path


def beside(tick: int, *, offset: float = 0.0, **changes: Any) -> OffTracking:
    """Straight travel with the path ``offset`` to the left of the trailer's axis."""
    return estimate(tick, value=offset, path=PATH + np.array([0.0, offset]), **changes)


def arriving(**about: Any) -> Any:
    """A new estimate every 0.1 s, 0.1 s old."""
    return lambda tick: beside(tick // 100 * 100 - 100, **about) if tick >= 100 else None


def test_the_axles_stay_where_they_are_when_the_news_is_too_old() -> None:
    """A path of 2 s ago says nothing of where the trailer is: who guards the law gives the axles to something else."""
    law = PathPreview(TRAILER)
    memory, _ = steps(law, 1000, arriving(offset=0.2))
    lost = beside(950, offset=0.2, health=Health.LOST)
    _, after = steps(law, 6000, lambda tick: lost, memory, 1000)
    still = after[100:]  # from 2 s after the last usable one's capture, and a tenth
    np.testing.assert_array_equal(still, np.broadcast_to(still[0], still.shape))


def short_of_the_follow_point(tick: int, *, v_y: float, length: float = 8.0) -> OffTracking:
    """An estimate while the buffer fills: no health, as the path does not reach back yet, but a motion."""
    seen = beside(tick, health=Health.LOST)
    return replace(seen, path=PATH[-PATH[:, 0] <= length], v_y=v_y, hitch_direction=math.atan2(v_y, seen.v_x))


def test_slip_is_taken_away_before_there_is_a_path_to_follow() -> None:
    """The trailer crabs at 1 deg with straight wheels: turned by 1 deg to where it goes, they roll along its axis.

    A trailer that moves along its own axis needs the angles that undo its slip, and the sum of both is zero: after 3 s
    at 2.8 m/s, 5 distances of the low-pass, all but 1 % is seen.
    """
    law, memory = PathPreview(TRAILER), PathPreview(TRAILER).init()
    slip = math.tan(math.radians(1.0))
    angles = np.zeros(3)
    for tick in range(0, 3000, 20):
        crab = (slip + float(np.mean(np.tan(angles)))) * 2.8
        seen = short_of_the_follow_point(tick // 100 * 100 - 100, v_y=crab) if tick >= 100 else None
        memory, command = law.step(memory, tick, seen, signals(tick, angles=angles))
        angles = command.angles
    assert np.degrees(angles) == pytest.approx([-1.0] * 3, abs=0.05)


def test_a_standing_trailer_does_not_wind_up() -> None:
    """The integral runs over the way, not over time."""
    law = tuned(integral=0.5)
    memory, _ = steps(law, 1000, arriving(offset=0.2))
    after, _ = steps(law, 61000, arriving(offset=0.2, v_x=0.0), memory._replace(bias=0.03), 1000)
    assert after.bias == pytest.approx(0.03, abs=0.02)  # the last moving estimate still counts for 0.1 s


@pytest.mark.parametrize(("radius", "rate"), [(30.0, 0.0), (-50.0, 0.02), (1e6, 0.05)])
def test_slip_of_a_turn_is_foreseen_before_it_is_measured(radius: float, rate: float) -> None:
    """0.022 rad per m/s2 of the axles' acceleration: between that of the hitch and v^2/R on the path at the rear."""
    quick, speed = replace(TRAILER, max_steer_rate=1e4, actuator_lag=0.0), 5.0
    turning = replace(on_circle(abs(radius)), hitch_direction=0.0, hitch_direction_rate=rate, v_x=speed, v_y=0.0)
    path = turning.path * np.array([1.0, math.copysign(1.0, radius)])
    turning = replace(turning, path=path, yaw_rate=speed / radius)
    commands = []
    for compliance in (0.022, 0.0):
        law = PathPreview(quick, parameters=PathPreview.Parameters(compliance=compliance, gain=0.0, integral=0.0))
        memory, _ = law.step(law.init(), 0, turning, signals(0, angles=np.zeros(3)))
        commands.append(np.tan(law.step(memory, 1, turning, signals(1, angles=np.zeros(3)))[1].angles))
    share = float(np.mean(TRAILER.axle_distances)) / 14.0
    slip = -0.022 * ((1.0 - share) * speed * (rate + speed / radius) + share * speed**2 / radius)
    assert commands[0] - commands[1] == pytest.approx(np.full(3, -slip), rel=0.03)  # the trailer goes on for 11 ms


# Virtual driver


def on_circle(radius: float, tick: int = 0) -> OffTracking:
    """A trailer that follows perfectly: hitch and follow point on the circle, whose chord is its axis."""
    angles = np.linspace(0.0, 2.2 * math.asin(7.0 / radius), 150)
    tangent = math.asin(7.0 / radius)
    along = -radius * (np.sin(angles - tangent) + math.sin(tangent))
    across = radius * (math.cos(tangent) - np.cos(angles - tangent))
    return estimate(
        tick,
        path=np.column_stack([along, across]),
        hitch_direction=tangent,
        path_tangent=-tangent,
        v_x=2.8 * math.cos(tangent),
        v_y=2.8 * math.sin(tangent),
        yaw_rate=2.8 / radius,
    )


def test_a_steady_turn_needs_no_error() -> None:
    """On a wide circle the angles of perfect following, -(x - Lf/2)/R, are kept without an error."""
    exact = -np.arctan((np.array(TRAILER.axle_distances) - 7.0) / math.sqrt(200.0**2 - 49.0))
    law = VirtualDriver(TRAILER)
    memory = law.init()
    for tick in range(0, 3000, 20):
        memory, command = law.step(memory, tick, on_circle(200.0, tick), signals(tick, angles=exact, speed=2.8))
    np.testing.assert_allclose(command.angles, exact, atol=1e-4)  # the path's points lie 0.2 m apart


@pytest.mark.parametrize("lag", [0.15, 0.4])
@pytest.mark.parametrize("speed", [2.8, 8.0, 16.0, 28.0])
def test_the_crossover_leaves_the_same_phase_at_every_speed(speed: float, lag: float) -> None:
    """A path that begins to lie 0.05 m to the left: the turn of the follow point per error, times v, is the crossover.

    Times the tyres' lag and a quarter of the others (0.1 s old, half of 0.1 s, the actuators) it stays below 0.7 rad.
    """
    trailer = replace(TRAILER, actuator_lag=lag, max_steer_rate=100.0)
    law = VirtualDriver(trailer, parameters=VirtualDriver.Parameters(integral=0.0))
    offset, memory = 0.05, law.init()
    path = np.column_stack([-np.linspace(0.0, 20.0, 81), np.full(81, offset)])
    for tick in (0, 100):
        beside = replace(on_circle(200.0, tick), path=path, hitch_direction=0.0, v_x=speed, v_y=0.0, yaw_rate=0.0)
        # the first command is limited to the initial angle: the second starts from straight wheels too
        memory, command = law.step(memory, tick + 100, beside, signals(tick + 100, angles=np.zeros(3), speed=2.8))
    distances = np.array(trailer.axle_distances)
    follow = np.arctan(np.tan(command.angles) * trailer.follow_distance / distances)
    np.testing.assert_allclose(follow, follow[0], rtol=0.01)  # one centre for all axles; share of small angles
    lags = 0.5 / speed + 0.022 * speed + 0.25 * (0.15 + lag)
    assert follow[0] / offset * speed == pytest.approx(min(speed / 1.5, 0.7 / lags), rel=0.02)


def test_a_trailer_keeps_enough_of_its_alignment_at_speed() -> None:
    """The direction of the path ahead is followed in full at walking pace, by less than half at 60 km/h."""
    law = VirtualDriver(replace(TRAILER, max_steer_rate=100.0), parameters=VirtualDriver.Parameters(integral=0.0))
    path = np.column_stack([-np.linspace(0.0, 20.0, 81), -0.02 * (np.linspace(0.0, 20.0, 81) - 14.0)])
    angles = []
    for speed in (2.8, 16.7):
        memory = law.init()
        for tick in (0, 100):
            along = replace(on_circle(200.0, tick), path=path, hitch_direction=0.02, v_x=speed, v_y=0.0, yaw_rate=0.0)
            along = replace(along, v_y=0.02 * speed, hitch_direction_rate=0.0)
            memory, command = law.step(memory, tick + 100, along, signals(tick + 100, angles=np.zeros(3), speed=2.8))
        angles.append(abs(float(command.angles[0])))
    assert angles[1] < 0.5 * angles[0]


@pytest.mark.slow
def test_integral_or_derivative_take_away_what_slip_leaves(drive: Any) -> None:
    """1 deg of slip on a straight road: proportion alone leaves 0.04 m."""
    course = straight(front_x=5.2, length=70.0)
    left = {
        (integral, derivative): drive(
            course,
            TRAILER,
            VirtualDriver(TRAILER, parameters=VirtualDriver.Parameters(integral=integral, derivative=derivative)),
            slip=lambda lateral_acceleration: -0.0175,
        ).off_tracking[-1]
        for integral, derivative in ((0.0, 0.0), (0.06, 0.0), (0.0, 1.0))
    }
    assert abs(left[0.0, 0.0]) > 0.02
    assert abs(left[0.06, 0.0]) < 0.005
    assert abs(left[0.0, 1.0]) < 0.005


def test_a_lost_estimate_changes_nothing() -> None:
    law = VirtualDriver(TRAILER)
    memory, _ = law.step(law.init(), 0, on_circle(20.0), signals(0, angles=np.zeros(3), speed=2.8))
    lost = replace(on_circle(-20.0, 20), health=Health.LOST, std=math.inf)
    _, seen = law.step(memory, 40, lost, signals(40, angles=np.zeros(3), speed=2.8))
    _, unseen = law.step(memory, 40, on_circle(20.0), signals(40, angles=np.zeros(3), speed=2.8))
    np.testing.assert_array_equal(seen.angles, unseen.angles)
