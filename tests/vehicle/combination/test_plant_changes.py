"""Changes of the plant's numbers: what each scales, what it leaves, and how wrong ones are refused."""

from pathlib import Path

import pytest

from tests.vehicle.chains import with_axles
from tests.vehicle.ground.test_tyres import TYRES as EVERY_LAW
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle, vehicle_names
from vehicle.combination.layout import wheels
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.roll import roll_gradients
from vehicle.combination.variants import LOADS, NamedChanges, changed_vehicle, load_cases, number_paths, with_load
from vehicle.foundation.user_file import ParameterLibrary
from vehicle.tyres import Planar


@pytest.fixture(scope="module")
def steered() -> Vehicle:
    return load_vehicle("b_double_steered")


@pytest.mark.parametrize("name", vehicle_names())
def test_scales_of_one_leave_every_vehicle_equal(name: str) -> None:
    vehicle = load_vehicle(name)
    ones = {key: 1.0 for key in NamedChanges.model_fields if key.endswith("_scale")}
    assert changed_vehicle(vehicle, ones) == vehicle
    assert changed_vehicle(vehicle, {}) == vehicle


def test_static_axle_loads_scale_with_the_masses(steered: Vehicle) -> None:
    heavier = changed_vehicle(steered, {"mass_scale": 1.2})
    for loads, before in zip(static_axle_loads(heavier), static_axle_loads(steered), strict=True):
        assert loads == pytest.approx([1.2 * load for load in before], rel=1e-12)  # rounding
    for unit, was in zip(heavier.units, steered.units, strict=True):
        assert (unit.mass, unit.yaw_inertia) == pytest.approx((1.2 * was.mass, 1.2 * was.yaw_inertia), rel=1e-15)
        assert unit.axles == was.axles


def test_inertia_and_height_scale_alone(steered: Vehicle) -> None:
    changed = changed_vehicle(steered, {"mass_scale": 0.5, "inertia_scale": 1.5, "cg_height_scale": 1.1})
    for unit, was in zip(changed.units, steered.units, strict=True):
        assert unit.yaw_inertia == pytest.approx(0.75 * was.yaw_inertia, rel=1e-15)
        assert unit.cg_height == pytest.approx(1.1 * was.cg_height, rel=1e-15)
        assert (unit.cg_x, unit.roll_axis_height) == (was.cg_x, was.roll_axis_height)


def test_brakes_share_by_the_changed_loads(steered: Vehicle) -> None:
    """More mass on the last unit alone: its wheels take a larger share of the brake force, the tractor's a smaller."""
    before = wheels(steered)
    after = wheels(changed_vehicle(steered, {"units.semitrailer.mass": 1.3 * steered.units[2].mass}))
    assert after[-1].brake_share > before[-1].brake_share
    assert after[0].brake_share < before[0].brake_share
    assert sum(wheel.brake_share for wheel in after) == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("law", EVERY_LAW)
def test_initial_slope_scales_and_peak_friction_stays(steered: Vehicle, law: str) -> None:
    """All laws are functions of the slip's linear force; so at 1/0.8 of the slip the softer tyre gives the same."""
    tyre = EVERY_LAW[law]
    softer = (
        changed_vehicle(with_axles(steered, {"tyre": tyre}), {"cornering_stiffness_scale": 0.8}).units[0].axles[0].tyre
    )
    F_z = 25e3
    assert float(softer.stiffness(F_z).y) == pytest.approx(0.8 * float(tyre.stiffness(F_z).y), rel=1e-12)
    assert float(softer.stiffness(F_z).x) == float(tyre.stiffness(F_z).x)
    assert float(softer.grip(F_z, 0.7, Planar(0.0, 0.0), 1.0).limit) == float(
        tyre.grip(F_z, 0.7, Planar(0.0, 0.0), 1.0).limit
    )
    for slip in (0.02, 0.1, 0.4, 1.5):  # up to sliding all over
        force, soft = (
            float(t.steady_force(Planar(0.0, s), F_z, 0.7).y) for s, t in ((slip, tyre), (slip / 0.8, softer))
        )
        assert soft == pytest.approx(force, rel=1e-9)


def test_steer_lag_is_that_of_towed_units(steered: Vehicle) -> None:
    changed = changed_vehicle(steered, {"steer_lag": 0.3, "steer_lag_scale": 0.5})
    lags = [unit.steering.lag for unit in changed.units if unit.steering is not None]
    assert lags == [0.1, 0.15, 0.15]
    scaled = changed_vehicle(steered, {"steer_lag_scale": 1.2})
    assert scaled.units[2].steering is not None
    assert scaled.units[2].steering.lag == pytest.approx(0.18, rel=1e-12)
    one_by_path = changed_vehicle(steered, {"steer_lag": 0.3, "units.1.steering.lag": 0.2})
    assert [unit.steering.lag for unit in one_by_path.units if unit.steering is not None] == [0.1, 0.2, 0.3]


@pytest.mark.parametrize("change", ["steer_lag", "steer_lag_scale"])
def test_steer_lag_without_steered_trailers_is_refused(change: str) -> None:
    with pytest.raises(ValueError, match=rf"^plant\.{change}: no towed unit of us_5_axle is steered$"):
        changed_vehicle(load_vehicle("us_5_axle"), {change: 0.3})


EDITS = [  # path, its line in the file, the same with another number
    ("units.semitrailer.mass", "mass = { value = 29625.0", 27000.0),
    ("units.2.mass", "mass = { value = 29625.0", 27000.0),
    ("units.lead_trailer.cg_x", "cg_x = { value = -3.619567", -3.7),
    ("drive.max_power", "max_power = { value = 400000.0", 350000.0),
    ("units.0.axles.0.track", "track = { value = 2.04", 2.1),
    ("units.tractor.steering.limit_deg", "limit_deg = { value = 42.0", 40.0),
    ("tyres.steer.nominal_load", "nominal_load = { value = 15450.0", 16000.0),
    ("tyres.twin.nominal_load", "nominal_load = { value = 28450.0", 29000.0),
]


@pytest.mark.parametrize(("path", "written", "value"), EDITS, ids=[edit[0] for edit in EDITS])
def test_a_path_sets_what_an_edit_of_the_file_sets(
    steered: Vehicle, tmp_path: Path, path: str, written: str, value: float
) -> None:
    text = ParameterLibrary("vehicle", "parameters").file("b_double_steered").read_text()
    assert text.count(written) == 1
    edited = tmp_path / "edited.toml"
    edited.write_text(text.replace(written, f"{written.rpartition(' ')[0]} {value}"))
    changed = changed_vehicle(steered, {path: value})
    assert changed == load_vehicle(str(edited))
    assert changed != steered


def test_nested_tables_are_paths(steered: Vehicle) -> None:
    nested = changed_vehicle(steered, {"mass_scale": 1.1, "units": {"semitrailer": {"mass": 27000.0, "cg_x": -5.9}}})
    dotted = changed_vehicle(
        steered, {"units.semitrailer.mass": 27000.0, "units.semitrailer.cg_x": -5.9, "mass_scale": 1.1}
    )
    assert nested == dotted
    assert nested.units[2].mass == pytest.approx(1.1 * 27000.0)  # values first, then scales


def test_a_bogie_s_name_stands_for_its_axles(steered: Vehicle) -> None:
    changed = changed_vehicle(steered, {"units.tractor.axles.tandem.track": 1.9})
    assert [axle.track for axle in changed.units[0].axles] == [2.04, 1.9, 1.9]


def test_axles_count_as_in_the_file_lifted_ones_included() -> None:
    name = next(name for name in vehicle_names() if any(unit.lifted_axles for unit in load_vehicle(name).units))
    vehicle = load_vehicle(name)
    i = next(i for i, unit in enumerate(vehicle.units) if unit.lifted_axles)
    in_file = sorted((*vehicle.units[i].axles, *vehicle.units[i].lifted_axles), key=lambda axle: -axle.x)
    k = in_file.index(vehicle.units[i].lifted_axles[0])
    lowered = changed_vehicle(vehicle, {f"units.{i}.axles.{k}.lifted": False})
    assert lowered.units[i].lifted_axles == vehicle.units[i].lifted_axles[1:]
    assert lowered.units[i].axles[k].x == in_file[k].x


def test_every_number_path_is_accepted_with_its_own_value(steered: Vehicle) -> None:
    values = {path: value for path, value in number_paths(steered).items() if ".tandem." not in path}  # two axles each
    assert {"units.1.mass", "units.lead_trailer.mass", "tyres.twin.lateral.peak_force.1"} <= values.keys()
    assert changed_vehicle(steered, values) == steered


# Load cases: mass, centre of gravity and inertia of units without a part of their payload


@pytest.mark.parametrize("name", [name for name in vehicle_names() if load_cases(load_vehicle(name)) != ("full",)])
def test_every_shipped_vehicle_stands_in_every_load_case(name: str) -> None:
    """Axle loads are positive and carry the whole mass; half laden lies midway, as loads are linear in the payload."""
    vehicle = load_vehicle(name)
    assert load_cases(vehicle) == tuple(LOADS)
    laden, half, empty = (with_load(vehicle, case) for case in ("full", "half", "unladen"))
    assert laden is vehicle
    payload = sum(unit.payload.mass for unit in vehicle.units if unit.payload is not None)
    assert empty.mass == pytest.approx(vehicle.mass - payload, rel=1e-12)  # rounding
    loads = [[load for unit in static_axle_loads(v) for load in unit] for v in (laden, half, empty)]
    assert min(loads[2]) > 5e3  # [N]: no axle hangs
    assert sum(loads[2]) == pytest.approx(empty.mass * GRAVITY, rel=1e-9)
    assert loads[1] == pytest.approx([0.5 * (a + b) for a, b in zip(loads[0], loads[2], strict=True)], rel=1e-9)
    for unit in empty.units:
        assert unit.rear_x < unit.cg_x < unit.front_x
    for unit, was in zip(empty.units, vehicle.units, strict=True):
        if was.payload is not None:
            uniform = unit.mass * (unit.front_x - unit.rear_x) ** 2 / 12.0
            assert 0.3 * uniform < unit.yaw_inertia < 1.5 * uniform  # a body of usual mass distribution


def test_the_payload_put_back_gives_the_laden_unit() -> None:
    vehicle = load_vehicle("eu_tractor_semitrailer")
    laden, empty = vehicle.units[1], with_load(vehicle, "unladen").units[1]
    load = laden.payload
    assert load is not None
    mass = empty.mass + load.mass
    cg_x = (empty.mass * empty.cg_x + load.mass * load.cg_x) / mass
    height = (empty.mass * empty.cg_height + load.mass * load.cg_height) / mass
    own = load.mass * (load.length**2 + load.width**2) / 12.0
    inertia = empty.yaw_inertia + own + empty.mass * (empty.cg_x - cg_x) ** 2 + load.mass * (load.cg_x - cg_x) ** 2
    assert (mass, cg_x, height, inertia) == pytest.approx(
        (laden.mass, laden.cg_x, laden.cg_height, laden.yaw_inertia), rel=1e-12
    )  # rounding


def test_model_errors_apply_to_the_load_case() -> None:
    """``plant.mass_scale`` scales what is there, and the payload with it."""
    vehicle = load_vehicle("us_5_axle")
    half = changed_vehicle(with_load(vehicle, "half"), {"mass_scale": 1.1})
    assert half.mass == pytest.approx(1.1 * with_load(vehicle, "half").mass, rel=1e-12)
    heavier = changed_vehicle(vehicle, {"mass_scale": 1.1, "cg_height_scale": 0.9})
    empty = with_load(heavier, "unladen").units[1]
    expected = with_load(vehicle, "unladen").units[1]
    assert (empty.mass, empty.cg_height) == pytest.approx((1.1 * expected.mass, 0.9 * expected.cg_height), rel=1e-12)


def test_a_vehicle_without_payload_has_one_load_case() -> None:
    vehicle = load_vehicle("us_5_axle")
    bare = vehicle.model_copy(update={"units": tuple(u.model_copy(update={"payload": None}) for u in vehicle.units)})
    assert load_cases(bare) == ("full",)
    assert with_load(bare, "full") is bare
    with pytest.raises(ValueError, match=r"^load = half: us_5_axle has no table 'payload' in any unit"):
        with_load(bare, "half")
    with pytest.raises(ValueError, match=r"^load = 'hal' is not a load case; did you mean 'half'\?$"):
        with_load(vehicle, "hal")


PAYLOADS = [
    ("mass = { value = 25000.0", "mass = { value = 33000.0", "payload.mass = 33000 kg must be less than units.1.mass"),
    ("cg_height = { value = 2.202", "cg_height = { value = 2.9", "units.1.payload: leaves cg_height = -"),
    ("length = { value = 11.93", "length = { value = 16.0", "make the payload shorter"),
    ("length = { value = 11.93", "length = { value = 0.0", "units.1.payload.length = 0.0 m must be above 0 and"),
]


@pytest.mark.parametrize(("old", "new", "says"), PAYLOADS, ids=[new.partition(" ")[0] for _, new, _ in PAYLOADS])
def test_a_payload_that_leaves_no_body_is_refused(tmp_path: Path, old: str, new: str, says: str) -> None:
    text = ParameterLibrary("vehicle", "parameters").file("eu_tractor_semitrailer").read_text()
    head, payload, rest = text.partition("[units.payload]")
    assert old in rest
    path = tmp_path / "mine.toml"
    path.write_text(head + payload + rest.replace(old, new, 1))
    with pytest.raises(ValueError, match=r"^[^\n]*$") as error:
        with_load(load_vehicle(str(path)), "unladen")
    assert says in str(error.value)


def test_springs_carry_the_lighter_body(short_form: Vehicle) -> None:
    """Less mass on a shorter lever leans less and swings faster; heave stays, as with air springs."""
    laden, empty = short_form.units[1], with_load(short_form, "unladen").units[1]
    assert empty.roll_swing[0] < 0.5 * laden.roll_swing[0]
    assert empty.roll_swing[1] > laden.roll_swing[1]
    assert empty.heave_frequency == laden.heave_frequency


def test_the_empty_body_swings_on_the_same_suspensions() -> None:
    """The rest of the roll inertia is that of an empty body, and it leans less on the same springs."""
    vehicle = load_vehicle("eu_tractor_semitrailer")
    empty = with_load(vehicle, "unladen")
    trailer = empty.units[1]
    assert trailer.axles == vehicle.units[1].axles
    assert trailer.roll is not None
    assert trailer.roll.inertia == pytest.approx(trailer.mass * 0.95**2, rel=1e-2)  # rounded in the file
    assert roll_gradients(empty)[1] < 0.2 * roll_gradients(vehicle)[1]
