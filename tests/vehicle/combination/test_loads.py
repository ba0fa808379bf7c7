"""Vertical loads: the weighed ones at rest, equilibrium in motion."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.vehicle.chains import named, outputs, rates, with_axles
from vehicle.combination.data_sheet import coupling_loads
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.layout import Input, input_sizes, parts, wheels
from vehicle.combination.linear import straight_running
from vehicle.combination.loads import chain_loads, roll_moments, static_axle_loads, wheel_loads
from vehicle.combination.multibody import Vector
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.combination.unit import LoadSharing
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface

accelerations = st.floats(-6.0, 6.0)


def tonnes(vehicle: Vehicle) -> list[list[float]]:
    return [[load / GRAVITY / 1000.0 for load in unit] for unit in static_axle_loads(vehicle)]


def test_static_axle_loads_are_those_of_the_audited_set(tractor_semitrailer: Vehicle) -> None:
    """Steer 7.10 t, drive 11.40 t, tridem 21.50 t, hence 10.50 t on the kingpin."""
    (steer, drive), tridem = tonnes(tractor_semitrailer)
    assert (steer, drive, sum(tridem)) == pytest.approx((7.10, 11.40, 21.50), abs=1e-5)  # kingpin given to 0.1 um
    tractor, kingpin = coupling_loads(tractor_semitrailer)
    assert tractor is None
    assert kingpin is not None
    assert kingpin / GRAVITY == pytest.approx(10.5e3, abs=1.0)  # [kg], the set's own rounding


def test_shares_of_brakes_and_drive_add_up(chain: Vehicle) -> None:
    """The demanded acceleration is that of the whole combination."""
    layout = wheels(chain)
    assert sum(wheel.brake_share for wheel in layout) == pytest.approx(1.0)
    assert sum(wheel.drive_share for wheel in layout) == pytest.approx(1.0)


def loads_with_pull(vehicle: Vehicle, a: float, pull: float, gamma: float = 0.0) -> list[list[float]]:
    """Axle loads [N] of tractor and semi-trailer at an acceleration, the hitch pulling the trailer."""
    e = [Vector(1.0, 0.0), Vector(np.cos(gamma), np.sin(gamma))]
    loads = chain_loads(vehicle, [GRAVITY] * 2, [a, a], [Vector(0.0, 0.0), Vector(pull, 0.0)], e).axles
    return [[float(load) for load in unit_loads] for unit_loads in loads]


@given(a=accelerations, pull=st.floats(-5e4, 5e4), gamma=st.floats(-1.5, 1.5))
def test_the_wheels_carry_the_weight(tractor_semitrailer: Vehicle, a: float, pull: float, gamma: float) -> None:
    """Vertical equilibrium of the whole, however it moves and bends."""
    loads = loads_with_pull(tractor_semitrailer, a, pull, gamma)
    assert sum(map(sum, loads)) == pytest.approx(tractor_semitrailer.mass * GRAVITY, rel=1e-12)


@given(a=accelerations, pull=st.floats(-5e4, 5e4))
def test_the_wheels_balance_the_pitching_moment(tractor_semitrailer: Vehicle, a: float, pull: float) -> None:
    """About the rear axle, for the straight whole: hitch forces are internal and must cancel."""
    tractor, trailer = tractor_semitrailer.units
    ahead, behind = loads_with_pull(tractor_semitrailer, a, pull)
    x = [axle.x for axle in tractor.axles] + [tractor.rear_hitch[0] + axle.x for axle in trailer.axles]
    inertia = sum(unit.mass * a * unit.cg_height for unit in (tractor, trailer))
    weight = GRAVITY * (tractor.mass * tractor.cg_x + trailer.mass * (tractor.rear_hitch[0] + trailer.cg_x))
    assert np.dot(x, ahead + behind) == pytest.approx(weight - inertia, rel=1e-9)


def test_roll_moments_add_up_and_load_the_outside(chain: Vehicle) -> None:
    """All of m h a_y loads the wheels, through any number of hitches; in a left turn (a_y > 0) the right ones."""
    a_y = [1.0 + 0.1 * i for i in range(len(chain.units))]
    moments = roll_moments(chain, a_y, [0.0] * len(a_y), [GRAVITY] * len(a_y))
    total = sum(unit.mass * unit.cg_height * a for unit, a in zip(chain.units, a_y, strict=True))
    assert sum(moments) == pytest.approx(total)
    left, right = wheel_loads(6e4, 5e3)
    assert right > 3e4 > left


@given(st.floats(-1e5, 2e5), st.floats(-1e5, 1e5))
def test_a_wheel_never_pulls_the_ground_up_and_its_partner_then_carries_the_axle(axle: float, transfer: float) -> None:
    """A lifted wheel carries (next to) nothing; a loaded one what equilibrium asks for."""
    left, right = wheel_loads(axle, transfer)
    assert min(left, right) >= 10.0 - 1e-9  # [N], so that nothing divides by zero
    assert left + right == pytest.approx(max(axle, 20.0))
    expected = min(max(0.5 * axle - transfer, 0.0), max(axle, 0.0))
    assert left == pytest.approx(expected, abs=10.0 + 1e-9)


# --- groups of axles ---


def test_a_compensated_group_shares_by_load_share(tractor_semitrailer: Vehicle) -> None:
    """The tridem as 1 : 1 : 2 carries what holds the trailer level about its hitch, from another centre."""
    shared = with_axles(tractor_semitrailer, {}, {}, {}, {}, {"load_share": 2.0})
    trailer = static_axle_loads(shared)[1]
    centre = -(6.39 + 7.70 + 2.0 * 9.01) / 4.0
    whole = 32000.0 * GRAVITY * 5.1734375 / -centre
    assert trailer == pytest.approx([0.25 * whole, 0.25 * whole, 0.5 * whole])


def test_a_bogie_of_the_tractor_is_one_support_and_shares_within(tractor_semitrailer: Vehicle) -> None:
    """Steer axle and a bogie of drive (2) and tag (1): two supports, so that equilibrium alone gives the loads."""
    tractor = tractor_semitrailer.units[0]
    drive = tractor.axles[1]
    axles = (
        tractor.axles[0],
        drive.model_copy(update={"bogie": "rear", "load_share": 2.0}),
        drive.model_copy(update={"x": -1.35, "driven": False, "bogie": "rear"}),
    )
    units = (tractor.model_copy(update={"axles": axles}), *tractor_semitrailer.units[1:])
    (steer, driven, tag), tridem = static_axle_loads(tractor_semitrailer.model_copy(update={"units": units}))
    assert driven == pytest.approx(2.0 * tag)
    weight = tractor_semitrailer.mass * GRAVITY - sum(tridem)
    assert steer + driven + tag == pytest.approx(weight)
    kingpin = weight - 8000.0 * GRAVITY
    assert 3.8 * steer - 1.35 * tag == pytest.approx(8000.0 * GRAVITY * tractor.cg_x + kingpin * tractor.rear_hitch[0])


def test_a_beam_on_three_springs_loads_them_by_its_tilt(tractor_semitrailer: Vehicle) -> None:
    """Three axles without a bogie: equilibrium, and loads over stiffness on one straight line."""
    tractor = tractor_semitrailer.units[0]
    drive = tractor.axles[1]
    axles = (tractor.axles[0], drive.model_copy(update={"load_share": 2.0}), drive.model_copy(update={"x": -1.35}))
    units = (tractor.model_copy(update={"axles": axles}), *tractor_semitrailer.units[1:])
    loads = static_axle_loads(tractor_semitrailer.model_copy(update={"units": units}))[0]
    sunk = np.array(loads) / [1.0, 2.0, 1.0]
    assert np.diff(sunk) / np.diff([3.8, 0.0, -1.35]) == pytest.approx([(sunk[0] - sunk[2]) / 5.15] * 2)


def test_named_bogies_of_a_towed_unit_turn_about_its_hitch(tractor_semitrailer: Vehicle) -> None:
    """Front axle alone, the rear two a bogie: loads of the two groups go by stiffness times distance to the hitch."""
    trailer = static_axle_loads(
        with_axles(tractor_semitrailer, {}, {}, {"bogie": "a"}, {"bogie": "b"}, {"bogie": "b"})
    )[1]
    centre = 0.5 * (7.70 + 9.01)
    assert trailer[1] == pytest.approx(trailer[2])
    assert (trailer[1] + trailer[2]) / trailer[0] == pytest.approx(2.0 * centre / 6.39)
    assert 6.39 * trailer[0] + 7.70 * trailer[1] + 9.01 * trailer[2] == pytest.approx(32000.0 * GRAVITY * 5.1734375)


# Axle groups on uneven road: how much an axle on a bump carries, and how it is equalised


STIFFNESS, LAG, BUMP = 1.2e6, 3.0, 0.02  # [N/m], [s], [m]


@pytest.fixture(scope="module")
def shared(tractor_semitrailer: Vehicle) -> Vehicle:
    tractor, trailer = tractor_semitrailer.units
    slow = trailer.model_copy(update={"load_sharing": LoadSharing(stiffness=STIFFNESS, lag=LAG)})
    return tractor_semitrailer.model_copy(update={"units": (tractor, slow)})


def on_a_bump(vehicle: Vehicle, shift: tuple[float, ...] = ()) -> tuple[FloatArray, FloatArray]:
    """Loads of all axles [N] with the middle axle of the tridem on a bump, and the rate of the shifts [N/s]."""
    x, u = straight_running(vehicle, 10.0, 0.8)
    s, given = named(vehicle, x)._replace(load_shift=np.array(shift)), Input(*parts(u, input_sizes(vehicle)))
    road = np.zeros(vehicle.n_wheels)
    road[6:8] = BUMP
    at = vehicle, s, given._replace(road=road)
    return outputs(*at).load.reshape(-1, 2).sum(axis=1), rates(*at).load_shift


def test_an_axle_on_a_bump_takes_load_from_its_group(shared: Vehicle, tractor_semitrailer: Vehicle) -> None:
    """It stands 2 / 3 of the bump above the group's mean, the others 1 / 3 below, each times c."""
    equal, _ = on_a_bump(tractor_semitrailer)
    loads, rate = on_a_bump(shared, (0.0, 0.0, 0.0))
    np.testing.assert_allclose(equal[2:], equal[2], rtol=1e-12)
    expected = STIFFNESS * BUMP * np.array([-1.0, 2.0, -1.0]) / 3.0
    np.testing.assert_allclose((loads - equal)[2:], expected, atol=1e-6)  # the middle of the group keeps its place
    np.testing.assert_allclose(rate, expected / LAG, atol=1e-6)
    np.testing.assert_allclose(loads[:2], equal[:2], rtol=1e-9)  # the hitch's load is the same


def test_an_equalised_group_shares_equally(shared: Vehicle, tractor_semitrailer: Vehicle) -> None:
    """Once all additional load has been given back, uneven road makes no difference, and nothing moves."""
    back = tuple(STIFFNESS * BUMP * part / 3.0 for part in (-1.0, 2.0, -1.0))
    loads, rate = on_a_bump(shared, back)
    np.testing.assert_allclose(loads, on_a_bump(tractor_semitrailer)[0], rtol=1e-9)
    np.testing.assert_allclose(rate, 0.0, atol=1e-9)


def test_a_group_out_of_balance_loads_the_hitch(shared: Vehicle, tractor_semitrailer: Vehicle) -> None:
    """Load on the foremost axle instead of the rearmost one: moments about the hitch stay in balance."""
    x = np.array([axle.x for axle in shared.units[1].axles])
    equal, loads = on_a_bump(tractor_semitrailer)[0], on_a_bump(shared, (-9e3, 0.0, 9e3))[0]
    assert loads[2] > loads[4] + 1.7e4
    assert loads[2:] @ x == pytest.approx(equal[2:] @ x, rel=1e-9)
    assert loads.sum() == pytest.approx(equal.sum(), rel=1e-9)


def test_the_shift_follows_the_road_with_its_lag(shared: Vehicle) -> None:
    """In the plant on a plane nothing is shifted; a shift that is there decays with the lag."""
    plant = Plant(shared, Surface(friction=0.8), engine="interpreted")
    state = named(shared, plant.initial_state(Pose2(0.0, 0.0, 0.0), 10.0))
    start = np.concatenate(state._replace(load_shift=np.array([6e3, -3e3, -3e3])))
    later = plant.step(start, VehicleCommand(0.0, 0.06, ()), 1500)
    shift = named(shared, later).load_shift
    np.testing.assert_allclose(shift, math.exp(-0.5) * np.array([6e3, -3e3, -3e3]), rtol=1e-6)
