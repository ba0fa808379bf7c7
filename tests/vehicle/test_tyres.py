"""Tyres: the magic formula is the steady state, and friction times load the bound."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vehicle.description import Vehicle
from vehicle.tyres import Planar, deflection_rate, force, rolling_speed, saturation, slip, steady_force, stiffness

loads = st.floats(2e3, 9e4)
frictions = st.floats(0.05, 1.2)
speeds = st.floats(-25.0, 25.0)

# Project Chrono, TMeasy GuessTruck80Par at nominal load, friction 0.8: slip angle [deg], side force over load.
TMEASY = [(0.5, 0.0508), (1, 0.0992), (2, 0.1894), (4, 0.3436), (6, 0.4663), (10, 0.6337), (15, 0.7383), (20, 0.7715)]


@pytest.fixture(scope="module", params=["steer", "drive", "trailer"])
def tyre(request: pytest.FixtureRequest, tractor_semitrailer: Vehicle):
    tractor, trailer = tractor_semitrailer.units
    return {"steer": tractor.axles[0], "drive": tractor.axles[1], "trailer": trailer.axles[0]}[request.param].tyre


@given(F_z=loads, friction=frictions, v_x=speeds, V_sx=speeds, V_sy=speeds)
def test_a_deflection_at_rest_gives_the_magic_formula(tyre, F_z, friction, v_x, V_sx, V_sy) -> None:
    """z = slip * saturation makes the rate vanish, and its force is the steady one, at any speed."""
    V_s = Planar(V_sx, V_sy)
    s = slip(V_s, v_x)
    share = saturation(s, friction, stiffness(F_z, tyre), tyre)
    z = Planar(s.x * share, s.y * share)
    rate = deflection_rate(z, V_s, v_x, F_z, friction, tyre)
    scale = 1e-9 * (1.0 + abs(V_sx) + abs(V_sy))  # rounding of a difference of two sliding velocities over a length
    assert rate == pytest.approx((0.0, 0.0), abs=scale)
    expected = steady_force(s, F_z, friction, tyre)
    assert force(z, Planar(0.0, 0.0), F_z, friction, tyre) == pytest.approx(expected, rel=1e-5, abs=1e-6 * F_z)


@given(F_z=loads, friction=frictions, z=st.tuples(*[st.floats(-5, 5)] * 2), rate=st.tuples(*[st.floats(-1e3, 1e3)] * 2))
def test_the_friction_circle_is_never_exceeded(tyre, F_z, friction, z, rate) -> None:
    """Whatever the state of the carcass, the ground gives no more than friction times load."""
    F = force(Planar(*z), Planar(*rate), F_z, friction, tyre)
    assert math.hypot(*F) <= friction * F_z * (1.0 + 1e-12)


@given(F_z=loads, friction=frictions, v_x=speeds, V_sx=speeds, V_sy=speeds)
def test_a_deflection_beyond_friction_over_stiffness_shrinks(tyre, F_z, friction, v_x, V_sx, V_sy) -> None:
    """The bristle cannot wind up: d|C z|^2/dt < 0 outside of |C z| = friction, whatever the sliding."""
    C = stiffness(F_z, tyre)
    for angle in np.linspace(0.0, math.tau, 7):
        u = Planar(1.02 * friction * math.cos(angle), 1.02 * friction * math.sin(angle))  # C z
        rate = deflection_rate(Planar(u.x / C.x, u.y / C.y), Planar(V_sx, V_sy), v_x, F_z, friction, tyre)
        assert u.x * C.x * rate.x + u.y * C.y * rate.y < 0.0


def test_the_force_opposes_the_slip_angle_and_drives_with_slip(tyre) -> None:
    """A wheel that drifts left is pulled right; a wheel that spins faster than it rolls pulls forward."""
    F = steady_force(slip(Planar(0.1, -0.2), 10.0), 35e3, 0.8, tyre)
    assert F.x > 0.0 > F.y


def test_friction_scales_the_peak_and_leaves_the_initial_stiffness(tyre) -> None:
    """Slope at no slip: C F_z; largest force: friction times load."""
    F_z = tyre.nominal_load
    for friction in (0.1, 0.3, 0.8):
        small = steady_force(Planar(0.0, 1e-4), F_z, friction, tyre)
        # quadratic falling off: relative (C s / mu)^2 and the smoothing of 1e-6 / (C s)
        assert small.y == pytest.approx(tyre.cornering_stiffness * F_z * 1e-4, rel=1e-3)
        forces = [steady_force(Planar(0.0, s), F_z, friction, tyre).y for s in np.linspace(0.0, 5.0, 5001)]
        assert max(forces) == pytest.approx(friction * F_z, rel=1e-4)  # the grid hits the flat top


@pytest.mark.parametrize(("angle_deg", "expected"), TMEASY)
def test_the_shape_is_that_of_a_truck_tyre(tyre, angle_deg: float, expected: float) -> None:
    """The shape was fitted to TMeasy's truck tyre within 0.03 of the load; stiffness and peak are put in."""
    like = tyre.model_copy(update={"cornering_stiffness": 5.948})
    got = steady_force(Planar(0.0, math.tan(math.radians(angle_deg))), tyre.nominal_load, 0.77253, like).y
    assert got / tyre.nominal_load == pytest.approx(expected, abs=0.03)


def test_stiffness_falls_with_load(tyre) -> None:
    """7.4 % of it from one to two nominal loads."""
    one, two = stiffness(tyre.nominal_load, tyre), stiffness(2.0 * tyre.nominal_load, tyre)
    assert (two.x / one.x, two.y / one.y) == pytest.approx((0.926, 0.926))


def test_rolling_speed_is_never_zero() -> None:
    """At rest slip is finite, and at 1 m/s the floor is invisible."""
    assert rolling_speed(0.0) > 0.0
    assert rolling_speed(-1.0) == pytest.approx(1.0, abs=2e-3)
