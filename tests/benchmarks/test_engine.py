"""Cost of a tick, for one vehicle and for many, with and without a compiler: 5-axle tractor-semitrailer, one core.

Each benchmark notes ``us_per_tick``, the least of its rounds for one vehicle and tick, and fails above its limit.
Processor time is measured, so that other programs on the machine do not count. Run with ``make benchmarks``.
"""

import time

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from vehicle.combination.batch import BatchGround, PlantBatch
from vehicle.combination.description import load_vehicle
from vehicle.combination.functions import numbers
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.engine.compiler import compiler
from vehicle.engine.kernels import Engine
from vehicle.frames import Pose2
from vehicle.surface import Surface

VEHICLE = load_vehicle("eu_tractor_semitrailer")
DRY = Surface(friction=0.8)
CONE = Surface(friction=0.7, cross_fall=-0.025, centre=(0.0, 20.0))
STEADY = VehicleCommand(0.05, 0.2, ())
MANY = 1024
FOLDED = 20  # [ticks] to a call: a controller at 50 Hz

pytestmark = pytest.mark.benchmark(timer=time.process_time)
with_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler here")


def judge(benchmark: BenchmarkFixture, ticks: int, bar: float) -> None:
    """Note the time of one vehicle and tick [us], and compare it with the limit."""
    assert benchmark.stats is not None
    spent = 1e6 * benchmark.stats.stats.min / ticks
    benchmark.extra_info["us_per_tick"] = spent
    assert spent <= bar


# Interpreted 6.3: a quarter more operations than before suspensions and brakes, at the same time each.
@pytest.mark.parametrize(("engine", "bar"), [pytest.param("compiled", 2.0, marks=with_compiler), ("interpreted", 7.0)])
def test_tick_of_one_vehicle(benchmark: BenchmarkFixture, engine: Engine, bar: float) -> None:
    """Twenty ticks in a call."""
    plant = Plant(VEHICLE, DRY, engine)
    state = plant.step(plant.initial_state(Pose2(0.0, 0.0, 0.0), 10.0), STEADY, 500)
    benchmark(plant.step, state, STEADY, FOLDED)
    judge(benchmark, FOLDED, bar)


@pytest.mark.parametrize(("engine", "bar"), [pytest.param("compiled", 0.4, marks=with_compiler), ("interpreted", 2.0)])
def test_tick_of_many_vehicles(benchmark: BenchmarkFixture, engine: Engine, bar: float) -> None:
    """A batch of 1024, twenty ticks in a call, each vehicle at its own speed with its own steer."""
    batch, own = PlantBatch(VEHICLE, MANY, engine), np.tile(numbers(VEHICLE), (MANY, 1))
    level = BatchGround(np.full(MANY, 0.8), np.zeros(MANY), np.full((MANY, 2), np.nan))
    batch.place(np.arange(MANY), own, level, np.linspace(0.0, 25.0, MANY))
    command = np.linspace(-0.1, 0.1, MANY), np.linspace(-2.0, 1.0, MANY), np.zeros((MANY, 0))
    batch.step(*command, 100)
    benchmark.pedantic(batch.step, (*command, FOLDED), rounds=15, warmup_rounds=2)
    assert batch.finite.all()
    judge(benchmark, FOLDED * MANY, bar)


@pytest.mark.parametrize("surface", [DRY, CONE], ids=["plane", "cone"])
@pytest.mark.parametrize(("call", "bar"), [("step", 40.0), ("observe", 60.0)])
def test_call_for_one_tick(benchmark: BenchmarkFixture, call: str, bar: float, surface: Surface) -> None:
    """Overhead of a step, with the ground lookup where the ground changes with position; full ground truth."""
    plant = Plant(VEHICLE, surface)
    state = plant.initial_state(Pose2(0.0, 0.0, 0.0), 10.0)
    benchmark(getattr(plant, call), state, *((STEADY, 1) if call == "step" else (0,)))
    judge(benchmark, 1, bar)
