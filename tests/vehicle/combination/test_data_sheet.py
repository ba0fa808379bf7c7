"""The data sheet of a combination: statics, reach of its steering, and warnings."""

from __future__ import annotations

import math

import pytest

from vehicle.combination.data_sheet import (
    STANDARD_SPEED,
    data_sheet,
    handling_at,
    origins,
    tightest_following,
    tightest_turn,
)
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle, vehicle_names


@pytest.mark.parametrize("name", vehicle_names())
def test_axles_carry_the_whole_weight(name: str) -> None:
    """Nothing floats: axle loads sum up to the weight, and each unit's to its own, what it gets and what it gives."""
    vehicle = load_vehicle(name)
    sheet = data_sheet(vehicle)
    assert sum(axle.load for unit in sheet.units for axle in unit.axles) == pytest.approx(vehicle.mass * GRAVITY)
    given = [unit.coupling_load or 0.0 for unit in sheet.units]
    for unit, gives, gets in zip(sheet.units, given, [*given[1:], 0.0], strict=True):
        carried = sum(axle.load for axle in unit.axles)
        assert carried == pytest.approx(unit.mass * GRAVITY + gets - gives)


def test_axles_are_listed_where_they_stand_lifted_ones_too() -> None:
    """Behind the foremost point: 5.0 m to the drive axle, 4.45 m to the kingpin and 6.39 m on to the first axle."""
    sheet = data_sheet(load_vehicle("eu_6x2_tractor_semitrailer"))
    stations = [[axle.behind_front for axle in unit.axles] for unit in sheet.units]
    assert stations[0] == pytest.approx([1.3, 5.0, 6.37])
    assert stations[1] == pytest.approx([10.84, 12.15, 13.46])
    lifted = [[axle.lifted for axle in unit.axles] for unit in sheet.units]
    assert lifted == [[False, False, True], [True, False, False]]
    assert [axle.load for unit in sheet.units for axle in unit.axles if axle.lifted] == [0.0, 0.0]


def test_origins_follow_the_hitches() -> None:
    assert origins(load_vehicle("a_double")) == pytest.approx((0.0, 0.285, -10.115, -14.665))


def test_full_lock_sweeps_the_circle_of_plane_geometry() -> None:
    """Wheelbase 5.70 m at 42 degrees: the outer front corner, 1.4 m ahead of the axle, sweeps 10.40 m."""
    truck = load_vehicle("rigid_truck").units[0]
    radius = 5.7 / math.tan(math.radians(42.0))
    assert tightest_turn(truck) == pytest.approx(math.hypot(radius + 1.275, 7.1))


def test_on_the_smallest_circle_the_last_axle_is_at_its_limit() -> None:
    """Path following without slip asks of an axle at x the angle -(x - L_f / 2) / sqrt(R^2 - L_f^2 / 4) (tangent)."""
    trailer = load_vehicle("uk_longer_semitrailer").units[1]
    R = tightest_following(trailer)
    assert R is not None
    asked = math.atan((10.62 - 7.0) / math.sqrt(R**2 - 7.0**2))
    assert math.degrees(asked) == pytest.approx(30.0)


def test_a_linkage_reaches_what_its_ratio_leaves() -> None:
    """42 degrees on the first axle are 0.665 times that on the second."""
    axles = data_sheet(load_vehicle("rigid_truck_8x4")).units[0].axles
    reaches = [math.degrees(axle.reach) for axle in axles if axle.reach is not None]
    assert reaches == pytest.approx([42.0, 0.665 * 42.0])
    assert {axle.group for axle in axles} == {"linkage", None}


def test_amplification_needs_a_second_unit(tractor_semitrailer: Vehicle) -> None:
    """Of a rigid truck there is nothing to say; of a combination the other figures belong to the same speed."""
    assert handling_at(load_vehicle("rigid_truck")).rearward_amplification is None
    handling = handling_at(tractor_semitrailer)
    assert handling.speed == STANDARD_SPEED
    assert handling.rearward_amplification is not None
    assert handling.rearward_amplification > 1.0  # a tractor-semitrailer amplifies a little
