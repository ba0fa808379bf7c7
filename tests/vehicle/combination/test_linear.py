"""The linearised lateral motion: against kinematics, python-control and the moving vehicle itself."""

import casadi as ca
import control
import numpy as np
import pytest

from tests.vehicle.chains import grouped, linear_tyre, with_axles
from vehicle.combination.chain import derivative
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle
from vehicle.combination.layout import Chain, Input, State, input_sizes, parts, state_sizes
from vehicle.combination.linear import LateralModel, OutputKind, flipped, kept, lateral_model, straight_running
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.surface import Surface

STIFFNESS = (4.0, 5.2, 4.4, 4.6, 4.8)  # of the axles, over load [1/rad]: all different


def ideal(vehicle: Vehicle) -> Vehicle:
    """The vehicle on tyres as textbooks have them: stiff in proportion to load, without rolling resistance."""
    loads = [load for of_unit in static_axle_loads(vehicle) for load in of_unit]
    tyres = [linear_tyre(c, load) for c, load in zip(STIFFNESS, loads, strict=False)]
    return with_axles(vehicle, *({"tyre": tyre} for tyre in tyres))


@pytest.mark.parametrize("speed", [5.0, 15.0, 25.0])
def test_outputs_are_what_the_motion_says(longer_semitrailer: Vehicle, speed: float) -> None:
    """By kinematics: the hitch's velocity, and a position whose second derivative is an acceleration."""
    model = lateral_model(
        ideal(longer_semitrailer), speed, outputs=("lateral_velocity", "axle_position", "follow_position"), path=True
    )
    tractor, trailer = longer_semitrailer.units
    h, state, row = tractor.rear_hitch[0], model.states.index, model.outputs.index
    v, r_1 = state("v_y"), state("yaw_rate_0")
    # At To's height the velocity across the trailer is the hitch's, turned by the articulation.
    hitch = np.zeros(len(model.A))
    hitch[[v, r_1, state("articulation_1")]] = 1.0, h, speed
    np.testing.assert_allclose(model.C[row("lateral_velocity_1")], hitch, atol=1e-12)  # rounding
    # d2/dt2 of an axle's place beside the path, from its row of C alone, is the acceleration of that point.
    a_axle = model.C[row("axle_position_0")] @ model.A @ model.A
    by_kinematics = model.A[v] + np.eye(len(model.A))[r_1] * speed + tractor.axles[0].x * model.A[r_1]
    np.testing.assert_allclose(a_axle, by_kinematics, atol=1e-9)  # rounding
    assert model.outputs[-1] == "follow_position_1"
    follow = model.C[-1] @ np.array([{"y": 1.0, "psi": 2.0, "articulation_1": 3.0}.get(s, 0.0) for s in model.states])
    assert trailer.follow_x is not None
    assert follow == pytest.approx(1.0 + 2.0 * h + trailer.follow_x * (2.0 - 3.0), abs=1e-12)  # y + h psi + x psi_S


ALL: tuple[OutputKind, ...] = ("yaw_rate", "lateral_velocity", "lateral_acceleration", "articulation", "load_transfer")


@pytest.mark.parametrize("name", ["eu_tractor_semitrailer", "uk_longer_semitrailer"])
def test_lags_leave_every_steady_gain_as_it_is(name: str) -> None:
    """A lag left out or kept, an actuator left out or kept: what is left in the end is the same."""
    vehicle = load_vehicle(name)
    reduced = lateral_model(vehicle, 22.0, outputs=ALL)
    for full in (
        lateral_model(vehicle, 22.0, outputs=ALL, tyre_dynamics=True),
        lateral_model(vehicle, 22.0, outputs=ALL, actuators=True),
        lateral_model(vehicle, 22.0, outputs=ALL, tyre_dynamics=True, actuators=True),
    ):
        for output in full.outputs:
            for to in full.inputs:
                # Rounding of two solutions; gains are of order 1 to 100 (hitch forces of 1e4 N are among the states).
                assert full.steady_gain(output, to) == pytest.approx(
                    reduced.steady_gain(output, to), rel=1e-7, abs=1e-8
                )


def as_control(model: LateralModel) -> control.StateSpace:
    return control.ss(
        model.A, model.B, model.C, model.D, states=model.states, inputs=model.inputs, outputs=model.outputs
    )


def test_small_motions_of_the_plant_are_those_of_the_linear_model(longer_semitrailer: Vehicle) -> None:
    """Steps of 0.5 mrad of all steering demands at 20 m/s, two seconds: the real vehicle and the linear one."""
    speed, ticks, n = 20.0, 10, 200
    plant = Plant(longer_semitrailer, Surface(friction=0.8))
    state, u = straight_running(longer_semitrailer, speed, 0.8)
    model = lateral_model(longer_semitrailer, speed, tyre_dynamics=True, actuators=True, outputs=("yaw_rate",))
    steps = {"steer": 5e-4, "trailer_steer_0": -5e-4, "trailer_steer_1": 5e-4}  # [rad]
    held = Input(*parts(u, input_sizes(longer_semitrailer))).acceleration[0]
    command = VehicleCommand(steps["steer"], held, (steps["trailer_steer_0"], steps["trailer_steer_1"]))
    got = []
    for tick in range(0, n * ticks, ticks):
        got.append(plant.observe(state, tick).velocities[:, 2])
        state = plant.step(state, command, ticks)
    times = np.arange(n) * ticks * 1e-3
    demands = np.array([[steps[name]] for name in model.inputs]) * np.ones(n)
    expected = control.forced_response(as_control(model), times, demands).outputs
    # 1.6e-4 are left at half and at twice these steps, so not of what is not linear: integration at 1 ms.
    np.testing.assert_allclose(np.array(got).T, expected, atol=5e-4 * np.abs(expected).max())


def test_friction_does_not_matter_to_freely_rolling_tyres(tractor_semitrailer: Vehicle) -> None:
    """The initial stiffness of a tyre is the same on any ground; without drag no force uses up friction."""
    vehicle = ideal(tractor_semitrailer)
    dry, icy = (lateral_model(vehicle, 20.0, friction=friction) for friction in (0.8, 0.1))
    np.testing.assert_allclose(icy.A, dry.A, atol=1e-9)  # rounding


def test_axles_steered_in_a_group_move_by_their_ratios(longer_semitrailer: Vehicle) -> None:
    """One actuator with ratios 1 and 0.5: its column of B is that of the first axle plus half that of the second."""
    single, group = lateral_model(longer_semitrailer, 20.0), lateral_model(grouped(longer_semitrailer), 20.0)
    assert group.inputs == ("steer", "trailer_steer_0")
    np.testing.assert_allclose(group.B[:, 1], single.B[:, 1] + 0.5 * single.B[:, 2], atol=1e-9)  # rounding


def test_a_linked_axle_of_the_tractor_turns_by_its_ratio_of_the_foremost_one() -> None:
    """The driver's demand is the first axle's angle; the linkage turns the second by r times that."""
    truck = load_vehicle("rigid_truck_8x4")
    own = {"steer_group": None, "steer_ratio": 1.0}
    first, second = (
        lateral_model(with_axles(truck, *({**own, "steered": k == steered} for k in range(4))), 20.0).B[:, 0]
        for steered in (0, 1)
    )
    ratio = truck.units[0].axles[1].steer_ratio
    np.testing.assert_allclose(lateral_model(truck, 20.0).B[:, 0], first + ratio * second, atol=1e-9)  # rounding


def test_an_engine_too_weak_for_the_speed_does_not_matter(tractor_semitrailer: Vehicle) -> None:
    drive = tractor_semitrailer.drive.model_copy(update={"max_power": 1e4})  # [W], of some 50 kW that drag takes
    weak = tractor_semitrailer.model_copy(update={"drive": drive})
    np.testing.assert_array_equal(lateral_model(weak, 25.0).A, lateral_model(tractor_semitrailer, 25.0).A)


def test_positions_need_a_path(tractor_semitrailer: Vehicle) -> None:
    with pytest.raises(ValueError, match="path=True"):
        lateral_model(tractor_semitrailer, 20.0, outputs=("follow_position",))


# Straight running, about which it is linearised


SPEED = 20.0  # [m/s]


def rate_and_slope(vehicle: Vehicle, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivative of the state, and its jacobian."""
    at, demands = ca.SX.sym("x", x.size), ca.SX.sym("u", u.size)
    s, d = State(*parts(at, state_sizes(vehicle))), Input(*parts(demands, input_sizes(vehicle)))
    rate = ca.vertcat(*derivative(Chain.of(vehicle), s, d))
    value, slope = ca.Function("f", [at, demands], [rate, ca.jacobian(rate, at)])(x, u)
    return np.array(value).ravel(), np.array(slope)


def test_nothing_changes_in_straight_running_but_the_place(chain: Vehicle) -> None:
    """All forces balance: every rate but that of x vanishes, and the speed is the one asked for."""
    x, u = straight_running(chain, SPEED, 0.8)
    s = State(*parts(x, state_sizes(chain)))
    rate = State(*parts(rate_and_slope(chain, x, u)[0], state_sizes(chain)))
    assert s.v_x[0] == SPEED
    assert rate.x[0] == SPEED
    for name, part, value in zip(State._fields, rate, s, strict=True):
        if name != "x":
            # Rounding, times the fastest rates of some 1e3 1/s; hitch forces are of 1e3 N.
            np.testing.assert_allclose(part, 0.0, atol=1e-9 * (1.0 + np.abs(value).max(initial=0.0)), err_msg=name)


def test_the_drive_makes_up_for_rolling_resistance(chain: Vehicle) -> None:
    """The torque that holds the speed would accelerate a vehicle without drag by coefficient times gravity."""
    x, u = straight_running(chain, SPEED, 0.8)
    coefficient = chain.units[0].axles[0].tyre.rolling_resistance
    held = Input(*parts(u, input_sizes(chain))).acceleration[0]
    # Loads move with the pull, and the driven wheels roll a little faster than the vehicle, with a torque of drag.
    assert held == pytest.approx(coefficient * GRAVITY, rel=2e-3)
    assert State(*parts(x, state_sizes(chain))).acceleration[0] == held


def test_the_two_halves_of_the_state_are_all_of_it(chain: Vehicle) -> None:
    """Every coordinate reads its own direction as 1 and all others as 0, and there are as many as states."""
    coordinates = kept(chain) + flipped(chain)
    read = np.stack([c.reading for c in coordinates])
    move = np.column_stack([c.direction for c in coordinates])
    np.testing.assert_array_equal(read @ move, np.eye(sum(state_sizes(chain))))
    assert len({c.name for c in kept(chain)}) == len(kept(chain))
    assert len({c.name for c in flipped(chain)}) == len(flipped(chain))


def test_neither_half_acts_on_the_other(chain: Vehicle) -> None:
    """To first order about straight running: the blocks of the jacobian between the halves are empty."""
    _, slope = rate_and_slope(chain, *straight_running(chain, SPEED, 0.8))
    even, odd = kept(chain), flipped(chain)
    for one, other in ((even, odd), (odd, even)):
        block = np.stack([c.reading for c in one]) @ slope @ np.column_stack([c.direction for c in other])
        # Rounding beside entries of the order of a whole row: hitch forces react by 1e7 N/s per unit of deflection.
        scale = np.abs(np.stack([c.reading for c in one]) @ slope).max(axis=1, keepdims=True)
        assert (np.abs(block) / (1.0 + scale)).max() < 1e-12


@pytest.mark.parametrize("speed", [0.0, -3.0, float("nan")])
def test_straight_running_needs_a_speed(tractor_semitrailer: Vehicle, speed: float) -> None:
    """At rest slip is not defined, and backwards the chain folds: both are refused."""
    with pytest.raises(ValueError, match=r"speed = .* m/s must be positive"):
        straight_running(tractor_semitrailer, speed, 0.8)


def test_a_speed_that_can_not_be_held_is_refused(tractor_semitrailer: Vehicle) -> None:
    """10 kW hold a laden combination at no motorway speed: its drag alone takes 47 kW."""
    weak = tractor_semitrailer.model_copy(
        update={"drive": tractor_semitrailer.drive.model_copy(update={"max_power": 1e4})}
    )
    with pytest.raises(ValueError, match=r"speed = 20.0 m/s cannot be held by eu_tractor_semitrailer"):
        straight_running(weak, SPEED, 0.8)


def test_more_drag_than_grip_is_refused(tractor_semitrailer: Vehicle) -> None:
    """On ice the drive axle, 28 % of the weight, can not pull a drag of 3 %."""
    stuck = with_axles(tractor_semitrailer, tyre={"rolling_resistance": 0.03})
    with pytest.raises(ValueError, match=r"cannot be held .* on a friction of 0.05"):
        straight_running(stuck, 5.0, 0.05)
