"""Handling figures against closed forms, and against what they claim of the motion."""

import math
from typing import Any

import pytest

from tests.vehicle.chains import with_axles
from vehicle.combination import data_sheet
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle, vehicle_names
from vehicle.combination.handling import (
    characteristic_speed,
    critical_speed,
    peak_rearward_amplification,
    rearward_amplification,
    static_rollover_threshold,
    yaw_damping,
)
from vehicle.combination.linear import lateral_model
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.unit import Axle
from vehicle.tyres.tyre import StiffnessTyre


@pytest.fixture
def alone(tractor_semitrailer: Vehicle) -> Vehicle:
    """The tractor alone, without drag and pneumatic trail: it has closed forms."""
    return with_tyres(tractor_semitrailer.model_copy(update={"units": tractor_semitrailer.units[:1]}), {})


def with_tyres(vehicle: Vehicle, factors: dict[int, float]) -> Vehicle:
    """The vehicle without drag and trail, the stiffness of its numbered axles times a factor."""
    tyres: list[Any] = [axle.tyre for unit in vehicle.units for axle in unit.axles]
    plain = {"rolling_resistance": 0.0, "pneumatic_trail": 0.0}
    stiffnesses = [factors.get(k, 1.0) * tyre.cornering_stiffness for k, tyre in enumerate(tyres)]
    changed = [t.model_copy(update=plain | {"cornering_stiffness": C}) for t, C in zip(tyres, stiffnesses, strict=True)]
    return with_axles(vehicle, *({"tyre": tyre} for tyre in changed))


def closed_form(alone: Vehicle) -> tuple[float, float]:
    """Wheelbase [m] and F_f / (C_f g) - F_r / (C_r g) [rad/(m/s2)] of a vehicle with two axles."""
    (front, rear), loads = alone.units[0].axles, static_axle_loads(alone)[0]
    return front.x - rear.x, (loads[0] / stiffness(front, loads[0]) - loads[1] / stiffness(rear, loads[1])) / GRAVITY


def stiffness(axle: Axle, load: float) -> float:
    """Cornering stiffness [N/rad] of an axle under a load [N]."""
    tyre = axle.tyre
    assert isinstance(tyre, StiffnessTyre)
    return load * tyre.cornering_stiffness * (1.0 - tyre.load_sensitivity * (load / 2 / tyre.nominal_load - 1.0))


def test_yaw_rate_gain_is_largest_at_the_characteristic_speed(alone: Vehicle) -> None:
    """sqrt(L / K), where the gain is half of that without understeer."""
    L, K = closed_form(alone)
    found = characteristic_speed(alone, 20.0)
    assert found is not None
    assert found == pytest.approx(math.sqrt(L / K), rel=1e-6)  # as the gradient
    gains = [lateral_model(alone, v).steady_gain("yaw_rate_0") for v in (0.95 * found, found, 1.05 * found)]
    assert gains[1] == max(gains)
    assert gains[1] == pytest.approx(0.5 * found / L, rel=1e-6)  # as the gradient


def test_critical_speed_of_an_oversteering_tractor(alone: Vehicle) -> None:
    """sqrt(L / -K): above it the straight course diverges. It has no characteristic speed."""
    loose = with_tyres(alone, {1: 0.4})
    L, K = closed_form(loose)
    assert K < 0.0
    assert critical_speed(loose) == pytest.approx(math.sqrt(-L / K), rel=1e-5)  # as the gradient, and of the search
    assert characteristic_speed(loose, 10.0) is None


def test_understeering_combination_has_no_critical_speed(tractor_semitrailer: Vehicle) -> None:
    assert critical_speed(tractor_semitrailer) is None


def test_tail_heavy_trailer_swings_beyond_a_speed(tractor_semitrailer: Vehicle) -> None:
    """Load far behind its axles and soft tyres: a trailer's swing, not a divergence, sets the critical speed."""
    tractor, trailer = tractor_semitrailer.units
    trailer = trailer.model_copy(update={"cg_x": -8.5, "yaw_inertia": 8e5})
    swinging = with_tyres(
        tractor_semitrailer.model_copy(update={"units": (tractor, trailer)}), {2: 0.3, 3: 0.3, 4: 0.3}
    )
    speed = critical_speed(swinging)
    assert speed is not None
    assert yaw_damping(swinging, speed) == pytest.approx(0.0, abs=1e-6)  # the search's, on a damping of order 1
    assert yaw_damping(swinging, 0.98 * speed) > 0.0 > yaw_damping(swinging, 1.02 * speed)
    growing = lateral_model(swinging, speed).eigenvalues()[-1]
    assert abs(growing.imag) > 0.1  # [rad/s] it swings: a divergence has none


def test_damping_is_one_where_nothing_swings(alone: Vehicle) -> None:
    assert yaw_damping(alone, 1.0) == 1.0


def test_amplification_is_one_for_slow_steering(tractor_semitrailer: Vehicle) -> None:
    """Steered slowly, every unit goes through the same curve; its peak is held against published ones elsewhere."""
    assert rearward_amplification(tractor_semitrailer, 24.0, 1e-4) == pytest.approx(1.0, abs=1e-5)  # second order in f
    assert peak_rearward_amplification(tractor_semitrailer, 24.0).gain > 1.0


def test_rollover_threshold_is_where_the_moment_takes_all_of_one_side(short_form: Vehicle) -> None:
    """Of each unit: half its axle loads times track against inertia at the centre of gravity and the leaning weight."""
    tractor, trailer = short_form.units
    per_a_y = [
        unit.mass * (unit.cg_height + (unit.cg_height - unit.roll_axis_height) * GRAVITY * unit.roll_swing[0])
        for unit in (tractor, trailer)
    ]  # roll moment over lateral acceleration [kg m]
    carried = [per_a_y[0] + trailer.hitch_roll_share * per_a_y[1], (1.0 - trailer.hitch_roll_share) * per_a_y[1]]
    loads = static_axle_loads(short_form)
    by_hand = [
        0.5 * sum(load) * unit.axles[0].track / moment
        for load, unit, moment in zip(loads, (tractor, trailer), carried, strict=True)
    ]
    # Drag and its hitch force in straight running move 0.1 % of the load from axle to axle.
    assert static_rollover_threshold(short_form) == pytest.approx(min(by_hand), rel=2e-3)


# The data sheet: statics, reach of its steering, and handling


@pytest.mark.parametrize("name", vehicle_names())
def test_axles_carry_the_whole_weight(name: str) -> None:
    """Nothing floats: axle loads sum up to the weight, and each unit's to its own, what it gets and what it gives."""
    vehicle = load_vehicle(name)
    sheet = data_sheet.data_sheet(vehicle)
    assert sum(axle.load for unit in sheet.units for axle in unit.axles) == pytest.approx(vehicle.mass * GRAVITY)
    given = [unit.coupling_load or 0.0 for unit in sheet.units]
    for unit, gives, gets in zip(sheet.units, given, [*given[1:], 0.0], strict=True):
        carried = sum(axle.load for axle in unit.axles)
        assert carried == pytest.approx(unit.mass * GRAVITY + gets - gives)


def test_axles_are_listed_where_they_stand_lifted_ones_too() -> None:
    """Behind the foremost point: 5.0 m to the drive axle, 4.45 m to the kingpin and 6.39 m on to the first axle."""
    sheet = data_sheet.data_sheet(load_vehicle("eu_6x2_tractor_semitrailer"))
    stations = [[axle.behind_front for axle in unit.axles] for unit in sheet.units]
    assert stations[0] == pytest.approx([1.3, 5.0, 6.37])
    assert stations[1] == pytest.approx([10.84, 12.15, 13.46])
    lifted = [[axle.lifted for axle in unit.axles] for unit in sheet.units]
    assert lifted == [[False, False, True], [True, False, False]]
    assert [axle.load for unit in sheet.units for axle in unit.axles if axle.lifted] == [0.0, 0.0]


def test_origins_follow_the_hitches() -> None:
    assert load_vehicle("a_double").origins == pytest.approx((0.0, 0.285, -10.115, -14.665))


def test_full_lock_sweeps_the_circle_of_plane_geometry() -> None:
    """Wheelbase 5.70 m at 42 degrees: the outer front corner, 1.4 m ahead of the axle, sweeps 10.40 m."""
    truck = load_vehicle("rigid_truck").units[0]
    radius = 5.7 / math.tan(math.radians(42.0))
    assert data_sheet.tightest_turn(truck) == pytest.approx(math.hypot(radius + 1.275, 7.1))


def test_on_the_smallest_circle_the_last_axle_is_at_its_limit() -> None:
    """Path following without slip asks of an axle at x the angle -(x - L_f / 2) / sqrt(R^2 - L_f^2 / 4) (tangent)."""
    trailer = load_vehicle("uk_longer_semitrailer").units[1]
    R = data_sheet.tightest_following(trailer)
    assert R is not None
    asked = math.atan((10.62 - 7.0) / math.sqrt(R**2 - 7.0**2))
    assert math.degrees(asked) == pytest.approx(30.0)


def test_a_linkage_reaches_what_its_ratio_leaves() -> None:
    """42 degrees on the first axle are 0.665 times that on the second."""
    axles = data_sheet.data_sheet(load_vehicle("rigid_truck_8x4")).units[0].axles
    reaches = [math.degrees(axle.reach) for axle in axles if axle.reach is not None]
    assert reaches == pytest.approx([42.0, 0.665 * 42.0])
    assert {axle.group for axle in axles} == {"linkage", None}


def test_amplification_needs_a_second_unit(tractor_semitrailer: Vehicle) -> None:
    """Of a rigid truck there is nothing to say; of a combination the other figures belong to the same speed."""
    assert data_sheet.handling_at(load_vehicle("rigid_truck")).rearward_amplification is None
    handling = data_sheet.handling_at(tractor_semitrailer)
    assert handling.speed == data_sheet.STANDARD_SPEED
    assert handling.rearward_amplification is not None
    assert handling.rearward_amplification > 1.0  # a tractor-semitrailer amplifies a little
