"""Drivers who repeat a recorded drive, and how fast a path can be driven."""

from __future__ import annotations

import math

import numpy as np
import pytest

from controllers.driver import DriverTrace, TraceDriver
from controllers.path import Path, SpeedProfile, arc, line
from sensors.messages import EgoState
from vehicle.frames import Pose2

TIME = np.array([0.0, 1.0, 3.0])


def ego(tick: int, v_x: float) -> EgoState:
    return EgoState(tick=tick, x=0.0, y=0.0, psi=0.0, v_x=v_x, v_y=0.0, yaw_rate=0.0)


def test_steer_angles_are_those_recorded_and_stay_after_the_end() -> None:
    """Linear between samples; the last one holds."""
    driver = TraceDriver(DriverTrace(time=TIME, steer=np.array([0.0, 0.1, -0.1]), acceleration=np.ones(3)))
    memory, demands = driver.init(), []
    for tick in (0, 500, 1000, 2000, 9000):
        memory, command = driver.step(memory, tick, ego(tick, 3.0))
        demands.append(command)
    assert [d.steer for d in demands] == pytest.approx([0.0, 0.05, 0.1, 0.0, -0.1], abs=1e-12)
    assert [d.acceleration for d in demands] == [1.0, 1.0, 1.0, 1.0, 0.0]


def test_a_recorded_speed_is_held() -> None:
    """A point mass that does as demanded follows a ramp of 0.5 m/s2 within 2 cm/s, and ends at the last speed."""
    trace = DriverTrace(time=np.array([0.0, 4.0, 10.0]), steer=np.zeros(3), speed=np.array([2.0, 4.0, 4.0]))
    driver = TraceDriver(trace)
    memory, v, worst = driver.init(), 2.0, 0.0
    for tick in range(0, 10000, 20):
        memory, command = driver.step(memory, tick, ego(tick, v))
        worst = max(worst, abs(v - float(np.interp(tick * 1e-3, trace.time, [2.0, 4.0, 4.0]))))
        v += command.acceleration * 0.02
    assert worst < 0.02
    assert v == pytest.approx(4.0, abs=1e-3)
    assert (driver.start_speed, driver.duration) == (2.0, 10.0)


@pytest.mark.parametrize(
    ("time", "values", "complaint"),
    [
        ([0.0], [1.0], "two samples"),
        ([1.0, 2.0], [1.0, 1.0], "start at 0 s"),
        ([0.0, 2.0, 2.0], [1.0, 1.0, 1.0], "increase"),
        ([0.0, 2.0], [1.0], "1 values for 2 times"),
    ],
)
def test_what_is_no_trace_is_refused(time: list[float], values: list[float], complaint: str) -> None:
    """One line that says why."""
    with pytest.raises(ValueError, match=complaint):
        DriverTrace(time=np.array(time), steer=np.zeros(len(time)), speed=np.array(values))


def test_a_trace_has_to_say_how_fast() -> None:
    """Steer angles alone are no drive."""
    with pytest.raises(ValueError, match="speed or an acceleration"):
        DriverTrace(time=TIME, steer=np.zeros(3))


def test_turns_are_taken_at_the_limit_and_approached_in_time() -> None:
    """sqrt(a R) round the arc; before it v^2 falls by 2 a per metre at most, and behind it rises by as much."""
    path = Path(Pose2(0.0, 0.0, 0.0), (line(100.0), arc(30.0, -1.0 / 20.0), line(100.0)))
    profile = SpeedProfile.of(path, 10.0, 0.8, 0.7)
    assert profile.at(115.0) == pytest.approx(4.0, abs=1e-9)  # sqrt(0.8 * 20)
    assert profile.at(10.0) == profile.at(220.0) == 10.0
    rises = np.diff(profile.speeds**2) / np.diff(profile.stations)
    assert np.abs(rises).max() <= 2.0 * 0.7 + 1e-9
    assert profile.duration > path.length / 10.0


def test_a_straight_path_is_driven_at_set_speed() -> None:
    """Nothing to slow down for; the time is way over speed."""
    profile = SpeedProfile.of(Path(Pose2(0.0, 0.0, 0.0), (line(50.0),)), 5.0, 0.1, 0.7)
    assert set(profile.speeds.tolist()) == {5.0}
    assert profile.duration == pytest.approx(10.0)


def test_a_limit_must_be_one() -> None:
    """Zero lateral acceleration is standing still at the first turn."""
    with pytest.raises(ValueError, match="max_lateral_acceleration"):
        SpeedProfile.of(Path(Pose2(0.0, 0.0, 0.0), (line(50.0),)), 5.0, 0.0, math.inf)
