"""The driver, on a tractor that rolls without slip and on given perceptions."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers.driver import DriverMemory, PreviewDriver
from controllers.path import Path, Segment, arc, line
from controllers.tractor import TractorGeometry
from controllers.trailer_steering.signal_laws import Unsteered
from scenarios.courses import figure_of_eight, roundabout, straight
from sensors.messages import EgoState
from tests.trailers import TWO_OF_THREE as TRAILER
from vehicle.frames import Pose2

TRACTOR = TractorGeometry(wheelbase=3.8, x_ref=5.2, y_ref=-1.275, max_steer=0.75, max_steer_rate=0.5, actuator_lag=0.1)
PATH = Path(Pose2(5.2, -1.275, 0.0), (line(10.0), arc(60.0, 0.08), line(10.0)))


def ego(tick: int = 0, /, **motion: float) -> EgoState:
    at_rest = EgoState(tick=tick, x=0.0, y=0.0, psi=0.0, v_x=0.0, v_y=0.0, yaw_rate=0.0)
    return replace(at_rest, **motion)  # type: ignore[arg-type]  # of any field, for mypy


@pytest.mark.slow
@pytest.mark.parametrize(("speed_kmh", "allowed"), [(10.0, 0.01), (15.0, 0.02)])
def test_the_guided_point_stays_on_a_figure_of_eight(drive: Any, speed_kmh: float, allowed: float) -> None:
    """Without tyre slip only the steering's delay is left: a third of what 3 cm allow with slip at 10 km/h."""
    run = drive(figure_of_eight(front_x=5.2, width=2.55), TRAILER, Unsteered(TRAILER), speed_kmh=speed_kmh)
    assert run.guided.max() < allowed


def test_steering_round_a_circle_has_the_closed_form_angle(drive: Any) -> None:
    """Front corner on R: the rear axle runs on sqrt(R^2 - x_ref^2) - width/2, and tan(delta) = wheelbase / that."""
    run = drive(roundabout(front_x=5.2, width=2.55), TRAILER, Unsteered(TRAILER))
    rear_radius = math.sqrt(12.5**2 - 5.2**2) - 1.275
    round_circle = run.tractor_steer[(run.station > 95.0) & (run.station < 105.0)]
    # The entry dies out over x_ref / cos(chi) = 5.7 m, chi = asin(5.2/12.5): exp(-65/5.7) of 0.4 rad is left.
    assert round_circle == pytest.approx(math.atan(3.8 / rear_radius), abs=1e-5)
    assert run.guided.max() < 0.01


def test_steer_demand_stays_within_the_limit() -> None:
    """A tractor that stands across its path asks for more than full lock."""
    driver = PreviewDriver(TRACTOR, PATH, 2.8)
    demands = [driver.step(driver.init(), 0, ego(psi=psi, v_x=2.8))[1].steer for psi in np.linspace(-1.5, 1.5, 31)]
    assert max(demands) == TRACTOR.max_steer
    assert min(demands) == -TRACTOR.max_steer


motions = st.fixed_dictionaries(
    {
        "x": st.floats(0.0, 10.0),
        "y": st.floats(-1.0, 1.0),
        "psi": st.floats(-0.5, 0.5),
        "v_x": st.floats(-1.0, 5.0),
        "v_y": st.floats(-0.2, 0.2),
        "yaw_rate": st.floats(-0.4, 0.4),
    }
)


@given(motions, st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_mirror_symmetry(motion: dict[str, float], steer: float, demand: float) -> None:
    """Swapping left and right flips the steer demand and leaves the acceleration."""
    before = DriverMemory(tick=0, station=3.0, demand=demand, steer=steer, front_slip=0.01, speed_integral=0.1)
    image = before._replace(demand=-demand, steer=-steer, front_slip=-0.01)
    segments = tuple(Segment(s.length, -s.start_curvature, -s.end_curvature) for s in PATH.segments)
    mirrored_path = Path(Pose2(PATH.start.x, -PATH.start.y, 0.0), segments)
    flipped = motion | {name: -motion[name] for name in ("y", "psi", "v_y", "yaw_rate")}
    _, command = PreviewDriver(TRACTOR, PATH, 2.8).step(before, 20, ego(20, **motion))
    mirrored_driver = PreviewDriver(replace(TRACTOR, y_ref=-TRACTOR.y_ref), mirrored_path, 2.8)
    _, mirrored = mirrored_driver.step(image, 20, ego(20, **flipped))
    assert mirrored.steer == pytest.approx(-command.steer, abs=1e-9)  # the projection stops at 1e-10 m
    assert mirrored.acceleration == command.acceleration


def test_slip_of_both_axles_is_steered_against() -> None:
    """On a straight path with a steady crab motion, the front wheels point where the tractor goes, plus their slip.

    v_y = 0.05 v_x without yaw: the body is held 0.05 rad to the right of the path so that the way leads along it; a
    front slip of -0.02 rad, seen for longer than its low-pass, is added on top.
    """
    crab, front_slip = 0.05, -0.02
    v_x = 2.8
    driver = PreviewDriver(TRACTOR, Path(Pose2(0.0, 0.0, 0.0), (line(500.0),)), v_x)
    memory = driver.init()
    steer = math.atan(crab) - front_slip
    for tick in range(0, 6000, 20):
        memory = memory._replace(demand=steer, steer=steer)
        along = v_x * math.hypot(1.0, crab) * tick * 1e-3
        y = -TRACTOR.x_ref * math.sin(-math.atan(crab)) - TRACTOR.y_ref * math.cos(math.atan(crab))
        seen = ego(tick, x=along, y=y, psi=-math.atan(crab), v_x=v_x, v_y=crab * v_x)
        memory, command = driver.step(memory, tick, seen)
    assert command.steer == pytest.approx(steer, abs=1e-6)


@pytest.mark.parametrize("start", [2.0, 3.5])
def test_the_set_speed_is_reached_and_held_against_a_resistance(start: float) -> None:
    """A mass with 0.5 m/s2 of drag, a 5 % grade: 20 s is many time constants of the loop."""
    driver = PreviewDriver(TRACTOR, straight(front_x=5.2, length=200.0).path, 2.8)
    memory, v = driver.init(), start
    for tick in range(0, 20000, 20):
        memory, command = driver.step(memory, tick, ego(tick, v_x=v))
        assert abs(command.acceleration) <= 1.5  # comfortable
        v += 0.02 * (command.acceleration - 0.5)
    assert v == pytest.approx(2.8, abs=1e-3)


@given(motions.map(lambda motion: motion | {"v_x": 0.0}))
def test_standing_still_is_survived(motion: dict[str, float]) -> None:
    """Nothing is divided by a speed that is not there."""
    driver = PreviewDriver(TRACTOR, PATH, 2.8)
    _, command = driver.step(driver.init(), 0, ego(**motion))
    assert math.isfinite(command.steer)
    assert math.isfinite(command.acceleration)


def test_driver_and_memory_can_be_pickled() -> None:
    """Runs travel to other processes, and go on there as they would have here."""
    driver = PreviewDriver(TRACTOR, PATH, 2.8)
    memory, _ = driver.step(driver.init(), 0, ego(v_x=2.8))
    copy, memory_copy = pickle.loads(pickle.dumps((driver, memory)))
    assert copy.step(memory_copy, 20, ego(20, v_x=2.8)) == driver.step(memory, 20, ego(20, v_x=2.8))


@pytest.mark.parametrize(
    ("change", "message"),
    [({"wheelbase": 0.0}, "wheelbase = 0.0"), ({"max_steer": 1.6}, "max_steer = 1.6"), ({"actuator_lag": -0.1}, "lag")],
)
def test_an_impossible_tractor_is_refused(change: dict[str, Any], message: str) -> None:
    """By name and value."""
    with pytest.raises(ValueError, match=message):
        replace(TRACTOR, **change)


@pytest.mark.parametrize(
    ("speed", "gain", "message"), [(0.0, 0.6, "speed = 0.0 m/s"), (2.8, -1.0, "gain = -1.0 rad/m")]
)
def test_an_impossible_driver_is_refused(speed: float, gain: float, message: str) -> None:
    """By name, value and unit."""
    with pytest.raises(ValueError, match=message):
        PreviewDriver(TRACTOR, PATH, speed, gain=gain)
