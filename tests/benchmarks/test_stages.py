"""Times of the stages of the loop, side by side in one run: compare them with each other, not with another machine.

Each benchmark carries ``share_of_real_time``: its time over the simulated time it is worth. The sum for one camera
period is the reciprocal of the real-time factor without overlap. Run with ``make benchmarks``.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from scenarios.assembly.trailer_run import Assembly, assemble
from scenarios.options.scenario import load_scenario
from sensors.messages import StereoFrame
from vehicle.clock import TICK
from vehicle.combination.plant import VehicleCommand

CAMERA_PERIOD = 0.1  # [s]


@pytest.fixture(scope="module")
def parts() -> Iterator[Assembly]:
    assembly = assemble(load_scenario("roundabout"), seed=1)
    yield assembly
    assert assembly.cameras is not None
    assembly.close()


def note(benchmark: BenchmarkFixture, worth: float) -> None:
    assert benchmark.stats is not None
    benchmark.extra_info["share_of_real_time"] = benchmark.stats.stats.median / worth


@pytest.mark.parametrize("ticks", [1, 10])
def test_physics(benchmark: BenchmarkFixture, parts: Assembly, ticks: int) -> None:
    """One call of the plant: folding ten ticks into it saves the look-up of friction and slope nine times."""
    state = parts.plant.initial_state(parts.course.start, parts.scenario.speed)
    after = benchmark(parts.plant.step, state, VehicleCommand(0.1, 0.0, (0.0, 0.0)), ticks)
    note(benchmark, ticks * TICK)
    assert np.isfinite(after).all()


@pytest.mark.parametrize("name", ["roundabout", "constant-slip"])
def test_stereo_pair(benchmark: BenchmarkFixture, name: str) -> None:
    """Rendering, read-back, grey conversion and noise of one pair; all threads' processor time goes into the notes."""
    parts = assemble(load_scenario(name, ["viso_ot.fusion=none"]), seed=1)
    truth = parts.plant.observe(parts.plant.initial_state(parts.course.start, parts.scenario.speed), 0)
    before, pairs = time.process_time(), 0

    def pair() -> StereoFrame:
        nonlocal pairs
        pairs += 1
        return parts.trailers[-1].sensing.sensor.sample(truth)  # type: ignore[return-value]  # what cameras send

    frame = benchmark(pair)
    note(benchmark, CAMERA_PERIOD)
    benchmark.extra_info["processor_seconds_a_pair"] = (time.process_time() - before) / pairs
    assert parts.cameras is not None
    parts.close()
    assert isinstance(frame, StereoFrame)


def test_odometry_and_buffer(benchmark: BenchmarkFixture, parts: Assembly) -> None:
    """One step of the estimator between two frames 0.28 m apart."""
    state = parts.plant.initial_state(parts.course.start, parts.scenario.speed)
    memory = parts.trailers[-1].sensing.estimator.init()
    memory, _ = parts.trailers[-1].sensing.estimator.step(
        memory, parts.trailers[-1].sensing.sensor.sample(parts.plant.observe(state, 0))
    )
    state = parts.plant.step(state, VehicleCommand(0.0, 0.0, (0.0, 0.0)), 100)
    frame = parts.trailers[-1].sensing.sensor.sample(parts.plant.observe(state, 100))
    _, estimate = benchmark(parts.trailers[-1].sensing.estimator.step, memory, frame)
    note(benchmark, CAMERA_PERIOD)
    assert estimate.motion.inliers > 250
