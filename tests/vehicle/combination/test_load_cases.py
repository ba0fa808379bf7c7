"""Load cases: mass, centre of gravity and inertia of units without a part of their payload."""

from __future__ import annotations

from pathlib import Path

import pytest

from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle, vehicle_names
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.roll import roll_gradients
from vehicle.combination.variants import LOADS, changed_vehicle, load_cases, with_load
from vehicle.foundation.user_file import ParameterLibrary


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


BAD = [
    ("mass = { value = 25000.0", "mass = { value = 33000.0", "payload.mass = 33000 kg must be less than units.1.mass"),
    ("cg_height = { value = 2.202", "cg_height = { value = 2.9", "units.1.payload: leaves cg_height = -"),
    ("length = { value = 11.93", "length = { value = 16.0", "make the payload shorter"),
    ("length = { value = 11.93", "length = { value = 0.0", "units.1.payload.length = 0.0 m must be above 0 and"),
]


@pytest.mark.parametrize(("old", "new", "says"), BAD, ids=[new.partition(" ")[0] for _, new, _ in BAD])
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
