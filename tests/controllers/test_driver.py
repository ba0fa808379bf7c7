"""Tractor drivers: preview driver with its design, recorded drives, and speed along a path."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers import preview_law as design
from controllers.checked import CheckedDriver, CheckedRoverDriver, LawError
from controllers.driver import DriverCommand, DriverMemory, DriverTrace, PreviewDriver, TraceDriver
from controllers.equations import FLOATS
from controllers.path import Path, Segment, SpeedProfile, arc, line
from controllers.tractor import STATES, TractorAxle, TractorDynamics, TractorGeometry, path_matrices, tractor_model
from controllers.trailer_steering.signal_laws import Unsteered
from estimators.slip.rover_odometry import Rolling, RoverPose
from scenarios.courses import figure_of_eight, roundabout, straight
from sensors.messages import EgoState
from tests.trailers import TWO_OF_THREE as TRAILER
from vehicle.frames import Pose2
from vehicle.rover.command import RoverCommand

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


@pytest.mark.slow
def test_steering_round_a_circle_has_the_closed_form_angle(drive: Any) -> None:
    """Front corner on R: the rear axle runs on sqrt(R^2 - x_ref^2) - width/2, and tan(delta) = wheelbase / that."""
    run = drive(roundabout(front_x=5.2, width=2.55), TRAILER, Unsteered(TRAILER))
    rear_radius = math.sqrt(12.5**2 - 5.2**2) - 1.275
    round_circle = run.tractor_steer[(run.station > 95.0) & (run.station < 105.0)]
    # The entry dies out over x_ref / cos(chi) = 5.7 m, chi = asin(5.2/12.5): exp(-65/5.7) of 0.4 rad is left.
    assert round_circle == pytest.approx(math.atan(3.8 / rear_radius), abs=1e-5)
    assert run.guided.max() < 0.01


def test_steer_demand_stays_within_the_limit() -> None:
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
    driver = PreviewDriver(TRACTOR, PATH, 2.8)
    _, command = driver.step(driver.init(), 0, ego(**motion))
    assert math.isfinite(command.steer)
    assert math.isfinite(command.acceleration)


# Design of the preview driver


DYNAMICS = TractorDynamics(
    mass=8000.0,
    yaw_inertia=28900.0,
    cg_x=2.36,
    hitch_mass=10500.0,
    hitch_x=0.77,
    axles=(TractorAxle(3.8, 2.8e5, 0.5, trail=0.04, steer_ratio=1.0), TractorAxle(0.0, 5.8e5, 0.5, trail=0.04)),
)
LADEN = TractorGeometry(
    wheelbase=3.8, x_ref=5.2, y_ref=0.0, max_steer=0.75, max_steer_rate=0.5, actuator_lag=0.1, dynamics=DYNAMICS
)


def test_load_on_the_hitch_is_part_of_the_tractors_mass() -> None:
    model, load = tractor_model(LADEN), 10500.0 * 0.77
    assert model.mass_x == pytest.approx((8000.0 * 2.36 + load) / 18500.0)
    assert model.second_moment == pytest.approx((28900.0 + 8000.0 * 2.36**2 + load * 0.77) / 18500.0)


FAST = np.geomspace(design.CREEP, design.FASTEST, 24)[-3:]  # speeds of designs, at which nothing is interpolated


@pytest.mark.parametrize("speed", FAST.tolist())
def test_a_steady_turn_needs_no_offset(speed: float) -> None:
    """On a path of constant curvature the law asks for the steer angle of the steady turn, with no offset.

    The path counts 3 s ahead; what lies beyond has weights of a hundredth of the sum.
    """
    A, B, E = path_matrices(tractor_model(LADEN), LADEN, LADEN.actuator_lag, speed)
    kappa = 0.1 / speed
    unknowns = np.column_stack([A[:, 1:], B])  # heading error, motion, slips, steer and demand; the offset is zero
    *state, demand = np.linalg.solve(unknowns, -E * kappa).tolist()
    row = design.gains(LADEN, 0.6).at(np.array([speed]))[0]
    asked = float(row[STATES:].sum() * kappa - row[1:STATES] @ np.array(state))
    assert asked == pytest.approx(demand, rel=0.02)


def test_a_slow_tractor_is_steered_as_one_that_rolls() -> None:
    """Below 2 m/s slip, side speed and yaw rate are no states of the design."""
    row = design.gains(LADEN, 0.6).at(np.array([1.0]))[0]
    assert not row[2:6].any()
    assert row[0] > 0.0
    assert row[1] > 0.0


def test_slip_follows_the_motion_over_the_relaxation_length() -> None:
    """Crabbing at 0.02 rad: after half a metre, the tyres' relaxation length, all but 1/e of that is their slip."""
    still, crabbing = design.Slips(0.0, 0.0, 0.0, 0.0), design.Motion(5.0, 0.1, 0.0)
    slips = design.slips_after(FLOATS, LADEN, still, crabbing, crabbing, 0.0, 0.1)
    assert slips[:2] == pytest.approx([0.02 * (1.0 - math.exp(-1.0))] * 2, rel=1e-3)


@pytest.mark.parametrize("speed", [-1.0, 0.0, 0.2, 0.27, 3.0, 24.99, 45.0, 60.0, float("nan")])
def test_a_row_of_gains_is_that_of_the_table_bit_for_bit(speed: float) -> None:
    """One driver and a thousand environments are steered alike."""
    gains = design.gains(LADEN, 0.1)
    assert gains.row(speed) == gains.at(np.array([speed]))[0].tolist()


# Recorded drives and speed profiles


def test_steer_angles_are_those_recorded_and_stay_after_the_end() -> None:
    driver = TraceDriver(
        DriverTrace(time=np.array([0.0, 1.0, 3.0]), steer=np.array([0.0, 0.1, -0.1]), acceleration=np.ones(3))
    )
    memory, demands = driver.init(), []
    for tick in (0, 500, 1000, 2000, 9000):
        memory, command = driver.step(memory, tick, ego(tick, v_x=3.0))
        demands.append(command)
    assert [d.steer for d in demands] == pytest.approx([0.0, 0.05, 0.1, 0.0, -0.1], abs=1e-12)
    assert [d.acceleration for d in demands] == [1.0, 1.0, 1.0, 1.0, 0.0]


def test_a_recorded_speed_is_held() -> None:
    """A point mass that does as demanded follows a ramp of 0.5 m/s2 within 2 cm/s, and ends at the last speed."""
    speeds = np.array([2.0, 2.0, 4.0, 4.0])
    trace = DriverTrace(time=np.array([0.0, 2.0, 6.0, 10.0]), steer=np.zeros(4), speed=speeds)
    driver = TraceDriver(trace)
    memory, v, worst = driver.init(), 2.0, 0.0
    for tick in range(0, 10000, 20):
        memory, command = driver.step(memory, tick, ego(tick, v_x=v))
        worst = max(worst, abs(v - float(np.interp(tick * 1e-3, trace.time, speeds))))
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
        ([0.0, 2.0], None, "speed or an acceleration"),
    ],
)
def test_what_is_no_trace_is_refused(time: list[float], values: list[float] | None, complaint: str) -> None:
    speed = None if values is None else np.array(values)
    with pytest.raises(ValueError, match=complaint):
        DriverTrace(time=np.array(time), steer=np.zeros(len(time)), speed=speed)


def test_turns_are_taken_at_the_limit_and_approached_in_time() -> None:
    """sqrt(a R) round the arc; before it v^2 falls by 2 a per metre at most, and behind it rises by as much."""
    path = Path(Pose2(0.0, 0.0, 0.0), (line(100.0), arc(30.0, -1.0 / 20.0), line(100.0)))
    profile = SpeedProfile.of(path, 10.0, 0.8, 0.7)
    assert profile.at(115.0) == pytest.approx(4.0, abs=1e-9)  # sqrt(0.8 * 20)
    assert profile.at(10.0) == profile.at(220.0) == 10.0
    rises = np.diff(profile.speeds**2) / np.diff(profile.stations)
    assert np.abs(rises).max() <= 2.0 * 0.7 + 1e-9
    assert profile.duration > path.length / 10.0
    plain = SpeedProfile.of(Path(Pose2(0.0, 0.0, 0.0), (line(50.0),)), 5.0, 0.1, 0.7)
    assert set(plain.speeds.tolist()) == {5.0}
    assert plain.duration == pytest.approx(10.0)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: replace(TRACTOR, wheelbase=0.0), "wheelbase = 0.0"),
        (lambda: replace(DYNAMICS, hitch_mass=-1.0), "hitch_mass = -1.0 kg"),
        (
            lambda: replace(DYNAMICS, axles=(DYNAMICS.axles[0]._replace(stiffness=-1.0), DYNAMICS.axles[1])),
            "stiffness = -1.0",
        ),
    ],
)
def test_what_can_not_be_is_refused_by_name_and_value(build: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        build()


# Drivers that misbehave end with one line that names them, the tick and the value


AT = 1200
EGO_AT = EgoState(tick=AT, x=0.0, y=0.0, psi=0.0, v_x=2.0, v_y=0.0, yaw_rate=0.0)
POSE = RoverPose(tick=AT, x=0.0, y=0.0, psi=0.0, drift=0.0, rolling=Rolling(0.0, 0.0, 0.0))


class Stub(NamedTuple):
    command: object
    duration: float = 10.0
    start_speed: float | None = None

    def init(self) -> int:
        return 0

    def _result(self, memory: int) -> tuple[int, object]:
        if isinstance(self.command, Exception):
            raise self.command
        return memory + 1, self.command


class StubDriver(Stub):
    def step(self, memory: int, tick: int, ego: EgoState, /) -> tuple[int, DriverCommand]:
        return self._result(memory)  # type: ignore[return-value]  # as a user's driver may


class StubRoverDriver(Stub):
    def step(self, memory: int, pose: RoverPose, /) -> tuple[int, RoverCommand]:
        return self._result(memory)  # type: ignore[return-value]


def test_a_good_step_passes_through_unchanged() -> None:
    demand = DriverCommand(steer=0.1, acceleration=0.2)
    driver = CheckedDriver(StubDriver(demand, 12.0, 3.0), "driver = mine")
    assert driver.step(driver.init(), AT, EGO_AT) == (1, demand)
    wheels = RoverCommand(wheel_speed=(1.0,) * 4, steer=(0.0,) * 4)
    rover = CheckedRoverDriver(StubRoverDriver(wheels), "driver = mine", 4)
    assert rover.step(rover.init(), POSE) == (1, wheels)


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (DriverCommand(steer=math.nan, acceleration=0.0), r"returned steer = nan"),
        (DriverCommand(steer=0.0, acceleration=-math.inf), r"returned acceleration = -inf"),
        ((0.0, 0.0), r"not \(memory, DriverCommand\)"),
        (KeyError("lane"), r"raised KeyError: 'lane'"),
    ],
)
def test_a_tractor_driver_that_misbehaves_is_named(command: object, message: str) -> None:
    """In one line, with the time in seconds."""
    driver = CheckedDriver(StubDriver(command), "driver.kind = mymod:Mine")
    with pytest.raises(LawError, match=rf"^driver\.kind = mymod:Mine: at tick 1200 \(1\.2 s\) it .*{message}"):
        driver.step(0, AT, EGO_AT)


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (RoverCommand(wheel_speed=(1.0, 1.0, math.nan, 1.0), steer=(0.0,) * 4), r"returned wheel_speed\[2\] = nan"),
        (RoverCommand._make(((1.0,) * 4, (0.0, 0.0))), r"returned steer = \(0\.0, 0\.0\), the rover has 4 wheels"),
        (None, r"returned \(1, None\), not \(memory, RoverCommand\)"),
    ],
)
def test_a_rover_driver_that_misbehaves_is_named(command: object, message: str) -> None:
    driver = CheckedRoverDriver(StubRoverDriver(command), "driver = mymod:Mine", 4)
    with pytest.raises(LawError, match=rf"^driver = mymod:Mine: at tick 1200 \(1\.2 s\) it .*{message}"):
        driver.step(0, POSE)
