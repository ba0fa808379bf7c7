"""Shipped rovers and soils, and errors in their files."""

import math
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from pydantic import BaseModel

from vehicle.foundation.user_file import read_toml, sources
from vehicle.frames import Pose2
from vehicle.rover.command import RoverCommand
from vehicle.rover.data_sheet import RoverSheet, rover_sheet
from vehicle.rover.description import Rover, Soil, load_rover, load_soil, rover_names, rover_sources, soil_names
from vehicle.rover.plant import RoverPlant
from vehicle.rover.terrain import Terrain

ROVERS = Path(__file__).parents[3] / "vehicle" / "rovers"
LONG_FORM = """wheels = [
  { name = "front_left", x = 0.30, y = 0.275, driven = true, steered = true },
  { name = "front_right", x = 0.30, y = -0.275, driven = true, steered = true },
  { name = "rear_left", x = -0.30, y = 0.275, driven = true, steered = true },
  { name = "rear_right", x = -0.30, y = -0.275, driven = true, steered = true },
]
"""


def file_of(name: str, folder: Path, *changes: tuple[str, str]) -> str:
    """A copy of a shipped file, in which the line that begins with a word is replaced."""
    lines = (ROVERS / f"{name}.toml").read_text(encoding="utf-8").splitlines()
    for word, new in changes:
        (at,) = (k for k, line in enumerate(lines) if line.lstrip().startswith(word))
        lines[at] = new
    path = folder / "changed.toml"
    path.write_text("\n".join(lines), encoding="utf-8")
    return str(path)


def long_form(folder: Path) -> str:
    """El Dorado II with its four wheels in a list."""
    return file_of("el_dorado_ii", folder, ("wheelbase", ""), ("tread", ""), ("steered", LONG_FORM))


def numbers(node: object, key: str = "") -> set[str]:
    if isinstance(node, float):
        return {key}
    children = dict(node) if isinstance(node, BaseModel) else dict(enumerate(node)) if isinstance(node, tuple) else {}
    return set().union(*(numbers(child, f"{key}.{name}" if key else str(name)) for name, child in children.items()))


@pytest.mark.parametrize("name", rover_names())
def test_every_number_of_a_rover_has_a_source(name: str) -> None:
    """A number that nobody measured has a source "assumed: …"; wheelbase and tread stand for four places."""
    expected = numbers(load_rover(name))
    if name != "six_wheel_rover":
        expected = {key for key in expected if not key.startswith("wheels.")} | {"wheelbase", "tread"}
    assert {key for key, source in rover_sources(name).items() if source.strip()} == expected


def test_the_skid_steered_rover_is_the_same_with_its_steering_locked() -> None:
    steered, skid = load_rover("el_dorado_ii"), load_rover("el_dorado_ii_skid")
    assert skid.model_dump(exclude={"name", "summary", "wheels"}) == steered.model_dump(
        exclude={"name", "summary", "wheels"}
    )
    assert skid.places == steered.places
    assert steered.steered
    assert not skid.steered


def test_wheels_off_the_origin_are_refused(tmp_path: Path) -> None:
    """R's origin is the middle of the wheels: loads and turns are computed about it."""
    text = LONG_FORM.replace("x = 0.30", "x = 0.40")
    changed = file_of("el_dorado_ii", tmp_path, ("wheelbase", ""), ("tread", ""), ("steered", text))
    with pytest.raises(ValueError, match=r"wheels: the mean of their x is 0.05 m and must be 0"):
        load_rover(changed)


def test_wheels_stand_at_the_corners() -> None:
    """Front left, front right, rear left, rear right: half a wheelbase of 0.60 m and half a tread of 0.55 m away."""
    rover = load_rover("el_dorado_ii")
    assert rover.wheel_places.tolist() == [[0.3, 0.275], [0.3, -0.275], [-0.3, 0.275], [-0.3, -0.275]]
    assert [wheel.name for wheel in rover.wheels] == ["front_left", "front_right", "rear_left", "rear_right"]
    assert (rover.wheelbase, rover.tread, rover.rear_left) == (0.6, 0.55, 2)


def test_short_form_and_list_of_wheels_are_the_same_rover(tmp_path: Path) -> None:
    assert load_rover(long_form(tmp_path)) == load_rover("el_dorado_ii")


def test_effective_track_is_that_of_equal_slips() -> None:
    """2 (a^2 + b^2) / b with a = 0.3, b = 0.275 m: 2.19 times the tread, as skid-steering rovers show on hard floor.

    With a third pair of wheels in the middle the mean of x^2 falls to 2/3: 2 (2/3 a^2 + b^2) / b.
    """
    assert load_rover("el_dorado_ii").effective_track == pytest.approx(2.0 * (0.09 + 0.075625) / 0.275)
    assert load_rover("six_wheel_rover").effective_track == pytest.approx(2.0 * (2.0 / 3.0 * 0.16 + 0.09) / 0.3)


def test_the_camera_watches_the_rearmost_left_wheel() -> None:
    rover = load_rover("six_wheel_rover")
    assert rover.wheels[rover.rear_left].name == "rear_left"


@pytest.mark.parametrize("name", soil_names())
def test_every_number_of_a_soil_has_a_source(name: str) -> None:
    """A number that nobody measured has a source "assumed: …"."""
    numbers = {key for key, value in load_soil(name) if isinstance(value, float)}
    assert {
        key
        for key, source in sources(read_toml(Path(str(resources.files("vehicle"))) / "soils" / f"{name}.toml")).items()
        if source.strip()
    } == numbers


def test_a_soil_file_of_ones_own_is_read(tmp_path: Path) -> None:
    plain = load_soil("beach_sand").model_dump() | {"cohesion": 500.0}
    path = tmp_path / "own.toml"
    path.write_text("\n".join(f"{key} = {value!r}" for key, value in plain.items()), encoding="utf-8")
    assert load_soil(str(path)) == Soil(**plain)


# The data sheet of a rover against the simulated rover and closed forms


GRAVITY = 9.81


def nose_heavy() -> Rover:
    return load_rover("el_dorado_ii").model_copy(update={"cg_x": 0.05})


def sheet_in(soil: str) -> RoverSheet:
    return rover_sheet(load_rover("el_dorado_ii"), [load_soil(soil)])


def test_level_loads_are_those_of_the_simulated_rover() -> None:
    """The rear wheels carry less by the ratio of the distances to the centre of gravity."""
    rover = nose_heavy()
    plant = RoverPlant(rover, Terrain(), None)
    truth = plant.observe(plant.initial_state(Pose2(0.0, 0.0, 0.0)), 0)
    sheet = rover_sheet(rover, [])
    assert sheet.loads == pytest.approx(truth.loads, rel=1e-6)  # the plant has settled for 2 s
    assert sheet.loads[2] / sheet.loads[0] == pytest.approx((0.3 - 0.05) / (0.3 + 0.05))


def test_at_the_tipping_slope_the_lowest_wheels_carry_everything() -> None:
    """The normal component of the weight; and the moment about their line of contact vanishes."""
    rover = nose_heavy()
    weight = rover.mass * GRAVITY
    for tipping in rover_sheet(rover, []).tipping:
        loads = np.array(tipping.loads)
        assert np.count_nonzero(loads) == 2
        assert loads.sum() == pytest.approx(weight * math.cos(tipping.angle))
        along = {"uphill": 1.0, "downhill": -1.0, "sideways": 0.0}[tipping.direction]
        across = 1.0 if tipping.direction == "sideways" else 0.0
        normal, tangent = weight * math.cos(tipping.angle), weight * math.sin(tipping.angle)
        x, y = rover.wheel_places.T
        assert loads @ x == pytest.approx(normal * rover.cg_x - along * tangent * rover.cg_height)
        assert loads @ y == pytest.approx(-across * tangent * rover.cg_height, abs=1e-9)


def test_a_climb_below_the_limit_is_driven_and_one_above_it_is_not() -> None:
    """With wheels at half of their top speed for 20 s, 1.5 deg to either side of the limit in lunar simulant."""
    rover, soil = load_rover("el_dorado_ii"), load_soil("lunar_regolith_simulant")
    limit = sheet_in("lunar_regolith_simulant").traction[0].steepest_climb
    distances = []
    for angle in (limit - math.radians(1.5), limit + math.radians(1.5)):
        plant = RoverPlant(rover, Terrain(slope_x=math.tan(angle)), soil)
        state = plant.initial_state(Pose2(0.0, 0.0, 0.0))
        state = plant.step(state, RoverCommand((2.0,) * 4, (0.0,) * 4), 20_000)
        distances.append(float(state[0]))
    assert distances[0] > 0.05 > distances[1]


def test_spinning_wheels_are_entrapped_in_drift_sand_alone() -> None:
    """From the slip at which the sinkage reaches the rover's limit."""
    assert sheet_in("toyoura_sand").traction[0].entrapped_from is None
    drift = sheet_in("drift_sand").traction[0]
    assert drift.entrapped_from == pytest.approx(0.91, abs=0.01)
    assert drift.largest_pull_slip is not None
    assert drift.entrapped_from is not None
    assert drift.largest_pull_slip < drift.entrapped_from


def test_soil_that_does_not_carry_the_rover_has_no_traction() -> None:
    rover = load_rover("el_dorado_ii")
    heavy = rover.model_copy(update={"mass": 100.0 * rover.mass})
    (traction,) = rover_sheet(heavy, [load_soil("drift_sand")]).traction
    assert (traction.sinkage, traction.pull, traction.largest_pull) == (None, None, None)
    assert (traction.entrapped_from, traction.steepest_climb) == (0.0, 0.0)


def test_a_motor_that_stalls_pulls_nothing() -> None:
    """Drives of 1 N m can not turn wheels that need more to pull at 20 % slip."""
    rover, soil = load_rover("el_dorado_ii"), load_soil("beach_sand")
    weak = rover.model_copy(update={"stall_torque": 1.0})
    strong_pull, weak_pull = (rover_sheet(one, [soil]).traction[0] for one in (rover, weak))
    assert strong_pull.pull is not None
    assert weak_pull.pull is None
    assert weak_pull.steepest_climb < strong_pull.steepest_climb


def test_a_narrow_steering_range_limits_the_turn() -> None:
    """The wheels' axles meet at the turning centre: 0.3 m / tan(30 deg) inside the inner wheels."""
    rover = load_rover("el_dorado_ii").model_copy(update={"steer_limit_deg": 30.0})
    assert rover_sheet(rover, []).turning_radius == pytest.approx(0.275 + 0.3 / math.tan(math.radians(30.0)))
    assert rover_sheet(load_rover("el_dorado_ii_skid"), []).turning_radius is None


def test_six_wheels_share_the_load_and_tip_about_the_rearmost() -> None:
    """Equal loads on level ground; all of it on the last pair where the rover tips uphill."""
    rover = load_rover("six_wheel_rover")
    (uphill,) = (tipping for tipping in rover_sheet(rover, []).tipping if tipping.direction == "uphill")
    assert uphill.angle == pytest.approx(math.atan(0.40 / 0.24))
    assert np.flatnonzero(uphill.loads).tolist() == [4, 5]
    assert rover_sheet(rover, []).loads == pytest.approx([rover.mass * GRAVITY / 6.0] * 6)


@pytest.mark.slow
def test_a_wheel_without_a_drive_costs_pull() -> None:
    """Two wheels of four roll freely: less than half of the pull, as they resist."""
    rover, soil = load_rover("el_dorado_ii"), load_soil("lunar_regolith_simulant")
    front = tuple(wheel.model_copy(update={"driven": wheel.x < 0.0}) for wheel in rover.wheels)
    towing = rover_sheet(rover.model_copy(update={"wheels": front}), [soil])
    full = rover_sheet(rover, [soil]).traction[0].pull
    assert towing.traction[0].pull is not None
    assert full is not None
    assert 0.0 < towing.traction[0].pull < 0.5 * full
    assert towing.stall_thrust == pytest.approx(2.0 * 8.0 / 0.102)
