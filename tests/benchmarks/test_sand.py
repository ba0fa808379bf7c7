"""Cost of a rover's ground image, and of a slip angle from it.

Limit for the image: 50 ms for wheels, light and camera, a quarter of the period of 0.2 s. Limit for the slip angle:
20 ms of processor time on one core; ``median_ms`` is that of a frame, as other programs may use the machine too.
"""

from __future__ import annotations

import time

import cv2
import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from estimators.context import SlipEstimator
from estimators.estimates import Health
from estimators.slip.trace_tracker.tracker import FTracePlus
from estimators.slip.wheel_trace.ftrace import FTrace
from sensors.messages import GreyImage, RoverView
from sensors.sand.relief import KINDS
from sensors.sand.rover_pass import FRAME_TICKS, RoverPass, labelled_sequence, route_of
from sensors.sand.trace_camera import TraceCamera, Webcam
from sensors.sand.trace_rig import nominal_rig
from sensors.sand.world import SandWorld
from vehicle.clock import TICK
from vehicle.rover.description import load_rover
from vehicle.rover.terrain import Terrain

LEAD, FRAMES = 45, 150  # until the trace is as long as the view; then 2.4 m with some new tiles
VIEWS = 140  # of each kind of sand; the path begins on a crust without a trace


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_frame(benchmark: BenchmarkFixture, kind: str) -> None:
    """Four wheels imprint 16 mm, the light is updated, and the camera takes an image."""
    rover = load_rover("el_dorado_ii")
    rng = np.random.default_rng(1)
    truths = RoverPass(frames=LEAD + FRAMES, profile="fast").truths(rover, Terrain(), rng)
    world = SandWorld(kind, rng=rng, rover=rover, terrain=Terrain(), route=route_of(truths))
    camera = TraceCamera(world, nominal_rig(rover), Webcam(), rng)
    world.drive(truths[:LEAD])
    moments = iter(truths[LEAD:])

    def frame() -> GreyImage:
        truth = next(moments)
        world.drive([truth])
        return camera.sample(truth)

    image = benchmark.pedantic(frame, rounds=FRAMES, iterations=1)
    assert benchmark.stats is not None
    benchmark.extra_info["share_of_real_time"] = benchmark.stats.stats.mean / (FRAME_TICKS * TICK)
    assert image.shape == (480, 640)


@pytest.fixture(scope="module")
def drives() -> list[list[RoverView]]:
    """Views of plain sand, and with the rover's own shadow, which must not be mistaken for a trace."""
    rover = load_rover("el_dorado_ii")
    return [
        [moment.view for moment in labelled_sequence(kind, seed=101, frames=VIEWS, rover=rover, profile="fast")]
        for kind in ("uniform", "shadows")
    ]


@pytest.mark.parametrize("kind", [FTrace, FTracePlus])
def test_slip_angle(
    benchmark: BenchmarkFixture, kind: type[FTrace | FTracePlus], drives: list[list[RoverView]]
) -> None:
    """A straight line from edges of one image, or the whole trace, followed or searched for; the drives show traces."""
    estimator: SlipEstimator = kind(nominal_rig(load_rover("el_dorado_ii")))
    spent: list[float] = []

    def estimated() -> int:
        estimates = 0
        for drive in drives:
            memory = estimator.init()
            for view in drive:
                begin = time.process_time()
                memory, estimate = estimator.step(memory, view)
                spent.append(time.process_time() - begin)
                estimates += estimate.health is Health.OK
        return estimates

    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    estimates = benchmark.pedantic(estimated, rounds=3, warmup_rounds=1)
    cv2.setNumThreads(threads)
    assert estimates > VIEWS // 10
    benchmark.extra_info["median_ms"] = 1e3 * float(np.median(spent))
