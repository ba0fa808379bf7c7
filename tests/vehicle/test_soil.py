"""Shipped soils, and errors in soil files."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import pytest

from vehicle.foundation.parameter_file import read_toml, sources
from vehicle.rover.description import Soil, load_soil, soil_names


@pytest.mark.parametrize("name", soil_names())
def test_every_number_of_a_soil_has_a_source(name: str) -> None:
    """A number that nobody measured has a source "assumed: …"."""
    numbers = {key for key, value in load_soil(name) if isinstance(value, float)}
    assert {
        key
        for key, source in sources(read_toml(Path(str(resources.files("vehicle"))) / "soils" / f"{name}.toml")).items()
        if source.strip()
    } == numbers


@pytest.mark.parametrize("name", soil_names())
def test_a_soil_has_the_name_of_its_file(name: str) -> None:
    assert load_soil(name).name == name


def test_a_misspelt_soil_is_pointed_to_the_nearest() -> None:
    with pytest.raises(ValueError, match="did you mean 'toyoura_sand'"):
        load_soil("toyora_sand")


def test_a_soil_out_of_range_is_refused_with_value_and_unit(tmp_path: Path) -> None:
    plain = load_soil("beach_sand").model_dump() | {"density": -3.0}
    path = tmp_path / "odd.toml"
    path.write_text("\n".join(f"{key} = {value!r}" for key, value in plain.items()), encoding="utf-8")
    with pytest.raises(ValueError, match=r"density = -3.0 kg/m3 must be above 0 and at most"):
        load_soil(str(path))


def test_a_soil_file_of_ones_own_is_read(tmp_path: Path) -> None:
    plain = load_soil("beach_sand").model_dump() | {"cohesion": 500.0}
    path = tmp_path / "own.toml"
    path.write_text("\n".join(f"{key} = {value!r}" for key, value in plain.items()), encoding="utf-8")
    assert load_soil(str(path)) == Soil(**plain)
