"""What a rover's ground image costs: bar 50 ms, a quarter of the 0.2 s it is worth, for wheels, light and camera."""

from __future__ import annotations

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from sensors.messages import GreyImage
from sensors.sand.kinds import KINDS
from sensors.sand.rig import nominal_rig
from sensors.sand.rover_pass import FRAME_TICKS, RoverPass
from sensors.sand.sequence import route_of
from sensors.sand.world import SandWorld
from sensors.trace_camera import TraceCamera, Webcam
from vehicle.clock import TICK
from vehicle.rover.description import load_rover
from vehicle.terrain import Terrain

LEAD, FRAMES = 45, 150  # the trace is as long as the view; then 2.4 m, some tiles of which are new


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_frame(benchmark: BenchmarkFixture, kind: str) -> None:
    """All four wheels imprint 16 mm, light is brought up to date, and the camera takes its image."""
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
    benchmark.extra_info["share_of_real_time"] = benchmark.stats.stats.mean / (FRAME_TICKS * TICK)
    assert image.shape == (480, 640)
