"""Vertical loads: the weighed ones at rest, equilibrium in motion."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vehicle.description import GRAVITY, Vehicle
from vehicle.layout import wheels
from vehicle.loads import axle_loads, roll_moments, static_axle_loads, wheel_load
from vehicle.multibody import Vector

accelerations = st.floats(-6.0, 6.0)


def tonnes(vehicle: Vehicle) -> list[list[float]]:
    return [[load / GRAVITY / 1000.0 for load in unit] for unit in static_axle_loads(vehicle)]


def test_static_axle_loads_are_those_of_the_audited_set(tractor_semitrailer: Vehicle) -> None:
    """Steer 7.10 t, drive 11.40 t, tridem 21.50 t, hence 10.50 t on the kingpin."""
    (steer, drive), tridem = tonnes(tractor_semitrailer)
    assert (steer, drive, sum(tridem)) == pytest.approx((7.10, 11.40, 21.50), abs=1e-5)  # kingpin given to 0.1 um


def test_axle_loads_of_the_longer_combination_are_legal(longer_semitrailer: Vehicle) -> None:
    """UK limits: drive axle 11.5 t, tridem 24 t; the whole 44 t."""
    (steer, drive), tridem = tonnes(longer_semitrailer)
    assert (steer, drive, sum(tridem)) == pytest.approx((7.10, 11.40, 21.50), abs=1e-3)  # cg given to 0.1 mm
    assert drive <= 11.5
    assert sum(tridem) <= 24.0


def test_shares_of_brakes_and_drive_add_up(chain: Vehicle) -> None:
    """The demanded acceleration is that of the whole combination."""
    layout = wheels(chain)
    assert sum(wheel.brake_share for wheel in layout) == pytest.approx(1.0)
    assert sum(wheel.drive_share for wheel in layout) == pytest.approx(1.0)


def loads_with_pull(vehicle: Vehicle, a: float, pull: float, gamma: float = 0.0) -> list[list[float]]:
    """Axle loads [N] of tractor and semi-trailer at an acceleration, the hitch pulling the trailer."""
    e = [Vector(1.0, 0.0), Vector(np.cos(gamma), np.sin(gamma))]
    return axle_loads(vehicle, [GRAVITY] * 2, [a, a], [Vector(0.0, 0.0), Vector(pull, 0.0)], e)


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
    x = [axle.x for axle in tractor.axles] + [tractor.hitch_x + axle.x for axle in trailer.axles]
    inertia = sum(unit.mass * a * unit.cg_height for unit in (tractor, trailer))
    weight = GRAVITY * (tractor.mass * tractor.cg_x + trailer.mass * (tractor.hitch_x + trailer.cg_x))
    assert np.dot(x, ahead + behind) == pytest.approx(weight - inertia, rel=1e-9)


def test_braking_loads_the_front_and_a_pull_at_the_hitch_unloads_it(tractor_semitrailer: Vehicle) -> None:
    """Signs of the pitching moment."""

    def steer_load(a: float, pull: float) -> float:
        return loads_with_pull(tractor_semitrailer, a, pull)[0][0]

    assert steer_load(-3.0, 0.0) > steer_load(0.0, 0.0) > steer_load(0.0, 1e4)


def test_roll_moments_add_up_and_load_the_outside(chain: Vehicle) -> None:
    """Whatever the hitches pass on, all of m h a_y arrives; in a left turn (a_y > 0) at the right wheels."""
    a_y = [1.0 + 0.1 * i for i in range(len(chain.units))]
    moments = roll_moments(chain, a_y)
    total = sum(unit.mass * unit.cg_height * a for unit, a in zip(chain.units, a_y, strict=True))
    assert sum(moments) == pytest.approx(total)
    assert wheel_load(6e4, 5e3, -1) > 3e4 > wheel_load(6e4, 5e3, +1)


@given(st.floats(-1e5, 2e5), st.floats(-1e5, 1e5))
def test_a_wheel_never_pulls_the_ground_up(axle_load: float, transfer: float) -> None:
    """A lifted wheel carries (next to) nothing; a loaded one what equilibrium asks for."""
    load = wheel_load(axle_load, transfer, 1)
    assert load > 0.0
    assert load == pytest.approx(max(0.0, 0.5 * axle_load - transfer), abs=25.1)  # half of the smoothing's 50 N
