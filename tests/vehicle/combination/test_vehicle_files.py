"""The vehicles that come with the program: published figures, legal loads, and what the variants are there for."""

import math
from pathlib import Path

import pytest

from tests.vehicle.combination.test_loads import tonnes
from vehicle.combination.data_sheet import DataSheet, data_sheet
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle, vehicle_names
from vehicle.combination.handling import static_rollover_threshold, understeer_gradient, yaw_damping

FOOT = 0.3048  # [m]
PARAMETERS = Path(__file__).parents[3] / "vehicle" / "parameters"

# Limits of each axle group, front to rear, and of the whole [t]. Europe: 96/53/EC, annex I (driven axle 11.5, motor
# tandem up to 19, tridem 21 at 1.3 m and 24 above; other axles 10); Sweden has the same groups with a higher whole.
# US: 20 000, 34 000 and 80 000 lb. Australia: general mass limits of a B-double. UK: 8x4 rigids of 32 t.
LEGAL = {
    "rigid_truck": ((10.0, 11.5), 18.0),
    "rigid_truck_8x4": ((20.0, 19.0), 32.0),
    "eu_tractor_semitrailer": ((10.0, 11.5, 24.0), 40.0),
    "eu_6x2_tractor_semitrailer": ((10.0, 11.5, 18.0), 40.0),
    "uk_longer_semitrailer": ((10.0, 11.5, 24.0), 44.0),
    "uk_longer_semitrailer_grouped": ((10.0, 11.5, 24.0), 44.0),
    "uk_longer_semitrailer_one_steered": ((10.0, 11.5, 24.0), 44.0),
    "openpbs_tractor_semitrailer_6x2": ((10.0, 19.0, 21.0), 44.0),
    "a_double": ((10.0, 19.0, 21.0, 18.0, 21.0), 80.0),
    "b_double": ((6.0, 16.5, 20.0, 20.0), 62.5),
    "b_double_steered": ((6.0, 16.5, 20.0, 20.0), 62.5),
    "us_5_axle": ((9.072, 15.422, 15.422), 36.287),
    "wb62": ((9.072, 15.422, 15.422), 36.287),
    "wb67": ((9.072, 15.422, 15.422), 36.287),
    "desaxe_field_combination": ((10.0, 11.5, 18.0), 36.0),
    "mobile_crane_5_axle": ((12.0, 12.0, 36.0), 60.0),  # 12 t an axle, under a permit
}


def group_loads(vehicle: Vehicle) -> list[float]:
    """Static load of each group of axles less than 2 m apart [t]."""
    groups: list[float] = []
    for unit, loads in zip(vehicle.units, tonnes(vehicle), strict=True):
        last = math.inf
        for axle, load in zip(unit.axles, loads, strict=True):
            if last - axle.x < 2.0:
                groups[-1] += load
            else:
                groups.append(load)
            last = axle.x
    return groups


def test_every_shipped_vehicle_is_held_against_the_law() -> None:
    assert LEGAL.keys() == set(vehicle_names())


@pytest.mark.parametrize("name", LEGAL)
def test_static_loads_are_legal_and_laden(name: str) -> None:
    """Vehicles to test with are driven laden, yet not beyond what the road law lets them carry."""
    vehicle = load_vehicle(name)
    limits, whole = LEGAL[name]
    loads = group_loads(vehicle)
    assert len(loads) == len(limits)
    for load, limit in zip(loads, limits, strict=True):
        assert 0.35 * limit < load <= limit + 0.001  # [t]: a kilogram for pounds that were rounded to kilograms
    assert 0.7 * whole < vehicle.mass / 1e3 <= whole + 0.001
    assert data_sheet(vehicle).warnings == ()


@pytest.mark.parametrize("name", vehicle_names())
def test_masses_are_spread_like_those_of_road_vehicles(name: str) -> None:
    """Radius of gyration over length: 0.29 for a bar. The factor of 1e5 that an OpenPBS record lost gives 0.001."""
    for unit in load_vehicle(name).units:
        length = unit.front_x - min(unit.rear_x, *(axle.x for axle in unit.axles))
        if unit.front_x < 0.0:  # a dolly's drawbar
            length -= unit.front_x
        assert 0.2 < math.sqrt(unit.yaw_inertia / unit.mass) / length < 0.45


@pytest.mark.parametrize("name", sorted(LEGAL.keys() - {"mobile_crane_5_axle"}))  # in the short form
def test_every_shipped_vehicle_has_all_systems(name: str) -> None:
    """Brakes with ABS on every axle, a powertrain with an endurance brake, drag, and sides of its bodies' size."""
    vehicle = load_vehicle(name)
    assert vehicle.brakes is not None
    assert vehicle.brakes.abs
    assert all(axle.brake is not None for unit in vehicle.units for axle in unit.axles)
    assert vehicle.powertrain is not None
    assert vehicle.powertrain.retarder is not None
    assert vehicle.air is not None
    for unit in vehicle.in_wind().units:
        if unit.side_wind is not None:
            assert 0.2 < unit.side_wind.area / ((unit.front_x - unit.rear_x) * unit.height) < 0.9
            assert unit.rear_x < unit.side_wind.x < unit.front_x


@pytest.mark.slow
@pytest.mark.parametrize("name", vehicle_names())
def test_handling_is_that_of_vehicles_on_the_road(name: str) -> None:
    """Australian PBS: yaw damping ratio at least 0.15, rollover not below 0.35 g; and trucks do not oversteer laden."""
    vehicle = load_vehicle(name)
    assert yaw_damping(vehicle, 80.0 / 3.6) > 0.15
    assert 0.35 < static_rollover_threshold(vehicle) / GRAVITY < 0.8  # above, its centre of gravity would be a car's
    assert -1e-6 < understeer_gradient(vehicle, 80.0 / 3.6) * GRAVITY < math.radians(6.0)


@pytest.mark.parametrize(("name", "overall", "wb_2"), [("wb62", 69.0, 41.0), ("wb67", 73.5, 45.5)])
def test_aashto_vehicles_have_the_published_lengths(name: str, overall: float, wb_2: float) -> None:
    """Front overhang 4.0 + WB1 19.5 + WB2 + rear overhang 4.5 = overall length [ft]; the kingpin is where WB1 ends."""
    vehicle = load_vehicle(name)
    tractor, trailer = vehicle.units
    rounding = pytest.approx  # micrometres in the files
    assert vehicle.length / FOOT == rounding(overall, abs=1e-5)
    assert [axle.x / FOOT for axle in tractor.axles] == rounding([19.5, 0.0], abs=1e-5)
    assert tractor.hitch_x == 0.0
    assert [axle.x / FOOT for axle in trailer.axles] == rounding([-wb_2], abs=1e-5)


def test_lengths_stay_within_the_law() -> None:
    """96/53/EC: 16.50 m and 12 m behind the kingpin; UK trial 18.55 m; Australian B-double 26 m."""
    longest = {"eu_6x2_tractor_semitrailer": 16.5, "uk_longer_semitrailer_grouped": 18.55, "b_double": 26.0}
    for name, limit in longest.items():
        assert 0.95 * limit < load_vehicle(name).length <= limit


def test_lifted_axles_carry_nothing_and_come_down_with_one_word(tmp_path: Path) -> None:
    """Down, the tag axle takes 7.5 t to the drive axle's 11.5, and the tridem shares equally."""
    up = load_vehicle("eu_6x2_tractor_semitrailer")
    assert [len(unit.lifted_axles) for unit in up.units] == [1, 1]
    assert [len(of_unit) for of_unit in tonnes(up)] == [2, 2]
    mine = tmp_path / "mine.toml"
    text = (PARAMETERS / "eu_6x2_tractor_semitrailer.toml").read_text(encoding="utf-8")
    mine.write_text(text.replace("lifted = true", "lifted = false"), encoding="utf-8")
    down = load_vehicle(str(mine))
    (_, drive, tag), tridem = tonnes(down)
    assert tag / drive == pytest.approx(0.65)
    assert not data_sheet(down).warnings  # a declared share is no contradiction
    assert tridem == pytest.approx([sum(tridem) / 3] * 3)
    assert sum(map(sum, tonnes(up))) == pytest.approx(sum(map(sum, tonnes(down))))


def test_the_longer_trailer_comes_with_three_kinds_of_steering() -> None:
    """Two axles on an actuator each, two on one, one alone; but for that the same vehicle."""
    names = ("uk_longer_semitrailer", "uk_longer_semitrailer_grouped", "uk_longer_semitrailer_one_steered")
    each, grouped, alone = (load_vehicle(name).units[1] for name in names)
    assert [actuator.axles for actuator in each.actuators] == [(1,), (2,)]
    assert [actuator.axles for actuator in grouped.actuators] == [(1, 2)]
    assert [actuator.axles for actuator in alone.actuators] == [(2,)]
    same = {"mass", "yaw_inertia", "cg_x", "cg_height", "front_x", "rear_x", "follow_x", "roll_gradient"}
    assert each.model_dump(include=same) == grouped.model_dump(include=same) == alone.model_dump(include=same)
    assert [axle.x for axle in each.axles] == [axle.x for axle in grouped.axles] == [axle.x for axle in alone.axles]


def test_linked_axles_turn_about_one_point() -> None:
    """The files' ratios are those of the tangents: at 5 degrees the axes of both axles meet within 5 cm."""
    for name, unit in (("uk_longer_semitrailer_grouped", 1), ("rigid_truck_8x4", 0)):
        axles = [axle for axle in load_vehicle(name).units[unit].axles if axle.steered]
        assert len({axle.ackermann_x for axle in axles}) == 1
        centre = axles[0].ackermann_x
        assert centre is not None
        radii = [abs(axle.x - centre) / math.tan(math.radians(5.0) * axle.steer_ratio) for axle in axles]
        # [m], of 67 m and 41 m: ratios have three digits, and an angle is its tangent within 0.3 %
        assert radii[0] == pytest.approx(radii[1], rel=4e-3)


def test_dolly_and_second_trailer_hang_where_the_record_has_them() -> None:
    """OpenPBS Adouble6x4: what couplings and groups carry, worked out by hand from moments about the hitches."""
    sheet: DataSheet = data_sheet(load_vehicle("a_double"))
    kingpin_2 = 33.8 - 33.8 * 4.6501 / 7.7
    dolly = (3.2 * 3.8391 + kingpin_2 * 4.55) / 4.55
    eye = 3.2 + kingpin_2 - dolly
    tridem = (33.101 * 4.3344 + eye * 10.4) / 7.7
    expected = [33.101 + eye - tridem, eye, kingpin_2]
    found = [unit.coupling_load for unit in sheet.units[1:]]
    assert [load / GRAVITY / 1e3 for load in found if load is not None] == pytest.approx(expected, abs=1e-6)
