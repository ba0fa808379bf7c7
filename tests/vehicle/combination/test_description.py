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


def test_a_file_is_loaded_as_a_file_and_plain_numbers_do(tmp_path: Path) -> None:
    plain = re.sub(r"\{ value = (\S+), source = \"[^\"]*\" \}", r"\1", FILE.read_text())
    assert "source" not in plain
    mine = tmp_path / "mine.toml"
    mine.write_text(plain)
    assert load_vehicle(str(mine)) == load_vehicle("eu_tractor_semitrailer")
    assert vehicle_sources(str(mine)) == {}


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


def test_a_vehicle_is_a_value() -> None:
    vehicle, again = (load_vehicle("eu_tractor_semitrailer") for _ in range(2))
    assert vehicle is not again
    assert hash(again) == hash(vehicle)
    with pytest.raises(ValueError, match="frozen"):
        again.units[0].mass = 1.0  # type: ignore[misc]  # exactly what must be refused
