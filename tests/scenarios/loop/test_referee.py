"""Mishaps of runs: jackknifed, rolled over, left the road."""

import math

import numpy as np
import pytest

from scenarios.loop.referee import Outcome, Referee, lift_warnings
from scenarios.results.log import Log, Signal
from scenarios.results.trailer_signals import load_columns
from tests.trailers import truth as truth_at
from vehicle.clock import TICK
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, rotation_zyx

VEHICLE = load_vehicle("eu_tractor_semitrailer")
ROAD = np.column_stack([np.arange(-20.0, 20.0, 0.5), np.zeros(80)])


def truth(
    tick: int = 0,
    *,
    tractor: tuple[float, float, float] = (0.0, 0.0, 0.0),
    trailer_yaw: float = 0.0,
    transfer: tuple[float, float] = (0.0, 0.0),
    leans: tuple[float, float] = (0.0, 0.0),
) -> Truth:
    bodies = np.tile(np.eye(4), (2, 1, 1))
    bodies[:, :3, :3] = [rotation_zyx(0.0, 0.0, lean) for lean in leans]
    poses: FloatArray = np.array([tractor, (tractor[0], tractor[1], trailer_yaw)])
    wheels = dict.fromkeys(("wheel_loads", "wheel_slip_angles", "friction_used"), np.zeros(VEHICLE.n_wheels))
    return truth_at(tick, poses=poses, bodies=bodies, load_transfer=np.array(transfer), steer=np.zeros(1), **wheels)


def judged(seen: Truth, half_width: float | FloatArray = 4.5) -> Outcome | None:
    referee = Referee(VEHICLE, ROAD, half_width)
    return referee.step(referee.init(), seen)[1]


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("degrees", "outcome"), [(89.0, None), (91.0, "jackknifed")])
def test_a_combination_folded_past_the_right_angle_has_jackknifed(
    side: float, degrees: float, outcome: Outcome | None
) -> None:
    """At 90 degrees the pull of the hitch has no part left along the trailer, to either side."""
    assert judged(truth(trailer_yaw=side * math.radians(degrees))) == outcome


def lifted(
    vehicle: Vehicle, transfer: tuple[float, float], leans: tuple[float, float] = (0.0, 0.0)
) -> list[Outcome | None]:
    """Outcomes of 0.6 s in such a state."""
    referee = Referee(vehicle)
    memory = referee.init()
    outcomes = []
    for tick in range(0, 600, 10):
        memory, outcome = referee.step(memory, truth(tick, transfer=transfer, leans=leans))
        outcomes.append(outcome)
    return outcomes


@pytest.mark.parametrize("unit", [0, 1])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_body_whose_weight_is_beyond_its_outer_wheels_has_rolled_over(unit: int, side: float) -> None:
    """After half a second on one side's wheels, the time constant with which a laden body falls over them.

    A degree less, and its weight still brings it back when the lateral acceleration ends.
    """
    track, height = max(axle.track for axle in VEHICLE.units[unit].axles), VEHICLE.units[unit].cg_height
    tipping = math.atan2(0.5 * track, height)

    def outcomes(lean: float) -> list[Outcome | None]:
        if unit == 0:
            return lifted(VEHICLE, (side, 0.0), (side * lean, 0.0))
        return lifted(VEHICLE, (0.0, side), (0.0, side * lean))

    assert outcomes(tipping + 0.01).index("rolled over") * 10 * TICK == pytest.approx(0.5)
    assert not any(outcomes(tipping - 0.02))


def test_a_body_on_gradients_rolls_over_after_half_a_second() -> None:
    on_gradients = VEHICLE.model_copy(
        update={"units": tuple(unit.model_copy(update={"roll": None}) for unit in VEHICLE.units)}
    )
    assert lifted(on_gradients, transfer=(0.3, -1.0)).index("rolled over") * 10 * TICK == pytest.approx(0.5)


def test_a_unit_that_was_on_one_sides_wheels_is_warned_of() -> None:
    """0.8 s of the trailer; 0.4 s are a wheel that skips over a bump."""
    transfers = [(0.1, 1.0 if 1000 <= tick <= 1800 or 3000 <= tick <= 3400 else 0.2) for tick in range(0, 5000, 10)]
    truths = [truth(10 * k, transfer=transfer) for k, transfer in enumerate(transfers)]
    time = (Signal("time", "s", "time"), [truth.tick * TICK for truth in truths])
    log = Log.of([time, *load_columns(truths, VEHICLE)])
    name = VEHICLE.units[1].name
    assert lift_warnings(VEHICLE, log) == (f"{name}: the wheels of one side carry nothing from 1.0 to 1.8 s",)


def test_a_wheel_that_comes_back_in_time_is_no_roll_over() -> None:
    """0.4 s in the air, down for one row, 0.4 s in the air: the count begins anew."""
    referee = Referee(VEHICLE)
    memory = referee.init()
    for tick in range(0, 810, 10):
        down = tick == 400
        memory, outcome = referee.step(memory, truth(tick, transfer=(0.0, 0.5 if down else 1.0)))
        assert outcome is None


@pytest.mark.parametrize(
    ("y", "yaw", "outcome"),
    [
        (3.4, 0.0, None),  # wheels stand 1.02 m out: 4.42 m
        (3.6, 0.0, "left the road"),
        (-3.6, 0.0, "left the road"),
        (2.0, 0.8, "left the road"),  # the front wheels are 3.8 sin(0.8) + 1.02 cos(0.8) = 3.4 m further out
        (2.0, 0.2, None),
    ],
)
def test_the_road_is_left_with_the_first_wheel_of_the_tractor(y: float, yaw: float, outcome: Outcome | None) -> None:
    """The road is 4.5 m wide to either side of its centre line."""
    assert judged(truth(tractor=(0.0, y, yaw), trailer_yaw=yaw)) == outcome


@pytest.mark.parametrize(("x", "y", "outcome"), [(-10.0, 3.3, None), (10.0, 3.3, "left the road"), (10.0, -3.3, None)])
def test_a_road_of_changing_width_is_left_at_its_edge(x: float, y: float, outcome: Outcome | None) -> None:
    """A wheel 4.3 m to the left of the line: the edge is 4.5 m away at first, and 4 m 5 m on from the origin."""
    widths = np.stack([np.where(ROAD[:, 0] < 5.0, 4.5, 4.0), np.full(len(ROAD), 4.5)], axis=1)
    assert judged(truth(tractor=(x, y, 0.0)), widths) == outcome


@pytest.mark.parametrize(("y", "outcome"), [(0.9, None), (1.5, "left the lane"), (4.2, "left the road")])
def test_a_lane_is_left_before_the_road_is(y: float, outcome: Outcome | None) -> None:
    """Wheels stand 1.02 m out; the lane is 2 m wide to either side, the road 5 m."""
    widths = np.full((len(ROAD), 2), 2.0)
    referee = Referee(VEHICLE, ROAD, widths, widths + 3.0)
    assert referee.step(referee.init(), truth(tractor=(0.0, y, 0.0)))[1] == outcome


def test_neither_a_trailer_nor_a_tractor_without_a_road_leaves_it() -> None:
    """A trailer at 80 degrees to the road reaches 9 m beside it; on the proving ground anything goes."""
    assert judged(truth(trailer_yaw=math.radians(80.0))) is None
    referee = Referee(VEHICLE)
    assert referee.step(referee.init(), truth(tractor=(0.0, 1e3, 0.0)))[1] is None


def test_the_road_is_left_at_the_same_moment_whether_or_not_it_is_looked_at_every_step() -> None:
    """The referee looks at the road again when a wheel may have reached its edge, and misses no step beyond it.

    The tractor drifts and turns off a road that is wider on the left, in steps of up to 0.1 m.
    """
    referee = Referee(VEHICLE, ROAD, np.tile([4.5, 3.0], (len(ROAD), 1)))
    for sign in (1.0, -1.0):
        memory, looks, outcomes = referee.init(), 0, []
        for k in range(400):
            seen = truth(k, tractor=(0.02 * k - 5.0, sign * 0.01 * k, sign * 0.002 * k), trailer_yaw=sign * 0.002 * k)
            before = memory
            memory, outcome = referee.step(memory, seen)
            looks += memory != before
            outcomes.append(outcome)
            assert outcome == referee.step(referee.init(), seen)[1]
        assert outcomes[0] is None
        assert outcomes[-1] == "left the road"
        assert looks < 300
