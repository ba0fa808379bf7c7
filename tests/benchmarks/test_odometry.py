"""Cost of a stereo pair at 1344 x 391: rendered, and of the odometries on one core, the median.

Bars on the reference machine: keyframe 20 ms, viso2 40 ms. Run with ``make benchmarks``.
"""

import time
from typing import Any

import cv2
import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from estimators.context import Odometry
from scenarios.assembly.trailer_run import assemble
from scenarios.catalogue import ODOMETRY, resolve
from scenarios.options.scenario import load_scenario
from sensors.camera.rig import StereoCalibration
from sensors.messages import StereoFrame
from vehicle.combination.plant import VehicleCommand

PAIRS = 12  # 3.4 m: the keyframe odometry makes two or three keyframes


@pytest.fixture(scope="module")
def drive() -> tuple[StereoCalibration, list[StereoFrame]]:
    """Frames 0.28 m apart at the beginning of a roundabout."""
    parts = assemble(load_scenario("roundabout", ["viso_ot.fusion=none"]), seed=1)
    assert parts.cameras is not None
    state = parts.plant.initial_state(parts.course.start, parts.scenario.speed)
    frames: list[StereoFrame] = []
    for k in range(PAIRS):
        frame = parts.trailers[-1].sensing.sensor.sample(parts.plant.observe(state, 100 * k))
        assert isinstance(frame, StereoFrame)
        frames.append(frame)
        state = parts.plant.step(state, VehicleCommand(0.1, 0.0, (0.0, 0.0)), 100)
    parts.close()
    return parts.cameras.calibration, frames


@pytest.mark.parametrize("name", ["circular", "keyframe", "viso2"])
def test_stereo_pair(
    benchmark: BenchmarkFixture, drive: tuple[StereoCalibration, list[StereoFrame]], name: str
) -> None:
    """A short drive; ``median_pair_ms`` is the processor time of the ordinary pair, keyframes being the exception."""
    calibration, frames = drive
    odometry: Odometry[Any] = resolve("odometry", name, ODOMETRY)(calibration)
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    spent: list[float] = []

    def driven() -> int:
        memory, inliers = odometry.init(), 0
        for frame in frames:
            start = time.thread_time()
            memory, motion = odometry.step(memory, frame)
            spent.append(time.thread_time() - start)
            inliers = 0 if motion is None else motion.inliers
        return inliers

    inliers = benchmark.pedantic(driven, rounds=3, warmup_rounds=1)
    cv2.setNumThreads(threads)
    benchmark.extra_info["median_pair_ms"] = 1e3 * float(np.median(spent))
    assert inliers > 150


@pytest.mark.parametrize("name", ["roundabout", "constant-slip"])
def test_rendered_pair(benchmark: BenchmarkFixture, name: str) -> None:
    """Rendering, read-back, grey conversion and noise."""
    parts = assemble(load_scenario(name, ["viso_ot.fusion=none"]), seed=1)
    truth = parts.plant.observe(parts.plant.initial_state(parts.course.start, parts.scenario.speed), 0)
    assert isinstance(benchmark(parts.trailers[-1].sensing.sensor.sample, truth), StereoFrame)
    parts.close()
