"""A rover on loose soil and on uneven ground."""

import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.vehicle.rover.test_terramechanics import compiled
from tests.vehicle.rovers import HOME, STILL, STRAIGHT, driven, plant_on, slope_towards
from vehicle.clock import TICK
from vehicle.combination.layout import slices
from vehicle.combination.plant import DivergedError
from vehicle.engine.compiler import compiler
from vehicle.engine.kernels import kernel_for_one
from vehicle.frames import FloatArray, Pose2
from vehicle.rover.command import RoverCommand
from vehicle.rover.description import load_rover, load_soil, soil_names
from vehicle.rover.equations import RoverInput, RoverState, input_sizes, numbers, state_sizes, step_function
from vehicle.rover.plant import LONGEST_STEP, RoverPlant
from vehicle.rover.terrain import HeightMap, Mound, Terrain, load_height_map
from vehicle.rover.truth import RoverTruth

ROVER, SKID = load_rover("el_dorado_ii"), load_rover("el_dorado_ii_skid")
OMEGA = 0.08 / ROVER.radius  # of 8 cm/s, as Reina 2008 drove [rad/s]
FORWARD = RoverCommand((OMEGA,) * 4, STRAIGHT)
SIDE_SLOPE = Terrain(slope_y=math.tan(math.radians(5.0)))


def forces(soil: str, truth: RoverTruth) -> FloatArray:
    """F_x, F_y, F_z of the wheels (4, 3) from their true motion, by integration of the stresses."""
    force: Any = compiled(ROVER, load_soil(soil))
    rolling = truth.wheel_velocities / (ROVER.radius * truth.wheel_speeds[:, None])
    return np.array([np.array(force(h, *v)).ravel()[:3] for h, v in zip(truth.sinkages, rolling, strict=True)])


@pytest.mark.slow
@pytest.mark.parametrize("soil", ["toyoura_sand", "beach_sand", "lunar_regolith_simulant"])
def test_driving_straight_along_a_side_slope_it_drifts_downhill(soil: str) -> None:
    """5 degrees of slope and 8 cm/s, as in Reina 2008, fig. 8: some degrees of slip angle, and hardly any yaw.

    The paper has 6 to 11 degrees; on firmer soils wheels slip less.
    """
    truth = driven(plant_on(soil, SIDE_SLOPE), FORWARD, 20.0)
    assert -11.0 < math.degrees(truth.slip_angle) < -1.0
    assert abs(math.degrees(float(truth.pose[2]))) < 2.0


@pytest.mark.slow
@pytest.mark.parametrize("soil", ["toyoura_sand", "k10_mini_sand"])
def test_steady_forces_are_the_integrated_stresses(soil: str) -> None:
    """Steadily drifting, the stresses under the wheels carry the loads and hold the rover's weight on the slope.

    0.1 % is the remaining lag of the slip after 20 s of a slowly turning rover.
    """
    truth = driven(plant_on(soil, SIDE_SLOPE), FORWARD, 20.0)
    force = forces(soil, truth)
    weight = ROVER.mass * 9.81
    assert force[:, 2] == pytest.approx(truth.loads, rel=1e-3)
    rise = weight * math.sin(math.radians(5.0)) * np.array([math.sin(truth.pose[2]), math.cos(truth.pose[2])])
    assert np.sum(force[:, :2], axis=0) == pytest.approx(rise, abs=1e-3 * weight)


@pytest.mark.parametrize("soil", soil_names())
def test_it_stands_on_a_sandy_slope_without_creeping(soil: str) -> None:
    """8 degrees are far below the friction angle of any soil; a model with slip from speeds alone would creep."""
    slope_x, slope_y = slope_towards(0.6, math.radians(8.0))
    plant = plant_on(soil, Terrain(slope_x=slope_x, slope_y=slope_y))
    state = plant.step(plant.initial_state(HOME), STILL, 3000)
    assert plant.step(state, STILL, 5000)[:3] == pytest.approx(state[:3], abs=1e-6)


def test_spinning_wheels_dig_in_until_the_rover_is_entrapped() -> None:
    """Up 5 degrees of drift sand no slip pulls enough; on the level the rover moves on."""
    uphill = plant_on("drift_sand", Terrain(slope_x=math.tan(math.radians(5.0))))
    assert uphill.entrapped(driven(uphill, FORWARD, 30.0))
    level = plant_on("drift_sand")
    truth = driven(level, FORWARD, 30.0)
    assert not level.entrapped(truth)
    assert truth.pose[0] > 1.0


def test_a_crust_carries_the_wheels() -> None:
    """Wheels on firm ground, an input of the equations, rise onto it; those in sand do not."""
    soil = load_soil("toyoura_sand")
    at, in_state = RoverInput(*slices(input_sizes(4))), RoverState(*slices(state_sizes(4)))
    u = np.zeros(at.friction.stop)
    u[at.wheel_speed], u[at.step], u[at.friction] = OMEGA, LONGEST_STEP * TICK, 0.6
    u[at.firm] = 1.0, 1.0, 0.0, 0.0
    start = RoverPlant(ROVER, Terrain(), soil, "interpreted").initial_state(Pose2(0.0, 0.0, 0.0), 0.08)
    advance = kernel_for_one(step_function(ROVER, soil), numbers(ROVER, soil), "interpreted")
    sinkages = advance(start, u, 1000)[in_state.sinkage]
    assert sinkages[:2] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert np.all(sinkages[2:] > 0.02)


def test_sand_turns_a_skid_steered_rover_less_than_a_floor() -> None:
    command = RoverCommand((0.6 * OMEGA, 1.4 * OMEGA) * 2, STRAIGHT)
    sandy = driven(RoverPlant(SKID, Terrain(), load_soil("beach_sand"), "interpreted"), command, 10.0)
    floor = driven(RoverPlant(SKID, Terrain(), None, "interpreted"), command, 10.0)
    assert 0.0 < sandy.velocity[2] < floor.velocity[2]


def test_the_world_has_no_preferred_direction() -> None:
    """Slope and rover rotated together: quantities in the rover's frame stay, but for rounding in 10 s of slipping."""
    turned = 2.1
    truths = []
    for psi in (0.0, turned):
        slope_x, slope_y = slope_towards(psi + 1.0, 0.08)
        plant = plant_on("beach_sand", Terrain(slope_x=slope_x, slope_y=slope_y))
        truths.append(driven(plant, FORWARD, 10.0, Pose2(0.0, 0.0, psi)))
    one, other = truths
    assert other.velocity == pytest.approx(one.velocity, abs=1e-10)
    assert Pose2(0.0, 0.0, turned).apply(one.pose[None, :2])[0] == pytest.approx(other.pose[:2], abs=1e-10)
    assert other.loads == pytest.approx(one.loads, abs=1e-8)


def test_it_drives_backward_as_forward() -> None:
    plant = plant_on("toyoura_sand")
    forth, back = (driven(plant, RoverCommand((sign * OMEGA,) * 4, STRAIGHT), 10.0) for sign in (1.0, -1.0))
    assert back.pose[0] == pytest.approx(-forth.pose[0], rel=1e-3)  # at rest the entry is assumed in front
    assert back.slip_ratios == pytest.approx(forth.slip_ratios, rel=1e-3)
    assert back.sinkages == pytest.approx(forth.sinkages[[2, 3, 0, 1]], rel=1e-3)


def test_over_a_mound_the_nose_goes_up_and_down_again() -> None:
    """On firm ground straight over the top: the body pitches with the slope under the wheels and keeps its line."""
    terrain = Terrain(mounds=(Mound(x=2.0, y=0.0, height=0.2, radius=1.0),), friction=0.8)
    plant = RoverPlant(ROVER, terrain, None, "interpreted")
    state = plant.initial_state(HOME, 0.3)
    climbs = []
    for _ in range(26):
        state = plant.step(state, RoverCommand((0.3 / ROVER.radius,) * 4, STRAIGHT), 500)
        truth = plant.observe(state, 0)
        climbs.append(float(truth.X_WB[2, 0]))
        assert truth.X_WB[2, 3] == pytest.approx(
            np.mean(truth.wheel_positions[:, 2]), abs=1e-5
        )  # the change by one more iteration
    assert max(climbs) > 0.15  # the largest slope of 0.2 m over 1 m is 0.24
    assert min(climbs) < -0.15
    assert state[1:3] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert 3.0 < state[0] < 3.9


@pytest.mark.parametrize("soil", [None, "toyoura_sand"])
def test_integration_steps_are_short_enough(soil: str | None) -> None:
    """Steps of 1 ms against those of 5 ms that the plant takes by itself: 0.1 mm in 10 s from a standing start."""
    plant = RoverPlant(ROVER, SIDE_SLOPE, None if soil is None else load_soil(soil), "interpreted")
    start = plant.initial_state(HOME)
    fine = coarse = start
    for _ in range(5000):
        fine = plant.step(fine, FORWARD, 1)
    for _ in range(5):
        coarse = plant.step(coarse, FORWARD, 1000)
    assert coarse[:3] == pytest.approx(fine[:3], abs=1e-4)


@pytest.mark.slow
def test_compiled_and_interpreted_are_the_same() -> None:
    if compiler() is None:
        pytest.skip("no C compiler here")
    soil = load_soil("toyoura_sand")
    native, interpreted = (RoverPlant(ROVER, SIDE_SLOPE, soil, e) for e in ("compiled", "interpreted"))
    one = native.step(native.initial_state(HOME), FORWARD, 5000)
    other = interpreted.step(interpreted.initial_state(HOME), FORWARD, 5000)
    assert one == pytest.approx(other, rel=1e-9, abs=1e-12)


def test_a_pickled_plant_steps_alike() -> None:
    plant = plant_on("toyoura_sand", SIDE_SLOPE)
    same = pickle.loads(pickle.dumps(plant))
    state = plant.initial_state(HOME)
    assert np.array_equal(same.step(state, FORWARD, 100), plant.step(state, FORWARD, 100))


def test_the_initial_state_is_that_of_steady_driving() -> None:
    """At the given pose, with turns of 0, and the sinkage and slip of steady driving."""
    plant = plant_on("toyoura_sand", SIDE_SLOPE)
    start = plant.observe(plant.initial_state(Pose2(1.0, 2.0, 0.3), 0.08), 0)
    assert start.pose == pytest.approx([1.0, 2.0, 0.3], abs=0.0)
    assert start.wheel_turns == pytest.approx(np.zeros(4), abs=0.0)
    assert start.wheel_speeds == pytest.approx(np.full(4, OMEGA), rel=1e-6)
    later = plant.observe(plant.step(plant.initial_state(Pose2(1.0, 2.0, 0.3), 0.08), FORWARD, 1000), 0)
    assert start.slip_ratios == pytest.approx(later.slip_ratios, abs=0.01)
    assert start.sinkages == pytest.approx(later.sinkages, abs=2e-4)


def test_soil_that_does_not_carry_the_rover_is_refused() -> None:
    heavy = ROVER.model_copy(update={"mass": 2000.0})
    with pytest.raises(ValueError, match=r"toyoura_sand does not carry .* N on a wheel of el_dorado_ii"):
        RoverPlant(heavy, Terrain(), load_soil("toyoura_sand"), "interpreted").initial_state(HOME)


def test_a_state_that_is_not_finite_raises_diverged_error() -> None:
    plant = RoverPlant(ROVER, Terrain(), None, "interpreted")
    broken = plant.initial_state(HOME)
    broken[3] = math.nan
    with pytest.raises(DivergedError):
        plant.step(broken, FORWARD, 10)


# The ground itself


MOUND = Mound(x=1.0, y=-0.5, height=0.4, radius=1.5)


def mound_map(height: float) -> HeightMap:
    """A mound as a map of its heights, 5 m x 4 m."""
    x, y = np.meshgrid(np.arange(-1.5, 3.51, 0.05), np.arange(-2.5, 1.51, 0.05))
    mound = Mound(x=1.0, y=-0.5, height=height, radius=1.5)
    return HeightMap(heights=Terrain(mounds=(mound,)).height(x, y), spacing=0.05, x=-1.5, y=-2.5)


TERRAINS = {
    "slope": Terrain(slope_x=0.1, slope_y=-0.05),
    "mounds": Terrain(slope_y=0.08, mounds=(MOUND, Mound(x=0.0, y=0.3, height=-0.2, radius=0.8))),
    "height map": Terrain(slope_x=0.05, height_map=mound_map(0.4)),
}


def places() -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(2)
    return rng.uniform(-1.0, 2.5, (20, 3)), rng.uniform(-2.0, 1.0, (20, 3))


@pytest.mark.parametrize("terrain", TERRAINS.values(), ids=TERRAINS.keys())
def test_gradient_is_the_slope_of_the_height(terrain: Terrain) -> None:
    """Central differences over 20 micrometres: exact to the third derivative and to rounding, 1e-9."""
    (x, y), d = places(), 1e-5
    along = (terrain.height(x + d, y) - terrain.height(x - d, y)) / (2 * d)
    across = (terrain.height(x, y + d) - terrain.height(x, y - d)) / (2 * d)
    assert terrain.gradient(x, y) == pytest.approx(np.stack([along, across], axis=-1), abs=1e-8)


def test_a_slope_rises_by_its_angle_in_its_direction() -> None:
    """One metre in the direction of 0.5 rad rises by the tangent of the angle; across it the ground is level."""
    slope_x, slope_y = slope_towards(0.5, math.radians(5.0))
    terrain = Terrain(slope_x=slope_x, slope_y=slope_y)
    assert float(terrain.height(math.cos(0.5), math.sin(0.5))) == pytest.approx(math.tan(math.radians(5.0)))
    assert float(terrain.height(-math.sin(0.5), math.cos(0.5))) == pytest.approx(0.0, abs=1e-15)


def test_a_mound_has_its_height_and_ends_at_twice_its_radius() -> None:
    terrain = Terrain(mounds=(MOUND,))
    assert float(terrain.height(1.0, -0.5)) == pytest.approx(0.4)
    assert float(terrain.height(4.0, -0.5)) < 0.4 * 4e-4  # four standard deviations off: exp(-8)


def test_a_map_of_a_mound_is_the_mound() -> None:
    """Error of a bicubic spline: spacing to the fourth times the bell's fourth derivative, some 1e-6 m at 5 cm."""
    x, y = places()
    assert Terrain(height_map=mound_map(0.4)).height(x, y) == pytest.approx(
        Terrain(mounds=(MOUND,)).height(x, y), abs=1e-5
    )


def test_beyond_a_map_the_height_of_its_edge_continues() -> None:
    terrain = Terrain(height_map=mound_map(0.4))
    assert float(terrain.height(9.0, 0.0)) == float(terrain.height(3.5, 0.0))
    assert terrain.gradient(9.0, 0.0)[0] == 0.0


def test_a_height_map_is_read_from_text_and_from_an_array(tmp_path: Path) -> None:
    heights = np.arange(20.0).reshape(4, 5) ** 2 / 100.0
    np.savetxt(tmp_path / "heights.csv", heights, delimiter=",")
    np.save(tmp_path / "heights.npy", heights)
    for name in ("heights.csv", "heights.npy"):
        assert load_height_map(str(tmp_path / name), 0.5).heights == pytest.approx(heights)
    with pytest.raises(ValueError, match=r"none\.npy: cannot be read"):
        load_height_map(str(tmp_path / "none.npy"), 0.5)


@pytest.mark.parametrize(
    ("build", "complaint"),
    [
        (lambda: HeightMap(heights=np.zeros((3, 9)), spacing=1.0), "at least 4 x 4"),
        (lambda: HeightMap(heights=np.full((4, 4), np.nan), spacing=1.0), "finite"),
    ],
)
def test_impossible_ground_is_refused(build: object, complaint: str) -> None:
    assert callable(build)
    with pytest.raises(ValueError, match=complaint):
        build()
