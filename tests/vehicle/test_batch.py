"""A batch is its vehicles, each as a plant would move it."""

from __future__ import annotations

import math
import multiprocessing
import pickle

import numpy as np
import pytest

from vehicle.combination.batch import PlantBatch
from vehicle.combination.description import Vehicle
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.engine.compiler import compiler
from vehicle.engine.kernels import Engine
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import SplitFriction, Surface

N = 13  # more than one vector of eight lanes, and not two
DRY = Surface(friction=0.8)
CONE = Surface(friction=0.6, cross_fall=0.03, centre=(5.0, 20.0))
# Rounding of 1e-16 grows by the few hundred operations of a step and by the stiffness of tyres, some 1e5 N per unit of
# slip; over 0.2 s nothing of it is unstable.
CLOSE = 1e-9

ENGINES = [
    pytest.param("compiled", marks=pytest.mark.skipif(compiler() is None, reason="no C compiler here")),
    "interpreted",
]


def poses() -> FloatArray:
    rng = np.random.default_rng(5)
    return np.column_stack([rng.uniform(-20.0, 20.0, (N, 2)), rng.uniform(-math.pi, math.pi, N)])


def demands(n_trailer: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    rng = np.random.default_rng(6)
    return rng.uniform(-0.3, 0.3, N), rng.uniform(-3.0, 1.0, N), rng.uniform(-0.2, 0.2, (N, n_trailer))


CALLS = [1, 4, *[5] * 12]  # [ticks]: up to 20 m/s the ground is looked up every 5 or less often
SPEEDS = np.linspace(0.0, 18.0, N)


def n_trailer(vehicle: Vehicle) -> int:
    return sum(len(unit.steered_axles) for unit in vehicle.units[1:])


def assert_each_is_a_plant(batch: PlantBatch, plants: list[Plant], n_steered: int) -> None:
    """Some calls of some ticks, and what is seen afterwards."""
    steer, acceleration, trailer_steer = demands(n_steered)
    states = batch.initial_state(poses(), SPEEDS)
    singles = [
        plant.initial_state(Pose2(*pose), speed) for plant, pose, speed in zip(plants, poses(), SPEEDS, strict=True)
    ]
    np.testing.assert_allclose(states, singles, rtol=1e-12, atol=1e-12)
    for ticks in CALLS:
        states = batch.step(states, steer, acceleration, trailer_steer, ticks)
    motion, wheels = batch.observe_motion(states), batch.observe_wheels(states)
    for k, plant in enumerate(plants):
        command = VehicleCommand(steer[k], acceleration[k], tuple(trailer_steer[k]))
        for ticks in CALLS:
            singles[k] = plant.step(singles[k], command, ticks)
        truth = plant.observe(singles[k], 60)
        np.testing.assert_allclose(states[k], singles[k], rtol=CLOSE, atol=CLOSE)
        np.testing.assert_allclose(motion.poses[k], truth.poses, atol=CLOSE)
        np.testing.assert_allclose(motion.velocities[k], truth.velocities, atol=CLOSE)
        np.testing.assert_allclose(motion.articulation[k], -np.diff(truth.poses[:, 2]), atol=CLOSE)
        np.testing.assert_allclose(wheels.steer[k], truth.steer, atol=CLOSE)
        np.testing.assert_allclose(wheels.loads[k], truth.wheel_loads, rtol=CLOSE)
        np.testing.assert_allclose(wheels.slip_angles[k], truth.wheel_slip_angles, atol=CLOSE)
        np.testing.assert_allclose(wheels.friction_used[k], truth.friction_used, atol=CLOSE)
        np.testing.assert_allclose(wheels.load_transfer[k], truth.load_transfer, atol=CLOSE)


@pytest.mark.parametrize("engine", ENGINES)
def test_each_of_a_batch_on_level_ground_is_a_plant(longer_semitrailer: Vehicle, engine: Engine) -> None:
    """Same vehicle, same ground, other states and demands."""
    batch = PlantBatch(longer_semitrailer, DRY, N, engine)
    assert_each_is_a_plant(batch, [Plant(longer_semitrailer, DRY, engine)] * N, 2)


@pytest.mark.parametrize("engine", ENGINES)
def test_each_of_a_batch_of_different_vehicles_on_different_ground_is_a_plant(
    tractor_semitrailer: Vehicle, engine: Engine
) -> None:
    """Loads from empty to full, and each on its own friction, slope and camber."""
    tractor, trailer = tractor_semitrailer.units
    laden = [trailer.model_copy(update={"mass": mass}) for mass in np.linspace(8e3, 32e3, N)]
    vehicles = [tractor_semitrailer.model_copy(update={"units": (tractor, unit)}) for unit in laden]
    surfaces = [
        Surface(friction=mu, cross_fall=0.05 * mu - 0.03, grade=0.03 - 0.04 * mu) for mu in np.linspace(0.1, 1.0, N)
    ]
    surfaces[3] = surfaces[7] = CONE
    batch = PlantBatch(vehicles, surfaces, N, engine)
    plants = [Plant(vehicle, surface, engine) for vehicle, surface in zip(vehicles, surfaces, strict=True)]
    assert_each_is_a_plant(batch, plants, 0)


def test_friction_acts_where_the_wheels_of_each_are(longer_semitrailer: Vehicle) -> None:
    """Ice to the left of the x axis: those that brake on the line turn right, those well off it do not."""
    split = Surface(friction=SplitFriction(left=0.1, right=0.8, line=np.array([[0.0, 0.0], [1.0, 0.0]])))
    batch = PlantBatch(longer_semitrailer, split, 3)
    states = batch.initial_state([[0.0, 0.0, 0.0], [0.0, 20.0, 0.0], [0.0, -20.0, 0.0]], 10.0)
    states = batch.step(states, 0.0, -4.0, np.zeros((3, 2)), 1000)
    yaw_rate = batch.observe_motion(states).velocities[:, 0, 2]
    assert yaw_rate[0] < -0.01
    np.testing.assert_allclose(yaw_rate[1:], 0.0, atol=1e-9)  # straight but for rounding


@pytest.mark.parametrize("engine", ENGINES)
def test_one_that_breaks_leaves_the_others_alone(longer_semitrailer: Vehicle, engine: Engine) -> None:
    """No number in a state or in a demand: these lanes are told, all others are as without them, to the bit."""
    batch = PlantBatch(longer_semitrailer, CONE, N, engine)
    steer, acceleration, trailer_steer = demands(2)
    start = batch.initial_state(poses(), SPEEDS)
    sound = batch.step(start, steer, acceleration, trailer_steer, 20)
    assert batch.finite(sound).all()
    start[2, 5] = math.nan
    start[4, 0] = math.inf
    start[5, 3] = 1e200  # [m/s]: finite still, but not what follows from it
    steer[6], trailer_steer[7, 1], acceleration[8] = math.nan, -math.inf, math.nan
    broken = batch.step(start, steer, acceleration, trailer_steer, 20)
    lost = [2, 4, 5, 6, 7, 8]
    assert np.flatnonzero(~batch.finite(broken)).tolist() == lost
    rest = np.setdiff1d(np.arange(N), lost)
    np.testing.assert_allclose(broken[rest], sound[rest], rtol=CLOSE, atol=CLOSE)
    still = batch.step(broken, *demands(2), 5)
    assert np.flatnonzero(~batch.finite(still)).tolist() == lost
    batch.observe_motion(still)
    batch.observe_wheels(still)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_step_is_a_function(longer_semitrailer: Vehicle, engine: Engine) -> None:
    """Same arguments, same result, to the bit, also from a pickled batch; and the arguments stay as they are."""
    batch = PlantBatch(longer_semitrailer, CONE, N, engine)
    start = batch.initial_state(poses(), SPEEDS)
    kept = start.copy()
    first = batch.step(start, *demands(2), 20)
    np.testing.assert_array_equal(start, kept)
    np.testing.assert_array_equal(batch.step(start, *demands(2), 20), first)
    again: PlantBatch = pickle.loads(pickle.dumps(batch))
    np.testing.assert_array_equal(again.step(start, *demands(2), 20), first)


def stepped_elsewhere(batch: PlantBatch, start: FloatArray) -> FloatArray:
    return batch.step(start, *demands(2), 20)


def test_a_batch_goes_on_in_another_process(longer_semitrailer: Vehicle) -> None:
    """Spawned workers, as learning libraries use them, get the same batch; here two at once."""
    batch = PlantBatch(longer_semitrailer, CONE, N)
    start = batch.initial_state(poses(), SPEEDS)
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        results = [pool.apply_async(stepped_elsewhere, (batch, start)) for _ in range(2)]
        for result in results:
            np.testing.assert_array_equal(result.get(timeout=60.0), stepped_elsewhere(batch, start))


def test_what_does_not_fit_is_refused(longer_semitrailer: Vehicle, tractor_semitrailer: Vehicle) -> None:
    """The message says what there is and what there must be."""
    with pytest.raises(ValueError, match="built differently"):
        PlantBatch([longer_semitrailer, tractor_semitrailer], DRY, 2)
    with pytest.raises(ValueError, match="1 vehicles for a batch of 2"):
        PlantBatch([longer_semitrailer], DRY, 2)
    with pytest.raises(ValueError, match="3 surfaces for 2 vehicles"):
        PlantBatch(longer_semitrailer, [DRY] * 3, 2)
    with pytest.raises(ValueError, match="n = 0"):
        PlantBatch(longer_semitrailer, DRY, 0)
    batch = PlantBatch(longer_semitrailer, DRY, 2)
    state = batch.initial_state(np.zeros((2, 3)), 5.0)
    with pytest.raises(ValueError, match=r"trailer_steer of shape \(2, 1\) must be \(2, 2\)"):
        batch.step(state, 0.0, 0.0, np.zeros((2, 1)), 1)
    with pytest.raises(ValueError, match="ticks = 0"):
        batch.step(state, 0.0, 0.0, np.zeros((2, 2)), 0)
