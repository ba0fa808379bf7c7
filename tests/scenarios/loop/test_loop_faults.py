"""Faults of the loop beyond its sensors: messages, steering actuators, brakes."""

import copy
import math
from collections.abc import Callable
from typing import ClassVar

import numpy as np
import pytest

import offtrack
from offtrack.exchange.fmi_proxy.system import fmu_system
from scenarios.assembly.applied_faults import LoopFaults
from scenarios.assembly.rover_run import assemble_rover
from scenarios.assembly.trailer_run import Assembly, assemble
from scenarios.loop_faults.fault import ActuatorFault, LoopFault, LoopFaultContext, MessageFault
from scenarios.options.scenario import RoverScenario, load_any_scenario, load_scenario
from scenarios.options.tables import FaultOptions
from tests.trailers import estimate
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface

STEP = 10  # [ticks]
ESTIMATE = estimate(0)
VEHICLE = "uk_longer_semitrailer"  # two steered axles, each with an actuator


def fault(text: str) -> LoopFault:
    """The fault as ``--set faults=`` takes it."""
    scenario = load_scenario("roundabout", (f"faults={text}",))
    built = scenario.faults[0].fault()
    assert isinstance(built, LoopFault)
    return built


def built_actuator(text: str, vehicle: Vehicle | None = None) -> tuple[LoopFault, ActuatorFault]:
    one, vehicle = fault(text), vehicle or load_vehicle(VEHICLE)
    kind = one.built(LoopFaultContext(vehicle=vehicle, unit=1, rng=np.random.default_rng(0)))
    assert isinstance(kind, ActuatorFault)
    return one, kind


def driven(text: str, demands: list[float], vehicle: Vehicle | None = None) -> FloatArray:
    """Angles (n, 2) [rad] of axles that follow their demand at once, one demand a step; the fault has its times."""
    one, kind = built_actuator(text, vehicle)
    angles, course = np.zeros(2), []
    for k, demand in enumerate(demands):
        angles = kind.demanded(k * STEP, np.full(2, demand), angles, one.active(k * STEP))
        course.append(angles)
    return np.array(course)


def carried(text: str, count: int) -> list[list[int]]:
    """Messages that arrive at each step of 10 ms; one is sent at each, and is its number."""
    one = fault(text)
    kind = one.built(LoopFaultContext(vehicle=load_vehicle(VEHICLE), unit=1, rng=np.random.default_rng(0)))
    assert isinstance(kind, MessageFault)
    return [kind.carried(k * STEP, [k], one.active(k * STEP)) for k in range(count)]


@pytest.mark.parametrize(
    ("text", "vehicle", "stay"),
    [
        ("actuator_stuck@0.02+0.02", VEHICLE, [True, True]),
        ("actuator_stuck:2@0.02+0.02", VEHICLE, [False, True]),
        ("actuator_stuck:2@0.02+0.02", f"{VEHICLE}_grouped", [True, True]),  # a linkage turns both
    ],
)
def test_stuck_axles_stay_until_the_fault_ends(text: str, vehicle: str, stay: list[bool]) -> None:
    demands = [0.0, 0.1, 0.2, 0.3, 0.4]
    course = driven(text, demands, load_vehicle(vehicle))
    assert course.T.tolist() == [[0.0, 0.1, 0.1, 0.1, 0.4] if stuck else demands for stuck in stay]


def test_slow_axles_turn_at_their_share_of_the_rate() -> None:
    steering = load_vehicle(VEHICLE).units[1].steering
    assert steering is not None
    course = driven("actuator_slow:0.1@0.01", [0.0, *[0.02] * 60])
    rates = np.diff(course[1:, 0]) / 0.01
    assert rates[0] == pytest.approx(0.1 * steering.rate_limit)
    assert course[-1, 0] == 0.02  # and get there


def test_an_offset_stands_beside_the_demand() -> None:
    assert driven("actuator_offset:-3", [0.1])[0] == pytest.approx(0.1 - math.radians(3.0))


def test_dead_axles_return_to_straight_and_stay() -> None:
    """From 0.1 rad at 10 deg/s: within 0.58 s."""
    course = driven("actuator_dead:10@0.01", [0.1] * 70)[:, 0]
    assert np.diff(course[1:30]) == pytest.approx(-math.radians(10.0) * 0.01)
    assert course[-1] == 0.0


def test_late_messages_arrive_in_their_order() -> None:
    """Those under way at the end of the fault are lost."""
    assert carried("estimate_delay:0.02@0.01+0.04", 7) == [[0], [], [], [1], [2], [5], [6]]


def test_messages_are_lost_in_their_share() -> None:
    """Of 1 000 with a share of 0.3: the standard deviation of the count is 14."""
    arrived = carried("demand_loss:0.3@0+10", 1100)
    assert sum(map(len, arrived[:1000])) == pytest.approx(700, abs=60)
    assert all(len(one) == 1 for one in arrived[1000:])


class Swapped(ActuatorFault):
    options: ClassVar = ()

    def demanded(self, tick: int, demand: FloatArray, angles: FloatArray, active: bool) -> FloatArray:
        """The demand, mirrored."""
        return -demand if active else demand


def test_a_kind_of_ones_own_acts_by_its_import_path() -> None:
    options = FaultOptions(kind="tests.scenarios.loop.test_loop_faults:Swapped")
    own = options.fault()
    assert isinstance(own, LoopFault)
    context = LoopFaultContext(vehicle=load_vehicle(VEHICLE), unit=1, rng=np.random.default_rng(0))
    faults = LoopFaults([(own, own.built(context))])
    assert faults.demanded(0, np.array([0.1, -0.2]), np.zeros(2)).tolist() == [-0.1, 0.2]


def test_faults_act_between_law_and_axles_of_a_run() -> None:
    """The log has the demands, which soon make up for the offset, and the angles of the faulty axles.

    A snapshot goes on bitwise.
    """
    faults = "actuator_offset:4,1; actuator_stuck:1@0.5; demand_loss:0.5; estimate_loss:0.5"
    settings = {"course.length": 30, "off_tracking": "truth", "faults": faults}
    with offtrack.Session("cambered-road", settings=settings) as session:
        session.step(0.7)
        snapshot = copy.deepcopy(session)
        session.step(0.2)
        snapshot.step(0.2)
        log = session.result().log
        assert log == snapshot.result().log
    assert abs(log["steer_trailer_1_command"][:11]).max() < math.radians(0.5)  # on a straight
    assert log["steer_trailer_1"][10] > math.radians(1.5)  # by the offset alone
    assert log["steer_trailer_1_command"][45] == pytest.approx(math.radians(-4.0), rel=0.1)
    assert np.ptp(log["steer_trailer_1"][50:]) < 1e-9
    assert abs(log["steer_trailer_2"]).max() < math.radians(0.5)


def test_a_brake_fault_pulls_the_vehicle_to_the_sound_side() -> None:
    """Without the brakes of the tractor's left side the combination turns to the right; the deceleration is less."""
    vehicle = load_vehicle("eu_tractor_semitrailer").with_failing_brakes()
    plant = Plant(vehicle, Surface(friction=0.8), "interpreted")
    start = plant.initial_state(Pose2(0.0, 0.0, 0.0), 15.0)
    left = tuple(0.0 if k < 4 and k % 2 == 0 else 1.0 for k in range(vehicle.n_wheels))
    speeds = {}
    for name, shares in (("sound", ()), ("ones", (1.0,) * vehicle.n_wheels), ("left", left)):
        state = plant.step(start, VehicleCommand(0.0, -3.0, (), 1.0, shares), 1000)
        truth = plant.observe(state, 1000)
        speeds[name] = float(truth.velocities[0, 0])
        yaw = float(truth.velocities[0, 2])
        assert (yaw < -0.005) if name == "left" else (abs(yaw) < 1e-9)
    assert speeds["sound"] == speeds["ones"] < speeds["left"] - 0.1


def test_brakes_of_one_side_of_an_axle_fail() -> None:
    parts = assembled("roundabout", "faults=brake_fault:0.25,2,1,-1@1")
    wheels_ahead = 2 * len(parts.vehicle.units[0].axles)
    shares = parts.brake_faults.shares(1000)
    assert [k for k, share in enumerate(shares) if share == 0.25] == [wheels_ahead + 1]
    assert set(parts.brake_faults.shares(0)) == {1.0}


def assembled(name: str, *settings: str) -> Assembly:
    return assemble(load_scenario(name, ("off_tracking=truth", *settings)), 1)


def test_loss_draws_the_same_numbers_whether_active_or_not() -> None:
    """A fault's time changes no message outside of it."""
    late, always = ([len(one) for one in carried(f"demand_loss:0.5@{start}", 60)] for start in ("0.3", "0"))
    assert late[30:] == always[30:]


def test_what_has_no_such_part_has_no_fault_of_it() -> None:
    rover = load_any_scenario("rover-slope", ("faults=demand_delay:0.2", "slip_estimator=truth"))
    assert isinstance(rover, RoverScenario)
    fmus = load_scenario("roundabout", ("off_tracking=truth", "faults=actuator_dead"))
    bare = load_vehicle(VEHICLE).model_copy(update={"brakes": None})
    refused: dict[str, Callable[[], object]] = {
        r"^the file of vehicle uk_longer_semitrailer has no table \[brakes\]$": bare.with_failing_brakes,
        r"^faults: demand_delay acts on .* of a run's trailer; a rover has none$": lambda: assemble_rover(rover, 1),
        r"^faults: actuator_dead acts on .*; a system of FMUs has none$": lambda: fmu_system(fmus, 1),
        r"amount = \[1.0, 2.0, 3.0\] must be offset \[deg\], axle": lambda: fault("actuator_offset:1,2,3"),
    }
    for complaint, build in refused.items():
        with pytest.raises(ValueError, match=complaint):
            build()
