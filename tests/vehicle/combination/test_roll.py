"""Roll on suspensions and tyres, coupled through the hitches: equilibrium, lift-off, fifth wheel, static rollover."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.vehicle.chains import named, with_axles
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle, vehicle_names
from vehicle.combination.functions import step_function
from vehicle.combination.handling import understeer_gradient
from vehicle.combination.layout import state_sizes
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.combination.roll import roll_gradients, settled_rolls, springs_of, static_rollover
from vehicle.combination.sprung import settled
from vehicle.combination.variants import changed_vehicle, with_load
from vehicle.engine.function_cache import written_out
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Roughness, RoughProfile, Surface

ORIGIN = Pose2(0.0, 0.0, 0.0)


@given(body=st.floats(-0.2, 0.2), side=st.floats(-6e4, 6e4))
def test_the_axle_is_in_equilibrium(tractor_semitrailer: Vehicle, body: float, side: float) -> None:
    """Moments about the ground: the springs' one, the side force at the roll centre, the load beside it.

    On both wheels the tyres' deflection carries them, on one wheel half the track times the load.
    """
    spring = springs_of(tractor_semitrailer)[1].axles[1]
    W, T, h = float(spring.weight), float(spring.track), float(spring.height)
    transfer = float(spring.transfer(body, side))
    right_less_left = float(np.clip(2.0 * transfer, -W, W))
    springs = float(spring.lever) * side - float(spring.body_moment(body, side, right_less_left))
    angle = body - springs / float(spring.suspension)
    ground = 0.5 * T * right_less_left
    assert ground == pytest.approx(springs + h * side + W * h * angle, abs=1e-6)
    if abs(transfer) < 0.5 * W * (1.0 - 1e-12):
        assert ground == pytest.approx(float(spring.tyres) * angle, abs=1e-6)  # [N m] of 1e5: rounding
    else:
        assert abs(float(spring.tyres) * angle) > 0.5 * T * W  # the lifted wheel is clear of the ground


@given(body=st.floats(-0.2, 0.2), rate=st.floats(0.01, 0.3))
def test_dampers_act_while_the_wheels_stand(tractor_semitrailer: Vehicle, body: float, rate: float) -> None:
    """Moment at one angle, rolling up less rolling down: twice that of the data's dampers, or none with a side lifted.

    A lifted axle follows its body, so that its springs and dampers do not move. The dampers take energy in between.
    """
    springs = springs_of(tractor_semitrailer)[1]

    def moment(sign: float) -> float:
        whole = 0.0
        for axle in springs.axles:
            lean = body + sign * float(springs.time) * rate
            excess = np.clip(2.0 * float(axle.transfer(lean, 0.0)), -axle.weight, axle.weight)
            whole += float(axle.body_moment(body, 0.0, float(excess)))
        return whole

    damped = 2.0 * float(springs.damping * springs.inertia) * rate
    lifts = [abs(2.0 * float(axle.transfer(abs(body), 0.0))) / float(axle.weight) for axle in springs.axles]
    reach = float(springs.time) * rate * float(springs.axles[0].transfer(2.0, 0.0)) / float(springs.axles[0].weight)
    loss = moment(-1.0) - moment(+1.0)
    if max(lifts) < 1.0 - reach:
        assert loss == pytest.approx(damped)
    elif min(lifts) > 1.0 + reach:
        assert loss == pytest.approx(0.0, abs=1e-9 * damped)
    else:
        assert -1e-9 * damped <= loss <= damped * (1.0 + 1e-9)


def test_fifth_wheel_separates_at_its_edge_and_catches_after_the_lash(tractor_semitrailer: Vehicle) -> None:
    """K twist up to load times half the width, then that over the lash of 2 deg, then K again; both ways alike."""
    springs = springs_of(tractor_semitrailer)[1]
    assert springs.hitch is not None
    K, load, lash = float(springs.hitch), 100e3, math.radians(2.0)
    edge = 0.45 * load
    for twist, expected in (
        (0.5 * edge / K, 0.5 * edge),
        (edge / K + 0.5 * lash, edge),
        (edge / K + lash + 0.01, edge + K * 0.01),
    ):
        assert float(springs.hitch_moment(twist, load)) == pytest.approx(expected)
        assert float(springs.hitch_moment(-twist, load)) == pytest.approx(-expected)
    assert float(springs.hitch_moment(0.01, -5e3)) == 0.0  # a hitch that pulls up rests on no plate


def test_twin_tyres_carry_in_roll_by_their_own_places(tractor_semitrailer: Vehicle) -> None:
    """Sum of k y^2 over four tyres of half the wheel's stiffness."""
    axle = tractor_semitrailer.units[0].axles[1]
    assert axle.suspension is not None
    places = [0.5 * axle.track + 0.5 * s * 0.34 for s in (-1.0, 1.0)]
    by_tyre = 2.0 * sum(0.5 * axle.suspension.tyre_stiffness * y**2 for y in places)
    assert axle.suspension.tyre_roll_stiffness(axle.track, 0.34) == pytest.approx(by_tyre)


def test_it_settles_on_a_bank_as_it_starts(tractor_semitrailer: Vehicle) -> None:
    """Rolls by the linear equations, and ten seconds later on the plant; the moments of all wheels balance the weight.

    About the line under the middle of the track: m g sin h of every body, and m g cos times its lateral offset.
    """
    bank = 0.1
    plant = Plant(tractor_semitrailer, Surface(friction=1.0, cross_fall=bank))
    state = plant.initial_state(ORIGIN, 0.0)
    start = named(tractor_semitrailer, state)
    expected = settled_rolls(
        tractor_semitrailer, springs_of(tractor_semitrailer), [GRAVITY * math.sin(math.atan(bank))] * 2
    )
    assert np.abs(start.roll) == pytest.approx([float(roll) for roll in expected], rel=1e-12)
    end = plant.step(state, VehicleCommand(0.0, 0.0, ()), 10_000)
    now = named(tractor_semitrailer, end)
    np.testing.assert_allclose(now.roll, start.roll, rtol=5e-3)  # weight of cos(bank), and how the tyres share forces


def test_dampers_are_given_or_follow_from_the_ratio(tractor_semitrailer: Vehicle) -> None:
    """The sum of the axles' dampers over the inertia; without them 2 zeta sqrt(K / I)."""
    trailer = tractor_semitrailer.units[1]
    given = springs_of(tractor_semitrailer)[1]
    assert float(given.damping * given.inertia) == pytest.approx(3 * 1.39e5)
    changes = [axle.suspension.model_copy(update={"roll_damping": None}) for axle in trailer.axles if axle.suspension]
    undamped = with_axles(tractor_semitrailer, {}, {}, *({"suspension": suspension} for suspension in changes))
    by_ratio = springs_of(undamped)[1]
    w = math.sqrt(float(by_ratio.stiffness) / float(by_ratio.inertia))
    assert float(by_ratio.damping) == pytest.approx(2.0 * trailer.suspension_damping * w)


def test_a_drawbar_transmits_no_moment() -> None:
    """The rear pair of an A-double tips alone: stiffer springs in front change nothing."""
    vehicle = load_vehicle("a_double")
    tractor = {f"units.0.axles.{k}.suspension.roll_stiffness": 5e6 for k in range(3)}
    before, after = static_rollover(vehicle), static_rollover(changed_vehicle(vehicle, tractor))
    assert after.roll[3] == pytest.approx(before.roll[3], rel=1e-3) or after.threshold > before.threshold
    rear = {f"units.2.axles.{k}.suspension.roll_stiffness": 5e6 for k in range(2)}
    stiffer = roll_gradients(changed_vehicle(vehicle, rear))
    assert stiffer[:2] == pytest.approx(roll_gradients(vehicle)[:2], rel=1e-12)
    assert stiffer[3] < roll_gradients(vehicle)[3]


@pytest.mark.parametrize("name", [name for name in vehicle_names() if load_vehicle(name).has_springs])
def test_every_shipped_vehicle_tips_within_the_measured_range(name: str) -> None:
    """Laden combinations 0.35 to 0.5 g, light ones to 0.55 g; more with half the load, and twice that without.

    A compliant vehicle tips below half the track over the height of its whole centre of gravity.
    """
    vehicle = load_vehicle(name)
    full, half, empty = (static_rollover(with_load(vehicle, case)) for case in ("full", "half", "unladen"))
    assert 0.35 < full.threshold / GRAVITY < 0.55
    assert full.threshold < half.threshold < empty.threshold
    assert 0.65 < empty.threshold / GRAVITY < 0.95
    height = sum(u.mass * u.cg_height for u in vehicle.units) / vehicle.mass
    track = max(axle.track for unit in vehicle.units for axle in unit.axles)
    assert full.threshold / GRAVITY < 0.5 * track / height


def test_the_trailer_lifts_before_the_drive_axle(tractor_semitrailer: Vehicle) -> None:
    """All trailer axles lift before the drive axle; the threshold itself is in ``offtrack validate``."""
    assert static_rollover(tractor_semitrailer).lifted == ((False, False), (True, True, True))


def test_bodies_that_the_springs_do_not_carry_are_refused() -> None:
    truck = load_vehicle("rigid_truck")
    soft = changed_vehicle(truck, {f"units.0.axles.{k}.suspension.roll_stiffness": 7e4 for k in range(2)})
    with pytest.raises(ValueError, match=r"^rigid_truck falls over where it stands"):
        static_rollover(soft)


def test_without_suspensions_nothing_is_computed_for_them(short_form: Vehicle, tractor_semitrailer: Vehicle) -> None:
    """No states and no operations; with them, those of five axles and a hitch."""
    assert sum(state_sizes(short_form)) == sum(state_sizes(tractor_semitrailer)) - 5
    count = {v.has_springs: written_out(step_function(v)).n_instructions() for v in (short_form, tractor_semitrailer)}
    assert count[True] < 1.12 * count[False]  # lift-off, tyres and hitch of five axles


def test_a_lifted_unit_falls_and_stays_finite(tractor_semitrailer: Vehicle) -> None:
    """Beyond the threshold the roll grows; a body that lies on its side is not thrown further and further."""
    plant = Plant(tractor_semitrailer, Surface(friction=1.5, cross_fall=0.2))
    state = plant.initial_state(ORIGIN, 0.0)
    at = named(tractor_semitrailer, state)
    at.roll[:] = np.sign(at.roll) * 0.9
    at.roll_spring[:] = at.roll * [float(springs.damping) for springs in springs_of(tractor_semitrailer)]  # no motion
    end = named(tractor_semitrailer, plant.step(state, VehicleCommand(0.0, 0.0, ()), 3000))
    assert np.abs(end.roll).min() > 0.9
    assert np.isfinite(np.concatenate(end)).all()


# Roll steer and bump steer: axles that their suspensions turn as the body moves


SPEED = 20.0  # [m/s]


def truck(axle: int = 1, /, **numbers: float) -> Vehicle:
    return changed_vehicle(load_vehicle("rigid_truck"), {f"units.0.axles.{axle}.{k}": v for k, v in numbers.items()})


def roll_gradient(vehicle: Vehicle) -> float:
    """Steady roll of the body per lateral acceleration [rad/(m/s2)]."""
    ((attitude, _),) = settled(vehicle, [0.0], [1.0])
    return float(attitude.roll)


@pytest.mark.parametrize(("axle", "sign"), [(1, 1.0), (0, -1.0)])
def test_roll_steer_adds_to_the_understeer_gradient(axle: int, sign: float) -> None:
    """delta = L / R + K a_y + rear angle - front's own: the gradient grows by roll steer times the roll gradient.

    Understeer if the rear axle turns into the turn, oversteer if the front axle does.
    """
    plain, steering = truck(), truck(axle, roll_steer=0.1)
    added = understeer_gradient(steering, SPEED) - understeer_gradient(plain, SPEED)
    assert added == pytest.approx(sign * 0.1 * roll_gradient(plain), rel=0.02)  # the front wheels are no single one


def test_bump_steer_in_roll_is_roll_steer_by_half_the_track() -> None:
    """In roll the left wheel goes down as much as the right one up: both turn to the same side."""
    track = load_vehicle("rigid_truck").units[0].axles[1].track
    bump, roll = truck(bump_steer=0.1), truck(roll_steer=0.1 * 0.5 * track)
    assert understeer_gradient(bump, SPEED) == pytest.approx(understeer_gradient(roll, SPEED), rel=1e-6)


def driven(vehicle: Vehicle, side: float, surface: Surface) -> FloatArray:
    """x, y, psi of the truck after 3 s of steer to one side."""
    plant = Plant(vehicle, surface)
    state = plant.initial_state(Pose2(0.0, 0.0, 0.0), SPEED)
    pose: FloatArray = plant.observe(plant.step(state, VehicleCommand(side * 0.02, 0.0, ()), 3000), 3000).poses[0]
    return pose


def test_both_pass_the_mirror_test() -> None:
    """Left and right change places, so do the signs of all angles; bump steer turns the wheels of an axle apart."""
    vehicle = truck(roll_steer=0.15, bump_steer=0.2)
    left, right = (driven(vehicle, side, Surface(friction=0.8)) for side in (1.0, -1.0))
    np.testing.assert_allclose(right, left * (1.0, -1.0, -1.0), rtol=1e-9, atol=1e-9)
    assert abs(left[1] - driven(truck(), 1.0, Surface(friction=0.8))[1]) > 0.05  # [m], and they do something


def test_roll_steer_makes_a_truck_weave_on_a_rough_road() -> None:
    """The road rolls axles under the body: an axle that this steers yaws the truck, by half as much again."""
    yawing = []
    for vehicle in (truck(), truck(roll_steer=0.3)):
        road = Roughness(profile=RoughProfile(np.random.default_rng(1), "B"))
        plant = Plant(vehicle, Surface(friction=0.8, roughness=road))
        state = plant.initial_state(Pose2(0.0, 0.0, 0.0), SPEED)
        rates = []
        for k in range(400):
            rates.append(plant.observe(state, 20 * k).velocities[0, 2])
            state = plant.step(state, VehicleCommand(0.0, 0.0, ()), 20)
        yawing.append(float(np.std(rates[100:])))
    assert yawing[1] > 1.3 * yawing[0]
