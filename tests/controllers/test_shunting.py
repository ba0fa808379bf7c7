"""A driver with stops: he stands where and as long as he is told to, goes back and goes on."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest

from controllers.driver import DriverCommand, PreviewDriver
from controllers.path import Path, arc, line
from controllers.reversing_law import RollingChain
from controllers.shunting import ShuntingDriver, Stop
from controllers.tractor import TractorGeometry
from sensors.messages import EgoState
from vehicle.frames import FloatArray, Pose2

CHAIN = RollingChain(wheelbase=3.8, max_steer=0.7, hitches=(0.6,), lengths=(8.0,))
FRONT = 5.2  # [m]
TRACTOR = TractorGeometry(wheelbase=3.8, x_ref=FRONT, y_ref=1e-9, max_steer=0.7, max_steer_rate=0.5, actuator_lag=0.0)
PATH = Path(Pose2(FRONT, 0.0, 0.0), (line(20.0), arc(30.0, 1.0 / 20.0), line(20.0)))
STEP = 20  # [ticks]


class Driven(NamedTuple):
    """A drive, every 20 ms."""

    station: FloatArray  # of the guided point [m]
    speed: FloatArray  # [m/s]
    gear: FloatArray
    commands: list[DriverCommand]


def driven(stops: list[Stop], speed: float = 3.0, until: float = 120.0) -> Driven:
    """On wheels that roll where they point, with brakes that stop and hold and an engine that answers at once."""
    driver = ShuntingDriver(PreviewDriver(TRACTOR, PATH, speed), CHAIN, stops)
    memory, pose, gamma, v = driver.init(), Pose2(0.0, 0.0, 0.0), 0.0, speed
    found: list[tuple[float, float, float]] = []
    commands, station, curvature = [], 0.0, 0.0
    for k in range(round(until / 0.02)):
        ego = EgoState(
            tick=k * STEP, x=pose.x, y=pose.y, psi=pose.psi, v_x=v, v_y=0.0, yaw_rate=v * curvature,
            articulation=(gamma,),
        )  # fmt: skip
        memory, command = driver.step(memory, k * STEP, ego)
        commands.append(command)
        guided = pose @ Pose2(FRONT, 0.0, 0.0)
        station = PATH.project(guided.x, guided.y, station)
        found.append((station, v, command.gear))
        if station >= PATH.length:
            break
        if command.acceleration >= 0.0:
            v += 0.02 * command.gear * command.acceleration
        else:
            v = math.copysign(max(0.0, abs(v) + 0.02 * command.acceleration), v)
        curvature = math.tan(command.steer) / CHAIN.wheelbase
        yaw_rates = CHAIN.rates(np.array([gamma]), curvature)[1]
        way = 0.02 * v
        pose = pose @ Pose2(way, 0.0, way * curvature)
        gamma += way * float(yaw_rates[0] - yaw_rates[1])
    assert driver.duration > 0.8 * 0.02 * len(found)  # he knows about how long it takes
    stations, speeds, gears = np.array(found).T
    return Driven(stations, speeds, gears, commands)


def standing(seen: Driven) -> list[tuple[float, float]]:
    """Station [m] and duration [s] of every standstill."""
    still, found, k = np.abs(seen.speed) < 0.03, [], 0
    while k < len(still):
        end = k
        while end < len(still) and still[end]:
            end += 1
        if end - k > 25:
            found.append((float(seen.station[k]), 0.02 * (end - k)))
        k = end + 1
    return found


def test_he_stands_where_and_as_long_as_he_is_told_to() -> None:
    """Within the last centimetres of braking; half a second more for setting off."""
    seen = driven([Stop(15.0, 2.0), Stop(35.0, 10.0), Stop(50.0, 0.6)])
    found = standing(seen)
    assert [at for at, _ in found] == pytest.approx([15.0, 35.0, 50.0], abs=0.15)
    for (_, took), wait in zip(found, (2.0, 10.0, 0.6), strict=True):
        assert wait <= took < wait + 0.5
    assert seen.station[-1] >= PATH.length
    assert (seen.gear == 1.0).all()
    assert seen.speed.min() > -0.01


def test_he_goes_back_as_far_as_he_is_told_to_and_on_again() -> None:
    """20 m back from the bend: he stands there, too, and finishes the path."""
    seen = driven([Stop(40.0, 1.0, back=20.0)])
    (there, _), (back, took) = standing(seen)
    assert there == pytest.approx(40.0, abs=0.15)
    # The trailer's axle goes 20 m back; in the bend the guided point's way is up to 1.2 times as long.
    assert 18.0 < there - back < 25.0
    assert took >= 1.0
    assert seen.speed.min() == pytest.approx(-1.2, abs=0.25)  # walking pace, and a little over it when setting off
    assert seen.station[-1] >= PATH.length


def test_the_gear_is_changed_at_a_standstill_only() -> None:
    seen = driven([Stop(40.0, 1.0, back=10.0), Stop(45.0, 1.0)])
    changes = np.flatnonzero(np.diff(seen.gear))
    assert len(changes) == 2
    assert np.abs(seen.speed[changes]).max() < 0.03


def test_while_he_waits_he_holds_the_brakes_and_the_wheel() -> None:
    seen = driven([Stop(30.0, 3.0)])
    waiting = [command for command, v in zip(seen.commands, seen.speed, strict=True) if v == 0.0][5:-30]
    assert len(waiting) > 90
    assert {command.steer for command in waiting} == {waiting[0].steer}
    assert max(command.acceleration for command in waiting) <= -1.5


@pytest.mark.parametrize(
    ("stops", "complaint"),
    [
        ([Stop(30.0, 1.0), Stop(20.0, 1.0)], r"stops.1: station = 20 m must be beyond 30 m and before"),
        ([Stop(300.0, 1.0)], r"stops.0: station = 300 m must be beyond 0 m and before the path's end at 70.0 m"),
        ([Stop(30.0, 1.0, back=31.0)], r"stops.0: back = 31 m must be between 0 and the station, 30 m"),
    ],
)
def test_stops_that_do_not_fit_are_refused(stops: list[Stop], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        ShuntingDriver(PreviewDriver(TRACTOR, PATH, 3.0), CHAIN, stops)


@pytest.mark.parametrize(("lengths", "speed"), [((8.0,), 1.2), ((3.0, 8.0), 0.5 * 3.0 / 2.8)])
def test_in_reverse_the_shortest_unit_moves_half_its_length_from_lock_to_lock(
    lengths: tuple[float, ...], speed: float
) -> None:
    """1.4 rad at 0.5 rad/s are 2.8 s: a dolly of 3 m is pushed at 0.54 m/s; at 1.2 m/s it jackknifed in a bend of 20 m.

    The speed follows from what 10 m more in reverse add to the planned duration; going on from there is at 3 m/s.
    """
    chain = RollingChain(wheelbase=3.8, max_steer=0.7, hitches=(0.6,) * len(lengths), lengths=lengths)

    def duration(back: float) -> float:
        return ShuntingDriver(PreviewDriver(TRACTOR, PATH, 3.0), chain, [Stop(40.0, 1.0, back)]).duration

    assert 10.0 / (duration(20.0) - duration(10.0) - 10.0 / 3.0) == pytest.approx(speed)
