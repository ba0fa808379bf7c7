"""Each vehicle of a batch moves as a plant of its own would move it."""

import math

import numpy as np
import pytest

from vehicle.combination.batch import BatchGround, LaneObserver, PlantBatch
from vehicle.combination.description import Vehicle
from vehicle.combination.functions import numbers
from vehicle.combination.plant import Plant, SurfaceLookup, VehicleCommand
from vehicle.engine.kernels import Engine
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface

N = 13  # more than one vector of eight lanes, and not two
SPEEDS = np.linspace(0.0, 18.0, N)
FRICTION = np.linspace(0.1, 1.0, N)
CROSS_FALL = 0.03 - 0.05 * FRICTION
APEX = (5.0, 20.0)
# Rounding of 1e-16 grows by the few hundred operations of a step and by the stiffness of tyres, some 1e5 N per unit of
# slip; over 0.2 s nothing of it is unstable.
CLOSE = 1e-9


def commands(n_trailer: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    rng = np.random.default_rng(6)
    return rng.uniform(-0.3, 0.3, N), rng.uniform(-3.0, 1.0, N), rng.uniform(-0.2, 0.2, (N, n_trailer))


def ground(centre: tuple[float, float] = (math.nan, math.nan), lanes: slice = slice(None)) -> BatchGround:
    return BatchGround(FRICTION[lanes], CROSS_FALL[lanes], np.tile(centre, (len(FRICTION[lanes]), 1)))


def placed(vehicle: Vehicle, engine: Engine = "auto") -> PlantBatch:
    batch = PlantBatch(vehicle, N, engine)
    batch.place(np.arange(N), np.tile(numbers(vehicle), (N, 1)), ground(), SPEEDS)
    return batch


@pytest.mark.slow
def test_each_lane_on_a_plane_is_a_plant(longer_semitrailer: Vehicle, engine: Engine) -> None:
    """Loads from empty to full, and each on its own friction and cross-fall, forwards and backwards."""
    tractor, trailer = longer_semitrailer.units
    laden = [trailer.model_copy(update={"mass": mass}) for mass in np.linspace(8e3, 32e3, N).tolist()]
    vehicles = [longer_semitrailer.model_copy(update={"units": (tractor, unit)}) for unit in laden]
    batch = PlantBatch(longer_semitrailer, N, engine)
    batch.place(np.arange(N), np.array([numbers(vehicle) for vehicle in vehicles]), ground(), SPEEDS)
    steer, acceleration, trailer_steer = commands(2)
    gear = np.where(SPEEDS == 0.0, -1.0, 1.0)
    for ticks in (1, 4, 60):
        motion = batch.step(steer, acceleration, trailer_steer, ticks, gear)
    for k, vehicle in enumerate(vehicles):
        plant = Plant(vehicle, Surface(friction=FRICTION[k], cross_fall=CROSS_FALL[k]), engine)
        state = plant.initial_state(Pose2(0.0, 0.0, 0.0), SPEEDS[k])
        state = plant.step(state, VehicleCommand(steer[k], acceleration[k], tuple(trailer_steer[k]), gear[k]), 65)
        truth = plant.observe(state, 65)
        np.testing.assert_allclose(batch.state[k], state, rtol=CLOSE, atol=CLOSE)
        np.testing.assert_allclose(motion.poses[k], truth.poses, atol=CLOSE)
        np.testing.assert_allclose(motion.velocities[k], truth.velocities, atol=CLOSE)
        np.testing.assert_allclose(motion.steer[k], truth.steer, atol=CLOSE)
        np.testing.assert_allclose(motion.load_transfer[k], truth.load_transfer, atol=CLOSE)


def test_each_lane_on_a_cone_is_a_plant(longer_semitrailer: Vehicle, engine: Engine) -> None:
    """Steps of 5 ticks: up to 20 m/s a plant looks the ground up as often, so that both hold the same slopes."""
    batch = PlantBatch(longer_semitrailer, N, engine)
    batch.place(np.arange(N), np.tile(numbers(longer_semitrailer), (N, 1)), ground(APEX), SPEEDS)
    observer = LaneObserver(longer_semitrailer, batch)
    steer, acceleration, trailer_steer = commands(2)
    for _ in range(12):
        batch.step(steer, acceleration, trailer_steer, 5)
    for k in range(N):
        surface = Surface(friction=FRICTION[k], cross_fall=CROSS_FALL[k], centre=APEX)
        plant = Plant(longer_semitrailer, surface, engine)
        state = plant.initial_state(Pose2(0.0, 0.0, 0.0), SPEEDS[k])
        for _ in range(12):
            state = plant.step(state, VehicleCommand(steer[k], acceleration[k], tuple(trailer_steer[k])), 5)
        np.testing.assert_allclose(batch.state[k], state, rtol=CLOSE, atol=CLOSE)
        truth, expected = observer.truth(k, SurfaceLookup(surface, longer_semitrailer), 60), plant.observe(state, 60)
        assert truth.tick == 60
        for part in ("bodies", "steer", "wheel_loads", "wheel_slip_angles", "friction_used"):
            np.testing.assert_allclose(getattr(truth, part), getattr(expected, part), rtol=CLOSE, atol=CLOSE)


def test_placed_lanes_begin_anew_and_the_others_go_on(longer_semitrailer: Vehicle, engine: Engine) -> None:
    """To the bit: a lane neither knows what it did before nor that another is placed."""
    steer, acceleration, trailer_steer = commands(2)
    undisturbed, batch = placed(longer_semitrailer, engine), placed(longer_semitrailer, engine)
    first = undisturbed.step(steer, acceleration, trailer_steer, 20)
    batch.step(steer, acceleration, trailer_steer, 20)
    again = np.array([1, 4, 9])
    own = np.tile(numbers(longer_semitrailer), (len(again), 1))
    kept = np.setdiff1d(np.arange(N), again)
    batch.place(again, own, BatchGround(FRICTION[again], CROSS_FALL[again], np.full((3, 2), np.nan)), SPEEDS[again])
    np.testing.assert_array_equal(batch.state[kept], undisturbed.state[kept])
    motion = batch.step(steer, acceleration, trailer_steer, 20)
    undisturbed.step(steer, acceleration, trailer_steer, 20)
    np.testing.assert_array_equal(batch.state[kept], undisturbed.state[kept])
    np.testing.assert_array_equal(motion.poses[again], first.poses[again])
    np.testing.assert_array_equal(motion.velocities[again], first.velocities[again])


def test_one_that_breaks_leaves_the_others_alone(longer_semitrailer: Vehicle, engine: Engine) -> None:
    """A state or command that is no number: these lanes are known as lost until they are placed again."""
    steer, acceleration, trailer_steer = commands(2)
    sound = placed(longer_semitrailer, engine)
    sound.step(steer, acceleration, trailer_steer, 20)
    assert sound.finite.all()
    batch = placed(longer_semitrailer, engine)
    batch.state[2, 5] = math.nan
    batch.state[4, 0] = math.inf
    batch.state[5, 3] = 1e200  # [m/s]: finite still, but not what follows from it
    steer[6], trailer_steer[7, 1], acceleration[8] = math.nan, -math.inf, math.nan
    batch.step(steer, acceleration, trailer_steer, 20)
    lost = [2, 4, 5, 6, 7, 8]
    assert np.flatnonzero(~batch.finite).tolist() == lost
    rest = np.setdiff1d(np.arange(N), lost)
    np.testing.assert_array_equal(batch.state[rest], sound.state[rest])
    batch.step(*commands(2), 5)
    assert np.flatnonzero(~batch.finite).tolist() == lost
    batch.place(np.array(lost), np.tile(numbers(longer_semitrailer), (6, 1)), ground(lanes=slice(6)), SPEEDS[lost])
    batch.step(*commands(2), 5)
    assert batch.finite.all()


def test_back_is_the_same_vehicle_farther_back(longer_semitrailer: Vehicle) -> None:
    batch = placed(longer_semitrailer)
    observer, surface = LaneObserver(longer_semitrailer, batch), Surface(friction=0.5, cross_fall=0.02)
    here, back = (observer.truth(3, SurfaceLookup(surface, longer_semitrailer), 7, back=d) for d in (0.0, 5.0))
    np.testing.assert_allclose(back.poses - here.poses, [[-5.0, 0.0, 0.0]] * 2, atol=1e-12)
    np.testing.assert_allclose(back.wheel_loads, here.wheel_loads, rtol=1e-12)


def test_misfits_are_refused(longer_semitrailer: Vehicle) -> None:
    with pytest.raises(ValueError, match="n = 0"):
        PlantBatch(longer_semitrailer, 0)
    batch = PlantBatch(longer_semitrailer, 2)
    with pytest.raises(ValueError, match=r"trailer_steer of shape \(2, 1\) must be \(2, 2\)"):
        batch.step(0.0, 0.0, np.zeros((2, 1)), 1)
    with pytest.raises(ValueError, match="ticks = 0"):
        batch.step(0.0, 0.0, np.zeros((2, 2)), 0)
