"""Sprung bodies: where they settle, how they swing, and what they do to the wheels' loads."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from tests.vehicle.chains import at_rest, outputs
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.layout import Chain, Input, State, wheels
from vehicle.combination.sprung import Ride, rides, settled, spring_rates


def bodies(vehicle: Vehicle, s: State[np.ndarray], u: Input[np.ndarray]) -> list[Ride]:
    return rides(Chain.of(vehicle), s, u)


def swing(vehicle: Vehicle, unit: int, a_y: float, t: np.ndarray) -> np.ndarray:
    """Roll [rad] of a unit after a step of lateral specific force, from the equations."""
    s, u = at_rest(vehicle)

    def f(_: float, y: np.ndarray) -> np.ndarray:
        roll, spring = np.zeros(len(s.roll)), np.zeros(len(s.roll))
        roll[unit], spring[unit] = y
        ride = bodies(vehicle, s._replace(roll=roll, roll_spring=spring), u)[unit]
        return np.array([ride.rate.roll, spring_rates(vehicle.units[unit], ride, 0.0, a_y).roll])

    roll: np.ndarray = solve_ivp(f, (0.0, t[-1]), [0.0, 0.0], t_eval=t, rtol=1e-10, atol=1e-13).y[0]
    return roll


def test_a_step_of_lateral_acceleration_rolls_a_body_as_a_second_order_system(short_form: Vehicle) -> None:
    """Closed form: G a (1 - exp(-z w t) (cos(w_d t) + z w / w_d sin(w_d t))), w_d = w sqrt(1 - z^2)."""
    for k, unit in enumerate(short_form.units):
        t = np.linspace(0.0, 2.0, 41)
        w, z = math.tau * unit.roll_swing[1], unit.suspension_damping
        w_d = w * math.sqrt(1.0 - z**2)
        shape = 1.0 - np.exp(-z * w * t) * (np.cos(w_d * t) + z * w / w_d * np.sin(w_d * t))
        expected = unit.roll_swing[0] * 2.0 * shape
        np.testing.assert_allclose(swing(short_form, k, 2.0, t), expected, atol=1e-9)  # of 1e-2; the solver's


def test_a_step_of_the_road_lifts_a_body_through_springs_and_dampers(tractor_semitrailer: Vehicle) -> None:
    """Base excitation: h (1 - exp(-z w t) (cos(w_d t) - z w / w_d sin(w_d t))); no rate of the road is needed."""
    unit = tractor_semitrailer.units[0]
    s, u = at_rest(tractor_semitrailer, road=np.full(10, 0.03))
    t = np.linspace(0.0, 2.0, 41)
    w, z = math.tau * unit.heave_frequency, unit.suspension_damping
    w_d = w * math.sqrt(1.0 - z**2)

    def f(_: float, y: np.ndarray) -> np.ndarray:
        named = s._replace(heave=np.array([y[0], 0.0]), heave_spring=np.array([y[1], 0.0]))
        ride = bodies(tractor_semitrailer, named, u)[0]
        return np.array([ride.rate.heave, spring_rates(unit, ride, 0.0, 0.0).heave])

    got = solve_ivp(f, (0.0, 2.0), [0.0, 0.0], t_eval=t, rtol=1e-10, atol=1e-13).y[0]
    expected = 0.03 * (1.0 - np.exp(-z * w * t) * (np.cos(w_d * t) - z * w / w_d * np.sin(w_d * t)))
    np.testing.assert_allclose(got, expected, atol=1e-9)  # of 3e-2; the solver's


@given(a=st.floats(-4.0, 4.0), b=st.floats(-4.0, 4.0))
def test_settled_bodies_stay(chain: Vehicle, a: float, b: float) -> None:
    """Under the specific forces they settled under nothing moves, and the springs carry just these."""
    n = len(chain.units)
    attitudes, springs = (np.array(of_all).T for of_all in zip(*settled(chain, [a] * n, [b] * n), strict=True))
    s, u = at_rest(chain)
    s = s._replace(heave=attitudes[0], pitch=attitudes[1], roll=attitudes[2])
    s = s._replace(heave_spring=springs[0], pitch_spring=springs[1], roll_spring=springs[2])
    for unit, ride in zip(chain.units, bodies(chain, s, u), strict=True):
        assert ride.rate == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
        assert spring_rates(unit, ride, a, b) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)  # G w^2 of 1e2 times rounding
        assert ride.felt == pytest.approx((0.0, a, 0.0 if chain.has_springs else b), abs=1e-9)  # springs: test_roll


def test_a_body_stands_on_a_plane_as_the_plane_lies(chain: Vehicle) -> None:
    """Road heights of any plane under all wheels: after a long time every body has its height, pitch and roll."""
    level, slope, tilt = 0.02, 0.004, -0.006
    origins = np.cumsum([0.0, *(unit.rear_hitch[0] for unit in chain.units[:-1])])
    heights = [level + slope * (origins[w.unit] + w.axle.x) + tilt * w.y for w in wheels(chain)]
    s, u = at_rest(chain, road=np.array(heights))
    cg = origins + np.array([unit.cg_x for unit in chain.units])
    s = s._replace(heave=level + slope * cg, pitch=np.full(len(cg), -slope), roll=np.full(len(cg), tilt))
    for ride in bodies(chain, s, u):
        assert ride.offset == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)  # rounding of heights of 0.1 m


def test_the_trailer_stands_on_the_hitch_of_the_tractor_that_dives(tractor_semitrailer: Vehicle) -> None:
    """Tractor's nose down by 0.01 rad about its centre of gravity: the hitch behind it and the trailer's nose rise."""
    tractor, trailer = tractor_semitrailer.units
    s, u = at_rest(tractor_semitrailer)
    ride = bodies(tractor_semitrailer, s._replace(pitch=np.array([0.01, 0.0])), u)[1]
    risen = 0.01 * (tractor.cg_x - tractor.rear_hitch[0])
    assert ride.offset.pitch == pytest.approx(-risen / 7.70)
    assert ride.offset.heave == pytest.approx(risen * (1.0 + trailer.cg_x / 7.70))


# --- what the springs carry ---


def test_steady_cornering_moves_the_load_that_statics_ask_for(short_form: Vehicle) -> None:
    """m h a_y and the weight beside the roll axis, m g (h - h_r) roll; the hitch passes its share to the tractor."""
    a_y = 2.0
    s, u = at_rest(short_form)
    lean = settled(short_form, [0.0, 0.0], [a_y, a_y])
    s = s._replace(
        roll=np.array([attitude.roll for attitude, _ in lean]),
        roll_spring=np.array([spring.roll for _, spring in lean]),
    )
    load = outputs(short_form, s, u).load
    tractor, trailer = short_form.units
    moments = [
        unit.mass
        * (unit.cg_height * a_y + GRAVITY * (unit.cg_height - unit.roll_axis_height) * unit.roll_swing[0] * a_y)
        for unit in (tractor, trailer)
    ]
    passed = trailer.hitch_roll_share * moments[1]
    for wheels_of, expected in ((slice(0, 4), moments[0] + passed), (slice(4, 10), moments[1] - passed)):
        left, right = load[wheels_of][::2].sum(), load[wheels_of][1::2].sum()
        assert (right - left) * 2.04 / 2.0 == pytest.approx(expected, rel=1e-9)
    assert outputs(short_form, s, u).lateral_load_transfer[1] == pytest.approx(
        (moments[1] - passed) / 1.02 / (21500.0 * GRAVITY),
        rel=1e-6,  # the weight is given to 1e-8
    )


def test_a_body_that_is_thrown_up_loads_its_wheels_by_its_inertia(tractor_semitrailer: Vehicle) -> None:
    """All bodies 1 cm low: w^2 * 1 cm on top of gravity for every one, and all of it arrives at the ground."""
    s, u = at_rest(tractor_semitrailer)
    low = s._replace(heave=np.full(2, -0.01), heave_spring=np.full(2, 0.0))
    # at that moment the dampers push as well: the rate is 2 z w * 1 cm upward, and against it works 2 z w * rate
    expected = 0.0
    for unit in tractor_semitrailer.units:
        w, z = math.tau * unit.heave_frequency, unit.suspension_damping
        lag = 0.0 if unit is tractor_semitrailer.units[0] else -0.01 * (1.0 + unit.cg_x / 7.70)
        offset = 0.01 + lag  # the trailer's front stands on a hitch that is low as well
        expected += unit.mass * (GRAVITY + w**2 * offset * (1.0 - (2.0 * z) ** 2))
    assert outputs(tractor_semitrailer, low, u).load.sum() == pytest.approx(expected, rel=1e-9)


def test_a_side_that_has_lifted_off_reads_one(short_form: Vehicle) -> None:
    """The flag of rolling over: everything on the right wheels, no more than the axles' loads."""
    s, u = at_rest(short_form)
    s = s._replace(roll=np.full(2, 0.1), roll_spring=np.full(2, 2.0 * 0.2 * math.tau * 0.1))
    out = outputs(short_form, s, u)
    assert (out.lateral_load_transfer > 0.998).all()  # a lifted wheel keeps 10 N
    assert out.load.sum() == pytest.approx(short_form.mass * GRAVITY, rel=1e-9)


def test_a_bump_under_one_wheel_moves_no_weight_but_the_bodys(tractor_semitrailer: Vehicle) -> None:
    """3 cm under the left drive wheel: it takes load from the other side, and the sum changes by inertia alone."""
    road = np.zeros(10)
    road[2] = 0.03
    s, u = at_rest(tractor_semitrailer, road=road)
    out = outputs(tractor_semitrailer, s, u)
    level = outputs(tractor_semitrailer, *at_rest(tractor_semitrailer)).load
    assert out.load[2] > level[2]
    assert out.load[3] < level[3]
    felt = [ride.felt.heave for ride in bodies(tractor_semitrailer, s, u)]
    inertia = sum(unit.mass * a for unit, a in zip(tractor_semitrailer.units, felt, strict=True))
    assert out.load.sum() == pytest.approx(tractor_semitrailer.mass * GRAVITY + inertia, rel=1e-9)
