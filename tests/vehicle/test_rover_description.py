"""The rovers that come with the program, and what is said of a wrong one."""

from __future__ import annotations

from pathlib import Path

import pytest

from vehicle.rover.description import Rover, load_rover, rover_names, rover_sources


@pytest.mark.parametrize("name", rover_names())
def test_every_number_of_a_rover_has_a_source(name: str) -> None:
    """What nobody measured says that it is assumed; nothing stands there without a word."""
    numbers = {key for key, value in load_rover(name) if isinstance(value, float)}
    assert {key for key, source in rover_sources(name).items() if source.strip()} == numbers


def test_the_skid_steered_rover_is_the_same_with_its_steering_locked() -> None:
    same = load_rover("el_dorado_ii").model_dump(exclude={"name", "summary", "steered"})
    assert load_rover("el_dorado_ii_skid").model_dump(exclude={"name", "summary", "steered"}) == same
    assert not load_rover("el_dorado_ii_skid").steered


def test_a_misspelt_rover_is_pointed_to_the_nearest() -> None:
    with pytest.raises(ValueError, match="did you mean 'el_dorado_ii'"):
        load_rover("eldorado_ii")


@pytest.mark.parametrize(
    ("key", "value", "complaint"),
    [
        ("mass", -1.0, r"mass = -1.0 must be greater than 0 \[kg\]"),
        ("cg_x", 0.4, r"cg_x = 0.4 m must lie between the wheels"),
        ("sinkage_limit", 0.2, r"sinkage_limit = 0.2 m must be below the radius"),
    ],
)
def test_an_impossible_rover_is_refused(tmp_path: Path, key: str, value: float, complaint: str) -> None:
    plain = load_rover("el_dorado_ii").model_dump() | {key: value}
    path = tmp_path / "odd.toml"
    path.write_text("\n".join(f"{name} = {_toml(said)}" for name, said in plain.items()), encoding="utf-8")
    with pytest.raises(ValueError, match=complaint):
        load_rover(str(path))


def test_wheels_stand_at_the_corners() -> None:
    """Front left, front right, rear left, rear right: half a wheelbase of 0.60 m and half a tread of 0.55 m away."""
    places = load_rover("el_dorado_ii").wheel_places
    assert places.tolist() == [[0.3, 0.275], [0.3, -0.275], [-0.3, 0.275], [-0.3, -0.275]]


def test_effective_track_is_that_of_four_equal_slips() -> None:
    """2 (a^2 + b^2) / b with a = 0.3, b = 0.275 m: 2.19 times the tread, as skid-steering rovers show on hard floor."""
    rover: Rover = load_rover("el_dorado_ii")
    assert rover.effective_track == pytest.approx(2.0 * (0.09 + 0.075625) / 0.275)


def _toml(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else repr(value)
