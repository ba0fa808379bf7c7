"""Reversing: geometry of a rolling chain, the reference that it leaves, the law, and a driver with stops."""

import math
from typing import NamedTuple

import numpy as np
import pytest

from controllers.driver import DriverCommand, PreviewDriver, ShuntingDriver, Stop
from controllers.path import Path, arc, line
from controllers.reversing_law import ReverseReference, ReversingLaw, RollingChain
from controllers.tractor import TractorGeometry
from sensors.messages import EgoState
from vehicle.combination.description import load_vehicle
from vehicle.frames import FloatArray, Pose2

ONE = RollingChain(wheelbase=3.8, max_steer=0.7, hitches=(0.6,), lengths=(8.0,))
TWO = RollingChain(wheelbase=3.8, max_steer=0.7, hitches=(0.6, -1.5), lengths=(7.5, 6.0))
CHAINS = pytest.mark.parametrize("chain", [ONE, TWO], ids=["semi-trailer", "two trailers"])


def rolled(chain: RollingChain, state: FloatArray, curvature: float, way: float) -> FloatArray:
    """State x, y, psi (N + 1,) after ``way`` [m] of the tractor's axle, backwards below 0; midpoint rule."""

    def rate(s: FloatArray) -> FloatArray:
        yaw_rates = chain.rates(s[2:-1] - s[3:], curvature)[1]
        return np.concatenate([[math.cos(s[2]), math.sin(s[2])], yaw_rates])

    return state + way * rate(state + 0.5 * way * rate(state))


def last_axle(chain: RollingChain, state: FloatArray) -> Pose2:
    return chain.last_axle(Pose2(*state[:3]), (state[2:-1] - state[3:]).tolist())


def drawn_forwards(chain: RollingChain, curvatures: FloatArray, step: float = 0.05) -> tuple[FloatArray, FloatArray]:
    """Points of the last axle's way, and the states, when the tractor goes along these curvatures."""
    states = [np.zeros(3 + len(chain.lengths))]
    for curvature in curvatures:
        states.append(rolled(chain, states[-1], curvature, step))
    return np.array([last_axle(chain, s)[:2] for s in states]), np.array(states)


def pushed_back(
    chain: RollingChain, reference: ReverseReference, state: FloatArray, way: float, step: float = 0.04
) -> FloatArray:
    """Distance beside the reference and articulation while the law steers backwards, (n, 2)."""
    law, last = ReversingLaw(chain), last_axle(chain, state)
    station, seen = reference.project(last.x, last.y, reference.stations[-1]), []
    for _ in range(round(way / step)):
        last = last_axle(chain, state)
        station = reference.project(last.x, last.y, station)
        on = reference.at(station)
        gamma = state[2:-1] - state[3:]
        x, y, psi = on.pose
        seen.append([math.cos(psi) * (last.y - y) - math.sin(psi) * (last.x - x), np.abs(gamma).max()])
        steer = law.steer(last, gamma, on)
        assert abs(steer) <= chain.max_steer
        state = rolled(chain, state, math.tan(steer) / chain.wheelbase, -step)
    return np.array(seen)


@CHAINS
@pytest.mark.parametrize("curvature", [0.06, -0.03])
def test_a_steady_turn_keeps_its_articulation(chain: RollingChain, curvature: float) -> None:
    articulation, of_tractor = chain.steady(curvature)
    speeds, yaw_rates = chain.rates(articulation, of_tractor)
    np.testing.assert_allclose(yaw_rates, of_tractor, rtol=1e-12)  # a closed form, to rounding
    assert yaw_rates[-1] / speeds[-1] == pytest.approx(curvature, rel=1e-12)


def test_a_group_rolls_about_the_root_of_its_second_moment() -> None:
    """Axles at 6.39, 7.70 and 9.01 m: sum x^2 / sum x, 0.15 m behind their middle."""
    chain = RollingChain.of(load_vehicle("eu_tractor_semitrailer"))
    assert chain.lengths == pytest.approx([(6.39**2 + 7.70**2 + 9.01**2) / (6.39 + 7.70 + 9.01)], abs=0.01)


@CHAINS
def test_the_reference_is_how_the_units_stood_on_the_way_there(chain: RollingChain) -> None:
    """Drawn through a bend of 20 m and out of it without slip: articulations and the tractor's curvature come back."""
    entering, turning = np.zeros(300), np.full(500, 0.05)
    ramp = np.linspace(0.0, 0.05, 100)
    curvatures = np.concatenate([entering, ramp, turning, ramp[::-1], entering])
    way, states = drawn_forwards(chain, curvatures)
    reference = ReverseReference.of(chain, way[::5])
    gone = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])
    gammas = states[:, 2:-1] - states[:, 3:]
    for k in range(100, len(curvatures) - 100, 50):
        on = reference.at(float(gone[k]))
        np.testing.assert_allclose(on.articulation, gammas[k], atol=0.01)  # smoothing over 0.6 m
        assert on.tractor_curvature == pytest.approx(float(curvatures[k]), abs=0.006)
        assert math.hypot(on.pose.x - way[k, 0], on.pose.y - way[k, 1]) < 0.02


@CHAINS
def test_it_finds_back_to_a_line_from_beside_it(chain: RollingChain) -> None:
    """Two metres beside and askew, on a straight line: within a centimetre after some lengths, never folded."""
    reference = ReverseReference.of(chain, np.array([[-150.0, 0.0], [40.0, 0.0]]))
    state = np.zeros(3 + len(chain.lengths))
    state[1], state[2:] = 2.0, 0.1
    seen = pushed_back(chain, reference, state, 100.0)
    assert abs(seen[-1, 0]) < 0.01
    assert seen[:, 1].max() < math.radians(60.0)
    assert seen[:, 0].min() > -0.5  # it hardly crosses the line


@CHAINS
def test_it_goes_back_through_a_bend_on_its_own_way(chain: RollingChain) -> None:
    curvatures = np.concatenate([np.zeros(300), np.linspace(0.0, 0.06, 60), np.full(400, 0.06)])
    way, states = drawn_forwards(chain, curvatures)
    reference = ReverseReference.of(chain, way[::5])
    seen = pushed_back(chain, reference, states[-1], 25.0)
    assert np.abs(seen[:, 0]).max() < 0.05


def test_without_feedback_the_same_push_folds() -> None:
    """That the law has something to do: the reference's own steer angle alone loses the trailer within 60 m."""
    reference = ReverseReference.of(ONE, np.array([[-150.0, 0.0], [40.0, 0.0]]))
    assert reference.at(10.0).tractor_curvature == pytest.approx(0.0, abs=1e-9)
    state = np.array([0.0, 0.0, 0.02, 0.0])
    for _ in range(1500):
        state = rolled(ONE, state, 0.0, -0.04)
    assert abs(state[2] - state[3]) > 0.5 * math.pi


def test_what_can_not_be_pushed_is_refused() -> None:
    with pytest.raises(ValueError, match=r"points span 0\.50 m: reversing needs 1 m at least"):
        ReverseReference.of(ONE, np.array([[0.0, 0.0], [0.5, 0.0]]))
    with pytest.raises(ValueError, match="must be a tractor with steering that tows a trailer"):
        RollingChain.of(load_vehicle("rigid_truck"))


# A driver with stops


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
    driver = ShuntingDriver(PreviewDriver(TRACTOR, PATH, speed), ONE, stops)
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
        curvature = math.tan(command.steer) / ONE.wheelbase
        yaw_rates = ONE.rates(np.array([gamma]), curvature)[1]
        way = 0.02 * v
        pose = pose @ Pose2(way, 0.0, way * curvature)
        gamma += way * float(yaw_rates[0] - yaw_rates[1])
    assert driver.duration > 0.8 * 0.02 * len(found)  # he knows about how long it takes
    stations, speeds, gears = np.array(found).T
    return Driven(stations, speeds, gears, commands)


def standing(seen: Driven) -> list[tuple[float, float]]:
    """Station [m] and duration [s] of every standstill of more than half a second."""
    changes = np.flatnonzero(np.diff(np.concatenate([[0], np.abs(seen.speed) < 0.03, [0]])))
    spans = zip(changes[::2].tolist(), changes[1::2].tolist(), strict=True)
    return [(float(seen.station[begin]), 0.02 * (end - begin)) for begin, end in spans if end - begin > 25]


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
    assert seen.speed[:100].min() > 2.9  # he begins at speed


def test_he_goes_back_as_far_as_he_is_told_to_and_on_again() -> None:
    """20 m back from the bend: he stands there, too, and finishes the path; the gear is changed at standstills."""
    seen = driven([Stop(40.0, 1.0, back=20.0)])
    changes = np.flatnonzero(np.diff(seen.gear))
    assert len(changes) == 2
    assert np.abs(seen.speed[changes]).max() < 0.03
    (there, _), (back, took) = standing(seen)
    assert there == pytest.approx(40.0, abs=0.15)
    # The trailer's axle goes 20 m back; in the bend the guided point's way is up to 1.2 times as long.
    assert 18.0 < there - back < 25.0
    assert took >= 1.0
    assert seen.speed.min() == pytest.approx(-1.2, abs=0.25)  # walking pace, and a little over it when setting off
    assert seen.station[-1] >= PATH.length


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
        ShuntingDriver(PreviewDriver(TRACTOR, PATH, 3.0), ONE, stops)


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
