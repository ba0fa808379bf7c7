"""Vehicle files: every number has a source, every mistake one clear line."""

import math
import re
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

import pytest

from tests.vehicle.chains import grouped
from vehicle.combination.description import Vehicle, load_vehicle, vehicle_names, vehicle_sources
from vehicle.combination.unit import Actuator

FILE = Path(str(resources.files("vehicle"))) / "parameters" / "eu_tractor_semitrailer.toml"
TMEASY = FILE.with_name("b_double_steered.toml")


def numbers(node: Any, key: str = "") -> dict[str, float]:
    """Every bare number of a TOML tree, and every sourced one under its own key."""
    if isinstance(node, dict) and "value" in node:
        return {key: node["value"]}
    if isinstance(node, bool | str):
        return {}
    if isinstance(node, dict | list):
        children = node.items() if isinstance(node, dict) else enumerate(node)
        return {k: v for name, child in children for k, v in numbers(child, f"{key}.{name}".lstrip(".")).items()}
    return {key: node}


@pytest.mark.parametrize("name", vehicle_names())
def test_shipped_vehicles_load_and_each_number_has_a_source(name: str) -> None:
    """A guess says so; anything else names where it was read or how it was derived."""
    assert load_vehicle(name).name == name
    contents = tomllib.loads((FILE.parent / f"{name}.toml").read_text())
    stated = vehicle_sources(name)
    assert numbers(contents).keys() == stated.keys()
    assert all(len(source) >= 5 for source in stated.values())


def test_degrees_of_the_file_are_radians_in_the_program() -> None:
    """Trailer actuators: +-30 deg, 20 deg/s, 0.15 s."""
    steering = load_vehicle("uk_longer_semitrailer").units[1].steering
    assert steering is not None
    assert (steering.limit, steering.rate_limit, steering.lag) == (math.radians(30.0), math.radians(20.0), 0.15)


def test_an_unknown_name_is_answered_with_the_nearest_and_all_known() -> None:
    with pytest.raises(ValueError, match=r"did you mean 'uk_longer_semitrailer'.*known: .*eu_tractor") as caught:
        load_vehicle("uk_longer_semitrailr")
    assert "\n" not in str(caught.value)


def test_a_file_is_loaded_as_a_file_and_plain_numbers_do(tmp_path: Path) -> None:
    plain = re.sub(r"\{ value = (\S+), source = \"[^\"]*\" \}", r"\1", FILE.read_text())
    assert "source" not in plain
    mine = tmp_path / "mine.toml"
    mine.write_text(plain)
    assert load_vehicle(str(mine)) == load_vehicle("eu_tractor_semitrailer")
    assert vehicle_sources(str(mine)) == {}


MISTAKES = [
    ("value = 34830.0", "value = 3.55", ["tyres.steer.nominal_load = 3.55 N must be between 300 and", "not kg"]),
    ("value = 32000.0", "value = -32000.0", ["units.1.mass = -32000.0 kg must be between 100 and 200000 kg"]),
    ("value = 0.25,", "value = 250,", ["drive.lag = 250 s must be above 0 and at most 5 s"]),
    ("value = 4.60,", "value = nan,", ["cornering_stiffness = nan 1/rad must be between 0.1 and 60 1/rad"]),
    ("value = 28880.0,", 'value = "28880",', ["units.0.yaw_inertia = '28880' must be a number between 10 and"]),
    ("\nyaw_inertia", "\nyaw_intertia", ["unknown key 'units.0.yaw_intertia'", "did you mean 'yaw_inertia'"]),
    ("cg_height =", "# cg_height =", ["key 'units.0.cg_height' [m] is missing (usual: 1.0)"]),
    ("[drive]", "[dirve]", ["unknown key 'dirve'", "did you mean 'drive'"]),
    ('tyre = "steer"', 'tyre = "ster"', ["units.0.axles.0.tyre = 'ster'", "did you mean 'steer'"]),
    ("[units.steering]", "[units.stering]", ["stering", "did you mean 'steering'"]),
    ("driven = true", "driven = false", ["units.0", "driven axle"]),
    ("value = -7.70,", "value = -6.0,", ["units.1", "front to rear", "[m]"]),
    ("value = -9.01,", "value = 9.01,", ["units.1", "[m]"]),
    ("\nhitch_height", "\n# hitch_height", ["units.0", "hitch_x and hitch_height", "[m]"]),
    ("steered = true", "steered = 1", ["units.0.axles.0.steered = 1 must be true or false"]),
    ("name =", "name", ["not a TOML file"]),
    ('model = "magic_formula"', 'model = "magic"', ["tyres.steer.model = 'magic'", "did you mean 'magic_formula'"]),
    ('model = "magic_formula"', "", ["key 'tyres.steer.model' is missing", "linear", "tmeasy"]),
    ('model = "magic_formula"', 'model = "brush"', ["unknown key 'tyres.steer.shape'"]),
    (
        'tyre = "steer"',
        'tyre = { model = "linear" }',
        ["missing: 'units.0.axles.0.tyre.nominal_load' [N], 'units.0.axles.0.tyre.relaxation_length' [m], "],
    ),
    ('brake = "steer"', 'brake = "stear"', ["no table [axle_brakes.stear]; did you mean 'steer'?"]),
    ('distribution = "load"', 'distribution = "mass"', ["brakes.distribution = 'mass'; known: load, pressure"]),
    ("value = [0.12, 0.15]", "value = [0.12]", ["tyres.steer.longitudinal.peak_slip.1", "missing"]),
    ("value = [0.12, 0.15]", 'value = [0.12, "0.15"]', ["peak_slip.1 = '0.15'", "must be a number, above"]),
    (
        "value = [0.9, 0.95]",
        "value = [0.1, 0.95]",
        ["tyres.steer.longitudinal", "sliding_slip = 0.1", "peak_slip = 0.12"],
    ),
    ("value = [0.54397, 0.50365]", "value = [0.9, 0.5]", ["sliding_force = 0.9", "peak_force"]),
    (
        "value = [17.687, 13.805]",
        "value = [17.687, 9.0]",
        ["initial_slope = 9", "peak_force / peak_slip = 9.972", "twice"],
    ),
    ("steered = true", "steered = true\nsteer_ratio = 0.0", ["units.0", "steer_ratio = 0", "between -2 and 2"]),
    ("steered = true", "steered = true\nload_share = 0.0", ["units.0.axles.0.load_share = 0.0 must be above 0"]),
    ("driven = true", "driven = true\nlifted = true", ["units.0", "driven axle"]),
    ("pitch_frequency = { value = 1.8,", "pitch_frequency = { value = 0.0,", ["units.0.pitch_frequency = 0.0 Hz"]),
    ("[units.roll]", "[units.rol]", ["unknown key 'units.0.rol'", "did you mean 'roll'"]),
    ("[units.coupling]", "hitch_roll_share = 0.3\n[units.coupling]", ["units.1", "roll.hitch_roll_share"]),
    (
        "suspension_damping =",
        "roll_gradient = 0.007\nsuspension_damping =",
        ["units.0: roll_gradient follows from the"],
    ),
    (
        "roll_stiffness = { value = 330000.0,",
        "roll_stiffness = { value = 330.0,",
        ["roll_stiffness = 330.0 N m/rad must be"],
    ),
]


@pytest.mark.parametrize(("right", "wrong", "said"), MISTAKES)
def test_a_mistake_in_a_file_gives_one_clear_line(tmp_path: Path, right: str, wrong: str, said: list[str]) -> None:
    """File, dotted key, value, limit and unit: what is needed to put it right."""
    text = next(text for text in (FILE.read_text(), TMEASY.read_text()) if right in text)
    bad = tmp_path / "bad.toml"
    bad.write_text(text.replace(right, wrong, 1))
    with pytest.raises(ValueError, match=r"bad\.toml: ") as caught:
        load_vehicle(str(bad))
    message = str(caught.value)
    assert "\n" not in message
    for words in said:
        assert words in message


def trailer_like(text: str, *changes: tuple[str, str]) -> str:
    tractor, trailer = text.split('name = "semitrailer"')
    for right, wrong in changes:
        assert right in trailer
        trailer = trailer.replace(right, wrong, 1)
    return tractor + 'name = "semitrailer"' + trailer


def test_raised_axles_are_told_from_those_on_the_ground(tmp_path: Path) -> None:
    """Everything that rolls looks at the axles on the ground; complaints count as the file does."""
    mine = tmp_path / "mine.toml"
    mine.write_text(trailer_like(FILE.read_text(), ("steered = false", "steered = false\nlifted = true")))
    vehicle = load_vehicle(str(mine))
    trailer = vehicle.units[1]
    assert [axle.x for axle in trailer.axles] == [-7.70, -9.01]
    assert [axle.x for axle in trailer.lifted_axles] == [-6.39]
    assert vehicle.n_wheels == 8
    raised_and_wrong = ("value = -9.01", "value = -9.01e3")
    mine.write_text(
        trailer_like(FILE.read_text(), ("steered = false", "steered = false\nlifted = true"), raised_and_wrong)
    )
    with pytest.raises(ValueError, match=r"units\.1\.axles\.2\.x"):
        load_vehicle(str(mine))


def test_an_axle_at_least_stays_on_the_ground(tmp_path: Path) -> None:
    mine = tmp_path / "mine.toml"
    mine.write_text(trailer_like(FILE.read_text(), *[("steered = false\n", "steered = false \nlifted = true\n")] * 3))
    with pytest.raises(ValueError, match=r"units\.1: at least one axle must stay on the ground"):
        load_vehicle(str(mine))


def test_axles_of_one_steer_group_share_an_actuator(longer_semitrailer: Vehicle) -> None:
    assert longer_semitrailer.units[1].actuators == (Actuator((1,), (1.0,)), Actuator((2,), (1.0,)))
    assert grouped(longer_semitrailer).units[1].actuators == (Actuator((1, 2), (1.0, 0.5)),)


@pytest.mark.parametrize("shapeless", ["units = 3", "tyres = 3", "units = [3]", "[[units]]\naxles = 3"])
def test_a_file_of_quite_another_shape_gives_one_clear_line(tmp_path: Path, shapeless: str) -> None:
    bad = tmp_path / "bad.toml"
    bad.write_text(f'name = "bad"\n{shapeless}\n')
    with pytest.raises(ValueError, match=r"bad\.toml: [^\n]+$"):
        load_vehicle(str(bad))


def test_a_missing_file_is_named() -> None:
    with pytest.raises(ValueError, match=r"nowhere/mine\.toml: cannot be read: No such file"):
        load_vehicle("nowhere/mine.toml")


def test_a_vehicle_is_a_value() -> None:
    vehicle, again = (load_vehicle("eu_tractor_semitrailer") for _ in range(2))
    assert vehicle is not again
    assert hash(again) == hash(vehicle)
    with pytest.raises(ValueError, match="frozen"):
        again.units[0].mass = 1.0  # type: ignore[misc]  # exactly what must be refused
